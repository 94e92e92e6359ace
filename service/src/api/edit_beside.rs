//! What an edit request carries beside its edits, in the terms of jobs and the engine: when to stop, what to light first
//! and in which steps.

use glam::DVec3;

use super::edit_types::{Budget, CameraRef, Focus, TileMode, Tiles};
use super::misread::join;
use super::problem::{ApiResult, Kind, Problem};
use super::types::dvec3;
use crate::config::Config;
use crate::engine::{self, World};
use crate::jobs::budget::JobBudget;

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
    let samples_per_element = samples_per_element.unwrap_or(open_ended);
    Ok(JobBudget { samples_per_element, max_seconds, target_rmse, by_error: false })
}

/// The budget of an edit: where the request sets no bound, its noise does.
pub(crate) fn to_edit_budget(budget: Option<Budget>, config: &Config) -> ApiResult<JobBudget> {
    let by_error = budget.is_none_or(|budget| budget == Budget::default());
    let budget = to_budget(budget, "budget", config.defaults.edit_samples, config)?;
    Ok(JobBudget { by_error, ..budget })
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
