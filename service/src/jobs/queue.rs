//! The state of all jobs: plain data and its transitions, without a clock, threads or locks.
//!
//! ```text
//!    ┌──────────── interrupted ───────────┐
//!    ▼                                    │
//! queued ──► running ──► succeeded | failed | canceled
//!  ▲  │ └──────────────────────────────────────► canceled
//!  │  ▼         │
//! paused ◄──────┘
//! ```
//!
//! A queued job whose work another one does with its own is *merged* into it: it waits, out of line, and ends as that
//! one ends. Where that one is canceled or interrupted instead, it is in line again.

use std::collections::{BTreeMap, HashMap};
use std::fmt;

use jiff::Timestamp;

pub use super::job::{
    Change, Full, Job, JobKind, JobNumber, JobProgress, JobState, Outcome, Priority, QueueLimits, SceneNumber,
};

/// All jobs, finished ones up to a limit.
#[derive(Debug)]
pub struct Queue {
    limits: QueueLimits,
    newest: JobNumber,
    jobs: BTreeMap<JobNumber, Job>,
    /// Queued, paused or promised.
    waiting: usize,
    finished: usize,
    waiting_of: HashMap<SceneNumber, usize>,
    running_of: HashMap<SceneNumber, JobNumber>,
    /// Starts so far, and the turn at which each scene had its last one.
    turn: u64,
    last_turn: HashMap<SceneNumber, u64>,
    forgotten: Vec<JobNumber>,
}

impl Queue {
    /// An empty queue.
    pub fn new(limits: QueueLimits) -> Queue {
        Queue {
            limits,
            newest: 0,
            jobs: BTreeMap::new(),
            waiting: 0,
            finished: 0,
            waiting_of: HashMap::new(),
            running_of: HashMap::new(),
            turn: 0,
            last_turn: HashMap::new(),
            forgotten: Vec::new(),
        }
    }

    /// Whether one more job of the scene has room.
    pub fn has_room(&self, scene: SceneNumber) -> Result<(), Full> {
        let of_scene = self.waiting_of.get(&scene).copied().unwrap_or(0);
        if of_scene >= self.limits.queued_per_scene {
            return Err(Full::Scene(of_scene));
        }
        if self.waiting >= self.limits.queued {
            return Err(Full::Service(self.waiting));
        }
        Ok(())
    }

    /// Promises a place and gives it a number; to be followed by [`Queue::push`] or [`Queue::give_back`].
    pub fn promise(&mut self, scene: SceneNumber) -> Result<JobNumber, Full> {
        self.has_room(scene)?;
        self.newest += 1;
        self.joins(scene);
        Ok(self.newest)
    }

    /// Gives a promised place back.
    pub fn give_back(&mut self, scene: SceneNumber) {
        self.leaves(scene);
    }

    /// Puts a job in its promised place.
    pub fn push(&mut self, mut job: Job) {
        job.arrived_turn = self.turn;
        self.jobs.insert(job.number, job);
    }

    /// Takes in a job of an earlier life; one that ran waits again. Limits hold for new jobs only.
    pub fn restore(&mut self, mut job: Job) {
        self.begin_after(job.number);
        job.arrived_turn = self.turn;
        job.merged_into = job.merged_into.filter(|_| job.state.has_ended());
        if job.state.has_ended() {
            self.finished += 1;
        } else {
            if job.state == JobState::Running || !job.pause_requested {
                job.state = if job.pause_requested { JobState::Paused } else { JobState::Queued };
            }
            self.joins(job.scene);
        }
        self.jobs.insert(job.number, job);
        self.forget_old();
    }

    /// Numbers up to this one were given before.
    pub fn begin_after(&mut self, newest: JobNumber) {
        self.newest = self.newest.max(newest);
    }

    /// Queued → running. False where that is not the job's next step or its scene is busy.
    pub fn start(&mut self, number: JobNumber, now: Timestamp) -> bool {
        let Some(job) = self.jobs.get_mut(&number) else { return false };
        if !job.is_in_line() || self.running_of.contains_key(&job.scene) {
            return false;
        }
        job.state = JobState::Running;
        job.started_at = Some(now);
        job.progress = JobProgress { version: job.progress.version, ..JobProgress::default() };
        let scene = job.scene;
        self.turn += 1;
        self.last_turn.insert(scene, self.turn);
        self.running_of.insert(scene, number);
        self.leaves(scene);
        true
    }

    /// Lets `into`, which runs, do the work of `number`, which waits on the same scene. False where it cannot.
    pub fn merge(&mut self, number: JobNumber, into: JobNumber) -> bool {
        let Some(scene) = self.jobs.get(&into).filter(|job| job.state == JobState::Running).map(|job| job.scene) else {
            return false;
        };
        let Some(job) = self.jobs.get_mut(&number).filter(|job| job.is_in_line() && job.scene == scene) else {
            return false;
        };
        job.merged_into = Some(into);
        true
    }

