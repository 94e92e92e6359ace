//! The sampled transport of a scene that frames of dragged lights come from, while its surfaces stay.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::engine::{DragBasis, World};

/// At most one basis: the last that was made.
#[derive(Debug, Default)]
pub(crate) struct Drag(Mutex<Option<Arc<DragBasis>>>);

impl Drag {
    fn lock(&self) -> MutexGuard<'_, Option<Arc<DragBasis>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The basis, where it is one of a world's surfaces.
    pub(crate) fn get(&self, world: &World) -> Option<Arc<DragBasis>> {
        self.lock().clone().filter(|basis| basis.fits(world))
    }

    /// Takes the place of the one before.
    pub(crate) fn keep(&self, basis: DragBasis) -> Arc<DragBasis> {
        let basis = Arc::new(basis);
        *self.lock() = Some(basis.clone());
        basis
    }

    /// Gives up the basis of surfaces that are no more.
    pub(crate) fn drop_stale(&self, world: &World) {
        self.lock().take_if(|basis| !basis.fits(world));
    }

    /// Bytes that it holds.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.lock().as_ref().map_or(0, |basis| basis.memory_bytes())
    }
}
