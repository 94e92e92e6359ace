//! The state of all jobs: plain data and its transitions, without a clock, threads or locks.
//!
//! ```text
//! queued ──► running ──► succeeded | failed | canceled
//!    └──────────────────────────────────────► canceled
//! ```

use std::collections::{BTreeMap, HashMap};
use std::fmt;

use jiff::Timestamp;

/// Number of a job, in the order of arrival.
pub type JobNumber = u64;
/// Number of a scene, in the order of arrival.
pub type SceneNumber = u64;

/// What a job does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JobKind {
    /// Lights a scene from scratch.
    Bake,
    /// Brings a light map up to date after an edit.
    Edit,
}

/// Where a job stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum JobState {
    /// Waits for its turn.
    Queued,
    /// Runs.
    Running,
    /// Done.
    Succeeded,
    /// Ended by an error.
    Failed,
    /// Ended by a client or by the end of the service.
    Canceled,
}

impl JobState {
    /// Nothing more will happen.
    pub fn has_ended(self) -> bool {
        matches!(self, JobState::Succeeded | JobState::Failed | JobState::Canceled)
    }

    /// A stable word for clients.
    pub fn as_str(self) -> &'static str {
        match self {
            JobState::Queued => "queued",
            JobState::Running => "running",
            JobState::Succeeded => "succeeded",
            JobState::Failed => "failed",
            JobState::Canceled => "canceled",
        }
    }
}

/// How a job ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Within its budget.
    Succeeded,
    /// With an error, for people.
    Failed(String),
    /// On request.
    Canceled,
}

/// How far a job is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JobProgress {
    /// Part of the work that is done, 0..=1; never falls.
    pub fraction: f64,
    /// What is being done.
    pub pass: Option<&'static str>,
    /// Of the rounds that are finished.
    pub samples_per_element: u32,
    /// Since the job started.
    pub elapsed_ms: u64,
    /// The stated error of the last snapshot.
    pub estimated_rmse: Option<f32>,
    /// Rays traced.
    pub rays: u64,
    /// Newest version that the job published.
    pub version: Option<u64>,
}

/// One job.
#[derive(Clone, Debug)]
pub struct Job {
    /// In the order of arrival.
    pub number: JobNumber,
    /// Whose light map it works on.
    pub scene: SceneNumber,
    /// What it does.
    pub kind: JobKind,
    /// Where it stands.
    pub state: JobState,
    /// A running job was asked to stop.
    pub cancel_requested: bool,
    /// How far it is.
    pub progress: JobProgress,
    /// When it was accepted.
    pub created_at: Timestamp,
    /// When it began.
    pub started_at: Option<Timestamp>,
    /// When it ended.
    pub finished_at: Option<Timestamp>,
    /// Why it failed.
    pub error: Option<String>,
}

/// How many jobs there may be.
#[derive(Clone, Copy, Debug)]
pub struct QueueLimits {
    /// Queued, of one scene.
    pub queued_per_scene: usize,
    /// Queued, in all.
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

/// What a cancel did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cancel {
    /// There is no such job.
    Unknown,
    /// It had ended before.
    Ended,
    /// It was queued and is canceled.
    Done,
    /// It runs and was asked to stop.
    Requested,
}

