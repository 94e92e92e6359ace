//! Light maps from scratch, by the propagator of the updates: the source is the direct light.

use std::cell::OnceCell;
use std::sync::Arc;

use glam::Vec3;

use crate::accumulate::Accumulator;
use crate::job::{Budget, Canceled, Observer, Pass};
use crate::lightmap::LightMap;
use crate::random::{Pcg32, subseed};
use crate::rounds::{Phase, Round, Rounds};
use crate::solve::{Exchange, Rows, Source, Subset};
use crate::transport::direct::direct_of;
use crate::transport::{Effort, Field, Rough, Surfel, Work, gather};
use crate::world::World;

/// Samples per representative and round: at least, at most.
const SOLVE_SAMPLES: (u32, u32) = (16, 64);

/// Samples of direct light that tell where it is rough.
const ROUGH_SAMPLES: u32 = 4;

/// Bakes a light map. Progressive: the observer gets a snapshot after every round. Ends by the budget or when the
/// observer plans no further round; the same inputs, seed and plan give the same bits.
pub fn bake(world: &World, budget: &Budget, seed: u64, observer: &dyn Observer) -> Result<Arc<LightMap>, Canceled> {
    let work = Work::new(observer);
    let seed = subseed(seed, 0xba6e);
    let baker = Baker::new(world, seed, &work);
    let stated = |map: &LightMap| Some(map.estimated_rmse(world.areas()));
    let rounds = Rounds { len: world.slots(), budget, seed, work: &work, phase: Phase::Whole };
    let map = rounds.run(stated, |_| false, |r| baker.round(r), |s| baker.compose(s))?;
    Ok(map.unwrap_or_else(|| Arc::new(LightMap::black(world.slots()))))
}

/// What all rounds of a bake share.
pub(crate) struct Baker<'a> {
    world: &'a World,
    slots: Vec<u32>,
    subset: Subset,
    rows: Rows,
    rough: OnceCell<Rough>,
    seed: u64,
    work: &'a Work<'a>,
}

impl<'a> Baker<'a> {
    pub(crate) fn new(world: &'a World, seed: u64, work: &'a Work<'a>) -> Baker<'a> {
        let subset = Subset::new(world);
        let (slots, rows) = (world.computed_slots(), Rows::all(&subset));
        Baker { world, slots, subset, rows, rough: OnceCell::new(), seed: subseed(seed, 0x4006), work }
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
        // Earlier rounds choose the number of samples, never what they find: the mean stays free of bias.
        let effort = match round.sum.knows_variance() {
            true => Effort::new(world, &round.sum.variance()),
            false => Effort::default(),
        };
        let direct = self.scatter(&direct_of(world, &self.slots, round.samples, &effort, round.seed, work)?);
        (round.begin)(Pass::Propagation, 0.25);
        // Each round solves anew, from its own direct light: rounds stay independent, so that their scatter is the
        // error of their mean, and since all is linear the mean is the solution of the mean direct light.
        let mut filled_direct = direct.clone();
        world.validity.fill(&mut filled_direct);
        let (exchange, bounces) = self.solve(&filled_direct, round)?;
        let field = Field { direct: &filled_direct, indirect: &bounces, rough: self.rough()? };
        (round.begin)(Pass::FinalGather, 0.4);
        let indirect = gather(world, &field, &self.slots, round.samples, &effort, round.seed, work)?;
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
        let world = self.world;
        let field = Field { direct, indirect: &[], rough: self.rough()? };
        let source = |_: u32, s: &Surfel, near: bool, rng: &mut Pcg32, rays: &mut u64| {
            s.albedo * field.at(world, s, near, rng, rays)
        };
        let source = Source { radiance: source, sky: world.emitters.environment };
        let samples = round.samples.clamp(SOLVE_SAMPLES.0, SOLVE_SAMPLES.1);
        let seed = subseed(round.seed, 0x50);
        let exchange = Exchange::trace(world, &self.subset, &self.rows, &source, samples, seed, self.work)?;
        let bounces = self.spread(&exchange, &exchange.all_bounces(&exchange.first));
        Ok((exchange, bounces))
    }

    fn spread(&self, exchange: &Exchange, values: &[Vec3]) -> Vec<Vec3> {
        let mut field = self.subset.interpolate(&exchange.to_representatives(&self.subset, values));
        self.world.validity.fill(&mut field);
        field
    }

    /// Where direct light is not to be looked up, judged once, by samples of its own.
    fn rough(&self) -> Result<&Rough, Canceled> {
        if let Some(rough) = self.rough.get() {
            return Ok(rough);
        }
        let mut direct =
            self.scatter(&direct_of(self.world, &self.slots, ROUGH_SAMPLES, &Effort::default(), self.seed, self.work)?);
        self.world.validity.fill(&mut direct);
        Ok(self.rough.get_or_init(|| Rough::new(self.world, &direct)))
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
