//! Which parts of an offered round are done, and by whom: decisions only, no message and no clock of its own.

use std::time::Duration;

use rebake_core::Estimate;

/// A worker that has not been heard of for so long is not waited for.
const PATIENCE: Duration = Duration::from_secs(10);

/// A part that takes a worker so many times as long as one takes here is done here as well.
const SLOWER: u32 = 4;

/// Whatever the time it takes here: others have to fetch the scene first.
const LEAST_WAIT: Duration = Duration::from_secs(5);

/// The parts of one round.
#[derive(Debug)]
pub(super) struct Board {
    parts: Vec<Part>,
    /// Time that a part took here.
    own: Option<Duration>,
    /// When a worker last took a part or gave one.
    moved: Duration,
}

/// Where a part is. Times are since the offer.
#[derive(Debug)]
enum Part {
    /// Nobody has taken it.
    Waiting,
    /// A worker is at it, since the first time, and was heard of at the second.
    Taken { by: String, since: Duration, heard: Duration },
    /// It is done, or being done, here.
    Here,
    /// Done elsewhere.
    Done(Box<Estimate>),
    /// Taken over.
    Gone,
}

/// What the bake is to do next.
#[derive(Debug, PartialEq)]
pub(super) enum Next {
    /// This part.
    Run(u32),
    /// Take this.
    Take(Box<Estimate>),
    /// Wait for news.
    Wait,
}

impl Board {
    pub(super) fn new(parts: usize) -> Board {
        Board { parts: (0..parts).map(|_| Part::Waiting).collect(), own: None, moved: Duration::ZERO }
    }

    /// What to do at `now`, where these parts are missing; those that nobody has taken are `left` to workers or not.
    pub(super) fn next(&mut self, missing: &[u32], now: Duration, left: bool) -> Next {
        for &part in missing {
            if let Some(place) = self.parts.get_mut(part as usize)
                && matches!(place, Part::Done(_))
                && let Part::Done(estimate) = std::mem::replace(place, Part::Gone)
            {
                return Next::Take(estimate);
            }
        }
        // Messages may be lost: what nobody takes is not left to workers for ever.
        let left = left && now.saturating_sub(self.moved) <= PATIENCE;
        // Workers take the first of those that wait, too: it is gone from the queue as soon as it is begun here.
        let waits = |part: &&u32| !left && matches!(self.parts.get(**part as usize), Some(Part::Waiting));
        let is_late = |part: &&u32| match self.parts.get(**part as usize) {
            Some(Part::Taken { since, heard, .. }) => self.is_late(now, *since, *heard),
            Some(Part::Waiting | Part::Done(_)) => false,
            // Whoever asks again has lost what was done here.
            Some(Part::Here | Part::Gone) | None => true,
        };
        let Some(&part) = missing.iter().find(waits).or_else(|| missing.iter().find(is_late)) else {
            return Next::Wait;
        };
        if let Some(place) = self.parts.get_mut(part as usize) {
            *place = Part::Here;
        }
        Next::Run(part)
    }

    fn is_late(&self, now: Duration, since: Duration, heard: Duration) -> bool {
        let is_silent = now.saturating_sub(heard) > PATIENCE;
        let longest = self.own.map(|own| (own * SLOWER).max(LEAST_WAIT));
        is_silent || longest.is_some_and(|longest| now.saturating_sub(since) > longest)
    }

    /// Whether nobody is at a part.
    pub(super) fn is_waiting(&self, part: u32) -> bool {
        matches!(self.parts.get(part as usize), Some(Part::Waiting))
    }

    /// A part took so long here.
    pub(super) fn done_here(&mut self, took: Duration) {
        self.own = Some(took);
    }

    /// A worker is at a part.
    pub(super) fn working(&mut self, part: u32, worker: &str, now: Duration) {
        self.moved = now;
        match self.parts.get_mut(part as usize) {
            Some(place @ Part::Waiting) => *place = Part::Taken { by: worker.to_owned(), since: now, heard: now },
            Some(Part::Taken { by, heard, .. }) if by == worker => *heard = now,
            // It was given to another, which begins anew.
            Some(place @ Part::Taken { .. }) => {
                *place = Part::Taken { by: worker.to_owned(), since: now, heard: now };
            }
            _ => {}
        }
    }

    /// Whether a result of a part is still of use.
    pub(super) fn wants(&self, part: u32) -> bool {
        matches!(self.parts.get(part as usize), Some(Part::Waiting | Part::Taken { .. }))
    }

    /// A part has come.
    pub(super) fn done(&mut self, part: u32, estimate: Estimate) {
        if let Some(place @ (Part::Waiting | Part::Taken { .. })) = self.parts.get_mut(part as usize) {
            *place = Part::Done(Box::new(estimate));
        }
    }

