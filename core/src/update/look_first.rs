//! What somebody looks at, brought up to date before the rest. Everything is estimated once, at few samples and on the
//! representatives; rounds then estimate only what is looked at, since from the rest light arrives by way of at least
//! one bounce, which smooths it.

use std::cell::OnceCell;
use std::sync::Arc;

use super::extent::Extent;
use super::updater::{Extents, Updater};
use crate::accumulate::Accumulator;
use crate::focus::Focus;
use crate::job::Canceled;
use crate::lightmap::LightValues;
use crate::random::subseed;
use crate::rounds::{First, Goal, Phase, Round, Rounds};
use crate::solve::Rows;
use crate::transport::Work;
use crate::value::Value;

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
    /// Of new rows.
    pub indirect: Arc<[V]>,
}

/// What is looked at, and what its rounds need.
pub(super) struct Look<V> {
    is_seen: Vec<bool>,
    seen: Extents,
    /// Representatives that bounces are interpolated from, where they are seen.
    rows: Arc<Rows>,
    new_rows: Vec<u32>,
    is_large: bool,
    known: OnceCell<Known<V>>,
}

impl<V: Value> Known<V> {
    /// What is known around slots that somebody looks at.
    pub(super) fn around(mut self, is_seen: &[bool]) -> Known<V> {
        self.parts = self.parts.without(is_seen);
        self
    }
}

impl<V: Value> Updater<'_, V> {
    /// Brings up to date what comes first; none where that is nothing.
    pub(super) fn come_first(&self, goal: &Goal, work: &Work) -> Result<Option<First<V>>, Canceled> {
        match (goal.importance.one_by_one(), goal.focus()) {
            (Some(tiles), focus) => self.tile_by_tile(focus, tiles, goal, work),
            (None, Some(focus)) => self.look_first(focus, goal, work),
            (None, None) => Ok(None),
        }
    }

    /// Brings what is looked at up to date; none where that is nothing.
    fn look_first(&self, focus: &Focus, goal: &Goal, work: &Work) -> Result<Option<First<V>>, Canceled> {
        let is_seen = focus.covers(self.world);
        if !is_seen.iter().any(|seen| *seen) {
            return Ok(None);
        }
        let look = self.look(is_seen);
        let mut last = None;
        let compose = |s: &Accumulator<V>| {
            let mut stack = self.compose(s);
            let unseen = self.static_rows.iter().copied().filter(|&slot| !look.is_seen[slot as usize]);
            stack.take(self.old(), unseen);
            stack.fill_invalid(&self.world.validity);
            let map = self.finish(&stack);
            last = Some((stack, s.samples()));
            map
        };
        let (budget, seed) = (&goal.first_budget(), goal.first_seed());
        // The rest of the map is out of date: nothing can be stated about the whole.
        let (world, weights) = (self.world, self.stage.weights);
        let rounds = Rounds { world, weights, budget, seed, work, phase: Phase::Part, guesses: goal.guesses };
        rounds.run(|_| None, |_| false, |r, out| self.round_of(r, &look, out), compose)?;
        Ok(last.map(|(stack, samples)| First::evenly(stack, &look.is_seen, samples)))
    }

    /// With what is known of everything else.
    pub(super) fn look_with(&self, is_seen: Vec<bool>, known: Known<V>) -> Look<V> {
        Look { is_large: false, known: OnceCell::from(known), ..self.look(is_seen) }
    }

    fn look(&self, is_seen: Vec<bool>) -> Look<V> {
        let seen = |rows: &[u32]| -> Vec<u32> { rows.iter().copied().filter(|&slot| is_seen[slot as usize]).collect() };
        let (slots, is_near) = (self.world.slots(), self.source.is_near());
        let (static_rows, new_rows) = (seen(&self.static_rows), seen(&self.transition.new_rows));
        let extents = Extents {
            direct: Extent::only(&static_rows, &self.subset, slots, |_| true),
            source: Extent::only(&static_rows, &self.subset, slots, is_near),
        };
        let needed = self.subset.needed_by(&[static_rows, new_rows.clone()].concat(), slots);
        let rows = Arc::new(Rows::only(&self.subset, |slot| needed[slot as usize]));
        let count = is_seen.iter().filter(|seen| **seen).count();
        let is_large = count as f64 > LARGE * self.world.element_count() as f64;
        Look { seen: extents, rows, new_rows, is_large, known: OnceCell::new(), is_seen }
    }

    /// Estimates everything; element by element where somebody looks and that is much. Answers that estimate, too.
    fn estimate_all(&self, round: &Round<V>, look: &Look<V>) -> Result<(Known<V>, LightValues<V>), Canceled> {
        let samples = if look.is_large { round.samples } else { UNSEEN_SAMPLES };
        let known = self.know(round, samples, |slot| look.is_large && look.is_seen[slot as usize])?;
        let mut estimate = known.parts.clone();
        estimate.add_indirect(&known.bounces);
        Ok((known.around(&look.is_seen), estimate))
    }

    /// Everything at few samples, for all tiles.
    pub(super) fn know_roughly(&self, round: &Round<V>) -> Result<Known<V>, Canceled> {
        self.know(round, UNSEEN_SAMPLES, |_| false)
    }

    fn know(&self, round: &Round<V>, samples: u32, is_fine: impl Fn(u32) -> bool) -> Result<Known<V>, Canceled> {
        let round = Round { samples, seed: subseed(round.seed, 0xa11), ..*round };
        let mut parts = LightValues::default();
        parts.blacken(self.world.slots());
        self.arriving(&round, &self.extents(is_fine), (&self.transition.new_rows, None), &mut parts)?;
        let bounces = self.propagate(&parts, &round, None, &[])?;
        let indirect = parts.indirect.iter().zip(&bounces).map(|(i, b)| *i + *b).collect();
        Ok(Known { parts, bounces: bounces.into(), indirect })
    }

    pub(super) fn round_of(&self, round: &Round<V>, look: &Look<V>, out: &mut LightValues<V>) -> Result<(), Canceled> {
        let Known { parts, bounces, indirect } = match look.known.get() {
            Some(known) => known,
            None => {
                let (known, estimate) = self.estimate_all(round, look)?;
                let known = look.known.get_or_init(|| known);
                if look.is_large {
                    *out = estimate;
                    return Ok(());
                }
                known
            }
        };
        *out = parts.clone();
        self.arriving(round, &look.seen, (&look.new_rows, Some(indirect)), out)?;
        let mut fresh = self.propagate(out, round, Some((&look.rows, bounces)), &look.seen.source.fine)?;
        let unseen = look.is_seen.iter().zip(fresh.iter_mut().zip(bounces.iter())).filter(|(seen, _)| !**seen);
        unseen.for_each(|(_, (fresh, known))| *fresh = *known);
        out.add_indirect(&fresh);
        self.buffers.give(fresh);
        Ok(())
    }
}
