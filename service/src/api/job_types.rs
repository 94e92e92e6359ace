//! Jobs as JSON.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::types::{LightError, finite};
use crate::ids::Ids;
use crate::jobs::{About, queue};

pub use crate::jobs::queue::{JobKind, JobState, Priority as JobPriority};

/// The work that brings a light map up to date.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct Job {
    /// Stable id.
    #[schema(example = "j4-k3f9qz")]
    pub id: String,
    /// The scene's id.
    #[schema(example = "s1-k3f9qz")]
    pub scene: String,
    /// What it lights: the scene's accepted edits up to this one. Of the answer to an edit: the scene's `ETag` from then on.
    #[schema(example = 3)]
    pub accepted_edits: u64,
    /// What it does.
    pub kind: JobKind,
    /// Where it stands.
    pub state: JobState,
    /// It runs and was asked to stop.
    pub cancel_requested: bool,
    /// It runs and was asked to make room.
    pub pause_requested: bool,
    /// Whose turn comes sooner.
    pub priority: JobPriority,
    /// The job that lights this one's edits together with its own. Set while that one runs; this job ends as it does,
    /// or waits again where that one is canceled or paused.
    #[schema(example = "j7-k3f9qz")]
    pub merged_into: Option<String>,
    /// How far it is.
    pub progress: JobProgress,
    /// When it was accepted.
    #[schema(value_type = String, format = DateTime, example = "2026-11-23T09:00:00Z")]
    pub created_at: Timestamp,
    /// When it began.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub started_at: Option<Timestamp>,
    /// When it ended.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub finished_at: Option<Timestamp>,
    /// Why it failed.
    pub error: Option<String>,
    /// What to know of how it ended: its `target_rmse` counts noise alone, and is met where the error of resolution is larger.
    pub warnings: Vec<String>,
}

impl Job {
    pub(crate) fn new(ids: &Ids, job: &queue::Job, about: &About) -> Job {
        let (progress, ended) = (&job.progress, job.ended());
        Job {
            id: ids.job(job.number),
            scene: about.scene.clone(),
            accepted_edits: about.sequence,
            kind: job.kind,
            state: job.state(),
            cancel_requested: job.requests().cancel,
            pause_requested: job.requests().pause,
            priority: job.priority,
            merged_into: job.merged_into().map(|into| ids.job(into)),
            progress: JobProgress {
                fraction: progress.fraction,
                pass: progress.pass.map(str::to_owned),
                samples_per_element: progress.samples_per_element,
                elapsed_ms: progress.elapsed_ms,
                remaining_ms: progress.remaining_ms,
                estimated_rmse: progress.estimated_rmse.and_then(finite),
                light_error: LightError { noise: progress.estimated_rmse, resolution: progress.resolution }.finite(),
                rays: progress.rays,
                version: progress.version,
            },
            created_at: job.created_at,
            started_at: job.started_at(),
            finished_at: ended.map(|ended| ended.finished_at),
            error: ended.and_then(|ended| ended.outcome.error().map(str::to_owned)),
            warnings: ended.and_then(|_| too_coarse(progress, about.target_rmse)).into_iter().collect(),
        }
    }
}

/// Says that a target is met by noise alone.
fn too_coarse(progress: &queue::JobProgress, target: Option<f32>) -> Option<String> {
    let (target, noise, resolution) = (target?, progress.estimated_rmse?, progress.resolution?);
    (noise <= target && resolution > target).then(|| {
        format!(
            "the noise is {noise:.2e}, less than the target of {target:.2e}, but the error of resolution is {resolution:.2e}: \
             more samples do not change that, elements that lie closer together do"
        )
    })
}

/// How far a job is.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct JobProgress {
    /// Part of the budget that is used, 0 to 1; never falls.
    #[schema(example = 0.4)]
    pub fraction: f64,
    /// What is being done: `direct`, `object`, `source`, `propagation` or `final_gather`.
    #[schema(example = "final_gather")]
    pub pass: Option<String>,
    /// Samples per element of the rounds that are finished.
    #[schema(example = 16)]
    pub samples_per_element: u32,
    /// Since the job started.
    #[schema(example = 412)]
    pub elapsed_ms: u64,
    /// From here to the end of the budget at the pace so far; absent while nothing is measured.
    #[schema(example = 618)]
    pub remaining_ms: Option<u64>,
    /// Stated error of the newest version, of the light that the scene's map holds: area-weighted RMSE (irradiance /
    /// π).
    #[schema(example = 0.012)]
    pub estimated_rmse: Option<f32>,
    /// Its errors: of chance, and of the distance between elements.
    pub light_error: LightError,
    /// Rays traced.
    #[schema(example = 1_200_345)]
    pub rays: u64,
    /// Newest version that the job published.
    #[schema(example = 7)]
    pub version: Option<u64>,
}
