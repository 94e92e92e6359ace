//! `Σ_{k ≥ 1} u_k` with `u_1 = G[source]`, `u_{k+1} = G[ρ u_k]`: equation (1) of the design without its first term.

use glam::Vec3;
use rayon::prelude::*;

use super::Subset;
use super::clusters::Clusters;
use crate::job::Canceled;
use crate::random::subseed;
use crate::transport::{Surfel, Work, gather_with};
use crate::world::World;

/// Gathers before the tail is closed by clusters.
const GATHERS: u32 = 2;

/// Rays from clusters: what they meet, counted over all gathers of one solve.
struct Counts {
    transport: Vec<Vec<Vec3>>,
    /// Total weight of the rays.
    rays: Vec<f64>,
}

/// All bounces of a source, and what is needed to correct them.
pub(crate) struct Bounces<'a> {
    world: &'a World,
    subset: &'a Subset,
    clusters: Clusters,
    counts: Counts,
    /// Sum of all bounces, per slot.
    pub field: Vec<Vec3>,
}

impl Bounces<'_> {
    /// What is missing where a better gather of the same light differs from `field` by a residual (per slot):
    /// `Σ_{j ≥ 1} Tʲ r`, over clusters. The lowest modes of a bright room, which bounce the longest, settle at once.
    pub(crate) fn settle(&self, residual: impl Fn(usize) -> Vec3) -> Vec<Vec3> {
        let r: Vec<Vec3> = self.subset.slots.iter().map(|&slot| residual(slot as usize)).collect();
        spread(self.world, self.subset, &self.clusters.tail(&self.counts.transport, &self.counts.rays, &r))
    }
}

/// Sum of all bounces of a source. `first(slot, surfel)` is the radiance that the source sends from a point; it may
/// differ by receiver. Samples are those of the first gather; later ones need fewer.
pub(crate) fn propagate<'a>(
    world: &'a World,
    subset: &'a Subset,
    first: &(impl Fn(u32, &Surfel) -> Vec3 + Sync),
    samples: u32,
    seed: u64,
    work: &Work,
) -> Result<Bounces<'a>, Canceled> {
    let clusters = Clusters::new(world, subset);
    let n = clusters.len();
    let mut counts = Counts { transport: vec![vec![Vec3::ZERO; n]; n], rays: vec![0.0; n] };
    let u1 = step(world, subset, &clusters, first, samples, subseed(seed, 1), work, &mut counts)?;
    if u1.iter().all(|v| *v == Vec3::ZERO) {
        let field = vec![Vec3::ZERO; world.slots()];
        return Ok(Bounces { world, subset, clusters, counts, field });
    }
    let (mut sum, mut u) = (u1.clone(), u1.clone());
    for k in 2..=GATHERS {
        let field = spread(world, subset, &u);
        let samples = (samples >> (k - 1)).max(4);
        let seed = subseed(seed, u64::from(k));
        u = step(world, subset, &clusters, &look_up(&field), samples, seed, work, &mut counts)?;
        add(&mut sum, &u);
    }
    add(&mut sum, &clusters.tail(&counts.transport, &counts.rays, &u));
    // The tail is constant over clusters and a little off: one more gather gives the residual of u_1 + G[ρ X] = X,
    // which is added with all its bounces.
    let field = spread(world, subset, &sum);
    let samples = (samples / 2).max(4);
    let mut residual = step(world, subset, &clusters, &look_up(&field), samples, subseed(seed, 99), work, &mut counts)?;
    add(&mut residual, &u1);
    residual.iter_mut().zip(&sum).for_each(|(r, s)| *r -= *s);
    add(&mut sum, &residual);
    add(&mut sum, &clusters.tail(&counts.transport, &counts.rays, &residual));
    let field = spread(world, subset, &sum);
    Ok(Bounces { world, subset, clusters, counts, field })
}

/// Values of representatives at all slots, elements inside solids included.
fn spread(world: &World, subset: &Subset, values: &[Vec3]) -> Vec<Vec3> {
    let mut field = subset.interpolate(values);
    world.validity.fill(&mut field);
    field
}

fn look_up(field: &[Vec3]) -> impl Fn(u32, &Surfel) -> Vec3 + Sync + '_ {
    move |_, s| s.elements.map_or(Vec3::ZERO, |e| s.albedo * s.interpolate(e, field))
}

fn add(sum: &mut [Vec3], other: &[Vec3]) {
    sum.iter_mut().zip(other).for_each(|(a, b)| *a += *b);
}

/// One gather at all representatives, counting what rays meet. Clusters are the tasks: each owns its row.
#[expect(clippy::too_many_arguments, reason = "a private step of one loop")]
fn step(
    world: &World,
    subset: &Subset,
    clusters: &Clusters,
    radiance: &(impl Fn(u32, &Surfel) -> Vec3 + Sync),
    samples: u32,
    seed: u64,
    work: &Work,
    counts: &mut Counts,
) -> Result<Vec<Vec3>, Canceled> {
    let gathered: Vec<Vec<Vec3>> = clusters
        .members
        .par_iter()
        .zip(counts.transport.par_iter_mut().zip(&mut counts.rays))
        .map(|(members, (row, rays_of_row))| {
            let mut values = Vec::with_capacity(members.len());
            for chunk in members.chunks(64) {
                let mut rays = 0;
                work.check()?;
                for &r in chunk {
                    let slot = subset.slots[r as usize];
                    let weight = clusters.areas[r as usize];
                    *rays_of_row += f64::from(weight) * f64::from(samples);
                    values.push(gather_with(world, slot, samples, seed, &mut rays, |s| {
                        if let Some(elements) = s.elements {
                            let cluster = clusters.of_slot[elements[0] as usize];
                            if let Some(entry) = row.get_mut(cluster as usize) {
                                *entry += s.albedo * weight;
                            }
                        }
                        radiance(slot, s)
                    }));
                }
                work.count(rays);
            }
            Ok(values)
        })
        .collect::<Result<_, Canceled>>()?;
    let mut out = vec![Vec3::ZERO; subset.slots.len()];
    for (members, values) in clusters.members.iter().zip(gathered) {
        members.iter().zip(values).for_each(|(&r, v)| out[r as usize] = v);
    }
    Ok(out)
}
