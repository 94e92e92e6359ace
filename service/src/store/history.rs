//! What was asked of a scene, request by request, and the way back and forth between its states.

use std::collections::VecDeque;
use std::sync::Arc;

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

/// A way through a scene's states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Way {
    pub(crate) turn: Turn,
    /// Past all steps of a drag.
    pub(crate) drag: bool,
}

/// What a request moves, where it does nothing else.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Moves {
    pub(crate) things: Vec<String>,
    /// A step of a drag, which goes on where the next request moves the same things.
    pub(crate) is_step: bool,
}

/// An accepted edit request.
#[derive(Clone, Debug)]
pub(crate) struct Accepted {
    /// As it was sent; not the part of a connection's read buffer that it came in, all of which would stay with it.
    pub(crate) body: Arc<[u8]>,
    /// What lit it; none where an earlier build has not kept that.
    pub(crate) job: Option<JobNumber>,
    pub(crate) accepted_at: Option<Timestamp>,
    pub(crate) moves: Option<Moves>,
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

    /// The first request that is passed on a way, and the edits that go it; none where there is no such request.
    pub(crate) fn plan(&self, way: Way) -> Option<(Sequence, Vec<Edit>)> {
        let steps: Vec<&Step> = self.passed(way);
        let restore = |step: &&Step| match way.turn {
            Turn::Undo => step.back.clone(),
            Turn::Redo => step.forth.clone(),
        };
        Some((steps.first()?.sequence, steps.iter().map(restore).map(Edit::Restore).collect()))
    }

    /// The steps that a way passes, in its order: one, or all of a drag.
    fn passed(&self, way: Way) -> Vec<&Step> {
        let steps: Vec<&Step> = match way.turn {
            Turn::Undo => self.done.iter().rev().collect(),
            Turn::Redo => self.undone.iter().rev().collect(),
        };
        let is_one = |pair: &[&Step]| match way.turn {
            Turn::Undo => self.goes_on(pair[1], pair[0]),
            Turn::Redo => self.goes_on(pair[0], pair[1]),
        };
        let more = if way.drag { steps.windows(2).take_while(|pair| is_one(pair)).count() } else { 0 };
        steps.into_iter().take(1 + more).collect()
    }

    /// Whether a drag, of which `earlier` is a step, goes on with `later`.
    fn goes_on(&self, earlier: &Step, later: &Step) -> bool {
        let moves =
            |step: &Step| self.accepted.get(step.sequence as usize - 1).and_then(|request| request.moves.as_ref());
        let pair = moves(earlier).filter(|moves| moves.is_step).zip(moves(later));
        pair.is_some_and(|(earlier, later)| earlier.things == later.things)
    }

    /// Takes in a request that led from one state to another. A way is one that [`History::plan`] planned last.
    pub(crate) fn accept(&mut self, mut accepted: Accepted, way: Option<Way>, (from, to): (&Scene, &Scene)) {
        match way {
            None => {
                self.undone.clear();
                let between = |from, to| Arc::new(Restore::between(from, to));
                let sequence = self.accepted.len() as Sequence + 1;
                self.done.push_back(Step { sequence, back: between(to, from), forth: between(from, to) });
            }
            Some(way) => {
                for _ in 0..self.passed(way).len() {
                    let step = self.pass(way.turn);
                    accepted.turn = accepted.turn.or(step.map(|sequence| (way.turn, sequence)));
                }
            }
        }
        self.accepted.push(accepted);
        self.limit(self.max_steps);
    }

    /// Takes one request back, or makes it count again.
    fn pass(&mut self, turn: Turn) -> Option<Sequence> {
        let step = match turn {
            Turn::Undo => self.done.pop_back(),
            Turn::Redo => self.undone.pop(),
        }?;
        let sequence = step.sequence;
        if let Some(of) = self.accepted.get_mut(sequence as usize - 1) {
            of.is_undone = turn == Turn::Undo;
        }
        match turn {
            Turn::Undo => self.undone.push(step),
            Turn::Redo => self.done.push_back(step),
        }
        Some(sequence)
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
        Accepted { body: Arc::default(), job: None, accepted_at: None, moves: None, turn: None, is_undone: false }
    }

    fn scene(count: usize) -> Scene {
        let mut scene = Scene::from_objects(Vec::new());
        scene.groups.extend((0..count).map(|k| (k.to_string(), "group".to_owned())));
        scene
    }

    /// Which requests are undone, and what the next turns are about.
    fn told(history: &History) -> (Vec<Sequence>, Option<Sequence>, Option<Sequence>) {
        let undone = history.after(0, 99).into_iter().filter(|(_, accepted)| accepted.is_undone);
        let next = |turn| history.plan(Way { turn, drag: true }).map(|(sequence, _)| sequence);
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
            history.accept(request(), Some(Way { turn, drag: true }), (&states[0], &states[0]));
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

    #[test]
    fn a_drag_is_passed_as_one_where_that_is_asked_for() {
        let mut history = History::new(9);
        let states: Vec<Scene> = (0..6).map(scene).collect();
        let moves = |thing: &str, is_step| Accepted {
            moves: Some(Moves { things: vec![thing.to_owned()], is_step }),
            ..request()
        };
        // Another thing is moved first; three steps, and where it rests; one more move of the same thing is none of the drag.
        let requests = [("b", true), ("a", true), ("a", true), ("a", false), ("a", false)];
        for (k, (thing, is_step)) in requests.into_iter().enumerate() {
            history.accept(moves(thing, is_step), None, (&states[k], &states[k + 1]));
        }
        let passed =
            |history: &History, turn, drag| history.plan(Way { turn, drag }).map(|(at, edits)| (at, edits.len()));
        let pass = |history: &mut History, turn, drag| {
            history.accept(request(), Some(Way { turn, drag }), (&states[0], &states[0]));
            told(history).0
        };
        assert_eq!(passed(&history, Turn::Undo, true), Some((5, 1)));
        assert_eq!(pass(&mut history, Turn::Undo, true), [5]);
        assert_eq!(passed(&history, Turn::Undo, false), Some((4, 1)));
        assert_eq!(passed(&history, Turn::Undo, true), Some((4, 3)));
        assert_eq!(pass(&mut history, Turn::Undo, true), [2, 3, 4, 5]);
        assert_eq!(passed(&history, Turn::Redo, false), Some((2, 1)));
        assert_eq!(passed(&history, Turn::Redo, true), Some((2, 3)));
        assert_eq!(pass(&mut history, Turn::Redo, true), [5]);
        assert_eq!(history.after(7, 1)[0].1.turn, Some((Turn::Redo, 2)));
    }
}
