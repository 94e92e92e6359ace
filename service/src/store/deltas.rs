//! Deltas between two versions, kept for a while after they were first asked for: caches in front of thousands of
//! clients ask for the same ones, some of them when the map has moved on.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use bytes::Bytes;

/// Deltas kept per scene, however small.
const KEPT: usize = 32;

/// The last deltas of a scene that were asked for, by what tells them apart: the two versions, and what else there is.
pub(crate) struct KeptDeltas<K = (u64, u64)>(Mutex<VecDeque<Kept<K>>>);

/// A delta as bytes. It is made once, however many ask for it at the same time.
struct Kept<K> {
    key: K,
    frame: Arc<OnceLock<KeptDelta>>,
}

/// What changed between two versions.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct KeptDelta {
    /// One frame; of pages, all frames.
    pub(crate) frame: Bytes,
    /// Stated error of the later version.
    pub(crate) stated: Option<f32>,
}

impl<K> Kept<K> {
    fn bytes(&self) -> usize {
        self.frame.get().map_or(0, |delta| delta.frame.len())
    }
}

impl<K> Default for KeptDeltas<K> {
    fn default() -> KeptDeltas<K> {
        KeptDeltas(Mutex::default())
    }
}

impl<K: PartialEq> KeptDeltas<K> {
    fn lock(&self) -> MutexGuard<'_, VecDeque<Kept<K>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The delta from one version to another, where it was made before.
    pub(crate) fn find(&self, key: &K) -> Option<KeptDelta> {
        let kept = self.lock();
        kept.iter().find(|kept| kept.key == *key)?.frame.get().cloned()
    }

    /// The delta from one version to another, made by `encode` where it is not kept. All that is kept takes `most_bytes`, or is this one alone.
    pub(crate) fn find_or_make(&self, key: K, most_bytes: usize, encode: impl FnOnce() -> KeptDelta) -> KeptDelta {
        let frame = {
            let mut kept = self.lock();
            let known = kept.iter().find(|kept| kept.key == key).map(|kept| kept.frame.clone());
            known.unwrap_or_else(|| {
                let frame = Arc::<OnceLock<KeptDelta>>::default();
                kept.push_back(Kept { key, frame: frame.clone() });
                frame
            })
        };
        // Not under the lock: it takes milliseconds.
        let delta = frame.get_or_init(encode).clone();
        self.forget(most_bytes);
        delta
    }

    /// Drops the oldest until the others are few enough.
    fn forget(&self, most_bytes: usize) {
        let mut kept = self.lock();
        let mut bytes: usize = kept.iter().map(|kept| kept.bytes()).sum();
        while kept.len() > KEPT || (kept.len() > 1 && bytes > most_bytes) {
            let Some(oldest) = kept.pop_front() else { return };
            bytes -= oldest.bytes();
        }
    }

    /// Bytes of what is kept.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.lock().iter().map(|kept| kept.bytes()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_delta_is_made_once_and_the_oldest_goes_first() {
        let kept = KeptDeltas::default();
        let delta = |bytes: usize| KeptDelta { frame: vec![7; bytes].into(), stated: Some(bytes as f32) };
        let make = |versions, bytes: usize| kept.find_or_make(versions, 100, || delta(bytes));
        assert_eq!((kept.find(&(1, 2)), kept.memory_bytes()), (None, 0));
        assert_eq!(make((1, 2), 60), delta(60));
        let again = kept.find_or_make((1, 2), 100, || unreachable!("it is there"));
        assert_eq!((again, kept.find(&(1, 2))), (delta(60), Some(delta(60))));
        make((0, 2), 30);
        assert_eq!(kept.memory_bytes(), 90);
        make((2, 3), 20);
        assert_eq!((kept.find(&(1, 2)), kept.memory_bytes()), (None, 50), "the oldest made room");
        assert_eq!(make((0, 3), 1000), delta(1000), "too large to be kept beside others");
        assert_eq!(kept.memory_bytes(), 1000);
        for version in 0..2 * KEPT as u64 {
            make((version, version + 1), 1);
        }
        assert_eq!(kept.memory_bytes(), KEPT);
    }
}
