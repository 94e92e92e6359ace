//! Noise averaged away where it may be: an element takes in those near it on the surface whose light, as far as the
//! errors of both tell, may be the same.
//!
//! What is averaged is decided by the statistics of the map itself, not by an image: after Sakai et al., A statistical
//! approach to Monte Carlo denoising (SIGGRAPH Asia 2024), with a fixed number of standard errors as the test, and
//! weights that are the same both ways, so that the light of all together, by area, stays as it is.

mod nearby;
#[cfg(test)]
mod tests;
mod weights;

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use crate::job::{Canceled, Observer};
use crate::lightmap::{Layer, LightMap, LightValues};
use crate::world::World;
use weights::Weights;

/// Bytes per slot that filtering takes for its time, beside the map that it gives.
pub const BYTES_PER_SLOT: usize = 512;

/// Slots per task.
const CHUNK: usize = 4096;

/// A light map whose noise is averaged away where it may be: direct and indirect light, and those of every layer, with the
/// same weights, so that parts and layers add up as they did; of many layers, the rest alone takes the change, and may be negative. The mean of all light by area stays as it is, and light that
/// is nowhere negative stays so. The variance is the expected squared error of what is returned: that of the means,
/// and, for what averages blur, the square of what averaging once more would change. Elements of which `is_known` says no,
/// and those without variance, keep what they have.
///
/// # Errors
/// [`Canceled`] where the observer says so.
///
/// # Panics
/// Where the map has not one value per slot of the world.
pub fn filter(
    world: &World,
    map: &LightMap,
    is_known: impl Fn(usize) -> bool + Sync,
    observer: &dyn Observer,
) -> Result<LightMap, Canceled> {
    assert_eq!(map.len(), world.slots(), "one value per slot");
    let stated = |slot: usize| world.stated().of(map.light.direct[slot], map.light.indirect[slot]);
    let light: Vec<Vec3> = (0..map.len()).into_par_iter().with_min_len(CHUNK).map(stated).collect();
    let own = |(slot, v): (usize, &f32)| if v.is_finite() && is_known(slot) { v.max(0.0) } else { 0.0 };
    let own: Vec<f32> = map.light.variance.par_iter().enumerate().with_min_len(CHUNK).map(own).collect();
    let weights = Weights::new(world, &light, &own, observer)?;
    let average = |values: &[Vec3]| {
        let mut averaged = weights.average(values);
        world.validity.fill(&mut averaged);
        averaged
    };
    let filtered = |light: &LightValues| {
        let (direct, indirect) = (average(&light.direct), average(&light.indirect));
        let stated = |slot: usize| world.stated().of(direct[slot], indirect[slot]);
        let mut variance = weights.squared_errors(stated, &light.variance);
        world.validity.fill(&mut variance);
        LightValues { direct, indirect, variance }
    };
    let layer = |layer: &Arc<Layer>| {
        if observer.canceled() {
            return Err(Canceled);
        }
        let (name, lights) = (layer.name.clone(), layer.lights.clone());
        Ok(Arc::new(Layer { name, lights, light: filtered(&layer.light.to_dense()).into() }))
    };
    let light = filtered(&map.light);
    let layers = match map.rest() {
        Some(rest) => with_rest_of(map, rest, &light),
        None => map.layers.iter().map(layer).collect::<Result<_, _>>()?,
    };
    Ok(LightMap { light, layers })
}

/// Many layers stay as they are, each where it matters; what filtering changes is in the rest.
fn with_rest_of(map: &LightMap, rest: &Layer, filtered: &LightValues) -> Vec<Arc<Layer>> {
    let mut light = rest.light.to_dense();
    let change = |rest: &mut [Vec3], old: &[Vec3], new: &[Vec3]| {
        let pairs = rest.par_iter_mut().zip(old.par_iter().zip(new)).with_min_len(CHUNK);
        pairs.for_each(|(rest, (old, new))| *rest += *new - *old);
    };
    change(&mut light.direct, &map.light.direct, &filtered.direct);
    change(&mut light.indirect, &map.light.indirect, &filtered.indirect);
    let mut layers = map.layers.clone();
    layers[0] = Arc::new(Layer { name: rest.name.clone(), lights: Vec::new(), light: light.into() });
    layers
}
