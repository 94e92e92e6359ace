//! A light map that is right made more accurate: averaged with fresh bakes, by variance. What many edits have left behind
//! of noise and bias fades, and idle time is of use.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::accumulate::Accumulator;
use crate::bake::Baker;
use crate::job::{Budget, Canceled, Observer};
use crate::lightmap::LightMap;
use crate::random::subseed;
use crate::rounds::{Phase, Rounds};
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
    let baker = Baker::new(world, seed, work);
    let compose = |sum: &Accumulator| {
        if sum.knows_variance() { blend(world, map, baker.compose(sum)) } else { map.clone() }
    };
    let stated = |map: &LightMap| Some(map.estimated_rmse(world.areas()));
    let rounds = Rounds { len: world.slots(), budget, seed, work, phase: Phase::Whole };
    rounds.run(stated, |_| false, |r| baker.round(r), compose)
}

/// The average of two independent estimates, object by object.
fn blend(world: &World, old: &LightMap, mut new: LightMap) -> LightMap {
    let (a, b) = (variances(world, old), variances(world, &new));
    for (slot, key) in world.geometry.owners.iter().enumerate() {
        let (Some(&a), Some(&b)) = (a.get(key), b.get(key)) else { continue };
        let weight = if a > 0.0 { (a / (a + b)) as f32 } else { 0.0 };
        new.direct[slot] = old.direct[slot].lerp(new.direct[slot], weight);
        new.indirect[slot] = old.indirect[slot].lerp(new.indirect[slot], weight);
        new.variance[slot] =
            (1.0 - weight) * (1.0 - weight) * old.variance[slot] + weight * weight * new.variance[slot];
    }
    new
}

/// Area-weighted mean variance per object.
fn variances(world: &World, map: &LightMap) -> BTreeMap<u32, f64> {
    let mut sums: BTreeMap<u32, (f64, f64)> = BTreeMap::new();
    for ((key, area), variance) in world.geometry.owners.iter().zip(world.areas()).zip(&map.variance) {
        let sum = sums.entry(*key).or_default();
        sum.0 += f64::from(*area) * f64::from(*variance);
        sum.1 += f64::from(*area);
    }
    sums.into_iter().filter(|(_, (_, area))| *area > 0.0).map(|(key, (sum, area))| (key, sum / area)).collect()
}
