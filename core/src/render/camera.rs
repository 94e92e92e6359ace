//! From pixels to rays.

use glam::{DVec3, Vec3};

use crate::bvh::Ray;
use crate::scene::Camera;
use crate::world::World;

/// Where a picture is taken from. World space, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewpoint {
    eye: DVec3,
    forward: DVec3,
    right: DVec3,
    up: DVec3,
    fov_y: f32,
}

/// Why there is no picture from here.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field} {reason}")]
pub struct ViewpointError {
    /// `eye`, `target`, `up` or `fov_y`.
    pub field: &'static str,
    /// What is wrong with it.
    pub reason: &'static str,
}

impl Viewpoint {
    /// A camera at `eye` that looks at `target`; `up` is upward in the picture, roughly; `fov_y` is the vertical field
    /// of view in radians.
    ///
    /// # Errors
    /// Names the parameter that does not fit.
    pub fn new(eye: DVec3, target: DVec3, up: DVec3, fov_y: f32) -> Result<Viewpoint, ViewpointError> {
        let error = |field, reason| Err(ViewpointError { field, reason });
        for (field, value) in [("eye", eye), ("target", target), ("up", up)] {
            if !value.is_finite() {
                return error(field, "has to be finite");
            }
        }
        if !(fov_y > 0.0 && fov_y < std::f32::consts::PI) {
            return error("fov_y", "has to be above 0 and below π");
        }
        let Some(forward) = (target - eye).try_normalize() else {
            return error("target", "has to be away from the eye");
        };
        let Some(right) = up.try_normalize().and_then(|up| {
            let right = forward.cross(up);
            (right.length_squared() > 1e-12).then(|| right.normalize())
        }) else {
            return error("up", "has to point away from the line of sight");
        };
        Ok(Viewpoint { eye, forward, right, up: right.cross(forward), fov_y })
    }

    /// A camera of a scene.
    pub fn of_camera(camera: &Camera) -> Viewpoint {
        let axis = |v: DVec3| camera.world_from_camera.transform_vector3(v).normalize_or(v);
        Viewpoint {
            eye: camera.world_from_camera.transform_point3(DVec3::ZERO),
            forward: axis(DVec3::NEG_Z),
            right: axis(DVec3::X),
            up: axis(DVec3::Y),
            fov_y: camera.fov_y,
        }
    }

    /// A view of the whole scene from above one corner of its bounds, for scenes without a camera.
    pub fn overview(world: &World) -> Viewpoint {
        let bounds = world.objects().map(|o| o.bounds).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        let (low, high) = bounds.unwrap_or((DVec3::ZERO, DVec3::ONE));
        let (center, radius) = ((low + high) * 0.5, ((high - low).length() * 0.5).max(1e-6));
        let toward = DVec3::new(0.55, 0.6, 0.8).normalize();
        let fov_y = std::f32::consts::FRAC_PI_4;
        let eye = center + toward * (radius / f64::from(fov_y * 0.5).sin());
        let right = DVec3::Y.cross(toward).normalize();
        Viewpoint { eye, forward: -toward, right, up: toward.cross(right), fov_y }
    }
}

/// The camera rays of one picture, in scene space.
pub(super) struct Rays {
    origin: Vec3,
    /// Direction of the picture's top left corner, and the steps of one pixel.
    corner: Vec3,
    step_x: Vec3,
    step_y: Vec3,
}

impl Rays {
    pub(super) fn new(world: &World, viewpoint: &Viewpoint, width: usize, height: usize) -> Rays {
        let half_y = (f64::from(viewpoint.fov_y) * 0.5).tan();
        let half_x = half_y * width as f64 / height as f64;
        let corner = viewpoint.forward - viewpoint.right * half_x + viewpoint.up * half_y;
        Rays {
            // In f64 until here: a scene may lie far from the world's zero.
            origin: (viewpoint.eye - world.scene.origin).as_vec3(),
            corner: corner.as_vec3(),
            step_x: (viewpoint.right * (2.0 * half_x / width as f64)).as_vec3(),
            step_y: (viewpoint.up * (-2.0 * half_y / height as f64)).as_vec3(),
        }
    }

    /// Angle that a pixel in the middle takes up.
    pub(super) fn pixel(&self) -> f32 {
        self.step_y.length()
    }

    /// The ray through a point of a pixel; `[0.5, 0.5]` is its centre.
    pub(super) fn through(&self, x: usize, y: usize, [u, v]: [f32; 2]) -> Ray {
        let direction = self.corner + self.step_x * (x as f32 + u) + self.step_y * (y as f32 + v);
        Ray { origin: self.origin, direction: direction.normalize(), t_min: 0.0, t_max: f32::INFINITY }
    }
}