    /// Jobs that `into` does with its own.
    pub fn merged_into(&self, into: JobNumber) -> Vec<JobNumber> {
        self.iter()
            .filter(|job| job.merged_into == Some(into) && !job.state.has_ended())
            .map(|job| job.number)
            .collect()
    }

    /// Running → ended, queued again or paused; the jobs merged into it likewise. What changed, or nothing where the
    /// job does not run.
    pub fn finish(&mut self, number: JobNumber, outcome: &Outcome, now: Timestamp) -> Vec<JobNumber> {
        let Some(job) = self.jobs.get_mut(&number).filter(|job| job.state == JobState::Running) else {
            return Vec::new();
        };
        let (scene, progress) = (job.scene, job.progress);
        self.running_of.remove(&scene);
        if *outcome == Outcome::Interrupted {
            job.state = if job.pause_requested { JobState::Paused } else { JobState::Queued };
            self.joins(scene);
        } else {
            self.end(number, outcome, now);
        }
        let merged = self.merged_into(number);
        for other in &merged {
            if matches!(outcome, Outcome::Canceled | Outcome::Interrupted) {
                self.jobs.get_mut(other).into_iter().for_each(|job| job.merged_into = None);
                continue;
            }
            self.jobs.get_mut(other).into_iter().for_each(|job| job.progress = progress);
            self.leaves(scene);
            self.end(*other, outcome, now);
        }
        self.forget_old();
        std::iter::once(number).chain(merged).collect()
    }

    /// What [`Queue::finish`] will make of a job and of those merged into it, to be kept before anybody is told.
    pub fn preview_finish(&self, number: JobNumber, outcome: &Outcome, now: Timestamp) -> Vec<Job> {
        let Some(job) = self.get(number).filter(|job| job.state == JobState::Running) else { return Vec::new() };
        let progress = job.progress;
        let merged = self.merged_into(number).into_iter().filter_map(|other| self.get(other).cloned());
        let merged = merged.map(|other| Job { progress, ..other });
        let ended = std::iter::once(job.clone()).chain(merged.filter(|_| *outcome != Outcome::Canceled));
        ended
            .map(|mut job| {
                job.end(outcome, now);
                job
            })
            .collect()
    }

    /// Cancels a waiting job at once, asks a running one to stop.
    pub fn cancel(&mut self, number: JobNumber, now: Timestamp) -> Change {
        let Some(job) = self.jobs.get_mut(&number) else { return Change::Unknown };
        match job.state {
            JobState::Queued | JobState::Paused => {
                let scene = job.scene;
                job.merged_into = None;
                self.leaves(scene);
                self.end(number, &Outcome::Canceled, now);
                self.forget_old();
                Change::Done
            }
            JobState::Running => {
                job.cancel_requested = true;
                Change::Requested
            }
            JobState::Succeeded | JobState::Failed | JobState::Canceled => Change::Ended,
        }
    }

    /// A scene is prepared: its jobs are in line from here on.
    pub fn scene_prepared(&mut self, scene: SceneNumber) {
        self.jobs.values_mut().filter(|job| job.scene == scene).for_each(|job| job.waits_for_scene = false);
    }

    /// Ends a waiting job that nobody can do. False where it does not wait.
    pub fn fail(&mut self, number: JobNumber, error: &str, now: Timestamp) -> bool {
        let waits = |job: &&mut Job| matches!(job.state, JobState::Queued | JobState::Paused);
        let Some(job) = self.jobs.get_mut(&number).filter(waits) else { return false };
        let scene = job.scene;
        self.leaves(scene);
        self.end(number, &Outcome::Failed(error.to_owned()), now);
        self.forget_old();
        true
    }

    /// Takes a waiting job out of line at once, asks a running one to make room.
    pub fn pause(&mut self, number: JobNumber) -> Change {
        let Some(job) = self.jobs.get_mut(&number) else { return Change::Unknown };
        if job.state.has_ended() {
            return Change::Ended;
        }
        job.pause_requested = true;
        if job.state == JobState::Running {
            return Change::Requested;
        }
        (job.state, job.merged_into) = (JobState::Paused, None);
        Change::Done
    }

    /// Puts a paused job in line again. One that runs and was asked to make room goes on as soon as it has.
    pub fn resume(&mut self, number: JobNumber) -> Change {
        let Some(job) = self.jobs.get_mut(&number) else { return Change::Unknown };
        if job.state.has_ended() {
            return Change::Ended;
        }
        job.pause_requested = false;
        if job.state == JobState::Paused {
            job.state = JobState::Queued;
            job.arrived_turn = self.turn;
        }
        Change::Done
    }

