//! Light maps from scratch, by the propagator of the updates: the source is the direct light.

use std::sync::Arc;

use glam::Vec3;

use crate::accumulate::Accumulator;
use crate::job::{Budget, Canceled, Observer, Pass};
use crate::lightmap::LightMap;
use crate::random::{Pcg32, subseed};
use crate::rounds::{self, Round};
use crate::solve::{Exchange, Rows, Source, Subset};
use crate::transport::direct::direct_of;
use crate::transport::{Surfel, Work, gather, light_at};
use crate::world::World;

/// Samples per representative and round: at least, at most.
const SOLVE_SAMPLES: (u32, u32) = (16, 64);

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
    rows: Rows,
    work: &'a Work<'a>,
}

impl<'a> Baker<'a> {
    pub(crate) fn new(world: &'a World, work: &'a Work<'a>) -> Baker<'a> {
        let subset = Subset::new(world);
        Baker { world, slots: world.computed_slots(), rows: Rows::all(&subset), subset, work }
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
        let (exchange, bounces) = self.solve(&direct, round)?;
        let total: Vec<Vec3> = direct.iter().zip(&bounces).map(|(d, b)| *d + *b).collect();
        (round.begin)(Pass::FinalGather, 0.4);
        let indirect = gather(world, &total, &self.slots, round.samples, round.seed, work)?;
        let mut indirect = self.scatter(&indirect);
        // The gather is better than the solution that it looked up: at all elements, not on a subset. What it found anew
        // has bounces of its own.
        let mut residual: Vec<Vec3> = indirect.iter().zip(&bounces).map(|(i, b)| *i - *b).collect();
        world.validity.fill(&mut residual);
        let missing = self.spread(&exchange, &exchange.settle(&residual));
        self.slots.iter().for_each(|&slot| indirect[slot as usize] += missing[slot as usize]);
        Ok((direct, indirect))
    }

    /// All bounces of the direct light, on the subset and interpolated to all slots.
    fn solve(&self, direct: &[Vec3], round: &Round) -> Result<(Exchange<'_>, Vec<Vec3>), Canceled> {
        let mut direct = direct.to_vec();
        self.world.validity.fill(&mut direct);
        let source = |_: u32, s: &Surfel, near: bool, rng: &mut Pcg32, rays: &mut u64| {
            let light = match s.elements {
                Some(elements) if !near => s.interpolate(elements, &direct),
                _ => light_at(self.world, s, rng, rays),
            };
            s.albedo * light
        };
        let source = Source { radiance: source, sky: self.world.emitters.environment };
        let samples = round.samples.clamp(SOLVE_SAMPLES.0, SOLVE_SAMPLES.1);
        let seed = subseed(round.seed, 0x50);
        let exchange = Exchange::trace(self.world, &self.subset, &self.rows, &source, samples, seed, self.work)?;
        let bounces = self.spread(&exchange, &exchange.all_bounces(&exchange.first));
        Ok((exchange, bounces))
    }

    fn spread(&self, exchange: &Exchange, values: &[Vec3]) -> Vec<Vec3> {
        let mut field = self.subset.interpolate(&exchange.to_representatives(&self.subset, values));
        self.world.validity.fill(&mut field);
        field
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
