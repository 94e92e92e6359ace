//! G: the mean of incoming radiance over cosine-distributed rays, per element.

use glam::Vec3;

use super::incoming::{Radiance, Source};
use super::spots::From;
use super::{Effort, End, Work};
use crate::job::Canceled;
use crate::random::{Draws, PartSeed, Pcg32};
use crate::sampling::cosine_hemisphere;
use crate::value::Value;
use crate::world::World;

/// Gathers a light map with the near-field rule: reflected light only. `samples` per element, times its effort.
pub(crate) fn gather<V: Value>(
    world: &World,
    source: &Source<impl Radiance<V>, V>,
    slots: &[u32],
    samples: u32,
    effort: &Effort,
    seed: u64,
    work: &Work,
) -> Result<Vec<V>, Canceled> {
    let gathered = gathered(world, source, samples, effort, PartSeed::whole(seed));
    work.map(slots, |_, slot, rays| gathered(slot, rays))
}

/// What an element gathers: for [`Work::add`], which writes it into a map.
pub(crate) fn gathered<'a, V: Value>(
    world: &'a World,
    source: &'a Source<impl Radiance<V>, V>,
    samples: u32,
    effort: &'a Effort,
    seed: PartSeed,
) -> impl Fn(u32, &mut u64) -> V + Sync + 'a {
    let seed = seed.of(0x6a);
    move |slot, rays| {
        let from = world.ray_origin(slot as usize);
        let draws = &mut seed.draws(slot.into());
        gather_paths(world, source, effort.samples(slot, samples), |_| (slot, from), |_, _, _| {}, draws, rays)
    }
}

/// The mean of what arrives along so many paths. `begin(k)` is where the `k`-th begins: the element that receives and a
/// point on it; `ended(k, end, rng)` is told how it ended.
#[inline]
pub(crate) fn gather_paths<V: Value>(
    world: &World,
    source: &Source<impl Radiance<V>, V>,
    paths: u32,
    begin: impl Fn(u32) -> (u32, From),
    mut ended: impl FnMut(u32, End, &mut Pcg32),
    draws: &mut Draws,
    rays: &mut u64,
) -> V {
    let aims = source.aims(paths);
    let (sequence, aimed) = (draws.sequence(paths), draws.sequence(aims));
    let rng = &mut draws.own;
    let ratio = aims as f32 / paths as f32;
    let (mut sum, mut last) = (V::default(), None);
    for k in 0..paths {
        let (slot, from) = begin(k);
        let direction = cosine_hemisphere(from.1, sequence.get(k));
        let (end, landed) = source.along(world, slot, from, direction, ratio, rng, rays, &mut sum);
        source.add_landed(std::mem::replace(&mut last, landed).as_ref(), rng, rays, &mut sum);
        ended(k, end, rng);
    }
    source.add_landed(last.as_ref(), rng, rays, &mut sum);
    for k in 0..aims {
        let (slot, from) = begin(k);
        source.aimed(world, slot, from, aimed.get(k), (ratio, Vec3::ONE), rng, rays, &mut sum);
    }
    (sum / paths as f32).thinned()
}
