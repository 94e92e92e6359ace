//! Independent rounds of unequal size, averaged; their scatter is the variance of the average.

use glam::Vec3;
use rayon::prelude::*;

use crate::lightmap::LightValues;
use crate::scatter::{pooled_with_neighbours, scatter_of_neighbours};
use crate::value::{Scalars as _, Value};
use crate::world::{Stated, World};

/// The mean of rounds, per slot, and how they scatter about it.
pub(crate) struct Accumulator<V: Value> {
    /// By samples; empty before the first round.
    mean: LightValues<V>,
    /// What each layer weighs in the whole.
    weights: Vec<Vec3>,
    /// What the variance is of.
    stated: Stated,
    /// Σ n |light − mean|² of the whole, mean over RGB.
    squares: Vec<f32>,
    /// Σ n |light − mean|² per layer, mean over RGB.
    layer_squares: Vec<V::Scalars>,
    /// Variance of the mean, of the whole and per layer, as neighbours tell it too.
    told: Option<(Vec<f32>, Vec<V::Scalars>)>,
    samples: u32,
    rounds: u32,
    /// Σ over slots of the variance of the mean, as the last round and the mean of those before it tell it.
    by_last: f64,
    /// Σ over slots of the variance of the mean, as the scatter of all rounds tells it.
    by_all: f64,
}

/// Slots per partial sum: fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 4096;

impl<V: Value> Accumulator<V> {
    /// No round yet; `weights` has one of each layer.
    pub(crate) fn new(weights: &[Vec3], stated: Stated) -> Accumulator<V> {
        Accumulator {
            mean: LightValues::default(),
            weights: weights.to_vec(),
            stated,
            squares: Vec::new(),
            layer_squares: Vec::new(),
            told: None,
            samples: 0,
            rounds: 0,
            by_last: 0.0,
            by_all: 0.0,
        }
    }

    /// Samples per element so far.
    pub(crate) fn samples(&self) -> u32 {
        self.samples
    }

    /// Adds a round of `samples` samples per element, and leaves its arrays to be written over.
    pub(crate) fn add(&mut self, samples: u32, light: &mut LightValues<V>) {
        let before = self.samples;
        self.samples += samples;
        self.rounds += 1;
        self.told = None;
        if before == 0 {
            std::mem::swap(&mut self.mean, light);
            self.squares = vec![0.0; self.mean.direct.len()];
            self.layer_squares = vec![V::Scalars::default(); self.squares.len()];
            return;
        }
        let part = samples as f32 / self.samples as f32;
        let round = Added { weights: &self.weights, stated: self.stated, part, factor: before as f32 * part };
        let means = self.mean.direct.chunks_mut(CHUNK).zip(self.mean.indirect.chunks_mut(CHUNK));
        let squares = self.squares.chunks_mut(CHUNK).zip(self.layer_squares.chunks_mut(CHUNK));
        let sums = means.zip(squares).map(|((direct, indirect), (squares, layer_squares))| Sums {
            direct,
            indirect,
            squares,
            layer_squares,
        });
        let sums: Vec<Sums<V>> = sums.collect();
        let light = light.direct.par_chunks(CHUNK).zip(light.indirect.par_chunks(CHUNK));
        let add = |(mut sums, light): (Sums<V>, (&[V], &[V]))| sums.add(&round, light);
        let partials: Vec<(f64, f64)> = sums.into_par_iter().zip(light).map(add).collect();
        let (added, all) = partials.into_iter().fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        (self.by_last, self.by_all) = (added / f64::from(self.samples), all * self.per_square());
    }

