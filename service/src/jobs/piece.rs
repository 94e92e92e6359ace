//! A piece of a job's work: what it is right for, what it makes way for, and how far it has come.

use std::sync::atomic::{AtomicU8, Ordering};

use crate::store::lighting::Sequence;

/// What a piece of work makes way for before its budget is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Yields {
    /// For nothing.
    #[default]
    Never,
    /// It is a step of a drag: for the next one, once anything of it is to be seen.
    ToNextStep,
    /// It goes tile by tile, or bakes the scene as an edit left it: for a newer edit, once it has a complete map that states
    /// its error.
    OnceStated,
    /// It works towards the scene's target: for an edit at once, for another scene once it has had its share and has
    /// something to go on from.
    AtOnce,
}

/// How far a piece of work has come; it only rises.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Reached {
    /// Nothing of its light is to be seen.
    #[default]
    Nothing,
    /// An estimate is published.
    Shown,
    /// There is a complete map.
    Complete,
    /// There is one that states its error.
    Stated,
}

/// [`Reached`], as all threads ask for it at every tile.
#[derive(Debug, Default)]
pub(super) struct Mark(AtomicU8);

impl Mark {
    const ALL: [Reached; 4] = [Reached::Nothing, Reached::Shown, Reached::Complete, Reached::Stated];

    pub(super) fn raise(&self, reached: Reached) {
        self.0.fetch_max(reached as u8, Ordering::Relaxed);
    }

    pub(super) fn get(&self) -> Reached {
        Mark::ALL[usize::from(self.0.load(Ordering::Relaxed))]
    }
}

/// A piece of a job's work.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Piece {
    /// What its maps are right for.
    pub(crate) sequence: Sequence,
    /// Length of the maps that are published: edits that were merged may need less.
    pub(crate) slots: usize,
    /// Maps with a larger stated error are held back: what is published for the same edit already, by a run that was
    /// interrupted, is better.
    pub(crate) floor: Option<f32>,
    /// What it makes way for.
    pub(crate) yields: Yields,
    /// Samples per element of the light that it starts from, which count towards the budget.
    pub(crate) before: u32,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_reached_only_rises() {
        let mark = Mark::default();
        for (at, reached) in Mark::ALL.into_iter().enumerate() {
            assert_eq!(reached as usize, at);
            mark.raise(reached);
            mark.raise(Reached::Shown);
            assert_eq!(mark.get(), reached.max(Reached::Shown));
        }
    }
}
