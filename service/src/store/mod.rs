//! What the service knows: scenes with their published light maps, and assets. [`Store`] keeps what has to survive a
//! restart: [`disk`] in a data directory, [`InMemory`] nothing.

pub(crate) mod accepted;
pub(crate) mod assets;
pub(crate) mod atlas;
pub(crate) mod computed;
pub(crate) mod deltas;
pub(crate) mod disk;
mod drag;
pub(crate) mod earlier;
pub mod faults;
pub(crate) mod filtered;
pub(crate) mod history;
pub(crate) mod keys;
pub(crate) mod layers;
pub(crate) mod lighting;
mod lineage;
pub(crate) mod probes;
pub(crate) mod records;
pub(crate) mod scene;
pub(crate) mod scenes;
mod stored_job;
pub(crate) mod tiles;
pub(crate) mod upload_keys;
pub(crate) mod versions;

use std::collections::HashMap;
use std::fmt::{Debug, Display};
use std::io;
use std::sync::{Mutex, MutexGuard, PoisonError};

use bytes::Bytes;

use crate::jobs::queue::{JobNumber, SceneNumber};
use lighting::Sequence;
use records::{Accepted, JobRecord, LightRecord, Origin, SceneChange, SceneRecord, UploadRecord};

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
    /// The file that a scene was made of, as it was uploaded.
    fn upload(&self, scene: SceneNumber) -> Result<Bytes, StoreError>;
    /// The file that an asset is.
    fn asset(&self, id: &str) -> Result<Bytes, StoreError>;
    /// How a scene came to be, up to an edit.
    fn origin(&self, scene: SceneNumber, sequence: Sequence) -> Result<Origin, StoreError>;
    /// Bytes of memory that what is kept takes.
    fn memory_bytes(&self) -> u64 {
        0
    }
    /// Nothing is written from here on; another process may have what is kept.
    fn close(&self);
    /// A scene, with the job that bakes it.
    fn scene_created(
        &self,
        number: SceneNumber,
        scene: &SceneRecord,
        glb: &[u8],
        bake: Option<&JobRecord>,
        key: Option<&UploadRecord>,
    ) -> Result<(), StoreError>;
    /// An upload with an idempotency key that made no scene.
    fn upload_keyed(&self, key: &UploadRecord) -> Result<(), StoreError>;
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

/// Keeps files in memory, which exports copy from, and nothing else: all state is gone with the process.
#[derive(Debug, Default)]
pub(crate) struct InMemory {
    files: Mutex<Files>,
    /// Where others are told how scenes came to be.
    origins: Option<Mutex<HashMap<SceneNumber, Origin>>>,
}

#[derive(Debug, Default)]
struct Files {
    uploads: HashMap<SceneNumber, Bytes>,
    assets: HashMap<String, Bytes>,
    bytes: u64,
}

impl InMemory {
    /// Keeps origins of scenes, too.
    pub(crate) fn with_origins() -> InMemory {
        InMemory { origins: Some(Mutex::default()), ..InMemory::default() }
    }

    fn origins(&self) -> Option<MutexGuard<'_, HashMap<SceneNumber, Origin>>> {
        self.origins.as_ref().map(|origins| origins.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn files(&self) -> MutexGuard<'_, Files> {
        self.files.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Files {
    /// Counts what has come for what has gone.
    fn count(&mut self, come: usize, gone: Option<Bytes>) {
        self.bytes = self.bytes + come as u64 - gone.map_or(0, |gone| gone.len() as u64);
    }
}

fn file_gone() -> StoreError {
    StoreError::damaged("the file is not kept any more", "it was deleted meanwhile")
}

impl Store for InMemory {
    fn is_durable(&self) -> bool {
        false
    }

    fn upload(&self, scene: SceneNumber) -> Result<Bytes, StoreError> {
        self.files().uploads.get(&scene).cloned().ok_or_else(file_gone)
    }

    fn asset(&self, id: &str) -> Result<Bytes, StoreError> {
        self.files().assets.get(id).cloned().ok_or_else(file_gone)
    }

    fn origin(&self, scene: SceneNumber, sequence: Sequence) -> Result<Origin, StoreError> {
        let origin = self.origins().and_then(|origins| origins.get(&scene).cloned());
        let mut origin = origin.ok_or_else(file_gone)?;
        origin.edits.truncate(sequence as usize);
        Ok(origin)
    }

    fn memory_bytes(&self) -> u64 {
        let origins = self.origins();
        let edits = origins.iter().flat_map(|origins| origins.values()).flat_map(|origin| &origin.edits);
        self.files().bytes + edits.map(|edit| edit.len() as u64).sum::<u64>()
    }

    fn close(&self) {}

    fn scene_created(
        &self,
        number: SceneNumber,
        scene: &SceneRecord,
        glb: &[u8],
        _bake: Option<&JobRecord>,
        _key: Option<&UploadRecord>,
    ) -> Result<(), StoreError> {
        if let Some(mut origins) = self.origins() {
            origins.insert(number, Origin { record: scene.clone(), edits: Vec::new() });
        }
        let mut files = self.files();
        let gone = files.uploads.insert(number, Bytes::copy_from_slice(glb));
        files.count(glb.len(), gone);
        Ok(())
    }

    fn upload_keyed(&self, _key: &UploadRecord) -> Result<(), StoreError> {
        Ok(())
    }

    fn scene_changed(&self, _number: SceneNumber, _change: &SceneChange<'_>) -> Result<(), StoreError> {
        Ok(())
    }

    fn scene_deleted(&self, number: SceneNumber) -> Result<(), StoreError> {
        self.origins().and_then(|mut origins| origins.remove(&number));
        let mut files = self.files();
        let gone = files.uploads.remove(&number);
        files.count(0, gone);
        Ok(())
    }

    fn asset_added(&self, id: &str, glb: &[u8]) -> Result<(), StoreError> {
        let mut files = self.files();
        let gone = files.assets.insert(id.to_owned(), Bytes::copy_from_slice(glb));
        files.count(glb.len(), gone);
        Ok(())
    }

    fn asset_deleted(&self, id: &str) -> Result<(), StoreError> {
        let mut files = self.files();
        let gone = files.assets.remove(id);
        files.count(0, gone);
        Ok(())
    }

    fn accepted(&self, request: &Accepted<'_>) -> Result<(), StoreError> {
        if let (Some(mut origins), Some(edit)) = (self.origins(), &request.edit)
            && let Some(origin) = origins.get_mut(&request.scene)
        {
            origin.edits.push(edit.body.to_vec());
        }
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
