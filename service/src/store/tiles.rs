//! Pages of atlases that clients follow: hashes of their tiles as they were last delivered, with the version that each
//! was first seen at. No texels are kept.
//!
//! Every delivery is seen here, so that whoever has a page at some version is told every tile that has other bits now,
//! also where a client that was slow got an older version after another had got a newer one.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::deltas::KeptDeltas;
use super::versions::Wanted;
use crate::filter::Filter;

/// Selections that are kept per scene; the one that was asked for longest ago makes room.
const SELECTIONS: usize = 32;

/// Of what a tile holds, as it was delivered: equal ones have the same texels.
pub(crate) type TileHash = [u8; 16];

/// What pages are read for.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Selection {
    /// A layer; none for the map itself.
    pub(crate) layer: Option<String>,
    pub(crate) wanted: Wanted,
    pub(crate) filter: Filter,
    /// Values are `f16`.
    pub(crate) half: bool,
}

/// The tiles of a page.
#[derive(Clone, Debug)]
pub(crate) struct PageTiles {
    size: [u32; 2],
    /// The newest that was seen.
    version: u64,
    /// What was delivered before is not known.
    first: u64,
    hashes: Vec<TileHash>,
    /// Per tile: a version from which on it is as it is now.
    changed: Arc<[u64]>,
}

impl PageTiles {
    fn new(version: u64, size: [u32; 2], hashes: Vec<TileHash>) -> PageTiles {
        PageTiles { size, version, first: version, changed: vec![version; hashes.len()].into(), hashes }
    }

    fn see(&mut self, version: u64, size: [u32; 2], hashes: Vec<TileHash>) {
        let is_newer = version >= self.version;
        if size != self.size {
            match is_newer {
                true => *self = PageTiles::new(version, size, hashes),
                false => self.first = self.version,
            }
            return;
        }
        // Who has an older version has other bits in these tiles.
        let newest = self.version.max(version);
        let seen = self.hashes.iter().zip(&hashes).zip(&*self.changed);
        self.changed = seen.map(|((old, new), changed)| if old == new { *changed } else { newest }).collect();
        if is_newer {
            (self.version, self.hashes) = (version, hashes);
        }
    }

    /// Whether a client that has the page at version `since`, 0 for none, may have other bits in a tile.
    pub(crate) fn is_new(&self, tile: usize, since: u64) -> bool {
        since == 0 || since < self.first || self.changed[tile] > since
    }

    fn memory_bytes(&self) -> usize {
        size_of_val(self.hashes.as_slice()) + size_of_val(&*self.changed)
    }
}

/// The pages of a scene, for each selection by their index; asked for last comes last.
type Seen = VecDeque<(Selection, BTreeMap<usize, PageTiles>)>;

/// All that is kept of a scene.
#[derive(Default)]
pub(crate) struct KeptTiles {
    /// Whoever reads pages for a delta holds it: others may want the same.
    pub(crate) turn: tokio::sync::Mutex<()>,
    /// The last deltas that were asked for, as frames.
    pub(crate) deltas: KeptDeltas<(Selection, u64, u64)>,
    seen: Mutex<Seen>,
}

impl KeptTiles {
    /// A page of that size was read for a client; answers what is known of its tiles.
    pub(crate) fn see(
        &self,
        selection: &Selection,
        page: usize,
        version: u64,
        size: [u32; 2],
        hashes: Vec<TileHash>,
    ) -> PageTiles {
        let mut seen = self.seen();
        let at = seen.iter().position(|(kept, _)| kept == selection);
        let (kept, mut pages) =
            at.and_then(|at| seen.remove(at)).unwrap_or_else(|| (selection.clone(), BTreeMap::new()));
        let known = match pages.remove(&page) {
            Some(mut known) => {
                known.see(version, size, hashes);
                known
            }
            None => PageTiles::new(version, size, hashes),
        };
        pages.insert(page, known.clone());
        if seen.len() >= SELECTIONS {
            seen.pop_front();
        }
        seen.push_back((kept, pages));
        known
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        let hashes: usize = self.seen().iter().flat_map(|(_, pages)| pages.values()).map(PageTiles::memory_bytes).sum();
        hashes + self.deltas.memory_bytes()
    }

