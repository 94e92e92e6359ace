//! OpenEXR: light maps as 32-bit float pictures, one pixel per element, and pages of atlases.

use std::borrow::Borrow;
use std::collections::BTreeSet;
use std::io::Cursor;

use ::exr::meta::attribute::{AttributeValue, Text};
use ::exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes, LineOrder,
    SmallVec, WritableImage, f16,
};
use glam::Vec3;

use super::ExportError;
use crate::texels::TexelPage;

/// Pixels per row that suit a light map: element `i` is pixel `(i % EXR_WIDTH, i / EXR_WIDTH)`.
pub const EXR_WIDTH: usize = 1024;

/// Longest channel or attribute name of the format, bytes.
const MAX_NAME_BYTES: usize = 255;

/// Largest width or height, pixels: readers take picture sizes as signed 32-bit numbers.
pub(super) const MAX_SIDE: usize = 1 << 24;

/// Writes layers of light-map values as a 32-bit float OpenEXR picture, losslessly compressed.
///
/// Pixel `(x, y)` is element `y · width + x`; the last row is padded with zeros. A layer called `direct` has the
/// channels `direct.R`, `direct.G`, `direct.B`; one without a name has `R`, `G`, `B`. `attributes` are name and
/// text, stored in the header beside `elements` (the number of elements) and `layout` (these two sentences).
/// Equal input gives equal bytes.
///
/// # Errors
/// [`ExportError`]: no layers, no elements or layers that differ in length; names that are taken or not possible;
/// a width of zero or more pixels than the format can hold.
pub fn write_exr(
    layers: &[(&str, &[Vec3])],
    width: usize,
    attributes: &[(&str, &str)],
) -> Result<Vec<u8>, ExportError> {
    let elements = layers.first().map_or(0, |(_, values)| values.len());
    if let Some((name, _)) = layers.iter().find(|(_, values)| values.len() != elements) {
        return Err(ExportError::Lists((*name).to_owned()));
    }
    if elements == 0 || width == 0 {
        return Err(ExportError::Lists("the light map".to_owned()));
    }
    let height = elements.div_ceil(width);
    let count = i32::try_from(elements).map_err(|_| ExportError::TooLarge)?;
    let layout = "Pixel (x, y) is element y * width + x. The last row is padded with zeros.";
    let own = [("elements", AttributeValue::I32(count)), ("layout", AttributeValue::Text(text(layout)))];
    write((width, height), channels(layers, (width, height))?, &own, attributes)
}

/// Writes linear RGB, row by row from the top, as a 32-bit float OpenEXR picture. The same input gives the same bytes.
///
/// # Errors
/// [`ExportError`]: no pixels, rows that are not complete, attribute names that are not possible.
pub fn write_picture_exr(pixels: &[Vec3], width: usize, attributes: &[(&str, &str)]) -> Result<Vec<u8>, ExportError> {
    if pixels.is_empty() || width == 0 || !pixels.len().is_multiple_of(width) {
        return Err(ExportError::Lists("the picture".to_owned()));
    }
    let size = (width, pixels.len() / width);
    write(size, channels(&[("", pixels)], size)?, &[], attributes)
}

/// How exact the numbers of a picture are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// 16 bits: three digits, up to 65504.
    #[default]
    Half,
    /// 32 bits.
    Float,
}

/// Writes a page of an atlas as an OpenEXR picture with the channels `R`, `G` and `B`, and `valid`: 1 where a texel was
/// read from a surface, 0 where it is filled or empty. The same input gives the same bytes.
///
/// # Errors
/// [`ExportError`]: no texels, attribute names that are not possible.
pub fn write_page_exr(
    page: &TexelPage,
    precision: Precision,
    attributes: &[(&str, &str)],
) -> Result<Vec<u8>, ExportError> {
    write_pages_exr(&[("", page)], precision, attributes)
}

