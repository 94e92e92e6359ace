//! Lights and transforms that move.

use glam::{DMat4, DVec3, Vec3};

use super::check::invalid;
use crate::edit::EditError;
use crate::scene::{Light, LightKind};

/// Moves a light to a place, which is checked already, or turns it into a direction of any length.
pub(super) fn move_light(kind: &mut LightKind, to: Option<DVec3>, turn: Option<Vec3>) -> Result<(), EditError> {
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
        LightKind::Directional { direction, .. } => {
            *direction = turn.ok_or_else(|| invalid("direction", "is missing: a directional light has no position"))?;
        }
        LightKind::Emissive { .. } => return Err(invalid("light", "is an emissive surface: move its object")),
        LightKind::Environment | LightKind::Sky { .. } => {
            return Err(invalid("light", "is the environment, which has no place"));
        }
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
        LightKind::Directional { direction, .. } => *direction = turn(*direction),
        LightKind::Emissive { .. } | LightKind::Environment | LightKind::Sky { .. } => {}
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
    use crate::edit::Edit;
    use crate::scene::{Material, Mesh, Object, Scene};
    use crate::world::{World, WorldOptions};

    /// A lamp of an inserted asset moves with it, rigidly or not, and goes with it; its name is then free again.
    #[test]
    fn lamps_follow_the_object_that_they_hang_on() {
        let quad = |name: &str| {
            Object::new(name, Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y), Material::diffuse(Vec3::splat(0.5)))
        };
        let bulb = Light {
            name: "bulb".into(),
            kind: LightKind::Point { position: DVec3::new(0.0, 1.0, 0.0), range: None },
            color: Vec3::ONE,
            intensity: 1.0,
        };
        let asset = std::sync::Arc::new(Scene::from_objects(vec![quad("shade")]).with_light(bulb.clone()));
        let world = World::new(Scene::from_objects(vec![quad("wall")]).with_light(bulb), &WorldOptions::default());
        let at = |x: f64| DMat4::from_translation(DVec3::new(x, 0.0, 5.0));
        let insert = Edit::Insert { asset, name: "lamp".into(), transform: at(1.0) };
        let world = world.unwrap().apply(std::slice::from_ref(&insert)).unwrap().after;
        let place = |world: &World| {
            let light = world.scene.lights.iter().find(|light| light.name == "lamp/bulb")?;
            if let LightKind::Point { position, .. } = light.kind { Some(position) } else { None }
        };
        assert_eq!(place(&world), Some(DVec3::new(1.0, 1.0, 5.0)));
        let moved = Edit::Move { object: "lamp".into(), transform: at(3.0) };
        let world = world.apply(&[moved]).unwrap().after;
        assert_eq!(place(&world), Some(DVec3::new(3.0, 1.0, 5.0)));
        let scaled = Edit::Move { object: "lamp".into(), transform: at(3.0) * DMat4::from_scale(DVec3::splat(2.0)) };
        let world = world.apply(&[scaled]).unwrap().after;
        assert_eq!(place(&world), Some(DVec3::new(3.0, 2.0, 5.0)));
        let world = world.apply(&[Edit::Remove { objects: vec!["lamp".into()] }]).unwrap().after;
        let names: Vec<&str> = world.scene.lights.iter().map(|light| light.name.as_str()).collect();
        assert_eq!(names, ["bulb"]);
        assert!(world.apply(&[insert]).is_ok());
    }

    /// A scene without objects is what some files are: lamps and furniture come by edits.
    #[test]
    fn an_empty_world_takes_its_first_object() {
        struct Quiet;
        impl crate::Observer for Quiet {}
        let floor = Object::new("floor", Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y), Material::diffuse(Vec3::splat(0.5)));
        let sun = Light {
            name: "sun".into(),
            kind: LightKind::Directional { direction: Vec3::NEG_Z, angle: 0.0 },
            color: Vec3::ONE,
            intensity: std::f32::consts::PI,
        };
        let asset = std::sync::Arc::new(Scene::from_objects(vec![floor]).with_light(sun));
        let empty = World::new(Scene::from_objects(Vec::new()), &WorldOptions::default()).unwrap();
        let budget = crate::Budget { samples_per_element: 8, target_rmse: None };
        let map = crate::bake(&empty, &budget, 1, &Quiet).unwrap();
        assert_eq!((map.len(), empty.slots()), (0, 0));
        let insert = Edit::Insert { asset, name: "lamp".into(), transform: DMat4::IDENTITY };
        let transition = empty.apply(&[insert]).unwrap();
        let lit = crate::update(&transition, &map, &budget, None, 1, &Quiet).unwrap();
        assert_eq!(lit.len(), transition.after.slots());
        let light = |slot: usize| (lit.total(slot) - Vec3::ONE).abs().max_element();
        assert!(transition.new_slots.iter().all(|&slot| light(slot as usize) < 1e-5), "{:?}", lit.total(0));
    }

    #[test]
    fn rigid_motions_are_told_from_scalings_and_mirrors() {
        let turn = DMat4::from_rotation_y(0.7) * DMat4::from_translation(DVec3::new(1.0, 2.0, 3.0));
        assert!(is_rigid(&turn));
        assert!(!is_rigid(&DMat4::from_scale(DVec3::splat(1.01))));
        assert!(!is_rigid(&DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0))));
    }
}
