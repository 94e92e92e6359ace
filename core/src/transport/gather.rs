//! G: the mean of incoming radiance over cosine-distributed rays, per element.

use glam::Vec3;

use super::{Canceled, LightField, Surfel, Work, incoming_light};
use crate::bvh::Ray;
use crate::random::{Pcg32, R2, subseed};
use crate::sampling::cosine_hemisphere;
use crate::world::World;

/// Gathers a light map with the near-field rule: reflected light only.
pub(crate) fn gather(
    world: &World,
    field: &LightField,
    slots: &[u32],
    samples: u32,
    seed: u64,
    work: &Work,
) -> Result<Vec<Vec3>, Canceled> {
    let seed = subseed(seed, 0x6a);
    work.map(slots, |_, slot, rays| {
        let (origin, n) = world.ray_origin(slot as usize);
        let mut rng = Pcg32::new(seed, u64::from(slot));
        let sequence = R2::new(&mut rng);
        let mut sum = Vec3::ZERO;
        for k in 0..samples {
            let direction = cosine_hemisphere(n, sequence.get(k));
            sum += incoming_light(world, field, origin, direction, &mut rng, rays);
        }
        sum / samples as f32
    })
}

/// Gathers any radiance that is a function of the point met; `visit` sees every reflecting hit.
pub(crate) fn gather_with(
    world: &World,
    slot: u32,
    samples: u32,
    seed: u64,
    rays: &mut u64,
    mut visit: impl FnMut(&Surfel) -> Vec3,
) -> Vec3 {
    let (origin, n) = world.ray_origin(slot as usize);
    let mut rng = Pcg32::new(seed, u64::from(slot));
    let sequence = R2::new(&mut rng);
    let mut sum = Vec3::ZERO;
    for k in 0..samples {
        let ray = Ray { origin, direction: cosine_hemisphere(n, sequence.get(k)), t_min: 0.0, t_max: f32::INFINITY };
        *rays += 1;
        if let Some(hit) = world.trees.closest_hit(&ray)
            && let Some(surfel) = Surfel::new(world, &ray, &hit)
        {
            sum += visit(&surfel);
        }
    }
    sum / samples as f32
}
