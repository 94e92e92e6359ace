//! What clients uploaded to insert later, or as a sky, by the hash of its bytes.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

use glam::DVec3;

use crate::engine::{Scene, SkyPicture};
use crate::jobs::queue::SceneNumber;
use crate::memory;

/// What an asset is.
#[derive(Clone, Debug)]
pub(crate) enum Content {
    /// Something to insert.
    Model(Arc<Scene>),
    /// A picture of the sky.
    Picture(Arc<SkyPicture>),
}

impl Content {
    /// Bytes that it takes.
    pub(crate) fn memory_bytes(&self) -> u64 {
        match self {
            Content::Model(scene) => memory::of_asset(scene),
            Content::Picture(picture) => picture.memory_bytes() as u64,
        }
    }

    /// Low and high corner of what can be inserted, metres.
    fn bounds(&self) -> Option<(DVec3, DVec3)> {
        match self {
            Content::Model(scene) => scene.bounds(),
            Content::Picture(_) => None,
        }
    }

    /// Objects that are inserted from it tell where they come from.
    fn named(self, id: &str) -> Content {
        match self {
            Content::Model(scene) => {
                Content::Model(Arc::new(Scene { asset: Some(id.into()), ..Arc::unwrap_or_clone(scene) }))
            }
            picture => picture,
        }
    }
}

impl From<Scene> for Content {
    fn from(scene: Scene) -> Content {
        Content::Model(Arc::new(scene))
    }
}

impl From<SkyPicture> for Content {
    fn from(picture: SkyPicture) -> Content {
        Content::Picture(Arc::new(picture))
    }
}

/// Assets in memory.
#[derive(Debug)]
pub(crate) struct Assets {
    max_assets: usize,
    max_bytes: usize,
    held: RwLock<Held>,
    /// One change at a time: what is kept on the disk and what is held go together.
    changing: Mutex<()>,
}

#[derive(Debug, Default)]
struct Held {
    by_hash: HashMap<String, Entry>,
    /// Hashes by the order of arrival.
    by_number: BTreeMap<u64, String>,
    newest: u64,
    bytes: usize,
    memory_bytes: u64,
}

#[derive(Debug)]
struct Entry {
    number: u64,
    content: Content,
    bytes: usize,
    memory_bytes: u64,
    bounds: Option<(DVec3, DVec3)>,
    /// Scenes that used it at some time.
    needed_by: BTreeSet<SceneNumber>,
    /// It is being deleted: nobody begins to need it.
    is_leaving: bool,
}

/// One asset, as it is listed.
#[derive(Clone, Debug)]
pub(crate) struct Listed {
    pub(crate) number: u64,
    pub(crate) id: String,
    pub(crate) content: Content,
    /// As uploaded.
    pub(crate) bytes: usize,
    pub(crate) memory_bytes: u64,
    /// Low and high corner of what can be inserted, in its own space, metres.
    pub(crate) bounds: Option<(DVec3, DVec3)>,
    pub(crate) needed_by: Vec<SceneNumber>,
}

/// There is no room for another asset.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct NoRoom;

/// Why an asset stays.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Stays {
    /// There is none of that id.
    Unknown,
    /// These scenes use it.
    Needed(Vec<SceneNumber>),
}

impl Assets {
    pub(crate) fn new(max_assets: usize, max_bytes: usize) -> Assets {
        Assets { max_assets, max_bytes, held: RwLock::default(), changing: Mutex::default() }
    }

    /// The id of an asset: the same bytes give the same.
    pub(crate) fn id_of(glb: &[u8]) -> String {
        blake3::hash(glb).to_hex().to_string()
    }

    pub(crate) fn get(&self, id: &str) -> Option<Content> {
        self.read().by_hash.get(id).filter(|entry| !entry.is_leaving).map(|entry| entry.content.clone())
    }

    /// Bytes of all assets as they are held.
    pub(crate) fn memory_bytes(&self) -> u64 {
        self.read().memory_bytes
    }

    /// Held while an asset is added or deleted.
    pub(crate) fn change(&self) -> MutexGuard<'_, ()> {
        self.changing.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether there is room for an asset of `bytes` uploaded bytes beside the others.
    pub(crate) fn check_room(&self, bytes: usize) -> Result<(), NoRoom> {
        let held = self.read();
        let fits = held.by_hash.len() < self.max_assets && bytes <= self.max_bytes.saturating_sub(held.bytes);
        if fits { Ok(()) } else { Err(NoRoom) }
    }

    /// Keeps an asset of `bytes` uploaded bytes, whatever room there is. True where it is new.
    pub(crate) fn insert(&self, id: String, content: impl Into<Content>, bytes: usize) -> bool {
        let content = content.into().named(&id);
        let (memory_bytes, bounds) = (content.memory_bytes(), content.bounds());
        let mut held = self.write();
        if held.by_hash.contains_key(&id) {
            return false;
        }
        held.newest += 1;
        held.bytes += bytes;
        held.memory_bytes += memory_bytes;
        let number = held.newest;
        held.by_number.insert(number, id.clone());
        let needed_by = BTreeSet::new();
        held.by_hash.insert(id, Entry { number, content, bytes, memory_bytes, bounds, needed_by, is_leaving: false });
        true
    }

