//! One job: where it stands, with what it needs there, and its next steps. Without a clock, threads or locks.
//!
//! ```text
//!    ┌──────────── interrupted ───────────┐
//!    ▼                                    │
//! waiting ──► running ──► ended
//!  ▲  │ └──────────────────► ended
//!  │  ▼         │
//! paused ◄──────┘
//! ```

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::words::{JobKind, JobState, Priority};

/// Number of a job, in the order of arrival.
pub type JobNumber = u64;
/// Number of a scene, in the order of arrival.
pub type SceneNumber = u64;

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

impl Outcome {
    /// What went wrong.
    pub fn error(&self) -> Option<&str> {
        match self {
            Outcome::Failed(error) => Some(error),
            Outcome::Succeeded | Outcome::Canceled => None,
        }
    }
}

/// How a run of a job came to its end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RunEnd {
    /// With the end of the job.
    Ended(Outcome),
    /// The job is to go on later.
    Interrupted,
}

impl RunEnd {
    /// A word for people.
    pub(super) fn as_str(&self) -> &'static str {
        match self {
            RunEnd::Ended(Outcome::Succeeded) => "succeeded",
            RunEnd::Ended(Outcome::Failed(_)) => "failed",
            RunEnd::Ended(Outcome::Canceled) => "canceled",
            RunEnd::Interrupted => "interrupted",
        }
    }
}

impl From<Outcome> for RunEnd {
    fn from(outcome: Outcome) -> RunEnd {
        RunEnd::Ended(outcome)
    }
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
    /// What is known of its error of resolution.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resolution: Option<f32>,
    /// Rays traced.
    pub rays: u64,
    /// Newest version that the job published.
    pub version: Option<u64>,
}

/// What clients have asked of a job while it ran. Both may be asked; that it ends counts then.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Requests {
    /// To make room until it is resumed.
    pub pause: bool,
    /// To stop.
    pub cancel: bool,
}

/// Where a job stands, with what it needs there.
#[derive(Clone, Debug, PartialEq)]
pub enum Standing {
    /// Waits for its turn.
    Waiting {
        /// Starts of jobs when it joined the line: how long it waits. Where its scene has had a turn since, that
        /// counts.
        turn: u64,
        /// The job that does its work with its own.
        merged_into: Option<JobNumber>,
        /// Where it ran and was interrupted: since when.
        started_at: Option<Timestamp>,
    },
    /// Runs.
    Running {
        /// Since when.
        started_at: Timestamp,
        /// What it has been asked for.
        requests: Requests,
    },
    /// Waits for a client to resume it.
    Paused {
        /// Where it ran and was interrupted: since when.
        started_at: Option<Timestamp>,
    },
    /// Nothing more will happen.
    Ended(Ended),
}

/// The end of a job.
#[derive(Clone, Debug, PartialEq)]
pub struct Ended {
    /// How.
    pub outcome: Outcome,
    /// When it began, if it ever did.
    pub started_at: Option<Timestamp>,
    /// When it ended.
    pub finished_at: Timestamp,
    /// The job that did its work; it ended as that one did.
    pub merged_into: Option<JobNumber>,
    /// What it had been asked for.
    pub requests: Requests,
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

/// One job.
#[derive(Clone, Debug, PartialEq)]
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
    pub standing: Standing,
    /// How far it is.
    pub progress: JobProgress,
    /// When it was accepted.
    pub created_at: Timestamp,
}

impl Job {
    /// A job that waits.
    pub fn new(number: JobNumber, scene: SceneNumber, kind: JobKind, priority: Priority, now: Timestamp) -> Job {
        let standing = Standing::Waiting { turn: 0, merged_into: None, started_at: None };
        Job { number, scene, kind, priority, standing, progress: JobProgress::default(), created_at: now }
    }

    /// The word for where it stands.
    pub fn state(&self) -> JobState {
        match &self.standing {
            Standing::Waiting { .. } => JobState::Queued,
            Standing::Running { .. } => JobState::Running,
            Standing::Paused { .. } => JobState::Paused,
            Standing::Ended(Ended { outcome, .. }) => match outcome {
                Outcome::Succeeded => JobState::Succeeded,
                Outcome::Failed(_) => JobState::Failed,
                Outcome::Canceled => JobState::Canceled,
            },
        }
    }

    /// It runs.
    pub fn is_running(&self) -> bool {
        matches!(self.standing, Standing::Running { .. })
    }

    /// Nothing more will happen.
    pub fn has_ended(&self) -> bool {
        self.ended().is_some()
    }

    /// Its end, where it has come.
    pub fn ended(&self) -> Option<&Ended> {
        match &self.standing {
            Standing::Ended(ended) => Some(ended),
            Standing::Waiting { .. } | Standing::Running { .. } | Standing::Paused { .. } => None,
        }
    }

    /// When it began, the last time.
    pub fn started_at(&self) -> Option<Timestamp> {
        match self.standing {
            Standing::Running { started_at, .. } => Some(started_at),
            Standing::Waiting { started_at, .. } | Standing::Paused { started_at } => started_at,
            Standing::Ended(Ended { started_at, .. }) => started_at,
        }
    }

    /// The job that does its work with its own, or did.
    pub fn merged_into(&self) -> Option<JobNumber> {
        match self.standing {
            Standing::Waiting { merged_into, .. } | Standing::Ended(Ended { merged_into, .. }) => merged_into,
            Standing::Running { .. } | Standing::Paused { .. } => None,
        }
    }