/// Writes several readings of the same page of an atlas as one OpenEXR picture: that called `y` has the channels `y.R`,
/// `y.G` and `y.B`, one without a name `R`, `G` and `B`; `valid` is that of the first. The same input gives the same bytes.
///
/// # Errors
/// [`ExportError`]: no pages, no texels, pages that differ in size, attribute names that are not possible.
pub fn write_pages_exr(
    pages: &[(&str, impl Borrow<TexelPage>)],
    precision: Precision,
    attributes: &[(&str, &str)],
) -> Result<Vec<u8>, ExportError> {
    let first = first_of(pages)?;
    let size = (first.width, first.height);
    let channel = |page: &TexelPage, part: usize| {
        let values = page.values.iter().map(|value| value[part]);
        match precision {
            Precision::Half => FlatSamples::F16(values.map(to_half).collect()),
            Precision::Float => FlatSamples::F32(values.collect()),
        }
    };
    let valid = first.valid.iter().map(|valid| if *valid { f16::ONE } else { f16::ZERO }).collect();
    let mut list = SmallVec::new();
    list.push(AnyChannel::new(text("valid"), FlatSamples::F16(valid)));
    for (layer, page) in pages {
        for (part, letter) in ["R", "G", "B"].into_iter().enumerate() {
            let name = if layer.is_empty() { letter.to_owned() } else { format!("{layer}.{letter}") };
            list.push(AnyChannel::new(text_name(&name)?, channel(page.borrow(), part)));
        }
    }
    write(size, AnyChannels::sort(list), &[], attributes)
}

/// The first of several readings of the same page.
///
/// # Errors
/// [`ExportError::Lists`]: no pages, no texels, pages that differ in size.
pub(super) fn first_of<'p>(pages: &'p [(&str, impl Borrow<TexelPage>)]) -> Result<&'p TexelPage, ExportError> {
    let lists = || ExportError::Lists("the page".to_owned());
    let first: &TexelPage = pages.first().ok_or_else(lists)?.1.borrow();
    let (size, texels) = ((first.width, first.height), first.width * first.height);
    let fits = |page: &TexelPage| {
        (page.width, page.height) == size && page.values.len() == texels && page.valid.len() == texels
    };
    let is_usable = texels > 0 && pages.iter().all(|(_, page)| fits(page.borrow()));
    if is_usable { Ok(first) } else { Err(lists()) }
}

/// What is finite stays so.
pub(super) fn to_half(value: f32) -> f16 {
    let most = f16::MAX.to_f32();
    f16::from_f32(if value.is_finite() { value.clamp(-most, most) } else { value })
}

fn write(
    (width, height): (usize, usize),
    channels: AnyChannels<FlatSamples>,
    own: &[(&str, AttributeValue)],
    attributes: &[(&str, &str)],
) -> Result<Vec<u8>, ExportError> {
    let encoding =
        Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let attributes = layer_attributes(own, attributes)?;
    let image = Image::from_layer(Layer::new((width, height), attributes, encoding, channels));
    let mut file = Cursor::new(Vec::new());
    image.write().to_buffered(&mut file).map_err(|error| ExportError::Exr(error.to_string()))?;
    let mut file = file.into_inner();
    sort_attributes(&mut file)?;
    Ok(file)
}

fn channels(
    layers: &[(&str, &[Vec3])],
    (width, height): (usize, usize),
) -> Result<AnyChannels<FlatSamples>, ExportError> {
    if width > MAX_SIDE || height > MAX_SIDE {
        return Err(ExportError::TooLarge);
    }
    let mut names = BTreeSet::new();
    let mut list = SmallVec::new();
    for (layer, values) in layers {
        for (part, letter) in ["R", "G", "B"].into_iter().enumerate() {
            let name = if layer.is_empty() { letter.to_owned() } else { format!("{layer}.{letter}") };
            let text = text_name(&name)?;
            if !names.insert(name) {
                return Err(ExportError::Name((*layer).to_owned()));
            }
            let mut samples: Vec<f32> = values.iter().map(|value| value[part]).collect();
            samples.resize(width * height, 0.0);
            list.push(AnyChannel::new(text, FlatSamples::F32(samples)));
        }
    }
    Ok(AnyChannels::sort(list))
}

