//! Pages of atlases as tiles: what tells them apart, and those that changed as bytes.

use rayon::prelude::*;
use rebake_core::delta::{FrameFlags, Tile, TileFrame, grid};
use rebake_core::texels::TexelPage;

use crate::store::tiles::{PageTiles, TileHash};

/// Longest side of a tile, texels. Fewer texels would be unchanged ones in smaller tiles; compressed, they are as large.
const SIDE: u32 = 32;

/// Bytes of a value of full precision.
const VALUE_BYTES: usize = 12;

fn size_of_page(page: &TexelPage) -> [u32; 2] {
    [page.width as u32, page.height as u32]
}

fn cut(page: &TexelPage, index: usize, (corner, size): ([u32; 2], [u32; 2])) -> Tile {
    Tile::cut(index as u32, (page.width, &page.values, &page.valid), corner, size)
}

/// The size of a page and the hashes of its tiles as they are delivered, in the order of their grid.
pub(crate) fn hashes(page: &TexelPage, half: bool) -> ([u32; 2], Vec<TileHash>) {
    let size = size_of_page(page);
    let places: Vec<_> = grid(size, SIDE).collect();
    let hash = |bytes: &mut Vec<u8>, place: &([u32; 2], [u32; 2])| -> TileHash {
        bytes.clear();
        cut(page, 0, *place).write_texels(half, bytes);
        let mut short = TileHash::default();
        short.copy_from_slice(&blake3::hash(bytes).as_bytes()[..16]);
        short
    };
    (size, places.par_iter().map_init(Vec::new, hash).collect())
}

/// One snapshot, frame by frame.
pub(crate) struct Frames {
    /// How every frame begins.
    head: TileFrame,
    /// Version of the pages that the client has; 0 for none.
    since: u64,
    max_tiles: usize,
    bytes: Vec<u8>,
}

impl Frames {
    /// What leads pages of those sizes from version `since` to `version`, in frames of about `frame_bytes` bytes.
    pub(crate) fn new(sizes: Vec<[u32; 2]>, (since, version): (u64, u64), half: bool, frame_bytes: usize) -> Frames {
        let flags = FrameFlags { last: false, replace_all: since == 0, half };
        let max_tiles = (frame_bytes / (VALUE_BYTES * (SIDE * SIDE) as usize)).max(1);
        let head = TileFrame { flags, base: since, new: version, pages: sizes, tiles: Vec::new() };
        Frames { head, since, max_tiles, bytes: Vec::new() }
    }

    /// Adds the tiles of a page that the client lacks. Pages begin empty, so that empty tiles of a first one need not
    /// be told.
    pub(crate) fn add(&mut self, index: usize, page: &TexelPage, known: &PageTiles) {
        let places: Vec<_> = grid(size_of_page(page), SIDE).enumerate().collect();
        let new: Vec<_> = places.into_iter().filter(|(tile, _)| known.is_new(*tile, self.since)).collect();
        for places in new.chunks(self.max_tiles) {
            let tiles = places.iter().map(|(_, place)| cut(page, index, *place));
            let tiles: Vec<Tile> = tiles.filter(|tile| self.since > 0 || !tile.is_empty()).collect();
            if !tiles.is_empty() {
                self.push(tiles, false);
            }
        }
    }

    /// All frames.
    pub(crate) fn finish(mut self) -> Vec<u8> {
        self.push(Vec::new(), true);
        self.bytes
    }

    fn push(&mut self, tiles: Vec<Tile>, last: bool) {
        let frame = TileFrame { tiles, flags: FrameFlags { last, ..self.head.flags }, ..self.head.clone() };
        self.bytes.extend(frame.encode());
        // What was sent of this snapshot stays.
        self.head.flags.replace_all = false;
    }
}
