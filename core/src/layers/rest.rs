//! Maps of more layers than are carried side by side: each is kept where it matters, and what is left of all of them is
//! a layer of its own, the first, that nobody can relight.
//!
//! The rest has light at the strength that it was computed at. Layers are held at that strength, too: where a lamp is at
//! `w` times it, the rest is off by at most |w − 1| times itself, and that is stated.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::blocks::matters;
use super::{
    BLOCK_SLOTS, Layer, LayerHeader, LightBlock, LightValues, SparseLight, blocks_of, weight_of, weights_of_layers,
};
use crate::lightmap::LightMap;
use crate::scene::Scene;

/// Blocks per task.
const BLOCKS: usize = 64;

/// Name of the layer of what is left of the others.
pub const REST_LAYER: &str = "rest";

/// Headers of more layers than are carried side by side, behind that of the rest. Their lights are at present strength.
/// Those that are off have no layer: what is left of them would be light that is not there.
pub(super) fn with_rest(mut headers: Vec<LayerHeader>) -> Vec<LayerHeader> {
    headers.retain(is_lit);
    let name = free_name(REST_LAYER, |name| headers.iter().any(|header| header.name == name));
    headers.insert(0, LayerHeader { name, lights: Vec::new() });
    headers
}

/// The name, or one like it where it is taken.
pub(super) fn free_name(name: &str, is_taken: impl Fn(&str) -> bool) -> String {
    let mut free = name.to_owned();
    while is_taken(&free) {
        free.push('\'');
    }
    free
}

fn is_lit(header: &LayerHeader) -> bool {
    header.is_rest() || header.lights.iter().any(|light| light.reference != Vec3::ZERO)
}

/// Headers with their lights at present strength, without those that are off.
pub(crate) fn at_strength_of(headers: &[LayerHeader], scene: &Scene) -> Vec<LayerHeader> {
    let now = |header: &LayerHeader| {
        let mut header = header.clone();
        for light in &mut header.lights {
            light.reference = super::strength_of(scene, &light.name).unwrap_or(light.reference);
        }
        header
    };
    headers.iter().map(now).filter(is_lit).collect()
}

/// A layer at the strength that its lights have in a scene. Those that are off, and those that have changed unlike one
/// another, stay as they are.
pub(crate) fn at_present(layer: &Arc<Layer>, scene: &Scene) -> Arc<Layer> {
    let weight = weight_of(&layer.lights, scene).unwrap_or(Vec3::ONE);
    let factor = Vec3::select(weight.cmpgt(Vec3::ZERO), weight, Vec3::ONE);
    if factor == Vec3::ONE {
        return layer.clone();
    }
    let mut lights = layer.lights.clone();
    lights.iter_mut().for_each(|light| light.reference *= factor);
    Arc::new(Layer { name: layer.name.clone(), lights, light: layer.light.scaled(factor) })
}

impl LightMap {
    /// This map with its layers at the strength of a scene, and with what the rest is off by from then on in its variance,
    /// and in that of all light as far as that does not count it already, since the scene `before`; itself where it has no
    /// rest.
    pub(crate) fn at_strength_of(&self, scene: &Scene, before: &Scene) -> LightMap {
        let Some(rest) = self.rest() else { return self.clone() };
        // Those that are off stay as they are, and so does what is stated of them.
        let on = |scene: &Scene| -> Vec<Vec3> {
            let weights = self.layer_weights(scene).into_iter();
            weights.map(|w| Vec3::select(w.cmpgt(Vec3::ZERO), w, Vec3::ONE)).collect()
        };
        let (off, counted) = (off_by(&self.layers, &on(scene)), off_by(&self.layers, &on(before)));
        let mut light = self.light.clone();
        if off > counted {
            add_square_of_rest(&mut light.variance, &rest.light, (off * off - counted * counted).sqrt());
        }
        let mut layers: Vec<Arc<Layer>> = self.layers.par_iter().map(|layer| at_present(layer, scene)).collect();
        if off > 0.0 {
            layers[0] = less_sure(rest, off);
        }
        LightMap { light, layers }
    }

    /// This map without the layers that weigh nothing in a scene, and those, each with its place; where it has a rest.
    pub(crate) fn without_dark(&self, scene: &Scene) -> (LightMap, Vec<(usize, Arc<Layer>)>) {
        if self.rest().is_none() {
            return (self.clone(), Vec::new());
        }
        let all = self.layers.iter().cloned().zip(self.layer_weights(scene)).enumerate();
        let (dark, lit): (Vec<_>, Vec<_>) = all.partition(|(_, (_, weight))| *weight == Vec3::ZERO);
        let layers = lit.into_iter().map(|(_, (layer, _))| layer).collect();
        let dark = dark.into_iter().map(|(place, (layer, _))| (place, layer)).collect();
        (LightMap { light: self.light.clone(), layers }, dark)
    }
}

/// Part of itself that the rest of some layers is off by, at most, where they have these weights.
pub(crate) fn off_by(layers: &[Arc<Layer>], weights: &[Vec3]) -> f32 {
    let is_rest = |layer: &Arc<Layer>| layer.lights.is_empty();
    let own = layers.iter().zip(weights).filter(|(layer, _)| !is_rest(layer));
    own.map(|(_, weight)| (*weight - Vec3::ONE).abs().max_element()).fold(0.0, f32::max)
}