fn layer_attributes(
    own: &[(&str, AttributeValue)],
    attributes: &[(&str, &str)],
) -> Result<LayerAttributes, ExportError> {
    let mut result = LayerAttributes { software_name: Some(text("rebake")), ..LayerAttributes::default() };
    result.other.extend(own.iter().map(|(name, value)| (text(name), value.clone())));
    for (name, value) in attributes {
        let known = result.other.insert(text_name(name)?, AttributeValue::Text(text(value)));
        // The names that the format itself uses have types of their own.
        if known.is_some() || RESERVED.contains(name) {
            return Err(ExportError::Name((*name).to_owned()));
        }
    }
    Ok(result)
}

/// Attributes that the library writes itself.
const RESERVED: &[&str] = &[
    "channels",
    "chunkCount",
    "compression",
    "dataWindow",
    "displayWindow",
    "lineOrder",
    "name",
    "pixelAspectRatio",
    "screenWindowCenter",
    "screenWindowWidth",
    "software",
    "tiles",
    "type",
    "version",
];

/// UTF-8, as the format has it.
fn text(value: &str) -> Text {
    Text::from_bytes_unchecked(SmallVec::from_slice(value.as_bytes()))
}

fn text_name(name: &str) -> Result<Text, ExportError> {
    let is_possible = !name.is_empty() && name.len() <= MAX_NAME_BYTES && !name.contains('\0');
    if is_possible { Ok(text(name)) } else { Err(ExportError::Name(name.to_owned())) }
}

/// Sorts the attributes of the header by name: the library writes them in the order of a randomly seeded map, and
/// one version of a light map must be the same bytes each time. Nothing else in the file moves.
fn sort_attributes(file: &mut [u8]) -> Result<(), ExportError> {
    /// Magic number and format version.
    const START: usize = 8;
    let mut attributes: Vec<(usize, usize)> = Vec::new();
    let mut at = START;
    let end_of_name = |from: usize| Some(from + file.get(from..)?.iter().position(|&byte| byte == 0)? + 1);
    let next = |from: usize| {
        let size_at = end_of_name(end_of_name(from)?)?;
        let size = file.get(size_at..size_at + 4)?;
        let size = u32::from_le_bytes([size[0], size[1], size[2], size[3]]) as usize;
        Some(size_at + 4 + size).filter(|&end| end < file.len())
    };
    // An empty name ends the header.
    while file.get(at) != Some(&0) {
        let end = next(at).ok_or_else(|| ExportError::Exr("its header cannot be read back".to_owned()))?;
        attributes.push((at, end));
        at = end;
    }
    attributes.sort_unstable_by(|a, b| file[a.0..a.1].cmp(&file[b.0..b.1]));
    let sorted: Vec<u8> = attributes.iter().flat_map(|&(from, to)| &file[from..to]).copied().collect();
    file[START..at].copy_from_slice(&sorted);
    Ok(())
}

#[cfg(test)]
mod tests {
    use ::exr::prelude::{ReadChannels, ReadLayers, read};

    use super::*;

    fn values(count: usize, offset: f32) -> Vec<Vec3> {
        let value = |i: usize| Vec3::new(i as f32 * 0.5, 1e6 + offset, 1e-6 * i as f32) - Vec3::splat(offset);
        (0..count).map(value).collect()
    }

