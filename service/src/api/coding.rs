//! Compressed answers. Every piece is flushed as it is written: a follower must not wait for the next one.

use std::io::{self, Write};

use axum::http::{HeaderMap, HeaderValue, header};
use bytes::Bytes;
use flate2::write::GzEncoder;
use zstd::stream::write::Encoder;

use super::extract::Coding;

/// Light maps are floats of limited entropy: more effort gains a few per cent at several times the cost.
const LEVEL: i32 = 1;

impl Coding {
    /// `Content-Encoding`, where there is one.
    pub(crate) fn headers(self) -> HeaderMap {
        let mut headers = HeaderMap::new();
        if let Some(value) = self.header_value() {
            headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static(value));
        }
        headers
    }
}

/// Compresses one answer, piece by piece.
pub(super) enum Coder {
    Identity,
    Gzip(GzEncoder<Vec<u8>>),
    Zstd(Box<Encoder<'static, Vec<u8>>>),
}

impl Coder {
    pub(super) fn new(coding: Coding) -> io::Result<Coder> {
        Ok(match coding {
            Coding::Identity => Coder::Identity,
            Coding::Gzip => Coder::Gzip(GzEncoder::new(Vec::new(), flate2::Compression::new(LEVEL as u32))),
            Coding::Zstd => Coder::Zstd(Box::new(Encoder::new(Vec::new(), LEVEL)?)),
        })
    }

    /// Everything that the client needs to see `piece`.
    pub(super) fn push(&mut self, piece: impl Into<Bytes>) -> io::Result<Bytes> {
        let piece = piece.into();
        match self {
            Coder::Identity => Ok(piece),
            Coder::Gzip(encoder) => {
                encoder.write_all(&piece)?;
                encoder.flush()?;
                Ok(std::mem::take(encoder.get_mut()).into())
            }
            Coder::Zstd(encoder) => {
                encoder.write_all(&piece)?;
                encoder.flush()?;
                Ok(std::mem::take(encoder.get_mut()).into())
            }
        }
    }

    /// What ends the answer.
    pub(super) fn finish(self) -> io::Result<Bytes> {
        match self {
            Coder::Identity => Ok(Bytes::new()),
            Coder::Gzip(encoder) => Ok(encoder.finish()?.into()),
            Coder::Zstd(encoder) => Ok(encoder.finish()?.into()),
        }
    }
}

/// A whole body in one piece.
pub(crate) fn encode_body(coding: Coding, body: impl Into<Bytes>) -> io::Result<Bytes> {
    let mut coder = Coder::new(coding)?;
    let head = coder.push(body)?;
    let tail = coder.finish()?;
    Ok(if tail.is_empty() { head } else { [head, tail].concat().into() })
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    #[test]
    fn every_piece_can_be_read_before_the_next() {
        let pieces = [vec![1u8; 1000], vec![2; 10], vec![3; 100_000]];
        let mut gzip = Coder::new(Coding::Gzip).unwrap();
        let mut zstd = Coder::new(Coding::Zstd).unwrap();
        let (mut gzipped, mut zstded, mut plain) = (Vec::new(), Vec::new(), Vec::new());
        for piece in pieces {
            gzipped.extend(gzip.push(piece.clone()).unwrap());
            zstded.extend(zstd.push(piece.clone()).unwrap());
            plain.extend(piece);
            let mut seen = vec![0; plain.len()];
            flate2::read::GzDecoder::new(&gzipped[..]).read_exact(&mut seen).unwrap();
            assert!(seen == plain);
            zstd::stream::read::Decoder::new(&zstded[..]).unwrap().read_exact(&mut seen).unwrap();
            assert!(seen == plain);
        }
        zstded.extend(zstd.finish().unwrap());
        assert!(zstd::decode_all(&zstded[..]).unwrap() == plain);
    }
}