    /// What clients have asked of it and not taken back.
    pub fn requests(&self) -> Requests {
        match self.standing {
            Standing::Waiting { .. } => Requests::default(),
            Standing::Running { requests, .. } | Standing::Ended(Ended { requests, .. }) => requests,
            Standing::Paused { .. } => Requests { pause: true, cancel: false },
        }
    }

    /// Order of the jobs of one scene: edits as they came, then what works towards the target.
    pub fn place(&self) -> (bool, JobNumber) {
        (self.kind.is_for_target(), self.number)
    }

    /// Whether it waits and no other job does its work.
    pub fn is_in_line(&self) -> bool {
        matches!(self.standing, Standing::Waiting { merged_into: None, .. })
    }

    /// In line → running. False where it is not in line.
    pub fn start(&mut self, now: Timestamp) -> bool {
        let is_in_line = self.is_in_line();
        if is_in_line {
            self.standing = Standing::Running { started_at: now, requests: Requests::default() };
            self.progress = JobProgress { version: self.progress.version, ..JobProgress::default() };
        }
        is_in_line
    }

    /// In line → merged into another job. False where it is not in line.
    pub fn merge(&mut self, other: JobNumber) -> bool {
        match &mut self.standing {
            Standing::Waiting { merged_into: into @ None, .. } => {
                *into = Some(other);
                true
            }
            _ => false,
        }
    }

    /// Takes it out of line at once; asks one that runs to make room.
    pub fn pause(&mut self) -> Change {
        match &mut self.standing {
            Standing::Waiting { started_at, .. } => {
                self.standing = Standing::Paused { started_at: *started_at };
                Change::Done
            }
            Standing::Running { requests, .. } => {
                requests.pause = true;
                Change::Requested
            }
            Standing::Paused { .. } => Change::Done,
            Standing::Ended(_) => Change::Ended,
        }
    }

    /// Puts it in line again, after so many starts of jobs. One that runs and was asked to make room goes on as soon as
    /// it has.
    pub fn resume(&mut self, turn: u64) -> Change {
        match &mut self.standing {
            Standing::Paused { started_at } => {
                self.standing = Standing::Waiting { turn, merged_into: None, started_at: *started_at };
            }
            Standing::Running { requests, .. } => requests.pause = false,
            Standing::Waiting { .. } => {}
            Standing::Ended(_) => return Change::Ended,
        }
        Change::Done
    }

    /// Ends it at once; asks one that runs to stop.
    pub fn cancel(&mut self, now: Timestamp) -> Change {
        match &mut self.standing {
            Standing::Waiting { .. } | Standing::Paused { .. } => {
                self.end(Outcome::Canceled, now);
                Change::Done
            }
            Standing::Running { requests, .. } => {
                requests.cancel = true;
                Change::Requested
            }
            Standing::Ended(_) => Change::Ended,
        }
    }

    /// The end of its run. One that is interrupted waits again, is paused or ends, as it was asked to.
    pub fn stop(&mut self, end: &RunEnd, now: Timestamp) {
        let Standing::Running { started_at, requests } = self.standing else { return };
        let started_at = Some(started_at);
        match end {
            RunEnd::Ended(outcome) => self.end(outcome.clone(), now),
            RunEnd::Interrupted if requests.cancel => self.end(Outcome::Canceled, now),
            RunEnd::Interrupted if requests.pause => self.standing = Standing::Paused { started_at },
            RunEnd::Interrupted => self.standing = Standing::Waiting { turn: 0, merged_into: None, started_at },
        }
    }

    /// The end of the run of the job that does this one's work, with its progress: this one ends as that does, or is in
    /// line again.
    pub fn stop_merged(&mut self, progress: JobProgress, end: &RunEnd, now: Timestamp) {
        let Standing::Waiting { merged_into, .. } = &mut self.standing else { return };
        match end {
            RunEnd::Interrupted | RunEnd::Ended(Outcome::Canceled) => *merged_into = None,
            RunEnd::Ended(outcome) => {
                self.progress = progress;
                self.end(outcome.clone(), now);
            }
        }
    }

    /// Ends it, wherever it stands. The first end counts. One that is canceled ends for itself, whatever did its work.
    pub fn end(&mut self, outcome: Outcome, now: Timestamp) {
        if self.has_ended() {
            return;
        }
        let (started_at, requests) = (self.started_at(), self.requests());
        let merged_into = self.merged_into().filter(|_| outcome != Outcome::Canceled);
        self.progress.remaining_ms = None;
        if let Some(started_at) = started_at {
            self.progress.elapsed_ms = now.duration_since(started_at).as_millis().try_into().unwrap_or(0);
        }
        if outcome == Outcome::Succeeded {
            self.progress.fraction = 1.0;
        }
        self.standing = Standing::Ended(Ended { outcome, started_at, finished_at: now, merged_into, requests });
    }

    /// Puts a job of an earlier life in line, after so many starts of jobs: whatever ran then runs no more.
    pub fn restore(&mut self, turn: u64) {
        match &mut self.standing {
            Standing::Running { requests: Requests { pause: true, .. }, .. } => {
                self.standing = Standing::Paused { started_at: None };
            }
            Standing::Running { .. } => self.standing = Standing::Waiting { turn, merged_into: None, started_at: None },
            Standing::Waiting { started_at, .. } => {
                self.standing = Standing::Waiting { turn, merged_into: None, started_at: *started_at };
            }
            Standing::Paused { .. } | Standing::Ended(_) => {}
        }
    }
}
