//! Light maps whose noise is averaged away, for clients that ask for them: made once per version, and told like the maps
//! themselves, with what changed since the one before.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::versions::Published;
use crate::engine::{Canceled, Observer};

/// The newest filtered light map of a scene.
#[derive(Default)]
pub(crate) struct FilteredLight {
    /// Held by whoever filters: the others wait for what that gives.
    pub(crate) turn: tokio::sync::Mutex<()>,
    last: Mutex<Option<Arc<Published>>>,
}

impl FilteredLight {
    /// That of a version, where it was the last one made.
    pub(crate) fn known(&self, version: u64) -> Option<Arc<Published>> {
        self.lock().clone().filter(|last| last.version == version)
    }

    /// That of a version. To be called by whoever has the turn, on a compute thread.
    pub(crate) fn of(&self, published: &Arc<Published>, observer: &dyn Observer) -> Result<Arc<Published>, Canceled> {
        let last = self.lock().clone();
        match last {
            Some(last) if last.version == published.version => Ok(last),
            // A client that was slow: what is newer stays.
            Some(last) if last.version > published.version => Ok(Arc::new(published.filtered(None, observer)?)),
            last => {
                let next = Arc::new(published.filtered(last.as_deref(), observer)?);
                *self.lock() = Some(next.clone());
                Ok(next)
            }
        }
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.lock().as_ref().map_or(0, |last| last.memory_bytes())
    }

    fn lock(&self) -> MutexGuard<'_, Option<Arc<Published>>> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
