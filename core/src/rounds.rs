//! The loop that bakes and updates share: rounds of growing size until a budget or the caller ends them.

use std::sync::Arc;

use crate::accumulate::Accumulator;
use crate::focus::Focus;
use crate::importance::Importance;
use crate::job::{Budget, Canceled, Pass, Progress, Snapshot};
use crate::layers::Stack;
use crate::lightmap::{LightMap, LightValues};
use crate::random::subseed;
use crate::transport::Work;
use crate::value::Value;
use crate::world::World;

/// Samples per element of the first two rounds; every later round doubles the total.
const FIRST_SAMPLES: u32 = 4;

/// What one round is told.
#[derive(Clone, Copy)]
pub(crate) struct Round<'a, V> {
    /// Samples per element.
    pub samples: u32,
    /// This round's own seed.
    pub seed: u64,
    /// What earlier rounds have gathered.
    pub sum: &'a Accumulator<V>,
    /// Tells the caller which pass begins; `f32` is the part of the round that is done.
    pub begin: &'a dyn Fn(Pass, f32),
}

/// What a run of rounds is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    /// The whole map.
    Whole,
    /// A part that comes first. Its samples do not count: the rest of the map is still out of date.
    Part,
    /// The whole map behind such a part: at least one sample is taken, whatever the observer plans, because a map of
    /// old and new values must not stay.
    Rest,
}

impl Phase {
    /// What a map of this phase holds.
    fn snapshot(self, stated: Option<f32>) -> Snapshot {
        match self {
            Phase::Part => Snapshot::Partial,
            Phase::Whole | Phase::Rest => Snapshot::Complete { stated },
        }
    }
}

/// How far a computation goes, and where first.
#[derive(Clone, Copy)]
pub(crate) struct Goal<'a> {
    pub budget: &'a Budget,
    pub importance: &'a Importance,
    pub seed: u64,
    /// An estimate may be shown before the first round: there is no light to be shown yet.
    pub estimates: bool,
    /// A first round states the error that it is guessed to have. What is averaged by its variance waits until it is
    /// known.
    pub guesses: bool,
}

impl Goal<'_> {
    /// What somebody looks at.
    pub(crate) fn focus(&self) -> Option<&Focus> {
        self.importance.focus.as_ref()
    }

    /// How far what comes first is computed before the rest.
    pub(crate) fn first_budget(&self) -> Budget {
        let samples = self.importance.samples();
        Budget { samples_per_element: self.budget.samples_per_element.min(samples), target_rmse: None }
    }

    /// Seed of what comes first.
    pub(crate) fn first_seed(&self) -> u64 {
        subseed(self.seed, 0xf0c)
    }
}

/// What was computed first, because somebody looks at it.
pub(crate) struct First<V> {
    pub stack: Stack<V>,
    /// Samples per slot.
    pub samples: Vec<u32>,
}

impl<V: Value> First<V> {
    /// With the same number of samples wherever somebody looks.
    pub(crate) fn evenly(stack: Stack<V>, is_seen: &[bool], samples: u32) -> First<V> {
        First { stack, samples: is_seen.iter().map(|seen| if *seen { samples } else { 0 }).collect() }
    }

    /// The mean, by samples, of what was done first and what followed, in some slots. Both hold the noise of `shared`.
    pub(crate) fn merge(
        &self,
        stack: &mut Stack<V>,
        samples: u32,
        slots: impl Iterator<Item = u32>,
        shared: Option<&Stack<V>>,
    ) {
        let weight = |first: u32| first as f32 / (first + samples) as f32;
        let of = |slot: u32| (self.samples[slot as usize] > 0).then(|| (slot, weight(self.samples[slot as usize])));
        stack.blend(&self.stack, slots.filter_map(of), shared);
    }
}

/// Rounds to be run.
pub(crate) struct Rounds<'a> {
    /// What the map is of.
    pub world: &'a World,
    /// What each layer weighs in the whole.
    pub weights: &'a [glam::Vec3],
    /// When to stop.
    pub budget: &'a Budget,
    /// Every round gets one of its own from it.
    pub seed: u64,
    /// Rays, cancel, observer.
    pub work: &'a Work<'a>,
    /// What they are for.
    pub phase: Phase,
    /// See [`Goal::guesses`].
    pub guesses: bool,
}

/// Parts of a tile's samples that its first rounds have: so many rounds tell its variance.
const TILE_PARTS: u32 = 4;

