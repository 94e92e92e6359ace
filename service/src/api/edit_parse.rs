//! From the JSON of an edit request to edits of the engine. Errors name the field.

use glam::DVec3;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

pub(super) use super::edit_lights::check_strength;
use super::edit_lights::{check_group, light_kind, unit};
use super::edit_types::{self as dto, Budget, CameraRef, EditOp, Focus, NewLight, TileMode, Tiles};
use super::problem::{ApiResult, Kind, Problem};
use super::skies;
use super::types::{JobPriority, dmat4, dvec3, vec3};
use crate::config::Config;
use crate::engine::{self, Edit, World};
use crate::jobs::budget::JobBudget;
use crate::store::assets::Assets;
use crate::store::history::{History, Turn};

/// An edit request, read.
pub(crate) struct Parsed {
    pub(crate) edits: Vec<EditOp>,
    pub(crate) budget: Option<Budget>,
    pub(crate) focus: Option<Focus>,
    pub(crate) tiles: Option<Tiles>,
    pub(crate) priority: JobPriority,
    /// The request was a list: fields are named `edits[i].…`.
    pub(crate) is_list: bool,
}

/// Reads the body of an edit request.
pub(crate) fn parse(body: &[u8], max_edits: usize) -> ApiResult<Parsed> {
    let value: Value =
        serde_json::from_slice(body).map_err(|error| Problem::new(Kind::InvalidJson, error.to_string()))?;
    let Value::Object(mut fields) = value else {
        return Err(Problem::new(Kind::InvalidJson, "the body has to be a JSON object"));
    };
    let Extras { mut budget, mut focus, mut tiles, mut priority } = take_extras(&mut fields, "")?;
    let Some(list) = fields.remove("edits") else {
        let priority = priority.unwrap_or_default();
        return Ok(Parsed { edits: vec![parse_op(fields, "")?], budget, focus, tiles, priority, is_list: false });
    };
    if let Some(unknown) = fields.keys().next() {
        let reason = "is not known beside `edits`; expected `budget`, `focus`, `tiles` or `priority`";
        return Err(Problem::field(Kind::InvalidValue, unknown, reason));
    }
    let Value::Array(list) = list else {
        return Err(Problem::field(Kind::InvalidValue, "edits", "has to be a list"));
    };
    if list.len() > max_edits {
        let reason = format!("may hold {max_edits} edits, not {}", list.len());
        return Err(Problem::field(Kind::InvalidValue, "edits", reason));
    }
    let mut edits = Vec::with_capacity(list.len());
    for (i, edit) in list.into_iter().enumerate() {
        let path = format!("edits[{i}]");
        let Value::Object(mut fields) = edit else {
            return Err(Problem::field(Kind::InvalidValue, path, "has to be an object"));
        };
        let its = take_extras(&mut fields, &path)?;
        budget = budget.or(its.budget);
        focus = focus.or(its.focus);
        tiles = tiles.or(its.tiles);
        priority = priority.or(its.priority);
        edits.push(parse_op(fields, &path)?);
    }
    Ok(Parsed { edits, budget, focus, tiles, priority: priority.unwrap_or_default(), is_list: true })
}

/// What an edit, or a list of them, may carry beside.
struct Extras {
    budget: Option<Budget>,
    focus: Option<Focus>,
    tiles: Option<Tiles>,
    priority: Option<JobPriority>,
}

fn take_extras(fields: &mut Map<String, Value>, path: &str) -> ApiResult<Extras> {
    fn take<T: DeserializeOwned>(fields: &mut Map<String, Value>, path: &str, name: &str) -> ApiResult<Option<T>> {
        // `null` is as good as absent.
        fields.remove(name).map_or(Ok(None), |value| read(value, &join(path, name)))
    }
    Ok(Extras {
        budget: take(fields, path, "budget")?,
        focus: take(fields, path, "focus")?,
        tiles: take(fields, path, "tiles")?,
        priority: take(fields, path, "priority")?,
    })
}

