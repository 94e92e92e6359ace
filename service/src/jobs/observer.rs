//! The service's side of a running job: time, cancel, progress, snapshots.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::Jobs;
use super::budget::{JobBudget, Pace, fraction, remaining_ms, round_samples, samples_wanted};
use super::forecast::Forecast;
use super::phases::PhaseClock;
use super::piece::{Mark, Piece, Reached, Yields};
use super::queue::{JobNumber, JobProgress};
use super::seeds::mixed;
use super::stop::{Asked, Stop};
use crate::cluster::{OpenOffer, Told};
use crate::engine::{LightMap, Meter, NextPart, Observer, Offer, Progress, Snapshot, lengthened};
use crate::store::lighting::Lit;
use crate::store::scene::SceneEntry;

/// Observes one job, one piece of its work (a bake, or a step of an update) after the other.
pub(crate) struct JobObserver<'a> {
    pub(crate) jobs: &'a Arc<Jobs>,
    pub(crate) scene: &'a Arc<SceneEntry>,
    pub(crate) job: JobNumber,
    pub(crate) budget: JobBudget,
    pub(crate) stop: &'a Stop,
    /// Time budgets count from here.
    accepted: Instant,
    started: Instant,
    piece: Piece,
    reached: Mark,
    /// Milliseconds after `started` at which progress within a pass is told next.
    due_ms: AtomicU64,
    state: Mutex<State>,
    /// The round that others do parts of.
    offered: Mutex<Option<OpenOffer>>,
}

/// Between two looks at how far a pass is: not often, since events are remembered.
const WITHIN_PASS: Duration = Duration::from_millis(500);

/// A complete map of the piece under way.
pub(crate) struct Complete {
    pub(crate) map: Arc<LightMap>,
    /// Samples per element of this piece.
    pub(crate) samples: u32,
    /// It was not published, because there is a better one.
    pub(crate) held_back: Option<Progress>,
}

#[derive(Default)]
struct State {
    pace: Pace,
    forecast: Forecast,
    /// What the engine told last.
    told: Option<Progress>,
    /// The last complete map of the piece.
    complete: Option<Complete>,
    /// Time ended the piece.
    cut: bool,
    /// The job's last version.
    version: Option<u64>,
    reported: Option<(Instant, &'static str)>,
    clock: PhaseClock,
    saved: Option<Instant>,
    /// The error of resolution of the piece's maps.
    meter: Meter,
}

impl<'a> JobObserver<'a> {
    pub(crate) fn new(
        jobs: &'a Arc<Jobs>,
        scene: &'a Arc<SceneEntry>,
        job: JobNumber,
        budget: JobBudget,
        (stop, accepted): (&'a Stop, Instant),
    ) -> JobObserver<'a> {
        JobObserver {
            jobs,
            scene,
            job,
            budget,
            stop,
            accepted,
            started: Instant::now(),
            piece: Piece::default(),
            reached: Mark::default(),
            due_ms: AtomicU64::new(0),
            state: Mutex::default(),
            offered: Mutex::default(),
        }
    }

    /// From here on maps are those of `piece`.
    pub(crate) fn begin(&mut self, piece: Piece) {
        self.piece = piece;
        self.reached = Mark::default();
        let mut state = self.lock();
        (state.complete, state.pace, state.cut) = (None, Pace::default(), false);
        (state.forecast, state.told) = (Forecast::default(), None);
        state.meter = Meter::default();
    }

    /// The maps of the piece are those that clients see, more accurate: what is known of these holds for them.
    pub(crate) fn goes_on(&self) {
        let known = self.scene.published().resolution.clone();
        self.lock().meter = Meter::after(known.map(Arc::unwrap_or_clone));
    }

    /// The last complete map since [`JobObserver::begin`].
    pub(crate) fn take_complete(&self) -> Option<Complete> {
        let mut state = self.lock();
        state.clock.stop(&self.jobs.metrics);
        state.complete.take()
    }

    /// Tells of a version that was published without a round.
    pub(crate) fn shown(&self, version: u64) {
        self.lock().version = Some(version);
    }

    /// What is used of the time budget.
    fn used_secs(&self) -> f64 {
        self.accepted.elapsed().as_secs_f64()
    }

    /// Nothing is left of the time budget.
    pub(crate) fn is_out_of_time(&self) -> bool {
        self.budget.max_seconds.is_some_and(|max| self.used_secs() >= max)
    }

    /// The time is over by more than planning can be blamed for, and there is a map to show.
    fn is_overdue(&self) -> bool {
        const GRACE: f64 = 1.1;
        self.reached.get() >= Reached::Complete
            && self.budget.max_seconds.is_some_and(|max| self.used_secs() > max * GRACE)
    }

