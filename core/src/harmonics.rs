//! Real spherical harmonics up to the second band: what probes and directional light maps hold.
//!
//! The basis is orthonormal over the sphere, without the Condon-Shortley phase, in the axes of the scene (+y is up).
//! Its order and signs are those of `SphericalHarmonics3` of three.js, and the order of Unity's `SphericalHarmonicsL2`:
//! 1, *y*, *z*, *x*, *xy*, *yz*, 3*z*² − 1, *xz*, *x*² − *y*².

use std::ops::{Add, AddAssign, Div, Mul, Sub};

use glam::Vec3;

/// Coefficients of the bands 0, 1 and 2.
pub const COEFFICIENTS: usize = 9;

/// What the cosine leaves of each band, over π: a coefficient of radiance times this is one of irradiance / π
/// (Ramamoorthi and Hanrahan 2001).
pub const COSINE: [f32; 3] = [1.0, 2.0 / 3.0, 0.25];

/// The band of each coefficient.
const BANDS: [usize; COEFFICIENTS] = [0, 1, 1, 1, 2, 2, 2, 2, 2];

/// The basis functions in a unit direction.
#[inline]
pub fn basis(Vec3 { x, y, z }: Vec3) -> [f32; COEFFICIENTS] {
    // √(1/4π), √(3/4π), √(15/4π), √(5/16π), √(15/16π)
    const C: [f32; 5] = [0.282_094_8, 0.488_602_51, 1.092_548_4, 0.315_391_57, 0.546_274_24];
    [
        C[0],
        C[1] * y,
        C[1] * z,
        C[1] * x,
        C[2] * x * y,
        C[2] * y * z,
        C[3] * (3.0 * z * z - 1.0),
        C[2] * x * z,
        C[4] * (x * x - y * y),
    ]
}

/// A function over directions by its coefficients, linear RGB: of radiance, W/(m² sr) or whatever the scene's unit is,
/// times steradians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Harmonics(pub [Vec3; COEFFICIENTS]);

impl Harmonics {
    /// Of radiance × solid angle that comes from a unit direction.
    #[inline]
    pub fn of(direction: Vec3, power: Vec3) -> Harmonics {
        Harmonics(basis(direction).map(|y| power * y))
    }

    /// The function itself in a unit direction; of radiance it may be negative where that varies fast.
    pub fn at(&self, direction: Vec3) -> Vec3 {
        basis(direction).iter().zip(&self.0).map(|(y, c)| *c * *y).sum()
    }

    /// irradiance / π on a small surface with unit normal `n`, where the coefficients are those of radiance: what a
    /// light map holds, as far as two bands tell it.
    pub fn irradiance(&self, n: Vec3) -> Vec3 {
        let convolved = |(band, c): (&usize, &Vec3)| *c * COSINE[*band];
        let mut coefficients = [Vec3::ZERO; COEFFICIENTS];
        coefficients.iter_mut().zip(BANDS.iter().zip(&self.0).map(convolved)).for_each(|(to, from)| *to = from);
        Harmonics(coefficients).at(n)
    }

    fn zip(self, other: Harmonics, f: impl Fn(Vec3, Vec3) -> Vec3) -> Harmonics {
        Harmonics(std::array::from_fn(|k| f(self.0[k], other.0[k])))
    }
}

impl Add for Harmonics {
    type Output = Harmonics;
    fn add(self, other: Harmonics) -> Harmonics {
        self.zip(other, |a, b| a + b)
    }
}

impl AddAssign for Harmonics {
    #[inline]
    fn add_assign(&mut self, other: Harmonics) {
        self.0.iter_mut().zip(other.0).for_each(|(a, b)| *a += b);
    }
}

impl Sub for Harmonics {
    type Output = Harmonics;
    fn sub(self, other: Harmonics) -> Harmonics {
        self.zip(other, |a, b| a - b)
    }
}

impl Mul<f32> for Harmonics {
    type Output = Harmonics;
    fn mul(self, factor: f32) -> Harmonics {
        Harmonics(self.0.map(|c| c * factor))
    }
}

impl Div<f32> for Harmonics {
    type Output = Harmonics;
    fn div(self, divisor: f32) -> Harmonics {
        Harmonics(self.0.map(|c| c / divisor))
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::PI;

    use super::*;
    use crate::sampling::uniform_sphere;

    /// Sums over a fine grid of directions: exact up to its step.
    fn over_the_sphere(f: impl Fn(Vec3) -> f64) -> f64 {
        const STEPS: usize = 400;
        let at = |k: usize| (k as f32 + 0.5) / STEPS as f32;
        let places = (0..STEPS * STEPS).map(|k| uniform_sphere([at(k / STEPS), at(k % STEPS)]));
        places.map(f).sum::<f64>() * 4.0 * std::f64::consts::PI / (STEPS * STEPS) as f64
    }

    #[test]
    fn the_basis_is_orthonormal() {
        for i in 0..COEFFICIENTS {
            for j in i..COEFFICIENTS {
                let product = over_the_sphere(|d| f64::from(basis(d)[i]) * f64::from(basis(d)[j]));
                assert!((product - f64::from(u8::from(i == j))).abs() < 1e-4, "{i} {j}: {product}");
            }
        }
    }

    /// Of a function of two bands the irradiance is exact.
    #[test]
    fn irradiance_is_the_integral_with_the_cosine() {
        let mut radiance = Harmonics::default();
        radiance.0.iter_mut().zip(1u8..).for_each(|(c, k)| *c = Vec3::splat(f32::from(k) - 4.5));
        for n in [Vec3::X, Vec3::Y, -Vec3::Z, Vec3::new(0.48, -0.6, 0.64)] {
            let cosine = |d: Vec3| f64::from(radiance.at(d).x) * f64::from(n.dot(d).max(0.0)) / std::f64::consts::PI;
            let (found, expected) = (f64::from(radiance.irradiance(n).x), over_the_sphere(cosine));
            assert!((found - expected).abs() < 1e-3, "{n}: {found} {expected}");
        }
    }

    /// As three.js evaluates them (`SphericalHarmonics3.getAt` and `getIrradianceAt`, which answers π times as much).
    #[test]
    fn order_and_signs_are_those_of_three_js() {
        let d = Vec3::new(0.48, -0.6, 0.64);
        let Vec3 { x, y, z } = d;
        let light =
            Harmonics(std::array::from_fn(|k| Vec3::splat([0.7, -0.2, 0.4, 0.3, -0.6, 0.1, 0.9, -0.5, 0.8][k])));
        let c = light.0.map(|c| c.x);
        let at = 0.282095 * c[0]
            + 0.488603 * (y * c[1] + z * c[2] + x * c[3])
            + 1.092548 * (x * y * c[4] + y * z * c[5] + x * z * c[7])
            + 0.315392 * (3.0 * z * z - 1.0) * c[6]
            + 0.546274 * (x * x - y * y) * c[8];
        let irradiance = 0.886227 * c[0]
            + 2.0 * 0.511664 * (y * c[1] + z * c[2] + x * c[3])
            + 2.0 * 0.429043 * (x * y * c[4] + y * z * c[5] + x * z * c[7])
            + (0.743125 * z * z - 0.247708) * c[6]
            + 0.429043 * (x * x - y * y) * c[8];
        assert!((light.at(d).x - at).abs() < 1e-5 && (light.irradiance(d).x - irradiance / PI).abs() < 1e-5);
    }
}
