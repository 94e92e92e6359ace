//! Tiles: what changed on the pages of an atlas between two versions.
//!
//! A [`TileFrame`] lists the sizes of all pages, and rectangles of texels with their new values. Like those of a
//! [`Frame`](super::Frame) they are absolute, so that applying every frame since version V to the pages at V gives the
//! newest pages bit for bit; whoever applies a frame of a later version that changes more than needed loses nothing.
//! Laws, each with a property test beside this file: `decode(encode(f)) = f`, and the tiles in which two sets of pages
//! differ, applied to the first, give the second.

use glam::Vec3;

use super::wire::{Header, read_values, u32_at, write_values};
use super::{DeltaError, FrameFlags, same_bits};

/// First bytes of every frame of tiles.
pub const TILE_MAGIC: [u8; 4] = *b"RBKT";
/// Media type of a sequence of frames of tiles.
pub const TILE_CONTENT_TYPE: &str = "application/vnd.rebake.tiles";
/// Texels that the pages of a frame may have together. Keeps a malformed frame from asking for more memory than an
/// atlas can need.
pub const MAX_TEXELS: u64 = 1 << 28;

const PAGE_BYTES: usize = 8;
const TILE_BYTES: usize = 20;

/// A page of texels, row by row from the top.
#[derive(Clone, Debug, Default)]
pub struct TilePage {
    /// Width and height, texels.
    pub size: [u32; 2],
    /// One value per texel.
    pub values: Vec<Vec3>,
    /// Whether a texel was read from a surface.
    pub valid: Vec<bool>,
}

/// A rectangle of a page with what its texels hold.
#[derive(Clone, Debug, Default)]
pub struct Tile {
    /// Index of the page.
    pub page: u32,
    /// First column and row, texels from the top left.
    pub corner: [u32; 2],
    /// Width and height, texels; at least 1.
    pub size: [u32; 2],
    /// New values, row by row.
    pub values: Vec<Vec3>,
    /// Whether a texel was read from a surface, row by row.
    pub valid: Vec<bool>,
}

/// The tiles that changed from version `base` to version `new`, or a part of them. Two frames are equal where all bits
/// are.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TileFrame {
    /// How to read the frame; `replace_all`: all pages are emptied before the tiles are written.
    pub flags: FrameFlags,
    /// Version of the pages that the frame applies to; 0 with `replace_all`.
    pub base: u64,
    /// Version of the pages once the last frame of the snapshot is applied.
    pub new: u64,
    /// Width and height of every page at version `new`.
    pub pages: Vec<[u32; 2]>,
    /// What changed.
    pub tiles: Vec<Tile>,
}

impl TilePage {
    /// A page of which nothing was read: zero, and not valid.
    pub fn empty(size: [u32; 2]) -> TilePage {
        let texels = texels(size) as usize;
        TilePage { size, values: vec![Vec3::ZERO; texels], valid: vec![false; texels] }
    }

    /// This page at another size: what lies on both stays, the rest is empty.
    fn resized(&self, size: [u32; 2]) -> TilePage {
        let mut next = TilePage::empty(size);
        let common = [self.size[0].min(size[0]), self.size[1].min(size[1])];
        if texels(common) > 0 {
            let tile = Tile::cut(0, (self.size[0] as usize, &self.values, &self.valid), [0; 2], common);
            next.write(&tile);
        }
        next
    }

    fn write(&mut self, tile: &Tile) {
        let ([x, y], [w, _]) = (tile.corner.map(|c| c as usize), tile.size.map(|s| s as usize));
        for (row, (values, valid)) in tile.values.chunks(w).zip(tile.valid.chunks(w)).enumerate() {
            let start = (y + row) * self.size[0] as usize + x;
            self.values[start..start + w].copy_from_slice(values);
            self.valid[start..start + w].copy_from_slice(valid);
        }
    }
}

impl PartialEq for TilePage {
    fn eq(&self, other: &TilePage) -> bool {
        self.size == other.size && self.valid == other.valid && have_same_bits(&self.values, &other.values)
    }
}

impl PartialEq for Tile {
    fn eq(&self, other: &Tile) -> bool {
        (self.page, self.corner, self.size) == (other.page, other.corner, other.size)
            && self.valid == other.valid
            && have_same_bits(&self.values, &other.values)
    }
}

fn have_same_bits(a: &[Vec3], b: &[Vec3]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same_bits(*a, *b))
}