    #[test]
    fn layers_are_read_back_bit_for_bit() {
        let (full, direct) = (values(2500, 0.0), values(2500, 3.5));
        let file = write_exr(&[("", &full), ("direct", &direct)], 1024, &[("rebake.version", "7")]).unwrap();
        let image = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
        let image = image.all_attributes().from_buffered(Cursor::new(file)).unwrap();
        let layer = image.layer_data;
        assert_eq!((layer.size.0, layer.size.1), (1024, 3));
        assert_eq!(layer.attributes.other[&text("elements")], AttributeValue::I32(2500));
        assert_eq!(layer.attributes.other[&text("rebake.version")], AttributeValue::Text(text("7")));
        for channel in &layer.channel_data.list {
            let name = channel.name.to_string();
            let source = if name.starts_with("direct.") { &direct } else { &full };
            let part = "RGB".find(name.chars().last().unwrap()).unwrap();
            let FlatSamples::F32(samples) = &channel.sample_data else { panic!("{name} is not f32") };
            let expected = source.iter().map(|value| value[part]).chain(std::iter::repeat(0.0));
            assert!(samples.iter().zip(expected).all(|(a, b)| a.to_bits() == b.to_bits()), "{name}");
        }
        assert_eq!(layer.channel_data.list.len(), 6);
    }

    #[test]
    fn same_values_give_the_same_bytes() {
        let values = values(100, 0.0);
        let attributes = [("a", "1"), ("b", "2"), ("c", "3"), ("d", "4"), ("e", "5")];
        let write = || write_exr(&[("Lampe über dem Tisch", &values)], 16, &attributes).unwrap();
        let first = write();
        assert!((0..20).all(|_| write() == first));
    }

    #[test]
    fn pages_are_read_back_at_their_precision() {
        let page = TexelPage {
            width: 5,
            height: 3,
            values: (0..15).map(|k| Vec3::new(k as f32 * 0.1, 1e6, f32::INFINITY)).collect(),
            valid: (0..15).map(|k| k % 2 == 0).collect(),
        };
        for precision in [Precision::Half, Precision::Float] {
            let file = write_page_exr(&page, precision, &[("lightMapVersion", "3")]).unwrap();
            let image = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
            let layer = image.all_attributes().from_buffered(Cursor::new(file)).unwrap().layer_data;
            assert_eq!((layer.size.0, layer.size.1), (5, 3));
            let names: Vec<String> = layer.channel_data.list.iter().map(|channel| channel.name.to_string()).collect();
            assert_eq!(names, ["B", "G", "R", "valid"]);
            let samples: Vec<Vec<f32>> =
                layer.channel_data.list.iter().map(|channel| channel.sample_data.values_as_f32().collect()).collect();
            let is_half = precision == Precision::Half;
            assert!(samples[0].iter().all(|value| *value == f32::INFINITY));
            assert!(samples[1].iter().all(|value| *value == if is_half { 65504.0 } else { 1e6 }));
            let error = |(value, k): (&f32, usize)| (value - page.values[k].x).abs();
            let most = samples[2].iter().zip(0..).map(error).fold(0.0, f32::max);
            assert!(if is_half { most < 1e-3 && most > 0.0 } else { most == 0.0 }, "{most}");
            assert!((0..15).all(|k| samples[3][k] == f32::from(u8::from(page.valid[k]))));
        }
    }

    #[test]
    fn impossible_input_is_refused() {
        let (three, two) = (values(3, 0.0), values(2, 0.0));
        let long = "x".repeat(300);
        let refused = [
            write_exr(&[], 4, &[]),
            write_exr(&[("", &[])], 4, &[]),
            write_exr(&[("", &three)], 0, &[]),
            write_exr(&[("", &three)], usize::MAX, &[]),
            write_exr(&[("", &three), ("a", &two)], 4, &[]),
            write_exr(&[("a", &three), ("a", &three)], 4, &[]),
            write_exr(&[("a\0b", &three)], 4, &[]),
            write_exr(&[(&long, &three)], 4, &[]),
            write_exr(&[("", &three)], 4, &[("channels", "x")]),
            write_exr(&[("", &three)], 4, &[("layout", "x")]),
            write_exr(&[("", &three)], 4, &[("", "x")]),
        ];
        for (index, result) in refused.iter().enumerate() {
            assert!(result.is_err(), "case {index}");
        }
    }
}
