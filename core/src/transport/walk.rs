//! Light that arrives along a ray, looked up at the surface that it meets, with the near-field rule: hits nearer than
//! two spacings of the elements there are not looked up. A map interpolated across a contact leaks there (in a
//! prototype without the rule 0.2 % of the elements carried 54 % of the squared bias). Light is sampled at the hit
//! instead, and the path goes on.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::direct::one_light;
use super::incoming::{Radiance, Source};
use super::{Spots, Surfel};
use crate::bits::Bits;
use crate::bvh::Ray;
use crate::random::Pcg32;
use crate::sampling::cosine_hemisphere;
use crate::space::{Footprint, Patch};
use crate::value::Value;
use crate::world::{Placed, World};

/// Hits nearer than this many spacings of the elements there are near.
const NEAR: f32 = 2.0;

/// Square of the distance between elements over the area of one: a little more than that of a square grid.
const AREA_TO_SPACING: f32 = 1.5;

/// Near hits are followed at most this often before the map is trusted anyway.
const NEAR_DEPTH: u32 = 16;

/// From here on a walk ends by Russian roulette.
const ROULETTE_DEPTH: u32 = 3;

/// Backs without elements are followed until here.
const MAX_DEPTH: u32 = 64;

/// How a path ended.
pub(crate) enum End {
    /// At a surface that has elements and can be looked up. The weight is the product of all albedos met, its own
    /// included, and of what tinted surfaces on the way left.
    Landed(Surfel, Vec3),
    /// It left the scene after a near surface, in this direction: what lights that surface from outside.
    Escaped(Vec3, Vec3),
    /// Nothing more comes along it.
    Absorbed,
}

/// Follows a ray to the first surface that can be looked up. `visit(surfel, weight, near)` sees all surfaces on the
/// way, the last one included, with the product of the albedos and tints before it; near ones are not looked up.
#[inline]
pub(crate) fn walk(
    world: &World,
    origin: Vec3,
    direction: Vec3,
    rng: &mut Pcg32,
    rays: &mut u64,
    mut visit: impl FnMut(&Surfel, Vec3, bool, &mut Pcg32, &mut u64),
) -> End {
    let mut ray = Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY };
    let mut weight = Vec3::ONE;
    for depth in 0..MAX_DEPTH {
        *rays += 1;
        let Some(hit) = world.trees.first_hit(&ray, &mut weight) else {
            return if depth > 0 { End::Escaped(weight, ray.direction) } else { End::Absorbed };
        };
        let Some(surfel) = Surfel::to_look_up(world, &ray, &hit, rays) else { return End::Absorbed };
        let is_near = match &surfel.footprint {
            None => true,
            Some(footprint) => depth < NEAR_DEPTH && is_near(world, footprint, hit.t * hit.t),
        };
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
        ray.origin = surfel.ray_origin();
        ray.direction = cosine_hemisphere(surfel.normal, rng.next_2d());
    }
    End::Absorbed
}

/// Whether elements are not to be looked up from a distance, given as its square.
#[inline]
pub(crate) fn is_near(world: &World, footprint: &Footprint, distance2: f32) -> bool {
    // A fine mesh can be trusted from nearer.
    let area = footprint.slots().iter().map(|&slot| world.areas()[slot as usize]).fold(0.0, f32::max);
    let near = NEAR * world.spacing();
    distance2 < near * near && distance2 < NEAR * NEAR * AREA_TO_SPACING * area
}

/// Light to look up where paths land, irradiance / π per slot.
#[derive(Clone, Copy)]
pub(crate) struct Field<'a, V> {
    /// All light: of most look-ups it is all that is read.
    pub total: &'a [V],
    /// What of it does not come straight from lights; empty where all does.
    pub indirect: &'a [V],
    /// Where the direct light must not be looked up.
    pub rough: &'a Rough,
}

/// Cells over which direct light changes so much that interpolation between their corners would be off: at the edges of
/// shadows and close to lamps.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rough {
    /// By id.
    cells: Bits,
}

