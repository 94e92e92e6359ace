//! Layers as transport computes them: side by side per slot.

use std::ops::Add;

use glam::Vec3;
use rayon::prelude::*;

use crate::accumulate::Accumulator;
use crate::lightmap::LightValues;
use crate::value::Value;
use crate::world::Validity;

/// Slots per task.
const CHUNK: usize = 4096;

/// What each layer weighs while some are computed together: a single one is computed at its own scale.
pub(crate) fn weights_within(weights: &[Vec3]) -> &[Vec3] {
    if weights.len() > 1 { weights } else { &[Vec3::ONE] }
}

/// Light of some layers per slot.
#[derive(Clone, Debug)]
pub(crate) struct Stack<V> {
    /// The variance is that of the weighted sum of all layers.
    pub light: LightValues<V>,
    /// Variance of every layer, those of a slot side by side; empty for one layer.
    pub layer_variance: Vec<f32>,
}

impl<V: Value> Stack<V> {
    /// Light of `layers` layers whose error is not known.
    pub(crate) fn without_error(direct: Vec<V>, indirect: Vec<V>, layers: usize) -> Stack<V> {
        let len = direct.len();
        let layer_variance = vec![0.0; if layers > 1 { len * layers } else { 0 }];
        Stack { light: LightValues { direct, indirect, variance: vec![0.0; len] }, layer_variance }
    }

    /// The mean of all rounds, with its variance, added to other, independent light. Invalid elements take their
    /// neighbours' values.
    pub(crate) fn of_mean(sum: &Accumulator<V>, to: Option<&Stack<V>>, validity: &Validity) -> Stack<V> {
        fn total<T: Add<Output = T> + Copy + Send + Sync>(
            values: impl IndexedParallelIterator<Item = T>,
            to: Option<&[T]>,
        ) -> Vec<T> {
            match to {
                Some(to) => values.zip(to).with_min_len(CHUNK).map(|(a, b)| a + *b).collect(),
                None => values.with_min_len(CHUNK).collect(),
            }
        }
        let (mean, scatter, layers) = (sum.mean(), sum.scatter(), sum.layers());
        let slots = mean.len();
        let of_layers = if layers > 1 { slots * layers } else { 0 };
        let of_layer = (0..of_layers).into_par_iter().map(|k| scatter.of_layer(k % layers, k / layers));
        let of_whole = (0..slots).into_par_iter().map(|slot| scatter.of_whole(slot));
        let mut stack = Stack {
            light: LightValues {
                direct: total(mean.direct.par_iter().copied(), to.map(|to| &*to.light.direct)),
                indirect: total(mean.indirect.par_iter().copied(), to.map(|to| &*to.light.indirect)),
                variance: total(of_whole, to.map(|to| &*to.light.variance)),
            },
            layer_variance: total(of_layer, to.map(|to| &*to.layer_variance)),
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
        let layers = self.layers_of_variance();
        for (slot, weight) in slots {
            let slot = slot as usize;
            let part = |old: f32, a: f32, b: f32| {
                old + weight * weight * (b - old) + (1.0 - weight) * (1.0 - weight) * (a - old)
            };
            let mix = |a: V, b: V| a + (b - a) * weight;
            let (light, theirs) = (&mut self.light, &other.light);
            light.direct[slot] = mix(light.direct[slot], theirs.direct[slot]);
            light.indirect[slot] = mix(light.indirect[slot], theirs.indirect[slot]);
            let old = shared.map_or(0.0, |s| s.light.variance[slot]);
            light.variance[slot] = part(old, light.variance[slot], theirs.variance[slot]);
            for k in slot * layers..(slot + 1) * layers {
                let old = shared.map_or(0.0, |s| s.layer_variance[k]);
                self.layer_variance[k] = part(old, self.layer_variance[k], other.layer_variance[k]);
            }
        }
    }

    /// Takes the values of another in some slots, bit for bit.
    pub(crate) fn take(&mut self, other: &Stack<V>, slots: impl Iterator<Item = u32>) {
        let layers = self.layers_of_variance();
        for slot in slots.map(|slot| slot as usize) {
            self.light.direct[slot] = other.light.direct[slot];
            self.light.indirect[slot] = other.light.indirect[slot];
            self.light.variance[slot] = other.light.variance[slot];
            let its_layers = slot * layers..(slot + 1) * layers;
            self.layer_variance[its_layers.clone()].copy_from_slice(&other.layer_variance[its_layers]);
        }
    }

    fn layers_of_variance(&self) -> usize {
        self.layer_variance.len().checked_div(self.light.len()).unwrap_or(0)
    }

    /// Invalid elements take their neighbours' values.
    pub(crate) fn fill_invalid(&mut self, validity: &Validity) {
        validity.fill_light(&mut self.light);
        let layers = self.layers_of_variance();
        validity.fill_scalars(&mut self.layer_variance, layers);
    }
}
