//! The service's side of a running job: time, cancel, progress, snapshots.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use super::Stop;
use super::phases::PhaseClock;
use super::queue::{JobNumber, JobProgress};
use crate::engine::{LightMap, Observer, Progress, lengthened};
use crate::state::App;
use crate::store::lighting::{Lit, Sequence};
use crate::store::scenes::SceneEntry;

/// When a job stops; the first bound that is reached ends it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct JobBudget {
    pub(crate) samples_per_element: u32,
    pub(crate) max_seconds: Option<f64>,
    pub(crate) target_rmse: Option<f32>,
}

impl JobBudget {
    /// A budget that is used up when both are.
    pub(crate) fn both(self, other: JobBudget) -> JobBudget {
        JobBudget {
            samples_per_element: self.samples_per_element.max(other.samples_per_element),
            max_seconds: self.max_seconds.zip(other.max_seconds).map(|(a, b)| a.max(b)),
            target_rmse: self.target_rmse.zip(other.target_rmse).map(|(a, b)| a.min(b)),
        }
    }
}

/// Decides how large a round may be so that a job ends on time.
///
/// A round costs something by itself and something per sample; two rounds of different size tell both. The first
/// round is a single sample, because nothing is known before it. A job does at least that one: without it there is
/// nothing to show for the time.
#[derive(Debug, Default)]
pub(crate) struct Pace {
    /// The round that runs: when it began, and its samples.
    running: Option<(f64, u32)>,
    /// The round before the last one: its seconds and samples.
    measured: Option<(f64, u32)>,
}

impl Pace {
    const FIRST_ROUND: u32 = 1;

    pub(crate) fn plan(&mut self, now_secs: f64, max_seconds: f64, proposed: u32) -> u32 {
        let samples = match self.running {
            None => proposed.min(Pace::FIRST_ROUND),
            Some((started_secs, samples)) => {
                let last = (now_secs - started_secs, samples);
                let (secs_per_round, secs_per_sample) = self.speed(last);
                self.measured = Some(last);
                // `as` saturates: where there is no room left this is 0.
                proposed.min(((max_seconds - now_secs - secs_per_round) / secs_per_sample) as u32)
            }
        };
        self.running = Some((now_secs, samples));
        samples
    }

    /// Seconds per round and, on top, per sample.
    fn speed(&self, (secs, samples): (f64, u32)) -> (f64, f64) {
        const SHORTEST: f64 = 1e-9;
        let all_per_sample = (secs / f64::from(samples.max(1))).max(SHORTEST);
        match self.measured {
            Some((before_secs, before)) if before < samples => {
                let per_sample = (secs - before_secs) / f64::from(samples - before);
                // Noise can make larger rounds look free or rounds themselves cheaper than nothing.
                let per_sample = per_sample.clamp(0.25 * all_per_sample, all_per_sample).max(SHORTEST);
                (secs - per_sample * f64::from(samples), per_sample)
            }
            _ => (0.0, all_per_sample),
        }
    }
}

/// How much of the budget is used: the bound that is nearest to its end counts.
pub(crate) fn fraction(budget: &JobBudget, progress: &Progress, elapsed_secs: f64) -> f64 {
    // A round that is finished counts among the samples already.
    let part = if progress.round_fraction < 1.0 { f64::from(progress.round_fraction.max(0.0)) } else { 0.0 };
    let running = f64::from(progress.round_samples) * part;
    let samples = (f64::from(progress.samples_per_element) + running) / f64::from(budget.samples_per_element.max(1));
    let time = budget.max_seconds.map_or(0.0, |max| elapsed_secs / max.max(1e-9));
    // The error falls with the root of the samples.
    let error = match (budget.target_rmse, progress.estimated_rmse) {
        (Some(target), Some(now)) if now > 0.0 => f64::from(target / now).powi(2),
        _ => 0.0,
    };
    let fraction = samples.max(time).max(error);
    if fraction.is_finite() { fraction.clamp(0.0, 1.0) } else { 0.0 }
}

/// Time to the end at the pace so far; none while that says nothing.
fn remaining_ms(fraction: f64, elapsed: Duration) -> Option<u64> {
    const MEASURED: f64 = 0.02;
    (fraction >= MEASURED).then(|| (elapsed.as_secs_f64() * 1e3 * (1.0 - fraction) / fraction) as u64)
}

/// Observes one job, one transition (or bake) after the other.
pub(crate) struct JobObserver<'a> {
    pub(crate) app: &'a Arc<App>,
    pub(crate) scene: &'a Arc<SceneEntry>,
    pub(crate) job: JobNumber,
    pub(crate) budget: JobBudget,
    pub(crate) stop: &'a Stop,
    pub(crate) started: Instant,
    /// What the maps of the work under way are right for.
    pub(crate) sequence: Sequence,
    /// Length of the maps that are published: edits that were merged may need less.
    pub(crate) slots: usize,
    state: Mutex<State>,
    /// There is a complete map, so time may end the work.
    complete: AtomicBool,
    /// What is under way is a step of a drag: the next one ends it once there is anything to show.
    pub(crate) drags: bool,
    /// What is under way goes tile by tile: a newer edit ends it once there is a complete map that states its error.
    pub(crate) yields: bool,
    /// An estimate is published.
    estimated: AtomicBool,
    /// There is a complete map that states its error.
    stated: AtomicBool,
}

