//! Deltas: what changed between two versions of a light map, as an algebra and as bytes.
//!
//! A [`Frame`] lists runs of elements and their new values. Values are absolute, never differences, so nothing drifts:
//! applying every frame since version V to the map at V gives the newest map bit for bit. Comparisons are of bits, so
//! NaN and −0 survive too.
//!
//! Laws, each with a property test beside this file:
//! - `decode(encode(f)) = f`
//! - `apply(merge(a, b)) = apply(b) ∘ apply(a)`
//! - `merge(merge(a, b), c) = merge(a, merge(b, c))`
//! - `between(x, x)` is empty, and `between(x, y)` applied to `x` gives `y`

mod stream;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tile_tests;
mod tiles;
mod wire;

pub use stream::Decoder;
pub use tiles::{MAX_TEXELS, TILE_CONTENT_TYPE, TILE_MAGIC, Tile, TileFrame, TilePage, grid};
pub use wire::{CONTENT_TYPE, FORMAT_VERSION, HEADER_BYTES, MAGIC};

use glam::Vec3;

/// Longest light map that a delta may describe. Keeps every count of the format within `u32` and a malformed frame
/// from asking for more memory than a light map can need.
pub const MAX_ELEMENTS: usize = 1 << 27;

/// Properties of a frame, as its header states them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameFlags {
    /// The snapshot is complete with this frame: the map is now at [`Frame::new`].
    pub last: bool,
    /// The map is emptied before the runs are written; the base version does not matter.
    pub replace_all: bool,
    /// Values travel as three `f16`. In memory they stay `f32`; see [`Frame::halved`].
    pub half: bool,
}

/// Neighbouring elements with new values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Run {
    /// First element.
    pub first: u32,
    /// Number of elements, at least 1.
    pub count: u32,
}

impl Run {
    /// One past the last element.
    pub fn end(self) -> u64 {
        u64::from(self.first) + u64::from(self.count)
    }
}

/// The elements that changed from version `base` to version `new`, or a part of them.
///
/// In a valid frame the runs are in rising order, do not overlap, are not empty, end at [`MAX_ELEMENTS`] at the latest
/// and add up to the number of values ([`Frame::validate`]). All functions here make valid frames. Two frames are equal
/// where all bits are.
#[derive(Clone, Debug, Default)]
pub struct Frame {
    /// How to read the frame.
    pub flags: FrameFlags,
    /// Version of the map that the frame applies to; 0 with `replace_all`.
    pub base: u64,
    /// Version of the map once the last frame of the snapshot is applied.
    pub new: u64,
    /// Which elements changed.
    pub runs: Vec<Run>,
    /// Their new values, in run order.
    pub values: Vec<Vec3>,
}

/// Why bytes are not a delta, or why a delta does not apply.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DeltaError {
    /// The bytes end inside a frame. Not an error while more may come.
    #[error("the frame is not complete: {needed} bytes are needed")]
    Incomplete {
        /// Bytes that the frame needs in all, as far as is known by now.
        needed: usize,
    },
    /// The bytes do not begin with `RBKD`.
    #[error("not a delta: it does not begin with RBKD")]
    Magic,
    /// A format version that this build does not know.
    #[error("delta format version {0} is not known")]
    Version(u16),
    /// Flag bits that this build does not know.
    #[error("delta flags {0:#06x} are not known")]
    Flags(u16),
    /// The payload's checksum does not match.
    #[error("the payload is damaged: its CRC-32 is {found:08x}, the header says {expected:08x}")]
    Checksum {
        /// What the header says.
        expected: u32,
        /// What the payload has.
        found: u32,
    },
    /// Counts or runs contradict each other.
    #[error("malformed delta: {0}")]
    Malformed(&'static str),
    /// The map would grow past the limit.
    #[error("the delta reaches element {end}, the limit is {limit}")]
    TooLong {
        /// One past the last element of the delta.
        end: u64,
        /// Largest length allowed.
        limit: usize,
    },
    /// The second frame does not follow the first.
    #[error("a delta from version {base} does not follow version {version}")]
    Gap {
        /// Version the map is at.
        version: u64,
        /// Version the frame starts from.
        base: u64,
    },
}

/// Equality of all three bit patterns: NaN equals itself, −0 and 0 differ.
pub fn same_bits(a: Vec3, b: Vec3) -> bool {
    a.to_array().map(f32::to_bits) == b.to_array().map(f32::to_bits)
}