/// All jobs, finished ones up to a limit.
#[derive(Debug)]
pub struct Queue {
    limits: QueueLimits,
    newest: JobNumber,
    jobs: BTreeMap<JobNumber, Job>,
    queued: usize,
    finished: usize,
    queued_of: HashMap<SceneNumber, usize>,
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
            queued: 0,
            finished: 0,
            queued_of: HashMap::new(),
            running_of: HashMap::new(),
            turn: 0,
            last_turn: HashMap::new(),
            forgotten: Vec::new(),
        }
    }

    /// Whether one more job of the scene has room.
    pub fn has_room(&self, scene: SceneNumber) -> Result<(), Full> {
        let of_scene = self.queued_of.get(&scene).copied().unwrap_or(0);
        if of_scene >= self.limits.queued_per_scene {
            return Err(Full::Scene(of_scene));
        }
        if self.queued >= self.limits.queued {
            return Err(Full::Service(self.queued));
        }
        Ok(())
    }

    /// Appends a job.
    pub fn push(&mut self, scene: SceneNumber, kind: JobKind, now: Timestamp) -> Result<JobNumber, Full> {
        self.has_room(scene)?;
        self.newest += 1;
        let number = self.newest;
        self.queued += 1;
        *self.queued_of.entry(scene).or_default() += 1;
        self.jobs.insert(
            number,
            Job {
                number,
                scene,
                kind,
                state: JobState::Queued,
                cancel_requested: false,
                progress: JobProgress::default(),
                created_at: now,
                started_at: None,
                finished_at: None,
                error: None,
            },
        );
        Ok(number)
    }

    /// Queued → running. False where that is not the job's next step or its scene is busy.
    pub fn start(&mut self, number: JobNumber, now: Timestamp) -> bool {
        let Some(job) = self.jobs.get_mut(&number) else { return false };
        if job.state != JobState::Queued || self.running_of.contains_key(&job.scene) {
            return false;
        }
        job.state = JobState::Running;
        job.started_at = Some(now);
        let scene = job.scene;
        self.turn += 1;
        self.last_turn.insert(scene, self.turn);
        self.running_of.insert(scene, number);
        self.left_queue(scene);
        true
    }

    /// Running → ended. False where the job does not run.
    pub fn finish(&mut self, number: JobNumber, outcome: Outcome, now: Timestamp) -> bool {
        let Some(job) = self.jobs.get_mut(&number).filter(|job| job.state == JobState::Running) else { return false };
        job.finished_at = Some(now);
        if let Some(started_at) = job.started_at {
            job.progress.elapsed_ms = now.duration_since(started_at).as_millis().try_into().unwrap_or(0);
        }
        (job.state, job.error) = match outcome {
            Outcome::Succeeded => (JobState::Succeeded, None),
            Outcome::Failed(error) => (JobState::Failed, Some(error)),
            Outcome::Canceled => (JobState::Canceled, None),
        };
        if job.state == JobState::Succeeded {
            job.progress.fraction = 1.0;
        }
        let scene = job.scene;
        self.running_of.remove(&scene);
        self.finished += 1;
        self.forget_old();
        true
    }

    /// Cancels a queued job at once, asks a running one to stop.
    pub fn cancel(&mut self, number: JobNumber, now: Timestamp) -> Cancel {
        let Some(job) = self.jobs.get_mut(&number) else { return Cancel::Unknown };
        match job.state {
            JobState::Queued => {
                job.state = JobState::Canceled;
                job.finished_at = Some(now);
                let scene = job.scene;
                self.left_queue(scene);
                self.finished += 1;
                self.forget_old();
                Cancel::Done
            }
            JobState::Running => {
                job.cancel_requested = true;
                Cancel::Requested
            }
            JobState::Succeeded | JobState::Failed | JobState::Canceled => Cancel::Ended,
        }
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

    /// Jobs that run.
    pub fn running(&self) -> usize {
        self.running_of.len()
    }

    /// The job that runs on a scene.
    pub fn running_on(&self, scene: SceneNumber) -> Option<JobNumber> {
        self.running_of.get(&scene).copied()
    }

    /// The job that runs on a scene, else the first of its queue.
    pub fn current(&self, scene: SceneNumber) -> Option<JobNumber> {
        self.running_on(scene).or_else(|| {
            self.queued_of.get(&scene)?;
            self.iter().find(|job| job.scene == scene && job.state == JobState::Queued).map(|job| job.number)
        })
    }

    /// Whether any job of the scene waits.
    pub fn has_queued(&self, scene: SceneNumber) -> bool {
        self.queued_of.contains_key(&scene)
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

    fn left_queue(&mut self, scene: SceneNumber) {
        self.queued -= 1;
        if let Some(count) = self.queued_of.get_mut(&scene) {
            *count -= 1;
            if *count == 0 {
                self.queued_of.remove(&scene);
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
            let kind = match job.kind {
                JobKind::Bake => "bake",
                JobKind::Edit => "edit",
            };
            write!(f, "{} scene {} {kind} {}", job.number, job.scene, job.state.as_str())?;
            if job.cancel_requested && !job.state.has_ended() {
                write!(f, " (to be canceled)")?;
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
