//! The loop that bakes and updates share: rounds of growing size until a budget or the caller ends them.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use glam::Vec3;

use crate::accumulate::Accumulator;
use crate::focus::Focus;
use crate::importance::Importance;
use crate::job::{Budget, Canceled, NextPart, Offer, Pass, Progress, Snapshot};
use crate::layers::{Apart, Stack};
use crate::lightmap::{LightMap, LightValues};
use crate::random::{PartSeed, subseed};
use crate::transport::Work;
use crate::value::Value;
use crate::world::{Validity, World};

/// Samples per element of the first two rounds; every later round doubles the total.
const FIRST_SAMPLES: u32 = 4;

/// Samples per element of a part of a round, at most: each solves for its own bounces, which takes that many.
const PART_SAMPLES: u32 = 16;

/// What one round is told beside its prior.
#[derive(Clone, Copy)]
pub(crate) struct Round<'a> {
    /// Samples per element.
    pub samples: u32,
    /// Samples per element of the rounds before it.
    pub earlier: u32,
    /// This round's own seed.
    pub seed: u64,
    /// Which part of the round it is: those before it have as many samples, or one more.
    pub part: u32,
    /// Tells the caller which pass begins, and which part of the round it is, roughly.
    pub begin: &'a dyn Fn(Pass, Range<f32>),
}

impl Round<'_> {
    /// The seed that the parts of the round share.
    pub(crate) fn part_seed(&self) -> PartSeed {
        PartSeed { seed: self.seed, part: self.part }
    }
}

/// What is estimated in independent rounds. A round is a function of what it is told: it leaves nothing behind.
pub(crate) trait Estimator<V: Value> {
    /// What rounds go by: it says where samples are of most use. What they find is right on average whatever it says.
    type Prior;

    /// The first round, written over `out`, and what the next may go by. `known` is what rounds for a part of the map
    /// went by.
    fn first_round(
        &self,
        known: Option<Self::Prior>,
        round: &Round,
        out: &mut LightValues<V>,
    ) -> Result<Self::Prior, Canceled>;

    /// What the next round goes by: what the last went by, and what all of them have found.
    fn prior(&self, last: Self::Prior, sum: &Accumulator<V>) -> Self::Prior;

    /// One independent estimate, written over `out`.
    fn round(&self, prior: &Self::Prior, round: &Round, out: &mut LightValues<V>) -> Result<(), Canceled>;

    /// What others are told who do parts of rounds that go by `prior`; none where rounds are not done in parts.
    fn offer<'a>(&'a self, _prior: &'a Self::Prior) -> Option<Offer<'a>> {
        None
    }
}

/// Samples per element of the parts of a round: as equal as can be, the larger first.
fn parts_of(samples: u32) -> Vec<u32> {
    let count = samples.div_ceil(PART_SAMPLES).max(1);
    (0..count).map(|part| samples / count + u32::from(part < samples % count)).collect()
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
    /// Rounds are done in parts, which may be done elsewhere.
    pub offers: bool,
}

impl Goal<'_> {
    /// What somebody looks at.
    pub(crate) fn focus(&self) -> Option<&Focus> {
        self.importance.focus.as_ref()
    }

    /// Rounds towards it. What comes first is computed to its own quality before the rest.
    pub(crate) fn rounds<'r>(
        &self,
        world: &'r World,
        weights: &'r [Vec3],
        work: &'r Work<'r>,
        phase: Phase,
    ) -> Rounds<'r> {
        let samples = self.budget.samples_per_element.min(self.importance.samples());
        let (budget, seed) = match phase {
            Phase::Part => (Budget { samples_per_element: samples, target_rmse: None }, self.first_seed()),
            Phase::Whole | Phase::Rest => (*self.budget, self.seed),
        };
        Rounds { world, weights, budget, seed, work, phase, guesses: self.guesses }
    }

    /// Seed of what comes first.
    pub(crate) fn first_seed(&self) -> u64 {
        subseed(self.seed, 0xf0c)
    }
}

/// What was computed first, because somebody looks at it.
pub(crate) struct First<V: Value> {
    pub stack: Stack<V>,
    /// Samples per slot.
    pub samples: Vec<u32>,
    /// The light before, whose noise is in this and in what follows; none where all is computed from scratch.
    pub old: Option<Stack<V>>,
}

impl<V: Value> First<V> {
    /// The mean, by samples, of what was done first and what followed, in some slots.
    pub(crate) fn merged(
        &self,
        sum: &Accumulator<V>,
        slots: impl Iterator<Item = u32>,
        validity: &Validity,
    ) -> Stack<V> {
        let weight = |slot: u32| {
            let first = self.samples[slot as usize];
            (first > 0).then(|| (slot, first as f32 / (first + sum.samples()) as f32))
        };
        let mut stack = Stack::of_mean(sum, self.old.as_ref(), validity);
        stack.blend(&self.stack, slots.filter_map(weight), self.old.as_ref());
        stack.fill_invalid(validity);
        stack
    }
}

