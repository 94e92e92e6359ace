//! Layers as transport computes them: side by side per slot.

use glam::Vec3;
use rayon::prelude::*;

use crate::accumulate::Accumulator;
use crate::lightmap::LightValues;
use crate::value::{Linear, Value};
use crate::world::Validity;

/// Slots per task.
const CHUNK: usize = 4096;

/// What each layer weighs while some are computed together: a single one is computed at its own scale.
pub(crate) fn weights_within(weights: &[Vec3]) -> &[Vec3] {
    if weights.len() > 1 { weights } else { &[Vec3::ONE] }
}

/// Light of some layers per slot.
#[derive(Clone, Debug)]
pub(crate) struct Stack<V: Value> {
    /// The variance is that of the weighted sum of all layers.
    pub light: LightValues<V>,
    /// Variance of every layer.
    pub layer_variance: Vec<V::Scalars>,
}

impl<V: Value> Stack<V> {
    /// Light whose error is not known.
    pub(crate) fn without_error(direct: Vec<V>, indirect: Vec<V>) -> Stack<V> {
        let len = direct.len();
        let layer_variance = vec![V::Scalars::default(); len];
        Stack { light: LightValues { direct, indirect, variance: vec![0.0; len] }, layer_variance }
    }

    /// The mean of all rounds, with its variance, added to other, independent light. Invalid elements take their
    /// neighbours' values.
    pub(crate) fn of_mean(sum: &Accumulator<V>, to: Option<&Stack<V>>, validity: &Validity) -> Stack<V> {
        fn total<T: Linear>(values: impl IndexedParallelIterator<Item = T>, to: Option<&[T]>) -> Vec<T> {
            match to {
                Some(to) => values.zip(to).with_min_len(CHUNK).map(|(a, b)| a + *b).collect(),
                None => values.with_min_len(CHUNK).collect(),
            }
        }
        let (mean, scatter) = (sum.mean(), sum.scatter());
        let slots = mean.len();
        let of_layers = (0..slots).into_par_iter().map(|slot| scatter.of_layers(slot));
        let of_whole = (0..slots).into_par_iter().map(|slot| scatter.of_whole(slot));
        let mut stack = Stack {
            light: LightValues {
                direct: total(mean.direct.par_iter().copied(), to.map(|to| &*to.light.direct)),
                indirect: total(mean.indirect.par_iter().copied(), to.map(|to| &*to.light.indirect)),
                variance: total(of_whole, to.map(|to| &*to.light.variance)),
            },
            layer_variance: total(of_layers, to.map(|to| &*to.layer_variance)),
        };
        stack.fill_invalid(validity);
        stack
    }

    /// Takes a part (slot, weight) of another in some slots. Both hold the noise of `shared`, and beside it their own.
    pub(crate) fn blend(
        &mut self,
        other: &Stack<V>,
        slots: impl Iterator<Item = (u32, f32)>,
        shared: Option<&Stack<V>>,
    ) {
        fn part<T: Linear>(weight: f32, old: T, a: T, b: T) -> T {
            old + (b - old) * (weight * weight) + (a - old) * ((1.0 - weight) * (1.0 - weight))
        }
        for (slot, weight) in slots {
            let slot = slot as usize;
            let mix = |a: V, b: V| a + (b - a) * weight;
            let (light, theirs) = (&mut self.light, &other.light);
            light.direct[slot] = mix(light.direct[slot], theirs.direct[slot]);
            light.indirect[slot] = mix(light.indirect[slot], theirs.indirect[slot]);
            let old = shared.map_or(0.0, |s| s.light.variance[slot]);
            light.variance[slot] = part(weight, old, light.variance[slot], theirs.variance[slot]);
            let old = shared.map_or_else(V::Scalars::default, |s| s.layer_variance[slot]);
            self.layer_variance[slot] = part(weight, old, self.layer_variance[slot], other.layer_variance[slot]);
        }
    }

    /// Takes the values of another in some slots, bit for bit.
    pub(crate) fn take(&mut self, other: &Stack<V>, slots: impl Iterator<Item = u32>) {
        for slot in slots.map(|slot| slot as usize) {
            self.light.direct[slot] = other.light.direct[slot];
            self.light.indirect[slot] = other.light.indirect[slot];
            self.light.variance[slot] = other.light.variance[slot];
            self.layer_variance[slot] = other.layer_variance[slot];
        }
    }

    /// Invalid elements take their neighbours' values.
    pub(crate) fn fill_invalid(&mut self, validity: &Validity) {
        validity.fill_light(&mut self.light);
        validity.fill(&mut self.layer_variance);
    }
}
