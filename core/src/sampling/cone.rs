//! Directions towards a sphere, uniform in solid angle (Wang 1992).

use std::f32::consts::TAU;

use glam::Vec3;

use super::basis;

/// The cone of directions from a point to a sphere.
#[derive(Clone, Copy, Debug)]
pub struct Cone {
    /// Unit axis.
    pub axis: Vec3,
    /// 1 − cos θ_max, kept apart because it is tiny for distant spheres.
    pub one_minus_cos: f32,
}

impl Cone {
    /// The cone from `point` to a sphere; none where the point lies inside the sphere or on it.
    #[inline]
    pub fn to_sphere(point: Vec3, center: Vec3, radius: f32) -> Option<Cone> {
        let w = center - point;
        let distance2 = w.length_squared();
        let radius2 = radius * radius;
        if distance2 <= radius2 * 1.0002 {
            return None;
        }
        let sin2 = radius2 / distance2;
        // 1 − √(1 − s) without cancellation.
        let one_minus_cos = sin2 / (1.0 + (1.0 - sin2).sqrt());
        Some(Cone { axis: w / distance2.sqrt(), one_minus_cos })
    }

    /// Solid angle, steradians.
    #[inline]
    pub fn solid_angle(&self) -> f32 {
        TAU * self.one_minus_cos
    }

    /// A direction in the cone, uniform in solid angle.
    #[inline]
    pub fn sample(&self, [u, v]: [f32; 2]) -> Vec3 {
        let k = u * self.one_minus_cos;
        let sin = (k * (2.0 - k)).max(0.0).sqrt();
        let (s, t) = basis(self.axis);
        let (sin_phi, cos_phi) = (TAU * v).sin_cos();
        s * (sin * cos_phi) + t * (sin * sin_phi) + self.axis * (1.0 - k)
    }

    /// Density of [`Cone::sample`] per steradian.
    #[inline]
    pub fn pdf(&self, direction: Vec3) -> f32 {
        // |d − a|² / 2 = 1 − cos, exact where cos itself has lost its digits.
        let one_minus_cos = 0.5 * (direction - self.axis).length_squared();
        if one_minus_cos <= self.one_minus_cos * 1.000_01 { 1.0 / self.solid_angle() } else { 0.0 }
    }
}
