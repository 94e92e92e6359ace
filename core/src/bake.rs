//! Light maps from scratch, by the propagator of the updates: the source is the direct light.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use crate::accumulate::Accumulator;
use crate::ambient::with_ambient;
use crate::importance::Importance;
use crate::job::{Budget, Canceled, Observer, Offer, Pass, Progress, Snapshot};
use crate::layers::{Apart, Computed, groups_of, weights_of, weights_within};
use crate::lightmap::{LayerHeader, LightMap, LightValues};
use crate::random::subseed;
use crate::rounds::{Estimator, Goal, Need, Phase, Round};
use crate::solve::{Exchange, Paths, Rows, Solvable, Subset};
use crate::transport::direct::direct_at;
use crate::transport::{Effort, Field, Hint, Work, for_slots, gathered};
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
    let importance = &Importance::default();
    let goal = Goal { budget, importance, seed: seed_of(seed), estimates: true, guesses: true, offers: true };
    let map = bake_map(world, &groups_of(&world.scene), &|map| map, &goal, &work)?;
    Ok(map.unwrap_or_else(|| Arc::new(LightMap::black(world.slots()))))
}

/// What the seeds of a bake's rounds are made from.
fn seed_of(seed: u64) -> u64 {
    subseed(seed, 0xba6e)
}

/// Bakes a map of the layers of some headers, or without any of all light together; none where no round was run.
/// `improve` makes what is published of what was baked so far.
pub(crate) fn bake_map(
    world: &World,
    headers: &[LayerHeader],
    improve: &dyn Fn(LightMap) -> LightMap,
    goal: &Goal,
    work: &Work,
) -> Result<Option<Arc<LightMap>>, Canceled> {
    if headers.is_empty() {
        let finish = |layers: Apart| improve(layers.into_map());
        return bake_stack::<Vec3>(world, (&[], &[Vec3::ONE]), &finish, goal, work);
    }
    let weights = weights_of(headers, &world.scene);
    let finish = |computed: Computed| improve(computed.into_map(&weights));
    bake_layers(world, headers, &finish, goal, work)
}

/// Bakes layers along the same rays; none where no round was run. `finish` makes what is published of them.
pub(crate) fn bake_layers(
    world: &World,
    headers: &[LayerHeader],
    finish: &dyn Fn(Computed) -> LightMap,
    goal: &Goal,
    work: &Work,
) -> Result<Option<Arc<LightMap>>, Canceled> {
    let weights = weights_of(headers, &world.scene);
    let lit = world.only_layers(headers, &weights);
    with_layers!(headers.len(), bake_headers(&lit, headers, &weights, finish, goal, work))
}

fn bake_headers<V: Solvable>(
    world: &World,
    headers: &[LayerHeader],
    weights: &[Vec3],
    finish: &dyn Fn(Computed) -> LightMap,
    goal: &Goal,
    work: &Work,
) -> Result<Option<Arc<LightMap>>, Canceled> {
    let finish = |layers: Apart| finish(layers.named(headers));
    bake_stack::<V>(world, (headers, weights_within(weights)), &finish, goal, work)
}

/// Bakes some layers together; none where no round was run.
fn bake_stack<V: Solvable>(
    world: &World,
    (layers, weights): (&[LayerHeader], &[Vec3]),
    finish: &dyn Fn(Apart) -> LightMap,
    goal: &Goal,
    work: &Work,
) -> Result<Option<Arc<LightMap>>, Canceled> {
    let baker = Baker::new(world, weights, goal.seed);
    let show = |direct: Vec<V>, round: &Round| baker.show_estimate(direct, round, finish, work);
    let shows = goal.estimates && work.observer().wants_estimates();
    let layers = goal.offers.then_some(layers);
    let all = BakeRounds { show: shows.then_some(&show), layers, ..baker.rounds(work) };
    let is_seen = goal.focus().map(|focus| focus.covers(world)).unwrap_or_default();
    let seen: Vec<u32> =
        baker.slots.iter().copied().filter(|&slot| is_seen.get(slot as usize) == Some(&true)).collect();
    let (first, prior) = match seen.is_empty() {
        true => (None, None),
        false => {
            // The rest is shown as the solution on the subset has it.
            let rounds = goal.rounds(world, weights, work, Phase::Part);
            rounds.run_first(&BakeRounds { wanted: &seen, layers: None, ..all }, &is_seen, None, finish)?
        }
    };
    let compose = |sum: &Accumulator<V>, _: &Prior| {
        let Some(first) = &first else { return finish(Apart::of_mean(sum, None, &world.validity)) };
        let stack = first.merged(sum, baker.slots.iter().copied(), &world.validity);
        finish(Apart::of_stack(&stack, weights.len()))
    };
    let stated = |map: &LightMap| Some(map.estimated_rmse(world.areas()));
    let phase = if first.is_some() { Phase::Rest } else { Phase::Whole };
    let rounds = goal.rounds(world, weights, work, phase);
    Ok(rounds.run_and_show(&all, prior, stated, |_, _| Need::default(), compose)?.0)
}

