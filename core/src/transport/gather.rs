//! G: the mean of incoming radiance over cosine-distributed rays, per element.

use super::incoming::{Radiance, Source};
use super::{Effort, Work};
use crate::job::Canceled;
use crate::random::{Pcg32, R2, subseed};
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
    let gathered = gathered(world, source, samples, effort, seed);
    work.map(slots, |_, slot, rays| gathered(slot, rays))
}

/// What an element gathers: for [`Work::add`], which writes it into a map.
pub(crate) fn gathered<'a, V: Value>(
    world: &'a World,
    source: &'a Source<impl Radiance<V>, V>,
    samples: u32,
    effort: &'a Effort,
    seed: u64,
) -> impl Fn(u32, &mut u64) -> V + Sync + 'a {
    let seed = subseed(seed, 0x6a);
    move |slot, rays| gather_one(world, source, slot, effort.samples(slot, samples), seed, rays)
}

#[inline]
fn gather_one<V: Value>(
    world: &World,
    source: &Source<impl Radiance<V>, V>,
    slot: u32,
    samples: u32,
    seed: u64,
    rays: &mut u64,
) -> V {
    let from = world.ray_origin(slot as usize);
    let mut rng = Pcg32::new(seed, u64::from(slot));
    let sequence = R2::new(&mut rng);
    let aims = source.aims(samples);
    let ratio = aims as f32 / samples as f32;
    let (mut sum, mut last) = (V::default(), None);
    for k in 0..samples {
        let direction = cosine_hemisphere(from.1, sequence.get(k));
        let (_, landed) = source.along(world, slot, from, direction, ratio, &mut rng, rays, &mut sum);
        source.add_landed(std::mem::replace(&mut last, landed).as_ref(), &mut rng, rays, &mut sum);
    }
    source.add_landed(last.as_ref(), &mut rng, rays, &mut sum);
    let sequence = R2::new(&mut rng);
    for k in 0..aims {
        sum += source.aimed(world, slot, from, sequence.get(k), ratio, &mut rng, rays);
    }
    sum / samples as f32
}
