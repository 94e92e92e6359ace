//! What a running job is asked to do before its budget is used.

use std::sync::atomic::{AtomicU8, Ordering};

/// From the least to the most pressing: a later request never takes a more pressing one back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Asked {
    /// To run to its end.
    #[default]
    Nothing,
    /// To make room for another scene, once it has had its share: one waits.
    MakeRoom,
    /// To leave what a newer edit of the scene makes superfluous: one waits.
    NewerEdit,
    /// To leave what the next step of its drag makes superfluous: that waits.
    NextStep,
    /// To stop. It goes on later, from where it started.
    Interrupt,
    /// To end with what it has.
    Cancel,
}

/// Asks a running job to make way. Read at every tile, on all threads.
#[derive(Debug, Default)]
pub(crate) struct Stop(AtomicU8);

impl Stop {
    const ALL: [Asked; 6] =
        [Asked::Nothing, Asked::MakeRoom, Asked::NewerEdit, Asked::NextStep, Asked::Interrupt, Asked::Cancel];

    pub(crate) fn ask(&self, asked: Asked) {
        self.0.fetch_max(asked as u8, Ordering::Relaxed);
    }

    pub(crate) fn asked(&self) -> Asked {
        Stop::ALL[usize::from(self.0.load(Ordering::Relaxed))]
    }

    /// It is to end, whatever it has.
    pub(crate) fn must_end(&self) -> bool {
        self.asked() >= Asked::Interrupt
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_pressing_request_counts() {
        assert!(Stop::ALL.iter().enumerate().all(|(at, asked)| *asked as usize == at));
        for first in Stop::ALL {
            for second in Stop::ALL {
                let stop = Stop::default();
                stop.ask(first);
                stop.ask(second);
                assert_eq!(stop.asked(), first.max(second));
                assert_eq!(stop.must_end(), first.max(second) >= Asked::Interrupt);
            }
        }
    }
}
