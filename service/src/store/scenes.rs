//! All scenes in memory.

use std::collections::BTreeMap;
use std::sync::{Arc, PoisonError, RwLock};

use tokio::sync::watch;

use super::scene::SceneEntry;
use crate::jobs::queue::SceneNumber;

/// All scenes.
pub(crate) struct Scenes {
    held: RwLock<Held>,
    /// The newest scene's number.
    newest: watch::Sender<SceneNumber>,
}

#[derive(Default)]
struct Held {
    by_number: BTreeMap<SceneNumber, Arc<SceneEntry>>,
    newest: SceneNumber,
    /// Being uploaded: they count against the limit.
    reserved: usize,
}

impl Scenes {
    pub(crate) fn new() -> Scenes {
        Scenes { held: RwLock::default(), newest: watch::Sender::new(0) }
    }

    pub(crate) fn get(&self, number: SceneNumber) -> Option<Arc<SceneEntry>> {
        self.read().by_number.get(&number).cloned()
    }

    /// All scenes, the oldest first.
    pub(crate) fn all(&self) -> Vec<Arc<SceneEntry>> {
        self.read().by_number.values().cloned().collect()
    }

    /// Scenes with numbers below `before`, newest first.
    pub(crate) fn older_than(&self, before: SceneNumber, limit: usize) -> Vec<Arc<SceneEntry>> {
        self.read().by_number.range(..before).rev().take(limit).map(|(_, scene)| scene.clone()).collect()
    }

    /// A place and a number for a scene; given back when the reservation is dropped.
    pub(crate) fn reserve(self: &Arc<Scenes>, limit: usize) -> Option<Reservation> {
        let mut held = self.write();
        if held.by_number.len() + held.reserved >= limit {
            return None;
        }
        held.reserved += 1;
        held.newest += 1;
        Some(Reservation { scenes: self.clone(), number: held.newest })
    }

    pub(crate) fn insert(&self, scene: Arc<SceneEntry>) {
        let mut held = self.write();
        held.newest = held.newest.max(scene.number);
        let number = scene.number;
        held.by_number.insert(number, scene);
        drop(held);
        self.newest.send_replace(number);
    }

    /// Told of scenes that come.
    pub(crate) fn watch_newest(&self) -> watch::Receiver<SceneNumber> {
        self.newest.subscribe()
    }

    /// Numbers up to this one were given before.
    pub(crate) fn begin_after(&self, newest: SceneNumber) {
        let mut held = self.write();
        held.newest = held.newest.max(newest);
    }

    pub(crate) fn remove(&self, number: SceneNumber) -> Option<Arc<SceneEntry>> {
        self.write().by_number.remove(&number)
    }

    fn read(&self) -> std::sync::RwLockReadGuard<'_, Held> {
        self.held.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> std::sync::RwLockWriteGuard<'_, Held> {
        self.held.write().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A place for a scene that is being uploaded.
pub(crate) struct Reservation {
    scenes: Arc<Scenes>,
    pub(crate) number: SceneNumber,
}

impl Drop for Reservation {
    fn drop(&mut self) {
        self.scenes.write().reserved -= 1;
    }
}
