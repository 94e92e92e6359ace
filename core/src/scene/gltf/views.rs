//! The bytes of buffer views, decompressed where `EXT_meshopt_compression` or `KHR_meshopt_compression` says so.

use ::gltf::json;
use meshoptimizer_rs::codec::{
    BufferView, Filter, Mode, decode_filter_color, decode_filter_exp, decode_filter_oct, decode_filter_quat,
    decode_index_buffer, decode_index_sequence, decode_vertex_buffer,
};
use meshoptimizer_rs::{Error, Limits, Workspace};

use super::container::File;
use super::document::CompressedView;
use super::{LoadError, malformed};

/// The bytes of a buffer view. Compressed ones are unpacked once and kept while the file is read.
pub(super) fn view_bytes<'f>(
    file: &'f File<'_>,
    index: json::Index<json::buffer::View>,
    place: &str,
) -> Result<&'f [u8], LoadError> {
    let view = file.root.get(index).ok_or_else(|| malformed(place, "its buffer view does not exist"))?;
    let Some(compressed) = file.more.compressed_view(index.value()) else {
        let start = view.byte_offset.unwrap_or_default().0;
        return range(file, view.buffer.value(), start, view.byte_length.0, place, index.value());
    };
    let slot = &file.decompressed[index.value()];
    if slot.get().is_none() {
        let bytes = decompress(file, view, compressed, place, index.value())?;
        // Nobody else has filled it: reading a file is one thread's work.
        let _ = slot.set(bytes);
    }
    Ok(slot.get().map_or(&[], Vec::as_slice))
}

fn range<'f>(
    file: &'f File<'_>,
    buffer: usize,
    start: u64,
    length: u64,
    place: &str,
    view: usize,
) -> Result<&'f [u8], LoadError> {
    let Some(bytes) = file.buffers.get(buffer).and_then(Option::as_ref) else {
        return Err(malformed(place, &format!("buffer view {view} lies in buffer {buffer}, which has no data")));
    };
    let end = start.checked_add(length);
    let range = end.and_then(|end| Some(usize::try_from(start).ok()?..usize::try_from(end).ok()?));
    range.and_then(|range| bytes.get(range)).ok_or_else(|| {
        let text =
            format!("buffer view {view} covers {length} bytes from byte {start} on, the buffer has {}", bytes.len());
        malformed(place, &text)
    })
}

fn decompress(
    file: &File<'_>,
    view: &json::buffer::View,
    compressed: &CompressedView,
    place: &str,
    index: usize,
) -> Result<Vec<u8>, LoadError> {
    let at_fault = |error: &dyn std::fmt::Display| {
        malformed(place, &format!("buffer view {index} cannot be decompressed (meshopt compression): {error}"))
    };
    let source = range(file, compressed.buffer.value(), compressed.byte_offset, compressed.byte_length, place, index)?;
    let mode = Mode::parse(&compressed.mode).map_err(|_| at_fault(&"its mode is unknown"))?;
    let filter = match compressed.filter.as_deref() {
        Some("COLOR") => Unfilter::Color,
        other => Unfilter::Ext(Filter::parse(other.unwrap_or("NONE")).map_err(|_| at_fault(&"its filter is unknown"))?),
    };
    let [count, stride] = [compressed.count, compressed.byte_stride].map(|n| usize::try_from(n).unwrap_or(usize::MAX));
    let checked = if let Unfilter::Ext(filter) = filter { filter } else { Filter::None };
    let layout = BufferView::new(mode, checked, count, stride).map_err(|error| at_fault(&error))?;
    let length = layout.byte_length();
    if view.byte_length.0 != length as u64 {
        return Err(at_fault(&format!("it states {} bytes and unpacks to {length}", view.byte_length.0)));
    }
    file.unpacked.take(length, place)?;
    // Twice: what is decoded, and what the decoder needs beside it.
    let limits = Limits { max_bytes: length.saturating_mul(2).saturating_add(1 << 16), ..Limits::default() };
    decode(mode, filter, (count, stride), source, &mut Workspace::new(limits)).map_err(|error| at_fault(&error))
}

/// How decoded attributes become those that were encoded.
#[derive(Clone, Copy)]
enum Unfilter {
    Ext(Filter),
    /// Luma and chroma to RGB: `KHR_meshopt_compression` alone has it.
    Color,
}

/// Streams of either version: the decoder's own checked form takes the first alone.
fn decode(
    mode: Mode,
    filter: Unfilter,
    (count, stride): (usize, usize),
    source: &[u8],
    workspace: &mut Workspace,
) -> Result<Vec<u8>, Error> {
    let mut bytes = match mode {
        Mode::Attributes => decode_vertex_buffer(count, stride, source, workspace),
        Mode::Triangles => decode_index_buffer(count, stride, source, workspace),
        Mode::Indices => decode_index_sequence(count, stride, source, workspace),
    }?;
    match filter {
        Unfilter::Ext(Filter::None) => Ok(()),
        Unfilter::Ext(Filter::Octahedral) => decode_filter_oct(&mut bytes, count, stride, workspace),
        Unfilter::Ext(Filter::Quaternion) => decode_filter_quat(&mut bytes, count, stride, workspace),
        Unfilter::Ext(Filter::Exponential) => decode_filter_exp(&mut bytes, count, stride, workspace),
        Unfilter::Color if mode == Mode::Attributes => decode_filter_color(&mut bytes, count, stride, workspace),
        Unfilter::Color => Err(Error::InvalidParameter),
    }?;
    Ok(bytes)
}
