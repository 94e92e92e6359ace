//! Uploads that a client may send again.

use std::collections::{HashMap, HashSet, VecDeque};
use std::pin::pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

use super::records::UploadRecord;

/// The last idempotency keys of uploads, and those whose uploads are under way.
#[derive(Debug)]
pub(crate) struct UploadKeys {
    capacity: usize,
    held: Mutex<Held>,
    /// An upload with a key has ended.
    ended: Notify,
}

#[derive(Debug, Default)]
struct Held {
    by_key: HashMap<String, Arc<UploadRecord>>,
    order: VecDeque<String>,
    under_way: HashSet<String>,
}

impl UploadKeys {
    pub(crate) fn new(capacity: usize) -> UploadKeys {
        UploadKeys { capacity: capacity.max(1), held: Mutex::default(), ended: Notify::new() }
    }

    /// Waits until no other upload with that key is under way: the first one is to answer the second.
    pub(crate) async fn begin(self: &Arc<UploadKeys>, key: String) -> Turn {
        loop {
            let mut ended = pin!(self.ended.notified());
            // Before the look: an end in between is not missed.
            ended.as_mut().enable();
            if self.lock().under_way.insert(key.clone()) {
                return Turn { keys: self.clone(), key };
            }
            ended.await;
        }
    }

    fn get(&self, key: &str) -> Option<Arc<UploadRecord>> {
        self.lock().by_key.get(key).cloned()
    }

    pub(crate) fn insert(&self, record: UploadRecord) {
        let mut held = self.lock();
        let key = record.key.clone();
        if held.by_key.insert(key.clone(), Arc::new(record)).is_none() {
            held.order.push_back(key);
        }
        if held.order.len() > self.capacity
            && let Some(oldest) = held.order.pop_front()
        {
            held.by_key.remove(&oldest);
        }
    }

    fn lock(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// No other upload with its key is under way.
#[derive(Debug)]
pub(crate) struct Turn {
    keys: Arc<UploadKeys>,
    key: String,
}

impl Turn {
    pub(crate) fn key(&self) -> &str {
        &self.key
    }

    /// What came with the key before.
    pub(crate) fn known(&self) -> Option<Arc<UploadRecord>> {
        self.keys.get(&self.key)
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        self.keys.lock().under_way.remove(&self.key);
        self.keys.ended.notify_waiters();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(key: &str) -> UploadRecord {
        UploadRecord { key: key.to_owned(), hash: blake3::hash(key.as_bytes()), scene: None, job: None }
    }

    #[test]
    fn the_oldest_keys_go_first() {
        let keys = UploadKeys::new(2);
        ["a", "b", "b", "c"].into_iter().for_each(|key| keys.insert(record(key)));
        assert_eq!(["a", "b", "c"].map(|key| keys.get(key).is_some()), [false, true, true]);
    }

    #[tokio::test]
    async fn uploads_with_one_key_take_turns() {
        let keys = Arc::new(UploadKeys::new(2));
        let first = keys.begin("a".to_owned()).await;
        let other = keys.begin("b".to_owned()).await;
        let second = tokio::spawn({
            let keys = keys.clone();
            async move { drop(keys.begin("a".to_owned()).await) }
        });
        drop(other);
        tokio::task::yield_now().await;
        assert!(!second.is_finished(), "the first is under way");
        drop(first);
        second.await.unwrap();
        assert!(keys.lock().under_way.is_empty());
    }
}
