//! Samples in independent batches: the scatter of the batches is the error of their mean.

use glam::Vec3;

/// Batches that samples are taken in.
pub(crate) const BATCHES: usize = 8;

/// How many samples each batch takes of so many; of fewer than there are batches, the last take none.
#[inline]
pub(crate) fn shares(samples: u32) -> [u32; BATCHES] {
    std::array::from_fn(|k| samples / BATCHES as u32 + u32::from((k as u32) < samples % BATCHES as u32))
}

/// Mean of independent batches (samples, their mean), by their samples, and the standard error that their scatter
/// tells, mean over RGB. Batches without samples do not count; of a single one the error is infinite.
pub(crate) fn mean_of(batches: &[(u32, Vec3)]) -> (Vec3, f32) {
    let taken = batches.iter().filter(|(count, _)| *count > 0).count();
    let samples: u32 = batches.iter().map(|(count, _)| count).sum();
    let mean = batches.iter().map(|(count, value)| *value * *count as f32).sum::<Vec3>() / samples as f32;
    if taken < 2 {
        return (mean, f32::INFINITY);
    }
    let squares: f32 =
        batches.iter().map(|(count, value)| *count as f32 * (*value - mean).length_squared() / 3.0).sum();
    (mean, (squares / ((taken - 1) as f32 * samples as f32)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Pcg32;

    #[test]
    fn all_samples_are_shared_out() {
        assert_eq!(shares(21), [3, 3, 3, 3, 3, 2, 2, 2]);
        assert_eq!(shares(2), [1, 1, 0, 0, 0, 0, 0, 0]);
    }

    /// Over many means of uniforms, the stated error is the one that they have.
    #[test]
    fn the_error_is_that_of_the_mean() {
        for samples in [2, 5, 40] {
            let mut rng = Pcg32::new(4, u64::from(samples));
            let mut batch = |count: u32| {
                let sum: f32 = (0..count).map(|_| rng.next_f32()).sum();
                (count, Vec3::splat(if count > 0 { sum / count as f32 } else { 0.0 }))
            };
            let (mut squares, mut stated) = (0.0, 0.0);
            const MEANS: u32 = 20_000;
            for _ in 0..MEANS {
                let (mean, error) = mean_of(&shares(samples).map(&mut batch));
                squares += f64::from(mean.x - 0.5).powi(2);
                stated += f64::from(error).powi(2);
            }
            let exact = 1.0 / 12.0 / f64::from(samples) * f64::from(MEANS);
            assert!((squares / exact - 1.0).abs() < 0.06 && (stated / exact - 1.0).abs() < 0.06, "{squares} {stated}");
        }
        assert_eq!(mean_of(&[(3, Vec3::ONE), (0, Vec3::ZERO)]), (Vec3::ONE, f32::INFINITY));
    }
}
