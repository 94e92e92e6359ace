//! PNG: 8-bit sRGB pictures.

use super::ExportError;

/// The sRGB transfer function (IEC 61966-2-1).
pub fn srgb_from_linear(c: f32) -> f32 {
    if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
}

/// Writes 8-bit RGB as PNG.
///
/// # Errors
/// [`ExportError`] where the bytes are not `3 · width · height`, or not possible in the format.
pub fn write_png(width: usize, height: usize, rgb: &[u8]) -> Result<Vec<u8>, ExportError> {
    use image::ImageEncoder;
    let mut file = Vec::new();
    let side = |n: usize| u32::try_from(n).map_err(|_| ExportError::TooLarge);
    if width == 0 || height == 0 || rgb.len() != 3 * width * height {
        return Err(ExportError::Lists("the picture".to_owned()));
    }
    use image::codecs::png::{CompressionType, FilterType, PngEncoder};
    PngEncoder::new_with_quality(&mut file, CompressionType::Default, FilterType::Adaptive)
        .write_image(rgb, side(width)?, side(height)?, image::ExtendedColorType::Rgb8)
        .map_err(|error| ExportError::Png(error.to_string()))?;
    Ok(file)
}
