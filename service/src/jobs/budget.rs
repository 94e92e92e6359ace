//! When a job stops, how large its rounds are so that it ends on time, and how far it is: pure functions.

use serde::{Deserialize, Serialize};

use crate::engine::Progress;

/// When a job stops; the first bound that is reached ends it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct JobBudget {
    pub(crate) samples_per_element: u32,
    pub(crate) max_seconds: Option<f64>,
    pub(crate) target_rmse: Option<f32>,
    /// An edit's noise is not to be seen beside that of the map it began with ([`Progress::needed`]): nobody asked for more.
    #[serde(default)]
    pub(crate) by_error: bool,
}

impl JobBudget {
    /// A budget that is used up when both are.
    pub(crate) fn both(self, other: JobBudget) -> JobBudget {
        JobBudget {
            samples_per_element: self.samples_per_element.max(other.samples_per_element),
            max_seconds: self.max_seconds.zip(other.max_seconds).map(|(a, b)| a.max(b)),
            target_rmse: self.target_rmse.zip(other.target_rmse).map(|(a, b)| a.min(b)),
            by_error: self.by_error && other.by_error,
        }
    }

    /// See [`Progress::needed`]: where that ends the job.
    fn needed(&self, progress: &Progress) -> Option<f64> {
        progress.needed.filter(|_| self.by_error).map(f64::from)
    }
}

/// Samples of the next round, where so many are proposed: as many as the job's error needs. None end it.
pub(super) fn round_samples(budget: &JobBudget, so_far: &Progress, proposed: u32) -> u32 {
    /// A round costs something by itself: part of the samples so far that it has at least.
    const LEAST: u32 = 4;
    let done = so_far.samples_per_element;
    match budget.needed(so_far) {
        None => proposed,
        Some(needed) if needed <= 1.0 => 0,
        // `as` saturates.
        Some(needed) => proposed.min(((f64::from(done) * (needed - 1.0)).ceil() as u32).max(done / LEAST).max(1)),
    }
}

/// Decides how large a round may be so that a job ends on time.
///
/// A round costs something by itself and something per sample; two rounds of different size tell both. The first
/// round is a single sample, because nothing is known before it. A job does at least that one: without it there is
/// nothing to show for the time.
#[derive(Debug, Default)]
pub(super) struct Pace {
    /// The round that runs: when it began, and its samples.
    running: Option<(f64, u32)>,
    /// The round before the last one: its seconds and samples.
    measured: Option<(f64, u32)>,
}

impl Pace {
    const FIRST_ROUND: u32 = 1;

    pub(super) fn plan(&mut self, now_secs: f64, max_seconds: f64, proposed: u32) -> u32 {
        let samples = match self.running {
            None => proposed.min(Pace::FIRST_ROUND),
            Some((started_secs, samples)) => {
                let last = (now_secs - started_secs, samples);
                let (secs_per_round, secs_per_sample) = speed(last, self.measured);
                self.measured = Some(last);
                // `as` saturates: where there is no room left this is 0.
                proposed.min(((max_seconds - now_secs - secs_per_round) / secs_per_sample) as u32)
            }
        };
        self.running = Some((now_secs, samples));
        samples
    }
}

/// Seconds per round and, on top, per sample, by the last round and the one before: seconds and samples of each.
pub(super) fn speed((secs, samples): (f64, u32), before: Option<(f64, u32)>) -> (f64, f64) {
    const SHORTEST: f64 = 1e-9;
    let all_per_sample = (secs / f64::from(samples.max(1))).max(SHORTEST);
    match before {
        Some((before_secs, before)) if before < samples => {
            let per_sample = (secs - before_secs) / f64::from(samples - before);
            // Noise can make larger rounds look free or rounds themselves cheaper than nothing.
            let per_sample = per_sample.clamp(0.25 * all_per_sample, all_per_sample).max(SHORTEST);
            (secs - per_sample * f64::from(samples), per_sample)
        }
        _ => (0.0, all_per_sample),
    }
}

/// How much of the budget is used: the bound that is nearest to its end counts.
pub(super) fn fraction(budget: &JobBudget, progress: &Progress, elapsed_secs: f64) -> f64 {
    // A round that is finished counts among the samples already.
    let part = if progress.round_fraction < 1.0 { f64::from(progress.round_fraction.max(0.0)) } else { 0.0 };
    let running = f64::from(progress.round_samples) * part;
    let samples = (f64::from(progress.samples_per_element) + running) / f64::from(budget.samples_per_element.max(1));
    let time = budget.max_seconds.map_or(0.0, |max| elapsed_secs / max.max(1e-9));
    // The error falls with the root of the samples.
    let error = match (budget.target_rmse, progress.estimated_rmse) {
        (Some(target), Some(now)) if now > 0.0 => f64::from(target / now).powi(2),
        _ => 0.0,
    };
    let needed = budget.needed(progress).map_or(0.0, |needed| 1.0 / needed.max(1.0));
    let fraction = samples.max(time).max(error).max(needed);
    if fraction.is_finite() { fraction.clamp(0.0, 1.0) } else { 0.0 }
}

