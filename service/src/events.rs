//! Bounded logs of events with rising ids, so that a client that lost its connection can resume.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::watch;

/// One event.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Event {
    pub(crate) id: u64,
    pub(crate) name: &'static str,
    /// JSON on one line.
    pub(crate) data: Arc<str>,
}

/// What a reader gets.
#[derive(Debug)]
pub(crate) struct Batch {
    pub(crate) events: Vec<Event>,
    /// Events between the reader's last one and the first of `events` are lost: the reader needs the whole state.
    pub(crate) gap: bool,
    /// Id of the newest event; 0 before the first.
    pub(crate) newest: u64,
    /// Nothing will follow.
    pub(crate) closed: bool,
    /// The state as of `newest`, where the log keeps it.
    pub(crate) state: Option<Arc<str>>,
}

/// The last events of one job or scene. A slow reader never holds up a writer.
#[derive(Debug)]
pub(crate) struct EventLog {
    log: Mutex<Log>,
    newest: watch::Sender<u64>,
}

#[derive(Debug)]
struct Log {
    events: VecDeque<Event>,
    capacity: usize,
    newest: u64,
    closed: bool,
    state: Option<Arc<str>>,
}

impl EventLog {
    /// `first`: ids rise from the one after it. Another life of the service begins elsewhere, so that an id of an
    /// earlier one is known to be old.
    pub(crate) fn new(capacity: usize, first: u64) -> EventLog {
        let capacity = capacity.max(1);
        let log = Log { events: VecDeque::new(), capacity, newest: first, closed: false, state: None };
        EventLog { log: Mutex::new(log), newest: watch::Sender::new(first) }
    }

    /// Appends an event. Nothing is added to a closed log.
    pub(crate) fn push(&self, name: &'static str, data: Arc<str>) {
        self.append(name, data, false);
    }

    /// Appends an event whose data is the whole state.
    pub(crate) fn push_state(&self, name: &'static str, state: Arc<str>) {
        self.append(name, state, true);
    }

    fn append(&self, name: &'static str, data: Arc<str>, is_state: bool) {
        let newest = {
            let mut log = self.lock();
            if log.closed {
                return;
            }
            log.newest += 1;
            if is_state {
                log.state = Some(data.clone());
            }
            if log.events.len() == log.capacity {
                log.events.pop_front();
            }
            let id = log.newest;
            log.events.push_back(Event { id, name, data });
            id
        };
        self.newest.send_replace(newest);
    }

    /// Nothing will follow.
    pub(crate) fn close(&self) {
        self.lock().closed = true;
        self.newest.send_modify(|_| ());
    }

    /// Keeps only the last events of a log that was closed a while ago: finished jobs are many.
    pub(crate) fn shrink(&self) {
        const KEPT: usize = 8;
        let mut log = self.lock();
        let surplus = log.events.len().saturating_sub(KEPT);
        log.events.drain(..surplus);
        log.events.shrink_to_fit();
    }

    /// The events after `after`.
    pub(crate) fn since(&self, after: u64) -> Batch {
        let log = self.lock();
        let oldest = log.events.front().map_or(log.newest + 1, |event| event.id);
        let gap = after > log.newest || after + 1 < oldest;
        let events = if gap { Vec::new() } else { log.events.iter().filter(|e| e.id > after).cloned().collect() };
        Batch { events, gap, newest: log.newest, closed: log.closed, state: log.state.clone() }
    }

    /// Told of every new event and of the end.
    pub(crate) fn watch(&self) -> watch::Receiver<u64> {
        self.newest.subscribe()
    }

    fn lock(&self) -> MutexGuard<'_, Log> {
        // A panic while the lock was held cannot leave the log half-written in a way that matters.
        self.log.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ids(batch: &Batch) -> Vec<u64> {
        batch.events.iter().map(|event| event.id).collect()
    }

    #[test]
    fn resumes_within_the_ring_and_says_so_beyond_it() {
        let log = EventLog::new(3, 0);
        for n in 1..=5u64 {
            log.push("x", n.to_string().into());
        }
        assert_eq!(ids(&log.since(2)), [3, 4, 5]);
        assert_eq!(ids(&log.since(5)), [0u64; 0]);
        let lost = log.since(1);
        assert!(lost.gap && lost.events.is_empty() && lost.newest == 5);
        assert!(log.since(6).gap, "an id that was never given");
    }

    #[test]
    fn a_closed_log_takes_nothing_and_keeps_its_end() {
        let log = EventLog::new(100, 0);
        for n in 1..=40u64 {
            log.push_state("job", n.to_string().into());
        }
        log.close();
        assert_eq!(log.since(3).events.len(), 37, "who is behind can still catch up");
        log.shrink();
        log.push("job", "late".into());
        let batch = log.since(39);
        assert_eq!(ids(&batch), [40]);
        assert!(batch.closed);
        assert_eq!(batch.state.as_deref(), Some("40"));
        assert!(log.since(3).gap);
    }
}
