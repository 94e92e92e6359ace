//! Arrays that one pass hands on to the next: fresh memory costs more than what most passes do with it.

use std::cell::RefCell;

/// Arrays that are not in use.
pub(super) struct Buffers<V>(RefCell<Vec<Vec<V>>>);

impl<V> Buffers<V> {
    pub(super) fn new() -> Buffers<V> {
        Buffers(RefCell::new(Vec::new()))
    }

    /// One of them, whatever it holds, to be written over.
    pub(super) fn take(&self) -> Vec<V> {
        self.0.borrow_mut().pop().unwrap_or_default()
    }

    /// Leaves one that is not needed any longer.
    pub(super) fn give(&self, values: Vec<V>) {
        self.0.borrow_mut().push(values);
    }
}
