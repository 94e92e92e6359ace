//! What a round of samples gives.

use rayon::prelude::*;

use crate::transport::blacken;
use crate::value::Value;

/// Slots per task.
const CHUNK: usize = 4096;

/// Direct and indirect light per slot: values, or how they change.
#[derive(Clone, Default)]
pub(crate) struct Estimate<V> {
    pub direct: Vec<V>,
    pub indirect: Vec<V>,
}

impl<V: Value> Estimate<V> {
    /// No light in so many slots, in the memory that is there: fresh memory takes longer than most of what is done with
    /// it.
    pub(crate) fn blacken(&mut self, slots: usize) {
        blacken(&mut self.direct, slots);
        blacken(&mut self.indirect, slots);
    }

    /// Black in some slots.
    pub(crate) fn without(mut self, slots: &[bool]) -> Estimate<V> {
        for slot in slots.iter().enumerate().filter(|(_, out)| **out).map(|(slot, _)| slot) {
            (self.direct[slot], self.indirect[slot]) = (V::default(), V::default());
        }
        self
    }

    /// Adds indirect light.
    pub(crate) fn add_indirect(&mut self, light: &[V]) {
        self.indirect.par_iter_mut().zip(light).with_min_len(CHUNK).for_each(|(i, b)| *i += *b);
    }
}