    /// Whether time ended what is under way before it was as accurate as was asked for.
    pub(crate) fn was_cut(&self) -> bool {
        self.lock().cut || self.is_overdue() || self.is_superseded()
    }

    /// What it makes way for is there, and it has come far enough.
    fn is_superseded(&self) -> bool {
        let (asked, reached) = (self.stop.asked(), self.reached.get());
        match self.piece.yields {
            Yields::Never => false,
            Yields::ToNextStep => asked >= Asked::NextStep && reached >= Reached::Shown,
            Yields::OnceStated => asked >= Asked::NewerEdit && reached == Reached::Stated,
            Yields::AtOnce if asked == Asked::MakeRoom => {
                reached == Reached::Stated && self.started.elapsed() >= self.jobs.config.timeouts.share
            }
            Yields::AtOnce => asked >= Asked::NewerEdit,
        }
    }

    /// It has made way for something, and is to go on from what it has.
    pub(crate) fn has_made_way(&self) -> bool {
        self.piece.yields == Yields::AtOnce && self.is_superseded() && !self.stop.must_end()
    }

    /// The next step of the drag has ended this one before it had more than an estimate.
    pub(crate) fn ended_as_estimate(&self) -> bool {
        self.piece.yields == Yields::ToNextStep
            && self.is_superseded()
            && !self.stop.must_end()
            && self.reached.get() < Reached::Complete
    }

    fn report(&self, progress: &Progress, version: Option<u64>) {
        let (elapsed, used) = (self.started.elapsed(), self.used_secs());
        let (part, measured) = {
            let state = self.lock();
            (state.forecast.part(), self.measured(&state.forecast, progress, elapsed.as_secs_f64()))
        };
        let progress = &self.counted(progress);
        // A round that is finished counts among the samples.
        let round_fraction = if progress.round_fraction < 1.0 { part as f32 } else { 1.0 };
        let running = Progress { round_fraction, ..*progress };
        let fraction = fraction(&self.budget, &running, used);
        let report = JobProgress {
            fraction,
            pass: Some(progress.pass.as_str()),
            samples_per_element: progress.samples_per_element,
            elapsed_ms: elapsed.as_millis() as u64,
            estimated_rmse: progress.estimated_rmse,
            resolution: self.lock().meter.error().and_then(|error| error.all.rmse()),
            rays: progress.rays,
            version,
            remaining_ms: remaining_ms(&self.budget, measured, used),
        };
        self.jobs.report(self.job, report);
    }

    /// Seconds that the piece will take from here on, where anything is measured.
    fn measured(&self, forecast: &Forecast, progress: &Progress, now: f64) -> Option<f64> {
        let before = self.piece.before;
        let wanted = samples_wanted(&self.budget, &self.counted(progress)) - f64::from(before);
        let budget = self.budget.samples_per_element.saturating_sub(before);
        forecast.remaining(now, progress.samples_per_element, wanted, budget)
    }

