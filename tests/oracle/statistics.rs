//! Statistical comparison by replicates: an estimate is run with several seeds, its own scatter gives its error.

use glam::DVec3;
use rebake_core::{LightMap, World, metrics};

/// Mean over replicates and its standard error.
#[derive(Clone, Copy, Debug)]
pub(super) struct Estimate {
    pub(super) mean: f64,
    pub(super) error: f64,
}

/// Runs `f` with seeds `0..replicates`.
pub(super) fn replicate(replicates: u64, f: impl Fn(u64) -> f64) -> Estimate {
    let values: Vec<f64> = (0..replicates).map(f).collect();
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
    Estimate { mean, error: (variance / n).sqrt() }
}

/// Asserts that an estimate agrees with `truth` up to five standard errors and a known bias. With the eight to twelve
/// replicates used here five standard errors are passed by chance less than once in a thousand choices of seeds; seeds
/// are fixed, so a test that passes keeps passing.
pub(super) fn assert_agrees(name: &str, estimate: Estimate, truth: f64, bias: f64) {
    let difference = (estimate.mean - truth).abs();
    let allowed = 5.0 * estimate.error + bias + 1e-6 * truth.abs();
    assert!(
        difference <= allowed,
        "{name}: {:.6} ± {:.6} against {truth:.6} (known bias {bias:.6})",
        estimate.mean,
        estimate.error
    );
    // A test that could not tell 3 % would be no test.
    assert!(estimate.error <= 0.03 * truth.abs() + 1e-9, "{name}: standard error {:.6} of {truth:.6}", estimate.error);
}

/// Comparisons of estimates from a few replicates each that hold together ([`metrics::Family`]), each of which can tell
/// 3 %.
pub(super) struct Family {
    comparisons: metrics::Family,
    errors: Vec<f64>,
}

impl Family {
    /// Of estimates from so many replicates each.
    pub(super) fn of(replicates: u64) -> Family {
        Family { comparisons: metrics::Family::of_freedom((replicates - 1) as f64), errors: Vec::new() }
    }

    /// Notes an estimate, its truth and the bias that it may have.
    pub(super) fn compare(&mut self, name: impl Into<String>, estimate: Estimate, truth: f64, bias: f64) {
        let Estimate { mean, error } = estimate;
        let name = format!("{}: {mean:.6} against {truth}", name.into());
        self.comparisons.compare_within(name, mean - truth, error, bias);
        self.errors.push(error);
    }

    /// Asserts all of them, and that each could tell 3 %.
    pub(super) fn assert_agrees(self) {
        self.comparisons.assert_agrees();
        let worst = self.errors.into_iter().fold(0.0, f64::max);
        assert!(self.comparisons.critical() * worst <= 0.03, "a standard error is {worst}");
    }
}

/// Area-weighted mean over RGB and the valid elements that `which` picks.
pub(super) fn area_mean(world: &World, which: impl Fn(usize) -> bool, value: impl Fn(usize) -> DVec3) -> f64 {
    let (mut sum, mut area) = (0.0, 0.0);
    for slot in (0..world.slots()).filter(|&i| world.areas()[i] > 0.0 && world.is_valid(i) && which(i)) {
        let a = f64::from(world.areas()[slot]);
        sum += a * value(slot).element_sum() / 3.0;
        area += a;
    }
    sum / area
}

/// Area-weighted mean of direct + indirect.
pub(super) fn mean_total(world: &World, map: &LightMap) -> f64 {
    area_mean(world, |_| true, |i| map.total(i).as_dvec3())
}
