//! How far two pictures or light maps are apart, and estimates from what they should be.

mod family;
mod flip;

pub use family::{Family, t_quantile};
pub use flip::{PIXELS_PER_DEGREE, flip};

use glam::Vec3;

/// Root of the mean squared difference over all pixels and channels; 0 for none.
///
/// # Panics
/// Where the lists differ in length.
pub fn rmse(a: &[Vec3], b: &[Vec3]) -> f64 {
    assert_eq!(a.len(), b.len(), "what is compared has to have the same size");
    let sum: f64 = a.iter().zip(b).map(|(a, b)| (a.as_dvec3() - b.as_dvec3()).length_squared()).sum();
    (sum / (3 * a.len().max(1)) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rmse_is_the_root_of_the_mean_square() {
        assert_eq!(rmse(&[], &[]), 0.0);
        let (a, b) = ([Vec3::ZERO, Vec3::ONE], [Vec3::new(3.0, 0.0, 0.0), Vec3::new(1.0, 5.0, 1.0)]);
        assert!((rmse(&a, &b) - (25.0f64 / 6.0).sqrt()).abs() < 1e-12);
        assert_eq!(rmse(&a, &a), 0.0);
    }
}
