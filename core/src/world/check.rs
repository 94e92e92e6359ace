//! What an edit may ask for, and the errors that say what it may not.

use glam::{DMat4, Vec3};

use crate::edit::{EditError, EditErrorKind};
use crate::scene::LightKind;

pub(super) fn error(field: &str, reason: impl Into<String>, kind: EditErrorKind) -> EditError {
    EditError { field: field.to_owned(), reason: reason.into(), kind }
}

pub(super) fn unknown(field: &str, what: &str, name: &str) -> EditError {
    error(field, format!("there is no {what} named {name:?}"), EditErrorKind::NotFound)
}

pub(super) fn invalid(field: &str, reason: &str) -> EditError {
    error(field, reason, EditErrorKind::Invalid)
}

pub(super) fn check_transform(m: &DMat4) -> Result<(), EditError> {
    if !m.is_finite() {
        return Err(invalid("transform", "must hold 16 finite numbers"));
    }
    if (m.row(3) - glam::DVec4::W).abs().max_element() > 1e-6 {
        return Err(invalid("transform", "must be affine: its last row is not 0, 0, 0, 1 (16 numbers, column-major)"));
    }
    let determinant = m.determinant().abs();
    let scale = m.x_axis.length() * m.y_axis.length() * m.z_axis.length();
    if determinant <= 1e-9 * scale || scale <= 0.0 {
        return Err(invalid("transform", "must be invertible"));
    }
    Ok(())
}

pub(super) fn check_strength(color: Option<Vec3>, intensity: Option<f32>) -> Result<(), EditError> {
    if color.is_some_and(|c| !c.is_finite() || c.cmplt(Vec3::ZERO).any()) {
        return Err(invalid("color", "must hold three finite numbers of at least 0"));
    }
    if intensity.is_some_and(|i| !i.is_finite() || i < 0.0) {
        return Err(invalid("intensity", "must be a finite number of at least 0"));
    }
    let strength = color.unwrap_or(Vec3::ONE) * intensity.unwrap_or(1.0);
    if strength.max_element() > 1e12 {
        return Err(invalid("intensity", "colour times intensity must not pass 1e12"));
    }
    Ok(())
}

/// A disc covers less than half of the sky, radians.
const MAX_ANGLE: f32 = std::f32::consts::PI;

pub(super) fn check_kind(kind: &LightKind) -> Result<(), EditError> {
    match kind {
        LightKind::Directional { angle, .. } if !(0.0..MAX_ANGLE).contains(angle) => {
            return Err(invalid("light.angle", "must be at least 0 and below π"));
        }
        LightKind::Sky { rotation, .. } if !rotation.is_finite() => {
            return Err(invalid("light.rotation", "must be a finite number"));
        }
        _ => {}
    }
    let finite = match kind {
        LightKind::Point { position, .. } => position.is_finite(),
        LightKind::Spot { position, direction, .. } => position.is_finite() && direction.is_normalized(),
        LightKind::Directional { direction, .. } => direction.is_normalized(),
        LightKind::Environment | LightKind::Sky { .. } | LightKind::Emissive { .. } => true,
    };
    if finite {
        Ok(())
    } else {
        Err(invalid("light", "position and direction must be finite, and the direction not zero"))
    }
}
