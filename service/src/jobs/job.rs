//! Jobs as plain data.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Number of a job, in the order of arrival.
pub type JobNumber = u64;
/// Number of a scene, in the order of arrival.
pub type SceneNumber = u64;

/// What a job does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobKind {
    /// Lights a scene from scratch, after an upload.
    Bake,
    /// Brings the light map up to date after an edit.
    Edit,
    /// Brings the light map closer to the scene's target, after an edit or a new target.
    Refine,
}

impl JobKind {
    /// A stable word for clients.
    pub fn as_str(self) -> &'static str {
        match self {
            JobKind::Bake => "bake",
            JobKind::Edit => "edit",
            JobKind::Refine => "refine",
        }
    }

    /// Whether it works towards the scene's target. Edits of the scene go before it, whenever they come: it makes way for them
    /// and goes on from the light that they leave.
    pub fn is_for_target(self) -> bool {
        match self {
            JobKind::Bake | JobKind::Refine => true,
            JobKind::Edit => false,
        }
    }
}

/// Where a job stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// Waits for its turn.
    Queued,
    /// Runs.
    Running,
    /// Waits for a client to resume it.
    Paused,
    /// Done.
    Succeeded,
    /// Ended by an error.
    Failed,
    /// Ended by a client or by the end of the service.
    Canceled,
}

impl JobState {
    /// All states.
    pub const ALL: [JobState; 6] = [
        JobState::Queued,
        JobState::Running,
        JobState::Paused,
        JobState::Succeeded,
        JobState::Failed,
        JobState::Canceled,
    ];

    /// Nothing more will happen.
    pub fn has_ended(self) -> bool {
        matches!(self, JobState::Succeeded | JobState::Failed | JobState::Canceled)
    }

    /// A stable word for clients.
    pub fn as_str(self) -> &'static str {
        match self {
            JobState::Queued => "queued",
            JobState::Running => "running",
            JobState::Paused => "paused",
            JobState::Succeeded => "succeeded",
            JobState::Failed => "failed",
            JobState::Canceled => "canceled",
        }
    }
}

/// Whose turn comes sooner. Nothing waits for ever: what waits long counts as higher.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = JobPriority)]
pub enum Priority {
    /// When nothing else waits.
    Low,
    /// As most.
    #[default]
    Normal,
    /// Before the others.
    High,
}

/// How a job ended, or stopped.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Within its budget.
    Succeeded,
    /// With an error, for people.
    Failed(String),
    /// On request.
    Canceled,
    /// Not at all: it goes on later.
    Interrupted,
}

/// How far a job is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JobProgress {
    /// Part of the work that is done, 0..=1; never falls while the job runs.
    pub fraction: f64,
    /// What is being done.
    #[serde(skip)]
    pub pass: Option<&'static str>,
    /// Of the rounds that are finished.
    pub samples_per_element: u32,
    /// Since the job started.
    pub elapsed_ms: u64,
    /// From here to the end at the pace so far.
    #[serde(skip)]
    pub remaining_ms: Option<u64>,
    /// The stated error of the last snapshot.
    pub estimated_rmse: Option<f32>,
    /// Rays traced.
    pub rays: u64,
    /// Newest version that the job published.
    pub version: Option<u64>,
}

/// One job.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Job {
    /// In the order of arrival.
    pub number: JobNumber,
    /// Whose light map it works on.
    pub scene: SceneNumber,
    /// What it does.
    pub kind: JobKind,
    /// Whose turn comes sooner.
    pub priority: Priority,
    /// Where it stands.
    pub state: JobState,
    /// A running job was asked to stop.
    pub cancel_requested: bool,
    /// A running job was asked to make room.
    pub pause_requested: bool,
    /// Its scene is being prepared: its turn comes when that is done. A restored scene is there.
    #[serde(skip)]
    pub waits_for_scene: bool,
    /// The job that does this one's work with its own.
    pub merged_into: Option<JobNumber>,
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
    /// Starts of jobs when this one joined the queue: how long it waits.
    #[serde(skip)]
    pub arrived_turn: u64,
}

impl Job {
    /// A job that waits.
    pub fn new(number: JobNumber, scene: SceneNumber, kind: JobKind, priority: Priority, now: Timestamp) -> Job {
        Job {
            number,
            scene,
            kind,
            priority,
            state: JobState::Queued,
            cancel_requested: false,
            pause_requested: false,
            waits_for_scene: false,
            merged_into: None,
            progress: JobProgress::default(),
            created_at: now,
            started_at: None,
            finished_at: None,
            error: None,
            arrived_turn: 0,
        }
    }

    /// Takes over how it ended.
    pub fn end(&mut self, outcome: &Outcome, now: Timestamp) {
        self.finished_at = Some(now);
        self.progress.remaining_ms = None;
        if let Some(started_at) = self.started_at {
            self.progress.elapsed_ms = now.duration_since(started_at).as_millis().try_into().unwrap_or(0);
        }
        (self.state, self.error) = match outcome {
            Outcome::Succeeded => (JobState::Succeeded, None),
            Outcome::Failed(error) => (JobState::Failed, Some(error.clone())),
            Outcome::Canceled | Outcome::Interrupted => (JobState::Canceled, None),
        };
        if self.state == JobState::Succeeded {
            self.progress.fraction = 1.0;
        }
    }

    /// Order of the jobs of one scene: edits as they came, then what works towards the target.
    pub fn place(&self) -> (bool, JobNumber) {
        (self.kind.is_for_target(), self.number)
    }

    /// Whether its turn may come: it waits, not for its scene, and no other job does its work.
    pub fn is_in_line(&self) -> bool {
        self.state == JobState::Queued && !self.waits_for_scene && self.merged_into.is_none()
    }
}

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

/// What a request to cancel, pause or resume did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// There is no such job.
    Unknown,
    /// It had ended before.
    Ended,
    /// It is done.
    Done,
    /// The job runs and was asked to.
    Requested,
}
