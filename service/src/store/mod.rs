//! What the service knows: scenes with their published light maps, and assets. In memory; [`Store`] is told of
//! everything that has to survive a restart, before a client is.

pub(crate) mod assets;
pub(crate) mod lighting;
pub(crate) mod scenes;
pub(crate) mod versions;

use std::fmt::Debug;

use lighting::Sequence;
use versions::Published;

/// Something could not be kept. Nothing was acknowledged then.
#[derive(Debug, thiserror::Error)]
#[error("storage: {0}")]
pub(crate) struct StoreError(pub(crate) String);

/// Told of every change before it is acknowledged. Called from compute threads: may take its time.
pub(crate) trait Store: Send + Sync + Debug {
    fn scene_created(&self, id: &str, glb: &[u8]) -> Result<(), StoreError>;
    fn scene_deleted(&self, id: &str) -> Result<(), StoreError>;
    fn asset_added(&self, id: &str, glb: &[u8]) -> Result<(), StoreError>;
    /// `sequence`: place among the scene's accepted requests, from 1. `body`: that of the request.
    fn edit_accepted(&self, scene: &str, sequence: Sequence, body: &[u8]) -> Result<(), StoreError>;
    fn published(&self, scene: &str, published: &Published) -> Result<(), StoreError>;
}

/// Keeps nothing: all state is gone with the process.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct InMemory;

impl Store for InMemory {
    fn scene_created(&self, _id: &str, _glb: &[u8]) -> Result<(), StoreError> {
        Ok(())
    }

    fn scene_deleted(&self, _id: &str) -> Result<(), StoreError> {
        Ok(())
    }

    fn asset_added(&self, _id: &str, _glb: &[u8]) -> Result<(), StoreError> {
        Ok(())
    }

    fn edit_accepted(&self, _scene: &str, _sequence: Sequence, _body: &[u8]) -> Result<(), StoreError> {
        Ok(())
    }

    fn published(&self, _scene: &str, _published: &Published) -> Result<(), StoreError> {
        Ok(())
    }
}
