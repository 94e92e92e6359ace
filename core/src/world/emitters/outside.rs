//! Light from outside as transport samples it: the sky, its bright places, and the sun.

use std::f32::consts::{FRAC_1_PI, PI, TAU};
use std::sync::Arc;

use glam::Vec3;

use super::LightSample;
use crate::sampling::{Cone, cosine_hemisphere};
use crate::scene::SkyPicture;

/// A picture of the sky, turned about +y.
#[derive(Clone, Debug)]
pub(crate) struct TurnedSky {
    picture: Arc<SkyPicture>,
    /// Radians.
    rotation: f32,
    sin: f32,
    cos: f32,
}

impl TurnedSky {
    pub(super) fn new(picture: &Arc<SkyPicture>, rotation: f32) -> TurnedSky {
        let (sin, cos) = f64::from(rotation).sin_cos();
        TurnedSky { picture: Arc::clone(picture), rotation, sin: sin as f32, cos: cos as f32 }
    }

    /// Radiance that no direction brings much more of than others.
    #[inline]
    pub(super) fn even(&self, direction: Vec3) -> Vec3 {
        self.picture.even(self.in_picture(direction))
    }

    /// All radiance.
    #[inline]
    pub(super) fn radiance(&self, direction: Vec3) -> Vec3 {
        self.picture.radiance(self.in_picture(direction))
    }

    pub(super) fn has_bright_places(&self) -> bool {
        self.picture.bright_places().is_some()
    }

    /// ∫ radiance dΩ of the bright places, mean over RGB.
    #[inline]
    pub(in crate::world) fn bright_power(&self) -> f32 {
        self.picture.bright_places().map_or(0.0, |(_, power)| power)
    }

    /// A direction to a bright place, by brightness.
    #[inline]
    pub(super) fn sample_bright(&self, n: Vec3, u: [f32; 2]) -> Option<LightSample> {
        let (choice, _) = self.picture.bright_places()?;
        let there = choice.sample(u);
        let (direction, pdf) = (self.in_scene(there), choice.pdf(there));
        let cos = n.dot(direction);
        let tint = self.picture.bright(there);
        (cos > 0.0 && pdf > 0.0).then(|| LightSample { tint, ..from_afar(direction, cos * FRAC_1_PI / pdf) })
    }

    pub(super) fn same_as(&self, other: &TurnedSky) -> bool {
        self.rotation == other.rotation && self.picture == other.picture
    }

    #[inline]
    fn in_picture(&self, d: Vec3) -> Vec3 {
        Vec3::new(d.x * self.cos - d.z * self.sin, d.y, d.x * self.sin + d.z * self.cos)
    }

    #[inline]
    fn in_scene(&self, d: Vec3) -> Vec3 {
        Vec3::new(d.x * self.cos + d.z * self.sin, d.y, d.z * self.cos - d.x * self.sin)
    }
}

/// By the cosine: what is bright is left to other samples.
#[inline]
pub(super) fn sample_even(sky: Option<&TurnedSky>, n: Vec3, u: [f32; 2]) -> LightSample {
    let direction = cosine_hemisphere(n, u);
    let tint = sky.map_or(Vec3::ONE, |sky| sky.even(direction));
    LightSample { tint, ..from_afar(direction, 1.0) }
}

/// The directions towards a light that is as far away as the sun, and shines in unit `direction`; none where it has no
/// extent.
pub(super) fn disc(direction: Vec3, angle: f32) -> Option<Cone> {
    let sin = (0.25 * angle).sin();
    (angle > 0.0).then_some(Cone { axis: -direction, one_minus_cos: 2.0 * sin * sin })
}

/// Light of 1 lux on what faces it, over its disc where it has one.
#[inline]
pub(super) fn sample_directional(direction: Vec3, disc: Option<&Cone>, n: Vec3, u: [f32; 2]) -> Option<LightSample> {
    let Some(disc) = disc else {
        let cos = -n.dot(direction);
        return (cos > 0.0).then(|| from_afar(-direction, cos * FRAC_1_PI));
    };
    let towards = disc.sample(u);
    let cos = n.dot(towards);
    // Of radiance 1 / (π sin²) and density 1 / (2π (1 − cos)).
    let factor = TAU / (PI * (2.0 - disc.one_minus_cos));
    (cos > 0.0).then(|| from_afar(towards, cos * FRAC_1_PI * factor))
}

#[inline]
fn from_afar(direction: Vec3, weight: f32) -> LightSample {
    LightSample { direction, distance: f32::INFINITY, weight, tint: Vec3::ONE }
}
