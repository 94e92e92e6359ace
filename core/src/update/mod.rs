//! Light maps brought up to date after an edit by equation (1) of `docs/method.md`,
//! `L_B − L_A = (I − T_B)⁻¹ S` with `S = (E_B − E_A) + (T_B − T_A) L_A`.
//!
//! In terms of the stored `M = D + I` (direct and indirect irradiance / π) and the gather G:
//! - new slots (elements of what was inserted) are gathered from the old light, with the new direct light, to
//!   convergence;
//! - `ΔD` on unchanged slots is the change of direct light, `S` what their rays see of the objects and no more of what
//!   lies behind them: `S = (G_B − G_A)[ρ M]`, along rays that meet what was inserted or removed;
//! - everything else is transport in the new scene: `X = Σ_k u_k`, `u_1 = G_B[ρ (S + ΔD) + Δρ M_A]`,
//!   `u_{k+1} = G_B[ρ u_k]`, a contraction whatever the edit.

mod allotment;
mod buffers;
mod clusters;
mod direct;
mod extent;
mod layers;
mod look_first;
mod near_lamps;
mod need;
mod new_slots;
mod places;
mod propagate;
mod source;
mod tile_by_tile;
mod updater;

use std::sync::Arc;

use glam::Vec3;

use self::layers::update_layers;
use self::updater::{Extents, Prior, Updater};
use crate::accumulate::Accumulator;
use crate::bake::{self, Baker};
use crate::importance::Importance;
use crate::job::{Budget, Canceled, Observer};
use crate::layers::{Apart, Old};
use crate::lightmap::{AnyLight, LightMap, LightValues};
use crate::random::subseed;
use crate::refine::refine_with;
use crate::rounds::{Estimator, Goal, Need, Phase, Round};
use crate::solve::Solvable;
use crate::transport::Work;
use crate::world::Transition;

/// Part of the old map's variance below which that of the change is not seen: more samples of it would not show.
const UNSEEN: f64 = 0.25;

/// Brings `map`, which is right for `transition.before`, up to date with `transition.after`. Progressive as
/// [`crate::bake`] is; answering 0 to the first [`Observer::plan_round`] gives the old map in its new slots.
///
/// All layers of the map ([`crate::layers`]) are brought up to date along the same rays; those whose lights only change
/// in strength need none. A light that is relit for the first time gets a layer of its own.
///
/// Where `target_rmse` is below what the old map's own noise allows, the update ends by refining ([`crate::refine`]).
///
/// With a focus or tiles ([`Importance`]), some elements come first: snapshots hold new values there and old ones
/// elsewhere, until the rest follows.
pub fn update(
    transition: &Transition,
    map: &LightMap,
    budget: &Budget,
    importance: Option<&Importance>,
    seed: u64,
    observer: &dyn Observer,
) -> Result<Arc<LightMap>, Canceled> {
    let work = Work::new(observer);
    let importance = &importance.copied().unwrap_or_default();
    let budget = &importance.budget(budget);
    let goal = Goal { budget, importance, seed: subseed(seed, 0xed17), estimates: false, guesses: true, offers: false };
    let updated = match update_layers(transition, map, &goal, &work) {
        Some(updated) => updated?,
        None => update_whole(transition, map, &goal, &work)?,
    };
    let Some(Updated { map: updated, baked }) = updated else { return Ok(Arc::new(transition.carry_over(map))) };
    let world = &transition.after;
    match budget.target_rmse {
        Some(target)
            if !baked && !importance.ends_at_tile_quality() && updated.estimated_rmse(world.areas()) > target =>
        {
            Ok(refine_with(world, &updated, budget, goal.seed, &work)?.unwrap_or(updated))
        }
        _ => Ok(updated),
    }
}

/// What a stage has made.
pub(crate) struct Updated {
    pub map: Arc<LightMap>,
    /// From scratch: the change was larger than the light that is left.
    pub baked: bool,
}

/// All lights together.
fn update_whole(
    transition: &Transition,
    map: &LightMap,
    goal: &Goal,
    work: &Work,
) -> Result<Option<Updated>, Canceled> {
    let (old, finish) = (Old::new(vec![AnyLight::Dense(&map.light)], &map.light.variance, transition), Apart::into_map);
    let (weights, guides) = (&[Vec3::ONE], &[Vec3::ONE]);
    let stage = Stage { transition, old, weights, guides, around: None, finish: &finish };
    run_stage::<Vec3>(&stage, goal, work)
}