    /// With the samples of the light that the piece starts from.
    fn counted(&self, progress: &Progress) -> Progress {
        Progress { samples_per_element: progress.samples_per_element + self.piece.before, ..*progress }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn offered(&self) -> MutexGuard<'_, Option<OpenOffer>> {
        self.offered.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Observer for JobObserver<'_> {
    fn canceled(&self) -> bool {
        self.stop.must_end() || self.is_overdue() || self.is_superseded()
    }

    fn progress(&self, progress: &Progress) {
        let version = {
            let mut state = self.lock();
            state.clock.tick(&self.jobs.metrics, progress);
            let now = self.started.elapsed().as_secs_f64();
            state.forecast.told(now, progress);
            state.told = Some(*progress);
            let pass = progress.pass.as_str();
            let is_news = state
                .reported
                .is_none_or(|(at, last_pass)| last_pass != pass || at.elapsed() >= self.jobs.config.timeouts.progress);
            if !is_news {
                return;
            }
            state.reported = Some((Instant::now(), pass));
            state.version
        };
        self.report(progress, version);
    }

    fn advanced(&self, part: f32) {
        let now = self.started.elapsed();
        let (now_ms, due) = (now.as_millis() as u64, self.due_ms.load(Ordering::Relaxed));
        let next = now_ms + WITHIN_PASS.max(self.jobs.config.timeouts.progress).as_millis() as u64;
        let is_due =
            now_ms >= due && self.due_ms.compare_exchange(due, next, Ordering::Relaxed, Ordering::Relaxed).is_ok();
        // Every loop is noted as it begins.
        if !is_due && part > 0.0 {
            return;
        }
        let (told, version) = {
            let mut state = self.lock();
            state.forecast.advance(now.as_secs_f64(), part);
            if !is_due {
                return;
            }
            let Some(told) = state.told else { return };
            state.reported = Some((Instant::now(), told.pass.as_str()));
            (told, state.version)
        };
        self.report(&told, version);
    }

    fn plan_round(&self, so_far: &Progress, proposed: u32) -> u32 {
        self.progress(so_far);
        let mut state = self.lock();
        let proposed = round_samples(&self.budget, so_far, proposed);
        let samples = match self.budget.max_seconds {
            None => proposed,
            Some(max) => {
                let samples = state.pace.plan(self.used_secs(), max, proposed);
                state.cut |= samples == 0;
                samples
            }
        };
        state.forecast.round(self.started.elapsed().as_secs_f64(), samples);
        samples
    }

    fn offer(&self, offer: &Offer<'_>) {
        let Some(coordinator) = &self.jobs.coordinator else { return };
        let published = self.scene.published();
        let told = Told { scene: self.scene.number, sequence: self.piece.sequence, world: &published.world };
        *self.offered() = Some(coordinator.offer(&told, offer));
    }

    fn next_part(&self, missing: &[u32]) -> NextPart {
        match &*self.offered() {
            Some(offered) => offered.next(missing, || self.canceled()),
            None => NextPart::Run(missing[0]),
        }
    }

    fn leaves_first(&self) -> bool {
        self.piece.yields == Yields::OnceStated && self.stop.asked() >= Asked::NewerEdit
    }

    /// An estimate takes the place of nothing, never of a map that is right: an interrupted bake has shown one already.
    fn wants_estimates(&self) -> bool {
        self.piece.floor.is_none()
    }

    fn snapshot(&self, map: &Arc<LightMap>, snapshot: Snapshot, progress: &Progress) {
        let map = &lengthened(map, self.piece.slots);
        let is_better = match (snapshot, self.piece.floor) {
            (_, None) => true,
            (Snapshot::Complete { stated: Some(stated) }, Some(floor)) => stated <= floor,
            (_, Some(_)) => false,
        };
        if let Snapshot::Complete { stated } = snapshot {
            let held_back = (!is_better).then_some(*progress);
            self.lock().complete =
                Some(Complete { map: map.clone(), samples: progress.samples_per_element, held_back });
            self.reached.raise(if stated.is_some() { Reached::Stated } else { Reached::Complete });
            if stated.is_some() {
                self.measure(map, progress.rays);
            }
        }
        if is_better {
            self.publish(map, snapshot, progress);
        }
    }
}

impl JobObserver<'_> {
    /// Measures the error of resolution of a map that states its noise, where clients see its elements.
    fn measure(&self, map: &LightMap, rays: u64) {
        let Some(world) = self.scene.shown_world(self.piece.sequence).filter(|world| world.slots() == map.len()) else {
            return;
        };
        let seed = mixed(self.jobs.config.seed ^ self.scene.published().version);
        // Rays are traced: nobody is to wait for the lock.
        let mut meter = std::mem::take(&mut self.lock().meter);
        // What was known stays where it is canceled.
        let _ = meter.measure(&world, map, rays, seed, self);
        self.lock().meter = meter;
    }

    /// Publishes a map of this job. Nothing starts from one that is not complete.
    pub(crate) fn publish(&self, map: &Arc<LightMap>, snapshot: Snapshot, progress: &Progress) {
        if snapshot == Snapshot::Estimate {
            self.reached.raise(Reached::Shown);
        }
        if !self.jobs.saving.may_publish(self.scene) {
            return;
        }
        let is_right = matches!(snapshot, Snapshot::Complete { .. });
        let map = &lengthened(map, self.piece.slots);
        let resolution = self.lock().meter.error().filter(|_| is_right).cloned().map(Arc::new);
        let lit = Lit { map, estimated_rmse: progress.estimated_rmse, resolution: resolution.as_ref(), is_right };
        let published = self.scene.snapshot(self.piece.sequence, lit);
        let is_due = {
            let mut state = self.lock();
            state.version = Some(published.version);
            state.reported = Some((Instant::now(), progress.pass.as_str()));
            let saved = state.saved.get_or_insert(self.started);
            // What is not right is not worth keeping.
            let is_due = is_right && saved.elapsed() >= self.jobs.config.timeouts.save;
            if is_due {
                state.saved = Some(Instant::now());
            }
            is_due
        };
        self.report(progress, Some(published.version));
        self.jobs.tell_snapshot(self.scene, Some(self.job), &published, Some(&self.counted(progress)));
        if is_due {
            self.jobs.saving.save_soon(self.scene);
        }
    }
}
