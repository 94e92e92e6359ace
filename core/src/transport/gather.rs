//! G: the mean of incoming radiance over cosine-distributed rays, per element.

use super::incoming::{Radiance, Source};
use super::{Effort, Value, Work};
use crate::job::Canceled;
use crate::random::{Pcg32, R2, subseed};
use crate::sampling::cosine_hemisphere;
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
    let seed = subseed(seed, 0x6a);
    work.map(slots, |_, slot, rays| gather_one(world, source, slot, effort.samples(slot, samples), seed, rays))
}

/// The same, added to the light of some slots, ascending, in a map.
#[expect(clippy::too_many_arguments, reason = "those of `gather`, and where to")]
pub(crate) fn add_gathered<V: Value>(
    world: &World,
    source: &Source<impl Radiance<V>, V>,
    slots: &[u32],
    samples: u32,
    effort: &Effort,
    seed: u64,
    work: &Work,
    light: &mut [V],
) -> Result<(), Canceled> {
    let seed = subseed(seed, 0x6a);
    work.add(slots, light, |slot, rays| gather_one(world, source, slot, effort.samples(slot, samples), seed, rays))
}

/// What one element gathers.
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
