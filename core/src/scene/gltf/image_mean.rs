//! Mean colour of a texture: diffuse light over a surface hardly depends on more.

use std::collections::BTreeMap;
use std::io::Cursor;

use ::gltf::json;
use glam::Vec3;
use image::{ImageDecoder, ImageFormat, ImageReader};

use super::accessor::view_bytes;
use super::container::File;
use super::warnings::Warnings;
use super::{LoadError, LoadLimits, malformed};

/// Memory that a decoder may use beside the picture, bytes.
const DECODER_BYTES: u64 = 64 << 20;

/// Means of the images of a file, each computed once.
#[derive(Debug)]
pub(super) struct TextureMeans<'f> {
    file: &'f File<'f>,
    max_pixels: u64,
    total_pixels_left: u64,
    /// None: the image lies outside the file.
    known: BTreeMap<usize, Option<Vec3>>,
}

impl<'f> TextureMeans<'f> {
    pub(super) fn new(file: &'f File<'f>, limits: &LoadLimits) -> Self {
        Self {
            file,
            max_pixels: limits.max_texture_pixels,
            total_pixels_left: limits.max_total_texture_pixels,
            known: BTreeMap::new(),
        }
    }

    /// Mean of the sRGB texture in linear RGB, each part within 0 and 1.
    pub(super) fn mean(
        &mut self,
        texture: &json::texture::Info,
        place: &str,
        kind: &str,
        warnings: &mut Warnings,
    ) -> Result<Vec3, LoadError> {
        let image = self.file.root.get(texture.index).map(|texture| texture.source.value());
        let image = image.ok_or_else(|| malformed(place, "its texture does not exist"))?;
        let mean = match self.known.get(&image) {
            Some(&known) => known,
            None => {
                let mean = self.read(image)?;
                self.known.insert(image, mean);
                mean
            }
        };
        let remark = match mean {
            Some(_) => format!("{kind} textures count with their mean colour"),
            None => format!("{kind} textures outside the file are ignored"),
        };
        warnings.add(remark, place);
        Ok(mean.unwrap_or(Vec3::ONE))
    }

    fn read(&mut self, index: usize) -> Result<Option<Vec3>, LoadError> {
        let place = format!("image {index}");
        let image = self.file.root.images.get(index).ok_or_else(|| malformed(&place, "does not exist"))?;
        let Some(view) = image.buffer_view else { return Ok(None) };
        let bytes = view_bytes(self.file, view, &place)?;
        // By its first bytes: the stated type is often wrong.
        let format = match image::guess_format(bytes) {
            Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) => format,
            _ => return Err(LoadError::Unsupported(format!("{place}: is neither PNG nor JPEG"))),
        };
        let broken = |error: image::ImageError| malformed(&place, &format!("cannot be decoded: {error}"));
        let mut decoder = ImageReader::with_format(Cursor::new(bytes), format).into_decoder().map_err(broken)?;
        let (width, height) = decoder.dimensions();
        let pixels = u64::from(width) * u64::from(height);
        if pixels > self.max_pixels || pixels > self.total_pixels_left {
            return Err(LoadError::TooLarge(format!(
                "{place}: has {width} x {height} pixels, at most {} are allowed, and {} in all textures that are left",
                self.max_pixels, self.total_pixels_left
            )));
        }
        self.total_pixels_left -= pixels;
        let mut limits = image::Limits::default();
        limits.max_alloc = Some(decoder.total_bytes().saturating_add(DECODER_BYTES));
        decoder.set_limits(limits).map_err(broken)?;
        let picture = image::DynamicImage::from_decoder(decoder).map_err(broken)?.into_rgb8();
        Ok(Some(mean_linear(picture.as_raw())))
    }
}