    /// Has neighbours tell the variance, too: all of it of a first round, which has no other to scatter about, and more
    /// of it the fewer rounds there are.
    pub(crate) fn ask_neighbours(&mut self, world: &World) {
        if self.rounds == 0 {
            return;
        }
        let slots = (0..self.squares.len()).into_par_iter().with_min_len(CHUNK);
        let is_lit = |slot: usize| self.squares[slot] > 0.0 || self.light(slot) != V::default();
        // A first round scatters about nothing: nobody asks then.
        let has_light: Vec<bool> = if self.rounds > 1 { slots.clone().map(is_lit).collect() } else { Vec::new() };
        let freedom = (self.rounds - 1) as f32;
        let scatter = self.scatter();
        let square = |light: Vec3, factor: f32| factor * light.length_squared() / 3.0;
        let whole = match self.rounds {
            1 => {
                let light: Vec<Vec3> = slots.map(|slot| self.light(slot).weighted(&self.weights)).collect();
                scatter_of_neighbours(world, |slot| light[slot], square)
            }
            _ => pooled_with_neighbours(world, freedom, &has_light, |slot| scatter.of_whole(slot)),
        };
        let of_layers = match (self.weights.len(), self.rounds) {
            (0 | 1, _) => vec![V::Scalars::default(); whole.len()],
            _ if V::IS_FEW => self.few_told(&whole),
            (_, 1) => scatter_of_neighbours(world, |slot| self.light(slot), |light, factor| light.squares(factor)),
            _ => pooled_with_neighbours(world, freedom, &has_light, |slot| scatter.of_layers(slot)),
        };
        self.told = Some((whole, of_layers));
    }

    /// Light whose error is stated, of the mean of all rounds.
    #[inline]
    fn light(&self, slot: usize) -> V {
        self.stated.of(self.mean.direct[slot], self.mean.indirect[slot])
    }

    /// Of many layers, of which neighbours have different ones: as its rounds tell it, and of a first round as much of that
    /// of the whole as each has of the squared light.
    fn few_told(&self, whole: &[f32]) -> Vec<V::Scalars> {
        if self.rounds > 1 {
            let factor = self.scatter().factor;
            return self.layer_squares.par_iter().with_min_len(CHUNK).map(|squares| *squares * factor).collect();
        }
        let told = |(slot, variance): (usize, &f32)| {
            let light = self.light(slot);
            let square = light.weighted(&self.weights).length_squared() / 3.0;
            if square > 0.0 { light.squares(variance / square) } else { V::Scalars::default() }
        };
        whole.par_iter().enumerate().with_min_len(CHUNK).map(told).collect()
    }

    /// Mean of all rounds.
    pub(crate) fn mean(&self) -> &LightValues<V> {
        &self.mean
    }

    /// Whether there are rounds enough to tell a variance.
    pub(crate) fn knows_variance(&self) -> bool {
        self.rounds >= 2
    }

    /// How many layers there are.
    pub(crate) fn layers(&self) -> usize {
        self.weights.len()
    }

    /// Variance of the mean of what is stated, mean over RGB: with rounds x_r of n_r samples and variance σ²/n_r,
    /// Σ n_r (x_r − x̄)² / (R − 1) estimates σ², and the mean has σ² / Σ n_r. Low-discrepancy samples do better than
    /// 1/n: the whole is scaled to what the last round and those before it, which weigh most, say. Of one round it is
    /// guessed, and of few rounds pooled, where [`Accumulator::ask_neighbours`] was asked; else zero while nothing is known.
    pub(crate) fn scatter(&self) -> Scatter<'_, V> {
        let count = self.weights.len();
        if let Some((whole, layers)) = &self.told {
            return Scatter { whole, layers, count, factor: 1.0 };
        }
        let factor = if self.knows_variance() { (self.per_square() * self.scale()) as f32 } else { 0.0 };
        Scatter { whole: &self.squares, layers: &self.layer_squares, count, factor }
    }

    /// Variance of the mean of all layers together, mean over RGB, per slot.
    pub(crate) fn variance(&self) -> Vec<f32> {
        let scatter = self.scatter();
        (0..self.squares.len()).into_par_iter().with_min_len(CHUNK).map(|slot| scatter.of_whole(slot)).collect()
    }

    /// Variance of the mean per `squares`.
    fn per_square(&self) -> f64 {
        1.0 / (f64::from(self.rounds - 1) * f64::from(self.samples))
    }

    fn scale(&self) -> f64 {
        if self.by_all > 0.0 { (self.by_last / self.by_all).clamp(LEAST_SCALE, 1.0) } else { 1.0 }
    }
}

