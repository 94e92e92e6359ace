//! Light that arrives straight from a light.

use glam::Vec3;

use super::{Emitter, Trees};

/// One sample of an emitter as it arrives: its weight as if nothing stood between, and what of unit strength arrives,
/// linear RGB, each 0 or more: the share that is sent out there and let through, in the colour of a picture.
#[inline]
pub(crate) fn arriving(
    emitter: &Emitter,
    trees: &Trees,
    point: Vec3,
    n: Vec3,
    u: [f32; 2],
    rays: &mut u64,
) -> Option<(f32, Vec3)> {
    let sample = emitter.sample(point, n, u)?;
    *rays += 1;
    let end = sample.end(point);
    let left = trees.transmittance_between(point, sample.direction, sample.distance, end);
    Some((sample.weight, left * sample.tint))
}

/// Contribution to irradiance / π of one sample of an emitter, linear RGB; black where it is hidden.
#[inline]
pub(crate) fn visible_light(
    emitter: &Emitter,
    trees: &Trees,
    point: Vec3,
    n: Vec3,
    u: [f32; 2],
    rays: &mut u64,
) -> Vec3 {
    arriving(emitter, trees, point, n, u, rays).map_or(Vec3::ZERO, |(weight, left)| emitter.strength * left * weight)
}
