//! Reads accessors. Every range is checked against the binary chunk before a byte is touched.

use ::gltf::json;
use json::accessor::{ComponentType, Type};
use json::validation::Checked;
use json::{Accessor, Index};

use super::container::File;
use super::{LoadError, malformed};

/// Values of one accessor as they lie in the file.
struct Layout<'a> {
    /// From the first value on; absent where all values are zero.
    bytes: Option<&'a [u8]>,
    /// Bytes from one value to the next.
    stride: usize,
    count: usize,
}

/// A vertex attribute: `f32`, or the integer types of `KHR_mesh_quantization`. All finite.
pub(super) fn read_vec3(
    file: &File<'_>,
    index: Index<Accessor>,
    max_count: usize,
    place: &str,
) -> Result<Vec<[f32; 3]>, LoadError> {
    let (accessor, component) = expect(file, index, Type::Vec3, place)?;
    let norm = accessor.normalized;
    let quantized = file.root.extensions_used.iter().any(|e| e == "KHR_mesh_quantization");
    if component != ComponentType::F32 && !quantized {
        return Err(malformed(place, "has integers for coordinates, but the file does not use KHR_mesh_quantization"));
    }
    let read: fn(&[u8]) -> f32 = match (component, norm) {
        (ComponentType::F32, _) => |b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]),
        (ComponentType::I8, false) => |b| f32::from(b[0] as i8),
        (ComponentType::U8, false) => |b| f32::from(b[0]),
        (ComponentType::I16, false) => |b| f32::from(i16::from_le_bytes([b[0], b[1]])),
        (ComponentType::U16, false) => |b| f32::from(u16::from_le_bytes([b[0], b[1]])),
        (ComponentType::I8, true) => |b| (f32::from(b[0] as i8) / 127.0).max(-1.0),
        (ComponentType::U8, true) => |b| f32::from(b[0]) / 255.0,
        (ComponentType::I16, true) => |b| (f32::from(i16::from_le_bytes([b[0], b[1]])) / 32767.0).max(-1.0),
        (ComponentType::U16, true) => |b| f32::from(u16::from_le_bytes([b[0], b[1]])) / 65535.0,
        (ComponentType::U32, _) => return Err(malformed(place, "has 32-bit integers for coordinates")),
    };
    let values = read_all::<f32, 3>(file, accessor, component, max_count, place, read)?;
    let is_bad = |value: &[f32; 3]| value.iter().any(|c| !c.is_finite());
    match values.iter().position(is_bad) {
        Some(at) => Err(malformed(place, &format!("value {at} is {:?}", values[at]))),
        None => Ok(values),
    }
}

/// Vertex indices of 8, 16 or 32 bits.
pub(super) fn read_indices(
    file: &File<'_>,
    index: Index<Accessor>,
    max_count: usize,
    place: &str,
) -> Result<Vec<u32>, LoadError> {
    let (accessor, component) = expect(file, index, Type::Scalar, place)?;
    let read = index_reader(component).ok_or_else(|| malformed(place, "indices must be unsigned integers"))?;
    let values = read_all::<u32, 1>(file, accessor, component, max_count, place, read)?;
    Ok(values.into_iter().map(|[value]| value).collect())
}

fn index_reader(component: ComponentType) -> Option<fn(&[u8]) -> u32> {
    match component {
        ComponentType::U8 => Some(|b| u32::from(b[0])),
        ComponentType::U16 => Some(|b| u32::from(u16::from_le_bytes([b[0], b[1]]))),
        ComponentType::U32 => Some(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
        _ => None,
    }
}

/// The bytes of a buffer view.
pub(super) fn view_bytes<'a>(
    file: &File<'a>,
    index: Index<json::buffer::View>,
    place: &str,
) -> Result<&'a [u8], LoadError> {
    let view = file.root.get(index).ok_or_else(|| malformed(place, "its buffer view does not exist"))?;
    let start = view.byte_offset.unwrap_or_default().0;
    let end = start.checked_add(view.byte_length.0);
    let range = end.and_then(|end| Some(usize::try_from(start).ok()?..usize::try_from(end).ok()?));
    range.and_then(|range| file.bin.get(range)).ok_or_else(|| {
        malformed(
            place,
            &format!(
                "buffer view {} covers {} bytes from byte {start} on, the buffer has {}",
                index.value(),
                view.byte_length.0,
                file.bin.len()
            ),
        )
    })
}

fn expect<'f>(
    file: &'f File<'_>,
    index: Index<Accessor>,
    shape: Type,
    place: &str,
) -> Result<(&'f Accessor, ComponentType), LoadError> {
    let accessor = file.root.get(index).ok_or_else(|| malformed(place, "its accessor does not exist"))?;
    let (Checked::Valid(component), Checked::Valid(found)) = (accessor.component_type, accessor.type_) else {
        return Err(malformed(place, "its accessor has an unknown type"));
    };
    if found != shape {
        return Err(malformed(place, &format!("its accessor has type {found:?}, expected is {shape:?}")));
    }
    Ok((accessor, component.0))
}