/// Samples per element at which the stated error is likely to be what is asked for: it falls with their root.
pub(super) fn samples_wanted(budget: &JobBudget, progress: &Progress) -> f64 {
    if let Some(needed) = budget.needed(progress) {
        return f64::from(progress.samples_per_element) * needed;
    }
    match (budget.target_rmse, progress.estimated_rmse) {
        (Some(target), Some(now)) if now.is_finite() && target > 0.0 => {
            f64::from(progress.samples_per_element) * f64::from(now / target).powi(2)
        }
        _ => f64::INFINITY,
    }
}

/// Milliseconds to the end: what is measured of the work, or what is left of its time where that is less.
pub(super) fn remaining_ms(budget: &JobBudget, measured_secs: Option<f64>, elapsed_secs: f64) -> Option<u64> {
    let left = budget.max_seconds.map(|max| (max - elapsed_secs).max(0.0));
    let secs = match (measured_secs, left) {
        (Some(measured), Some(left)) => Some(measured.min(left)),
        (measured, left) => measured.or(left),
    };
    secs.map(|secs| (secs * 1e3) as u64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::Progress;

    /// A job of doubling rounds at a constant speed with a fixed cost per round: when does it end?
    fn ends_at(max_seconds: f64, secs_per_sample: f64, secs_per_round: f64) -> f64 {
        let (mut pace, mut now, mut done) = (Pace::default(), 0.0, 0u32);
        loop {
            let samples = pace.plan(now, max_seconds, done.max(4));
            if samples == 0 {
                return now;
            }
            now += secs_per_round + f64::from(samples) * secs_per_sample;
            done += samples;
        }
    }

    #[test]
    fn time_budgets_are_met() {
        for max in [1.0, 5.0, 60.0] {
            for rate in [0.0005, 0.001, 0.01, 0.05] {
                for fixed in [0.0, 0.5, 4.0] {
                    let end = ends_at(max, rate, rate * fixed);
                    assert!(end <= max * 1.05, "{end} s of {max} s at {rate} s per sample, {fixed} samples per round");
                    assert!(end >= max * 0.6, "{end} s of {max} s at {rate} s per sample, {fixed} samples per round");
                }
            }
        }
    }

    #[test]
    fn at_least_one_round_is_done() {
        assert_eq!(ends_at(0.01, 3.0, 1.0), 4.0);
    }

    fn half_a_round(samples: u32) -> Progress {
        let begun = Progress::at_once(rebake_core::Pass::Direct, samples, None);
        Progress { round_samples: samples, round_fraction: 0.5, ..begun }
    }

    #[test]
    fn an_edit_goes_on_for_as_long_as_its_noise_is_seen() {
        let budget = JobBudget { samples_per_element: 64, max_seconds: None, target_rmse: None, by_error: true };
        let explicit = JobBudget { by_error: false, ..budget };
        let at = |needed| Progress { needed, ..half_a_round(8) };
        assert_eq!(round_samples(&budget, &at(None), 8), 8, "nothing is known");
        assert_eq!(round_samples(&budget, &at(Some(0.9)), 8), 0);
        assert_eq!(round_samples(&budget, &at(Some(1.01)), 8), 2, "a quarter at least");
        assert_eq!(round_samples(&budget, &at(Some(1.6)), 8), 5);
        assert_eq!(round_samples(&budget, &at(Some(f32::INFINITY)), 8), 8);
        assert_eq!(round_samples(&explicit, &at(Some(0.1)), 8), 8, "what was asked for is done");
        assert_eq!(samples_wanted(&budget, &at(Some(1.5))), 12.0);
        assert_eq!(fraction(&budget, &at(Some(1.25)), 0.0), 0.8);
        assert_eq!(fraction(&explicit, &at(Some(1.25)), 0.0), 12.0 / 64.0);
        assert_eq!((budget.both(budget), budget.both(explicit)), (budget, explicit));
    }

    #[test]
    fn the_nearest_bound_counts() {
        let budget =
            JobBudget { samples_per_element: 100, max_seconds: Some(10.0), target_rmse: Some(0.1), by_error: false };
        let mut progress = half_a_round(10);
        assert_eq!(fraction(&budget, &progress, 1.0), 0.15);
        assert_eq!(fraction(&budget, &progress, 5.0), 0.5);
        progress.estimated_rmse = Some(0.125);
        assert!((fraction(&budget, &progress, 1.0) - 0.64).abs() < 1e-6);
        progress.estimated_rmse = Some(f32::NAN);
        assert_eq!(fraction(&budget, &progress, 1.0), 0.15);
    }
}