/// Rounds to be run.
pub(crate) struct Rounds<'a> {
    /// What the map is of.
    pub world: &'a World,
    /// What each layer weighs in the whole.
    pub weights: &'a [Vec3],
    /// When to stop.
    pub budget: Budget,
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

/// What has come of some rounds.
struct Ran<V: Value, P> {
    sum: Accumulator<V>,
    /// What the last went by; none where there was no round, and nothing known.
    prior: Option<P>,
    /// The observer let no more of them run.
    was_ended: bool,
}

/// What is said of all rounds so far.
#[derive(Default)]
struct Judged {
    estimated_rmse: Option<f32>,
    need: Need,
}

/// What an estimate needs beside the rounds so far.
#[derive(Clone, Copy, Default)]
pub(crate) struct Need {
    /// More of them are of no use.
    pub is_met: bool,
    /// See [`Progress::needed`].
    pub factor: Option<f32>,
}

/// Light maps as rounds bring them, and what the next round would go by.
type Mapped<T, P> = (Option<T>, Option<P>);

impl Rounds<'_> {
    /// Runs them for a part of the map that is shown when it is done; none where the observer ends it before.
    pub(crate) fn run_tile<V: Value, E: Estimator<V>>(
        &self,
        estimator: &E,
        known: E::Prior,
    ) -> Result<Option<Accumulator<V>>, Canceled> {
        let least = self.budget.samples_per_element.div_ceil(TILE_PARTS);
        let mut ran = self.run(least, estimator, Some(known), |_, _, _| Judged::default())?;
        if ran.sum.knows_variance() {
            ran.sum.ask_neighbours(self.world);
        }
        Ok((!ran.was_ended).then_some(ran.sum))
    }

    /// Runs them for what somebody looks at, and answers it with what its rounds went by. `old` is the light before, and
    /// the slots that keep it as long as nobody looks; `finish` makes a map of what lies side by side.
    pub(crate) fn run_first<V: Value, E: Estimator<V>>(
        &self,
        estimator: &E,
        is_seen: &[bool],
        old: Option<(Stack<V>, &[u32])>,
        finish: &dyn Fn(Apart) -> LightMap,
    ) -> Result<Mapped<First<V>, E::Prior>, Canceled> {
        let (old, keep) = old.map_or((None, &[][..]), |(old, keep)| (Some(old), keep));
        let mut last = None;
        let compose = |sum: &Accumulator<V>, _: &E::Prior| {
            let mut stack = Stack::of_mean(sum, old.as_ref(), &self.world.validity);
            if let Some(old) = &old {
                stack.take(old, keep.iter().copied().filter(|&slot| !is_seen[slot as usize]));
                stack.fill_invalid(&self.world.validity);
            }
            let map = finish(Apart::of_stack(&stack, self.weights.len()));
            last = Some((stack, sum.samples()));
            map
        };
        // The rest of the map is out of date: nothing can be stated about the whole.
        let (_, prior) = self.run_and_show(estimator, None, |_| None, |_, _| Need::default(), compose)?;
        let samples = |samples: u32| is_seen.iter().map(|seen| if *seen { samples } else { 0 }).collect();
        Ok((last.map(|(stack, done)| First { stack, samples: samples(done), old }), prior))
    }

    /// Runs them, and shows a map after each. `compose` makes it of all, `stated` tells its error, `need` what more it
    /// takes. Answers the last map.
    pub(crate) fn run_and_show<V: Value, E: Estimator<V>>(
        &self,
        estimator: &E,
        known: Option<E::Prior>,
        stated: impl Fn(&LightMap) -> Option<f32>,
        need: impl Fn(&Accumulator<V>, &E::Prior) -> Need,
        mut compose: impl FnMut(&Accumulator<V>, &E::Prior) -> LightMap,
    ) -> Result<Mapped<Arc<LightMap>, E::Prior>, Canceled> {
        let mut last = None;
        let ran = self.run(FIRST_SAMPLES, estimator, known, |sum, prior, samples| {
            if self.guesses || sum.knows_variance() {
                sum.ask_neighbours(self.world);
            }
            let map = Arc::new(compose(sum, prior));
            let estimated_rmse = stated(&map);
            let mut need = need(sum, prior);
            let done = self.progress(sum, Pass::FinalGather, samples, 1.0..1.0);
            let done = Progress { estimated_rmse, needed: need.factor, ..done };
            self.work.observer().progress(&done);
            self.work.observer().snapshot(&map, self.phase.snapshot(estimated_rmse), &done);
            last = Some(map);
            let reached = self.budget.target_rmse.zip(estimated_rmse).is_some_and(|(target, rmse)| rmse <= target);
            // A guess ends nothing.
            need.is_met |= reached && sum.knows_variance();
            Judged { estimated_rmse, need }
        })?;
        Ok((last, ran.prior))
    }

    /// Runs them, the first two of `least` samples, every later one of as many as all before it. `judge` is asked after
    /// each, and told what it went by and its samples.
    fn run<V: Value, E: Estimator<V>>(
        &self,
        least: u32,
        estimator: &E,
        mut prior: Option<E::Prior>,
        mut judge: impl FnMut(&mut Accumulator<V>, &E::Prior, u32) -> Judged,
    ) -> Result<Ran<V, E::Prior>, Canceled> {
        let observer = self.work.observer();
        let mut sum = Accumulator::new(self.weights, self.world.stated());
        let (mut light, mut judged) = (LightValues::default(), Judged::default());
        for index in 0_u32.. {
            let left = self.budget.samples_per_element.saturating_sub(sum.samples());
            if judged.need.is_met {
                break;
            }
            self.work.check()?;
            if left == 0 {
                break;
            }
            let (estimated_rmse, needed) = (judged.estimated_rmse, judged.need.factor);
            let progress =
                |pass, samples, part| Progress { estimated_rmse, needed, ..self.progress(&sum, pass, samples, part) };
            let proposed = sum.samples().max(least).min(left);
            let samples = match self.phase == Phase::Part && observer.leaves_first() {
                true => 0,
                false => observer.plan_round(&progress(Pass::Direct, proposed, 0.0..0.0), proposed).min(proposed),
            };
            let samples = if self.phase == Phase::Rest && index == 0 { samples.max(1) } else { samples };
            if samples == 0 {
                return Ok(Ran { sum, prior, was_ended: true });
            }
            let begin = |pass, part| observer.progress(&progress(pass, samples, part));
            let seed = subseed(self.seed, index.into());
            let round = Round { samples, earlier: sum.samples(), seed, part: 0, begin: &begin };
            let known = match prior {
                Some(last) if round.earlier > 0 => {
                    let prior = estimator.prior(last, &sum);
                    self.run_parts(estimator, &prior, (index, &round), &mut light)?;
                    prior
                }
                known => estimator.first_round(known, &round, &mut light)?,
            };
            sum.add(samples, &mut light);
            judged = judge(&mut sum, &known, samples);
            prior = Some(known);
        }
        Ok(Ran { sum, prior, was_ended: false })
    }

    /// One round, written over `light`: where it is large and the estimator allows it, as the mean of parts that may be
    /// done elsewhere. Where they were done makes no difference to a bit.
    fn run_parts<V: Value, E: Estimator<V>>(
        &self,
        estimator: &E,
        prior: &E::Prior,
        (index, round): (u32, &Round),
        light: &mut LightValues<V>,
    ) -> Result<(), Canceled> {
        let parts = parts_of(round.samples);
        let Some(offer) = estimator.offer(prior).filter(|_| parts.len() > 1) else {
            return estimator.round(prior, round, light);
        };
        let observer = self.work.observer();
        observer.offer(&Offer { round: index, parts: &parts, ..offer });
        let shape = (self.world.slots() as u64, self.weights.len() as u64);
        let (mut found, mut added, mut spare) = (BTreeMap::<u32, LightValues<V>>::new(), 0, LightValues::default());
        let count = parts.len() as u32;
        while added < count {
            if let Some(part) = found.remove(&added) {
                light.add_weighted(&part, parts[added as usize] as f32 / round.samples as f32, added == 0);
                (added, spare) = (added + 1, part);
                continue;
            }
            self.work.check()?;
            let missing: Vec<u32> = (added..count).filter(|part| !found.contains_key(part)).collect();
            let (part, values) = match observer.next_part(&missing) {
                NextPart::Take(estimate) if estimate.is_part_of(index, &parts, &missing, shape) => {
                    (estimate.part, estimate.light())
                }
                next => {
                    let asked = if let NextPart::Run(part) = next { part } else { missing[0] };
                    let part = if missing.contains(&asked) { asked } else { missing[0] };
                    let done = (added as usize + found.len()) as f32;
                    let within = |part: f32| (done + part) / count as f32;
                    let begin = |pass, part: Range<f32>| (round.begin)(pass, within(part.start)..within(part.end));
                    let samples = parts[part as usize];
                    let mut values = std::mem::take(&mut spare);
                    estimator.round(prior, &Round { samples, part, begin: &begin, ..*round }, &mut values)?;
                    (part, values)
                }
            };
            found.insert(part, values);
        }
        Ok(())
    }

    fn progress<V: Value>(&self, sum: &Accumulator<V>, pass: Pass, round_samples: u32, part: Range<f32>) -> Progress {
        Progress {
            pass,
            samples_per_element: if self.phase == Phase::Part { 0 } else { sum.samples() },
            round_samples,
            round_fraction: part.start,
            pass_share: part.end - part.start,
            rays: self.work.rays(),
            estimated_rmse: None,
            needed: None,
        }
    }
}
