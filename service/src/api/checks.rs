//! The engine's bounds on names and strengths, as problems that name the field.

use rebake_core::allowed::Allowed;

use super::misread::join;
use super::problem::{ApiResult, Kind, Problem};
use super::types::vec3;
use crate::engine::SHARED_LAYER;

/// A name for something new.
pub(super) fn check_name(allowed: Allowed, name: &str, field: &str) -> ApiResult<()> {
    allowed.check_name(name).map_err(|reason| Problem::field(Kind::InvalidValue, field, reason))
}

/// A name for a group of lights and their layer.
pub(super) fn check_group(allowed: Allowed, name: &str, field: &str) -> ApiResult<()> {
    check_name(allowed, name, field)?;
    if name == SHARED_LAYER {
        let reason = format!("{name:?} is the layer of the lights that are in no group");
        return Err(Problem::field(Kind::InvalidValue, field, reason));
    }
    Ok(())
}

/// Colour and intensity of a light that stands at `path`.
pub(super) fn check_strength(
    allowed: Allowed,
    color: Option<&[f32; 3]>,
    intensity: Option<f32>,
    path: &str,
) -> ApiResult<()> {
    let told = allowed.check_strength(color.copied().map(vec3), intensity);
    told.map_err(|error| Problem::field(Kind::InvalidValue, join(path, error.field), error.reason))
}
