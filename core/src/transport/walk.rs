//! Light that arrives along a ray, looked up at the surface that it meets, with the near-field rule: hits nearer than
//! two spacings are not looked up. A map interpolated across a contact leaks there (design, section 2: 0.2 % of the
//! elements carried 54 % of the squared bias). Light is sampled at the hit instead, and the path goes on.

use glam::Vec3;

use super::Surfel;
use super::direct::one_light;
use crate::bvh::Ray;
use crate::random::Pcg32;
use crate::sampling::cosine_hemisphere;
use crate::world::World;

/// Hits nearer than this many spacings are near.
const NEAR: f32 = 2.0;

/// Near hits are followed at most this often before the map is trusted anyway.
const NEAR_DEPTH: u32 = 16;

/// From here on a walk ends by Russian roulette.
const ROULETTE_DEPTH: u32 = 3;

/// Backs without elements are followed until here.
const MAX_DEPTH: u32 = 64;

/// How a path ended.
pub(crate) enum End {
    /// At a surface that has elements and can be looked up. The weight is the product of all albedos met, its own
    /// included.
    Landed(Surfel, Vec3),
    /// It left the scene after a near surface: what lights that surface from outside.
    Escaped(Vec3),
    /// Nothing more comes along it.
    Absorbed,
}

/// Follows a ray to the first surface that can be looked up. `visit(surfel, weight, near)` sees all surfaces on the way,
/// the last one included, with the product of the albedos before it; near ones are not looked up.
#[inline]
pub(crate) fn walk(
    world: &World,
    origin: Vec3,
    direction: Vec3,
    rng: &mut Pcg32,
    rays: &mut u64,
    mut visit: impl FnMut(&Surfel, Vec3, bool, &mut Pcg32, &mut u64),
) -> End {
    let near = NEAR * world.spacing();
    let mut ray = Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY };
    let mut weight = Vec3::ONE;
    for depth in 0..MAX_DEPTH {
        *rays += 1;
        let Some(hit) = world.trees.closest_hit(&ray) else {
            return if depth > 0 { End::Escaped(weight) } else { End::Absorbed };
        };
        let Some(surfel) = Surfel::to_look_up(world, &ray, &hit, rays) else { return End::Absorbed };
        let is_near = surfel.elements.is_none() || hit.t < near && depth < NEAR_DEPTH;
        visit(&surfel, weight, is_near, rng, rays);
        weight *= surfel.albedo;
        if weight == Vec3::ZERO {
            return End::Absorbed;
        }
        if !is_near {
            return End::Landed(surfel, weight);
        }
        if depth >= ROULETTE_DEPTH {
            let survive = weight.max_element().clamp(0.0, 0.95);
            if rng.next_f32() >= survive {
                return End::Absorbed;
            }
            weight /= survive;
        }
        ray.origin = surfel.position + surfel.normal * world.epsilon;
        ray.direction = cosine_hemisphere(surfel.normal, rng.next_2d());
    }
    End::Absorbed
}

/// Reflected radiance that arrives at `origin` from `direction`; `total` is irradiance / π per slot. What lights send
/// there directly is not in it.
#[inline]
pub(crate) fn incoming_light(
    world: &World,
    total: &[Vec3],
    origin: Vec3,
    direction: Vec3,
    rng: &mut Pcg32,
    rays: &mut u64,
) -> Vec3 {
    let mut radiance = Vec3::ZERO;
    let end = walk(world, origin, direction, rng, rays, |surfel, weight, near, rng, rays| {
        let light = match surfel.elements {
            Some(elements) if !near => surfel.interpolate(elements, total),
            _ => light_at(world, surfel, rng, rays),
        };
        radiance += weight * surfel.albedo * light;
    });
    if let End::Escaped(weight) = end {
        radiance += weight * world.emitters.environment;
    }
    radiance
}

/// Light that a surface gets straight from one of the lights, irradiance / π; the sky's is where a path escapes.
#[inline]
pub(crate) fn light_at(world: &World, surfel: &Surfel, rng: &mut Pcg32, rays: &mut u64) -> Vec3 {
    one_light(world, surfel.position + surfel.normal * world.epsilon, surfel.normal, rng, rays)
}
