//! Statistical comparison by replicates: an estimate is run with several seeds, its own scatter gives its error.

use glam::DVec3;
use rebake_core::{LightMap, World};

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

/// Comparisons that hold together: by chance alone one of all of them fails for less than one in a thousand choices of
/// seeds. Each is held to a quantile of Student's t-distribution, since errors are those of few replicates, at its share
/// of that thousandth (Bonferroni).
pub(super) struct Family {
    replicates: u64,
    comparisons: Vec<Comparison>,
}

struct Comparison {
    name: String,
    estimate: Estimate,
    truth: f64,
    bias: f64,
}

impl Family {
    /// Of estimates from so many replicates each.
    pub(super) fn of(replicates: u64) -> Family {
        Family { replicates, comparisons: Vec::new() }
    }

    /// Notes an estimate, its truth and the bias that it may have.
    pub(super) fn compare(&mut self, name: impl Into<String>, estimate: Estimate, truth: f64, bias: f64) {
        self.comparisons.push(Comparison { name: name.into(), estimate, truth, bias });
    }

    /// Asserts all of them, and that each could tell 3 %.
    pub(super) fn assert_agrees(self) {
        let level = 1e-3 / self.comparisons.len() as f64;
        let critical = t_quantile(level, (self.replicates - 1) as f64);
        let mut failed = String::new();
        for Comparison { name, estimate: Estimate { mean, error }, truth, bias } in &self.comparisons {
            let is_off = (mean - truth).abs() > critical * error + bias;
            let is_blunt = critical * error > 0.03;
            if is_off || is_blunt {
                failed += &format!("\n{name}: {mean:.6} ± {error:.6} against {truth} (bias {bias}, t {critical:.2})");
            }
        }
        assert!(failed.is_empty(), "{failed}");
    }
}

/// What the absolute value of Student's t passes with probability `p`.
fn t_quantile(p: f64, freedom: f64) -> f64 {
    // With t = √ν tan θ the density is cosine to the power of ν − 1: no tail to cut.
    let mass = |from: f64| -> f64 {
        const STEPS: u32 = 20_000;
        let width = (std::f64::consts::FRAC_PI_2 - from) / f64::from(STEPS);
        (0..STEPS).map(|k| (from + (f64::from(k) + 0.5) * width).cos().powf(freedom - 1.0) * width).sum()
    };
    let (all, mut low, mut high) = (mass(0.0), 0.0, std::f64::consts::FRAC_PI_2);
    for _ in 0..60 {
        let middle = (low + high) / 2.0;
        if mass(middle) / all > p { low = middle } else { high = middle }
    }
    freedom.sqrt() * low.tan()
}

#[test]
fn quantiles_are_those_of_the_tables() {
    for (p, freedom, expected) in [(0.05, 1.0, 12.706), (0.01, 5.0, 4.032), (0.001, 7.0, 5.408), (0.001, 3.0, 12.924)] {
        let found = t_quantile(p, freedom);
        assert!((found - expected).abs() < 2e-3, "{p} at {freedom}: {found}");
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
