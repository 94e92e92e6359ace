//! From an edit request to edits of the engine. Errors name the field.

use rebake_core::allowed::Allowed;
use serde_json::Value;

use super::checks::check_name;
use super::edit_lights;
use super::edit_types::{
    Budget, EditList, EditOp, EditRequest, Focus, PaintedTexture, Redo, Repaint, SingleEdit, Tiles, Undo,
};
use super::misread::{FromFields, Misread, join};
use super::problem::{ApiResult, Kind, Problem};
use super::skies;
use super::types::{JobPriority, dmat4, vec3};
use crate::engine::Edit;
use crate::store::assets::Assets;
use crate::store::history::{History, Moves, Turn, Way};

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
    let fields = serde_json::from_slice(body).map_err(|error| Problem::new(Kind::InvalidJson, error.to_string()))?;
    let Value::Object(fields) = fields else {
        return Err(Problem::new(Kind::InvalidJson, "the body has to be a JSON object"));
    };
    match EditRequest::from_fields(fields).map_err(Misread::problem)? {
        EditRequest::Many(list) if list.edits.len() > max_edits => {
            let reason = format!("may hold {max_edits} edits, not {}", list.edits.len());
            Err(Problem::field(Kind::InvalidValue, "edits", reason))
        }
        EditRequest::Many(list) => Ok(Parsed::of_list(list)),
        EditRequest::One(SingleEdit { op, budget, focus, tiles, priority }) => {
            let priority = priority.unwrap_or_default();
            Ok(Parsed { edits: vec![op], budget, focus, tiles, priority, is_list: false })
        }
    }
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
    /// What the list says of all its edits counts first, then the first edit that says it.
    fn of_list(list: EditList) -> Parsed {
        let EditList { edits, budget, focus, tiles, priority } = list;
        let priority = priority.or(edits.iter().find_map(|edit| edit.priority)).unwrap_or_default();
        let mut parsed =
            Parsed { edits: Vec::with_capacity(edits.len()), budget, focus, tiles, priority, is_list: true };
        for SingleEdit { op, budget, focus, tiles, priority: _ } in edits {
            parsed.budget = parsed.budget.or(budget);
            parsed.focus = parsed.focus.or(focus);
            parsed.tiles = parsed.tiles.or(tiles);
            parsed.edits.push(op);
        }
        parsed
    }

    /// Whether it goes through the scene's states, and which way. Such an edit stands alone.
    pub(crate) fn way(&self) -> Option<Way> {
        self.edits.iter().find_map(way)
    }

    /// What it moves, where it does nothing else.
    pub(crate) fn moves(&self) -> Option<Moves> {
        let moved = |op: &EditOp| match op {
            EditOp::Move(place) => Some((format!("object {}", place.object), place.drag)),
            EditOp::MoveLight(place) => Some((format!("light {}", place.light), place.drag)),
            _ => None,
        };
        let (things, drag): (Vec<_>, Vec<_>) =
            self.edits.iter().map(moved).collect::<Option<Vec<_>>>()?.into_iter().unzip();
        (!things.is_empty()).then(|| Moves { things, is_step: drag.into_iter().all(|is| is) })
    }

    /// Where the `i`-th edit stands in the body.
    pub(super) fn path(&self, i: usize) -> String {
        if self.is_list { format!("edits[{i}]") } else { String::new() }
    }
}

/// The engine's edits. Names of objects and lights are left to the engine, which knows the scene.
pub(crate) fn to_edits(parsed: &Parsed, assets: &Assets, history: &History, allowed: Allowed) -> ApiResult<Vec<Edit>> {
    let each = |(i, op): (usize, &EditOp)| {
        let path = parsed.path(i);
        let Some(way) = way(op) else { return Ok(vec![to_edit(op, &path, assets, allowed)?]) };
        if parsed.edits.len() > 1 {
            let reason = "undo and redo stand alone in their request";
            return Err(Problem::field(Kind::InvalidValue, join(&path, "op"), reason));
        }
        let nothing = || {
            let reason = match way.turn {
                Turn::Undo => "there is no edit that can be taken back",
                Turn::Redo => "there is no edit that was taken back last",
            };
            Problem::field(Kind::NothingToTurn, join(&path, "op"), reason)
        };
        history.plan(way).map(|(_, edits)| edits).ok_or_else(nothing)
    };
    let edits: Vec<Vec<Edit>> = parsed.edits.iter().enumerate().map(each).collect::<ApiResult<_>>()?;
    Ok(edits.into_iter().flatten().collect())
}

