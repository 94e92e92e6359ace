//! Requests that a client may send again.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use super::records::KeyRecord;
use crate::jobs::queue::JobNumber;

/// A remembered request.
#[derive(Clone, Debug)]
pub(crate) struct Remembered {
    pub(crate) body_hash: blake3::Hash,
    pub(crate) job: JobNumber,
    /// The job as first answered, for when it is forgotten.
    pub(crate) answer: Arc<str>,
}

/// The last idempotency keys of a scene.
#[derive(Debug)]
pub(crate) struct IdempotencyKeys {
    capacity: usize,
    by_key: HashMap<String, Remembered>,
    order: VecDeque<String>,
}

impl IdempotencyKeys {
    pub(crate) fn new(capacity: usize) -> IdempotencyKeys {
        IdempotencyKeys { capacity: capacity.max(1), by_key: HashMap::new(), order: VecDeque::new() }
    }

    pub(crate) fn get(&self, key: &str) -> Option<&Remembered> {
        self.by_key.get(key)
    }

    pub(crate) fn insert(&mut self, record: KeyRecord) {
        let KeyRecord { key, body_hash, job, answer } = record;
        let remembered = Remembered { body_hash, job, answer };
        if self.order.len() == self.capacity
            && let Some(oldest) = self.order.pop_front()
        {
            self.by_key.remove(&oldest);
        }
        self.order.push_back(key.clone());
        self.by_key.insert(key, remembered);
    }
}
