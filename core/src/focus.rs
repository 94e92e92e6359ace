//! What somebody looks at: brought up to date first.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::bvh::Ray;
use crate::world::World;

/// A view of a scene. World space, metres; angles in radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Focus {
    /// What a camera sees.
    Camera {
        /// Where it stands.
        eye: DVec3,
        /// A point it looks at.
        target: DVec3,
        /// Upward, roughly.
        up: DVec3,
        /// Vertical field of view.
        fov_y: f32,
        /// Width ÷ height of the picture.
        aspect: f32,
    },
    /// What lies in a sphere.
    Sphere {
        /// Its middle.
        point: DVec3,
        /// Its radius.
        radius: f32,
    },
}

impl Focus {
    /// Per element slot: whether it is looked at. From a camera those are the elements inside the picture's frame that
    /// face it and are not hidden, and what is looked up between them: a little is added at the rim.
    pub(crate) fn covers(&self, world: &World) -> Vec<bool> {
        let origin = world.scene.origin;
        let test: Box<dyn Fn(usize) -> bool + Sync> = match *self {
            Focus::Sphere { point, radius } => {
                let (point, reach) = ((point - origin).as_vec3(), radius + world.spacing());
                Box::new(move |i| world.positions()[i].distance_squared(point) <= reach * reach)
            }
            Focus::Camera { eye, target, up, fov_y, aspect } => {
                let forward = (target - eye).normalize_or(DVec3::NEG_Z);
                let right = forward.cross(up).normalize_or(forward.any_orthonormal_vector());
                let (up, eye) = (right.cross(forward).as_vec3(), (eye - origin).as_vec3());
                let (forward, right) = (forward.as_vec3(), right.as_vec3());
                let tan = (0.5 * fov_y).tan();
                Box::new(move |i| is_seen(world, i, eye, [right / (tan * aspect), up / tan, forward]))
            }
        };
        (0..world.slots()).into_par_iter().with_min_len(256).map(|i| world.areas()[i] > 0.0 && test(i)).collect()
    }
}

/// Part of the frame's half size that counts beyond its edge.
const RIM: f32 = 1.05;

fn is_seen(world: &World, slot: usize, eye: Vec3, [right, up, forward]: [Vec3; 3]) -> bool {
    let (from, n) = world.ray_origin(slot);
    let to_eye = eye - from;
    let depth = -to_eye.dot(forward);
    let inside = |axis: Vec3| to_eye.dot(axis).abs() <= RIM * depth;
    if depth <= 0.0 || !inside(right) || !inside(up) || n.dot(to_eye) <= 0.0 {
        return false;
    }
    let lift = n * world.lift();
    !world.trees.any_hit(&Ray { origin: from + lift, direction: to_eye - lift, t_min: 0.0, t_max: 1.0 })
}