/// Difference of the direct light at a cell's corners over the mean of its size there from which on it is rough.
const ROUGH: f32 = 0.5;

impl Rough {
    /// Judges by an estimate of the direct light per slot, or of its change, that nothing else uses: the choice must not know the noise of
    /// what it chooses between.
    pub(crate) fn new(world: &World, direct: impl Fn(u32) -> f32 + Sync) -> Rough {
        let is_rough = |corners: [u32; 3]| {
            let [a, b, c] = corners.map(&direct);
            a.max(b).max(c) - a.min(b).min(c) > ROUGH / 3.0 * (a.abs() + b.abs() + c.abs())
        };
        let of_object = |placed: &Arc<Placed>| -> Vec<u32> {
            let rough = |patch: &Patch| {
                let is_rough = placed.sides().any(|side| is_rough(patch.elements.map(|element| side.start + element)));
                is_rough.then_some(placed.placement.cells.start + patch.cell)
            };
            placed.layout.of_cells(&placed.surface, rough)
        };
        let rough: Vec<u32> = world.placed.par_iter().flat_map_iter(of_object).collect();
        Rough { cells: rough.into_iter().map(|cell| cell as usize).collect() }
    }

    #[inline]
    pub(crate) fn contains(&self, cell: u32) -> bool {
        self.cells.contains(cell as usize)
    }
}

impl<V: Value> Field<'_, V> {
    /// Adds light of a surface that a path met, irradiance / π, times a share. Near ones get one sample of direct light
    /// and nothing else: the path goes on from there.
    #[inline]
    #[expect(clippy::too_many_arguments, reason = "the inner loop of all gathers")]
    pub(crate) fn add_at(
        &self,
        world: &World,
        surfel: &Surfel,
        near: bool,
        share: Vec3,
        rng: &mut Pcg32,
        rays: &mut u64,
        light: &mut V,
    ) {
        let Some(footprint) = surfel.footprint.filter(|_| !near) else {
            *light += light_at::<V>(world, surfel, rng, rays) * share;
            return;
        };
        if !self.rough.contains(surfel.cell) {
            footprint.for_each(self.total, |value, weight| light.add_scaled(value, share * weight));
            return;
        }
        if !self.indirect.is_empty() {
            footprint.for_each(self.indirect, |value, weight| light.add_scaled(value, share * weight));
        }
        let sampled = light_at::<V>(world, surfel, rng, rays) + sky_at::<V>(world, surfel, rng, rays);
        *light += sampled * share;
    }

    /// Reflected light and the sky. What lights send straight to a point is not in it.
    pub(crate) fn source<'a>(&'a self, world: &'a World, spots: Option<&'a Spots>) -> Source<'a, impl Radiance<V>, V> {
        let radiance =
            move |_: u32, surfel: &Surfel, near: bool, share: Vec3, rng: &mut Pcg32, rays: &mut u64, light: &mut V| {
                self.add_at(world, surfel, near, share * surfel.albedo, rng, rays, light);
            };
        Source { radiance, looked_up: self.total, skies: &world.emitters.skies, spots }
    }
}

/// Light that a surface gets straight from one of the lights, irradiance / π; the even part of the sky's is where a path
/// escapes.
#[inline]
pub(super) fn light_at<V: Value>(world: &World, surfel: &Surfel, rng: &mut Pcg32, rays: &mut u64) -> V {
    one_light(world, surfel.ray_origin(), surfel.normal, rng, rays)
}

/// The even part of the sky's light at a surface, one sample.
#[inline]
pub(super) fn sky_at<V: Value>(world: &World, surfel: &Surfel, rng: &mut Pcg32, rays: &mut u64) -> V {
    if !world.emitters.has_sky() {
        return V::default();
    }
    *rays += 1;
    let origin = surfel.ray_origin();
    let direction = cosine_hemisphere(surfel.normal, rng.next_2d());
    let left = world.trees.transmittance(&Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY });
    world.emitters.sky::<V>(direction) * left
}
