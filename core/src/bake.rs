//! Light maps from scratch, by the propagator of the updates: the source is the direct light.

use std::cell::OnceCell;
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use crate::accumulate::Accumulator;
use crate::ambient::with_ambient;
use crate::focus::Focus;
use crate::importance::Importance;
use crate::job::{Budget, Canceled, Observer, Pass, Progress, Snapshot};
use crate::layers::{Apart, Computed, Header, Stack, groups_of, weights_of, weights_within};
use crate::lightmap::{LightMap, LightValues};
use crate::random::subseed;
use crate::rounds::{First, Goal, Phase, Round, Rounds};
use crate::solve::{Exchange, Paths, Rows, Subset};
use crate::transport::direct::direct_at;
use crate::transport::{Effort, Field, Hint, Work, blacken, for_slots, gathered};
use crate::value::Value;
use crate::value::with_layers;
use crate::world::World;

/// Samples per representative and round: at least, at most.
const SOLVE_SAMPLES: (u32, u32) = (16, 64);

/// Slots per task where little is done for each.
const CHUNK: usize = 4096;

/// Bakes a light map. Progressive: the observer gets a snapshot after every round. Ends by the budget or when the
/// observer plans no further round; the same inputs, seed and plan give the same bits. Groups of lights
/// ([`crate::scene::Scene::groups`]) get layers of their own, along the same rays.
pub fn bake(world: &World, budget: &Budget, seed: u64, observer: &dyn Observer) -> Result<Arc<LightMap>, Canceled> {
    let work = Work::new(observer);
    let goal = Goal {
        budget,
        importance: &Importance::default(),
        seed: subseed(seed, 0xba6e),
        estimates: true,
        guesses: true,
    };
    let map = bake_map(world, &groups_of(&world.scene), &|map| map, &goal, &work)?;
    Ok(map.unwrap_or_else(|| Arc::new(LightMap::black(world.slots()))))
}

/// Bakes a map of the layers of some headers, or without any of all light together; none where no round was run.
/// `improve` makes what is published of what was baked so far.
pub(crate) fn bake_map(
    world: &World,
    headers: &[Header],
    improve: &dyn Fn(LightMap) -> LightMap,
    goal: &Goal,
    work: &Work,
) -> Result<Option<Arc<LightMap>>, Canceled> {
    if headers.is_empty() {
        let finish = |layers: Apart| improve(layers.into_map());
        return bake_stack::<Vec3>(world, &[Vec3::ONE], &finish, goal, work);
    }
    let weights = weights_of(headers, &world.scene);
    let finish = |computed: Computed| improve(computed.into_map(&weights));
    bake_layers(world, headers, &finish, goal, work)
}

/// Bakes layers along the same rays; none where no round was run. `finish` makes what is published of them.
pub(crate) fn bake_layers(
    world: &World,
    headers: &[Header],
    finish: &dyn Fn(Computed) -> LightMap,
    goal: &Goal,
    work: &Work,
) -> Result<Option<Arc<LightMap>>, Canceled> {
    let weights = weights_of(headers, &world.scene);
    let lit = world.only_layers(headers, &weights);
    with_layers!(headers.len(), bake_headers(&lit, headers, &weights, finish, goal, work))
}

fn bake_headers<V: Value>(
    world: &World,
    headers: &[Header],
    weights: &[Vec3],
    finish: &dyn Fn(Computed) -> LightMap,
    goal: &Goal,
    work: &Work,
) -> Result<Option<Arc<LightMap>>, Canceled> {
    let finish = |layers: Apart| finish(layers.named(headers));
    bake_stack::<V>(world, weights_within(weights), &finish, goal, work)
}