/// Of interleaved 8-bit sRGB. Over a histogram: exact, and independent of the order of the pixels.
fn mean_linear(rgb: &[u8]) -> Vec3 {
    let mut counts = [[0_u64; 256]; 3];
    let (pixels, _) = rgb.as_chunks::<3>();
    for pixel in pixels {
        for (count, &value) in counts.iter_mut().zip(pixel) {
            count[value as usize] += 1;
        }
    }
    let mean = |count: &[u64; 256]| {
        let sum: f64 =
            count.iter().enumerate().map(|(value, &n)| n as f64 * linear_from_srgb(value as f64 / 255.0)).sum();
        (sum / pixels.len().max(1) as f64) as f32
    };
    Vec3::from_array([mean(&counts[0]), mean(&counts[1]), mean(&counts[2])]).clamp(Vec3::ZERO, Vec3::ONE)
}

/// IEC 61966-2-1.
fn linear_from_srgb(value: f64) -> f64 {
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::super::{load_glb, tests};
    use super::*;

    #[test]
    fn mean_is_taken_of_light_not_of_codes() {
        // Black and white: half the light, though code 128 is a fifth of it.
        assert!((mean_linear(&[0, 0, 0, 255, 255, 255]) - Vec3::splat(0.5)).abs().max_element() < 1e-6);
        let grey = mean_linear(&[188, 188, 188]).x;
        assert!((grey - 0.5029).abs() < 1e-3, "{grey}");
    }

    /// The square with two pixels, black and red, as its base colour and emissive texture.
    fn textured(image: &[u8]) -> Vec<u8> {
        let mut bin = tests::square_data();
        bin.extend(image);
        bin.resize(bin.len().next_multiple_of(4), 0);
        let texture =
            "\"emissiveTexture\": {\"index\": 0}, \"pbrMetallicRoughness\": {\"baseColorTexture\": {\"index\": 0}, ";
        let images = "\"textures\": [{\"source\": 0}], \"images\": [{\"bufferView\": 5, \"mimeType\": \"image/png\"}], \"meshes\"";
        let view =
            format!("\"byteLength\": 16}}, {{\"buffer\": 0, \"byteOffset\": 128, \"byteLength\": {}}}", image.len());
        let json = tests::SQUARE
            .replace("\"pbrMetallicRoughness\": {", texture)
            .replace("\"meshes\"", images)
            .replace("\"byteLength\": 16}", &view)
            .replace("[{\"byteLength\": 128}]", &format!("[{{\"byteLength\": {}}}]", bin.len()));
        tests::glb(&json, &bin)
    }

    fn encoded(format: ImageFormat) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        let picture = image::RgbImage::from_fn(16, 8, |x, _| image::Rgb(if x < 8 { [0, 0, 0] } else { [255, 0, 0] }));
        picture.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn embedded_textures_count_with_their_mean() {
        for (format, tolerance) in [(ImageFormat::Png, 1e-6), (ImageFormat::Jpeg, 0.02)] {
            let scene = load_glb(&textured(&encoded(format)), &LoadLimits::default()).unwrap();
            let paint = scene.objects[0].materials[0];
            assert!(paint.albedo.distance(Vec3::new(0.25, 0.0, 0.0)) < tolerance, "{paint:?}");
            assert!(paint.emission.distance(Vec3::new(1.5, 0.0, 0.0)) < 3.0 * tolerance, "{paint:?}");
            assert_eq!(scene.lights[0].strength(), paint.emission);
            assert!(scene.warnings.iter().any(|text| text.contains("mean colour")), "{:?}", scene.warnings);
        }
    }

    #[test]
    fn broken_and_large_textures_are_refused() {
        let png = encoded(ImageFormat::Png);
        let load = |image: &[u8], limits| load_glb(&textured(image), &limits).map(|_| ());
        let limits = LoadLimits::default();
        assert!(matches!(load(&png[..png.len() / 2], limits.clone()), Err(LoadError::Malformed(_))));
        assert!(matches!(load(b"RIFFxxxxWEBPVP8 ", limits.clone()), Err(LoadError::Unsupported(_))));
        assert!(matches!(load(b"", limits.clone()), Err(LoadError::Unsupported(_))));
        let small = LoadLimits { max_texture_pixels: 127, ..limits.clone() };
        assert!(matches!(load(&png, small), Err(LoadError::TooLarge(_))));
        let few = LoadLimits { max_total_texture_pixels: 127, ..limits };
        assert!(matches!(load(&png, few), Err(LoadError::TooLarge(_))));
    }
}
