//! Reads pictures of the sky: OpenEXR and Radiance.

use std::io::Cursor;

use ::exr::meta::MetaData;
use ::exr::prelude::{ReadChannels, ReadLayers, read};
use image::DynamicImage;
use image::ImageDecoder;
use image::codecs::hdr::HdrDecoder;

use super::SkyPicture;
use crate::scene::{LoadError, LoadLimits};

/// Pixels of a picture, at most: 8192 × 4096.
const MAX_PIXELS: u64 = 1 << 25;

/// What an OpenEXR file begins with.
const EXR: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

/// What a Radiance file begins with.
const RADIANCE: &[u8] = b"#?";

/// A picture that was read.
#[derive(Clone, Debug)]
pub struct LoadedSky {
    /// The picture.
    pub picture: SkyPicture,
    /// What is odd about it, in words for a person.
    pub warnings: Vec<String>,
}

/// Linear RGB as a file holds it, three numbers per pixel.
struct Pixels {
    width: usize,
    height: usize,
    rgb: Vec<f32>,
}

/// Whether a file begins as a picture of the sky does.
pub fn is_sky(file: &[u8]) -> bool {
    file.starts_with(&EXR) || file.starts_with(RADIANCE)
}

/// Reads an equirectangular picture of the sky, linear RGB radiance: OpenEXR with channels R, G and B (the first such
/// layer), or Radiance (`.hdr`; its exposure is taken out). Bounds are those of textures, and 8192 × 4096 pixels.
///
/// # Errors
/// [`LoadError`] where it is neither, damaged, too large, or no light.
pub fn load_sky(file: &[u8], limits: &LoadLimits) -> Result<LoadedSky, LoadError> {
    if file.len() > limits.max_bytes {
        return Err(LoadError::TooLarge(format!("the picture has more than {} bytes", limits.max_bytes)));
    }
    let most = MAX_PIXELS.min(limits.max_texture_pixels);
    let Pixels { width, height, rgb } = if file.starts_with(&EXR) {
        read_exr(file, most)?
    } else if file.starts_with(RADIANCE) {
        read_hdr(file, most)?
    } else {
        let text = "the picture is neither OpenEXR (76 2f 31 01) nor Radiance (#?RADIANCE): these are its first bytes";
        return Err(LoadError::Malformed(text.to_owned()));
    };
    let mut warnings = Vec::new();
    if width != 2 * height {
        warnings.push(format!(
            "the picture has {width} × {height} pixels: an equirectangular one is twice as wide as high"
        ));
    }
    let negative = rgb.iter().filter(|x| **x < 0.0).count();
    if negative > 0 {
        warnings.push(format!("{negative} numbers of the picture are negative: they count as 0"));
    }
    let picture =
        SkyPicture::new(width, height, &rgb).map_err(|error| LoadError::Malformed(format!("the picture: {error}")))?;
    Ok(LoadedSky { picture, warnings })
}

/// The sides of a picture, where it is not too large.
fn checked(width: usize, height: usize, most: u64) -> Result<(usize, usize), LoadError> {
    let pixels = (width as u64).saturating_mul(height as u64);
    if pixels > most {
        let text = format!("the picture has {width} × {height} pixels, more than {most}");
        return Err(LoadError::TooLarge(text));
    }
    Ok((width, height))
}

fn read_exr(file: &[u8], most: u64) -> Result<Pixels, LoadError> {
    let malformed = |error: ::exr::error::Error| LoadError::Malformed(format!("the OpenEXR picture: {error}"));
    // Sizes are those that a header says: before anything is kept.
    let about = MetaData::read_from_buffered(Cursor::new(file), false).map_err(malformed)?;
    for header in &about.headers {
        checked(header.layer_size.width(), header.layer_size.height(), most)?;
    }
    let picture = read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |size, _| Pixels {
                width: size.width(),
                height: size.height(),
                rgb: vec![0.0; 3 * size.width() * size.height()],
            },
            |pixels: &mut Pixels, at, (r, g, b): (f32, f32, f32)| {
                let first = 3 * (at.y() * pixels.width + at.x());
                pixels.rgb[first..first + 3].copy_from_slice(&[r, g, b]);
            },
        )
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(file))
        .map_err(malformed)?;
    Ok(picture.layer_data.channel_data.pixels)
}

fn read_hdr(file: &[u8], most: u64) -> Result<Pixels, LoadError> {
    let malformed = |error: image::ImageError| LoadError::Malformed(format!("the Radiance picture: {error}"));
    let decoder = HdrDecoder::new_nonstrict(Cursor::new(file)).map_err(malformed)?;
    let (width, height) = decoder.dimensions();
    let (width, height) = checked(width as usize, height as usize, most)?;
    let exposure = decoder.metadata().exposure.unwrap_or(1.0);
    let mut rgb = DynamicImage::from_decoder(decoder).map_err(malformed)?.into_rgb32f().into_raw();
    if exposure != 1.0 {
        if !(exposure.is_finite() && exposure > 0.0) {
            let text = format!("the Radiance picture: its exposure is {exposure}, it must be above 0");
            return Err(LoadError::Malformed(text));
        }
        rgb.iter_mut().for_each(|x| *x /= exposure);
    }
    Ok(Pixels { width, height, rgb })
}
