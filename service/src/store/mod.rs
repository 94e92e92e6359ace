//! What the service knows: scenes with their published light maps, and assets. [`Store`] keeps what has to survive a
//! restart: [`disk`] in a data directory, [`InMemory`] nothing.

pub(crate) mod assets;
pub(crate) mod atlas;
pub(crate) mod computed;
pub(crate) mod deltas;
pub(crate) mod disk;
mod drag;
mod earlier;
pub mod faults;
pub(crate) mod history;
pub(crate) mod keys;
pub(crate) mod layers;
pub(crate) mod lighting;
pub(crate) mod probes;
pub(crate) mod records;
pub(crate) mod scene;
pub(crate) mod scenes;
pub(crate) mod versions;

use std::fmt::{Debug, Display};
use std::io;

use crate::jobs::queue::{JobNumber, SceneNumber};
use records::{Accepted, JobRecord, LightRecord, SceneChange, SceneRecord};

/// Something could not be kept or found again.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{reason} ({detail})")]
pub(crate) struct StoreError {
    /// For clients: what is wrong, without paths.
    pub(crate) reason: &'static str,
    /// For the log.
    pub(crate) detail: String,
}

impl StoreError {
    pub(crate) fn damaged(reason: &'static str, detail: impl Display) -> StoreError {
        StoreError { reason, detail: detail.to_string() }
    }
}

impl From<io::Error> for StoreError {
    fn from(error: io::Error) -> StoreError {
        let reason = match error.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => "the disk is full",
            io::ErrorKind::ReadOnlyFilesystem => "the data directory is read-only",
            io::ErrorKind::PermissionDenied => "the data directory may not be written",
            _ => "the disk failed",
        };
        StoreError { reason, detail: error.to_string() }
    }
}

/// Told of every change before it is acknowledged; what it has said yes to is still there after a power loss. Called
/// from compute threads: may take its time.
pub(crate) trait Store: Send + Sync + Debug {
    /// Whether anything is kept at all.
    fn is_durable(&self) -> bool;
    /// Nothing is written from here on; another process may have what is kept.
    fn close(&self);
    /// A scene, with the job that bakes it.
    fn scene_created(
        &self,
        number: SceneNumber,
        scene: &SceneRecord,
        glb: &[u8],
        bake: Option<&JobRecord>,
    ) -> Result<(), StoreError>;
    fn scene_changed(&self, number: SceneNumber, change: &SceneChange<'_>) -> Result<(), StoreError>;
    fn scene_deleted(&self, number: SceneNumber) -> Result<(), StoreError>;
    fn asset_added(&self, id: &str, glb: &[u8]) -> Result<(), StoreError>;
    fn asset_deleted(&self, id: &str) -> Result<(), StoreError>;
    fn accepted(&self, request: &Accepted<'_>) -> Result<(), StoreError>;
    /// A job's new state.
    fn job_changed(&self, job: &JobRecord) -> Result<(), StoreError>;
    /// A job has ended, and with it the light is as it is.
    fn job_ended(&self, job: &JobRecord, light: Option<&LightRecord>) -> Result<(), StoreError>;
    /// Finished jobs that nobody will ask for again.
    fn jobs_forgotten(&self, jobs: &[JobNumber]) -> Result<(), StoreError>;
    fn light_saved(&self, scene: SceneNumber, light: &LightRecord) -> Result<(), StoreError>;
    /// No version up to `version` will be given twice, whatever is lost of the light itself.
    fn versions_reserved(&self, scene: SceneNumber, version: u64) -> Result<(), StoreError>;
}

/// Keeps nothing: all state is gone with the process.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct InMemory;

impl Store for InMemory {
    fn is_durable(&self) -> bool {
        false
    }

    fn close(&self) {}

    fn scene_created(
        &self,
        _number: SceneNumber,
        _scene: &SceneRecord,
        _glb: &[u8],
        _bake: Option<&JobRecord>,
    ) -> Result<(), StoreError> {
        Ok(())
    }

    fn scene_changed(&self, _number: SceneNumber, _change: &SceneChange<'_>) -> Result<(), StoreError> {
        Ok(())
    }

    fn scene_deleted(&self, _number: SceneNumber) -> Result<(), StoreError> {
        Ok(())
    }

    fn asset_added(&self, _id: &str, _glb: &[u8]) -> Result<(), StoreError> {
        Ok(())
    }

    fn asset_deleted(&self, _id: &str) -> Result<(), StoreError> {
        Ok(())
    }

    fn accepted(&self, _request: &Accepted<'_>) -> Result<(), StoreError> {
        Ok(())
    }

    fn job_changed(&self, _job: &JobRecord) -> Result<(), StoreError> {
        Ok(())
    }

    fn job_ended(&self, _job: &JobRecord, _light: Option<&LightRecord>) -> Result<(), StoreError> {
        Ok(())
    }

    fn jobs_forgotten(&self, _jobs: &[JobNumber]) -> Result<(), StoreError> {
        Ok(())
    }

    fn light_saved(&self, _scene: SceneNumber, _light: &LightRecord) -> Result<(), StoreError> {
        Ok(())
    }

    fn versions_reserved(&self, _scene: SceneNumber, _version: u64) -> Result<(), StoreError> {
        Ok(())
    }
}