/// What all rounds of a bake share: a function of the world, its layers and the seed.
pub(crate) struct Baker {
    world: World,
    slots: Vec<u32>,
    subset: Subset,
    rows: Arc<Rows>,
    /// What each layer weighs in the whole.
    weights: Vec<Vec3>,
    /// That rounds derive theirs from.
    seed: u64,
}

/// What rounds of a bake go by. It can be had again from the world, the bake's seed and the rounds before.
pub(crate) struct Prior {
    /// From the world and the bake's seed.
    hint: Arc<Hint>,
    /// From the variance of all rounds so far.
    effort: Effort,
}

impl Prior {
    pub(crate) fn with_effort(&self, effort: Effort) -> Prior {
        Prior { hint: Arc::clone(&self.hint), effort }
    }
}

/// Samples of the round after those in `sum`: they choose how many, never what is found, and the mean stays free of bias.
pub(crate) fn effort_after<V: Solvable>(world: &World, sum: &Accumulator<V>) -> Effort {
    if sum.knows_variance() { Effort::new(world, &sum.variance()) } else { Effort::default() }
}

/// Shows direct light.
type Show<'a, V> = dyn Fn(Vec<V>, &Round) -> Result<(), Canceled> + 'a;

/// Rounds of a bake.
#[derive(Clone, Copy)]
pub(crate) struct BakeRounds<'a, V> {
    baker: &'a Baker,
    work: &'a Work<'a>,
    /// Slots, ascending, where indirect light is gathered; elsewhere it is that of the solution on the subset.
    wanted: &'a [u32],
    /// Shows what is known of direct light before anything else is.
    show: Option<&'a Show<'a, V>>,
    /// What others are told of its layers; none where its rounds are done here.
    layers: Option<&'a [LayerHeader]>,
}

impl<V: Solvable> Estimator<V> for BakeRounds<'_, V> {
    type Prior = Prior;

    fn first_round(&self, known: Option<Prior>, round: &Round, out: &mut LightValues<V>) -> Result<Prior, Canceled> {
        let known = match known {
            Some(prior) => prior.with_effort(Effort::default()),
            None => {
                (round.begin)(Pass::Direct, 0.0..0.1);
                let (prior, direct) = self.baker.first_prior(self.work)?;
                self.show.map(|show| show(direct, round)).transpose()?;
                prior
            }
        };
        self.round(&known, round, out)?;
        Ok(known)
    }

    fn prior(&self, last: Prior, sum: &Accumulator<V>) -> Prior {
        last.with_effort(effort_after(&self.baker.world, sum))
    }

    fn round(&self, prior: &Prior, round: &Round, out: &mut LightValues<V>) -> Result<(), Canceled> {
        self.baker.round(prior, round, self.wanted, self.work, out)
    }

    fn offer<'p>(&'p self, prior: &'p Prior) -> Option<Offer<'p>> {
        let effort = prior.effort.factors();
        self.layers.map(|layers| Offer { seed: self.baker.seed, layers, round: 0, effort, parts: &[] })
    }
}

impl Baker {
    pub(crate) fn new(world: &World, weights: &[Vec3], seed: u64) -> Baker {
        let subset = Subset::new(world);
        let (slots, rows) = (world.computed_slots(), Arc::new(Rows::all(&subset)));
        let (world, weights) = (world.clone(), weights.to_vec());
        Baker { world, slots, subset, rows, weights, seed }
    }