/// Variance of a mean, as the scatter of its rounds tells it.
pub(crate) struct Scatter<'a, V: Value> {
    whole: &'a [f32],
    layers: &'a [V::Scalars],
    count: usize,
    factor: f32,
}

impl<V: Value> Scatter<'_, V> {
    /// Of all layers together.
    #[inline]
    pub(crate) fn of_whole(&self, slot: usize) -> f32 {
        self.whole[slot] * self.factor
    }

    /// Of one layer; of the only one, that of the whole.
    #[inline]
    pub(crate) fn of_layer(&self, layer: usize, slot: usize) -> f32 {
        if self.count > 1 { self.layers[slot].of_layer(layer) * self.factor } else { self.of_whole(slot) }
    }

    /// Of each layer.
    #[inline]
    pub(crate) fn of_layers(&self, slot: usize) -> V::Scalars {
        self.layers[slot] * self.factor
    }
}

/// What a round of m samples does to the mean of n.
struct Added<'a> {
    weights: &'a [Vec3],
    stated: Stated,
    /// m / (n + m).
    part: f32,
    /// n m / (n + m): what its squared distance from the mean adds to the squares about the new one (West 1979).
    factor: f32,
}

/// Means and squares of some slots.
struct Sums<'a, V: Value> {
    direct: &'a mut [V],
    indirect: &'a mut [V],
    squares: &'a mut [f32],
    layer_squares: &'a mut [V::Scalars],
}

impl<V: Value> Sums<'_, V> {
    /// Adds light of a round. Σ over the slots: what it adds to the squares, and the squares.
    fn add(&mut self, round: &Added, (direct, indirect): (&[V], &[V])) -> (f64, f64) {
        let square = |light: Vec3| round.factor * light.length_squared() / 3.0;
        let (mut added, mut all) = (0.0, 0.0);
        for (k, (direct, indirect)) in direct.iter().zip(indirect).enumerate() {
            let (mean_direct, mean_indirect) = (&mut self.direct[k], &mut self.indirect[k]);
            let (light, mean) = (round.stated.of(*direct, *indirect), round.stated.of(*mean_direct, *mean_indirect));
            mean_direct.approach(direct, round.part);
            mean_indirect.approach(indirect, round.part);
            let whole = square(light.weighted(round.weights) - mean.weighted(round.weights));
            self.squares[k] += whole;
            added += f64::from(whole);
            all += f64::from(self.squares[k]);
            self.layer_squares[k] += light.squared_difference(&mean, round.factor);
        }
        (added, all)
    }
}

/// Low-discrepancy samples are not trusted to do better than this.
const LEAST_SCALE: f64 = 0.05;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::Family;
    use crate::random::Pcg32;

    #[test]
    fn rounds_of_unequal_size_tell_the_variance_of_their_mean() {
        let len = 4000;
        let (mut acc, mut rng) = (Accumulator::new(&[Vec3::ONE], Stated::Full), Pcg32::new(1, 1));
        let mut mean = vec![0.0f64; len];
        let sizes = [2u32, 2, 4, 8, 16];
        for n in sizes {
            let values: Vec<Vec3> =
                (0..len).map(|_| Vec3::splat((0..n).map(|_| rng.next_f32()).sum::<f32>() / n as f32)).collect();
            mean.iter_mut().zip(&values).for_each(|(m, v)| *m += f64::from(v.x) * f64::from(n));
            acc.add(n, &mut LightValues { direct: values, indirect: vec![Vec3::ZERO; len], variance: Vec::new() });
        }
        let total = f64::from(acc.samples());
        let truth = mean.iter().map(|m| (m / total - 0.5).powi(2)).sum::<f64>() / len as f64;
        let stated = acc.variance().iter().map(|v| f64::from(*v)).sum::<f64>() / len as f64;
        // Both are means over 4,000 elements, of one and of four degrees of freedom each.
        let deviation = ((2.0 + 2.0 / 4.0) / len as f64).sqrt();
        let mut family = Family::of_known_errors();
        family.compare("stated over true", stated / truth - 1.0, deviation);
        family.assert_agrees();
    }
}
