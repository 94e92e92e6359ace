//! The sampled transport of a scene that frames of dragged lights come from: made on demand, and anew where surfaces have
//! changed since.

use std::sync::{Arc, Mutex, PoisonError};

use crate::engine::{DragBasis, Observer, World};

/// At most one basis: the last that was asked for.
#[derive(Debug, Default)]
pub(crate) struct Drag(Mutex<Option<Arc<DragBasis>>>);

impl Drag {
    /// The basis for a world's surfaces; none where the observer canceled its making.
    pub(crate) fn of(&self, world: &World, seed: u64, observer: &dyn Observer) -> Option<Arc<DragBasis>> {
        // A scene has one job at a time: nobody waits for this lock but for who asks for the memory.
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(basis) = kept.as_ref().filter(|basis| basis.fits(world)) {
            return Some(basis.clone());
        }
        *kept = None;
        drop(kept);
        let basis = Arc::new(DragBasis::new(world, seed, observer).ok()?);
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(basis.clone());
        Some(basis)
    }

    /// Gives up the basis of surfaces that are no more.
    pub(crate) fn drop_stale(&self, world: &World) {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.as_ref().is_some_and(|basis| !basis.fits(world)) {
            *kept = None;
        }
    }

    /// Bytes that it holds.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).as_ref().map_or(0, |basis| basis.memory_bytes())
    }
}