/// Bakes some layers together; none where no round was run.
fn bake_stack<V: Value>(
    world: &World,
    weights: &[Vec3],
    finish: &dyn Fn(Apart) -> LightMap,
    goal: &Goal,
    work: &Work,
) -> Result<Option<Arc<LightMap>>, Canceled> {
    let baker = Baker::new(world, weights, goal.seed, work);
    let first = goal.focus().map(|focus| baker.look_first(focus, finish, goal)).transpose()?.flatten();
    let compose = |sum: &Accumulator<V>| {
        let Some(first) = &first else { return finish(Apart::of_mean(sum, None, &world.validity)) };
        let mut stack = Stack::of_mean(sum, None, &world.validity);
        first.merge(&mut stack, sum.samples(), baker.slots.iter().copied(), None);
        stack.fill_invalid(&world.validity);
        finish(Apart::of_stack(&stack, weights.len()))
    };
    let stated = |map: &LightMap| Some(map.estimated_rmse(world.areas()));
    let phase = if first.is_some() { Phase::Rest } else { Phase::Whole };
    let Goal { budget, seed, guesses, .. } = *goal;
    let rounds = Rounds { world, weights, budget, seed, work, phase, guesses };
    let round = |r: &Round<V>, out: &mut LightValues<V>| {
        baker.show_estimate(r, finish, goal)?;
        baker.round(r, out)
    };
    rounds.run(stated, |_| false, round, compose)
}

/// What all rounds of a bake share.
pub(crate) struct Baker<'a> {
    world: &'a World,
    slots: Vec<u32>,
    subset: Subset,
    rows: Arc<Rows>,
    hint: OnceCell<Hint>,
    /// What each layer weighs in the whole.
    weights: &'a [Vec3],
    seed: u64,
    work: &'a Work<'a>,
}