    /// Rounds of the whole map.
    pub(crate) fn rounds<'a, V>(&'a self, work: &'a Work<'a>) -> BakeRounds<'a, V> {
        BakeRounds { baker: self, work, wanted: &self.slots, show: None, layers: None }
    }

    /// What the first round goes by, and the direct light that it is made from, which no round uses.
    pub(crate) fn first_prior<V: Solvable>(&self, work: &Work) -> Result<(Prior, Vec<V>), Canceled> {
        let seed = self.hint_seed();
        let direct: Vec<V> = Hint::direct(&self.world, &self.slots, seed, work)?;
        let hint = Arc::new(Hint::new(&self.world, &direct, &self.weights, seed, work));
        Ok((Prior { hint, effort: Effort::default() }, direct))
    }

    /// Of the world.
    pub(crate) fn slots(&self) -> usize {
        self.world.slots()
    }

    fn hint_seed(&self) -> u64 {
        subseed(self.seed, 0x4006)
    }

    /// Shows direct light with an ambient term for the rest.
    fn show_estimate<V: Solvable>(
        &self,
        direct: Vec<V>,
        round: &Round,
        finish: &dyn Fn(Apart) -> LightMap,
        work: &Work,
    ) -> Result<(), Canceled> {
        let stack = with_ambient(&self.world, direct, self.hint_seed(), work)?;
        let map = Arc::new(finish(Apart::of_stack(&stack, self.weights.len())));
        let (round_samples, rays) = (round.samples, work.rays());
        let progress = Progress { round_samples, rays, ..Progress::nothing(Pass::Direct) };
        work.observer().snapshot(&map, Snapshot::Estimate, &progress);
        Ok(())
    }

    fn round<V: Solvable>(
        &self,
        Prior { hint, effort }: &Prior,
        round: &Round,
        wanted: &[u32],
        work: &Work,
        out: &mut LightValues<V>,
    ) -> Result<(), Canceled> {
        let world = &self.world;
        out.blacken(world.slots());
        let LightValues { direct, indirect, .. } = out;
        (round.begin)(Pass::Direct, 0.0..0.25);
        work.add(&self.slots, direct, direct_at(world, round.samples, effort, round.part_seed()))?;
        world.validity.fill(direct);
        (round.begin)(Pass::Propagation, 0.25..0.4);
        // Each round solves anew, from its own direct light: rounds stay independent, so that their scatter is the
        // error of their mean, and since all is linear the mean is the solution of the mean direct light.
        let (exchange, bounces) = self.solve(direct, hint, round, work)?;
        let sum = direct.par_iter().zip(&bounces).with_min_len(CHUNK);
        let total: Vec<V> = sum.map(|(d, b)| *d + *b).collect();
        let field = Field { total: &total, indirect: &bounces, rough: &hint.rough };
        let source = field.source(world, hint.spots.as_ref());
        (round.begin)(Pass::FinalGather, 0.4..1.0);
        work.add(wanted, indirect, gathered(world, &source, round.samples, effort, round.part_seed()))?;
        drop(source);
        // The gather is better than the solution that it looked up: at all elements, not on a subset. What it found
        // anew has bounces of its own.
        drop(total);
        let mut residual = vec![V::Change::default(); world.slots()];
        for_slots(wanted, &mut residual, |slot, r| {
            *r = indirect[slot as usize].change_from(&bounces[slot as usize]);
        });
        world.validity.fill(&mut residual);
        let missing = exchange.to_representatives(&self.subset, &exchange.further_bounces(&residual));
        for_slots(&self.all_but(wanted), indirect, |slot, light| *light = bounces[slot as usize]);
        let is_computed = |slot: u32| world.is_computed(slot as usize);
        self.subset.interpolate_where(is_computed, &missing, indirect, V::add_change);
        Ok(())
    }

    /// All bounces of the direct light, on the subset and interpolated to all slots.
    fn solve<V: Solvable>(
        &self,
        direct: &[V],
        hint: &Hint,
        round: &Round,
        work: &Work,
    ) -> Result<(Exchange<V>, Vec<V>), Canceled> {
        let world = &self.world;
        let field = Field { total: direct, indirect: &[], rough: &hint.rough };
        let source = field.source(world, hint.spots.as_ref());
        let samples = round.samples.clamp(SOLVE_SAMPLES.0, SOLVE_SAMPLES.1);
        let seed = round.part_seed().of(0x50);
        let exchange = Exchange::trace(world, &self.subset, &self.rows, &source, Paths::Each(samples), seed, work)?;
        let bounces = self.spread(&exchange, &exchange.all_bounces(&exchange.first));
        Ok((exchange, bounces))
    }

    /// Slots that are computed, without some of them; both ascending.
    fn all_but(&self, wanted: &[u32]) -> Vec<u32> {
        if wanted.len() == self.slots.len() {
            return Vec::new();
        }
        self.slots.iter().copied().filter(|slot| wanted.binary_search(slot).is_err()).collect()
    }

    fn spread<V: Solvable>(&self, exchange: &Exchange<V>, values: &[V]) -> Vec<V> {
        let mut field = Vec::new();
        self.subset.interpolate(&exchange.to_representatives(&self.subset, values), &mut field);
        self.world.validity.fill(&mut field);
        field
    }
}