#[derive(Default)]
struct State {
    pace: Pace,
    latest: Option<Arc<LightMap>>,
    version: Option<u64>,
    reported: Option<(Instant, &'static str)>,
    /// The stated error of what is published for the same edit already, by a run that was interrupted.
    floor: Option<f32>,
    /// The last map was not published, because there is a better one.
    held_back: Option<Progress>,
    /// Time ended it.
    cut: bool,
    clock: PhaseClock,
    saved: Option<Instant>,
}

impl<'a> JobObserver<'a> {
    pub(crate) fn new(
        app: &'a Arc<App>,
        scene: &'a Arc<SceneEntry>,
        job: JobNumber,
        budget: JobBudget,
        stop: &'a Stop,
    ) -> JobObserver<'a> {
        JobObserver {
            app,
            scene,
            job,
            budget,
            stop,
            started: Instant::now(),
            sequence: 0,
            slots: 0,
            state: Mutex::default(),
            complete: AtomicBool::new(false),
            drags: false,
            yields: false,
            estimated: AtomicBool::new(false),
            stated: AtomicBool::new(false),
        }
    }

    /// From here on maps are right for `sequence`, and those with a larger stated error than `floor` are held back.
    pub(crate) fn begin(&mut self, sequence: Sequence, floor: Option<f32>) {
        self.sequence = sequence;
        self.complete = AtomicBool::new(false);
        (self.drags, self.yields) = (false, false);
        (self.estimated, self.stated) = (AtomicBool::new(false), AtomicBool::new(false));
        let mut state = self.lock();
        state.latest = None;
        state.held_back = None;
        state.floor = floor;
        state.pace = Pace::default();
        state.cut = false;
    }

    /// The last complete map since [`JobObserver::begin`], and its progress where it was held back.
    pub(crate) fn take_latest(&self) -> (Option<Arc<LightMap>>, Option<Progress>) {
        let mut state = self.lock();
        state.clock.stop(&self.app.metrics);
        (state.latest.take(), state.held_back.take())
    }

    /// Tells of a version that was published without a round.
    pub(crate) fn shown(&self, version: u64) {
        self.lock().version = Some(version);
    }

    fn elapsed(&self) -> Duration {
        self.started.elapsed()
    }

    /// The time is over by more than planning can be blamed for, and there is a map to show.
    fn is_overdue(&self) -> bool {
        const GRACE: f64 = 1.1;
        self.complete.load(Ordering::Relaxed)
            && self.budget.max_seconds.is_some_and(|max| self.elapsed().as_secs_f64() > max * GRACE)
    }

    /// Whether time ended what is under way before it was as accurate as was asked for.
    pub(crate) fn was_cut(&self) -> bool {
        self.lock().cut || self.is_overdue() || self.is_superseded()
    }

    /// There is something to show, and the next step of the drag waits; or a complete map, and a newer edit does.
    fn is_superseded(&self) -> bool {
        let is_shown = self.estimated.load(Ordering::Relaxed) || self.complete.load(Ordering::Relaxed);
        let is_stated = self.stated.load(Ordering::Relaxed);
        self.stop.is_superseded() && (self.drags && is_shown || self.yields && is_stated)
    }

    /// The next step of the drag has ended this one before it had more than an estimate.
    pub(crate) fn ended_as_estimate(&self) -> bool {
        self.is_superseded() && !self.stop.is_requested() && !self.complete.load(Ordering::Relaxed)
    }

