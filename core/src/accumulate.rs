//! Independent rounds of unequal size, averaged; their scatter is the variance of the average.

use glam::Vec3;
use rayon::prelude::*;

use crate::transport::Value;
use crate::world::Stated;

/// Weighted sums of rounds, per slot.
pub(crate) struct Accumulator<V> {
    direct: Vec<V>,
    indirect: Vec<V>,
    /// What each layer weighs in the whole.
    weights: Vec<Vec3>,
    /// What the variance is of.
    stated: Stated,
    /// Σ n |light|² of the whole, mean over RGB.
    squares: Vec<f64>,
    /// The same per layer, layers of a slot side by side; empty for one.
    layer_squares: Vec<f64>,
    samples: u32,
    rounds: u32,
    /// Σ over slots of the variance of the mean, as the last round and the mean of those before it tell it.
    last: f64,
    /// The same, as the scatter of all rounds tells it.
    scatter: f64,
}

/// Slots per partial sum: fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 4096;

impl<V: Value> Accumulator<V> {
    /// For `len` slots; `weights` has one of each layer.
    pub(crate) fn new(len: usize, weights: &[Vec3], stated: Stated) -> Accumulator<V> {
        let layers = if weights.len() > 1 { weights.len() } else { 0 };
        Accumulator {
            direct: vec![V::default(); len],
            indirect: vec![V::default(); len],
            weights: weights.to_vec(),
            stated,
            squares: vec![0.0; len],
            layer_squares: vec![0.0; len * layers],
            samples: 0,
            rounds: 0,
            last: 0.0,
            scatter: 0.0,
        }
    }

    /// Samples per element so far.
    pub(crate) fn samples(&self) -> u32 {
        self.samples
    }

    /// Adds a round of `samples` samples per element.
    pub(crate) fn add(&mut self, samples: u32, direct: &[V], indirect: &[V]) {
        let before = self.samples;
        self.samples += samples;
        self.rounds += 1;
        let scatter = Scatter { samples: self.samples, rounds: self.rounds };
        let (weights, layers, stated) = (&self.weights, self.weights.len(), self.stated);
        let mut layer_squares = self.layer_squares.chunks_mut(CHUNK * layers);
        let sums =
            self.direct.chunks_mut(CHUNK).zip(self.indirect.chunks_mut(CHUNK)).zip(self.squares.chunks_mut(CHUNK));
        let with_layers = |((d, i), q)| Sums {
            stated,
            direct: d,
            indirect: i,
            squares: q,
            layer_squares: layer_squares.next().unwrap_or_default(),
        };
        let sums: Vec<Sums<V>> = sums.map(with_layers).collect();
        let light = direct.par_chunks(CHUNK).zip(indirect.par_chunks(CHUNK));
        let add = |(mut sums, light): (Sums<V>, (&[V], &[V]))| sums.add(weights, (before, samples), light, scatter);
        let partials: Vec<(f64, f64)> = sums.into_par_iter().zip(light).map(add).collect();
        (self.last, self.scatter) = partials.into_iter().fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
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

    /// Variance of the mean of what is stated of the whole, mean over RGB: with rounds x_r of n_r samples and variance
    /// σ²/n_r, Σ n_r (x_r − x̄)² / (R − 1) estimates σ², and the mean has σ² / Σ n_r. Low-discrepancy samples do better
    /// than 1/n: the whole is scaled to what the last round and those before it, which weigh most, say.
    pub(crate) fn variance(&self) -> Vec<f32> {
        if !self.knows_variance() {
            return vec![0.0; self.squares.len()];
        }
        let (scale, scatter) = (self.scale(), self.of_rounds());
        let sums = self.direct.par_iter().zip(&self.indirect).zip(&self.squares).with_min_len(CHUNK);
        sums.map(|((d, i), q)| (scatter.of(*q, self.stated.of(*d, *i).weighted(&self.weights)) * scale) as f32)
            .collect()
    }

    /// The same of each layer, layers of a slot side by side; empty for one layer.
    pub(crate) fn layer_variance(&self) -> Vec<f32> {
        let mut variance = vec![0.0; self.layer_squares.len()];
        if !self.knows_variance() {
            return variance;
        }
        let (layers, scale, scatter) = (self.weights.len(), self.scale(), self.of_rounds());
        let sums = self.layer_squares.par_chunks(layers).zip(self.direct.par_iter().zip(&self.indirect));
        variance.par_chunks_mut(layers).zip(sums).with_min_len(CHUNK).for_each(|(variance, (squares, (d, i)))| {
            let total = self.stated.of(*d, *i);
            for (layer, (variance, square)) in variance.iter_mut().zip(squares).enumerate() {
                *variance = (scatter.of(*square, total.layer(layer)) * scale) as f32;
            }
        });
        variance
    }

    fn of_rounds(&self) -> Scatter {
        Scatter { samples: self.samples, rounds: self.rounds }
    }

    fn scale(&self) -> f64 {
        if self.scatter > 0.0 { (self.last / self.scatter).clamp(LEAST_SCALE, 1.0) } else { 1.0 }
    }
}

/// Variance of the mean of so many rounds and samples, from their scatter.
#[derive(Clone, Copy)]
struct Scatter {
    samples: u32,
    rounds: u32,
}

impl Scatter {
    fn of(self, squares: f64, sum: Vec3) -> f64 {
        let n = f64::from(self.samples);
        let mean2 = sum.as_dvec3().length_squared() / (3.0 * n);
        (squares - mean2).max(0.0) / (f64::from(self.rounds - 1) * n)
    }
}

/// Sums of some slots.
struct Sums<'a, V> {
    stated: Stated,
    direct: &'a mut [V],
    indirect: &'a mut [V],
    squares: &'a mut [f64],
    layer_squares: &'a mut [f64],
}