fn texels([width, height]: [u32; 2]) -> u64 {
    u64::from(width) * u64::from(height)
}

impl Tile {
    /// A rectangle of page `page`, whose texels are given as its width, values and validity.
    ///
    /// # Panics
    /// Where the rectangle does not lie on the page.
    pub fn cut(page: u32, (width, values, valid): (usize, &[Vec3], &[bool]), corner: [u32; 2], size: [u32; 2]) -> Tile {
        let ([x, y], [w, h]) = (corner.map(|c| c as usize), size.map(|s| s as usize));
        let mut tile = Tile { page, corner, size, values: Vec::with_capacity(w * h), valid: Vec::with_capacity(w * h) };
        for row in y..y + h {
            let row = row * width + x..row * width + x + w;
            tile.values.extend_from_slice(&values[row.clone()]);
            tile.valid.extend_from_slice(&valid[row]);
        }
        tile
    }

    /// Whether it is as on an empty page.
    pub fn is_empty(&self) -> bool {
        self.values.iter().all(|value| same_bits(*value, Vec3::ZERO)) && !self.valid.contains(&true)
    }

    /// What its texels hold as the format has it, appended to `bytes`: all values, then a bit per texel.
    pub fn write_texels(&self, half: bool, bytes: &mut Vec<u8>) {
        write_values(&self.values, half, bytes);
        self.write_valid(bytes);
    }

    fn write_valid(&self, bytes: &mut Vec<u8>) {
        let byte = |bits: &[bool]| bits.iter().enumerate().fold(0, |byte, (k, bit)| byte | u8::from(*bit) << k);
        bytes.extend(self.valid.chunks(8).map(byte));
    }

    fn texels(&self) -> u64 {
        texels(self.size)
    }
}

/// Corners and sizes of the tiles of at most `side` × `side` texels that make up a page.
///
/// # Panics
/// Where `side` is 0.
pub fn grid(page: [u32; 2], side: u32) -> impl Iterator<Item = ([u32; 2], [u32; 2])> + Clone {
    let cuts = move |length: u32| (0..length).step_by(side as usize).map(move |at| (at, side.min(length - at)));
    cuts(page[1]).flat_map(move |(y, h)| cuts(page[0]).map(move |(x, w)| ([x, y], [w, h])))
}

impl TileFrame {
    /// Size of [`TileFrame::encode`].
    pub fn encoded_bytes(&self) -> usize {
        let texels = |tile: &Tile| tile.values.len() * self.flags.value_bytes() + tile.valid.len().div_ceil(8);
        let tiles: usize = self.tiles.iter().map(|tile| TILE_BYTES + texels(tile)).sum();
        super::HEADER_BYTES + self.pages.len() * PAGE_BYTES + tiles
    }

    /// The frame as bytes. It has to be valid ([`TileFrame::validate`]).
    pub fn encode(&self) -> Vec<u8> {
        debug_assert_eq!(self.validate(), Ok(()));
        let header = Header {
            magic: TILE_MAGIC,
            flags: self.flags,
            base: self.base,
            new: self.new,
            counts: [self.pages.len(), self.tiles.len()],
        };
        header.seal(self.encoded_bytes(), |bytes| {
            let mut numbers = |numbers: &[u32]| numbers.iter().for_each(|n| bytes.extend_from_slice(&n.to_le_bytes()));
            self.pages.iter().for_each(|size| numbers(size));
            for Tile { page, corner: [x, y], size: [w, h], .. } in &self.tiles {
                numbers(&[*page, *x, *y, *w, *h]);
            }
            self.tiles.iter().for_each(|tile| write_values(&tile.values, self.flags.half, bytes));
            self.tiles.iter().for_each(|tile| tile.write_valid(bytes));
        })
    }

