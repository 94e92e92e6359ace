//! Direct light that nobody tells apart by layers.

use glam::Vec3;

use super::direct::{direct_of, one_light};
use super::{Effort, Work};
use crate::job::Canceled;
use crate::random::Pcg32;
use crate::world::World;

/// One sample of one light that is aimed at, for a vertex of a path with unit normal `n`: its contribution to irradiance
/// / π, linear RGB, divided by the density of the sample. What comes evenly from outside the path finds itself.
#[inline]
pub fn light_of_one(world: &World, point: Vec3, n: Vec3, rng: &mut Pcg32, rays: &mut u64) -> Vec3 {
    one_light(world, point, n, rng, rays)
}

/// Direct light of elements, irradiance / π, linear RGB, from `samples` each per light ([`super::DirectLight`]).
///
/// # Errors
/// [`Canceled`] where the observer says so.
pub fn direct_light(world: &World, slots: &[u32], samples: u32, seed: u64, work: &Work) -> Result<Vec<Vec3>, Canceled> {
    direct_of(world, slots, samples, &Effort::default(), seed, work)
}