impl<V: Value> Sums<'_, V> {
    /// Adds light of a round of `samples` to that of `before` samples. Sums over the slots: the variance of the mean as
    /// this round and those before it tell it, and as the scatter of all rounds does. With the means a and b of n and m
    /// samples, (a − b)² n m / (n + m)² estimates the former. Both are zero for a first round.
    fn add(
        &mut self,
        weights: &[Vec3],
        (before, samples): (u32, u32),
        (direct, indirect): (&[V], &[V]),
        scatter: Scatter,
    ) -> (f64, f64) {
        let (n, m) = (f64::from(before), f64::from(samples));
        let square = |light: Vec3| m * light.as_dvec3().length_squared() / 3.0;
        let (mut last, mut scattered) = (0.0, 0.0);
        let layers = weights.len();
        for (k, (direct, indirect)) in direct.iter().zip(indirect).enumerate() {
            let (sum_direct, sum_indirect) = (&mut self.direct[k], &mut self.indirect[k]);
            let light = self.stated.of(*direct, *indirect);
            let whole = light.weighted(weights);
            if before > 0 {
                let mean = self.stated.of(*sum_direct, *sum_indirect).weighted(weights).as_dvec3() / n;
                last += (mean - whole.as_dvec3()).length_squared() / 3.0;
            }
            *sum_direct += *direct * samples as f32;
            *sum_indirect += *indirect * samples as f32;
            self.squares[k] += square(whole);
            if before > 0 {
                scattered += scatter.of(self.squares[k], self.stated.of(*sum_direct, *sum_indirect).weighted(weights));
            }
            let squares = self.layer_squares.iter_mut().skip(k * layers).take(layers);
            squares.enumerate().for_each(|(layer, sum)| *sum += square(light.layer(layer)));
        }
        (last * n * m / ((n + m) * (n + m)), scattered)
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
        let (mut acc, mut rng) = (Accumulator::new(len, &[Vec3::ONE], Stated::Full), Pcg32::new(1, 1));
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
