//! Directions over a hemisphere, by the cosine to its axis.

use std::f32::consts::{FRAC_1_PI, TAU};

use glam::Vec3;

use super::basis;

/// A direction around unit `n` with density cos θ / π per steradian (Malley).
#[inline]
pub fn cosine_hemisphere(n: Vec3, [u, v]: [f32; 2]) -> Vec3 {
    let (s, t) = basis(n);
    let radius = u.sqrt();
    let (sin, cos) = (TAU * v).sin_cos();
    s * (radius * cos) + t * (radius * sin) + n * (1.0 - u).max(0.0).sqrt()
}

/// Density of [`cosine_hemisphere`] per steradian.
#[inline]
pub fn cosine_hemisphere_pdf(n: Vec3, direction: Vec3) -> f32 {
    n.dot(direction).max(0.0) * FRAC_1_PI
}
