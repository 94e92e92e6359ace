//! Path tracing from scratch, element by element: the honest baseline and the reference of every measurement.

use glam::Vec3;

use crate::bvh::Ray;
use crate::job::{Canceled, Observer};
use crate::random::{Pcg32, R2, subseed};
use crate::sampling::cosine_hemisphere;
use crate::transport::direct::one_light;
use crate::transport::{DirectLight, Surfel, Work};
use crate::world::World;

/// Paths end by Russian roulette from this vertex on.
const ROULETTE_DEPTH: u32 = 4;

/// No path is longer; what is cut is below 0.99^512.
const MAX_DEPTH: u32 = 512;

/// Samples per batch: batch means give the variance.
const BATCHES: u32 = 16;

/// Path-traced light of one element, irradiance / π.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PathTraced {
    /// Straight from lights.
    pub direct: Vec3,
    /// After at least one bounce.
    pub indirect: Vec3,
    /// Variance of the mean of `indirect`, per channel.
    pub indirect_variance: Vec3,
    /// Variance of the mean of `direct + indirect`, per channel.
    pub total_variance: Vec3,
}

/// Traces at least `samples` paths (a multiple of 16) for each of `slots`: cosine sampling with light sampling at
/// every vertex, Russian roulette, no cut that matters, no clamping. Elements inside solids come out as they are.
pub fn path_trace(
    world: &World,
    slots: &[u32],
    samples: u32,
    seed: u64,
    observer: &dyn Observer,
) -> Result<(Vec<PathTraced>, u64), Canceled> {
    let work = Work::new(observer);
    let per_batch = samples.div_ceil(BATCHES).max(1);
    let direct_light = DirectLight::new(world, per_batch);
    let seed = subseed(seed, 0x9a7);
    let traced = work.map(slots, |_, slot, rays| {
        let (point, n) = world.ray_origin(slot as usize);
        let mut rng = Pcg32::new(seed, u64::from(slot));
        let mut batches = [(Vec3::ZERO, Vec3::ZERO); BATCHES as usize];
        for batch in &mut batches {
            let sequence = R2::new(&mut rng);
            let mut indirect = Vec3::ZERO;
            for k in 0..per_batch {
                indirect += path(world, point, cosine_hemisphere(n, sequence.get(k)), &mut rng, rays);
            }
            *batch = (direct_light.estimate(world, point, n, &mut rng, rays), indirect / per_batch as f32);
        }
        summarize(&batches)
    })?;
    Ok((traced, work.rays()))
}

fn summarize(batches: &[(Vec3, Vec3)]) -> PathTraced {
    let n = batches.len() as f32;
    let direct = batches.iter().map(|b| b.0).sum::<Vec3>() / n;
    let indirect = batches.iter().map(|b| b.1).sum::<Vec3>() / n;
    let variance = |value: &dyn Fn(&(Vec3, Vec3)) -> Vec3, mean: Vec3| {
        batches.iter().map(|b| (value(b) - mean) * (value(b) - mean)).sum::<Vec3>() / (n * (n - 1.0))
    };
    PathTraced {
        direct,
        indirect,
        indirect_variance: variance(&|b| b.1, indirect),
        total_variance: variance(&|b| b.0 + b.1, direct + indirect),
    }
}

/// Light reflected towards `origin` from `direction`.
fn path(world: &World, origin: Vec3, direction: Vec3, rng: &mut Pcg32, rays: &mut u64) -> Vec3 {
    let mut ray = Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY };
    let (mut radiance, mut beta) = (Vec3::ZERO, Vec3::ONE);
    for depth in 1..MAX_DEPTH {
        *rays += 1;
        let Some(hit) = world.trees.closest_hit(&ray) else {
            if depth > 1 {
                radiance += beta * world.emitters.environment;
            }
            break;
        };
        let Some(surfel) = Surfel::new(world, &ray, &hit) else { break };
        beta *= surfel.albedo;
        if beta == Vec3::ZERO {
            break;
        }
        if depth >= ROULETTE_DEPTH {
            let survive = beta.max_element().min(0.95);
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
