//! What somebody looks at, brought up to date before the rest. Everything is estimated once, at few samples and on the
//! representatives; rounds then estimate only what is looked at, since from the rest light arrives by way of at least one
//! bounce, which smooths it.

use std::cell::{OnceCell, RefCell};
use std::sync::Arc;

use super::extent::Extent;
use super::updater::{Extents, Parts, Updater};
use crate::accumulate::Accumulator;
use crate::focus::Focus;
use crate::job::Canceled;
use crate::random::subseed;
use crate::rounds::{Estimate, First, Goal, Phase, Round, Rounds};
use crate::solve::Rows;
use crate::transport::{Value, Work};

/// Samples of what is not looked at, where that is nearly everything.
const UNSEEN_SAMPLES: u32 = 2;

/// Part of the elements from which on what is looked at is estimated along with everything else the first time.
const LARGE: f64 = 0.1;

/// Everything, roughly.
struct Known<V> {
    /// Before any bounce; black where somebody looks.
    parts: Parts<V>,
    bounces: Vec<V>,
    /// Of new rows.
    indirect: Vec<V>,
}

/// What is looked at, and what its rounds need.
struct Look<V> {
    is_seen: Vec<bool>,
    seen: Extents,
    /// Representatives that bounces are interpolated from, where they are seen.
    rows: Arc<Rows>,
    new_rows: Vec<u32>,
    is_large: bool,
    known: OnceCell<Known<V>>,
}

impl<V: Value> Updater<'_, V> {
    /// Brings what is looked at up to date; none where that is nothing.
    pub(super) fn look_first(&self, focus: &Focus, goal: &Goal, work: &Work) -> Result<Option<First<V>>, Canceled> {
        let is_seen = focus.covers(self.world);
        if !is_seen.iter().any(|seen| *seen) {
            return Ok(None);
        }
        let look = self.look(is_seen);
        let last = RefCell::new(None);
        let compose = |s: &Accumulator<V>| {
            let mut stack = self.compose(s);
            let unseen = self.static_rows.iter().copied().filter(|&slot| !look.is_seen[slot as usize]);
            stack.blend(&self.old, unseen, 1.0, None);
            stack.fill_invalid(&self.world.validity);
            last.replace(Some((stack.clone(), s.samples())));
            (self.stage.finish)(stack)
        };
        let (budget, seed) = (&goal.first_budget(), goal.first_seed());
        // The rest of the map is out of date: nothing can be stated about the whole.
        let (len, weights) = (self.world.slots(), self.stage.weights);
        let rounds = Rounds { len, weights, budget, seed, work, phase: Phase::Part };
        rounds.run(|_| None, |_| false, |r| self.round_of(r, &look), compose)?;
        Ok(last.take().map(|(stack, samples)| First { stack, is_seen: look.is_seen, samples }))
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
    fn estimate_all(&self, round: &Round<V>, look: &Look<V>) -> Result<(Known<V>, Estimate<V>), Canceled> {
        let samples = if look.is_large { round.samples } else { UNSEEN_SAMPLES };
        let round = Round { samples, seed: subseed(round.seed, 0xa11), ..*round };
        let mut parts = Parts::black(self.world.slots());
        let extents = self.extents(|slot| look.is_large && look.is_seen[slot as usize]);
        self.arriving(&round, &extents, (&self.transition.new_rows, None), &mut parts)?;
        let bounces = self.propagate(&parts, &round, None)?;
        let estimate = parts.clone().with(&bounces);
        Ok((Known { parts: parts.without(&look.is_seen), bounces, indirect: estimate.1.clone() }, estimate))
    }

    fn round_of(&self, round: &Round<V>, look: &Look<V>) -> Result<Estimate<V>, Canceled> {
        let Known { parts, bounces, indirect } = match look.known.get() {
            Some(known) => known,
            None => {
                let (known, estimate) = self.estimate_all(round, look)?;
                let known = look.known.get_or_init(|| known);
                if look.is_large {
                    return Ok(estimate);
                }
                known
            }
        };
        let mut parts = parts.clone();
        self.arriving(round, &look.seen, (&look.new_rows, Some(indirect)), &mut parts)?;
        let mut fresh = self.propagate(&parts, round, Some((&look.rows, bounces)))?;
        let unseen = look.is_seen.iter().zip(fresh.iter_mut().zip(bounces)).filter(|(seen, _)| !**seen);
        unseen.for_each(|(_, (fresh, known))| *fresh = *known);
        Ok(parts.with(&fresh))
    }
}