    /// Assets that arrived before `before`, newest first.
    pub(crate) fn older_than(&self, before: u64, limit: usize) -> Vec<Listed> {
        let held = self.read();
        let ids = held.by_number.range(..before).rev().take(limit);
        let listed = ids.filter_map(|(number, id)| {
            let entry = held.by_hash.get(id)?;
            Some(Listed {
                number: *number,
                id: id.clone(),
                content: entry.content.clone(),
                bytes: entry.bytes,
                memory_bytes: entry.memory_bytes,
                bounds: entry.bounds,
                needed_by: entry.needed_by.iter().copied().collect(),
            })
        });
        listed.collect()
    }

    /// A scene needs these assets from here on: those that it did not need before. The first that is not there, where
    /// one is not; nothing is noted then.
    pub(crate) fn need<'a>(&self, scene: SceneNumber, ids: &[&'a str]) -> Result<Vec<&'a str>, &'a str> {
        let mut held = self.write();
        let is_there = |id: &&&str| held.by_hash.get(**id).is_some_and(|entry| !entry.is_leaving);
        if let Some(missing) = ids.iter().find(|id| !is_there(id)) {
            return Err(missing);
        }
        let mut note = |id: &&str| held.by_hash.get_mut(*id).is_some_and(|entry| entry.needed_by.insert(scene));
        Ok(ids.iter().copied().filter(|id| note(id)).collect())
    }

    /// Takes back what [`Assets::need`] noted: what the scene was to insert was not kept.
    pub(crate) fn unneed(&self, scene: SceneNumber, ids: &[&str]) {
        let mut held = self.write();
        for id in ids {
            if let Some(entry) = held.by_hash.get_mut(*id) {
                entry.needed_by.remove(&scene);
            }
        }
    }

    /// A scene is gone, with its history.
    pub(crate) fn release(&self, scene: SceneNumber) {
        self.write().by_hash.values_mut().for_each(|entry| {
            entry.needed_by.remove(&scene);
        });
    }

    /// Deletes an asset that no scene needs, once `forget` has deleted what is kept of it.
    pub(crate) fn delete<E>(&self, id: &str, forget: impl FnOnce() -> Result<(), E>) -> Result<Result<(), Stays>, E> {
        let _change = self.change();
        match self.write().by_hash.get_mut(id) {
            None => return Ok(Err(Stays::Unknown)),
            Some(entry) if !entry.needed_by.is_empty() => {
                return Ok(Err(Stays::Needed(entry.needed_by.iter().copied().collect())));
            }
            Some(entry) => entry.is_leaving = true,
        }
        let forgotten = forget();
        let mut held = self.write();
        match (&forgotten, held.by_hash.get_mut(id)) {
            (Err(_), Some(entry)) => entry.is_leaving = false,
            _ => held.remove(id),
        }
        forgotten.map(Ok)
    }

    fn read(&self) -> RwLockReadGuard<'_, Held> {
        self.held.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> RwLockWriteGuard<'_, Held> {
        self.held.write().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Held {
    fn remove(&mut self, id: &str) {
        let Some(entry) = self.by_hash.remove(id) else { return };
        self.by_number.remove(&entry.number);
        self.bytes -= entry.bytes;
        self.memory_bytes -= entry.memory_bytes;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nothing() -> Scene {
        Scene::from_objects(Vec::new())
    }

    #[test]
    fn what_a_scene_needs_stays_until_the_scene_is_gone() {
        let assets = Assets::new(2, 100);
        assert!(assets.insert("a".to_owned(), nothing(), 60));
        assert!(!assets.insert("a".to_owned(), nothing(), 60));
        assert_eq!(assets.check_room(41), Err(NoRoom));
        assert_eq!(assets.check_room(40), Ok(()));
        assert_eq!(assets.need(7, &["a", "b"]), Err("b"));
        assert_eq!(assets.need(7, &["a", "a"]), Ok(vec!["a"]));
        assert_eq!(assets.need(7, &["a"]), Ok(vec![]));
        let delete = |id: &str, forgotten: Result<(), ()>| assets.delete(id, || forgotten);
        assert_eq!(delete("b", Ok(())), Ok(Err(Stays::Unknown)));
        assert_eq!(delete("a", Ok(())), Ok(Err(Stays::Needed(vec![7]))));
        assets.release(7);
        // The disk failed: it is there as before.
        assert_eq!(delete("a", Err(())), Err(()));
        assert!(assets.get("a").is_some());
        // Nobody begins to need what is being deleted.
        let deleted = assets.delete("a", || -> Result<(), ()> {
            assert!(assets.get("a").is_none() && assets.need(8, &["a"]) == Err("a"));
            Ok(())
        });
        assert_eq!(deleted, Ok(Ok(())));
        assert!(assets.older_than(u64::MAX, 9).is_empty() && assets.check_room(100) == Ok(()));
        assert_eq!(assets.memory_bytes(), 0);
    }

    #[test]
    fn pages_are_newest_first() {
        let assets = Assets::new(9, 9);
        assert!(["a", "b", "c"].iter().all(|id| assets.insert((*id).to_owned(), nothing(), 1)));
        let page = |before, limit| assets.older_than(before, limit);
        let names = |page: Vec<Listed>| page.into_iter().map(|asset| asset.id).collect::<String>();
        assert_eq!(names(page(u64::MAX, 2)), "cb");
        assert_eq!(names(page(page(u64::MAX, 2)[1].number, 2)), "a");
    }
}
