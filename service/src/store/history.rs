//! What was asked of a scene, request by request, and the way back and forth between its states.

use std::collections::VecDeque;
use std::sync::Arc;

use bytes::Bytes;
use jiff::Timestamp;
use rebake_core::Restore;

use super::lighting::Sequence;
use crate::engine::{Edit, Scene};
use crate::jobs::queue::JobNumber;

/// Which way through a scene's states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Turn {
    /// To the state before the last request that counts.
    Undo,
    /// To the state after the last one that was taken back.
    Redo,
}

/// An accepted edit request.
#[derive(Clone, Debug)]
pub(crate) struct Accepted {
    /// As it was sent.
    pub(crate) body: Bytes,
    /// What lit it; none where an earlier build has not kept that.
    pub(crate) job: Option<JobNumber>,
    pub(crate) accepted_at: Option<Timestamp>,
    /// It takes another request back, or makes it count again.
    pub(crate) turn: Option<(Turn, Sequence)>,
    /// Another request has taken it back.
    pub(crate) is_undone: bool,
}

/// All accepted edit requests of a scene. The way back holds what differs between two states; geometry is shared.
#[derive(Debug)]
pub(crate) struct History {
    /// By sequence number, from 1.
    accepted: Vec<Accepted>,
    /// Requests that can be taken back, the last one last.
    done: VecDeque<Step>,
    /// Requests that can be made again, the next one last.
    undone: Vec<Step>,
    max_steps: usize,
}

#[derive(Debug)]
struct Step {
    sequence: Sequence,
    back: Arc<Restore>,
    forth: Arc<Restore>,
}

impl History {
    /// Nothing was asked yet. So many requests can be taken back at most.
    pub(crate) fn new(max_steps: usize) -> History {
        History { accepted: Vec::new(), done: VecDeque::new(), undone: Vec::new(), max_steps }
    }

    /// The request that a turn is about, and the edit that does it; none where there is no such request.
    pub(crate) fn plan(&self, turn: Turn) -> Option<(Sequence, Edit)> {
        let (step, restore) = match turn {
            Turn::Undo => self.done.back().map(|step| (step, &step.back)),
            Turn::Redo => self.undone.last().map(|step| (step, &step.forth)),
        }?;
        Some((step.sequence, Edit::Restore(restore.clone())))
    }

    /// Takes in a request that led from one state to another. A turn is what [`History::plan`] planned last.
    pub(crate) fn accept(&mut self, mut accepted: Accepted, turn: Option<Turn>, (from, to): (&Scene, &Scene)) {
        let step = match turn {
            None => {
                self.undone.clear();
                let between = |from, to| Arc::new(Restore::between(from, to));
                let sequence = self.accepted.len() as Sequence + 1;
                self.done.push_back(Step { sequence, back: between(to, from), forth: between(from, to) });
                None
            }
            Some(Turn::Undo) => self.done.pop_back(),
            Some(Turn::Redo) => self.undone.pop(),
        };
        if let (Some(step), Some(turn)) = (step, turn) {
            accepted.turn = Some((turn, step.sequence));
            if let Some(of) = self.accepted.get_mut(step.sequence as usize - 1) {
                of.is_undone = turn == Turn::Undo;
            }
            match turn {
                Turn::Undo => self.undone.push(step),
                Turn::Redo => self.done.push_back(step),
            }
        }
        self.accepted.push(accepted);
        self.limit(self.max_steps);
    }

    /// So many requests can be taken back from here on.
    pub(crate) fn limit(&mut self, max_steps: usize) {
        self.max_steps = max_steps;
        let excess = self.done.len().saturating_sub(max_steps);
        self.done.drain(..excess);
    }

    /// Requests after `after`, the oldest first, with their sequence numbers.
    pub(crate) fn after(&self, after: Sequence, limit: usize) -> Vec<(Sequence, Accepted)> {
        let from = usize::try_from(after).unwrap_or(usize::MAX);
        let numbered = self.accepted.iter().enumerate().skip(from).take(limit);
        numbered.map(|(index, accepted)| (index as Sequence + 1, accepted.clone())).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request() -> Accepted {
        Accepted { body: Bytes::new(), job: None, accepted_at: None, turn: None, is_undone: false }
    }

    fn scene(count: usize) -> Scene {
        let mut scene = Scene::from_objects(Vec::new());
        scene.groups.extend((0..count).map(|k| (k.to_string(), "group".to_owned())));
        scene
    }

    /// Which requests are undone, and what the next turns are about.
    fn told(history: &History) -> (Vec<Sequence>, Option<Sequence>, Option<Sequence>) {
        let undone = history.after(0, 99).into_iter().filter(|(_, accepted)| accepted.is_undone);
        let next = |turn| history.plan(turn).map(|(sequence, _)| sequence);
        (undone.map(|(sequence, _)| sequence).collect(), next(Turn::Undo), next(Turn::Redo))
    }

    #[test]
    fn requests_are_undone_and_redone_in_order_and_new_ones_end_that() {
        let mut history = History::new(2);
        let states: Vec<Scene> = (0..5).map(scene).collect();
        assert_eq!(told(&history), (vec![], None, None));
        for k in 0..3 {
            history.accept(request(), None, (&states[k], &states[k + 1]));
        }
        let mut turn = |turn| {
            history.accept(request(), Some(turn), (&states[0], &states[0]));
            told(&history)
        };
        assert_eq!(turn(Turn::Undo), (vec![3], Some(2), Some(3)));
        assert_eq!(turn(Turn::Undo), (vec![2, 3], None, Some(2)), "no more than two");
        assert_eq!(turn(Turn::Redo), (vec![3], Some(2), Some(3)));
        history.accept(request(), None, (&states[2], &states[4]));
        assert_eq!(told(&history), (vec![3], Some(7), None));
        let turns: Vec<_> = history.after(3, 3).into_iter().map(|(sequence, a)| (sequence, a.turn)).collect();
        let expected = [(4, Turn::Undo, 3), (5, Turn::Undo, 2), (6, Turn::Redo, 2)];
        assert_eq!(turns, expected.map(|(sequence, turn, of)| (sequence, Some((turn, of)))));
        assert!(history.after(7, 9).is_empty() && history.after(u64::MAX, 9).is_empty());
    }
}
