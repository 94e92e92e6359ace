//! What events carry, as JSON.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::types::LightError;

/// Data of a `snapshot` event: a new version is there.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct SnapshotEvent {
    /// The scene's id.
    pub scene: String,
    /// The job that published it; none where no job waited and the map was refined in idle time.
    pub job: Option<String>,
    /// The new version.
    pub version: u64,
    /// Version at which elements, objects or lights last changed.
    pub elements_version: u64,
    /// Of the rounds so far, of the job or of this spell of idle time; absent where old light was carried over to new
    /// geometry.
    pub samples_per_element: Option<u32>,
    /// Stated error of this version; null where old light was carried over to another scene, or an estimate is shown.
    pub estimated_rmse: Option<f32>,
    /// Its errors: of chance, and of the distance between elements.
    pub light_error: LightError,
}

/// What happened to a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SceneChange {
    /// Its objects, lights or elements changed.
    Edited,
    /// It was being prepared, and cannot be built: its `error` says why.
    Damaged,
    /// It is gone.
    Deleted,
}

/// Data of a `scene` event.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct SceneEvent {
    /// The scene's id.
    pub scene: String,
    /// What happened.
    pub what: SceneChange,
    /// The scene's version.
    pub version: u64,
    /// Version at which elements, objects or lights last changed.
    pub elements_version: u64,
}

/// One line of JSON.
pub(crate) fn to_event_data(value: &impl Serialize) -> Arc<str> {
    // Only maps with keys that are no strings can fail; there are none here.
    serde_json::to_string(value).unwrap_or_default().into()
}
