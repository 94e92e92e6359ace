//! Independent rounds of unequal size, averaged; their scatter is the variance of the average.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::transport::Value;

/// Weighted sums of rounds, per slot.
pub(crate) struct Accumulator<V> {
    direct: Vec<V>,
    indirect: Vec<V>,
    /// What each layer weighs in the whole.
    weights: Vec<Vec3>,
    /// Σ n |direct + indirect|² of the whole, mean over RGB.
    squares: Vec<f64>,
    /// The same per layer, layers of a slot side by side; empty for one.
    layer_squares: Vec<f64>,
    samples: u32,
    rounds: u32,
    /// Σ over slots of the variance of the mean, as the last round and the mean of those before it tell it.
    last: f64,
}

/// Slots per partial sum: fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 4096;

impl<V: Value> Accumulator<V> {
    /// For `len` slots; `weights` has one of each layer.
    pub(crate) fn new(len: usize, weights: &[Vec3]) -> Accumulator<V> {
        let layers = if weights.len() > 1 { weights.len() } else { 0 };
        Accumulator {
            direct: vec![V::default(); len],
            indirect: vec![V::default(); len],
            weights: weights.to_vec(),
            squares: vec![0.0; len],
            layer_squares: vec![0.0; len * layers],
            samples: 0,
            rounds: 0,
            last: 0.0,
        }
    }

    /// Samples per element so far.
    pub(crate) fn samples(&self) -> u32 {
        self.samples
    }

    /// Adds a round of `samples` samples per element.
    pub(crate) fn add(&mut self, samples: u32, direct: &[V], indirect: &[V]) {
        let weight = samples as f32;
        if self.rounds > 0 {
            self.last = self.difference(samples, direct, indirect);
        }
        self.samples += samples;
        self.rounds += 1;
        let weights = &self.weights;
        let square = |light: Vec3| f64::from(samples) * light.as_dvec3().length_squared() / 3.0;
        let sums = self.direct.par_iter_mut().zip(&mut self.indirect).zip(&mut self.squares);
        sums.zip(direct.par_iter().zip(indirect)).with_min_len(CHUNK).for_each(|(((d, i), q), (direct, indirect))| {
            *d += *direct * weight;
            *i += *indirect * weight;
            *q += square((*direct + *indirect).weighted(weights));
        });
        let layers = weights.len();
        let squares = self.layer_squares.par_chunks_mut(layers).zip(direct.par_iter().zip(indirect));
        squares.with_min_len(CHUNK).for_each(|(squares, (direct, indirect))| {
            let total = *direct + *indirect;
            squares.iter_mut().enumerate().for_each(|(layer, q)| *q += square(total.layer(layer)));
        });
    }

    /// Mean of the direct part of all rounds.
    pub(crate) fn direct(&self) -> Vec<V> {
        self.direct.par_iter().with_min_len(CHUNK).map(|d| *d / self.samples as f32).collect()
    }

    /// Mean of the indirect part of all rounds.
    pub(crate) fn indirect(&self) -> Vec<V> {
        self.indirect.par_iter().with_min_len(CHUNK).map(|i| *i / self.samples as f32).collect()
    }

    /// Whether there are rounds enough to tell a variance.
    pub(crate) fn knows_variance(&self) -> bool {
        self.rounds >= 2
    }

    /// With the means a and b of n and m samples, (a − b)² n m / (n + m)² estimates the variance of the mean of all.
    fn difference(&self, samples: u32, direct: &[V], indirect: &[V]) -> f64 {
        let (n, m) = (f64::from(self.samples), f64::from(samples));
        let whole = |d: V, i: V| (d + i).weighted(&self.weights).as_dvec3();
        let square = |k: usize| {
            let before: DVec3 = whole(self.direct[k], self.indirect[k]) / n;
            (before - whole(direct[k], indirect[k])).length_squared() / 3.0
        };
        let len = self.direct.len();
        let of_chunk = |c: usize| (c * CHUNK..len.min((c + 1) * CHUNK)).map(square).sum::<f64>();
        let squares: Vec<f64> = (0..len.div_ceil(CHUNK)).into_par_iter().map(of_chunk).collect();
        squares.into_iter().sum::<f64>() * n * m / ((n + m) * (n + m))
    }