    /// Takes over new progress of a running job. The fraction never falls, and is 1 only at the end.
    pub fn report(&mut self, number: JobNumber, progress: JobProgress) {
        if let Some(job) = self.jobs.get_mut(&number).filter(|job| job.state == JobState::Running) {
            // `max` passes over NaN.
            let fraction = progress.fraction.clamp(0.0, 0.999).max(job.progress.fraction);
            job.progress = JobProgress { fraction, ..progress };
        }
    }

    /// One job.
    pub fn get(&self, number: JobNumber) -> Option<&Job> {
        self.jobs.get(&number)
    }

    /// All jobs in the order of arrival.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &Job> {
        self.jobs.values()
    }

    /// Jobs older than `before`, newest first.
    pub fn older_than(&self, before: JobNumber) -> impl Iterator<Item = &Job> {
        self.jobs.range(..before).rev().map(|(_, job)| job)
    }

    /// Whether a job that has not ended works towards a scene's target.
    pub fn has_target_work(&self, scene: SceneNumber) -> bool {
        self.iter().any(|job| job.scene == scene && job.kind.is_for_target() && !job.state.has_ended())
    }

    /// Jobs that run.
    pub fn running(&self) -> usize {
        self.running_of.len()
    }

    /// Jobs that are queued or paused.
    pub fn waiting(&self) -> usize {
        self.waiting
    }

    /// The job that runs on a scene.
    pub fn running_on(&self, scene: SceneNumber) -> Option<JobNumber> {
        self.running_of.get(&scene).copied()
    }

    /// The job that runs on a scene, else the first of its queue.
    pub fn current(&self, scene: SceneNumber) -> Option<JobNumber> {
        self.running_on(scene).or_else(|| {
            self.waiting_of.get(&scene)?;
            let waiting = self.iter().filter(|job| job.scene == scene && job.state == JobState::Queued);
            waiting.min_by_key(|job| job.place()).map(|job| job.number)
        })
    }

    /// Starts so far.
    pub fn turn(&self) -> u64 {
        self.turn
    }

    /// The turn at which a scene last started a job; 0 for never.
    pub fn last_turn(&self, scene: SceneNumber) -> u64 {
        self.last_turn.get(&scene).copied().unwrap_or(0)
    }

    /// Jobs that have not ended, of one scene.
    pub fn open_of(&self, scene: SceneNumber) -> Vec<JobNumber> {
        self.iter().filter(|job| job.scene == scene && !job.state.has_ended()).map(|job| job.number).collect()
    }

    /// The scene will not come back.
    pub fn forget_scene(&mut self, scene: SceneNumber) {
        self.last_turn.remove(&scene);
    }

    /// Jobs that fell out of the memory of finished ones since the last call.
    pub fn take_forgotten(&mut self) -> Vec<JobNumber> {
        std::mem::take(&mut self.forgotten)
    }

    fn end(&mut self, number: JobNumber, outcome: &Outcome, now: Timestamp) {
        let Some(job) = self.jobs.get_mut(&number) else { return };
        job.end(outcome, now);
        self.finished += 1;
    }

    fn joins(&mut self, scene: SceneNumber) {
        self.waiting += 1;
        *self.waiting_of.entry(scene).or_default() += 1;
    }

    fn leaves(&mut self, scene: SceneNumber) {
        self.waiting -= 1;
        if let Some(count) = self.waiting_of.get_mut(&scene) {
            *count -= 1;
            if *count == 0 {
                self.waiting_of.remove(&scene);
            }
        }
    }

    fn forget_old(&mut self) {
        while self.finished > self.limits.finished {
            let Some(number) = self.iter().find(|job| job.state.has_ended()).map(|job| job.number) else { return };
            self.jobs.remove(&number);
            self.forgotten.push(number);
            self.finished -= 1;
        }
    }
}

/// One line per job: what tests compare.
impl fmt::Display for Queue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for job in self.iter() {
            write!(f, "{} scene {} {} {}", job.number, job.scene, job.kind.as_str(), job.state.as_str())?;
            if let Some(into) = job.merged_into {
                write!(f, " (in {into})")?;
            }
            if job.cancel_requested && !job.state.has_ended() {
                write!(f, " (to be canceled)")?;
            }
            if job.pause_requested && job.state == JobState::Running {
                write!(f, " (to be paused)")?;
            }
            if job.progress.fraction > 0.0 {
                write!(f, " {:.0} %", job.progress.fraction * 100.0)?;
            }
            if let Some(error) = &job.error {
                write!(f, ": {error}")?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}
