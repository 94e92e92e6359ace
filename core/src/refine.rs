//! A light map that is right made more accurate: averaged with fresh bakes, by variance. What many edits have left
//! behind of noise and bias fades, and idle time is of use.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::Vec3;

use crate::bake::bake_map;
use crate::importance::Importance;
use crate::job::{Budget, Canceled, Observer};
use crate::layers::headers_of_layers;
use crate::lightmap::{LightMap, LightValues};
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
    // The old map stays until the new one's variance is known.
    let improve = |new: LightMap| {
        if new.light.variance.iter().any(|v| *v > 0.0) { blend(world, map, new) } else { map.clone() }
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
    let mix = |new: &mut [Vec3], old: &[Vec3]| {
        new.iter_mut().zip(old).zip(&weights).for_each(|((n, o), w)| *n = o.lerp(*n, *w));
    };
    let mix_all = |new: &mut LightValues, old: &LightValues| {
        mix(&mut new.direct, &old.direct);
        mix(&mut new.indirect, &old.indirect);
        let pairs = new.variance.iter_mut().zip(&old.variance).zip(&weights);
        pairs.for_each(|((n, o), w)| *n = (1.0 - w) * (1.0 - w) * o + w * w * *n);
    };
    mix_all(&mut new.light, &old.light);
    let layers = new.layers.iter_mut().zip(&old.layers);
    layers.for_each(|(new, old)| mix_all(&mut Arc::make_mut(new).light, &old.light));
    new
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