impl PartialEq for Frame {
    fn eq(&self, other: &Frame) -> bool {
        (self.flags, self.base, self.new) == (other.flags, other.base, other.new)
            && self.runs == other.runs
            && self.values.len() == other.values.len()
            && self.values.iter().zip(&other.values).all(|(a, b)| same_bits(*a, *b))
    }
}

impl Frame {
    /// What changed from `old` to `new`. Where `new` is longer its whole tail is in; where it is shorter the frame
    /// replaces everything.
    ///
    /// # Panics
    /// If `new` is longer than [`MAX_ELEMENTS`].
    pub fn between(old: &[Vec3], new: &[Vec3], base: u64, new_version: u64) -> Frame {
        if new.len() < old.len() {
            return Frame { base, ..Frame::whole(new, new_version) };
        }
        Frame::from_changed(new, |i| i >= old.len() || !same_bits(old[i], new[i]), base, new_version)
    }

    /// The elements of `values` for which `changed` says yes.
    ///
    /// # Panics
    /// If `values` is longer than [`MAX_ELEMENTS`].
    pub fn from_changed(values: &[Vec3], changed: impl Fn(usize) -> bool, base: u64, new: u64) -> Frame {
        assert!(values.len() <= MAX_ELEMENTS, "a light map of {} elements", values.len());
        let mut frame =
            Frame { flags: FrameFlags { last: true, ..FrameFlags::default() }, base, new, ..Frame::default() };
        let mut i = 0;
        while i < values.len() {
            let first = i;
            while i < values.len() && changed(i) {
                i += 1;
            }
            frame.push(first as u64, &values[first..i]);
            i += 1;
        }
        frame
    }

    /// All of a map: base 0, `replace_all`.
    ///
    /// # Panics
    /// If `values` is longer than [`MAX_ELEMENTS`].
    pub fn whole(values: &[Vec3], version: u64) -> Frame {
        let mut frame = Frame::from_changed(values, |_| true, 0, version);
        frame.flags.replace_all = true;
        frame
    }

    /// This frame with its values rounded to `f16`, to be sent at half the size. Finite values beyond the range of
    /// `f16` become its largest.
    #[must_use]
    pub fn halved(mut self) -> Frame {
        self.flags.half = true;
        for value in &mut self.values {
            *value = value.to_array().map(|x| wire::to_half(x).to_f32()).into();
        }
        self
    }

    /// Whether applying the frame changes nothing.
    pub fn is_empty(&self) -> bool {
        self.runs.is_empty() && !self.flags.replace_all
    }

    /// One past the last element of the runs.
    pub fn end(&self) -> u64 {
        self.runs.last().map_or(0, |run| run.end())
    }

    /// The runs with their values.
    pub fn slices(&self) -> impl Iterator<Item = (u32, &[Vec3])> {
        let mut rest = &self.values[..];
        self.runs.iter().map(move |run| {
            let (slice, after) = rest.split_at((run.count as usize).min(rest.len()));
            rest = after;
            (run.first, slice)
        })
    }

    /// Checks what a valid frame promises.
    pub fn validate(&self) -> Result<(), DeltaError> {
        let (mut end, mut count) = (0u64, 0u64);
        for run in &self.runs {
            if run.count == 0 {
                return Err(DeltaError::Malformed("a run is empty"));
            }
            if u64::from(run.first) < end {
                return Err(DeltaError::Malformed("runs overlap or are out of order"));
            }
            end = run.end();
            count += u64::from(run.count);
        }
        if count != self.values.len() as u64 {
            return Err(DeltaError::Malformed("the runs do not add up to the number of values"));
        }
        within(end, MAX_ELEMENTS)
    }

    /// Cuts the frame into frames of at most `max_values` values (at least 1), to be applied in order. Only the last
    /// has `flags.last` (if this one has), only the first `replace_all`.
    pub fn split(self, max_values: usize) -> Vec<Frame> {
        let max_values = max_values.max(1);
        if self.values.len() <= max_values {
            return vec![self];
        }
        let part = Frame { flags: FrameFlags { last: false, replace_all: false, ..self.flags }, ..self.empty() };
        let mut frames = vec![Frame { flags: FrameFlags { last: false, ..self.flags }, ..self.empty() }];
        for (first, mut slice) in self.slices() {
            let mut first = u64::from(first);
            while !slice.is_empty() {
                if frames.last().is_some_and(|frame| frame.values.len() == max_values) {
                    frames.push(part.clone());
                }
                let Some(frame) = frames.last_mut() else { break };
                let (now, later) = slice.split_at(slice.len().min(max_values - frame.values.len()));
                frame.push(first, now);
                first += now.len() as u64;
                slice = later;
            }
        }
        if let Some(frame) = frames.last_mut() {
            frame.flags.last = self.flags.last;
        }
        frames
    }