    /// A worker cannot do a part. Another may; it is done here if none comes.
    pub(super) fn failed(&mut self, part: u32, worker: &str) {
        if let Some(place) = self.parts.get_mut(part as usize)
            && matches!(place, Part::Taken { by, .. } if by == worker)
        {
            *place = Part::Waiting;
        }
    }

    /// What a worker is at waits again.
    pub(super) fn forget(&mut self, worker: &str) {
        for place in &mut self.parts {
            if matches!(place, Part::Taken { by, .. } if by == worker) {
                *place = Part::Waiting;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [u32; 3] = [0, 1, 2];

    fn at(seconds: u64) -> Duration {
        Duration::from_secs(seconds)
    }

    /// Of no world: the board looks at none.
    fn estimate(part: u32) -> Estimate {
        let numbers = [0, part, 16, 1].map(u32::to_le_bytes).concat();
        let bytes = [b"RBKEST03".as_slice(), &numbers, &0_u64.to_le_bytes()].concat();
        Estimate::from_bytes(&bytes, 0).unwrap()
    }

    #[test]
    fn without_workers_all_is_done_here_in_order() {
        let mut board = Board::new(3);
        for part in 0..3 {
            assert_eq!(board.next(&ALL[part as usize..], at(0), false), Next::Run(part));
        }
    }

    #[test]
    fn what_workers_are_at_is_waited_for_and_taken() {
        let mut board = Board::new(3);
        board.working(0, "a", at(1));
        assert_eq!(board.next(&ALL, at(1), false), Next::Run(1));
        board.working(2, "b", at(1));
        assert_eq!(board.next(&[0, 2], at(2), false), Next::Wait);
        assert!(board.wants(2) && !board.wants(1));
        board.done(2, estimate(2));
        assert_eq!(board.next(&[0, 2], at(3), false), Next::Take(Box::new(estimate(2))));
        assert!(!board.wants(2), "it may come twice");
        board.done(0, estimate(0));
        assert_eq!(board.next(&[0], at(3), false), Next::Take(Box::new(estimate(0))));
    }

    #[test]
    fn the_silent_and_the_slow_are_not_waited_for() {
        let mut board = Board::new(1);
        board.working(0, "a", at(0));
        assert_eq!(board.next(&[0], at(10), false), Next::Wait);
        board.working(0, "a", at(10));
        assert_eq!(board.next(&[0], at(20), false), Next::Wait);
        assert_eq!(board.next(&[0], at(21), false), Next::Run(0));
        // It comes too late.
        board.done(0, estimate(0));
        assert!(!board.wants(0));

        let mut board = Board::new(1);
        board.done_here(at(2));
        board.working(0, "a", at(0));
        board.working(0, "a", at(8));
        assert_eq!(board.next(&[0], at(8), false), Next::Wait);
        assert_eq!(board.next(&[0], at(9), false), Next::Run(0));
    }

    #[test]
    fn parts_are_left_to_workers_as_long_as_there_are_any() {
        let mut board = Board::new(3);
        assert_eq!(board.next(&ALL, at(1), true), Next::Wait);
        board.working(0, "a", at(1));
        assert_eq!(board.next(&ALL, at(2), true), Next::Wait);
        board.done(0, estimate(0));
        assert_eq!(board.next(&ALL, at(2), true), Next::Take(Box::new(estimate(0))));
        // Nobody takes the others.
        assert_eq!(board.next(&[1, 2], at(11), true), Next::Wait);
        assert_eq!(board.next(&[1, 2], at(12), true), Next::Run(1));
    }

    #[test]
    fn another_worker_has_time_of_its_own() {
        let mut board = Board::new(1);
        board.done_here(at(2));
        board.working(0, "a", at(0));
        board.working(0, "b", at(7));
        assert_eq!(board.next(&[0], at(14), false), Next::Wait);
        assert_eq!(board.next(&[0], at(16), false), Next::Run(0));
    }

    #[test]
    fn what_a_worker_that_is_gone_was_at_waits_anew() {
        let mut board = Board::new(2);
        board.working(0, "a", at(0));
        board.working(1, "b", at(0));
        board.forget("a");
        assert!(board.is_waiting(0) && !board.is_waiting(1));
        assert_eq!(board.next(&[0, 1], at(1), false), Next::Run(0));
        board.failed(1, "a");
        assert_eq!(board.next(&[1], at(1), false), Next::Wait);
        board.failed(1, "b");
        assert_eq!(board.next(&[1], at(1), false), Next::Run(1));
    }
}