fn parse_op(mut fields: Map<String, Value>, path: &str) -> ApiResult<EditOp> {
    let op = take_word(&mut fields, path, "op")?;
    match op.as_str() {
        "insert" => read_fields(fields, path).map(EditOp::Insert),
        "remove" => read_fields(fields, path).map(EditOp::Remove),
        "move" => read_fields(fields, path).map(EditOp::Move),
        "material" => read_fields(fields, path).map(EditOp::Material),
        "hide" => read_fields(fields, path).map(EditOp::Hide),
        "show" => read_fields(fields, path).map(EditOp::Show),
        "undo" => read_fields(fields, path).map(EditOp::Undo),
        "redo" => read_fields(fields, path).map(EditOp::Redo),
        "relight" => read_fields(fields, path).map(EditOp::Relight),
        "insert_light" => parse_insert_light(fields, path),
        "sky" => read_fields(fields, path).map(EditOp::Sky),
        "remove_light" => read_fields(fields, path).map(EditOp::RemoveLight),
        "move_light" => read_fields(fields, path).map(EditOp::MoveLight),
        "group_lights" => read_fields(fields, path).map(EditOp::GroupLights),
        _ => {
            let known = "insert, remove, move, material, hide, show, relight, insert_light, sky, remove_light, \
                         move_light, group_lights, undo or redo";
            Err(Problem::field(Kind::InvalidValue, join(path, "op"), format!("{op:?} is none of {known}")))
        }
    }
}

fn parse_insert_light(mut fields: Map<String, Value>, path: &str) -> ApiResult<EditOp> {
    let at = join(path, "light");
    let light = match fields.remove("light") {
        Some(Value::Object(mut light)) => {
            let kind = take_word(&mut light, &at, "kind")?;
            match kind.as_str() {
                "point" => NewLight::Point(read_fields(light, &at)?),
                "spot" => NewLight::Spot(read_fields(light, &at)?),
                "directional" => NewLight::Directional(read_fields(light, &at)?),
                "environment" => NewLight::Environment(read_fields(light, &at)?),
                _ => {
                    let reason = format!("{kind:?} is none of point, spot, directional or environment");
                    return Err(Problem::field(Kind::InvalidValue, join(&at, "kind"), reason));
                }
            }
        }
        Some(_) => return Err(Problem::field(Kind::InvalidValue, at, "has to be an object")),
        None => return Err(Problem::field(Kind::InvalidValue, at, "is missing")),
    };
    let Named { name } = read_fields(fields, path)?;
    Ok(EditOp::InsertLight(dto::InsertLight { name, light }))
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Named {
    name: String,
}

fn take_word(fields: &mut Map<String, Value>, path: &str, name: &str) -> ApiResult<String> {
    match fields.remove(name) {
        Some(Value::String(word)) => Ok(word),
        Some(_) => Err(Problem::field(Kind::InvalidValue, join(path, name), "has to be a string")),
        None => Err(Problem::field(Kind::InvalidValue, join(path, name), "is missing")),
    }
}

fn read_fields<T: DeserializeOwned>(fields: Map<String, Value>, path: &str) -> ApiResult<T> {
    read(Value::Object(fields), path)
}

pub(super) fn read<T: DeserializeOwned>(value: Value, path: &str) -> ApiResult<T> {
    serde_path_to_error::deserialize(value).map_err(|error| {
        let inner = error.path().to_string();
        let at = if inner == "." { path.to_owned() } else { join(path, &inner) };
        let reason = error.into_inner().to_string();
        // Missing and unknown fields are told without a place of their own; their name is between backticks.
        let named = reason.strip_prefix("missing field `").or_else(|| reason.strip_prefix("unknown field `"));
        match named.and_then(|rest| rest.split_once('`')) {
            Some((field, _)) if !at.ends_with(field) => Problem::field(Kind::InvalidValue, join(&at, field), reason),
            _ if at.is_empty() => Problem::new(Kind::InvalidValue, reason),
            _ => Problem::field(Kind::InvalidValue, at, reason),
        }
    })
}

pub(super) fn join(path: &str, field: &str) -> String {
    if path.is_empty() { field.to_owned() } else { format!("{path}.{field}") }
}

/// Ids of the assets that a request uses.
pub(crate) fn used_assets<'a>(parsed: &'a Parsed) -> Vec<&'a str> {
    let asset = |op: &'a EditOp| match op {
        EditOp::Insert(insert) => Some(insert.asset.as_str()),
        EditOp::Sky(sky) => sky.asset.as_deref(),
        _ => None,
    };
    parsed.edits.iter().filter_map(asset).collect()
}

