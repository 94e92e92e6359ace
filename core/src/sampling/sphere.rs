//! Directions over the whole sphere.

use std::f32::consts::{FRAC_1_PI, TAU};

use glam::Vec3;

/// A unit direction, uniform over the sphere.
#[inline]
pub fn uniform_sphere([u, v]: [f32; 2]) -> Vec3 {
    let z = 1.0 - 2.0 * u;
    // 1 − z² without cancellation.
    let radius = 2.0 * (u * (1.0 - u)).max(0.0).sqrt();
    let (sin, cos) = (TAU * v).sin_cos();
    Vec3::new(radius * cos, radius * sin, z)
}

/// Density of [`uniform_sphere`] per steradian.
#[inline]
pub fn uniform_sphere_pdf() -> f32 {
    0.25 * FRAC_1_PI
}