impl<'a> Baker<'a> {
    pub(crate) fn new(world: &'a World, weights: &'a [Vec3], seed: u64, work: &'a Work<'a>) -> Baker<'a> {
        let subset = Subset::new(world);
        let (slots, rows) = (world.computed_slots(), Arc::new(Rows::all(&subset)));
        Baker { world, slots, subset, rows, hint: OnceCell::new(), weights, seed: subseed(seed, 0x4006), work }
    }

    /// Bakes what is looked at before the rest, which is shown as the solution on the subset has it.
    fn look_first<V: Value>(
        &self,
        focus: &Focus,
        finish: &dyn Fn(Apart) -> LightMap,
        goal: &Goal,
    ) -> Result<Option<First<V>>, Canceled> {
        let is_seen = focus.covers(self.world);
        let seen: Vec<u32> = self.slots.iter().copied().filter(|&slot| is_seen[slot as usize]).collect();
        if seen.is_empty() {
            return Ok(None);
        }
        let mut last = None;
        let compose = |sum: &Accumulator<V>| {
            let stack = Stack::of_mean(sum, None, &self.world.validity);
            let map = finish(Apart::of_stack(&stack, self.weights.len()));
            last = Some((stack, sum.samples()));
            map
        };
        let (budget, seed) = (&goal.first_budget(), goal.first_seed());
        let (world, weights) = (self.world, self.weights);
        let rounds =
            Rounds { world, weights, budget, seed, work: self.work, phase: Phase::Part, guesses: goal.guesses };
        let round = |r: &Round<V>, out: &mut LightValues<V>| {
            self.show_estimate(r, finish, goal)?;
            self.round_at(r, &seen, out)
        };
        rounds.run(|_| None, |_| false, round, compose)?;
        Ok(last.map(|(stack, samples)| First::evenly(stack, &is_seen, samples)))
    }

    /// Shows what is known of direct light beforehand, with an ambient term for the rest, before anything else is
    /// known.
    fn show_estimate<V: Value>(
        &self,
        round: &Round<V>,
        finish: &dyn Fn(Apart) -> LightMap,
        goal: &Goal,
    ) -> Result<(), Canceled> {
        let observer = self.work.observer();
        if !goal.estimates || self.hint.get().is_some() || !observer.wants_estimates() {
            return Ok(());
        }
        (round.begin)(Pass::Direct, 0.0);
        let direct: Vec<V> = Hint::direct(self.world, &self.slots, self.seed, self.work)?;
        self.hint_of(&direct);
        let stack = with_ambient(self.world, direct, self.weights.len(), self.seed, self.work)?;
        let round_samples = round.samples;
        let rays = self.work.rays();
        observer.snapshot(
            &Arc::new(finish(Apart::of_stack(&stack, self.weights.len()))),
            Snapshot::Estimate,
            &Progress { round_samples, rays, ..Progress::nothing(Pass::Direct) },
        );
        Ok(())
    }

    /// One independent estimate of direct and indirect light.
    pub(crate) fn round<V: Value>(&self, round: &Round<V>, out: &mut LightValues<V>) -> Result<(), Canceled> {
        self.round_at(round, &self.slots, out)
    }

    /// One independent estimate of direct and indirect light. Indirect light is gathered in some slots only; elsewhere
    /// it is that of the solution on the subset.
    fn round_at<V: Value>(&self, round: &Round<V>, wanted: &[u32], out: &mut LightValues<V>) -> Result<(), Canceled> {
        let (world, work) = (self.world, self.work);
        out.blacken(world.slots());
        let LightValues { direct, indirect, .. } = out;
        (round.begin)(Pass::Direct, 0.0);
        // Earlier rounds choose the number of samples, never what they find: the mean stays free of bias.
        let effort = match round.sum.knows_variance() {
            true => Effort::new(world, &round.sum.variance()),
            false => Effort::default(),
        };
        work.add(&self.slots, direct, direct_at(world, round.samples, &effort, round.seed))?;
        world.validity.fill(direct);
        (round.begin)(Pass::Propagation, 0.25);
        // Each round solves anew, from its own direct light: rounds stay independent, so that their scatter is the
        // error of their mean, and since all is linear the mean is the solution of the mean direct light.
        let (exchange, bounces) = self.solve(direct, round)?;
        let sum = direct.par_iter().zip(&bounces).with_min_len(CHUNK);
        let total: Vec<V> = sum.map(|(d, b)| *d + *b).collect();
        let hint = self.hint::<V>()?;
        let field = Field { total: &total, direct, rough: &hint.rough };
        let source = field.source(world, hint.spots.as_ref());
        (round.begin)(Pass::FinalGather, 0.4);
        work.add(wanted, indirect, gathered(world, &source, round.samples, &effort, round.seed))?;
        drop(source);
        // The gather is better than the solution that it looked up: at all elements, not on a subset. What it found
        // anew has bounces of its own.
        let mut residual = total;
        blacken(&mut residual, world.slots());
        for_slots(wanted, &mut residual, |slot, r| *r = indirect[slot as usize] - bounces[slot as usize]);
        world.validity.fill(&mut residual);
        let missing = exchange.to_representatives(&self.subset, &exchange.settle(&residual));
        for_slots(&self.slots, indirect, |slot, light| *light = bounces[slot as usize] + residual[slot as usize]);
        let is_computed = |slot: u32| world.areas()[slot as usize] > 0.0 && world.is_valid(slot as usize);
        self.subset.add_where(is_computed, &missing, indirect);
        Ok(())
    }

    /// All bounces of the direct light, on the subset and interpolated to all slots.
    fn solve<V: Value>(&self, direct: &[V], round: &Round<V>) -> Result<(Exchange<V>, Vec<V>), Canceled> {
        let world = self.world;
        let hint = self.hint::<V>()?;
        let field = Field { total: direct, direct, rough: &hint.rough };
        let source = field.source(world, hint.spots.as_ref());
        let samples = round.samples.clamp(SOLVE_SAMPLES.0, SOLVE_SAMPLES.1);
        let seed = subseed(round.seed, 0x50);
        let exchange =
            Exchange::trace(world, &self.subset, &self.rows, &source, Paths::Each(samples), seed, self.work)?;
        let bounces = self.spread(&exchange, &exchange.all_bounces(&exchange.first));
        Ok((exchange, bounces))
    }

    fn spread<V: Value>(&self, exchange: &Exchange<V>, values: &[V]) -> Vec<V> {
        let mut field = Vec::new();
        self.subset.interpolate(&exchange.to_representatives(&self.subset, values), &mut field);
        self.world.validity.fill(&mut field);
        field
    }

    /// What is known of direct light beforehand, judged once.
    fn hint<V: Value>(&self) -> Result<&Hint, Canceled> {
        if let Some(hint) = self.hint.get() {
            return Ok(hint);
        }
        let direct: Vec<V> = Hint::direct(self.world, &self.slots, self.seed, self.work)?;
        Ok(self.hint_of(&direct))
    }

    fn hint_of<V: Value>(&self, direct: &[V]) -> &Hint {
        self.hint.get_or_init(|| Hint::new(self.world, direct, self.weights, self.seed, self.work))
    }
}