impl Parsed {
    /// Whether it goes through the scene's states, and which way. Such an edit stands alone.
    pub(crate) fn turn(&self) -> Option<Turn> {
        self.edits.iter().find_map(|op| match op {
            EditOp::Undo(_) => Some(Turn::Undo),
            EditOp::Redo(_) => Some(Turn::Redo),
            _ => None,
        })
    }

    /// Where the `i`-th edit stands in the body.
    pub(super) fn path(&self, i: usize) -> String {
        if self.is_list { format!("edits[{i}]") } else { String::new() }
    }
}

/// The engine's edits. Names of objects and lights are left to the engine, which knows the scene.
pub(crate) fn to_edits(parsed: &Parsed, assets: &Assets, history: &History, max_name: usize) -> ApiResult<Vec<Edit>> {
    let each = |(i, op): (usize, &EditOp)| {
        let path = parsed.path(i);
        let turn = match op {
            EditOp::Undo(_) => Turn::Undo,
            EditOp::Redo(_) => Turn::Redo,
            _ => return to_edit(op, &path, assets, max_name),
        };
        if parsed.edits.len() > 1 {
            let reason = "undo and redo stand alone in their request";
            return Err(Problem::field(Kind::InvalidValue, join(&path, "op"), reason));
        }
        let nothing = || {
            let reason = match turn {
                Turn::Undo => "there is no edit that can be taken back",
                Turn::Redo => "there is no edit that was taken back last",
            };
            Problem::field(Kind::NothingToTurn, join(&path, "op"), reason)
        };
        history.plan(turn).map(|(_, edit)| edit).ok_or_else(nothing)
    };
    parsed.edits.iter().enumerate().map(each).collect()
}

fn to_edit(op: &EditOp, path: &str, assets: &Assets, max_name: usize) -> ApiResult<Edit> {
    let finite = |field: &str, values: &[f64]| match values.iter().all(|value| value.is_finite()) {
        true => Ok(()),
        false => Err(Problem::field(Kind::InvalidValue, join(path, field), "has to be finite")),
    };
    Ok(match op {
        EditOp::Insert(insert) => {
            finite("transform", &insert.transform)?;
            check_name(&insert.name, &join(path, "name"), max_name)?;
            let asset = skies::model(&insert.asset, &join(path, "asset"), assets)?;
            Edit::Insert { asset, name: insert.name.clone(), transform: dmat4(&insert.transform) }
        }
        EditOp::Remove(dto::Remove { objects })
        | EditOp::Hide(dto::Hide { objects })
        | EditOp::Show(dto::Show { objects }) => {
            if objects.is_empty() {
                return Err(Problem::field(Kind::InvalidValue, join(path, "objects"), "names no object"));
            }
            let objects = objects.clone();
            match op {
                EditOp::Hide(_) => Edit::Hide { objects },
                EditOp::Show(_) => Edit::Show { objects },
                _ => Edit::Remove { objects },
            }
        }
        EditOp::Undo(_) | EditOp::Redo(_) => {
            return Err(Problem::field(Kind::InvalidValue, join(path, "op"), "stands alone in its request"));
        }
        EditOp::Move(place) => {
            finite("transform", &place.transform)?;
            Edit::Move { object: place.object.clone(), transform: dmat4(&place.transform) }
        }
        EditOp::Material(paint) => {
            finite("albedo", &paint.albedo.map(f64::from))?;
            if !paint.albedo.iter().all(|a| (0.0..=1.0).contains(a)) {
                return Err(Problem::field(Kind::InvalidValue, join(path, "albedo"), "each has to be 0 to 1"));
            }
            let albedo = vec3(paint.albedo);
            match (&paint.object, &paint.material) {
                (_, Some(material)) if material.is_empty() => {
                    let reason = "is empty: materials without a name are painted with their object";
                    return Err(Problem::field(Kind::InvalidValue, join(path, "material"), reason));
                }
                (object, Some(material)) => {
                    Edit::NamedMaterial { object: object.clone(), material: material.clone(), albedo }
                }
                (Some(object), None) => Edit::Material { object: object.clone(), albedo },
                (None, None) => {
                    let reason = "neither it nor `material` is given";
                    return Err(Problem::field(Kind::InvalidValue, join(path, "object"), reason));
                }
            }
        }
        EditOp::Relight(relight) => {
            if relight.lights.is_empty() {
                return Err(Problem::field(Kind::InvalidValue, join(path, "lights"), "names no light"));
            }
            let mut lights = Vec::with_capacity(relight.lights.len());
            for (i, one) in relight.lights.iter().enumerate() {
                let at = join(path, &format!("lights[{i}]"));
                check_strength(one.color.as_ref(), one.intensity, &at)?;
                let (color, intensity) = (one.color.map(vec3), one.intensity);
                lights.push(rebake_core::Relight { light: one.light.clone(), color, intensity });
            }
            Edit::Relight { lights }
        }
        EditOp::InsertLight(new) => {
            check_name(&new.name, &join(path, "name"), max_name)?;
            let at = join(path, "light");
            let (kind, color, intensity) = light_kind(&new.light, &at)?;
            check_strength(Some(&color), Some(intensity), &at)?;
            Edit::InsertLight { name: new.name.clone(), kind, color: vec3(color), intensity }
        }
        EditOp::Sky(sky) => skies::edit(sky, path, assets)?,
        EditOp::RemoveLight(remove) => Edit::RemoveLight { light: remove.light.clone() },
        EditOp::MoveLight(place) => {
            if place.position.is_none() && place.direction.is_none() {
                return Err(Problem::field(
                    Kind::InvalidValue,
                    join(path, "position"),
                    "neither it nor `direction` is given",
                ));
            }
            if let Some(position) = &place.position {
                finite("position", position)?;
            }
            let direction = place.direction.map(|d| unit(d, &join(path, "direction"))).transpose()?;
            let position = place.position.map(dvec3);
            Edit::MoveLight { light: place.light.clone(), position, direction, drag: place.drag }
        }
        EditOp::GroupLights(group) => {
            if let Some(name) = &group.name {
                check_group(name, &join(path, "name"), max_name)?;
            }
            if group.lights.is_empty() {
                return Err(Problem::field(Kind::InvalidValue, join(path, "lights"), "names no light"));
            }
            Edit::GroupLights { group: group.name.clone(), lights: group.lights.clone() }
        }
    })
}

