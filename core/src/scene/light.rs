//! Lights: a closed set of kinds, matched where light is sampled.

use std::sync::Arc;

use glam::Vec3;

use super::{Scene, SkyPicture};

/// Name of the light from outside.
pub const ENVIRONMENT: &str = "environment";

/// A light with a name. Its strength is `color × intensity` in the unit of its kind.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// Unique name within the scene: that of its glTF node, or [`ENVIRONMENT`].
    pub name: String,
    /// Where it is and how it spreads.
    pub kind: LightKind,
    /// Linear RGB factor.
    pub color: Vec3,
    /// Scalar factor: radiance (emissive, environment), candela (point, spot), lux (directional), or a factor on a picture
    /// (sky). An emissive texture multiplies the radiance by place ([`super::Look::emissive`]).
    pub intensity: f32,
}

/// The kinds of light. Positions are in world space (metres).
#[derive(Clone, Debug, PartialEq)]
pub enum LightKind {
    /// The emissive triangles of an object: those of one of its materials.
    Emissive {
        /// Name of the object.
        object: String,
        /// Index into that object's materials.
        material: u32,
    },
    /// `KHR_lights_punctual` point: intensity in candela.
    Point {
        /// World-space position.
        position: glam::DVec3,
        /// Light ends here (metres), where the file says so: the specification's window is applied.
        range: Option<f32>,
    },
    /// `KHR_lights_punctual` spot: candela, the specification's angular falloff.
    Spot {
        /// World-space position.
        position: glam::DVec3,
        /// Unit direction in which it shines.
        direction: Vec3,
        /// Full intensity up to this angle from `direction`, radians.
        inner_cone_angle: f32,
        /// No light beyond this angle, radians.
        outer_cone_angle: f32,
        /// Light ends here (metres), where the file says so.
        range: Option<f32>,
    },
    /// `KHR_lights_punctual` directional: lux on a surface that faces it.
    Directional {
        /// Unit direction in which it shines.
        direction: Vec3,
        /// Angle that its disc takes up seen from the scene, radians, below π; 0 casts hard shadows.
        angle: f32,
    },
    /// Constant radiance from outside.
    Environment,
    /// Radiance from outside, by direction.
    Sky {
        /// What is seen of it where it is not turned.
        picture: Arc<SkyPicture>,
        /// By how much it is turned about +y, counter-clockwise seen from above, radians.
        rotation: f32,
    },
}

impl LightKind {
    /// Whether it shines from all around, from beyond everything.
    pub fn is_from_outside(&self) -> bool {
        matches!(self, LightKind::Environment | LightKind::Sky { .. })
    }
}

impl Light {
    /// `color × intensity`.
    pub fn strength(&self) -> Vec3 {
        self.color * self.intensity
    }
}

impl Scene {
    /// Takes the intensities of point and spot lights for the power, in watts, that they would send out into all directions
    /// together, as Blender has them: what they send into a steradian is 1 / 4π of it, also within the cone of a spot.
    /// Directional lights (W/m²) and emissive surfaces (W/(m² sr)) stay as they are.
    pub fn lamps_in_watts(&mut self) {
        for light in &mut self.lights {
            if matches!(light.kind, LightKind::Point { .. } | LightKind::Spot { .. }) {
                light.intensity = (f64::from(light.intensity) / (4.0 * std::f64::consts::PI)) as f32;
            }
        }
    }
}
