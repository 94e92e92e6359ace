//! Tile after tile, each to its quality before the next, in the order of importance (Ulschmid et al. 2024). What light
//! comes from elsewhere is estimated once, roughly, for all of them: it arrives by way of at least one bounce.

use std::sync::Arc;

use super::look_first::Known;
use super::places::places;
use super::updater::Updater;
use crate::accumulate::Accumulator;
use crate::focus::Focus;
use crate::importance::Tiles;
use crate::job::{Canceled, Pass, Progress, Snapshot};
use crate::layers::Stack;
use crate::random::subseed;
use crate::rounds::{First, Goal, Phase, Round, Rounds};
use crate::tiles::{Place, cut};
use crate::transport::Work;
use crate::value::Value;

/// Part of the largest bound below which a change is not worth a tile of its own where nobody says what he looks at.
const NEGLIGIBLE: f32 = 0.01;

impl<V: Value> Updater<'_, V> {
    /// Brings what comes first up to date, one tile after the other, and shows each; none where there is no such tile.
    pub(super) fn tile_by_tile(
        &self,
        focus: Option<&Focus>,
        tiles: &Tiles,
        goal: &Goal,
        work: &Work,
    ) -> Result<Option<First<V>>, Canceled> {
        let keys = self.keys(focus);
        let order = cut(self.world.positions(), &self.subset.cells(), &keys, tiles.size);
        if order.is_empty() || work.observer().leaves_first() {
            return Ok(None);
        }
        let known = self.know_for_tiles(goal, work)?;
        let mut first = First { stack: self.carried(&known), samples: vec![0; self.world.slots()] };
        for (index, tile) in order.iter().enumerate() {
            let Some(sum) = self.tile(tile, &known, goal, (work, index as u64))? else { break };
            first.stack.take(&self.compose(&sum), tile.iter().copied());
            first.stack.fill_invalid(&self.world.validity);
            tile.iter().for_each(|&slot| first.samples[slot as usize] = sum.samples());
            let done = Progress { rays: work.rays(), ..Progress::at_once(Pass::FinalGather, 0, None) };
            work.observer().progress(&done);
            work.observer().snapshot(&Arc::new(self.finish(&first.stack)), Snapshot::Partial, &done);
        }
        Ok(first.samples.iter().any(|&samples| samples > 0).then_some(first))
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
        let computed = |slot: usize| world.areas()[slot] > 0.0 && world.is_valid(slot);
        keys.iter_mut().enumerate().filter(|(slot, _)| !computed(*slot)).for_each(|(_, key)| *key = f32::INFINITY);
        keys
    }

    /// By the bound on the change, the largest first.
    fn bounds(&self, places: &[Place]) -> Vec<f32> {
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

    fn know_for_tiles(&self, goal: &Goal, work: &Work) -> Result<Known<V>, Canceled> {
        let begin = |pass, fraction| {
            let progress = Progress { round_fraction: fraction, ..Progress::at_once(pass, 0, None) };
            work.observer().progress(&Progress { rays: work.rays(), ..progress });
        };
        let sum = Accumulator::new(self.stage.weights, self.world.stated());
        self.know_roughly(&Round { samples: 1, seed: goal.first_seed(), sum: &sum, begin: &begin })
    }

    /// What is shown before the first tile: old light, and on new rows, which have none, what is known roughly.
    fn carried(&self, known: &Known<V>) -> Stack<V> {
        let mut stack = self.old().clone();
        for &slot in &self.transition.new_rows {
            let slot = slot as usize;
            (stack.light.direct[slot], stack.light.indirect[slot]) = (known.parts.direct[slot], known.indirect[slot]);
        }
        stack.fill_invalid(&self.world.validity);
        stack
    }

    /// One tile; none where the observer ends it.
    fn tile(
        &self,
        tile: &[u32],
        known: &Known<V>,
        goal: &Goal,
        (work, index): (&Work, u64),
    ) -> Result<Option<Accumulator<V>>, Canceled> {
        let mut is_seen = vec![false; self.world.slots()];
        tile.iter().for_each(|&slot| is_seen[slot as usize] = true);
        let known = known.clone().around(&is_seen);
        let look = self.look_with(is_seen, known);
        let (world, weights) = (self.world, self.stage.weights);
        let (budget, seed) = (&goal.first_budget(), subseed(goal.first_seed(), 1 + index));
        let rounds = Rounds { world, weights, budget, seed, work, phase: Phase::Part, guesses: goal.guesses };
        rounds.run_quietly(|round, out| self.round_of(round, &look, out))
    }
}
