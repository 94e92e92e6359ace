//! Points on triangles and directions to them.

use glam::{DVec3, Vec3};

/// Barycentric weights of the second and third corner, uniform over the area (Heitz 2019).
#[inline]
pub fn uniform_barycentrics([u, v]: [f32; 2]) -> (f32, f32) {
    let (b0, b1) = if u < v { (u * 0.5, v - u * 0.5) } else { (u - v * 0.5, v * 0.5) };
    (b0, b1)
}

/// A triangle seen from a point, sampled uniformly in solid angle (Arvo 1995). In `f64`: its trigonometry cancels.
#[derive(Clone, Copy, Debug)]
pub struct SphericalTriangle {
    a: DVec3,
    b: DVec3,
    c: DVec3,
    alpha: f64,
    /// Solid angle, steradians.
    pub solid_angle: f64,
}

impl SphericalTriangle {
    /// The triangle `corners` seen from `point`; none where its solid angle is below 1e-6 sr or not to be had.
    pub fn new(point: Vec3, corners: [Vec3; 3]) -> Option<SphericalTriangle> {
        let [a, b, c] = corners.map(|p| (p - point).as_dvec3().try_normalize());
        let (a, b, c) = (a?, b?, c?);
        // Van Oosterom and Strackee 1983.
        let numerator = a.dot(b.cross(c)).abs();
        let denominator = 1.0 + a.dot(b) + b.dot(c) + c.dot(a);
        let solid_angle = 2.0 * numerator.atan2(denominator);
        if solid_angle < 1e-6 || !solid_angle.is_finite() {
            return None;
        }
        let normal_ab = a.cross(b).try_normalize()?;
        let normal_ca = c.cross(a).try_normalize()?;
        let alpha = (-normal_ab.dot(normal_ca)).clamp(-1.0, 1.0).acos();
        (alpha > 1e-7).then_some(SphericalTriangle { a, b, c, alpha, solid_angle })
    }

    /// A unit direction, uniform over the solid angle.
    pub fn sample(&self, [u, v]: [f32; 2]) -> Vec3 {
        let (a, b, c) = (self.a, self.b, self.c);
        let area = f64::from(u) * self.solid_angle;
        let (sin_alpha, cos_alpha) = self.alpha.sin_cos();
        let (s, t) = (area - self.alpha).sin_cos();
        let cos_side_c = a.dot(b);
        let p = t - cos_alpha;
        let q = s + sin_alpha * cos_side_c;
        let numerator = (q * t - p * s) * cos_alpha - q;
        let denominator = (q * s + p * t) * sin_alpha;
        let cos_b = if denominator.abs() < 1e-30 { 1.0 } else { (numerator / denominator).clamp(-1.0, 1.0) };
        let sin_b = (1.0 - cos_b * cos_b).max(0.0).sqrt();
        let c_prime = a * cos_b + (c - a * c.dot(a)).normalize_or_zero() * sin_b;
        let one_minus_z = f64::from(v) * (1.0 - c_prime.dot(b));
        let z = 1.0 - one_minus_z;
        let r = (one_minus_z * (1.0 + z)).max(0.0).sqrt();
        (b * z + (c_prime - b * c_prime.dot(b)).normalize_or_zero() * r).normalize_or(b).as_vec3()
    }

    /// Density of [`SphericalTriangle::sample`] per steradian.
    pub fn pdf(&self) -> f32 {
        (1.0 / self.solid_angle) as f32
    }
}
