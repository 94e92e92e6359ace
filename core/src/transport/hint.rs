//! What is known of direct light before a bake gathers it: where it must not be looked up, and where much of it is.

use glam::Vec3;

use super::direct::{direct_at, one_light};
use super::{Effort, Rough, Spots, Target, Work, black};
use crate::job::Canceled;
use crate::random::{PartSeed, Pcg32, R2, subseed};
use crate::space::ray_offset;
use crate::value::Value;
use crate::world::World;

/// Samples of direct light per element.
const SAMPLES: u32 = 4;

/// Samples of direct light within a cell over which it is rough: a lamp near by lights a point between its corners.
const PROBES: u32 = 8;

/// From samples that nothing else uses: a choice must not know the noise of what it chooses between.
pub(crate) struct Hint {
    pub rough: Rough,
    pub spots: Option<Spots>,
}

impl Hint {
    /// Direct light that hints are made from, per slot.
    pub(crate) fn direct<V: Value>(world: &World, slots: &[u32], seed: u64, work: &Work) -> Result<Vec<V>, Canceled> {
        let mut direct = black(world.slots());
        work.add(slots, &mut direct, direct_at(world, SAMPLES, &Effort::default(), PartSeed::whole(seed)))?;
        world.validity.fill(&mut direct);
        Ok(direct)
    }

    /// From [`Hint::direct`].
    pub(crate) fn new<V: Value>(world: &World, direct: &[V], weights: &[Vec3], seed: u64, work: &Work) -> Hint {
        let rough = Rough::new(world, |slot| direct[slot as usize].weighted(weights).element_sum());
        let radiance = |target: &Target| {
            let corners = target.elements.map(|e| direct[e as usize].weighted(weights));
            let mean = corners.into_iter().sum::<Vec3>() / 3.0;
            let light = if rough.contains(target.cell) {
                mean.max(probe::<V>(world, target, seed, work).weighted(weights))
            } else {
                mean
            };
            (light * target.albedo).element_sum()
        };
        let spots = Spots::new(world, radiance);
        Hint { rough, spots }
    }
}

/// Mean direct light over one side of a cell.
fn probe<V: Value>(world: &World, target: &Target, seed: u64, work: &Work) -> V {
    let mut rng = Pcg32::new(subseed(seed, 0x9b), 2 * u64::from(target.cell) + u64::from(target.back));
    let (sequence, mut rays) = (R2::new(&mut rng), 0);
    let sample = |k| {
        let (point, n) = target.point(sequence.get(k));
        one_light::<V>(world, point + n * ray_offset(point, target.extent), n, &mut rng, &mut rays)
    };
    let sum: V = (0..PROBES).map(sample).sum();
    work.count(rays);
    sum / PROBES as f32
}
