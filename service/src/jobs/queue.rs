//! The state of all jobs: plain data and its transitions, without a clock, threads or locks. The steps of one job are
//! those of [`Job`]; here they are counted, and jobs of one scene kept apart.
//!
//! A job that waits and whose work another one does with its own is *merged* into it: it waits, out of line, and ends
//! as that one ends. Where that one is canceled or interrupted instead, it is in line again.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fmt;

use jiff::Timestamp;

pub use super::job::{Change, Ended, Job, JobNumber, JobProgress, Outcome, Requests, RunEnd, SceneNumber, Standing};
pub use super::words::{JobKind, JobState, Priority};

/// How many jobs there may be.
#[derive(Clone, Copy, Debug)]
pub struct QueueLimits {
    /// Queued or paused, of one scene.
    pub queued_per_scene: usize,
    /// Queued or paused, in all.
    pub queued: usize,
    /// Finished jobs that are remembered.
    pub finished: usize,
}

/// A job was not accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Full {
    /// The scene has its share.
    #[error("{0} jobs of this scene are queued already")]
    Scene(usize),
    /// The service has its share.
    #[error("{0} jobs are queued already")]
    Service(usize),
    /// The service is about to end.
    #[error("the service takes no new jobs")]
    Closed,
}

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
    /// Scenes that are being prepared: their jobs are out of line until that is done.
    preparing: HashSet<SceneNumber>,
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
            preparing: HashSet::new(),
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
        self.count_in(scene);
        Ok(self.newest)
    }

    /// Gives a promised place back.
    pub fn give_back(&mut self, scene: SceneNumber) {
        self.count_out(scene);
    }

    /// Puts a job in its promised place.
    pub fn push(&mut self, mut job: Job) {
        if let Standing::Waiting { turn, .. } = &mut job.standing {
            *turn = self.turn;
        }
        self.jobs.insert(job.number, job);
    }

    /// Takes in a job of an earlier life; one that ran waits again. Limits hold for new jobs only.
    pub fn restore(&mut self, mut job: Job) {
        self.begin_after(job.number);
        job.restore(self.turn);
        match job.has_ended() {
            true => self.finished += 1,
            false => self.count_in(job.scene),
        }
        self.jobs.insert(job.number, job);
        self.forget_old();
    }

    /// Numbers up to this one were given before.
    pub fn begin_after(&mut self, newest: JobNumber) {
        self.newest = self.newest.max(newest);
    }

    /// A scene is being prepared: its jobs are out of line until [`Queue::scene_prepared`].
    pub fn scene_preparing(&mut self, scene: SceneNumber) {
        self.preparing.insert(scene);
    }

    /// A scene is prepared: its jobs are in line from here on.
    pub fn scene_prepared(&mut self, scene: SceneNumber) {
        self.preparing.remove(&scene);
    }

    /// The scene will not come back, or takes no jobs any more.
    pub fn forget_scene(&mut self, scene: SceneNumber) {
        self.last_turn.remove(&scene);
        self.preparing.remove(&scene);
    }

    /// In line → running. False where that is not the job's next step or its scene is busy.
    pub fn start(&mut self, number: JobNumber, now: Timestamp) -> bool {
        let Some(scene) = self.get(number).map(|job| job.scene) else { return false };
        let is_free = !self.running_of.contains_key(&scene) && !self.preparing.contains(&scene);
        let has_started = is_free && self.step(number, |job| job.start(now)) == Some(true);
        if has_started {
            self.turn += 1;
            self.last_turn.insert(scene, self.turn);
        }
        has_started
    }

    /// Lets `into`, which runs, do the work of `number`, which waits on the same scene. False where it cannot.
    pub fn merge(&mut self, number: JobNumber, into: JobNumber) -> bool {
        let scene = self.get(number).map(|job| job.scene);
        let is_one_scene = scene.is_some_and(|scene| self.running_on(scene) == Some(into));
        is_one_scene && self.step(number, |job| job.merge(into)) == Some(true)
    }

    /// Jobs that `into` does with its own.
    pub fn merged_into(&self, into: JobNumber) -> Vec<JobNumber> {
        let merged = self.iter().filter(|job| !job.has_ended() && job.merged_into() == Some(into));
        merged.map(|job| job.number).collect()
    }

    /// The end of a job's run, and what becomes of the jobs merged into it. What changed, or nothing where the job does
    /// not run.
    pub fn finish(&mut self, number: JobNumber, end: &RunEnd, now: Timestamp) -> Vec<JobNumber> {
        let Some(progress) = self.get(number).filter(|job| job.is_running()).map(|job| job.progress) else {
            return Vec::new();
        };
        let merged = self.merged_into(number);
        self.step(number, |job| job.stop(end, now));
        for other in &merged {
            self.step(*other, |job| job.stop_merged(progress, end, now));
        }
        self.forget_old();
        std::iter::once(number).chain(merged).collect()
    }

    /// Which jobs [`Queue::finish`] will end, as they will be: to be kept before anybody is told.
    pub fn preview_finish(&self, number: JobNumber, end: &RunEnd, now: Timestamp) -> Vec<Job> {
        let Some(job) = self.get(number).filter(|job| job.is_running()) else { return Vec::new() };
        let mut jobs = vec![job.clone()];
        jobs.extend(self.merged_into(number).into_iter().filter_map(|other| self.get(other).cloned()));
        let (running, merged) = jobs.split_at_mut(1);
        running.iter_mut().for_each(|job| job.stop(end, now));
        merged.iter_mut().for_each(|other| other.stop_merged(job.progress, end, now));
        jobs.retain(Job::has_ended);
        jobs
    }

    /// Cancels a waiting job at once, asks a running one to stop.
    pub fn cancel(&mut self, number: JobNumber, now: Timestamp) -> Change {
        let change = self.step(number, |job| job.cancel(now));
        self.forget_old();
        change.unwrap_or(Change::Unknown)
    }

    /// Ends a waiting job that nobody can do. False where it does not wait.
    pub fn fail(&mut self, number: JobNumber, error: &str, now: Timestamp) -> bool {
        if self.get(number).is_none_or(|job| job.is_running() || job.has_ended()) {
            return false;
        }
        self.step(number, |job| job.end(Outcome::Failed(error.to_owned()), now));
        self.forget_old();
        true
    }

    /// Takes a waiting job out of line at once, asks a running one to make room.
    pub fn pause(&mut self, number: JobNumber) -> Change {
        self.step(number, Job::pause).unwrap_or(Change::Unknown)
    }

    /// Puts a paused job in line again. One that runs and was asked to make room goes on as soon as it has.
    pub fn resume(&mut self, number: JobNumber) -> Change {
        let turn = self.turn;
        self.step(number, |job| job.resume(turn)).unwrap_or(Change::Unknown)
    }

    /// Takes over new progress of a running job. The fraction never falls, and is 1 only at the end.
    pub fn report(&mut self, number: JobNumber, progress: JobProgress) {
        if let Some(job) = self.jobs.get_mut(&number).filter(|job| job.is_running()) {
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

    /// Jobs whose turn may come: they wait, not for their scene, and no other job does their work.
    pub fn in_line(&self) -> impl Iterator<Item = &Job> {
        self.iter().filter(|job| job.is_in_line() && !self.preparing.contains(&job.scene))
    }

    /// Jobs older than `before`, newest first.
    pub fn older_than(&self, before: JobNumber) -> impl Iterator<Item = &Job> {
        self.jobs.range(..before).rev().map(|(_, job)| job)
    }

    /// Whether a job that has not ended works towards a scene's target.
    pub fn has_target_work(&self, scene: SceneNumber) -> bool {
        self.iter().any(|job| job.scene == scene && job.kind.is_for_target() && !job.has_ended())
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
            let waiting = self.iter().filter(|job| job.scene == scene && job.state() == JobState::Queued);
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
        self.iter().filter(|job| job.scene == scene && !job.has_ended()).map(|job| job.number).collect()
    }

    /// Jobs that fell out of the memory of finished ones since the last call.
    pub fn take_forgotten(&mut self) -> Vec<JobNumber> {
        std::mem::take(&mut self.forgotten)
    }

    /// One step of a job, with the counts that go with it. None where there is no such job.
    fn step<T>(&mut self, number: JobNumber, step: impl FnOnce(&mut Job) -> T) -> Option<T> {
        let job = self.jobs.get_mut(&number)?;
        let (scene, before) = (job.scene, job.state());
        let result = step(job);
        let after = job.state();
        if before == after {
            return Some(result);
        }
        match before {
            JobState::Queued | JobState::Paused => self.count_out(scene),
            JobState::Running => _ = self.running_of.remove(&scene),
            JobState::Succeeded | JobState::Failed | JobState::Canceled => {}
        }
        match after {
            JobState::Queued | JobState::Paused => self.count_in(scene),
            JobState::Running => _ = self.running_of.insert(scene, number),
            JobState::Succeeded | JobState::Failed | JobState::Canceled => self.finished += 1,
        }
        Some(result)
    }

    /// One more waits.
    fn count_in(&mut self, scene: SceneNumber) {
        self.waiting += 1;
        *self.waiting_of.entry(scene).or_default() += 1;
    }

    /// One less waits.
    fn count_out(&mut self, scene: SceneNumber) {
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
            let Some(number) = self.iter().find(|job| job.has_ended()).map(|job| job.number) else { return };
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
            write!(f, "{} scene {} {} {}", job.number, job.scene, job.kind.as_str(), job.state().as_str())?;
            if let Some(into) = job.merged_into() {
                write!(f, " (in {into})")?;
            }
            if let Standing::Running { requests, .. } = &job.standing {
                if requests.cancel {
                    write!(f, " (to be canceled)")?;
                }
                if requests.pause {
                    write!(f, " (to be paused)")?;
                }
            }
            if job.progress.fraction > 0.0 {
                write!(f, " {:.0} %", job.progress.fraction * 100.0)?;
            }
            if let Some(error) = job.ended().and_then(|ended| ended.outcome.error()) {
                write!(f, ": {error}")?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}
