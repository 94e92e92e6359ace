//! Discrete distributions by inversion: keeps the stratification of the number it is given.

/// A distribution over `0..len` proportional to weights.
#[derive(Clone, Debug, Default)]
pub struct Discrete {
    /// Running sums of the weights divided by their total; the last is 1.
    cdf: Vec<f32>,
}

impl Discrete {
    /// A distribution proportional to `weights` (finite, ≥ 0); none where all are zero.
    pub fn new(weights: impl Iterator<Item = f64>) -> Option<Discrete> {
        let mut total = 0.0;
        let sums: Vec<f64> = weights
            .map(|w| {
                total += w;
                total
            })
            .collect();
        if total <= 0.0 || !total.is_finite() {
            return None;
        }
        let mut cdf: Vec<f32> = sums.iter().map(|s| (s / total) as f32).collect();
        // Everything behind the last positive weight must stay unreachable.
        let last = sums.iter().position(|s| *s == total).unwrap_or(sums.len() - 1);
        cdf[last..].fill(1.0);
        Some(Discrete { cdf })
    }

    /// An index, and `u` stretched to [0, 1) within its interval for further use.
    #[inline]
    pub fn sample(&self, u: f32) -> (usize, f32) {
        let index = self.cdf.partition_point(|c| *c <= u).min(self.cdf.len() - 1);
        let low = if index == 0 { 0.0 } else { self.cdf[index - 1] };
        let width = self.cdf[index] - low;
        (index, if width > 0.0 { ((u - low) / width).clamp(0.0, 0.999_999_94) } else { 0.0 })
    }

    /// Probability of `index`, as sampled.
    #[inline]
    pub fn pdf(&self, index: usize) -> f32 {
        self.cdf[index] - if index == 0 { 0.0 } else { self.cdf[index - 1] }
    }
}