/// A name for something new.
pub(crate) fn check_name(name: &str, field: &str, max_chars: usize) -> ApiResult<()> {
    let chars = name.chars().count();
    if chars == 0 || chars > max_chars {
        let reason = format!("has to have 1 to {max_chars} characters, not {chars}");
        return Err(Problem::field(Kind::InvalidValue, field, reason));
    }
    if name.chars().any(char::is_control) {
        return Err(Problem::field(Kind::InvalidValue, field, "holds control characters"));
    }
    Ok(())
}

/// The budget in force. With a bound on time or error alone, samples go on until that is reached.
/// `path` is where the budget's fields stand.
pub(crate) fn to_budget(
    budget: Option<Budget>,
    path: &str,
    default_samples: u32,
    config: &Config,
) -> ApiResult<JobBudget> {
    let Budget { samples_per_element, max_seconds, target_rmse } = budget.unwrap_or_default();
    let max_samples = config.limits.samples_per_element;
    if samples_per_element.is_some_and(|samples| !(1..=max_samples).contains(&samples)) {
        let reason = format!("has to be 1 to {max_samples}");
        return Err(Problem::field(Kind::InvalidValue, join(path, "samples_per_element"), reason));
    }
    let longest = config.limits.max_seconds;
    if max_seconds.is_some_and(|seconds| !(seconds > 0.0 && seconds <= longest)) {
        let reason = format!("has to be above 0 and at most {longest}");
        return Err(Problem::field(Kind::InvalidValue, join(path, "max_seconds"), reason));
    }
    if target_rmse.is_some_and(|rmse| !(rmse > 0.0 && rmse.is_finite())) {
        return Err(Problem::field(Kind::InvalidValue, join(path, "target_rmse"), "has to be above 0"));
    }
    let open_ended = if max_seconds.is_some() || target_rmse.is_some() { max_samples } else { default_samples };
    Ok(JobBudget { samples_per_element: samples_per_element.unwrap_or(open_ended), max_seconds, target_rmse })
}

/// Elements per tile: at least, at most.
const TILE_SIZES: (u32, u32) = (16, 1 << 20);

