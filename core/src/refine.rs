//! A light map that is right made more accurate: averaged with fresh bakes, by variance. What many edits have left
//! behind of noise and bias fades, and idle time is of use.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use crate::bake::bake_map;
use crate::importance::Importance;
use crate::job::{Budget, Canceled, Observer};
use crate::layers::{headers_of_layers, less_sure};
use crate::lightmap::{BLOCK_SLOTS, Layer, LightBlock, LightMap, LightValues, SparseLight, blocks_of};
use crate::random::subseed;
use crate::rounds::Goal;
use crate::transport::Work;
use crate::world::World;

/// Improves `map`, which is right for `world`, until the budget or the observer ends it. Snapshots are averages of the
/// map and of what was baked so far, each object by the inverse of its mean variances: the error that is stated falls
/// with every one. A map that states no error (zero variance everywhere) is taken at its word and stays.
pub fn refine(
    world: &World,
    map: &LightMap,
    budget: &Budget,
    seed: u64,
    observer: &dyn Observer,
) -> Result<Arc<LightMap>, Canceled> {
    let work = Work::new(observer);
    let refined = refine_with(world, map, budget, seed, &work)?;
    Ok(refined.unwrap_or_else(|| Arc::new(map.clone())))
}

/// As [`refine`]; none where no round was run.
pub(crate) fn refine_with(
    world: &World,
    map: &LightMap,
    budget: &Budget,
    seed: u64,
    work: &Work,
) -> Result<Option<Arc<LightMap>>, Canceled> {
    let seed = subseed(seed, 0x4ef1);
    // Lamps that are off take no part where layers are many.
    let (map, dark) = map.at_strength_of(&world.scene, &world.scene).without_dark(&world.scene);
    let map = &map;
    // The old map stays until the new one's variance is known.
    let improve = |new: LightMap| {
        let is_known = new.light.variance.iter().any(|v| *v > 0.0);
        let mut refined = if is_known { blend(world, map, new) } else { map.clone() };
        dark.iter().for_each(|(place, layer)| refined.layers.insert(*place, layer.clone()));
        // What was left of those is in the new rest no more.
        if let Some(rest) = refined.rest().filter(|_| !dark.is_empty()).map(|rest| less_sure(rest, 1.0)) {
            refined.layers[0] = rest;
        }
        refined
    };
    let importance = &Importance::default();
    let goal = Goal { budget, importance, seed, estimates: false, guesses: false, offers: true };
    bake_map(world, &headers_of_layers(map), &improve, &goal, work)
}

/// The average of two independent estimates, object by object.
fn blend(world: &World, old: &LightMap, mut new: LightMap) -> LightMap {
    let (a, b) = (variances(world, old), variances(world, &new));
    let mut weights = vec![1.0; new.len()];
    for (slot, key) in world.space.slots().owners.iter().enumerate() {
        let (Some(&a), Some(&b)) = (a.get(key), b.get(key)) else { continue };
        let weight = if a > 0.0 { (a / (a + b)) as f32 } else { 0.0 };
        weights[slot] = weight;
    }
    let LightValues { direct, indirect, variance } = &old.light;
    mix(&mut new.light, &LightBlock { direct, indirect, variance }, &weights);
    let layers = new.layers.iter_mut().zip(&old.layers);
    for (new, old) in layers {
        let light = mix_layers(&new.light, &old.light, &weights);
        *new = Arc::new(Layer { name: new.name.clone(), lights: new.lights.clone(), light });
    }
    new
}

/// Takes a part, per slot, of `new`, and the rest of `old`.
fn mix(new: &mut LightValues, old: &LightBlock, weights: &[f32]) {
    let light = |new: &mut [Vec3], old: &[Vec3]| {
        new.iter_mut().zip(old).zip(weights).for_each(|((n, o), w)| *n = o.lerp(*n, *w));
    };
    light(&mut new.direct, old.direct);
    light(&mut new.indirect, old.indirect);
    let variances = new.variance.iter_mut().zip(old.variance).zip(weights);
    variances.for_each(|((n, o), w)| *n = (1.0 - w) * (1.0 - w) * o + w * w * *n);
}

/// As [`mix`], in blocks that either has.
fn mix_layers(new: &SparseLight, old: &SparseLight, weights: &[f32]) -> SparseLight {
    let slots = new.len();
    let black = LightValues::black(BLOCK_SLOTS);
    let mixed = |index: usize| {
        let own = index * BLOCK_SLOTS..slots.min((index + 1) * BLOCK_SLOTS);
        let (a, b) = (new.block(index), old.block(index));
        let is_there = a.is_some() || b.is_some();
        is_there.then(|| {
            let none = black.range(0, own.len());
            let mut values = LightValues::of_block(&a.unwrap_or(none));
            mix(&mut values, &b.unwrap_or(none), &weights[own]);
            (index, values)
        })
    };
    let blocks: Vec<(usize, LightValues)> = (0..blocks_of(slots)).into_par_iter().filter_map(mixed).collect();
    SparseLight::of_blocks(slots, blocks.iter().map(|(index, values)| (*index, values.block(0))))
}

/// Area-weighted mean variance per object.
fn variances(world: &World, map: &LightMap) -> BTreeMap<u32, f64> {
    let mut sums: BTreeMap<u32, (f64, f64)> = BTreeMap::new();
    for ((key, area), variance) in world.space.slots().owners.iter().zip(world.areas().iter()).zip(&map.light.variance)
    {
        let sum = sums.entry(*key).or_default();
        sum.0 += f64::from(*area) * f64::from(*variance);
        sum.1 += f64::from(*area);
    }
    sums.into_iter().filter(|(_, (_, area))| *area > 0.0).map(|(key, (sum, area))| (key, sum / area)).collect()
}
