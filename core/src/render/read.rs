//! Pictures and light maps read back from files.

use std::io::Cursor;

use exr::meta::attribute::{AttributeValue, Text};
use exr::prelude::{ReadChannels, ReadLayers, read};
use glam::Vec3;

use super::Picture;

/// Most pixels that are read: what a file claims is not allocated blindly.
const MAX_PIXELS: usize = 1 << 28;

/// A file's values.
#[derive(Clone, Debug, PartialEq)]
pub struct Loaded {
    /// Linear RGB.
    pub picture: Picture,
    /// A light map has this many elements, one pixel each, and no picture to look at.
    pub elements: Option<usize>,
}

/// Reads a PNG or an OpenEXR file with the channels R, G and B.
///
/// # Errors
/// What is wrong with it, in words for a person.
pub fn read_picture(bytes: &[u8]) -> Result<Loaded, String> {
    if bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01]) { read_exr(bytes) } else { read_png(bytes) }
}

fn read_png(bytes: &[u8]) -> Result<Loaded, String> {
    let picture = image::load_from_memory(bytes).map_err(|error| error.to_string())?.into_rgb8();
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let linear = |c: u8| {
        let c = f32::from(c) / 255.0;
        if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    };
    let pixels = picture.pixels().map(|p| Vec3::from(p.0.map(linear))).collect();
    Ok(Loaded { picture: Picture { width, height, pixels }, elements: None })
}

fn read_exr(bytes: &[u8]) -> Result<Loaded, String> {
    let size_of = |(width, height): (usize, usize)| width * height <= MAX_PIXELS;
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |size, _| {
                let count = if size_of((size.0, size.1)) { size.0 * size.1 } else { 0 };
                Picture { width: size.0, height: size.1, pixels: vec![Vec3::ZERO; count] }
            },
            |picture: &mut Picture, at, (r, g, b): (f32, f32, f32)| {
                if let Some(pixel) = picture.pixels.get_mut(at.1 * picture.width + at.0) {
                    *pixel = Vec3::new(r, g, b);
                }
            },
        )
        .first_valid_layer()
        .all_attributes()
        .from_buffered(Cursor::new(bytes))
        .map_err(|error| error.to_string())?;
    let mut picture = image.layer_data.channel_data.pixels;
    if picture.pixels.len() != picture.width * picture.height {
        return Err(format!("it has more than {MAX_PIXELS} pixels"));
    }
    let name = Text::from("elements");
    let elements = match image.layer_data.attributes.other.get(&name) {
        Some(AttributeValue::I32(count)) => usize::try_from(*count).ok().filter(|n| *n <= picture.pixels.len()),
        _ => None,
    };
    if let Some(count) = elements {
        // The last row is padded: padding is no element.
        picture.pixels.truncate(count);
        (picture.width, picture.height) = (count, 1);
    }
    Ok(Loaded { picture, elements })
}
