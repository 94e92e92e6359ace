//! What clients uploaded to insert later, by the hash of its bytes.

use std::collections::HashMap;
use std::sync::{Arc, PoisonError, RwLock};

use crate::engine::Scene;

/// Assets in memory.
#[derive(Debug)]
pub(crate) struct Assets {
    max_assets: usize,
    max_bytes: usize,
    held: RwLock<Held>,
}

#[derive(Debug, Default)]
struct Held {
    by_hash: HashMap<String, Arc<Scene>>,
    bytes: usize,
}

/// There is no room for another asset.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct NoRoom;

impl Assets {
    pub(crate) fn new(max_assets: usize, max_bytes: usize) -> Assets {
        Assets { max_assets, max_bytes, held: RwLock::default() }
    }

    /// The id of an asset: the same bytes give the same.
    pub(crate) fn id_of(glb: &[u8]) -> String {
        blake3::hash(glb).to_hex().to_string()
    }

    pub(crate) fn get(&self, id: &str) -> Option<Arc<Scene>> {
        self.held.read().unwrap_or_else(PoisonError::into_inner).by_hash.get(id).cloned()
    }

    /// Keeps an asset of `bytes` uploaded bytes. True where it is new.
    pub(crate) fn insert(&self, id: String, scene: Scene, bytes: usize) -> Result<bool, NoRoom> {
        let mut held = self.held.write().unwrap_or_else(PoisonError::into_inner);
        if held.by_hash.contains_key(&id) {
            return Ok(false);
        }
        if held.by_hash.len() >= self.max_assets || held.bytes + bytes > self.max_bytes {
            return Err(NoRoom);
        }
        held.bytes += bytes;
        held.by_hash.insert(id, Arc::new(scene));
        Ok(true)
    }
}
