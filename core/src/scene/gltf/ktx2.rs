//! Pictures in KTX2 files, as `KHR_texture_basisu` has them: ETC1S and UASTC by Basis Universal.

use std::panic::{AssertUnwindSafe, catch_unwind};

use ::ktx2::{Header, LevelIndex, SupercompressionScheme};
use basisu::{DecodeFlags, TargetFormat, Transcoder};

use super::{LoadError, malformed};

/// Bytes of one block of 4 × 4 texels in UASTC.
const BLOCK_BYTES: u64 = 16;
/// Mip levels that are halved from a texture of at most 2³² texels a side.
const MAX_LEVELS: u32 = 32;

/// Whether these are the first bytes of a KTX2 file.
pub(super) fn is_ktx2(bytes: &[u8]) -> bool {
    bytes.starts_with(&::ktx2::MAGIC)
}

/// Width and height of a picture, by its header. Nothing is decoded, and nothing is allocated that the file does not hold.
///
/// # Errors
/// [`LoadError::Malformed`]: no KTX2 file, or one that `KHR_texture_basisu` does not allow.
pub(super) fn size_of(bytes: &[u8], place: &str) -> Result<(u32, u32), LoadError> {
    let broken = |text: &str| malformed(place, &format!("cannot be decoded: {text}"));
    // Not by the library's reader: what it reads beside this is the decoder's to judge.
    let cut = || broken("it ends within its header");
    let (header, rest) = bytes.split_first_chunk::<{ Header::LENGTH }>().ok_or_else(cut)?;
    let (first, _) = rest.split_first_chunk::<{ LevelIndex::LENGTH }>().ok_or_else(cut)?;
    let (header, first) = (Header::from_bytes(header), LevelIndex::from_bytes(first));
    let header = header.map_err(|error| broken(&error.to_string()))?;
    if !is_plain(&header) {
        return Err(broken("it is no plain two-dimensional KTX2 texture"));
    }
    let (width, height) = (header.pixel_width, header.pixel_height);
    // The decoder takes a compressed level at its word.
    let most = BLOCK_BYTES * u64::from(width.div_ceil(4)) * u64::from(height.div_ceil(4));
    let is_compressed = header.supercompression_scheme == Some(SupercompressionScheme::Zstandard);
    if is_compressed && first.uncompressed_byte_length != most {
        return Err(broken("its first level is not of the size that its header tells"));
    }
    Ok((width, height))
}

/// One picture: no array, no cube, no volume.
fn is_plain(header: &Header) -> bool {
    let is_flat = header.pixel_width > 0 && header.pixel_height > 0 && header.pixel_depth == 0;
    is_flat && header.layer_count <= 1 && header.face_count == 1 && header.level_count <= MAX_LEVELS
}

/// The texels of the largest level, four bytes each (RGBA, as stored), rows from the top. `bytes` has a size that
/// [`size_of`] tells.
///
/// # Errors
/// [`LoadError::Malformed`]: data that cannot be decoded.
pub(super) fn decode(bytes: &[u8], place: &str) -> Result<Vec<u8>, LoadError> {
    let broken = |text: String| malformed(place, &format!("cannot be decoded: {text}"));
    // A young decoder: what it does not expect is an error of the file, not the end of the thread.
    let texels = catch_unwind(AssertUnwindSafe(|| {
        Transcoder::new(bytes)?.transcode(0, TargetFormat::Rgba32, DecodeFlags::NONE)
    }));
    match texels {
        Ok(Ok(texels)) => Ok(texels),
        Ok(Err(error)) => Err(broken(format!("{error:?}"))),
        Err(_) => Err(broken("its data are not as its header tells".to_owned())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 18 × 10 texels, the eight columns on the left black, the others (255, 0, 0, 102); with mip levels.
    const FILES: [&[u8]; 3] = [
        include_bytes!("tests/ktx2/etc1s.ktx2"),
        include_bytes!("tests/ktx2/uastc.ktx2"),
        include_bytes!("tests/ktx2/zstd.ktx2"),
    ];

    fn read(bytes: &[u8]) -> Result<Vec<u8>, LoadError> {
        size_of(bytes, "image 0")?;
        decode(bytes, "image 0")
    }

    #[test]
    fn texels_are_those_that_were_written() {
        for file in FILES {
            assert_eq!(size_of(file, "image 0").unwrap(), (18, 10));
            let texels = read(file).unwrap();
            assert_eq!(texels.len(), 18 * 10 * 4);
            for (index, texel) in texels.chunks(4).enumerate() {
                let expected = if index % 18 < 8 { [0, 0, 0, 255] } else { [255, 0, 0, 102] };
                // ETC1S keeps five bits of alpha.
                let off = texel.iter().zip(expected).map(|(is, was)| is.abs_diff(was)).max().unwrap();
                assert!(off <= 4, "{index}: {texel:?}");
            }
        }
    }

    #[test]
    fn damaged_files_are_errors_or_pictures_of_the_stated_size() {
        let fine = |bytes: &[u8]| {
            let Ok((width, height)) = size_of(bytes, "image 0") else { return };
            if u64::from(width) * u64::from(height) > 1 << 16 {
                return;
            }
            match decode(bytes, "image 0") {
                Ok(texels) => assert_eq!(texels.len(), (width * height * 4) as usize),
                Err(error) => assert!(error.to_string().starts_with("image 0"), "{error}"),
            }
        };
        for file in FILES {
            (0..file.len()).for_each(|end| fine(&file[..end]));
            for at in 0..file.len() {
                for bits in [0x01, 0x80, 0xff] {
                    let mut damaged = file.to_vec();
                    damaged[at] ^= bits;
                    fine(&damaged);
                }
            }
        }
    }

    #[test]
    fn what_a_header_claims_is_not_allocated() {
        // The size of level 0 once decompressed.
        let mut claims = FILES[2].to_vec();
        claims[96..104].copy_from_slice(&(1_u64 << 40).to_le_bytes());
        let refused = size_of(&claims, "image 0").unwrap_err();
        assert!(refused.to_string().contains("first level"), "{refused}");
        // Six faces are a cube, two layers an array.
        for (field, count) in [(36, 6), (32, 2)] {
            let mut several = FILES[0].to_vec();
            several[field] = count;
            assert!(size_of(&several, "image 0").is_err(), "{field}");
        }
    }
}