/// The rest, with so much of itself in its variance.
pub(crate) fn less_sure(rest: &Layer, part: f32) -> Arc<Layer> {
    let mut light = rest.light.to_dense();
    add_square_of_rest(&mut light.variance, &rest.light, part);
    Arc::new(Layer { name: rest.name.clone(), lights: Vec::new(), light: light.into() })
}

/// Adds the square of so much of the rest, mean over RGB, to variances per slot.
pub(crate) fn add_square_of_rest(variance: &mut [f32], rest: &SparseLight, part: f32) {
    add_squares_of_rest(variance, rest, |_| part * part);
}

/// The squared rest of a slot, mean over RGB. Edits leave light of both signs in it.
pub(super) fn square_at(rest: &SparseLight, slot: usize) -> f32 {
    let (direct, indirect) = rest.at(slot);
    (direct.abs() + indirect.abs()).length_squared() / 3.0
}

/// Adds `squares(block)` times the squared rest, mean over RGB, to variances per slot; they stay above zero.
pub(super) fn add_squares_of_rest(variance: &mut [f32], rest: &SparseLight, squares: impl Fn(usize) -> f32 + Sync) {
    let add = |(index, variance): (usize, &mut [f32])| {
        let factor = squares(index) / 3.0;
        let Some(block) = rest.block(index).filter(|_| factor != 0.0) else { return };
        for (v, (d, i)) in variance.iter_mut().zip(block.direct.iter().zip(block.indirect)) {
            // Edits leave light of both signs in it.
            *v = (*v + factor * (d.abs() + i.abs()).length_squared()).max(0.0);
        }
    };
    variance.par_chunks_mut(BLOCK_SLOTS).enumerate().with_min_len(BLOCKS).for_each(add);
}

/// Layers of which those that `which` tells were computed just now: where they matter little, their light goes to the
/// rest, which comes first. Where there is no rest, as they are.
pub(crate) fn thinned(layers: Vec<Arc<Layer>>, which: impl Fn(usize) -> bool, scene: &Scene) -> Vec<Arc<Layer>> {
    let Some(rest) = layers.first().filter(|layer| layer.lights.is_empty()) else { return layers };
    if !(1..layers.len()).any(&which) {
        return layers;
    }
    let (mut light, sizes) = (rest.light.to_dense(), sizes(&layers, scene));
    let name = rest.name.clone();
    let thin = |(k, layer): (usize, &Arc<Layer>)| match k > 0 && which(k) {
        true => thin(&at_present(layer, scene), scene, &sizes, &mut light),
        false => layer.clone(),
    };
    let mut layers: Vec<Arc<Layer>> = layers.iter().enumerate().map(thin).collect();
    layers[0] = Arc::new(Layer { name, lights: Vec::new(), light: light.into() });
    layers
}

/// Size of the light of all layers together, per slot.
fn sizes(layers: &[Arc<Layer>], scene: &Scene) -> Vec<f32> {
    let weights = weights_of_layers(layers, scene);
    let mut sizes = vec![0.0; layers.first().map_or(0, |layer| layer.light.len())];
    sizes.par_chunks_mut(BLOCK_SLOTS).enumerate().for_each(|(index, sizes)| {
        for (layer, weight) in layers.iter().zip(&weights) {
            let Some(block) = layer.light.block(index) else { continue };
            sizes.iter_mut().enumerate().for_each(|(k, size)| *size += size_of_slot(&block, k, *weight));
        }
    });
    sizes
}

fn size_of_slot(block: &LightBlock, slot: usize, weight: Vec3) -> f32 {
    (block.direct[slot] * weight).abs().max_element() + (block.indirect[slot] * weight).abs().max_element()
}

/// A layer that is at present strength, or dark, without the blocks in which it matters little beside light of these sizes
/// per slot: what it weighs of that is added to `rest`.
pub(crate) fn thin(layer: &Arc<Layer>, scene: &Scene, sizes: &[f32], rest: &mut LightValues) -> Arc<Layer> {
    let weight = weight_of(&layer.lights, scene).unwrap_or(Vec3::ONE);
    let is_told = |index: usize, block: &LightBlock| {
        let sizes = &sizes[index * BLOCK_SLOTS..][..block.direct.len()];
        matters(sizes.iter().enumerate().map(|(k, whole)| (size_of_slot(block, k, Vec3::ONE), *whole)))
    };
    let kept: Vec<bool> = (0..blocks_of(layer.light.len()))
        .into_par_iter()
        .map(|index| layer.light.block(index).is_some_and(|block| is_told(index, &block)))
        .collect();
    let square = weight.length_squared() / 3.0;
    for (index, block) in layer.light.blocks().filter(|(index, _)| !kept[*index]) {
        for (k, slot) in (index * BLOCK_SLOTS..).take(block.direct.len()).enumerate() {
            rest.direct[slot] += block.direct[k] * weight;
            rest.indirect[slot] += block.indirect[k] * weight;
            rest.variance[slot] += block.variance[k] * square;
        }
    }
    let light = SparseLight::of_blocks(layer.light.len(), layer.light.blocks().filter(|(index, _)| kept[*index]));
    Arc::new(Layer { name: layer.name.clone(), lights: layer.lights.clone(), light })
}
