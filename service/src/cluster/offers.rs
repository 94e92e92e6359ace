//! Rounds that are offered to workers, from the side of the bake.

use std::collections::HashMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rebake_core::NextPart;

use super::board::{Board, Next};
use super::coordinator::Coordinator;
use super::messages::Task;

/// Whether a job was canceled is looked at so often while it waits for workers.
const GLANCE: Duration = Duration::from_millis(100);

/// An offered round.
pub(super) struct Offered {
    /// Results go to its subject and folder.
    pub(super) id: String,
    /// Of the world.
    pub(super) slots: usize,
    since: Instant,
    state: Mutex<State>,
    news: Condvar,
}

/// Where its parts are.
pub(super) struct State {
    pub(super) board: Board,
    /// When a part was begun here.
    begun: Option<Instant>,
    /// Places in the queue of the tasks that are in it.
    pub(super) queued: HashMap<u32, u64>,
    /// What all its tasks say; none until the scene is where others find it.
    pub(super) task: Option<Task>,
    /// Samples per element of each part.
    pub(super) parts: Vec<u32>,
}

/// An offered round, until it is dropped.
pub(crate) struct OpenOffer {
    coordinator: Arc<Coordinator>,
    offered: Arc<Offered>,
}

impl Offered {
    pub(super) fn new(id: String, slots: usize, parts: &[u32]) -> Offered {
        let state = State {
            board: Board::new(parts.len()),
            begun: None,
            queued: HashMap::new(),
            task: None,
            parts: parts.to_vec(),
        };
        Offered { id, slots, since: Instant::now(), state: Mutex::new(state), news: Condvar::new() }
    }

    /// Time since the offer.
    pub(super) fn age(&self) -> Duration {
        self.since.elapsed()
    }

    /// The bake is to look again.
    pub(super) fn notify(&self) {
        self.news.notify_all();
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl OpenOffer {
    pub(super) fn new(coordinator: Arc<Coordinator>, offered: Arc<Offered>) -> OpenOffer {
        OpenOffer { coordinator, offered }
    }

    /// What the bake does next. Waits for workers, if there is nothing better to do, until `is_canceled`.
    pub(crate) fn next(&self, missing: &[u32], is_canceled: impl Fn() -> bool) -> NextPart {
        let offered = &self.offered;
        let mut state = offered.lock();
        if let Some(begun) = state.begun.take() {
            state.board.done_here(begun.elapsed());
            self.coordinator.metrics().part_done("here");
        }
        loop {
            if is_canceled() {
                // Its first tile ends it.
                return NextPart::Run(missing[0]);
            }
            match state.board.next(missing, offered.age(), self.coordinator.leaves_parts()) {
                Next::Take(estimate) => return NextPart::Take(*estimate),
                Next::Run(part) => {
                    state.begun = Some(Instant::now());
                    if let Some(place) = state.queued.remove(&part) {
                        let coordinator = self.coordinator.clone();
                        self.coordinator.runtime().spawn(async move { coordinator.unqueue(place).await });
                    }
                    return NextPart::Run(part);
                }
                Next::Wait => {
                    let woken = offered.news.wait_timeout(state, GLANCE);
                    state = woken.unwrap_or_else(PoisonError::into_inner).0;
                }
            }
        }
    }
}

impl Drop for OpenOffer {
    fn drop(&mut self) {
        self.coordinator.forget(&self.offered.id);
        self.coordinator.runtime().spawn(self.coordinator.clone().close(self.offered.clone()));
    }
}
