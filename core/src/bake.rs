//! Light maps from scratch, by the propagator of the updates: the source is the direct light.

use std::sync::Arc;

use glam::Vec3;

use crate::accumulate::Accumulator;
use crate::job::{Budget, Canceled, Observer, Pass};
use crate::lightmap::LightMap;
use crate::random::subseed;
use crate::rounds::{self, Round};
use crate::solve::{Bounces, Subset, propagate};
use crate::transport::direct::direct_of;
use crate::transport::{LightField, Work, gather};
use crate::world::World;

/// Samples per representative at least.
const SOLVE_SAMPLES: u32 = 16;

/// Hits nearer than this many spacings are not looked up ([`LightField::near`]).
pub(crate) const NEAR: f32 = 2.0;

/// Bakes a light map. Progressive: the observer gets a snapshot after every round. Ends by the budget or when the
/// observer plans no further round; the same inputs, seed and plan give the same bits.
pub fn bake(world: &World, budget: &Budget, seed: u64, observer: &dyn Observer) -> Result<Arc<LightMap>, Canceled> {
    let work = Work::new(observer);
    let baker = Baker::new(world, &work);
    let seed = subseed(seed, 0xba6e);
    let areas = world.areas();
    let map = rounds::run(world.slots(), areas, budget, seed, &work, |r| baker.round(r), |s| baker.compose(s))?;
    Ok(map.unwrap_or_else(|| Arc::new(LightMap::black(world.slots()))))
}

/// What all rounds of a bake share.
pub(crate) struct Baker<'a> {
    world: &'a World,
    slots: Vec<u32>,
    subset: Subset,
    work: &'a Work<'a>,
}

impl<'a> Baker<'a> {
    pub(crate) fn new(world: &'a World, work: &'a Work<'a>) -> Baker<'a> {
        Baker { world, slots: world.computed_slots(), subset: Subset::new(world), work }
    }

    /// The mean of all rounds.
    pub(crate) fn compose(&self, sum: &Accumulator) -> LightMap {
        let mut map = LightMap { direct: sum.direct(), indirect: sum.indirect(), variance: sum.variance() };
        self.world.fill_invalid(&mut map);
        map
    }

    /// One independent estimate of direct and indirect light.
    pub(crate) fn round(&self, round: &Round) -> Result<(Vec<Vec3>, Vec<Vec3>), Canceled> {
        let (world, work) = (self.world, self.work);
        (round.begin)(Pass::Direct, 0.0);
        let direct = self.scatter(&direct_of(world, &self.slots, round.samples, round.seed, work)?);
        (round.begin)(Pass::Propagation, 0.25);
        // Each round solves anew, from its own direct light: rounds stay independent, so that their scatter is the
        // error of their mean, and since all is linear the mean is the solution of the mean direct light.
        let (total, bounces) = self.solve(&direct, round)?;
        (round.begin)(Pass::FinalGather, 0.4);
        let field = LightField { total: &total, near: NEAR * world.spacing() };
        let indirect = gather(world, &field, &self.slots, round.samples, round.seed, work)?;
        let mut indirect = self.scatter(&indirect);
        let missing = bounces.settle(|slot| indirect[slot] - bounces.field[slot]);
        self.slots.iter().for_each(|&slot| indirect[slot as usize] += missing[slot as usize]);
        Ok((direct, indirect))
    }

    /// Direct light and all its bounces on the subset.
    fn solve(&self, direct: &[Vec3], round: &Round) -> Result<(Vec<Vec3>, Bounces<'_>), Canceled> {
        let mut direct = direct.to_vec();
        self.world.validity.fill(&mut direct);
        let first = |_: u32, s: &crate::transport::Surfel| {
            s.elements.map_or(Vec3::ZERO, |e| s.albedo * s.interpolate(e, &direct))
        };
        let samples = round.samples.max(SOLVE_SAMPLES);
        let bounces = propagate(self.world, &self.subset, &first, samples, subseed(round.seed, 0x50), self.work)?;
        let total = direct.iter().zip(&bounces.field).map(|(d, b)| *d + *b).collect();
        Ok((total, bounces))
    }

    fn scatter(&self, values: &[Vec3]) -> Vec<Vec3> {
        let mut out = vec![Vec3::ZERO; self.world.slots()];
        self.slots.iter().zip(values).for_each(|(&slot, v)| out[slot as usize] = *v);
        out
    }
}

impl World {
    /// Elements inside solids take their neighbours' values.
    pub(crate) fn fill_invalid(&self, map: &mut LightMap) {
        self.validity.fill(&mut map.direct);
        self.validity.fill(&mut map.indirect);
        self.validity.fill_scalars(&mut map.variance);
    }
}
