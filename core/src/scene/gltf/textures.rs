//! Pictures of a file, decoded one at a time and kept at the size that light needs.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::sync::Arc;

use ::gltf::json;
use glam::{Mat2, Vec2};
use image::{ImageDecoder, ImageFormat, ImageReader};
use json::texture::WrappingMode;
use json::validation::Checked;

use super::container::File;
use super::document::OtherSource;
use super::files::{Named, resolve};
use super::views::view_bytes;
use super::warnings::Warnings;
use super::{LoadError, LoadLimits, ktx2, malformed};
use crate::scene::{AlphaUse, Texture, TextureUse, Wrap};

/// Memory that a decoder may use beside the picture, bytes.
const DECODER_BYTES: u64 = 64 << 20;
/// Texels of one texture that are kept: where many are, and at most. Few enough that a file of as many pictures as
/// there may be keeps little more than it is allowed.
const KEPT_TEXELS: (usize, usize) = (1 << 6, 1 << 20);

/// What the texels of a texture are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Texels {
    /// sRGB, and what alpha means.
    Colors(AlphaUse),
    /// Numbers from 0 to 1.
    Numbers,
}

impl Texels {
    /// What is taken for a texture that is missing.
    fn stand_in(self) -> &'static str {
        match self {
            Self::Colors(_) => "mid grey stands for their colour (albedo 0.5)",
            Self::Numbers => "their factor counts all over",
        }
    }
}

/// Textures of a file, each decoded once per meaning of its texels.
#[derive(Debug)]
pub(super) struct Textures<'f> {
    file: &'f File<'f>,
    max_pixels: u64,
    total_pixels_left: u64,
    kept_texels_left: usize,
    /// Instead of every picture, where none is decoded.
    blank: Option<Arc<Texture>>,
    /// By image and what its texels are. None: not there, or in a format that is not read.
    known: BTreeMap<(usize, TexelKey), Option<Arc<Texture>>>,
}

type TexelKey = (u8, u32);

impl<'f> Textures<'f> {
    pub(super) fn new(file: &'f File<'f>, limits: &LoadLimits) -> Self {
        Self {
            file,
            max_pixels: limits.max_texture_pixels,
            total_pixels_left: limits.max_total_texture_pixels,
            kept_texels_left: limits.max_kept_texels,
            blank: None,
            known: BTreeMap::new(),
        }
    }

    /// None is decoded: a white texel stands for every picture.
    pub(super) fn undecoded(file: &'f File<'f>, limits: &LoadLimits) -> Self {
        let blank = Texture::new(1, 1, &[255; 4], AlphaUse::Ignored, 1);
        Self { blank: Some(Arc::new(blank)), ..Self::new(file, limits) }
    }

    /// A texture as a material refers to it; none, with a warning, where it cannot be had.
    pub(super) fn get(
        &mut self,
        info: &json::texture::Info,
        texels: Texels,
        kind: &str,
        place: &str,
        warnings: &mut Warnings,
    ) -> Result<Option<TextureUse>, LoadError> {
        let root = &self.file.root;
        let texture = root.get(info.index).ok_or_else(|| malformed(place, "its texture does not exist"))?;
        let image = self.image_of((info.index.value(), texture), (texels, kind), place, warnings)?;
        let Some(image) = image else { return Ok(None) };
        let key = (image, key_of(texels));
        let picture = match self.known.get(&key) {
            _ if self.blank.is_some() => self.blank.clone(),
            Some(known) => known.clone(),
            None => {
                let read = self.read(image, texels, warnings)?.map(Arc::new);
                self.known.insert(key, read.clone());
                read
            }
        };
        let Some(picture) = picture else {
            warnings.add(format!("missing {kind} textures: {}", texels.stand_in()), place);
            return Ok(None);
        };
        let transform = info.extensions.as_ref().and_then(|extensions| extensions.texture_transform.as_ref());
        let texcoord = transform.and_then(|transform| transform.tex_coord).unwrap_or(info.tex_coord);
        let (linear, offset) = transform.map_or((Mat2::IDENTITY, Vec2::ZERO), matrix_of);
        if !(linear.is_finite() && offset.is_finite()) {
            return Err(malformed(place, "a texture transform has a number that is not finite"));
        }
        let wrap = self.wrap_of(texture);
        Ok(Some(TextureUse { texture: picture, texcoord: texcoord as usize, linear, offset, wrap }))
    }

    /// The image of a texture in the best format that is read.
    fn image_of(
        &self,
        (index, texture): (usize, &json::Texture),
        (texels, kind): (Texels, &str),
        place: &str,
        warnings: &mut Warnings,
    ) -> Result<Option<usize>, LoadError> {
        let extensions = self.file.more.texture(index);
        let other = |source: &Option<OtherSource>| Some(source.as_ref()?.source?.value());
        let read = extensions.and_then(|e| other(&e.webp).or_else(|| other(&e.basisu)));
        let own = Some(texture.source.value()).filter(|image| *image != u32::MAX as usize);
        let unread = extensions.and_then(|e| {
            let all = [("EXT_texture_avif", &e.avif), ("MSFT_texture_dds", &e.dds)];
            all.into_iter().find(|(_, source)| source.is_some()).map(|(name, _)| name)
        });
        if let Some(image) = read.or(own) {
            if let Some(name) = unread.filter(|_| read.is_none()) {
                warnings.add(format!("textures in a format that is not read ({name}) show their other image"), place);
            }
            return Ok(Some(image));
        }
        let Some(name) = unread else {
            warnings.add(format!("missing {kind} textures (they have no image): {}", texels.stand_in()), place);
            return Ok(None);
        };
        if self.file.root.extensions_required.iter().any(|required| required == name) {
            let text = format!(
                "{place}: its {kind} texture needs the extension {name}, which is not supported: save PNG or WebP"
            );
            return Err(LoadError::Unsupported(text));
        }
        warnings.add(format!("missing {kind} textures ({name} is not read): {}", texels.stand_in()), place);
        Ok(None)
    }

