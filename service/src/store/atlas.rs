//! Atlases of scenes that were uploaded without one: made when a client first asks, and kept while the service runs.

use std::sync::{Arc, Mutex, PoisonError};

use super::versions::Published;
use crate::engine::{Atlas, AtlasError, new_atlas};

/// The last atlas that was made, and of which elements.
#[derive(Debug, Default)]
pub(crate) struct MadeAtlas {
    /// Whoever makes the next one holds it: rectangles go from one to the next.
    pub(crate) turn: tokio::sync::Mutex<()>,
    last: Mutex<Option<(u64, Arc<Atlas>)>>,
}

impl MadeAtlas {
    /// The atlas of a version: the scene's own, or one in which objects lie where they lay in the last. To be called by
    /// whoever has the turn, on a compute thread.
    pub(crate) fn of(&self, published: &Published, max_texels: u64) -> Result<Arc<Atlas>, AtlasError> {
        if let Some(own) = published.world.atlas() {
            return Ok(Arc::clone(own));
        }
        let last = self.last.lock().unwrap_or_else(PoisonError::into_inner).clone();
        match last {
            Some((version, atlas)) if version == published.elements_version => Ok(atlas),
            last => {
                let earlier = last.as_ref().map(|(_, atlas)| &**atlas);
                let atlas = Arc::new(new_atlas(&published.world, earlier, max_texels)?);
                // Of a client that was slow: what is newer stays.
                if last.as_ref().is_none_or(|(version, _)| *version < published.elements_version) {
                    let made = Some((published.elements_version, Arc::clone(&atlas)));
                    *self.last.lock().unwrap_or_else(PoisonError::into_inner) = made;
                }
                Ok(atlas)
            }
        }
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        let last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        last.as_ref().map_or(0, |(_, atlas)| atlas.memory_bytes())
    }
}
