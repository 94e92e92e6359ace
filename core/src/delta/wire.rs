//! Delta format, version 1: little-endian bytes of a [`Frame`].
//!
//! | bytes | header field |
//! | --- | --- |
//! | 0..4 | magic `RBKD` |
//! | 4..6 | format version, 1 |
//! | 6..8 | flags: bit 0 last frame of a snapshot, bit 1 replace everything, bit 2 values are `f16` |
//! | 8..16 | base version |
//! | 16..24 | new version |
//! | 24..28 | number of runs |
//! | 28..32 | number of values |
//! | 32..36 | payload bytes |
//! | 36..40 | CRC-32 (IEEE) of the payload |
//!
//! Payload: runs (`u32` first element, `u32` count), then three floats (RGB) per value in run order.

use glam::Vec3;
use half::f16;

use super::{DeltaError, Frame, FrameFlags, MAX_ELEMENTS, Run};

/// First bytes of every frame.
pub const MAGIC: [u8; 4] = *b"RBKD";
/// The format version this build writes and reads.
pub const FORMAT_VERSION: u16 = 1;
/// Size of the frame header.
pub const HEADER_BYTES: usize = 40;
/// Media type of a sequence of frames.
pub const CONTENT_TYPE: &str = "application/vnd.rebake.delta";

const RUN_BYTES: usize = 8;
const LAST: u16 = 1 << 0;
const REPLACE_ALL: u16 = 1 << 1;
const HALF: u16 = 1 << 2;

impl FrameFlags {
    pub(super) fn bits(self) -> u16 {
        let bit = |set: bool, bit: u16| if set { bit } else { 0 };
        bit(self.last, LAST) | bit(self.replace_all, REPLACE_ALL) | bit(self.half, HALF)
    }

    pub(super) fn from_bits(bits: u16) -> Result<FrameFlags, DeltaError> {
        if bits & !(LAST | REPLACE_ALL | HALF) != 0 {
            return Err(DeltaError::Flags(bits));
        }
        Ok(FrameFlags { last: bits & LAST != 0, replace_all: bits & REPLACE_ALL != 0, half: bits & HALF != 0 })
    }

    pub(super) fn value_bytes(self) -> usize {
        if self.half { 6 } else { 12 }
    }
}

/// Nearest `f16`; what is finite stays finite.
pub(super) fn to_half(x: f32) -> f16 {
    if x.is_finite() { f16::from_f32(x.clamp(f16::MIN.to_f32(), f16::MAX.to_f32())) } else { f16::from_f32(x) }
}

/// What the formats begin with: the table above, whose two counts each format has for its own.
pub(super) struct Header {
    pub(super) magic: [u8; 4],
    pub(super) flags: FrameFlags,
    pub(super) base: u64,
    pub(super) new: u64,
    pub(super) counts: [usize; 2],
}

impl Header {
    /// A frame of `size` bytes, header included, whose payload is what `write` appends.
    pub(super) fn seal(&self, size: usize, write: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(size);
        bytes.extend_from_slice(&self.magic);
        bytes.extend_from_slice(&FORMAT_VERSION.to_le_bytes());
        bytes.extend_from_slice(&self.flags.bits().to_le_bytes());
        bytes.extend_from_slice(&self.base.to_le_bytes());
        bytes.extend_from_slice(&self.new.to_le_bytes());
        for count in [self.counts[0], self.counts[1], size - HEADER_BYTES, 0] {
            bytes.extend_from_slice(&(count as u32).to_le_bytes());
        }
        write(&mut bytes);
        debug_assert_eq!(bytes.len(), size);
        let checksum = crc32fast::hash(&bytes[HEADER_BYTES..]);
        bytes[HEADER_BYTES - 4..HEADER_BYTES].copy_from_slice(&checksum.to_le_bytes());
        bytes
    }

