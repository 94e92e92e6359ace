//! KTX2: pages of atlases as textures that engines load as they are.

use std::borrow::Borrow;

use ::ktx2::dfd::{Basic, Block};
use ::ktx2::{Format, Header, Index, LevelIndex};

use super::ExportError;
use super::exr::{MAX_SIDE, Precision, first_of, to_half};
use crate::texels::TexelPage;

/// Keys that the format keeps for itself begin so.
const RESERVED: [&str; 2] = ["KTX", "ktx"];

/// Writes several readings of the same page of an atlas as one KTX2 texture (Khronos, KTX 2.0): linear RGBA of 16- or
/// 32-bit float without compression or mip levels, rows from the top. Alpha is 1 where a texel of the first reading was
/// read from a surface, 0 where it is filled or empty. One reading is a plain texture; several are the layers of an array,
/// in order, and the key `rebake.layers` has their names, between commas. `attributes` are keys and texts that are stored
/// with it. The same input gives the same bytes.
///
/// # Errors
/// [`ExportError`]: no pages, no texels, pages that differ in size, keys that are not possible or given twice.
pub fn write_pages_ktx2(
    pages: &[(&str, impl Borrow<TexelPage>)],
    precision: Precision,
    attributes: &[(&str, &str)],
) -> Result<Vec<u8>, ExportError> {
    let first = first_of(pages)?;
    let (width, height) = (first.width, first.height);
    if width.max(height) > MAX_SIDE {
        return Err(ExportError::TooLarge);
    }
    let names: Vec<&str> = pages.iter().map(|(name, _)| *name).collect();
    let names = names.join(",");
    let own = (pages.len() > 1).then_some(("rebake.layers", names.as_str()));
    let texts = key_values(&attributes.iter().copied().chain(own).collect::<Vec<_>>())?;
    let (format, texel_bytes) = match precision {
        Precision::Half => (Format::R16G16B16A16_SFLOAT, 8),
        Precision::Float => (Format::R32G32B32A32_SFLOAT, 16),
    };
    let layers = if pages.len() > 1 { pages.len() as u32 } else { 0 };
    let bytes = pages.len() * width * height * texel_bytes;
    let mut file = head((width, height, layers), format, &texts, (bytes, texel_bytes))?;
    file.reserve_exact(bytes);
    for (_, page) in pages {
        write_texels(page.borrow(), &first.valid, precision, &mut file);
    }
    Ok(file)
}

fn write_texels(page: &TexelPage, valid: &[bool], precision: Precision, file: &mut Vec<u8>) {
    for (value, &valid) in page.values.iter().zip(valid) {
        for number in value.extend(if valid { 1.0 } else { 0.0 }).to_array() {
            match precision {
                Precision::Half => file.extend(to_half(number).to_le_bytes()),
                Precision::Float => file.extend(number.to_le_bytes()),
            }
        }
    }
}

/// All that comes before the texels, of which there are so many bytes, and so many each.
fn head(
    (width, height, layers): (usize, usize, u32),
    format: Format,
    texts: &[u8],
    (bytes, texel_bytes): (usize, usize),
) -> Result<Vec<u8>, ExportError> {
    let (descriptor, type_size) = Basic::from_format(format).map_err(|_| ExportError::TooLarge)?;
    let descriptor = Block::Basic(descriptor).to_vec();
    let at = Header::LENGTH + LevelIndex::LENGTH;
    let length = |bytes: usize| u32::try_from(bytes).map_err(|_| ExportError::TooLarge);
    let index = Index {
        dfd_byte_offset: length(at)?,
        dfd_byte_length: length(4 + descriptor.len())?,
        kvd_byte_offset: length(at + 4 + descriptor.len())?,
        kvd_byte_length: length(texts.len())?,
        sgd_byte_offset: 0,
        sgd_byte_length: 0,
    };
    let texels_at = (at + 4 + descriptor.len() + texts.len()).next_multiple_of(texel_bytes);
    let header = Header {
        format: Some(format),
        type_size,
        pixel_width: width as u32,
        pixel_height: height as u32,
        pixel_depth: 0,
        layer_count: layers,
        face_count: 1,
        level_count: 1,
        supercompression_scheme: None,
        index,
    };
    let level =
        LevelIndex { byte_offset: texels_at as u64, byte_length: bytes as u64, uncompressed_byte_length: bytes as u64 };
    let mut file = Vec::with_capacity(texels_at);
    file.extend(header.as_bytes());
    file.extend(level.as_bytes());
    file.extend(index.dfd_byte_length.to_le_bytes());
    file.extend(descriptor);
    file.extend(texts);
    file.resize(texels_at, 0);
    Ok(file)
}