fn way(op: &EditOp) -> Option<Way> {
    match op {
        EditOp::Undo(Undo { drag }) => Some(Way { turn: Turn::Undo, drag: *drag }),
        EditOp::Redo(Redo { drag }) => Some(Way { turn: Turn::Redo, drag: *drag }),
        _ => None,
    }
}

fn to_edit(op: &EditOp, path: &str, assets: &Assets, allowed: Allowed) -> ApiResult<Edit> {
    Ok(match op {
        EditOp::Insert(insert) => {
            finite(path, "transform", &insert.transform)?;
            check_name(allowed, &insert.name, &join(path, "name"))?;
            let asset = skies::model(&insert.asset, &join(path, "asset"), assets)?;
            Edit::Insert { asset, name: insert.name.clone(), transform: dmat4(&insert.transform) }
        }
        EditOp::Remove(remove) => Edit::Remove { objects: objects(&remove.objects, path)? },
        EditOp::Hide(hide) => Edit::Hide { objects: objects(&hide.objects, path)? },
        EditOp::Show(show) => Edit::Show { objects: objects(&show.objects, path)? },
        EditOp::Undo(_) | EditOp::Redo(_) => return Err(invalid(path, "op", "stands alone in its request")),
        EditOp::Move(place) => {
            finite(path, "transform", &place.transform)?;
            Edit::Move { object: place.object.clone(), transform: dmat4(&place.transform) }
        }
        EditOp::Material(paint) => repaint(paint, path)?,
        EditOp::Relight(relight) => edit_lights::relight(relight, path, allowed)?,
        EditOp::InsertLight(new) => edit_lights::insert(new, path, allowed)?,
        EditOp::Sky(sky) => skies::edit(sky, path, assets, allowed)?,
        EditOp::RemoveLight(remove) => Edit::RemoveLight { light: remove.light.clone() },
        EditOp::MoveLight(place) => edit_lights::move_one(place, path)?,
        EditOp::GroupLights(group) => edit_lights::group(group, path, allowed)?,
    })
}

fn invalid(path: &str, field: &str, reason: &str) -> Problem {
    Problem::field(Kind::InvalidValue, join(path, field), reason)
}

/// JSON has no infinity, but numbers that a field is too small for.
pub(super) fn finite(path: &str, field: &str, values: &[f64]) -> ApiResult<()> {
    match values.iter().all(|value| value.is_finite()) {
        true => Ok(()),
        false => Err(invalid(path, field, "has to be finite")),
    }
}

fn objects(names: &[String], path: &str) -> ApiResult<Vec<String>> {
    match names.is_empty() {
        true => Err(invalid(path, "objects", "names no object")),
        false => Ok(names.to_vec()),
    }
}

fn repaint(paint: &Repaint, path: &str) -> ApiResult<Edit> {
    finite(path, "albedo", &paint.albedo.map(f64::from))?;
    if !paint.albedo.iter().all(|a| (0.0..=1.0).contains(a)) {
        return Err(invalid(path, "albedo", "each has to be 0 to 1"));
    }
    let albedo = vec3(paint.albedo);
    match (&paint.object, &paint.material) {
        (_, Some(material)) if material.is_empty() => {
            let reason = "is empty: materials without a name are painted with their object";
            Err(invalid(path, "material", reason))
        }
        (None, None) => Err(invalid(path, "object", "neither it nor `material` is given")),
        (object, material) if paint.texture == Some(PaintedTexture::Multiply) => {
            Ok(Edit::Tint { object: object.clone(), material: material.clone(), factor: albedo })
        }
        (object, Some(material)) => {
            Ok(Edit::NamedMaterial { object: object.clone(), material: material.clone(), albedo })
        }
        (Some(object), None) => Ok(Edit::Material { object: object.clone(), albedo }),
    }
}
