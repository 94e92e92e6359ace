//! What somebody looks at, brought up to date before the rest. Everything is estimated once, at few samples and on the
//! representatives; rounds then estimate only what is looked at, since from the rest light arrives by way of at least
//! one bounce, which smooths it.

use std::sync::Arc;

use super::extent::Extent;
use super::propagate::Seen;
use super::updater::{Extents, Prior, Updater};
use crate::accumulate::Accumulator;
use crate::focus::Focus;
use crate::job::Canceled;
use crate::lightmap::LightValues;
use crate::random::subseed;
use crate::rounds::{Estimator, First, Goal, Phase, Round};
use crate::solve::{Rows, Solvable};
use crate::transport::Work;

/// Samples of what is not looked at, where that is nearly everything.
const UNSEEN_SAMPLES: u32 = 2;

/// Part of the elements from which on what is looked at is estimated along with everything else the first time.
const LARGE: f64 = 0.1;

/// Everything, roughly.
#[derive(Clone)]
pub(super) struct Known<V> {
    /// Before any bounce; black where somebody looks.
    pub parts: LightValues<V>,
    pub bounces: Arc<[V]>,
}

impl<V: Solvable> Known<V> {
    /// What is known around slots that somebody looks at.
    pub(super) fn around(mut self, is_seen: &[bool]) -> Known<V> {
        self.parts = self.parts.without(is_seen);
        self
    }
}

/// What is looked at, and what its rounds need.
pub(super) struct Look<'a, V> {
    updater: &'a Updater<'a, V>,
    is_seen: Vec<bool>,
    seen: Extents,
    /// Representatives that bounces are interpolated from, where they are seen.
    rows: Arc<Rows>,
    new_slots: Vec<u32>,
    is_large: bool,
}

impl<V: Solvable> Estimator<V> for Look<'_, V> {
    type Prior = (Prior<V>, Known<V>);

    /// Estimates everything; element by element where somebody looks and that is much, which is an estimate, too.
    fn first_round(
        &self,
        known: Option<Self::Prior>,
        round: &Round,
        out: &mut LightValues<V>,
    ) -> Result<Self::Prior, Canceled> {
        if let Some(prior) = known {
            self.round(&prior, round, out)?;
            return Ok(prior);
        }
        let samples = if self.is_large { round.samples } else { UNSEEN_SAMPLES };
        let (prior, known) = self.updater.know(round, samples, |slot| self.is_large && self.is_seen[slot as usize])?;
        if self.is_large {
            out.clone_from(&known.parts);
            out.add_indirect(&known.bounces);
            return Ok((prior, known.around(&self.is_seen)));
        }
        let prior = (prior, known.around(&self.is_seen));
        self.round(&prior, round, out)?;
        Ok(prior)
    }

    fn prior(&self, last: Self::Prior, _: &Accumulator<V>) -> Self::Prior {
        last
    }

    fn round(
        &self,
        (Prior { guide, new_slots }, Known { parts, bounces }): &Self::Prior,
        round: &Round,
        out: &mut LightValues<V>,
    ) -> Result<(), Canceled> {
        let updater = self.updater;
        out.clone_from(parts);
        updater.straight(round, &self.seen, &self.new_slots, &mut out.direct)?;
        updater.arriving(round, &self.seen, (&*self.new_slots, new_slots.as_deref()), guide.spots.as_ref(), out)?;
        let known = Seen { rows: &self.rows, bounces, is_seen: &self.is_seen };
        let fresh = updater.propagate(updater.change(out), round, &guide.aims, Some(&known), &self.seen.source.fine)?;
        out.add_indirect(&fresh);
        updater.buffers.give(fresh);
        Ok(())
    }
}

/// What came first, and what the rounds of the whole go by once there was a round of it.
pub(super) type Ahead<V> = (Option<First<V>>, Option<Prior<V>>);

impl<V: Solvable> Updater<'_, V> {
    /// Brings up to date what comes first; none where that is nothing.
    pub(super) fn come_first(&self, goal: &Goal, work: &Work) -> Result<Ahead<V>, Canceled> {
        let (first, prior) = match (goal.importance.one_by_one(), goal.focus()) {
            (Some(tiles), focus) => self.tile_by_tile(focus, tiles, goal, work)?,
            (None, Some(focus)) => self.look_first(focus, goal, work)?,
            (None, None) => (None, None),
        };
        // The light of new slots was known roughly.
        Ok((first, prior.map(|prior| Prior { new_slots: None, ..prior })))
    }

    /// Brings what is looked at up to date; none where that is nothing.
    fn look_first(&self, focus: &Focus, goal: &Goal, work: &Work) -> Result<Ahead<V>, Canceled> {
        let is_seen = focus.covers(self.world);
        if !is_seen.iter().any(|seen| *seen) {
            return Ok((None, None));
        }
        let look = self.look(is_seen);
        let rounds = goal.rounds(self.world, self.stage.weights, work, Phase::Part);
        let old = (self.stage.old.stack(), &*self.unchanged_slots);
        let (first, prior) = rounds.run_first(&look, &look.is_seen, Some(old), self.stage.finish)?;
        Ok((first, prior.map(|(prior, _)| prior)))
    }

    /// What rounds of some slots need.
    pub(super) fn look(&self, is_seen: Vec<bool>) -> Look<'_, V> {
        let seen =
            |slots: &[u32]| -> Vec<u32> { slots.iter().copied().filter(|&slot| is_seen[slot as usize]).collect() };
        let (slots, is_near) = (self.world.slots(), self.source.is_near());
        let (unchanged_slots, new_slots) = (seen(&self.unchanged_slots), seen(&self.transition.new_slots));
        let extents = Extents {
            direct: Extent::only(&seen(&self.direct_slots), &self.subset, slots, |_| true),
            source: Extent::only(&unchanged_slots, &self.subset, slots, is_near),
        };
        let mut wanted = [&*unchanged_slots, &*new_slots].concat();
        wanted.sort_unstable();
        let needed = self.subset.needed_by(&wanted, slots);
        let rows = Arc::new(Rows::only(&self.subset, |slot| needed[slot as usize]));
        let count = is_seen.iter().filter(|seen| **seen).count();
        let is_large = count as f64 > LARGE * self.world.element_count() as f64;
        Look { updater: self, seen: extents, rows, new_slots, is_large, is_seen }
    }

    /// Everything at few samples, for all tiles.
    pub(super) fn know_roughly(&self, round: &Round) -> Result<(Prior<V>, Known<V>), Canceled> {
        self.know(round, UNSEEN_SAMPLES, |_| false)
    }

    fn know(
        &self,
        round: &Round,
        samples: u32,
        is_fine: impl Fn(u32) -> bool,
    ) -> Result<(Prior<V>, Known<V>), Canceled> {
        let round = Round { samples, seed: subseed(round.seed, 0xa11), ..*round };
        let mut parts = LightValues::default();
        let (guide, bounces) = self.explore(&round, &self.extents(is_fine), &mut parts)?;
        let indirect = |&slot: &u32| parts.indirect[slot as usize] + bounces[slot as usize];
        let new_slots = Some(self.transition.new_slots.iter().map(indirect).collect());
        Ok((Prior { guide: Arc::new(guide), new_slots }, Known { parts, bounces: bounces.into() }))
    }
}
