//! How far a light map is from the truth: path tracing of a random part of its elements, its own noise taken out.

use std::time::Instant;

use glam::Vec3;
use rebake_core::{Unobserved, World};

use crate::path::path_trace;

/// Elements that are path traced.
const SUBSET: usize = 1200;
/// Seconds that one reference may take.
const SECONDS: f64 = 5.0;
/// Samples of the run that tells how fast path tracing is here.
const TRIAL_SAMPLES: u32 = 32;

/// A light map compared with path tracing of the same scene.
#[derive(Clone, Copy, Debug)]
pub struct Comparison {
    /// Area-weighted mean squared error, the reference's noise taken out.
    mse: f64,
    /// Standard error of `mse`: the reference has few elements and noise of its own.
    uncertainty: f64,
    /// The reference's own RMSE.
    pub noise: f64,
    /// Samples per element of the reference.
    pub samples: u32,
    /// Elements compared.
    pub elements: usize,
    /// Seconds that path tracing takes for the whole light map at the reference's noise.
    reference_seconds: f64,
}

impl Comparison {
    /// The RMSE and its standard error; none where it cannot be told from zero, and [`Comparison::bound`] is what is
    /// known.
    pub fn rmse(&self) -> Option<(f64, f64)> {
        let rmse = self.mse.sqrt();
        self.is_told().then(|| (rmse, self.uncertainty / (2.0 * rmse)))
    }

    /// What the RMSE lies below where it cannot be told from zero, else the RMSE.
    pub fn bound(&self) -> f64 {
        self.mse_for_time().sqrt()
    }

    /// Seconds of path tracing from scratch to the same RMSE, by its law: the error falls with the root of the time.
    /// A lower bound where the RMSE is an upper one.
    pub fn path_seconds(&self) -> f64 {
        self.reference_seconds * self.noise * self.noise / self.mse_for_time()
    }

    /// Whether the error stands out from the uncertainty of its measurement.
    pub fn is_told(&self) -> bool {
        self.mse > 2.0 * self.uncertainty
    }

    fn mse_for_time(&self) -> f64 {
        if self.is_told() { self.mse } else { self.mse.max(0.0) + 2.0 * self.uncertainty }
    }
}

/// Compares `map` (irradiance / π per slot, linear RGB) with path tracing of `world` on the current rayon pool.
///
/// # Errors
/// A map that has not the slots of the world.
pub fn compare(world: &World, map: &[Vec3], seed: u64) -> anyhow::Result<Comparison> {
    anyhow::ensure!(map.len() == world.slots(), "the map has {} slots, the world {}", map.len(), world.slots());
    let live: Vec<u32> = (0..world.slots() as u32)
        .filter(|&slot| world.areas()[slot as usize] > 0.0 && world.is_valid(slot as usize))
        .collect();
    let elements = choose(&live, SUBSET, seed);
    let trial = Instant::now();
    path_trace(world, &elements, TRIAL_SAMPLES, seed, &Unobserved)?;
    let per_sample = trial.elapsed().as_secs_f64() / f64::from(TRIAL_SAMPLES);
    // Path tracing takes its samples in sixteens.
    let samples = ((SECONDS / per_sample) as u32).clamp(TRIAL_SAMPLES, 1 << 16).next_multiple_of(16);
    let start = Instant::now();
    let (reference, _rays) = path_trace(world, &elements, samples, seed ^ 0x5bd1_e995, &Unobserved)?;
    let seconds = start.elapsed().as_secs_f64();

    let compared = elements.iter().zip(&reference).map(|(&slot, truth)| Compared {
        area: f64::from(world.areas()[slot as usize]),
        squared: (map[slot as usize] - (truth.direct + truth.indirect)).as_dvec3().length_squared() / 3.0,
        variance: truth.total_variance.as_dvec3().element_sum() / 3.0,
    });
    let compared: Vec<Compared> = compared.collect();
    let (mse, uncertainty) = mean_squared_error(&compared);
    let area: f64 = compared.iter().map(|c| c.area).sum();
    Ok(Comparison {
        mse,
        uncertainty,
        noise: (compared.iter().map(|c| c.area * c.variance).sum::<f64>() / area).sqrt(),
        samples,
        elements: elements.len(),
        reference_seconds: seconds * live.len() as f64 / elements.len().max(1) as f64,
    })
}