/// Keys with their texts as the format has them: sorted by key, each with its length before it, padded to four bytes.
fn key_values(attributes: &[(&str, &str)]) -> Result<Vec<u8>, ExportError> {
    let is_possible = |key: &str| {
        !key.is_empty() && !key.contains('\0') && !RESERVED.iter().any(|reserved| key.starts_with(reserved))
    };
    if let Some((key, _)) = attributes.iter().find(|(key, text)| !is_possible(key) || text.contains('\0')) {
        return Err(ExportError::Name((*key).to_owned()));
    }
    let mut all = attributes.to_vec();
    all.extend([("KTXorientation", "rd"), ("KTXwriter", "rebake")]);
    all.sort_unstable();
    if let Some(twice) = all.windows(2).find(|two| two[0].0 == two[1].0) {
        return Err(ExportError::Name(twice[0].0.to_owned()));
    }
    let mut bytes = Vec::new();
    for (key, text) in all {
        let length = u32::try_from(key.len() + text.len() + 2).map_err(|_| ExportError::TooLarge)?;
        bytes.extend(length.to_le_bytes());
        bytes.extend([key.as_bytes(), b"\0", text.as_bytes(), b"\0"].concat());
        bytes.resize(bytes.len().next_multiple_of(4), 0);
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use ::ktx2::{Reader, TransferFunction};
    use glam::Vec3;
    use half::f16;

    use super::*;

    /// Three texels in a row, the last one filled.
    fn page(scale: f32) -> TexelPage {
        let values = [Vec3::new(0.25, 1.0, 3.0), Vec3::new(1e6, 0.0, 0.5), Vec3::ONE].map(|value| value * scale);
        TexelPage { width: 3, height: 1, values: values.to_vec(), valid: vec![true, true, false] }
    }

    #[test]
    fn pages_are_read_as_they_were_written() {
        let about = [("lightMapVersion", "7"), ("unit", "irradiance / π")];
        for precision in [Precision::Half, Precision::Float] {
            let file = write_pages_ktx2(&[("", page(1.0))], precision, &about).unwrap();
            let reader = Reader::new(&file[..]).unwrap();
            let header = reader.header();
            assert_eq!((header.pixel_width, header.pixel_height, header.layer_count), (3, 1, 0));
            assert_eq!(reader.transfer_function(), Some(TransferFunction::Linear));
            let texts: Vec<_> = reader.key_value_data().collect();
            let expected: [(&str, &[u8]); 4] = [
                ("KTXorientation", b"rd\0"),
                ("KTXwriter", b"rebake\0"),
                ("lightMapVersion", b"7\0"),
                ("unit", "irradiance / π\0".as_bytes()),
            ];
            assert_eq!(texts, expected);
            let level = reader.levels().next().unwrap();
            let numbers: Vec<f32> = match precision {
                Precision::Half => {
                    level.data.chunks(2).map(|two| f16::from_le_bytes([two[0], two[1]]).to_f32()).collect()
                }
                Precision::Float => {
                    level.data.chunks(4).map(|four| f32::from_le_bytes(four.try_into().unwrap())).collect()
                }
            };
            // The largest half is in place of what is above it.
            let bright = if precision == Precision::Half { 65504.0 } else { 1e6 };
            assert_eq!(numbers, [0.25, 1.0, 3.0, 1.0, bright, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 0.0]);
        }
    }

    #[test]
    fn several_readings_are_layers_of_an_array() {
        let pages = [("L0", page(1.0)), ("L1x", page(0.5))];
        let file = write_pages_ktx2(&pages, Precision::Float, &[]).unwrap();
        let reader = Reader::new(&file[..]).unwrap();
        assert_eq!(reader.header().layer_count, 2);
        assert!(reader.key_value_data().any(|(key, text)| (key, text) == ("rebake.layers", b"L0,L1x\0")));
        let level = reader.levels().next().unwrap();
        assert_eq!(level.data.len(), 2 * 3 * 16);
        assert_eq!(level.data[48..52], 0.125_f32.to_le_bytes());
    }

    #[test]
    fn what_cannot_be_written_is_an_error() {
        let name = |key: &str| Err(ExportError::Name(key.to_owned()));
        for key in ["KTXwriter", "", "a\0b"] {
            assert_eq!(write_pages_ktx2(&[("", page(1.0))], Precision::Half, &[(key, "x")]), name(key));
        }
        assert_eq!(write_pages_ktx2(&[("", page(1.0))], Precision::Half, &[("a", "1"), ("a", "2")]), name("a"));
        let none: [(&str, TexelPage); 0] = [];
        assert!(write_pages_ktx2(&none, Precision::Half, &[]).is_err());
        let short = TexelPage { width: 4, ..page(1.0) };
        assert!(write_pages_ktx2(&[("", short)], Precision::Half, &[]).is_err());
    }
}