    fn report(&self, progress: &Progress, version: Option<u64>) {
        let elapsed = self.elapsed();
        let fraction = fraction(&self.budget, progress, elapsed.as_secs_f64());
        let report = JobProgress {
            fraction,
            pass: Some(progress.pass.as_str()),
            samples_per_element: progress.samples_per_element,
            elapsed_ms: elapsed.as_millis() as u64,
            estimated_rmse: progress.estimated_rmse,
            rays: progress.rays,
            version,
            remaining_ms: remaining_ms(fraction, elapsed),
        };
        self.app.report(self.job, report);
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Observer for JobObserver<'_> {
    fn canceled(&self) -> bool {
        self.stop.is_requested() || self.is_overdue() || self.is_superseded()
    }

    fn progress(&self, progress: &Progress) {
        let version = {
            let mut state = self.lock();
            state.clock.tick(&self.app.metrics, progress);
            let pass = progress.pass.as_str();
            let is_news = state
                .reported
                .is_none_or(|(at, last_pass)| last_pass != pass || at.elapsed() >= self.app.config.timeouts.progress);
            if !is_news {
                return;
            }
            state.reported = Some((Instant::now(), pass));
            state.version
        };
        self.report(progress, version);
    }

    fn plan_round(&self, so_far: &Progress, proposed: u32) -> u32 {
        self.progress(so_far);
        match self.budget.max_seconds {
            None => proposed,
            Some(max) => {
                let mut state = self.lock();
                let samples = state.pace.plan(self.elapsed().as_secs_f64(), max, proposed);
                state.cut |= samples == 0;
                samples
            }
        }
    }

    fn leaves_first(&self) -> bool {
        self.yields && self.stop.is_superseded()
    }

    /// An estimate takes the place of nothing, never of a map that is right: an interrupted bake has shown one already.
    fn wants_estimates(&self) -> bool {
        self.lock().floor.is_none()
    }

    fn estimate(&self, map: &Arc<LightMap>, progress: &Progress) {
        self.publish_estimate(map, progress);
    }

    fn snapshot(&self, map: &Arc<LightMap>, progress: &Progress) {
        let map = &lengthened(map, self.slots);
        {
            let mut state = self.lock();
            // Before the first finished round the map is only carried over.
            if progress.samples_per_element > 0 {
                state.latest = Some(map.clone());
                self.complete.store(true, Ordering::Relaxed);
                self.stated.store(progress.estimated_rmse.is_some(), Ordering::Relaxed);
            }
            let is_worse = |floor: f32| progress.estimated_rmse.is_none_or(|rmse| rmse.is_nan() || rmse > floor);
            if state.floor.is_some_and(is_worse) {
                state.held_back = Some(*progress);
                return;
            }
            state.held_back = None;
        }
        self.publish(map, progress);
    }
}

impl JobObserver<'_> {
    /// Publishes a map of this job.
    pub(crate) fn publish(&self, map: &Arc<LightMap>, progress: &Progress) {
        self.publish_as(map, progress, progress.samples_per_element > 0);
    }

    /// Publishes an estimate: nothing starts from it.
    pub(crate) fn publish_estimate(&self, map: &Arc<LightMap>, progress: &Progress) {
        self.publish_as(&lengthened(map, self.slots), progress, false);
        self.estimated.store(true, Ordering::Relaxed);
    }

    fn publish_as(&self, map: &Arc<LightMap>, progress: &Progress, is_right: bool) {
        if !self.app.may_publish(self.scene) {
            return;
        }
        let lit = Lit { map, estimated_rmse: progress.estimated_rmse, is_right };
        let published = self.scene.snapshot(self.sequence, lit);
        let is_due = {
            let mut state = self.lock();
            state.version = Some(published.version);
            state.reported = Some((Instant::now(), progress.pass.as_str()));
            let saved = state.saved.get_or_insert(self.started);
            // What is not right is not worth keeping.
            let is_due = is_right && saved.elapsed() >= self.app.config.timeouts.save;
            if is_due {
                state.saved = Some(Instant::now());
            }
            is_due
        };
        self.report(progress, Some(published.version));
        self.app.tell_snapshot(self.scene, Some(self.job), &published, Some(progress));
        if is_due {
            self.app.save_soon(self.scene);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::Progress;

    /// A job of doubling rounds at a constant speed with a fixed cost per round: when does it end?
    fn ends_at(max_seconds: f64, secs_per_sample: f64, secs_per_round: f64) -> f64 {
        let (mut pace, mut now, mut done) = (Pace::default(), 0.0, 0u32);
        loop {
            let samples = pace.plan(now, max_seconds, done.max(4));
            if samples == 0 {
                return now;
            }
            now += secs_per_round + f64::from(samples) * secs_per_sample;
            done += samples;
        }
    }

    #[test]
    fn time_budgets_are_met() {
        for max in [1.0, 5.0, 60.0] {
            for rate in [0.0005, 0.001, 0.01, 0.05] {
                for fixed in [0.0, 0.5, 4.0] {
                    let end = ends_at(max, rate, rate * fixed);
                    assert!(end <= max * 1.05, "{end} s of {max} s at {rate} s per sample, {fixed} samples per round");
                    assert!(end >= max * 0.6, "{end} s of {max} s at {rate} s per sample, {fixed} samples per round");
                }
            }
        }
    }

    #[test]
    fn at_least_one_round_is_done() {
        assert_eq!(ends_at(0.01, 3.0, 1.0), 4.0);
    }

    #[test]
    fn the_nearest_bound_counts() {
        let budget = JobBudget { samples_per_element: 100, max_seconds: Some(10.0), target_rmse: Some(0.1) };
        let mut progress = Progress {
            pass: rebake_core::Pass::Direct,
            samples_per_element: 10,
            round_samples: 10,
            round_fraction: 0.5,
            rays: 0,
            estimated_rmse: None,
        };
        assert_eq!(fraction(&budget, &progress, 1.0), 0.15);
        assert_eq!(fraction(&budget, &progress, 5.0), 0.5);
        progress.estimated_rmse = Some(0.125);
        assert!((fraction(&budget, &progress, 1.0) - 0.64).abs() < 1e-6);
        progress.estimated_rmse = Some(f32::NAN);
        assert_eq!(fraction(&budget, &progress, 1.0), 0.15);
    }
}
