//! G: the mean of incoming radiance over cosine-distributed rays, per element.

use super::incoming::{Radiance, Source};
use super::{Canceled, Effort, Value, Work};
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
    work.map(slots, |_, slot, rays| {
        let from = world.ray_origin(slot as usize);
        let mut rng = Pcg32::new(seed, u64::from(slot));
        let samples = effort.samples(slot, samples);
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
    })
}
