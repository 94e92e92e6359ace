//! Light that arrives straight from a light.

use std::f32::consts::PI;

use glam::Vec3;

use super::{Emitter, Trees};

/// One sample of an emitter as it arrives: its weight as if nothing stood between, and what of unit strength arrives,
/// linear RGB, each 0 or more: the share that is sent out there and let through, in the colour of a picture.
#[inline]
pub fn arriving(
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

/// One sample of an emitter as it arrives at a point in space: the unit direction towards it, and radiance × solid angle,
/// divided by the density of the sample, linear RGB. None where it brings none.
#[inline]
pub(crate) fn arriving_in_space(
    emitter: &Emitter,
    trees: &Trees,
    point: Vec3,
    u: [f32; 2],
    rays: &mut u64,
) -> Option<(Vec3, Vec3)> {
    /// Samples are for one side of a surface: that of any plane which has the light. A skew one: few lights lie in it.
    const N: Vec3 = Vec3::new(0.577_215, 0.691_203, 0.431_237);
    arriving_on_side(emitter, trees, (point, N), u, rays)
        .or_else(|| arriving_on_side(emitter, trees, (point, -N), u, rays))
}

/// As [`arriving_in_space`], of light that comes to one side of a surface: that of `n`.
#[inline]
pub(crate) fn arriving_on_side(
    emitter: &Emitter,
    trees: &Trees,
    (point, n): (Vec3, Vec3),
    u: [f32; 2],
    rays: &mut u64,
) -> Option<(Vec3, Vec3)> {
    let sample = emitter.sample(point, n, u)?;
    *rays += 1;
    let left = trees.transmittance_between(point, sample.direction, sample.distance, sample.end(point));
    let power = emitter.strength * left * sample.tint * (sample.weight * PI / n.dot(sample.direction));
    Some((sample.direction, power))
}

/// Contribution to irradiance / π of one sample of an emitter, linear RGB; black where it is hidden.
#[inline]
pub fn visible_light(emitter: &Emitter, trees: &Trees, point: Vec3, n: Vec3, u: [f32; 2], rays: &mut u64) -> Vec3 {
    arriving(emitter, trees, point, n, u, rays).map_or(Vec3::ZERO, |(weight, left)| emitter.strength * left * weight)
}