    /// Writes the values into `map`, which grows with zeros where runs lie beyond its end, up to [`MAX_ELEMENTS`].
    /// On an error the map is as it was. Versions are the caller's to compare.
    pub fn apply(&self, map: &mut Vec<Vec3>) -> Result<(), DeltaError> {
        self.apply_within(map, MAX_ELEMENTS)
    }

    /// [`Frame::apply`] with a tighter limit on the length of the map.
    pub fn apply_within(&self, map: &mut Vec<Vec3>, limit: usize) -> Result<(), DeltaError> {
        self.validate()?;
        within(self.end(), limit)?;
        if self.flags.replace_all {
            map.clear();
        }
        let end = self.end() as usize;
        if map.len() < end {
            map.resize(end, Vec3::ZERO);
        }
        for (first, slice) in self.slices() {
            let first = first as usize;
            map[first..first + slice.len()].copy_from_slice(slice);
        }
        Ok(())
    }

    /// One frame that does what `first` and then `second` do. `second` has to follow: from the version that `first`
    /// leads to, or as a further part of the same snapshot, or replacing everything.
    pub fn merge(first: &Frame, second: &Frame) -> Result<Frame, DeltaError> {
        first.validate()?;
        second.validate()?;
        if second.flags.replace_all {
            return Ok(second.clone());
        }
        let follows = if first.flags.last {
            second.base == first.new
        } else {
            second.base <= first.new && second.new >= first.new
        };
        if !follows {
            return Err(DeltaError::Gap { version: first.new, base: second.base });
        }
        let mut merged = Frame {
            flags: FrameFlags {
                last: second.flags.last,
                replace_all: first.flags.replace_all,
                half: first.flags.half && second.flags.half,
            },
            base: first.base.min(second.base),
            new: second.new,
            ..Frame::default()
        };
        // A sweep over both lists of runs. What of the first frame lies under the second is overwritten.
        let mut older = first.slices().map(|(at, slice)| (u64::from(at), slice));
        let mut old = older.next();
        for (at, slice) in second.slices() {
            let (at, end) = (u64::from(at), u64::from(at) + slice.len() as u64);
            while let Some((old_at, rest)) = old.filter(|(old_at, _)| *old_at < at) {
                let before = ((at - old_at) as usize).min(rest.len());
                merged.push(old_at, &rest[..before]);
                old = remainder(old_at, rest, before).or_else(|| older.next());
            }
            merged.push(at, slice);
            while let Some((old_at, rest)) = old.filter(|(old_at, _)| *old_at < end) {
                let under = ((end - old_at) as usize).min(rest.len());
                old = remainder(old_at, rest, under).or_else(|| older.next());
            }
        }
        for (at, slice) in old.into_iter().chain(older) {
            merged.push(at, slice);
        }
        Ok(merged)
    }

    /// A frame of the same versions without runs.
    fn empty(&self) -> Frame {
        Frame { flags: self.flags, base: self.base, new: self.new, ..Frame::default() }
    }

    /// Appends a run, joined to the one before it where they touch.
    fn push(&mut self, first: u64, values: &[Vec3]) {
        if values.is_empty() {
            return;
        }
        match self.runs.last_mut() {
            Some(run) if run.end() == first => run.count += values.len() as u32,
            _ => self.runs.push(Run { first: first as u32, count: values.len() as u32 }),
        }
        self.values.extend_from_slice(values);
    }
}

/// What is left of a run after its first `taken` values.
fn remainder(at: u64, values: &[Vec3], taken: usize) -> Option<(u64, &[Vec3])> {
    (taken < values.len()).then(|| (at + taken as u64, &values[taken..]))
}

fn within(end: u64, limit: usize) -> Result<(), DeltaError> {
    if end > limit as u64 { Err(DeltaError::TooLong { end, limit }) } else { Ok(()) }
}
