//! Path tracing from scratch, element by element: the honest baseline and the reference of every measurement.
//!
//! Every vertex samples lights and a cosine-distributed direction; a light that both can find counts in both by the
//! balance heuristic (Veach and Guibas 1995), so that neither large or near lights nor small ones are noisy.

mod lights;

use glam::Vec3;

use self::lights::Lights;
use rebake_core::bvh::Ray;
use rebake_core::random::{Pcg32, R2, subseed};
use rebake_core::sampling::cosine_hemisphere;
use rebake_core::transport::{Surfel, Work};
use rebake_core::{Canceled, Observer, World};

/// Paths end by Russian roulette from this vertex on.
const ROULETTE_DEPTH: u32 = 4;

/// No path is longer; what is cut is below 0.99^512.
const MAX_DEPTH: u32 = 512;

/// Samples per element come in at most this many batches: their means tell the variance.
const BATCHES: u32 = 16;

/// Path-traced light of one element, irradiance / π.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PathTraced {
    /// Straight from lights.
    pub direct: Vec3,
    /// After at least one bounce.
    pub indirect: Vec3,
    /// Variance of the mean of `indirect`, per channel; 0 for a single sample.
    pub indirect_variance: Vec3,
    /// Variance of the mean of `direct + indirect`, per channel; 0 for a single sample.
    pub total_variance: Vec3,
}

/// Traces at least `samples` paths for each of `slots` (from 16 on a multiple of 16): light sampling at every vertex
/// and cosine-distributed directions combined by the balance heuristic, Russian roulette, no cut that matters, no
/// clamping. Invalid elements come out as they are, not as their neighbours. Also answers the number of rays.
pub fn path_trace(
    world: &World,
    slots: &[u32],
    samples: u32,
    seed: u64,
    observer: &dyn Observer,
) -> Result<(Vec<PathTraced>, u64), Canceled> {
    let work = Work::new(observer);
    let batches = BATCHES.min(samples.max(1));
    let per_batch = samples.div_ceil(batches).max(1);
    let lights = Lights::new(world, per_batch);
    let seed = subseed(seed, 0x9a7);
    let traced = work.map(slots, |_, slot, rays| {
        let (point, n) = world.ray_origin(slot as usize);
        let mut rng = Pcg32::new(seed, u64::from(slot));
        let mut sums = Sums::default();
        for batch in 0..batches {
            let mut direct = lights.stratified(point, n, &mut rng, rays);
            let sequence = R2::new(&mut rng);
            let mut indirect = Vec3::ZERO;
            for k in 0..per_batch {
                let first = Ray { origin: point, direction: cosine_hemisphere(n, sequence.get(k)), ..FREE };
                // A stream of its own: where two worlds look alike to a path it is the same in both.
                let mut rng = Pcg32::new(subseed(seed, 1 + u64::from(batch * per_batch + k)), u64::from(slot));
                let (d, i) = path(&lights, n, first, &mut rng, rays);
                direct += d / per_batch as f32;
                indirect += i / per_batch as f32;
            }
            sums.add(direct, indirect);
        }
        sums.finish(batches)
    })?;
    Ok((traced, work.rays()))
}

const FREE: Ray = Ray { origin: Vec3::ZERO, direction: Vec3::ZERO, t_min: 0.0, t_max: f32::INFINITY };

/// Sums over batches, and of their squares.
#[derive(Default)]
struct Sums {
    direct: Vec3,
    indirect: Vec3,
    indirect2: Vec3,
    total2: Vec3,
}

impl Sums {
    fn add(&mut self, direct: Vec3, indirect: Vec3) {
        self.direct += direct;
        self.indirect += indirect;
        self.indirect2 += indirect * indirect;
        self.total2 += (direct + indirect) * (direct + indirect);
    }

    fn finish(&self, batches: u32) -> PathTraced {
        let n = batches as f32;
        let (direct, indirect) = (self.direct / n, self.indirect / n);
        let variance = |squares: Vec3, mean: Vec3| {
            if batches < 2 { Vec3::ZERO } else { (squares / n - mean * mean).max(Vec3::ZERO) / (n - 1.0) }
        };
        PathTraced {
            direct,
            indirect,
            indirect_variance: variance(self.indirect2, indirect),
            total_variance: variance(self.total2, direct + indirect),
        }
    }
}

/// One path whose first ray starts with normal `n`: what its first hit sends out (its share of direct light, beside
/// [`Lights::stratified`]) and what comes later (indirect light).
fn path(lights: &Lights, mut n: Vec3, mut ray: Ray, rng: &mut Pcg32, rays: &mut u64) -> (Vec3, Vec3) {
    let world = lights.world;
    let (mut direct, mut indirect, mut beta) = (Vec3::ZERO, Vec3::ZERO, Vec3::ONE);
    for depth in 1..MAX_DEPTH {
        *rays += 1;
        let hit = world.trees().first_hit(&ray, &mut beta);
        let emitted = match &hit {
            Some(hit) if depth == 1 => lights.met_by_first(n, &ray, hit),
            Some(hit) => lights.met(n, &ray, hit),
            None => world.even_sky(ray.direction),
        };
        *(if depth == 1 { &mut direct } else { &mut indirect }) += beta * emitted;
        let Some(surfel) = hit.and_then(|hit| Surfel::without_light(world, &ray, &hit)) else { break };
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
        n = surfel.normal;
        let point = surfel.ray_origin();
        indirect += beta * lights.sampled(point, n, rng, rays);
        ray = Ray { origin: point, direction: cosine_hemisphere(n, rng.next_2d()), ..FREE };
    }
    (direct, indirect)
}
