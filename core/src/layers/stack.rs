//! Layers as transport computes them: side by side per slot.

use std::ops::Add;
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::{Header, Layer, whole, whole_with};
use crate::accumulate::Accumulator;
use crate::lightmap::LightMap;
use crate::transport::Value;
use crate::world::{Transition, Validity};

/// Slots per task.
const CHUNK: usize = 4096;

/// What layers tell of a slot, side by side.
#[inline]
fn side_by_side<V: Value>(layers: &[Arc<Layer>], of: impl Fn(&Layer) -> Vec3) -> V {
    let mut value = V::default();
    layers.iter().zip(0..).for_each(|(layer, k)| value.add_to_layer(k, of(layer)));
    value
}

/// All light of some layers, direct and indirect, in the slots that they have.
pub(crate) fn total_of_layers<V: Value>(layers: &[Arc<Layer>], slots: usize) -> Vec<V> {
    let total = |slot: usize| side_by_side(layers, |layer| layer.direct[slot] + layer.indirect[slot]);
    (0..slots).into_par_iter().with_min_len(CHUNK).map(total).collect()
}

/// What lies side by side, `per_slot` items a slot, layer by layer. All layers of some slots are taken out at once: read
/// one by one, each would bring the others along from memory.
fn apart<T: Sync, U: Default + Clone + Send>(
    values: &[T],
    per_slot: usize,
    layers: usize,
    of: impl Fn(&[T], usize) -> U + Sync,
) -> Vec<Vec<U>> {
    const CHUNK: usize = 256;
    let black = |_| vec![U::default(); values.len() / per_slot];
    let mut out: Vec<Vec<U>> = (0..layers).into_par_iter().map(black).collect();
    let mut chunks: Vec<_> = out.iter_mut().map(|layer| layer.chunks_mut(CHUNK)).collect();
    let of_chunk = |values| (values, chunks.iter_mut().filter_map(Iterator::next).collect());
    let tasks: Vec<(&[T], Vec<&mut [U]>)> = values.chunks(CHUNK * per_slot).map(of_chunk).collect();
    tasks.into_par_iter().for_each(|(values, layers)| {
        for (k, layer) in layers.into_iter().enumerate() {
            layer.iter_mut().zip(values.chunks_exact(per_slot)).for_each(|(out, slot)| *out = of(slot, k));
        }
    });
    out
}

/// Layers that were computed along the same rays.
pub(crate) struct Computed {
    pub layers: Vec<Arc<Layer>>,
    /// Variance of their weighted sum. None for a single one, which is computed at its own scale.
    pub variance: Option<Vec<f32>>,
}

impl Computed {
    /// The map of these layers alone.
    pub(crate) fn into_map(self, weights: &[Vec3]) -> LightMap {
        match self.variance {
            Some(variance) => whole_with(self.layers, weights, variance),
            None => whole(self.layers, weights, 0.0),
        }
    }
}

/// What each layer weighs while some are computed together: a single one is computed at its own scale.
pub(crate) fn weights_within(weights: &[Vec3]) -> &[Vec3] {
    if weights.len() > 1 { weights } else { &[Vec3::ONE] }
}

/// Light of some layers per slot.
#[derive(Clone, Debug, Default)]
pub(crate) struct Stack<V> {
    /// Straight from lights.
    pub direct: Vec<V>,
    /// After at least one bounce.
    pub indirect: Vec<V>,
    /// Variance of the weighted sum of all layers, mean over RGB.
    pub variance: Vec<f32>,
    /// Variance of every layer, those of a slot side by side; empty for one layer.
    pub layer_variance: Vec<f32>,
}

impl Stack<Vec3> {
    /// All light of a map together, in the slots of the world after a transition.
    pub(crate) fn of_whole(map: &LightMap, transition: &Transition) -> Stack<Vec3> {
        Stack {
            direct: transition.carry(&map.direct),
            indirect: transition.carry(&map.indirect),
            variance: transition.carry(&map.variance),
            layer_variance: Vec::new(),
        }
    }

    /// A map without layers.
    pub(crate) fn take_map(&mut self) -> LightMap {
        let Stack { direct, indirect, variance, .. } = std::mem::take(self);
        LightMap { direct, indirect, variance, layers: Vec::new() }
    }
}

impl<V: Value> Stack<V> {
    /// No light of `layers` layers.
    pub(crate) fn black(len: usize, layers: usize) -> Stack<V> {
        Stack {
            direct: vec![V::default(); len],
            indirect: vec![V::default(); len],
            variance: vec![0.0; len],
            layer_variance: vec![0.0; if layers > 1 { len * layers } else { 0 }],
        }
    }

