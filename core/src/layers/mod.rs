//! Light layers (Nielsen 2000): light tagged with the lights that it stems from, so that a change of
//! colour or intensity is a weighted sum and needs no ray.
//!
//! A layer holds the light of one light or of a group at *reference strengths*; its weight is the present strength over
//! the reference, the same for all its lights. The light map is the sum of weight × layer. A map has no layers until
//! somebody relights a light or groups lights: "model only what a scene needs".

mod apart;
mod blocks;
mod plan;
mod regroup;
mod rest;
mod stack;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use crate::lightmap::{AnyLight, LightMap};
use crate::scene::Scene;
use crate::transport::black;
use crate::world::{Emitters, World};

pub use crate::lightmap::{
    BLOCK_SLOTS, Layer, LayerHeader, LayerLight, LightBlock, LightValues, MAX_GROUPS, MAX_LAYERS, SIDE_BY_SIDE,
    SparseLight, blocks_of,
};
pub(crate) use apart::{Apart, Computed, Old};
pub(crate) use plan::{Piece, Plan, groups_of, headers_of_layers, is_new, moved_layers, wants_layers};
pub(crate) use regroup::{Pieces, renamed};
pub use rest::REST_LAYER;
pub(crate) use rest::{add_square_of_rest, at_present, at_strength_of, less_sure, off_by, thin, thinned};
pub(crate) use stack::{Stack, weights_within};

/// Name of the layer of the lights that share one by default.
pub const SHARED_LAYER: &str = "shared";

/// Relative difference up to which two strengths count as the same: a few units in the last place of `f32`.
const SAME_STRENGTH: f32 = 1e-6;

/// What a layer weighs in a scene, per channel: the factor from all its lights' references to their strengths. None
/// where they differ in it. Lights that the scene does not have do not count.
pub(crate) fn weight_of(lights: &[LayerLight], scene: &Scene) -> Option<Vec3> {
    weight_of_changes(lights.iter().filter_map(|light| Some((light.reference, strength_of(scene, &light.name)?))))
}

/// `color × intensity` of lights by their names: of many layers each looks for its own.
type Strengths<'s> = BTreeMap<&'s str, Vec3>;

fn strengths_of(scene: &Scene) -> Strengths<'_> {
    // Of several with one name the first counts, as everywhere.
    scene.lights.iter().rev().map(|light| (light.name.as_str(), light.strength())).collect()
}

/// As [`weight_of`].
fn weight_at(lights: &[LayerLight], strengths: &Strengths) -> Option<Vec3> {
    let change = |light: &LayerLight| Some((light.reference, *strengths.get(light.name.as_str())?));
    weight_of_changes(lights.iter().filter_map(change))
}

/// The factor, per channel, from the first to the second of all pairs; none where they differ in it.
fn weight_of_changes(changes: impl Iterator<Item = (Vec3, Vec3)>) -> Option<Vec3> {
    let mut weight = [None::<f32>; 3];
    for (reference, strength) in changes {
        for (channel, known) in weight.iter_mut().enumerate() {
            let (reference, now) = (reference[channel], strength[channel]);
            match *known {
                _ if reference == 0.0 && now == 0.0 => {}
                _ if reference == 0.0 => return None,
                None => *known = Some(now / reference),
                Some(known) if (known * reference - now).abs() > SAME_STRENGTH * now.abs() => return None,
                Some(_) => {}
            }
        }
    }
    Some(Vec3::from(weight.map(|w| w.unwrap_or(1.0))))
}

/// `color × intensity` of a light of a scene.
pub(crate) fn strength_of(scene: &Scene, name: &str) -> Option<Vec3> {
    scene.lights.iter().find(|light| light.name == name).map(|light| light.strength())
}

/// What the layers of some headers weigh in a scene.
pub(crate) fn weights_of(headers: &[LayerHeader], scene: &Scene) -> Vec<Vec3> {
    let strengths = strengths_of(scene);
    headers.iter().map(|header| weight_at(&header.lights, &strengths).unwrap_or(Vec3::ONE)).collect()
}