    /// Reads one frame from the beginning of `bytes`; also tells how many bytes it took. No texel is allocated before
    /// all bytes of the frame are there and their checksum matches.
    ///
    /// # Errors
    /// [`DeltaError`]; [`DeltaError::Incomplete`] where more bytes are needed.
    pub fn decode(bytes: &[u8]) -> Result<(TileFrame, usize), DeltaError> {
        let (header, payload) = Header::open(TILE_MAGIC, bytes, |header, payload_bytes| {
            let [pages, tiles] = header.counts;
            let table = pages.checked_mul(PAGE_BYTES).zip(tiles.checked_mul(TILE_BYTES));
            match table.and_then(|(a, b)| a.checked_add(b)).is_some_and(|table| table <= payload_bytes) {
                true => Ok(()),
                false => Err(DeltaError::Malformed("the counts do not add up to the payload's size")),
            }
        })?;
        let ([pages, tiles], flags) = (header.counts, header.flags);
        let (sizes, rest) = payload.split_at(pages * PAGE_BYTES);
        let (places, texels) = rest.split_at(tiles * TILE_BYTES);
        let place = |place: &[u8]| Tile {
            page: u32_at(place, 0),
            corner: [u32_at(place, 4), u32_at(place, 8)],
            size: [u32_at(place, 12), u32_at(place, 16)],
            ..Tile::default()
        };
        let mut frame = TileFrame {
            flags,
            base: header.base,
            new: header.new,
            pages: sizes.chunks_exact(PAGE_BYTES).map(|size| [u32_at(size, 0), u32_at(size, 4)]).collect(),
            tiles: places.chunks_exact(TILE_BYTES).map(place).collect(),
        };
        frame.check_places()?;
        // At most MAX_TEXELS for each of fewer than 2^32 tiles: no overflow before the factor, which is checked.
        let count: u64 = frame.tiles.iter().map(Tile::texels).sum();
        let bits: u64 = frame.tiles.iter().map(|tile| tile.texels().div_ceil(8)).sum();
        let size = count.checked_mul(flags.value_bytes() as u64).and_then(|size| size.checked_add(bits));
        if size != Some(texels.len() as u64) {
            return Err(DeltaError::Malformed("the tiles do not add up to the payload's size"));
        }
        let (mut rest, mut bits) = texels.split_at(count as usize * flags.value_bytes());
        for tile in &mut frame.tiles {
            let count = tile.texels() as usize;
            let (values, after) = rest.split_at(count * flags.value_bytes());
            let (valid, more) = bits.split_at(count.div_ceil(8));
            tile.values = read_values(values, flags.half);
            tile.valid = (0..count).map(|k| valid[k / 8] >> (k % 8) & 1 == 1).collect();
            (rest, bits) = (after, more);
        }
        Ok((frame, super::HEADER_BYTES + payload.len()))
    }

    /// Checks what a valid frame promises: tiles lie on its pages and have one value per texel.
    ///
    /// # Errors
    /// [`DeltaError`]
    pub fn validate(&self) -> Result<(), DeltaError> {
        self.check_places()?;
        let is_full = |tile: &Tile| [tile.values.len(), tile.valid.len()].iter().all(|n| *n as u64 == tile.texels());
        if !self.tiles.iter().all(is_full) {
            return Err(DeltaError::Malformed("a tile has not one value per texel"));
        }
        Ok(())
    }

    fn check_places(&self) -> Result<(), DeltaError> {
        let all = self.pages.iter().fold(0, |sum: u64, size| sum.saturating_add(texels(*size)));
        if all > MAX_TEXELS {
            return Err(DeltaError::Malformed("the pages are larger than an atlas can be"));
        }
        let fits = |tile: &Tile| {
            let Some(page) = self.pages.get(tile.page as usize) else { return false };
            let within = |k: usize| {
                tile.size[k] > 0 && tile.corner[k].checked_add(tile.size[k]).is_some_and(|end| end <= page[k])
            };
            within(0) && within(1)
        };
        match self.tiles.iter().all(fits) {
            true => Ok(()),
            false => Err(DeltaError::Malformed("a tile does not lie on a page")),
        }
    }

    /// Brings pages to what the frame says. Those that are new begin empty, those of another size keep the texels that
    /// lie on both, those that the frame does not list are dropped. On an error the pages are as they were. Versions
    /// are the caller's to compare.
    ///
    /// # Errors
    /// [`DeltaError`]
    pub fn apply(&self, pages: &mut Vec<TilePage>) -> Result<(), DeltaError> {
        self.validate()?;
        if self.flags.replace_all {
            pages.clear();
        }
        pages.resize_with(self.pages.len(), TilePage::default);
        for (page, size) in pages.iter_mut().zip(&self.pages) {
            if page.size != *size {
                *page = page.resized(*size);
            }
        }
        self.tiles.iter().for_each(|tile| pages[tile.page as usize].write(tile));
        Ok(())
    }
}