    /// Of the layers of a map whose weighted sum has `variance` (for a single one its own is taken), in the slots of the
    /// world after a transition: old values where elements stay, zero where they go or come.
    pub(crate) fn of_layers(layers: &[Arc<Layer>], variance: &[f32], transition: &Transition) -> Stack<V> {
        let carried = |part: fn(&Layer) -> &[Vec3]| -> Vec<V> {
            transition.carry_each(|slot| side_by_side(layers, |layer| part(layer)[slot]))
        };
        let mut layer_variance = Vec::new();
        let variance = match layers {
            [layer] => &layer.variance,
            _ => {
                layer_variance = vec![0.0; transition.after.slots() * layers.len()];
                let slots = layer_variance.par_chunks_mut(layers.len()).enumerate().with_min_len(CHUNK);
                slots.filter(|(slot, _)| transition.keeps(*slot)).for_each(|(slot, out)| {
                    out.iter_mut().zip(layers).for_each(|(out, layer)| *out = layer.variance[slot]);
                });
                variance
            }
        };
        let (direct, indirect) = (carried(|layer| &layer.direct), carried(|layer| &layer.indirect));
        Stack { direct, indirect, variance: transition.carry(variance), layer_variance }
    }

    /// The layers, with their headers.
    pub(crate) fn computed(&self, headers: &[Header]) -> Computed {
        let layers = self.to_layers(headers);
        Computed { layers, variance: (headers.len() > 1).then(|| self.variance.clone()) }
    }

    fn to_layers(&self, headers: &[Header]) -> Vec<Arc<Layer>> {
        let layers = headers.len();
        let mut direct = apart(&self.direct, 1, layers, |light, k| light[0].layer(k));
        let mut indirect = apart(&self.indirect, 1, layers, |light, k| light[0].layer(k));
        let mut variance = match layers {
            1 => vec![self.variance.clone()],
            _ => apart(&self.layer_variance, layers, layers, |slot, k| slot[k]),
        };
        let of = |(k, header): (usize, &Header)| {
            let (name, lights) = (header.name.clone(), header.lights.clone());
            let [direct, indirect] = [&mut direct, &mut indirect].map(|part| std::mem::take(&mut part[k]));
            Arc::new(Layer { name, lights, direct, indirect, variance: std::mem::take(&mut variance[k]) })
        };
        headers.iter().enumerate().map(of).collect()
    }

    /// Writes the mean of all rounds, with its variance, over what it holds; added to another, independent one.
    pub(crate) fn write_mean(&mut self, sum: &Accumulator<V>, to: Option<&Stack<V>>) {
        fn write<T: Add<Output = T> + Copy + Send + Sync>(
            values: impl IndexedParallelIterator<Item = T>,
            to: Option<&[T]>,
            out: &mut Vec<T>,
        ) {
            match to {
                Some(to) => values.zip(to).with_min_len(CHUNK).map(|(a, b)| a + *b).collect_into_vec(out),
                None => values.with_min_len(CHUNK).collect_into_vec(out),
            }
        }
        let mean = sum.mean();
        write(mean.direct.par_iter().copied(), to.map(|to| &*to.direct), &mut self.direct);
        write(mean.indirect.par_iter().copied(), to.map(|to| &*to.indirect), &mut self.indirect);
        write(sum.variance(), to.map(|to| &*to.variance), &mut self.variance);
        write(sum.layer_variance(), to.map(|to| &*to.layer_variance), &mut self.layer_variance);
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
            self.direct[slot] = mix(self.direct[slot], other.direct[slot]);
            self.indirect[slot] = mix(self.indirect[slot], other.indirect[slot]);
            let old = shared.map_or(0.0, |s| s.variance[slot]);
            self.variance[slot] = part(old, self.variance[slot], other.variance[slot]);
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
            self.direct[slot] = other.direct[slot];
            self.indirect[slot] = other.indirect[slot];
            self.variance[slot] = other.variance[slot];
            let its_layers = slot * layers..(slot + 1) * layers;
            self.layer_variance[its_layers.clone()].copy_from_slice(&other.layer_variance[its_layers]);
        }
    }

    /// Black in some slots.
    pub(crate) fn clear(&mut self, slots: &[u32]) {
        let layers = self.layers_of_variance();
        for slot in slots.iter().map(|slot| *slot as usize) {
            self.direct[slot] = V::default();
            self.indirect[slot] = V::default();
            self.variance[slot] = 0.0;
            self.layer_variance[slot * layers..(slot + 1) * layers].fill(0.0);
        }
    }

    fn layers_of_variance(&self) -> usize {
        self.layer_variance.len().checked_div(self.direct.len()).unwrap_or(0)
    }

    /// direct + indirect.
    pub(crate) fn total(&self) -> Vec<V> {
        self.direct.par_iter().zip(&self.indirect).with_min_len(CHUNK).map(|(d, i)| *d + *i).collect()
    }

    /// Elements inside solids take their neighbours' values.
    pub(crate) fn fill_invalid(&mut self, validity: &Validity) {
        validity.fill(&mut self.direct);
        validity.fill(&mut self.indirect);
        validity.fill_scalars(&mut self.variance, 1);
        let layers = self.layers_of_variance();
        validity.fill_scalars(&mut self.layer_variance, layers);
    }
}
