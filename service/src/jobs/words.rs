//! The words that clients have for jobs.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

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

    /// Whether it works towards the scene's target. Edits of the scene go before it, whenever they come: it makes way
    /// for them and goes on from the light that they leave.
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