/// How what comes first is cut up, in the engine's terms.
pub(crate) fn to_tiles(tiles: &Tiles, config: &Config) -> ApiResult<engine::Tiles> {
    let within = |field: &str, value: Option<u32>, default: u32, (least, most): (u32, u32)| match value {
        Some(value) if !(least..=most).contains(&value) => {
            Err(Problem::field(Kind::InvalidValue, join("tiles", field), format!("has to be {least} to {most}")))
        }
        _ => Ok(value.unwrap_or(default)),
    };
    let default = engine::Tiles::default();
    let mode = match tiles.mode {
        None => default.mode,
        Some(TileMode::Global) => engine::TileMode::Global,
        Some(TileMode::Incremental) => engine::TileMode::Incremental,
        Some(TileMode::Continuous) => engine::TileMode::Continuous,
    };
    Ok(engine::Tiles {
        size: within("size", tiles.size, default.size, TILE_SIZES)?,
        samples: within("samples", tiles.samples, default.samples, (1, config.limits.samples_per_element))?,
        mode,
    })
}

/// What comes first, in the engine's terms.
pub(crate) fn to_focus(focus: &Focus, world: &World) -> ApiResult<engine::Focus> {
    let invalid = |field: &str, reason: &str| Problem::field(Kind::InvalidValue, join("focus", field), reason);
    let point = |field: &str, value: Option<[f64; 3]>| match value {
        Some(value) if value.iter().all(|x| x.is_finite()) => Ok(dvec3(value)),
        Some(_) => Err(invalid(field, "has to be finite")),
        None => Err(invalid(field, "is missing")),
    };
    let is_sphere = focus.point.is_some() || focus.radius.is_some();
    let is_view = focus.eye.is_some() || focus.target.is_some() || focus.up.is_some() || focus.fov_y.is_some();
    if usize::from(is_sphere) + usize::from(is_view) + usize::from(focus.camera.is_some()) != 1 {
        let reason = "has to be a camera of the file, or eye and target, or point and radius";
        return Err(Problem::field(Kind::InvalidValue, "focus", reason));
    }
    if is_sphere {
        let radius = focus.radius.filter(|r| r.is_finite() && *r > 0.0);
        let radius = radius.ok_or_else(|| invalid("radius", "has to be above 0"))?;
        return Ok(engine::Focus::Sphere { point: point("point", focus.point)?, radius });
    }
    let aspect = match (focus.width, focus.height) {
        (None, None) => 16.0 / 9.0,
        (Some(width), Some(height)) if width > 0 && height > 0 => width as f32 / height as f32,
        _ => return Err(invalid("width", "has to be above 0 and come with `height`, also above 0")),
    };
    if let Some(camera) = &focus.camera {
        let cameras = &world.scene.cameras;
        let found = match camera {
            CameraRef::Index(index) => cameras.get(*index as usize),
            CameraRef::Name(name) => cameras.iter().find(|camera| camera.name == *name),
        };
        let Some(camera) = found else {
            let reason = format!("the scene has {} cameras, and not this one", cameras.len());
            return Err(Problem::field(Kind::UnknownCamera, "focus.camera", reason));
        };
        let (eye, target, up) = eye_target_up(camera);
        return Ok(engine::Focus::Camera { eye, target, up, fov_y: camera.fov_y, aspect });
    }
    let fov_y = focus.fov_y.unwrap_or(std::f32::consts::FRAC_PI_3);
    if !(fov_y > 0.0 && fov_y < std::f32::consts::PI) {
        return Err(invalid("fov_y", "has to be above 0 and below π"));
    }
    let (eye, target) = (point("eye", focus.eye)?, point("target", focus.target)?);
    let up = match focus.up {
        None => DVec3::Y,
        up => point("up", up)?,
    };
    if eye == target || up == DVec3::ZERO {
        return Err(invalid("target", "has to differ from `eye`, and `up` from zero"));
    }
    Ok(engine::Focus::Camera { eye, target, up, fov_y, aspect })
}

/// A camera of the file as two points and a direction.
pub(crate) fn eye_target_up(camera: &rebake_core::scene::Camera) -> (DVec3, DVec3, DVec3) {
    let eye = camera.world_from_camera.w_axis.truncate();
    let forward = -camera.world_from_camera.z_axis.truncate().normalize_or(-DVec3::Z);
    (eye, eye + forward, camera.world_from_camera.y_axis.truncate().normalize_or(DVec3::Y))
}