    /// Variance of the mean of direct + indirect of the whole, mean over RGB: with rounds x_r of n_r samples and variance
    /// σ²/n_r, Σ n_r (x_r − x̄)² / (R − 1) estimates σ², and the mean has σ² / Σ n_r. Low-discrepancy samples do better
    /// than 1/n: the whole is scaled to what the last round and those before it, which weigh most, say.
    pub(crate) fn variance(&self) -> Vec<f32> {
        if !self.knows_variance() {
            return vec![0.0; self.squares.len()];
        }
        let scatter = self.scatter();
        let scale = self.scale(&scatter);
        scatter.into_par_iter().with_min_len(CHUNK).map(|v| (v * scale) as f32).collect()
    }

    /// The same of each layer, layers of a slot side by side; empty for one layer.
    pub(crate) fn layer_variance(&self) -> Vec<f32> {
        if !self.knows_variance() {
            return vec![0.0; self.layer_squares.len()];
        }
        let (scale, layers) = (self.scale(&self.scatter()), self.weights.len());
        let of = |(k, q): (usize, &f64)| {
            let total = self.direct[k / layers] + self.indirect[k / layers];
            (self.scatter_of(*q, total.layer(k % layers)) * scale) as f32
        };
        self.layer_squares.par_iter().enumerate().with_min_len(CHUNK).map(of).collect()
    }

    fn scatter(&self) -> Vec<f64> {
        let sums = self.direct.par_iter().zip(&self.indirect).zip(&self.squares).with_min_len(CHUNK);
        sums.map(|((d, i), q)| self.scatter_of(*q, (*d + *i).weighted(&self.weights))).collect()
    }

    fn scatter_of(&self, squares: f64, sum: Vec3) -> f64 {
        let n = f64::from(self.samples);
        let mean2 = sum.as_dvec3().length_squared() / (3.0 * n);
        (squares - mean2).max(0.0) / (f64::from(self.rounds - 1) * n)
    }

    fn scale(&self, scatter: &[f64]) -> f64 {
        let total: f64 = scatter.iter().sum();
        if total > 0.0 { (self.last / total).clamp(LEAST_SCALE, 1.0) } else { 1.0 }
    }
}

/// Low-discrepancy samples are not trusted to do better than this.
const LEAST_SCALE: f64 = 0.05;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Pcg32;

    #[test]
    fn rounds_of_unequal_size_tell_the_variance_of_their_mean() {
        let len = 4000;
        let (mut acc, mut rng) = (Accumulator::new(len, &[Vec3::ONE]), Pcg32::new(1, 1));
        let mut mean = vec![0.0f64; len];
        let sizes = [2u32, 2, 4, 8, 16];
        for n in sizes {
            let values: Vec<Vec3> =
                (0..len).map(|_| Vec3::splat((0..n).map(|_| rng.next_f32()).sum::<f32>() / n as f32)).collect();
            mean.iter_mut().zip(&values).for_each(|(m, v)| *m += f64::from(v.x) * f64::from(n));
            acc.add(n, &values, &vec![Vec3::ZERO; len]);
        }
        let total = f64::from(acc.samples());
        let truth = mean.iter().map(|m| (m / total - 0.5).powi(2)).sum::<f64>() / len as f64;
        let stated = acc.variance().iter().map(|v| f64::from(*v)).sum::<f64>() / len as f64;
        // Both are means over 4,000 elements: relative standard deviations √(2/4000) and √(2/4/4000), seven of them.
        assert!((stated / truth - 1.0).abs() < 0.18, "{stated} {truth}");
    }
}
