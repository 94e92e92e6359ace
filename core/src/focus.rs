//! What somebody looks at: brought up to date first.

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use crate::bvh::Ray;
use crate::tiles::{ChangedSphere, nearest};
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
        let test: Box<dyn Fn(usize) -> bool + Sync> = match self.view(world.scene.origin) {
            View::Sphere { middle, radius } => {
                let reach = radius + world.spacing();
                Box::new(move |i| world.positions()[i].distance_squared(middle) <= reach * reach)
            }
            View::Camera { eye, frame } => Box::new(move |i| is_seen(world, i, eye, frame)),
        };
        (0..world.slots()).into_par_iter().with_min_len(256).map(|i| world.areas()[i] > 0.0 && test(i)).collect()
    }

    /// Per element slot how soon its turn comes, the less the sooner; infinite where nobody looks. From a camera it is
    /// the Chebyshev distance in the picture, in half heights, from the nearest of the places where something changed;
    /// from the picture's middle where there are none. In a sphere it is the distance from its middle in metres.
    pub(crate) fn keys(&self, world: &World, places: &[ChangedSphere]) -> Vec<f32> {
        let key: Box<dyn Fn(usize) -> f32 + Sync> = match self.view(world.scene.origin) {
            View::Sphere { middle, .. } => Box::new(move |i| world.positions()[i].distance(middle)),
            View::Camera { eye, frame } => {
                let mut seen_at: Vec<Vec2> = places.iter().map(|place| project(place.middle, eye, frame)).collect();
                if seen_at.is_empty() {
                    seen_at.push(Vec2::ZERO);
                }
                let aspect = frame[1].length() / frame[0].length();
                let distance = move |a: Vec2, b: Vec2| ((a - b) * Vec2::new(aspect, 1.0)).abs().max_element();
                Box::new(move |i| {
                    let here = project(world.positions()[i], eye, frame);
                    nearest(&seen_at, |there| distance(here, *there))
                })
            }
        };
        let covers = self.covers(world);
        let key = |(i, seen): (usize, bool)| if seen { key(i) } else { f32::INFINITY };
        covers.into_par_iter().enumerate().with_min_len(256).map(key).collect()
    }

    /// In scene space.
    fn view(&self, origin: DVec3) -> View {
        match *self {
            Focus::Sphere { point, radius } => View::Sphere { middle: (point - origin).as_vec3(), radius },
            Focus::Camera { eye, target, up, fov_y, aspect } => {
                let forward = (target - eye).normalize_or(DVec3::NEG_Z);
                let right = forward.cross(up).normalize_or(forward.any_orthonormal_vector());
                let (up, eye) = (right.cross(forward).as_vec3(), (eye - origin).as_vec3());
                let (forward, right) = (forward.as_vec3(), right.as_vec3());
                let tan = (0.5 * fov_y).tan();
                View::Camera { eye, frame: [right / (tan * aspect), up / tan, forward] }
            }
        }
    }
}

/// A focus in scene space.
enum View {
    Sphere {
        middle: Vec3,
        radius: f32,
    },
    Camera {
        eye: Vec3,
        /// Rightward, upward, forward, scaled so that the picture's edges are at ±1.
        frame: [Vec3; 3],
    },
}

/// Where a point is in the picture, whose edges are at ±1; what is behind the camera lies far out on its side.
fn project(point: Vec3, eye: Vec3, [right, up, forward]: [Vec3; 3]) -> Vec2 {
    const LEAST_DEPTH: f32 = 1e-3;
    let to = point - eye;
    let depth = to.dot(forward).max(LEAST_DEPTH * to.length()).max(f32::MIN_POSITIVE);
    Vec2::new(to.dot(right), to.dot(up)) / depth
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
    let lift = n * world.lift(from);
    !world.trees.any_hiding(&Ray { origin: from + lift, direction: to_eye - lift, t_min: 0.0, t_max: 1.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_where_the_picture_has_them() {
        let (eye, target) = (DVec3::new(11.0, 2.0, 5.0), DVec3::new(11.0, 2.0, 0.0));
        let fov_y = 2.0 * 0.5_f32.atan();
        let focus = Focus::Camera { eye, target, up: DVec3::Y, fov_y, aspect: 2.0 };
        let View::Camera { eye, frame } = focus.view(DVec3::new(10.0, 0.0, 0.0)) else { panic!("a camera") };
        let at = |x, y, z| project(Vec3::new(x, y, z), eye, frame);
        // Two metres ahead the picture is 2 m high and 4 m wide.
        for (point, seen) in [
            (at(1.0, 2.0, 3.0), Vec2::ZERO),
            (at(3.0, 2.0, 3.0), Vec2::X),
            (at(1.0, 1.0, 3.0), Vec2::NEG_Y),
            (at(0.0, 4.0, 1.0), Vec2::new(-0.25, 1.0)),
        ] {
            assert!(point.distance(seen) < 1e-6, "{point} {seen}");
        }
        let behind = at(1.5, 2.0, 6.0);
        assert!(behind.x > 100.0 && behind.y.abs() < 1e-3, "{behind} is far out on its side");
    }
}
