//! Where an edit changes a scene.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;

use crate::scene::{Light, LightKind, Scene};
use crate::tiles::ChangedSphere;
use crate::world::{Placed, Transition, World};

/// Everything that came, went, moved, was repainted or shines differently and has a place. `brightest` is the largest
/// irradiance / π there was: no object hides or reflects more.
pub(super) fn places(transition: &Transition, brightest: f32) -> Vec<ChangedSphere> {
    let mut places: Vec<ChangedSphere> =
        transition.changed_bounds().into_iter().map(|bounds| place_of(bounds, brightest)).collect();
    let Transition { before, after, .. } = transition;
    let repaint = transition.repaint();
    for placed in &after.placed {
        let change = repaint[placed.placement.part_indices()]
            .iter()
            .map(|change| change.abs().max_element())
            .fold(0.0, f32::max);
        if change > 0.0 {
            places.push(place_of(placed.surface.bounds(), change * brightest));
        }
    }
    for light in &after.scene.lights {
        let old = light_of(&before.scene, &light.name);
        if old.is_none_or(|old| !shines_alike(old, light)) {
            places.extend(place_of_light(after, light));
        }
    }
    for light in &before.scene.lights {
        let new = light_of(&after.scene, &light.name);
        if new.is_none_or(|new| !shines_alike(light, new)) {
            places.extend(place_of_light(before, light));
        }
    }
    places
}

/// `radiance` is what may change at most on the object.
fn place_of((low, high): (Vec3, Vec3), radiance: f32) -> ChangedSphere {
    let radius = 0.5 * (high - low).length();
    ChangedSphere { middle: 0.5 * (low + high), radius, power: radiance * radius * radius }
}

fn light_of<'a>(scene: &'a Scene, name: &str) -> Option<&'a Light> {
    scene.lights.iter().find(|light| light.name == name)
}

fn shines_alike(a: &Light, b: &Light) -> bool {
    a.kind == b.kind && a.strength() == b.strength()
}

/// None where a light shines from afar.
fn place_of_light(world: &World, light: &Light) -> Option<ChangedSphere> {
    let strength = light.strength().max_element();
    match &light.kind {
        LightKind::Emissive { object, .. } => {
            let index = world.scene.objects.iter().position(|o| o.name == *object)?;
            world.placed.get(index).map(|placed: &std::sync::Arc<Placed>| place_of(placed.surface.bounds(), strength))
        }
        LightKind::Point { position, .. } | LightKind::Spot { position, .. } => {
            let middle = (*position - world.scene.origin).as_vec3();
            Some(ChangedSphere { middle, radius: world.spacing(), power: strength * FRAC_1_PI })
        }
        LightKind::Directional { .. } | LightKind::Environment | LightKind::Sky { .. } => None,
    }
}
