//! Light that is known already, put together as the layers of a plan.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::plan::{Piece, Plan, Planned};
use super::{Layer, LayerHeader, variance_of};
use crate::lightmap::{AnyLight, BLOCK_SLOTS, LightMap, LightValues};

/// What the layers of a plan are put together from.
#[derive(Clone, Copy)]
pub(crate) struct Pieces<'a> {
    pub plan: &'a Plan,
    /// The old map.
    pub map: &'a LightMap,
    /// Light of the lights that leave their layers, at reference strength: as `plan.leaving`, or nothing.
    pub leaving: &'a [Arc<Layer>],
}

impl Pieces<'_> {
    /// The old light in its new layers.
    pub(crate) fn regroup(&self) -> Vec<Arc<Layer>> {
        self.plan.regrouped.iter().map(|planned| self.assemble(planned)).collect()
    }

    fn assemble(&self, planned: &Planned) -> Arc<Layer> {
        if let [(Piece::Old(index), Vec3::ONE)] = planned.pieces.as_slice()
            && let Some(layer) = self.map.layers.get(*index)
            && layer.name == planned.header.name
            && layer.lights == planned.header.lights
        {
            return layer.clone();
        }
        let LayerHeader { name, lights } = planned.header.clone();
        let (old, mut light) = (self.map.parts(), LightValues::black(self.map.len()));
        for &(piece, factor) in &planned.pieces {
            match piece {
                Piece::Old(index) => light.add_scaled(old[index], factor),
                Piece::Leaving(index) => light.add_scaled(AnyLight::Sparse(&self.leaving[index].light), factor),
            }
        }
        Arc::new(Layer { name, lights, light: light.into() })
    }

    /// Variance of the new map, whose layers have these weights: light that leaves one layer for another is in both,
    /// with opposite signs, so that only what it weighs in all counts.
    pub(crate) fn variance(&self, weights: &[Vec3], correlation: f64) -> Vec<f32> {
        let parts = self.map.parts();
        let mut old = vec![Vec3::ZERO; parts.len()];
        let mut new = vec![Vec3::ZERO; self.leaving.len()];
        for ((_, origin), weight) in self.plan.after.iter().zip(weights) {
            let pieces = origin.map_or(&[][..], |index| &self.plan.regrouped[index].pieces);
            for (piece, factor) in pieces {
                match piece {
                    Piece::Old(k) => old[*k] += *factor * *weight,
                    Piece::Leaving(k) => new[*k] += *factor * *weight,
                }
            }
        }
        let square = |v: &Vec3| v.length_squared() / 3.0;
        let mut variance = variance_of(&parts, &old, correlation);
        for (layer, factor) in self.leaving.iter().zip(new.iter().map(square)) {
            for (index, block) in layer.light.blocks() {
                let sums = variance[index * BLOCK_SLOTS..].iter_mut();
                sums.zip(block.variance).for_each(|(sum, v)| *sum += v * factor);
            }
        }
        variance
    }
}

impl LightValues {
    /// Adds `factor` times light, and leaves the variance as it is.
    pub(crate) fn add_light(&mut self, light: AnyLight, factor: Vec3) {
        let blocks = self.direct.par_chunks_mut(BLOCK_SLOTS).zip(self.indirect.par_chunks_mut(BLOCK_SLOTS));
        blocks.enumerate().with_min_len(64).for_each(|(index, (direct, indirect))| {
            let Some(block) = light.block(index) else { return };
            direct.iter_mut().zip(block.direct).for_each(|(s, v)| *s += *v * factor);
            indirect.iter_mut().zip(block.indirect).for_each(|(s, v)| *s += *v * factor);
        });
    }

    /// Adds `factor` times independent light.
    pub(crate) fn add_scaled(&mut self, light: AnyLight, factor: Vec3) {
        let square = factor.length_squared() / 3.0;
        self.add_light(light, factor);
        let blocks = self.variance.par_chunks_mut(BLOCK_SLOTS).enumerate().with_min_len(64);
        blocks.for_each(|(index, variance)| {
            let Some(block) = light.block(index) else { return };
            variance.iter_mut().zip(block.variance).for_each(|(s, v)| *s += *v * square);
        });
    }
}

/// A layer under another header.
pub(crate) fn renamed(layer: &Arc<Layer>, header: &LayerHeader) -> Arc<Layer> {
    if layer.name == header.name && layer.lights == header.lights {
        return layer.clone();
    }
    Arc::new(Layer { name: header.name.clone(), lights: header.lights.clone(), light: layer.light.clone() })
}