/// One element of the map beside its reference.
#[derive(Clone, Copy, Debug)]
struct Compared {
    area: f64,
    /// Squared distance, mean over RGB.
    squared: f64,
    /// Variance of the reference's value, mean over RGB.
    variance: f64,
}

/// Area-weighted mean of the squared error without the reference's variance, and its standard error.
fn mean_squared_error(compared: &[Compared]) -> (f64, f64) {
    let n = compared.len() as f64;
    let mean_area = compared.iter().map(|c| c.area).sum::<f64>() / n;
    let terms = || compared.iter().map(|c| c.area / mean_area * (c.squared - c.variance));
    let mse = terms().sum::<f64>() / n;
    // The terms of a weighted mean vary about weight × mean, not about the mean.
    let scatter: f64 = terms().zip(compared).map(|(x, c)| (x - c.area / mean_area * mse).powi(2)).sum();
    (mse, (scatter / (n * (n - 1.0))).sqrt())
}

/// `count` random entries of `all`, in their order there: one of each of `count` equal stretches.
fn choose(all: &[u32], count: usize, seed: u64) -> Vec<u32> {
    if all.len() <= count {
        return all.to_vec();
    }
    let begin = |i: usize| i * all.len() / count;
    let within = |i: usize| (unit(seed.wrapping_add(i as u64)) * (begin(i + 1) - begin(i)) as f64) as usize;
    (0..count).map(|i| all[begin(i) + within(i)]).collect()
}

/// SplitMix64, as a number in 0..1.
fn unit(x: u64) -> f64 {
    let mut z = x.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_choice_is_spread_and_without_repetition() {
        let all: Vec<u32> = (0..10_000).collect();
        let chosen = choose(&all, 1500, 7);
        assert_eq!(chosen.len(), 1500);
        assert!(chosen.windows(2).all(|pair| pair[0] < pair[1]));
        assert!(chosen[0] < 7 && *chosen.last().unwrap() > 9_992);
        assert_ne!(chosen, choose(&all, 1500, 8));
        assert_eq!(choose(&all[..3], 1500, 7), [0, 1, 2]);
    }

    #[test]
    fn path_tracing_needs_four_times_as_long_for_half_the_error() {
        let at = |mse, uncertainty| Comparison {
            mse,
            uncertainty,
            noise: 0.02,
            samples: 1,
            elements: 1,
            reference_seconds: 10.0,
        };
        assert!((at(0.02f64.powi(2), 0.0).path_seconds() - 10.0).abs() < 1e-9);
        assert!((at(0.01f64.powi(2), 0.0).path_seconds() - 40.0).abs() < 1e-9);
        let (rmse, its_error) = at(1e-4, 1e-5).rmse().expect("it stands out");
        assert!((rmse - 0.01).abs() < 1e-12 && (its_error - 5e-4).abs() < 1e-12);
        // An error that cannot be told from zero is bounded: so is the time.
        let unclear = at(-1e-6, 0.5e-4);
        assert!(unclear.rmse().is_none() && (unclear.bound() - 0.01).abs() < 1e-12);
        assert!((unclear.path_seconds() - 40.0).abs() < 1e-9);
    }

    #[test]
    fn the_noise_of_the_reference_is_taken_out() {
        // True error 0.1 or −0.1, reference noise ±0.2, areas 1 and 3: all combinations once.
        let mut compared = Vec::new();
        for area in [1.0, 3.0] {
            for error in [-0.1, 0.1] {
                for noise in [-0.2, 0.2] {
                    compared.push(Compared { area, squared: (error - noise) * (error - noise), variance: 0.04 });
                }
            }
        }
        let (mse, uncertainty) = mean_squared_error(&compared);
        assert!((mse - 0.01).abs() < 1e-12, "{mse}");
        assert!(uncertainty > 0.0 && uncertainty < 0.03, "{uncertainty}");
    }
}