    fn seen(&self) -> MutexGuard<'_, Seen> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use rebake_core::random::Pcg32;

    use super::*;

    fn selection(layer: &str) -> Selection {
        Selection { layer: Some(layer.to_owned()), wanted: Wanted::Error, filter: Filter::None, half: true }
    }

    fn hashes(tiles: &[u8]) -> Vec<TileHash> {
        tiles.iter().map(|tile| [*tile; 16]).collect()
    }

    /// Versions are seen in any order, some of them not at all: whoever was given one is told all that differs.
    #[test]
    fn whoever_was_given_a_page_is_told_what_differs() {
        const TILES: usize = 4;
        let mut rng = Pcg32::new(1, 1);
        for case in 0..500 {
            let mut below = |n: u32| rng.next_u32() % n;
            let versions: Vec<[u8; TILES]> = (0..1 + below(7)).map(|_| [(); TILES].map(|()| below(3) as u8)).collect();
            let (kept, mut given) = (KeptTiles::default(), Vec::new());
            for _ in 0..1 + below(15) {
                let index = below(versions.len() as u32) as usize;
                let now = kept.see(&selection("a"), 0, index as u64 + 1, [64, 64], hashes(&versions[index]));
                given.push(index);
                for earlier in given.iter().filter(|earlier| **earlier <= index) {
                    for tile in 0..TILES {
                        let differs = versions[*earlier][tile] != versions[index][tile];
                        assert!(!differs || now.is_new(tile, *earlier as u64 + 1), "{case}: {given:?} of {versions:?}");
                    }
                }
                assert!((0..TILES).all(|tile| now.is_new(tile, 0)), "who has nothing gets all");
            }
        }
    }

    #[test]
    fn only_what_changed_is_told() {
        let kept = KeptTiles::default();
        let see = |version, tiles: &[u8]| kept.see(&selection("a"), 0, version, [64, 32], hashes(tiles));
        let told = |page: &PageTiles, since| [0, 1].map(|tile| page.is_new(tile, since));
        assert_eq!(told(&see(0, &[1, 1]), 0), [true; 2], "version 0 is no version to go on from");
        let kept = KeptTiles::default();
        let see = |version, tiles: &[u8]| kept.see(&selection("a"), 0, version, [64, 32], hashes(tiles));
        see(3, &[1, 1]);
        let now = see(5, &[1, 2]);
        assert_eq!([2, 3, 4, 5].map(|since| told(&now, since)), [[true; 2], [false, true], [false, true], [false; 2]]);
        let back = see(7, &[1, 1]);
        assert_eq!([3, 5, 7].map(|since| told(&back, since)), [[false, true], [false, true], [false; 2]]);
        // Another size is another page, also where that comes late.
        let grown = kept.see(&selection("a"), 0, 8, [64, 64], hashes(&[1; 4]));
        assert_eq!((grown.is_new(0, 7), grown.is_new(0, 8)), (true, false));
        let late = kept.see(&selection("a"), 0, 7, [64, 32], hashes(&[1, 1]));
        assert_eq!((late.is_new(0, 7), late.is_new(0, 8)), (true, false));
    }

    #[test]
    fn selections_are_apart_and_make_room() {
        let kept = KeptTiles::default();
        let see = |layer: &str, version| kept.see(&selection(layer), 0, version, [32, 32], hashes(&[1]));
        see("a", 1);
        assert!(see("b", 2).is_new(0, 1) && !see("a", 2).is_new(0, 1));
        assert!(kept.memory_bytes() > 0);
        (0..SELECTIONS).for_each(|k| drop(see(&k.to_string(), 3)));
        assert!(see("a", 3).is_new(0, 2), "it was forgotten");
    }
}