    /// The header at the beginning of `bytes` and the payload behind it, which is whole. `check` has a say before the
    /// payload is waited for.
    pub(super) fn open(
        magic: [u8; 4],
        bytes: &[u8],
        check: impl FnOnce(&Header, usize) -> Result<(), DeltaError>,
    ) -> Result<(Header, &[u8]), DeltaError> {
        let known = bytes.len().min(magic.len());
        if bytes[..known] != magic[..known] {
            return Err(if magic == MAGIC {
                DeltaError::Magic
            } else {
                DeltaError::Malformed("it does not begin with RBKT")
            });
        }
        let Some((header, rest)) = bytes.split_first_chunk::<HEADER_BYTES>() else {
            return Err(DeltaError::Incomplete { needed: HEADER_BYTES });
        };
        let version = u16::from_le_bytes([header[4], header[5]]);
        if version != FORMAT_VERSION {
            return Err(DeltaError::Version(version));
        }
        let flags = FrameFlags::from_bits(u16::from_le_bytes([header[6], header[7]]))?;
        let counts = [u32_at(header, 24) as usize, u32_at(header, 28) as usize];
        let payload_bytes = u32_at(header, 32) as usize;
        let found = Header { magic, flags, base: u64_at(header, 8), new: u64_at(header, 16), counts };
        check(&found, payload_bytes)?;
        let Some(payload) = rest.get(..payload_bytes) else {
            return Err(DeltaError::Incomplete { needed: HEADER_BYTES.saturating_add(payload_bytes) });
        };
        let (checksum, expected) = (crc32fast::hash(payload), u32_at(header, 36));
        if checksum != expected {
            return Err(DeltaError::Checksum { expected, found: checksum });
        }
        Ok((found, payload))
    }
}

impl Frame {
    /// Size of [`Frame::encode`].
    pub fn encoded_bytes(&self) -> usize {
        HEADER_BYTES + self.runs.len() * RUN_BYTES + self.values.len() * self.flags.value_bytes()
    }

    /// The frame as bytes. The frame has to be valid ([`Frame::validate`]), as every frame made here is.
    pub fn encode(&self) -> Vec<u8> {
        debug_assert_eq!(self.validate(), Ok(()));
        let counts = [self.runs.len(), self.values.len()];
        let header = Header { magic: MAGIC, flags: self.flags, base: self.base, new: self.new, counts };
        header.seal(self.encoded_bytes(), |bytes| {
            for run in &self.runs {
                bytes.extend_from_slice(&run.first.to_le_bytes());
                bytes.extend_from_slice(&run.count.to_le_bytes());
            }
            write_values(&self.values, self.flags.half, bytes);
        })
    }

    /// Reads one frame from the beginning of `bytes`; also tells how many bytes it took. Nothing is allocated before
    /// all bytes of the frame are there and their checksum matches.
    pub fn decode(bytes: &[u8]) -> Result<(Frame, usize), DeltaError> {
        let (header, payload) = Header::open(MAGIC, bytes, |header, payload_bytes| {
            let ([runs, values], flags) = (header.counts, header.flags);
            if values > MAX_ELEMENTS {
                return Err(DeltaError::TooLong { end: values as u64, limit: MAX_ELEMENTS });
            }
            if runs > values {
                return Err(DeltaError::Malformed("there are more runs than values"));
            }
            // At most MAX_ELEMENTS × (8 + 12): no overflow on 64 bits, and checked on 32.
            let sum = runs.checked_mul(RUN_BYTES).zip(values.checked_mul(flags.value_bytes()));
            match sum.and_then(|(a, b)| a.checked_add(b)) == Some(payload_bytes) {
                true => Ok(()),
                false => Err(DeltaError::Malformed("the counts do not add up to the payload's size")),
            }
        })?;
        let (runs, values) = payload.split_at(header.counts[0] * RUN_BYTES);
        let run = |run: &[u8]| Run { first: u32_at(run, 0), count: u32_at(run, 4) };
        let frame = Frame {
            flags: header.flags,
            base: header.base,
            new: header.new,
            runs: runs.chunks_exact(RUN_BYTES).map(run).collect(),
            values: read_values(values, header.flags.half),
        };
        frame.validate()?;
        Ok((frame, HEADER_BYTES + payload.len()))
    }
}

/// Three floats per value.
pub(super) fn write_values(values: &[Vec3], half: bool, bytes: &mut Vec<u8>) {
    for value in values {
        for x in value.to_array() {
            if half {
                bytes.extend_from_slice(&to_half(x).to_le_bytes());
            } else {
                bytes.extend_from_slice(&x.to_le_bytes());
            }
        }
    }
}

/// What [`write_values`] wrote.
pub(super) fn read_values(bytes: &[u8], half: bool) -> Vec<Vec3> {
    let flags = FrameFlags { half, ..FrameFlags::default() };
    bytes.chunks_exact(flags.value_bytes()).map(|value| read_value(value, flags)).collect()
}

fn read_value(bytes: &[u8], flags: FrameFlags) -> Vec3 {
    let channel = |i: usize| {
        if flags.half {
            f16::from_le_bytes([bytes[2 * i], bytes[2 * i + 1]]).to_f32()
        } else {
            f32::from_bits(u32_at(bytes, 4 * i))
        }
    };
    Vec3::new(channel(0), channel(1), channel(2))
}

pub(super) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from(u32_at(bytes, at)) | u64::from(u32_at(bytes, at + 4)) << 32
}
