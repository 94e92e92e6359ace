//! Lights and transforms that move.

use glam::{DMat4, DVec3, Vec3};

use super::check::invalid;
use crate::edit::EditError;
use crate::scene::{Light, LightKind};

pub(super) fn move_light(kind: &mut LightKind, to: Option<DVec3>, turn: Option<Vec3>) -> Result<(), EditError> {
    if to.is_some_and(|p| !p.is_finite()) {
        return Err(invalid("position", "must hold three finite numbers"));
    }
    let turn = match turn.map(Vec3::try_normalize) {
        Some(None) => return Err(invalid("direction", "must be finite and not zero")),
        Some(Some(d)) => Some(d),
        None => None,
    };
    match kind {
        LightKind::Point { position, .. } => *position = to.ok_or_else(|| invalid("position", "is missing"))?,
        LightKind::Spot { position, direction, .. } => {
            if to.is_none() && turn.is_none() {
                return Err(invalid("position", "is missing"));
            }
            *position = to.unwrap_or(*position);
            *direction = turn.unwrap_or(*direction);
        }
        LightKind::Directional { direction } => {
            *direction = turn.ok_or_else(|| invalid("direction", "is missing: a directional light has no position"))?;
        }
        LightKind::Emissive { .. } => return Err(invalid("light", "is an emissive surface: move its object")),
        LightKind::Environment => return Err(invalid("light", "is the environment, which has no place")),
    }
    Ok(())
}

pub(super) fn transformed_light(mut light: Light, transform: &DMat4) -> Light {
    let turn = |d: Vec3| transform.transform_vector3(d.as_dvec3()).normalize_or(DVec3::NEG_Z).as_vec3();
    match &mut light.kind {
        LightKind::Point { position, .. } => *position = transform.transform_point3(*position),
        LightKind::Spot { position, direction, .. } => {
            *position = transform.transform_point3(*position);
            *direction = turn(*direction);
        }
        LightKind::Directional { direction } => *direction = turn(*direction),
        LightKind::Emissive { .. } | LightKind::Environment => {}
    }
    light
}

pub(super) fn is_rigid(m: &DMat4) -> bool {
    let l = glam::DMat3::from_mat4(*m);
    let error = l.transpose() * l - glam::DMat3::IDENTITY;
    let largest = error.to_cols_array().into_iter().map(f64::abs).fold(0.0, f64::max);
    largest < 1e-5 && l.determinant() > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rigid_motions_are_told_from_scalings_and_mirrors() {
        let turn = DMat4::from_rotation_y(0.7) * DMat4::from_translation(DVec3::new(1.0, 2.0, 3.0));
        assert!(is_rigid(&turn));
        assert!(!is_rigid(&DMat4::from_scale(DVec3::splat(1.01))));
        assert!(!is_rigid(&DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0))));
    }
}
