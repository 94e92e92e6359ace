//! Light that arrives at a point along one direction.

use glam::Vec3;

use super::spots::From;
use super::walk::is_near;
use super::{End, Spots, Surfel, walk};
use crate::bvh::Ray;
use crate::random::Pcg32;
use crate::value::Value;
use crate::world::{Emitter, World, sky};

/// Directions drawn by the cosine for each one that is aimed at a spot.
const COSINES_PER_AIM: u32 = 4;

/// Adds to light what a surface sends to a point, times a share: `f(receiver, surfel, near, share, rng, rays, light)`. The
/// receiver is an element slot, or `u32::MAX` where an object has no elements; near surfaces are not to be looked up where
/// their light can be had otherwise.
pub(crate) trait Radiance<V>: Fn(u32, &Surfel, bool, Vec3, &mut Pcg32, &mut u64, &mut V) + Sync {}

impl<V, F: Fn(u32, &Surfel, bool, Vec3, &mut Pcg32, &mut u64, &mut V) + Sync> Radiance<V> for F {}

/// What sends light.
pub(crate) struct Source<'a, F, V> {
    /// Of surfaces.
    pub radiance: F,
    /// What `radiance` looks up in the first place.
    pub looked_up: &'a [V],
    /// What paths find that leave the scene behind near surfaces.
    pub skies: &'a [Emitter],
    /// Where much of it comes from.
    pub spots: Option<&'a Spots>,
}

/// Where a path has landed whose light has not been looked up yet. Light of several layers takes longer to come from
/// memory than to be looked up: it is fetched while the next path is followed.
pub(crate) struct Landed {
    surfel: Surfel,
    /// Share of what is looked up: the product of the albedos and tints before it, and what is left to aimed directions.
    weight: Vec3,
    receiver: u32,
}

impl<V: Value, F: Radiance<V>> Source<'_, F, V> {
    /// How many directions are to be aimed at spots along with so many that are drawn by the cosine. Beside a single
    /// one they cost more than they tell.
    pub(crate) fn aims(&self, samples: u32) -> u32 {
        if self.spots.is_some() && samples > 1 { samples.div_ceil(COSINES_PER_AIM) } else { 0 }
    }

    /// Adds what arrives at a point of the element `receiver` from a direction drawn by the cosine, where `ratio` times
    /// as many are [`Source::aimed`] (none at all behind near surfaces either, if it is 0), to `light`: all but that of
    /// the surface where the path lands, which [`Source::add_landed`] adds. Answers how the path ended, too.
    #[inline]
    #[expect(clippy::too_many_arguments, reason = "the inner loop of all gathers")]
    pub(crate) fn along(
        &self,
        world: &World,
        mut receiver: u32,
        mut from: From,
        direction: Vec3,
        mut ratio: f32,
        rng: &mut Pcg32,
        rays: &mut u64,
        light: &mut V,
    ) -> (End, Option<Landed>) {
        let mut landed = None;
        let end = walk(world, from.0, direction, rng, rays, |surfel, weight, near, rng, rays| {
            let share = self.spots.map_or(1.0, |spots| spots.share(world, from, surfel, ratio));
            if !near {
                surfel.fetch(self.looked_up);
                landed = Some(Landed { surfel: *surfel, weight: weight * share, receiver });
                return;
            }
            (self.radiance)(receiver, surfel, near, weight * share, rng, rays, light);
            receiver = surfel.nearest_element();
            if ratio > 0.0 {
                (from, ratio) = ((surfel.ray_origin(), surfel.normal), 1.0);
                let (u, share) = (rng.next_2d(), weight * surfel.albedo);
                self.aimed(world, receiver, from, u, (ratio, share), rng, rays, light);
            }
        });
        if let End::Escaped(weight, direction) = end {
            *light += sky::<V>(self.skies, direction) * weight;
        }
        (end, landed)
    }

    /// Adds what the surface where a path has landed, if it has, sends along it.
    #[inline]
    pub(crate) fn add_landed(&self, landed: Option<&Landed>, rng: &mut Pcg32, rays: &mut u64, light: &mut V) {
        if let Some(&Landed { ref surfel, weight, receiver }) = landed {
            (self.radiance)(receiver, surfel, false, weight, rng, rays, light);
        }
    }

    /// Adds what arrives from a spot that two numbers in [0, 1) choose, per direction drawn by the cosine (of which there
    /// are `ratio` times as many), times a share, to `light`.
    #[inline]
    #[expect(clippy::too_many_arguments, reason = "the inner loop of all gathers")]
    pub(crate) fn aimed(
        &self,
        world: &World,
        receiver: u32,
        from: From,
        u: [f32; 2],
        (ratio, share): (f32, Vec3),
        rng: &mut Pcg32,
        rays: &mut u64,
        light: &mut V,
    ) {
        let Some(spots) = self.spots else { return };
        let Some((direction, cell)) = spots.aim(from, u) else { return };
        *rays += 1;
        let ray = Ray { origin: from.0, direction, t_min: 0.0, t_max: f32::INFINITY };
        let mut left = Vec3::ONE;
        let Some(hit) = world.trees.first_hit(&ray, &mut left) else { return };
        let Some(surfel) = Surfel::to_look_up(world, &ray, &hit, rays).filter(|surfel| surfel.cell == cell) else {
            return;
        };
        match &surfel.footprint {
            Some(footprint) if !is_near(world, footprint, hit.t * hit.t) => {
                let share = share * left * spots.share(world, from, &surfel, ratio);
                (self.radiance)(receiver, &surfel, false, share, rng, rays, light);
            }
            _ => {}
        }
    }
}
