//! Light that arrives along a ray, looked up in a light map, with the near-field rule.

use glam::Vec3;

use super::Surfel;
use super::direct::one_light;
use crate::bvh::Ray;
use crate::random::Pcg32;
use crate::sampling::cosine_hemisphere;
use crate::world::World;

/// Near hits are followed at most this often before the map is trusted anyway.
const NEAR_DEPTH: u32 = 4;

/// Backs without elements are followed until here.
const MAX_DEPTH: u32 = 24;

/// A light map to look up: direct + indirect per slot.
#[derive(Clone, Copy)]
pub(crate) struct LightField<'a> {
    /// irradiance / π.
    pub total: &'a [Vec3],
    /// Hits nearer than this (metres) are not looked up: a map interpolated across a contact leaks there (design,
    /// section 2: 0.2 % of the elements carried 54 % of the squared bias). Light is sampled at the hit instead and
    /// the path goes on.
    pub near: f32,
}

/// Reflected radiance that arrives at `origin` from `direction`. What lights send there directly is not in it.
#[inline]
pub(crate) fn incoming_light(
    world: &World,
    field: &LightField,
    origin: Vec3,
    direction: Vec3,
    rng: &mut Pcg32,
    rays: &mut u64,
) -> Vec3 {
    let mut ray = Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY };
    let (mut radiance, mut beta) = (Vec3::ZERO, Vec3::ONE);
    for depth in 0..MAX_DEPTH {
        *rays += 1;
        let Some(hit) = world.trees.closest_hit(&ray) else {
            if depth > 0 {
                radiance += beta * world.emitters.environment;
            }
            break;
        };
        let Some(surfel) = Surfel::to_look_up(world, &ray, &hit, rays) else { break };
        beta *= surfel.albedo;
        if beta == Vec3::ZERO {
            break;
        }
        if let Some(elements) = surfel.elements
            && (hit.t >= field.near || depth >= NEAR_DEPTH)
        {
            radiance += beta * surfel.interpolate(elements, field.total);
            break;
        }
        if depth >= NEAR_DEPTH {
            // Russian roulette inside cavities whose backs have no elements.
            let survive = beta.max_element().clamp(0.0, 0.95);
            if rng.next_f32() >= survive {
                break;
            }
            beta /= survive;
        }
        let point = surfel.position + surfel.normal * world.epsilon;
        radiance += beta * one_light(world, point, surfel.normal, rng, rays);
        ray.origin = point;
        ray.direction = cosine_hemisphere(surfel.normal, rng.next_2d());
    }
    radiance
}
