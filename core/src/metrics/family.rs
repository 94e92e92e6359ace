//! Comparisons of estimates with what they should be, where chance has a say.

use std::f64::consts::FRAC_PI_2;
use std::fmt::Write;

/// Comparisons that hold together: by chance alone any of all of them fails for less than one in a thousand choices of
/// seeds. Each is held to a quantile of Student's t-distribution at its share of that thousandth (Bonferroni). What is
/// compared need not be independent.
#[derive(Clone, Debug)]
pub struct Family {
    freedom: f64,
    comparisons: Vec<Comparison>,
}

#[derive(Clone, Debug)]
struct Comparison {
    name: String,
    off: f64,
    error: f64,
    bias: f64,
}

impl Family {
    /// Of estimates whose standard errors are known, or told by so many samples that they as good as are.
    pub fn of_known_errors() -> Family {
        Family::of_freedom(f64::INFINITY)
    }

    /// Of estimates whose standard errors stem from their own scatter, of so many degrees of freedom: the samples of
    /// each, less one.
    pub fn of_freedom(freedom: f64) -> Family {
        Family { freedom, comparisons: Vec::new() }
    }

    /// Notes an estimate that is `off` from what it should be by so much, with its standard error.
    pub fn compare(&mut self, name: impl Into<String>, off: f64, error: f64) {
        self.compare_within(name, off, error, 0.0);
    }

    /// Notes an estimate that is `off` by so much, with its standard error, and may be by `bias` whatever chance does.
    pub fn compare_within(&mut self, name: impl Into<String>, off: f64, error: f64, bias: f64) {
        self.comparisons.push(Comparison { name: name.into(), off, error, bias });
    }

    /// How many standard errors each may be off, beside its bias.
    pub fn critical(&self) -> f64 {
        t_quantile(1e-3 / self.comparisons.len() as f64, self.freedom)
    }

    /// Asserts all comparisons.
    ///
    /// # Panics
    /// Where one is off by more than chance and its bias explain, with all that are; and where there is none.
    pub fn assert_agrees(&self) {
        assert!(!self.comparisons.is_empty(), "nothing was compared");
        let (critical, mut failed) = (self.critical(), String::new());
        for Comparison { name, off, error, bias } in &self.comparisons {
            let agrees = off.abs() <= critical * error + bias;
            if !agrees {
                let line = format!("{name}: off by {off:.6}, standard error {error:.6}, bias {bias:.6}");
                writeln!(failed, "{line}").expect("strings take everything");
            }
        }
        let count = self.comparisons.len();
        assert!(failed.is_empty(), "of {count}, each within {critical:.2} standard errors:\n{failed}");
    }
}

/// What the absolute value of Student's t passes with probability `p`, for so many degrees of freedom; infinitely many:
/// of a normal distribution.
pub fn t_quantile(p: f64, freedom: f64) -> f64 {
    // More than these change nothing that counts, and would need finer steps.
    let freedom = freedom.min(10_000.0);
    // With t = √ν tan θ the density is cosine to the power of ν − 1: no tail to cut.
    let mass = |from: f64| -> f64 {
        const STEPS: u32 = 20_000;
        let width = (FRAC_PI_2 - from) / f64::from(STEPS);
        (0..STEPS).map(|k| (from + (f64::from(k) + 0.5) * width).cos().powf(freedom - 1.0) * width).sum()
    };
    let (all, mut low, mut high) = (mass(0.0), 0.0, FRAC_PI_2);
    for _ in 0..60 {
        let middle = (low + high) / 2.0;
        if mass(middle) / all > p { low = middle } else { high = middle }
    }
    freedom.sqrt() * low.tan()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Pcg32;

    #[test]
    fn quantiles_are_those_of_the_tables() {
        for (p, freedom, expected) in [
            (0.05, 1.0, 12.706),
            (0.01, 5.0, 4.032),
            (0.001, 7.0, 5.408),
            (0.001, 3.0, 12.924),
            (0.001, f64::INFINITY, 3.2905),
            (1e-6, f64::INFINITY, 4.8916),
        ] {
            let found = t_quantile(p, freedom);
            assert!((found - expected).abs() < 5e-3, "{p} at {freedom}: {found}");
        }
    }

    /// Families of many agree as often as they should, and one that is wrong fails them.
    #[test]
    fn a_family_fails_by_one_that_is_off_and_hardly_by_chance() {
        let family = |seed: u64, off: f64| {
            let (mut rng, mut family) = (Pcg32::new(seed, 8), Family::of_known_errors());
            for k in 0..200 {
                // A sum of twelve uniform numbers of variance 1/12.
                let normal = f64::from((0..12).map(|_| rng.next_f32()).sum::<f32>()) - 6.0;
                family.compare_within(format!("{k}"), normal + if k == 77 { off } else { 0.0 }, 1.0, 0.1);
            }
            std::panic::catch_unwind(move || family.assert_agrees()).is_ok()
        };
        assert_eq!((0..50).filter(|seed| family(*seed, 0.0)).count(), 50);
        assert_eq!((0..50).filter(|seed| family(*seed, 9.0)).count(), 0);
        let mut family = Family::of_freedom(7.0);
        family.compare("one", 5.4, 1.0);
        family.assert_agrees();
        family.compare("two", f64::NAN, 1.0);
        assert!(
            std::panic::catch_unwind(move || family.assert_agrees()).is_err(),
            "what is no number agrees with nothing"
        );
        assert!(std::panic::catch_unwind(|| Family::of_known_errors().assert_agrees()).is_err());
    }
}