/// An update of some layers together.
pub(crate) struct Stage<'a> {
    /// Lights are those of the layers only, at reference strength.
    pub transition: &'a Transition,
    /// All light that is right for `transition.before`.
    pub old: Old<'a>,
    /// What each layer weighs in the whole.
    pub weights: &'a [Vec3],
    /// How much the light of each layer matters where samples are shared out ([`World::guides`]).
    pub guides: &'a [Vec3],
    /// All light there is before the change, direct + indirect, per slot of the new world, the layers of this stage as
    /// they matter; none where it is the old light of this stage.
    pub around: Option<&'a [Vec3]>,
    /// Makes a light map of the layers so far.
    pub finish: &'a dyn Fn(Apart) -> LightMap,
}

/// Runs a stage to its goal; none where the observer planned no round.
pub(crate) fn run_stage<V: Solvable>(stage: &Stage, goal: &Goal, work: &Work) -> Result<Option<Updated>, Canceled> {
    let world = &stage.transition.after;
    let (weights, finish) = (stage.weights, stage.finish);
    let updater = Updater::<V>::new(stage, work);
    let (first, known) = updater.come_first(goal, work)?;
    let rounds = StageRounds { updater: &updater, extents: updater.extents(|_| true), seed: goal.seed };
    let compose = |s: &Accumulator<V>, prior: &StagePrior<V>| {
        finish(match (prior, &first) {
            (StagePrior::Bake(..), _) => Apart::of_mean(s, None, &world.validity),
            (StagePrior::Change(_), None) => Apart::of_mean(s, Some(&stage.old), &world.validity),
            (StagePrior::Change(_), Some(first)) => Apart::of_stack(&updater.merged(first, s), weights.len()),
        })
    };
    let stated = |map: &LightMap| Some(map.estimated_rmse(world.areas()));
    // What the old map brings along in noise no number of samples of the change takes away.
    let carried = updater.carried_variance();
    let is_unseen = |s: &Accumulator<V>| {
        goal.budget.target_rmse.is_some() && s.knows_variance() && updater.mean(&s.variance()) < UNSEEN * carried
    };
    let need = |s: &Accumulator<V>, prior: &StagePrior<V>| {
        let is_change = matches!(prior, StagePrior::Change(_)) && first.is_none();
        Need { is_met: is_unseen(s), factor: (is_change && s.knows_variance()).then(|| updater.needed(s)) }
    };
    let phase = if first.is_some() { Phase::Rest } else { Phase::Whole };
    let known = known.map(StagePrior::Change);
    let (map, prior) = goal.rounds(world, weights, work, phase).run_and_show(&rounds, known, stated, need, compose)?;
    let baked = matches!(prior, Some(StagePrior::Bake(..)));
    Ok(map.map(|map| Updated { map, baked }))
}

/// Rounds of a whole stage.
struct StageRounds<'a, V> {
    updater: &'a Updater<'a, V>,
    extents: Extents,
    /// Of a bake in its place.
    seed: u64,
}

/// What rounds of a stage go by.
enum StagePrior<V> {
    Change(Prior<V>),
    /// The change outgrew the light that is left.
    Bake(Box<Baker>, bake::Prior),
}

impl<V: Solvable> Estimator<V> for StageRounds<'_, V> {
    type Prior = StagePrior<V>;

    fn first_round(
        &self,
        known: Option<StagePrior<V>>,
        round: &Round,
        out: &mut LightValues<V>,
    ) -> Result<StagePrior<V>, Canceled> {
        let prior = match known {
            Some(prior) => {
                self.round(&prior, round, out)?;
                prior
            }
            None => StagePrior::Change(self.updater.first_round(round, &self.extents, out)?),
        };
        if !self.updater.outgrows_the_light(out) {
            return Ok(prior);
        }
        let Updater { world, stage, work, .. } = *self.updater;
        let baker = Box::new(Baker::new(world, stage.guides, self.seed));
        let prior = baker.rounds(work).first_round(None, round, out)?;
        Ok(StagePrior::Bake(baker, prior))
    }

    fn prior(&self, last: StagePrior<V>, sum: &Accumulator<V>) -> StagePrior<V> {
        match last {
            StagePrior::Change(prior) => StagePrior::Change(self.updater.prior(prior, sum)),
            StagePrior::Bake(baker, prior) => {
                let prior = baker.rounds(self.updater.work).prior(prior, sum);
                StagePrior::Bake(baker, prior)
            }
        }
    }

    fn round(&self, prior: &StagePrior<V>, round: &Round, out: &mut LightValues<V>) -> Result<(), Canceled> {
        match prior {
            StagePrior::Change(prior) => self.updater.round(prior, round, &self.extents, out),
            StagePrior::Bake(baker, prior) => baker.rounds(self.updater.work).round(prior, round, out),
        }
    }
}
