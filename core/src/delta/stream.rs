//! Frames out of a byte stream that arrives in pieces of any size.

use super::{DeltaError, Frame};

/// Puts the pieces of a byte stream together and hands out whole frames.
#[derive(Debug, Default)]
pub struct Decoder {
    buffer: Vec<u8>,
    /// Bytes at the front of `buffer` that are used up.
    used: usize,
    /// Size of the frame at the front, as far as is known.
    needed: usize,
}

impl Decoder {
    /// A decoder at the beginning of a stream.
    pub fn new() -> Decoder {
        Decoder::default()
    }

    /// Takes the next piece of the stream.
    pub fn push(&mut self, bytes: &[u8]) {
        if self.used > 0 {
            self.buffer.drain(..self.used);
            self.used = 0;
        }
        self.buffer.extend_from_slice(bytes);
    }

    /// The next whole frame with its size in bytes; `None` until more bytes come. After an error the stream cannot be
    /// read on.
    pub fn next_frame(&mut self) -> Result<Option<(Frame, usize)>, DeltaError> {
        let bytes = &self.buffer[self.used..];
        if bytes.is_empty() || bytes.len() < self.needed {
            return Ok(None);
        }
        match Frame::decode(bytes) {
            Ok((frame, used)) => {
                self.used += used;
                self.needed = 0;
                Ok(Some((frame, used)))
            }
            Err(DeltaError::Incomplete { needed }) => {
                self.needed = needed;
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// Bytes of a frame that has begun and is not complete.
    pub fn pending_bytes(&self) -> usize {
        self.buffer.len() - self.used
    }
}