/// What layers weigh in a scene.
pub(crate) fn weights_of_layers(layers: &[Arc<Layer>], scene: &Scene) -> Vec<Vec3> {
    let strengths = strengths_of(scene);
    layers.iter().map(|layer| weight_at(&layer.lights, &strengths).unwrap_or(Vec3::ONE)).collect()
}

impl LightMap {
    /// What every layer weighs in `scene`.
    pub fn layer_weights(&self, scene: &Scene) -> Vec<Vec3> {
        weights_of_layers(&self.layers, scene)
    }

    /// The layer of a light; none where the map has no layers, or none of that light.
    pub fn layer_of(&self, light: &str) -> Option<&Arc<Layer>> {
        self.layers.iter().find(|layer| layer.lights.iter().any(|l| l.name == light))
    }

    /// Bytes of values, those of layers included.
    pub fn memory_bytes(&self) -> usize {
        const SLOT: usize = 2 * size_of::<Vec3>() + size_of::<f32>();
        self.len() * SLOT + self.layers.iter().map(|layer| layer.light.memory_bytes()).sum::<usize>()
    }
}

/// The map that layers make with their weights. The stated variance takes `correlation` between layers as it is.
pub(crate) fn whole(layers: Vec<Arc<Layer>>, weights: &[Vec3], correlation: f64) -> LightMap {
    let variance = stated_variance(&layers, weights, correlation);
    whole_with(layers, weights, variance)
}

/// Variance of the weighted sum of layers, per slot, with what their rest is off by at these weights.
fn stated_variance(layers: &[Arc<Layer>], weights: &[Vec3], correlation: f64) -> Vec<f32> {
    let mut variance = variance_of(&lights_of(layers), weights, correlation);
    let off = rest::off_by(layers, weights);
    if let Some(rest) = layers.first().filter(|layer| off > 0.0 && layer.lights.is_empty()) {
        rest::add_square_of_rest(&mut variance, &rest.light, off);
    }
    variance
}

/// The map that layers make with their weights, whose variance (mean over RGB, per slot) is known.
pub(crate) fn whole_with(layers: Vec<Arc<Layer>>, weights: &[Vec3], variance: Vec<f32>) -> LightMap {
    let len = layers.first().map_or(0, |layer| layer.light.len());
    let mut light = LightValues { direct: black(len), indirect: black(len), variance };
    sum_blocks(&mut light, &layers, weights, |_| true);
    LightMap { light, layers }
}

/// Writes the weighted sum of layers into the blocks that are wanted.
fn sum_blocks(
    light: &mut LightValues,
    layers: &[Arc<Layer>],
    weights: &[Vec3],
    is_wanted: impl Fn(usize) -> bool + Sync,
) {
    let sum = |values: &mut [Vec3], part: for<'a> fn(&LightBlock<'a>) -> &'a [Vec3]| {
        let blocks = values.par_chunks_mut(BLOCK_SLOTS).enumerate().with_min_len(CHUNK / BLOCK_SLOTS);
        blocks.filter(|(index, _)| is_wanted(*index)).for_each(|(index, out)| {
            out.fill(Vec3::ZERO);
            for (layer, weight) in layers.iter().zip(weights) {
                let Some(block) = layer.light.block(index) else { continue };
                out.iter_mut().zip(part(&block)).for_each(|(o, v)| *o += *v * *weight);
            }
        });
    };
    sum(&mut light.direct, |block| block.direct);
    sum(&mut light.indirect, |block| block.indirect);
}

fn lights_of(layers: &[Arc<Layer>]) -> Vec<AnyLight<'_>> {
    layers.iter().map(|layer| AnyLight::Sparse(&layer.light)).collect()
}

/// Variance of the weighted sum of layers, per slot.
fn variance_of(layers: &[AnyLight], weights: &[Vec3], correlation: f64) -> Vec<f32> {
    let mut variance = vec![0.0; layers.first().map_or(0, AnyLight::len)];
    variance_of_blocks(&mut variance, layers, weights, correlation, |_| true);
    variance
}

