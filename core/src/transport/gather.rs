//! G: the mean of incoming radiance over cosine-distributed rays, per element.

use super::{Canceled, Effort, Field, Value, Work, incoming_light};
use crate::random::{Pcg32, R2, subseed};
use crate::sampling::cosine_hemisphere;
use crate::world::World;

/// Gathers a light map with the near-field rule: reflected light only. `samples` per element, times its effort.
pub(crate) fn gather<V: Value>(
    world: &World,
    field: &Field<V>,
    slots: &[u32],
    samples: u32,
    effort: &Effort,
    seed: u64,
    work: &Work,
) -> Result<Vec<V>, Canceled> {
    let seed = subseed(seed, 0x6a);
    work.map(slots, |_, slot, rays| {
        let (origin, n) = world.ray_origin(slot as usize);
        let mut rng = Pcg32::new(seed, u64::from(slot));
        let samples = effort.samples(slot, samples);
        let sequence = R2::new(&mut rng);
        let mut sum = V::default();
        for k in 0..samples {
            let direction = cosine_hemisphere(n, sequence.get(k));
            sum += incoming_light(world, field, origin, direction, &mut rng, rays);
        }
        sum / samples as f32
    })
}
