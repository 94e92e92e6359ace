//! What an edit may ask for, and the errors that say what it may not.

use glam::{DMat4, DVec3, Vec3};

use crate::allowed::Allowed;
use crate::edit::{Edit, EditError, EditErrorKind};
use crate::scene::{Light, LightKind};

pub(super) fn error(field: &str, reason: impl Into<String>, kind: EditErrorKind) -> EditError {
    EditError { field: field.to_owned(), reason: reason.into(), kind }
}

pub(super) fn unknown(field: &str, what: &str, name: &str) -> EditError {
    error(field, format!("there is no {what} named {name:?}"), EditErrorKind::NotFound)
}

pub(super) fn invalid(field: &str, reason: &str) -> EditError {
    error(field, reason, EditErrorKind::Invalid)
}

/// Refuses what cannot be the transform of an object, or leads too far from `origin`, the zero of scene space.
pub(super) fn check_transform(allowed: Allowed, origin: DVec3, m: &DMat4) -> Result<(), EditError> {
    if !m.is_finite() {
        return Err(invalid("transform", "must hold 16 finite numbers"));
    }
    if (m.row(3) - glam::DVec4::W).abs().max_element() > 1e-6 {
        return Err(invalid("transform", "must be affine: its last row is not 0, 0, 0, 1 (16 numbers, column-major)"));
    }
    allowed.check_place(m.w_axis.truncate(), origin).map_err(|reason| invalid("transform", &reason))?;
    let axes = [m.x_axis, m.y_axis, m.z_axis];
    if axes.iter().any(|axis| axis.abs().max_element() > allowed.farthest) {
        return Err(invalid("transform", &format!("may enlarge by {:e} at most", allowed.farthest)));
    }
    let determinant = m.determinant().abs();
    let scale = m.x_axis.length() * m.y_axis.length() * m.z_axis.length();
    if determinant <= 1e-9 * scale || scale <= 0.0 {
        return Err(invalid("transform", "must be invertible"));
    }
    Ok(())
}

pub(super) fn check_strength(allowed: Allowed, color: Option<Vec3>, intensity: Option<f32>) -> Result<(), EditError> {
    allowed.check_strength(color, intensity).map_err(|error| invalid(error.field, &error.reason))
}

pub(super) fn check_name(allowed: Allowed, name: &str) -> Result<(), EditError> {
    allowed.check_name(name).map_err(|reason| invalid("name", &reason))
}

/// Refuses lights that are relit to more than is possible by colour and intensity together, one of which may be from
/// before. One that is gone by the end of the request is nobody's concern.
pub(super) fn check_relit(allowed: Allowed, edits: &[Edit], lights: &[Light]) -> Result<(), EditError> {
    for (i, edit) in edits.iter().enumerate() {
        let Edit::Relight { lights: relit } = edit else { continue };
        for (k, relight) in relit.iter().enumerate() {
            let Some(light) = lights.iter().find(|light| light.name == relight.light) else { continue };
            let field = if relight.intensity.is_some() { "intensity" } else { "color" };
            let told = |reason: String| invalid(&format!("edits[{i}].lights[{k}].{field}"), &reason);
            allowed.check_product(light.color, light.intensity).map_err(told)?;
        }
    }
    Ok(())
}

/// A disc covers less than half of the sky, radians.
const MAX_ANGLE: f32 = std::f32::consts::PI;

pub(super) fn check_kind(allowed: Allowed, origin: DVec3, kind: &LightKind) -> Result<(), EditError> {
    let place = match kind {
        LightKind::Point { position, .. } | LightKind::Spot { position, .. } => Some(*position),
        _ => None,
    };
    let far = |reason: String| invalid("light.position", &reason);
    place.map_or(Ok(()), |place| allowed.check_place(place, origin).map_err(far))?;
    match kind {
        LightKind::Directional { angle, .. } if !(0.0..MAX_ANGLE).contains(angle) => {
            return Err(invalid("light.angle", "must be at least 0 and below π"));
        }
        LightKind::Sky { rotation, .. } if !rotation.is_finite() => {
            return Err(invalid("light.rotation", "must be a finite number"));
        }
        _ => {}
    }
    match kind {
        LightKind::Spot { direction, .. } | LightKind::Directional { direction, .. } if !direction.is_normalized() => {
            Err(invalid("light.direction", "must be finite and not zero"))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::Relight;
    use crate::scene::{Material, Mesh, Object, Scene};
    use crate::world::{World, WorldOptions};

    fn world() -> World {
        let plate = Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Z);
        let scene = Scene::from_objects(vec![Object::new("plate", plate, Material::diffuse(Vec3::splat(0.5)))]);
        World::new(scene, &WorldOptions { spacing: Some(0.5), ..WorldOptions::default() }).expect("a world")
    }

    fn lamp(name: &str, color: f32, intensity: f32) -> Edit {
        let (name, color) = (name.to_owned(), Vec3::splat(color));
        Edit::InsertLight { name, kind: LightKind::Environment, color, intensity }
    }

    /// Edits that an earlier version has accepted are applied again, whatever bounds it had.
    #[test]
    fn what_was_accepted_once_is_applied_again() {
        let world = world();
        let long = "n".repeat(300);
        for (edit, field) in [
            (lamp("lamp", 1e5, 1e6), "edits[0].intensity"),
            (lamp(&long, 1.0, 1.0), "edits[0].name"),
            (lamp("a\u{7}", 1.0, 1.0), "edits[0].name"),
        ] {
            let edits = [edit];
            assert_eq!(world.apply(&edits).expect_err("too much now").field, field);
            assert_eq!(world.apply_again(&edits).expect("accepted once").after.scene.lights.len(), 1);
        }
        assert!(world.apply_again(&[lamp("lamp", f32::NAN, 1.0)]).is_err());
    }

    /// Colour and intensity may be given apart: together they are bounded all the same.
    #[test]
    fn lights_are_relit_to_what_they_may_have() {
        let relight = |color: Option<f32>, intensity| {
            let relight = Relight { light: "lamp".to_owned(), color: color.map(Vec3::splat), intensity };
            Edit::Relight { lights: vec![relight] }
        };
        let lit = world().apply(&[lamp("lamp", 1e5, 1.0)]).expect("a light").after;
        assert_eq!(
            lit.apply(&[relight(None, Some(1e5))]).expect_err("too bright").field,
            "edits[0].lights[0].intensity"
        );
        let both = [relight(None, Some(1e5)), relight(Some(1.0), None)];
        assert!(lit.apply(&both).is_ok(), "what counts is the end of the request");
        assert!(lit.apply_again(&both[..1]).is_ok());
    }
}
