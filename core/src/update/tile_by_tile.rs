//! Tile after tile, each to its quality before the next, in the order of importance (Ulschmid et al. 2024). What light
//! comes from elsewhere is estimated once, roughly, for all of them: it arrives by way of at least one bounce.

use std::ops::Range;
use std::sync::Arc;

use super::look_first::{Ahead, Known};
use super::places::places;
use super::updater::{Prior, Updater};
use crate::focus::Focus;
use crate::importance::Tiles;
use crate::job::{Canceled, Pass, Progress, Snapshot};
use crate::layers::Stack;
use crate::random::subseed;
use crate::rounds::{First, Goal, Phase, Round, Rounds};
use crate::solve::Solvable;
use crate::tiles::{ChangedSphere, cut};
use crate::transport::Work;

/// Part of the largest bound below which a change is not worth a tile of its own where nobody says what he looks at.
const NEGLIGIBLE: f32 = 0.01;

impl<V: Solvable> Updater<'_, V> {
    /// Brings what comes first up to date, one tile after the other, and shows each; none where there is no such tile.
    pub(super) fn tile_by_tile(
        &self,
        focus: Option<&Focus>,
        tiles: &Tiles,
        goal: &Goal,
        work: &Work,
    ) -> Result<Ahead<V>, Canceled> {
        let keys = self.keys(focus);
        let order = cut(self.world.positions(), &self.subset.cells(), &keys, tiles.size);
        if order.is_empty() || work.observer().leaves_first() {
            return Ok((None, None));
        }
        let (prior, known) = self.know_for_tiles(goal, work)?;
        let old = self.stage.old.stack();
        let mut stack = self.carried(&old, &prior, &known);
        let mut samples = vec![0; self.world.slots()];
        for (index, tile) in order.iter().enumerate() {
            let mut is_seen = vec![false; self.world.slots()];
            tile.iter().for_each(|&slot| is_seen[slot as usize] = true);
            let known = (prior.clone(), known.clone().around(&is_seen));
            let seed = subseed(goal.first_seed(), 1 + index as u64);
            let rounds = Rounds { seed, ..goal.rounds(self.world, self.stage.weights, work, Phase::Part) };
            let Some(sum) = rounds.run_tile(&self.look(is_seen), known)? else { break };
            stack.take(&Stack::of_mean(&sum, Some(&old), &self.world.validity), tile.iter().copied());
            stack.fill_invalid(&self.world.validity);
            tile.iter().for_each(|&slot| samples[slot as usize] = sum.samples());
            let done = Progress { rays: work.rays(), ..Progress::at_once(Pass::FinalGather, 0, None) };
            work.observer().progress(&done);
            work.observer().snapshot(&Arc::new(self.finish(&stack)), Snapshot::Partial, &done);
        }
        let first = samples.iter().any(|&samples| samples > 0).then_some(First { stack, samples, old: Some(old) });
        Ok((first, Some(prior)))
    }

    /// Per slot how soon its turn comes; infinite where it does not come before the rest.
    fn keys(&self, focus: Option<&Focus>) -> Vec<f32> {
        let world = self.world;
        let light = |v: &V| v.weighted(self.stage.guides).max_element();
        let brightest = self.before_total.iter().map(light).fold(0.0, f32::max).max(f32::MIN_POSITIVE);
        let places = places(self.transition, brightest);
        let mut keys = match focus {
            Some(focus) => focus.keys(world, &places),
            None => self.bounds(&places),
        };
        keys.iter_mut()
            .enumerate()
            .filter(|(slot, _)| !world.is_computed(*slot))
            .for_each(|(_, key)| *key = f32::INFINITY);
        keys
    }

    /// By the bound on the change, the largest first.
    fn bounds(&self, places: &[ChangedSphere]) -> Vec<f32> {
        let world = self.world;
        let bound = |slot: usize| {
            let (point, n) = (world.positions()[slot], world.normals()[slot]);
            places.iter().map(|place| place.bound(point, n)).fold(0.0, f32::max)
        };
        let bounds: Vec<f32> = (0..world.slots()).map(bound).collect();
        let largest = bounds.iter().copied().fold(0.0, f32::max);
        let key = |bound: f32| if bound > NEGLIGIBLE * largest { -bound } else { f32::INFINITY };
        bounds.into_iter().map(key).collect()
    }

    fn know_for_tiles(&self, goal: &Goal, work: &Work) -> Result<(Prior<V>, Known<V>), Canceled> {
        let begin = |pass, part: Range<f32>| {
            let progress = Progress { round_fraction: part.start, ..Progress::at_once(pass, 0, None) };
            work.observer().progress(&Progress { rays: work.rays(), ..progress });
        };
        self.know_roughly(&Round { samples: 1, earlier: 0, seed: goal.first_seed(), part: 0, begin: &begin })
    }

    /// What is shown before the first tile: old light, and on new slots, which have none, what is known roughly.
    fn carried(&self, old: &Stack<V>, prior: &Prior<V>, known: &Known<V>) -> Stack<V> {
        let mut stack = old.clone();
        for (&slot, indirect) in
            self.transition.new_slots.iter().zip(prior.new_slots.iter().flat_map(|values| &**values))
        {
            let slot = slot as usize;
            (stack.light.direct[slot], stack.light.indirect[slot]) = (known.parts.direct[slot], *indirect);
        }
        stack.fill_invalid(&self.world.validity);
        stack
    }
}