fn read_all<T: Copy + Default, const N: usize>(
    file: &File<'_>,
    accessor: &Accessor,
    component: ComponentType,
    max_count: usize,
    place: &str,
    read: fn(&[u8]) -> T,
) -> Result<Vec<[T; N]>, LoadError> {
    let count = match usize::try_from(accessor.count.0) {
        Ok(0) => return Err(malformed(place, "its accessor has no values")),
        // Checked before anything is allocated: values of a sparse accessor need not exist in the file.
        Ok(count) if count <= max_count => count,
        _ => {
            let text =
                format!("{place}: its accessor has {} values, at most {max_count} are allowed", accessor.count.0);
            return Err(LoadError::TooLarge(text));
        }
    };
    let offset = accessor.byte_offset.unwrap_or_default().0;
    let layout = match accessor.buffer_view {
        Some(view) => layout(file, view, offset, count, component, N, place)?,
        None => Layout { bytes: None, stride: 1, count },
    };
    let mut values = decode::<T, N>(&layout, component.size(), read);
    if let Some(sparse) = &accessor.sparse {
        apply_sparse(file, sparse, component, &mut values, place, read)?;
    }
    Ok(values)
}

/// Checks that `count` values of `components` components lie within the view.
fn layout<'a>(
    file: &File<'a>,
    view_index: Index<json::buffer::View>,
    offset: u64,
    count: usize,
    component: ComponentType,
    components: usize,
    place: &str,
) -> Result<Layout<'a>, LoadError> {
    let bytes = view_bytes(file, view_index, place)?;
    let view = file.root.get(view_index).ok_or_else(|| malformed(place, "its buffer view does not exist"))?;
    let size = component.size() * components;
    let stride = view.byte_stride.map_or(size, |stride| stride.0);
    if stride < size {
        return Err(malformed(place, &format!("a stride of {stride} bytes is less than the {size} of a value")));
    }
    let start = view.byte_offset.unwrap_or_default().0.saturating_add(offset);
    if !start.is_multiple_of(component.size() as u64) || !stride.is_multiple_of(component.size()) {
        return Err(malformed(place, &format!("its values are not aligned to {} bytes", component.size())));
    }
    // In u128: nothing here can overflow it.
    let end = u128::from(offset) + (count as u128 - 1) * stride as u128 + size as u128;
    if end > bytes.len() as u128 {
        return Err(malformed(
            place,
            &format!(
                "{count} values reach to byte {end} of buffer view {}, which has {}",
                view_index.value(),
                bytes.len()
            ),
        ));
    }
    Ok(Layout { bytes: Some(&bytes[offset as usize..]), stride, count })
}

fn decode<T: Copy + Default, const N: usize>(layout: &Layout<'_>, size: usize, read: fn(&[u8]) -> T) -> Vec<[T; N]> {
    let Some(bytes) = layout.bytes else { return vec![[T::default(); N]; layout.count] };
    let value = |at: usize| {
        let bytes = &bytes[at * layout.stride..][..N * size];
        std::array::from_fn(|component| read(&bytes[component * size..]))
    };
    (0..layout.count).map(value).collect()
}

fn apply_sparse<T: Copy + Default, const N: usize>(
    file: &File<'_>,
    sparse: &json::accessor::sparse::Sparse,
    component: ComponentType,
    values: &mut [[T; N]],
    place: &str,
    read: fn(&[u8]) -> T,
) -> Result<(), LoadError> {
    let place = &format!("{place}, sparse values");
    let count = usize::try_from(sparse.count.0).ok().filter(|count| (1..=values.len()).contains(count));
    let count = count.ok_or_else(|| {
        malformed(place, &format!("there are {} of them for {} values", sparse.count.0, values.len()))
    })?;
    let Checked::Valid(index_type) = sparse.indices.component_type else {
        return Err(malformed(place, "their indices have an unknown type"));
    };
    let index_type = index_type.0;
    let read_index = index_reader(index_type).ok_or_else(|| malformed(place, "indices must be unsigned integers"))?;
    let (indices, data) = (&sparse.indices, &sparse.values);
    let at = layout(file, indices.buffer_view, indices.byte_offset.0, count, index_type, 1, place)?;
    let new = layout(file, data.buffer_view, data.byte_offset.0, count, component, N, place)?;
    let replaced = decode::<u32, 1>(&at, index_type.size(), read_index);
    for ([index], value) in replaced.into_iter().zip(decode::<T, N>(&new, component.size(), read)) {
        let total = values.len();
        let slot = values.get_mut(index as usize);
        *slot.ok_or_else(|| malformed(place, &format!("index {index} is out of range, there are {total} values")))? =
            value;
    }
    Ok(())
}