    fn wrap_of(&self, texture: &json::Texture) -> [Wrap; 2] {
        let sampler = texture.sampler.and_then(|sampler| self.file.root.get(sampler));
        let modes = sampler.map(|sampler| [sampler.wrap_s, sampler.wrap_t]);
        modes.unwrap_or_default().map(|mode| match mode {
            Checked::Valid(WrappingMode::ClampToEdge) => Wrap::Clamp,
            Checked::Valid(WrappingMode::MirroredRepeat) => Wrap::Mirror,
            Checked::Valid(WrappingMode::Repeat) | Checked::Invalid => Wrap::Repeat,
        })
    }

    fn read(&mut self, index: usize, texels: Texels, warnings: &mut Warnings) -> Result<Option<Texture>, LoadError> {
        let place = format!("image {index}");
        let Some(bytes) = self.bytes_of(index, &place)? else { return Ok(None) };
        let Some((width, height, picture)) = self.decode(&bytes, &place)? else {
            warnings.add("images that are neither PNG, JPEG, WebP nor KTX2 are not read", place);
            return Ok(None);
        };
        let kept = (self.kept_texels_left / 8).clamp(KEPT_TEXELS.0, KEPT_TEXELS.1);
        let texture = match texels {
            Texels::Colors(alpha) => Texture::new(width, height, &picture, alpha, kept),
            Texels::Numbers => Texture::of_numbers(width, height, &picture, kept),
        };
        let (width, height) = texture.size();
        self.kept_texels_left = self.kept_texels_left.saturating_sub(width as usize * height as usize);
        Ok(Some(texture))
    }

    /// Width, height and RGBA bytes of a picture in a format that is read, which its first bytes tell: the stated type
    /// is often wrong.
    fn decode(&mut self, bytes: &[u8], place: &str) -> Result<Option<(u32, u32, Vec<u8>)>, LoadError> {
        if ktx2::is_ktx2(bytes) {
            let (width, height) = ktx2::size_of(bytes, place)?;
            self.count((width, height), place)?;
            return Ok(Some((width, height, ktx2::decode(bytes, place)?)));
        }
        let format = match image::guess_format(bytes) {
            Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::WebP)) => format,
            _ => return Ok(None),
        };
        let broken = |error: image::ImageError| malformed(place, &format!("cannot be decoded: {error}"));
        let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
        // The decoder's own limits hold from its first allocation on.
        let mut limits = image::Limits::default();
        limits.max_alloc = Some(self.max_pixels.saturating_mul(8).saturating_add(DECODER_BYTES));
        reader.limits(limits);
        let decoder = reader.into_decoder().map_err(broken)?;
        let (width, height) = decoder.dimensions();
        self.count((width, height), place)?;
        let picture = image::DynamicImage::from_decoder(decoder).map_err(broken)?.into_rgba8();
        Ok(Some((width, height, picture.into_raw())))
    }

    /// Counts a picture against what all may have.
    fn count(&mut self, (width, height): (u32, u32), place: &str) -> Result<(), LoadError> {
        let pixels = u64::from(width) * u64::from(height);
        if pixels > self.max_pixels || pixels > self.total_pixels_left {
            return Err(LoadError::TooLarge(format!(
                "{place}: has {width} x {height} pixels, at most {} are allowed, and {} in all textures that are left",
                self.max_pixels, self.total_pixels_left
            )));
        }
        if pixels == 0 {
            return Err(malformed(place, "has no pixels"));
        }
        self.total_pixels_left -= pixels;
        Ok(())
    }

    fn bytes_of(&self, index: usize, place: &str) -> Result<Option<Cow<'f, [u8]>>, LoadError> {
        image_bytes(self.file, index, place)
    }
}

/// The file that an image is; none where it is not there.
pub(super) fn image_bytes<'f>(
    file: &'f File<'_>,
    index: usize,
    place: &str,
) -> Result<Option<Cow<'f, [u8]>>, LoadError> {
    let image = file.root.images.get(index).ok_or_else(|| malformed(place, "does not exist"))?;
    if let Some(view) = image.buffer_view {
        return view_bytes(file, view, place).map(|bytes| Some(Cow::Borrowed(bytes)));
    }
    let Some(uri) = &image.uri else { return Ok(None) };
    Ok(match resolve(uri, file.files, &file.unpacked, place)? {
        Named::Here(bytes) => Some(Cow::Owned(bytes)),
        Named::Missing => None,
    })
}

fn key_of(texels: Texels) -> TexelKey {
    match texels {
        Texels::Colors(AlphaUse::Ignored) => (0, 0),
        Texels::Colors(AlphaUse::Cutoff(cutoff)) => (1, cutoff.to_bits()),
        Texels::Colors(AlphaUse::Blend) => (2, 0),
        Texels::Numbers => (3, 0),
    }
}

/// `KHR_texture_transform`: scaled, then turned (counter-clockwise, with v down), then moved.
fn matrix_of(transform: &json::extensions::texture::TextureTransform) -> (Mat2, Vec2) {
    let (sin, cos) = transform.rotation.0.sin_cos();
    let [x, y] = transform.scale.0;
    let linear = Mat2::from_cols(Vec2::new(cos, -sin) * x, Vec2::new(sin, cos) * y);
    (linear, Vec2::from_array(transform.offset.0))
}