impl Rounds<'_> {
    /// Runs them for a part of the map that is shown when it is done; none where the observer ends it before.
    pub(crate) fn run_quietly<V: Value>(
        &self,
        mut round: impl FnMut(&Round<V>, &mut LightValues<V>) -> Result<(), Canceled>,
    ) -> Result<Option<Accumulator<V>>, Canceled> {
        let (budget, work) = (self.budget, self.work);
        let observer = work.observer();
        let mut sum = Accumulator::new(self.weights, self.world.stated());
        let mut light = LightValues::default();
        for index in 0.. {
            let left = budget.samples_per_element.saturating_sub(sum.samples());
            if left == 0 {
                break;
            }
            let proposed = sum.samples().max(budget.samples_per_element.div_ceil(TILE_PARTS)).min(left);
            let progress = |pass, round_samples, round_fraction| Progress {
                pass,
                samples_per_element: 0,
                round_samples,
                round_fraction,
                rays: work.rays(),
                estimated_rmse: None,
            };
            work.check()?;
            if observer.leaves_first() {
                return Ok(None);
            }
            let samples = observer.plan_round(&progress(Pass::Direct, proposed, 0.0), proposed).min(proposed);
            if samples == 0 {
                return Ok(None);
            }
            let begin = |pass, fraction| observer.progress(&progress(pass, samples, fraction));
            round(&Round { samples, seed: subseed(self.seed, index), sum: &sum, begin: &begin }, &mut light)?;
            sum.add(samples, &mut light);
        }
        Ok(Some(sum))
    }

    /// Runs them. `round` writes one independent estimate over the one before it, `compose` makes a light map of all,
    /// `stated` tells its error, `enough` whether more rounds are of no use.
    pub(crate) fn run<V: Value>(
        &self,
        stated: impl Fn(&LightMap) -> Option<f32>,
        enough: impl Fn(&Accumulator<V>) -> bool,
        mut round: impl FnMut(&Round<V>, &mut LightValues<V>) -> Result<(), Canceled>,
        mut compose: impl FnMut(&Accumulator<V>) -> LightMap,
    ) -> Result<Option<Arc<LightMap>>, Canceled> {
        let Rounds { budget, work, phase, .. } = *self;
        let observer = work.observer();
        let mut sum = Accumulator::new(self.weights, self.world.stated());
        let mut light = LightValues::default();
        let mut last: Option<Arc<LightMap>> = None;
        let mut estimated_rmse = None;
        for index in 0.. {
            let left = budget.samples_per_element.saturating_sub(sum.samples());
            let proposed = sum.samples().max(FIRST_SAMPLES).min(left);
            let progress = |pass, round_samples, round_fraction| Progress {
                pass,
                samples_per_element: if phase == Phase::Part { 0 } else { sum.samples() },
                round_samples,
                round_fraction,
                rays: work.rays(),
                estimated_rmse,
            };
            work.check()?;
            if proposed == 0 || phase == Phase::Part && observer.leaves_first() {
                break;
            }
            let samples = observer.plan_round(&progress(Pass::Direct, proposed, 0.0), proposed).min(proposed);
            let samples = if phase == Phase::Rest && index == 0 { samples.max(1) } else { samples };
            if samples == 0 {
                break;
            }
            let begin = |pass, fraction| observer.progress(&progress(pass, samples, fraction));
            round(&Round { samples, seed: subseed(self.seed, index), sum: &sum, begin: &begin }, &mut light)?;
            sum.add(samples, &mut light);
            if self.guesses {
                sum.guess_variance(self.world);
            }
            let map = Arc::new(compose(&sum));
            estimated_rmse = stated(&map);
            let done = Progress {
                pass: Pass::FinalGather,
                samples_per_element: if phase == Phase::Part { 0 } else { sum.samples() },
                round_samples: samples,
                round_fraction: 1.0,
                rays: work.rays(),
                estimated_rmse,
            };
            observer.progress(&done);
            observer.snapshot(&map, phase.snapshot(estimated_rmse), &done);
            let reached = matches!((budget.target_rmse, estimated_rmse), (Some(target), Some(rmse)) if rmse <= target);
            // A guess ends nothing.
            let enough = reached && sum.knows_variance() || enough(&sum);
            last = Some(map);
            if enough {
                break;
            }
        }
        Ok(last)
    }
}