/// Writes the variance of the weighted sum of layers into the blocks that are wanted.
fn variance_of_blocks(
    variance: &mut [f32],
    layers: &[AnyLight],
    weights: &[Vec3],
    correlation: f64,
    is_wanted: impl Fn(usize) -> bool + Sync,
) {
    let correlation = correlation as f32;
    let factors: Vec<f32> = weights.iter().map(|w| w.length_squared() / 3.0).collect();
    let blocks = variance.par_chunks_mut(BLOCK_SLOTS).enumerate().with_min_len(CHUNK / BLOCK_SLOTS);
    blocks.filter(|(index, _)| is_wanted(*index)).for_each(|(index, variance)| {
        let mut sums = [(0.0f32, 0.0f32); BLOCK_SLOTS];
        for (layer, factor) in layers.iter().zip(&factors) {
            let Some(block) = layer.block(index) else { continue };
            for ((sum, equal), value) in sums.iter_mut().zip(block.variance) {
                let value = value * factor;
                *sum += value;
                *equal += value.sqrt();
            }
        }
        for (variance, (sum, equal)) in variance.iter_mut().zip(sums) {
            *variance = (sum + correlation * (equal * equal - sum)).max(0.0);
        }
    });
}

/// The map of layers that take the place of those of `old`, one by one, with the weights of `after`. Only what changes is
/// summed anew: elsewhere light and its variance stay, but for what the rest is off by.
pub(crate) fn whole_of(layers: Vec<Arc<Layer>>, old: &LightMap, before: &Scene, after: &Scene) -> LightMap {
    let old_weights = old.layer_weights(before);
    let correlation = correlation(old, &old_weights);
    let mut map = LightMap { light: LightValues::default(), layers };
    let weights = map.layer_weights(after);
    if map.layers.len() != old.layers.len() || old.light.variance.len() != old.len() {
        let variance = stated_variance(&map.layers, &weights, correlation);
        return whole_with(map.layers, &weights, variance);
    }
    let mut has_changed = vec![false; blocks_of(old.len())];
    let pairs = map.layers.iter().zip(&old.layers).zip(weights.iter().zip(&old_weights));
    for ((new, old), _) in pairs.filter(|((new, old), (a, b))| !Arc::ptr_eq(new, old) || a != b) {
        new.light.blocks().chain(old.light.blocks()).for_each(|(index, _)| has_changed[index] = true);
    }
    map.light = old.light.clone();
    sum_blocks(&mut map.light, &map.layers, &weights, |index| has_changed[index]);
    let variance = &mut map.light.variance;
    variance_of_blocks(variance, &lights_of(&map.layers), &weights, correlation, |index| has_changed[index]);
    if let Some(rest) = map.layers.first().filter(|layer| layer.lights.is_empty()) {
        let [now, then] =
            [(&map.layers, &weights), (&old.layers, &old_weights)].map(|(l, w)| rest::off_by(l, w).powi(2));
        let more = |index: usize| if has_changed[index] { now } else { now - then };
        rest::add_squares_of_rest(variance, &rest.light, more);
    }
    map
}

/// Slots per task: two parts of it fit in the cache.
const CHUNK: usize = 4096;

/// So many slots tell a correlation, and so many of a block.
const CORRELATION_SLOTS: usize = 1 << 14;
const OF_BLOCK: usize = 8;

