//! The ambient term of progressive radiosity (Cohen, Chen, Wallace and Greenberg 1988), layer by layer (Nielsen 2000):
//! light that has not been distributed yet, spread evenly. It makes the picture that is shown before a first bounce is
//! computed, and is in no map that anything starts from.

use glam::Vec3;
use rayon::prelude::*;

use crate::job::Canceled;
use crate::layers::Stack;
use crate::random::{Pcg32, R2, subseed};
use crate::sampling::cosine_hemisphere;
use crate::transport::{Surfel, Work};
use crate::value::Value;
use crate::world::World;

/// Elements that rays are sent from, at most.
const ELEMENTS: usize = 2048;

/// Rays of each.
const RAYS: u32 = 4;

/// A closed room without losses has no answer: albedos above this count as this.
const MOST_ALBEDO: f32 = 0.995;

/// Slots per task.
const CHUNK: usize = 4096;

/// Direct light with the ambient term as all the indirect light there is. `direct` is irradiance / π per slot, filled
/// in for invalid elements too.
pub(crate) fn with_ambient<V: Value>(
    world: &World,
    direct: Vec<V>,
    seed: u64,
    work: &Work,
) -> Result<Stack<V>, Canceled> {
    let ambient = ambient(world, &direct, seed, work)?;
    let areas = world.areas().par_iter().with_min_len(CHUNK);
    let indirect = areas.map(|area| if *area > 0.0 { ambient } else { V::default() }).collect();
    Ok(Stack::without_error(direct, indirect))
}

/// irradiance / π of all bounces of `direct`, were every element to see what elements see on average: light `u` sent
/// back at the first bounce, surfaces of albedo `a` (0 where there is none, black and open alike), `u / (1 − a)` after
/// all.
fn ambient<V: Value>(world: &World, direct: &[V], seed: u64, work: &Work) -> Result<V, Canceled> {
    let slots = world.computed_slots();
    let slots: Vec<u32> = slots.iter().copied().step_by(slots.len().div_ceil(ELEMENTS).max(1)).collect();
    let seed = subseed(seed, 0xa3b);
    let seen: Vec<(V, Vec3)> = work.map(&slots, |_, slot, rays| {
        let (origin, n) = world.ray_origin(slot as usize);
        let mut rng = Pcg32::new(seed, u64::from(slot));
        let sequence = R2::new(&mut rng);
        let (mut sent, mut albedo) = (V::default(), Vec3::ZERO);
        for k in 0..RAYS {
            let ray = crate::bvh::Ray {
                origin,
                direction: cosine_hemisphere(n, sequence.get(k)),
                t_min: 0.0,
                t_max: f32::INFINITY,
            };
            *rays += 1;
            let mut reflected = Vec3::ONE;
            let hit = world.trees.first_hit(&ray, &mut reflected);
            let Some(surfel) = hit.and_then(|hit| Surfel::new(world, &ray, &hit)) else {
                continue;
            };
            reflected *= surfel.albedo;
            albedo += reflected;
            if let Some(footprint) = surfel.footprint {
                sent += footprint.interpolate(direct) * reflected;
            }
        }
        (sent / RAYS as f32, albedo / RAYS as f32)
    })?;
    let (mut sent, mut albedo, mut area) = (V::default(), Vec3::ZERO, 0.0);
    for (&slot, (its_sent, its_albedo)) in slots.iter().zip(seen) {
        let its_area = world.areas()[slot as usize];
        sent += its_sent * its_area;
        albedo += its_albedo * its_area;
        area += its_area;
    }
    if area <= 0.0 {
        return Ok(V::default());
    }
    Ok((sent / area) * (1.0 - (albedo / area).min(Vec3::splat(MOST_ALBEDO))).recip())
}