/// How much the errors of layers, which share their rays, have in common: 0 not at all, 1 they are the same, below 0
/// they take from one another. From the variance of the whole, which was measured, and those of its layers.
pub(crate) fn correlation(map: &LightMap, weights: &[Vec3]) -> f64 {
    if map.layers.len() < 2 {
        return 0.0;
    }
    let factors: Vec<f32> = weights.iter().map(|w| w.length_squared() / 3.0).collect();
    let (mut measured, mut independent, mut equal) = (0.0f64, 0.0f64, 0.0f64);
    // What the rest is off by is stated beside what was measured.
    let off = rest::off_by(&map.layers, weights);
    let rest = map.rest().filter(|_| off > 0.0);
    let of_rest = |slot| rest.map_or(0.0, |rest| off * off * rest::square_at(&rest.light, slot));
    // Few slots of many layers tell as much.
    let slots = (SIDE_BY_SIDE * CORRELATION_SLOTS / map.layers.len()).clamp(CORRELATION_SLOTS / 8, CORRELATION_SLOTS);
    let step = (map.len() * OF_BLOCK).div_ceil(slots * BLOCK_SLOTS).max(1);
    for index in (0..blocks_of(map.len())).step_by(step) {
        let mut sums = [(0.0f32, 0.0f32); OF_BLOCK];
        for (layer, factor) in map.layers.iter().zip(&factors) {
            let Some(block) = layer.light.block(index) else { continue };
            for ((sum, root), variance) in sums.iter_mut().zip(block.variance.iter().step_by(BLOCK_SLOTS / OF_BLOCK)) {
                *sum += variance * factor;
                *root += (variance * factor).sqrt();
            }
        }
        let slots = (index * BLOCK_SLOTS..map.len()).step_by(BLOCK_SLOTS / OF_BLOCK);
        for (slot, (sum, root)) in slots.zip(sums) {
            measured += f64::from(map.light.variance[slot] - of_rest(slot));
            independent += f64::from(sum);
            equal += f64::from(root * root);
        }
    }
    // Layers that were set apart have errors of opposite sign in common.
    let least = -1.0 / (map.layers.len() - 1) as f64;
    if equal > independent { ((measured - independent) / (equal - independent)).clamp(least, 1.0) } else { 0.0 }
}

/// A layer gets at least this part of the samples that its power at reference strength would get it: it may be made
/// brighter at any time.
const LEAST_IMPORTANCE: f32 = 0.05;

impl World {
    /// This world with the lights of some layers only, at reference strengths, each tagged with its layer's position in
    /// `layers`. `weights` tell how much their samples matter.
    pub(crate) fn only_layers(&self, layers: &[LayerHeader], weights: &[Vec3]) -> World {
        let mut list = Vec::new();
        for (index, layer) in layers.iter().enumerate() {
            for light in &layer.lights {
                for emitter in self.emitters.all().filter(|e| e.name == light.name) {
                    list.push(crate::world::Emitter {
                        strength: light.reference,
                        layer: index as u32,
                        ..emitter.clone()
                    });
                }
            }
        }
        let radius = self.emitters.scene_radius;
        let power = |layer: u32, list: &[crate::world::Emitter]| -> f32 {
            list.iter().filter(|e| e.layer == layer).map(|e| e.power(radius)).sum()
        };
        let powers: Vec<f32> = (0..layers.len() as u32).map(|layer| power(layer, &list)).collect();
        let mean_weight = |w: &Vec3| w.element_sum() / 3.0;
        let total: f32 = powers.iter().zip(weights).map(|(p, w)| p * mean_weight(w)).sum();
        for emitter in &mut list {
            let (power, weight) = (powers[emitter.layer as usize], mean_weight(&weights[emitter.layer as usize]));
            let least = if total > 0.0 { LEAST_IMPORTANCE * total } else { 1.0 };
            emitter.importance = if power > 0.0 { weight.max(least / power) } else { 0.0 };
        }
        World { emitters: Arc::new(Emitters::of(list, radius)), ..self.clone() }
    }

    /// How much the light of each layer matters where samples are shared out, in a world of [`World::only_layers`]: what it
    /// weighs, and that of lamps which are off as little as their samples count. Where all are off, all alike.
    pub(crate) fn guides(&self, weights: &[Vec3]) -> Vec<Vec3> {
        let least = |layer: usize| {
            let of_layer = self.emitters.list.iter().find(|emitter| emitter.layer as usize == layer);
            of_layer.map_or(0.0, |emitter| emitter.importance)
        };
        let guide = |(layer, weight): (usize, &Vec3)| {
            if weight.element_sum() / 3.0 < least(layer) { Vec3::splat(least(layer)) } else { *weight }
        };
        let guides: Vec<Vec3> = weights.iter().enumerate().map(guide).collect();
        if guides.iter().all(|guide| *guide == Vec3::ZERO) { vec![Vec3::ONE; weights.len()] } else { guides }
    }
}
