//! Reads accessors. Every range is checked against its buffer before a byte is touched, every count before anything is
//! allocated.

use ::gltf::json;
use json::accessor::{ComponentType, Type};
use json::validation::Checked;
use json::{Accessor, Index};

use super::container::File;
use super::views::view_bytes;
use super::{LoadError, malformed, too_large};

/// Values of one accessor as they lie in the file.
struct Layout<'a> {
    /// From the first value on; absent where all values are zero.
    bytes: Option<&'a [u8]>,
    /// Bytes from one value to the next.
    stride: usize,
    count: usize,
}

/// How many values an accessor may have.
#[derive(Clone, Copy, Debug)]
pub(super) struct Most {
    /// So many.
    pub(super) count: usize,
    /// Of what, with the limit that says so: words and number of the answer to more.
    pub(super) of: (&'static str, usize),
}

/// Numbers of `N` components each: `f32`, or integers as `KHR_mesh_quantization` and the core specification allow them
/// for some attributes (normalised ones become 0..=1 or −1..=1). Not checked to be finite.
pub(super) fn read_floats<const N: usize>(
    file: &File<'_>,
    index: Index<Accessor>,
    most: Most,
    place: &str,
) -> Result<Vec<[f32; N]>, LoadError> {
    let (accessor, _) = expect(file, index, shape_of(N), place)?;
    read_numbers(file, index, accessor.normalized, most, place)
}

fn read_numbers<const N: usize>(
    file: &File<'_>,
    index: Index<Accessor>,
    are_fractions: bool,
    most: Most,
    place: &str,
) -> Result<Vec<[f32; N]>, LoadError> {
    let (accessor, component) = expect(file, index, shape_of(N), place)?;
    let read = float_reader(component, are_fractions);
    let read = read.ok_or_else(|| malformed(place, "has 32-bit integers for fractions"))?;
    read_all::<f32, N>(file, accessor, component, most, place, read)
}

/// Positions or normals. Integers only where the file uses `KHR_mesh_quantization`. Not checked to be finite.
pub(super) fn read_vec3(
    file: &File<'_>,
    index: Index<Accessor>,
    most: Most,
    place: &str,
) -> Result<Vec<[f32; 3]>, LoadError> {
    let (_, component) = expect(file, index, Type::Vec3, place)?;
    let quantized = file.root.extensions_used.iter().any(|e| e == "KHR_mesh_quantization");
    if component != ComponentType::F32 && component != ComponentType::U32 && !quantized {
        return Err(malformed(place, "has integers for coordinates, but the file does not use KHR_mesh_quantization"));
    }
    if component == ComponentType::U32 {
        return Err(malformed(place, "has 32-bit integers for coordinates"));
    }
    read_floats(file, index, most, place)
}

/// Colours: RGB or RGBA, `f32` or integers, which stand for fractions also where the file does not say so; alpha is 1
/// where there is none. All finite.
pub(super) fn read_colors(
    file: &File<'_>,
    index: Index<Accessor>,
    most: Most,
    place: &str,
) -> Result<Vec<[f32; 4]>, LoadError> {
    let accessor = file.root.get(index).ok_or_else(|| malformed(place, "its accessor does not exist"))?;
    let colors = if accessor.type_ == Checked::Valid(Type::Vec4) {
        read_numbers::<4>(file, index, true, most, place)?
    } else {
        let colors = read_numbers::<3>(file, index, true, most, place)?;
        colors.into_iter().map(|[r, g, b]| [r, g, b, 1.0]).collect()
    };
    require_finite(&colors, place)?;
    Ok(colors)
}

/// Joint indices, four a vertex.
pub(super) fn read_joints(
    file: &File<'_>,
    index: Index<Accessor>,
    most: Most,
    place: &str,
) -> Result<Vec<[u32; 4]>, LoadError> {
    let (accessor, component) = expect(file, index, Type::Vec4, place)?;
    let read = index_reader(component).ok_or_else(|| malformed(place, "joints must be unsigned integers"))?;
    read_all::<u32, 4>(file, accessor, component, most, place, read)
}

/// 4 × 4 matrices, column by column.
pub(super) fn read_matrices(
    file: &File<'_>,
    index: Index<Accessor>,
    most: Most,
    place: &str,
) -> Result<Vec<[f32; 16]>, LoadError> {
    let (accessor, component) = expect(file, index, Type::Mat4, place)?;
    let read = float_reader(component, false).filter(|_| component == ComponentType::F32);
    let read = read.ok_or_else(|| malformed(place, "matrices must be of f32"))?;
    let matrices = read_all::<f32, 16>(file, accessor, component, most, place, read)?;
    require_finite(&matrices, place)?;
    Ok(matrices)
}

/// Vertex indices of 8, 16 or 32 bits.
pub(super) fn read_indices(
    file: &File<'_>,
    index: Index<Accessor>,
    most: Most,
    place: &str,
) -> Result<Vec<u32>, LoadError> {
    let (accessor, component) = expect(file, index, Type::Scalar, place)?;
    let read = index_reader(component).ok_or_else(|| malformed(place, "indices must be unsigned integers"))?;
    let values = read_all::<u32, 1>(file, accessor, component, most, place, read)?;
    Ok(values.into_iter().map(|[value]| value).collect())
}

/// Refuses values with a number that is not finite.
pub(super) fn require_finite<const N: usize>(values: &[[f32; N]], place: &str) -> Result<(), LoadError> {
    match values.iter().position(|value| value.iter().any(|c| !c.is_finite())) {
        Some(at) => Err(malformed(place, &format!("value {at} is {:?}", values[at]))),
        None => Ok(()),
    }
}

fn shape_of(components: usize) -> Type {
    match components {
        1 => Type::Scalar,
        2 => Type::Vec2,
        3 => Type::Vec3,
        _ => Type::Vec4,
    }
}

fn float_reader(component: ComponentType, normalized: bool) -> Option<fn(&[u8]) -> f32> {
    Some(match (component, normalized) {
        (ComponentType::F32, _) => |b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]),
        (ComponentType::I8, false) => |b| f32::from(b[0] as i8),
        (ComponentType::U8, false) => |b| f32::from(b[0]),
        (ComponentType::I16, false) => |b| f32::from(i16::from_le_bytes([b[0], b[1]])),
        (ComponentType::U16, false) => |b| f32::from(u16::from_le_bytes([b[0], b[1]])),
        (ComponentType::I8, true) => |b| (f32::from(b[0] as i8) / 127.0).max(-1.0),
        (ComponentType::U8, true) => |b| f32::from(b[0]) / 255.0,
        (ComponentType::I16, true) => |b| (f32::from(i16::from_le_bytes([b[0], b[1]])) / 32767.0).max(-1.0),
        (ComponentType::U16, true) => |b| f32::from(u16::from_le_bytes([b[0], b[1]])) / 65535.0,
        (ComponentType::U32, _) => return None,
    })
}
fn index_reader(component: ComponentType) -> Option<fn(&[u8]) -> u32> {
    match component {
        ComponentType::U8 => Some(|b| u32::from(b[0])),
        ComponentType::U16 => Some(|b| u32::from(u16::from_le_bytes([b[0], b[1]]))),
        ComponentType::U32 => Some(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
        _ => None,
    }
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
    most: Most,
    place: &str,
    read: fn(&[u8]) -> T,
) -> Result<Vec<[T; N]>, LoadError> {
    let count = match usize::try_from(accessor.count.0) {
        Ok(0) => return Err(malformed(place, "its accessor has no values")),
        // Checked before anything is allocated: values of a sparse accessor need not exist in the file.
        Ok(count) if count <= most.count => count,
        _ => return Err(too_large(most.of.0, most.of.1)),
    };
    let bytes = count.saturating_mul(size_of::<[T; N]>());
    file.read.take(bytes, place)?;
    if accessor.buffer_view.is_none() {
        file.zeros.take(bytes, place)?;
    }
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
fn layout<'f>(
    file: &'f File<'_>,
    view_index: Index<json::buffer::View>,
    offset: u64,
    count: usize,
    component: ComponentType,
    components: usize,
    place: &str,
) -> Result<Layout<'f>, LoadError> {
    let bytes = view_bytes(file, view_index, place)?;
    let view = file.root.get(view_index).ok_or_else(|| malformed(place, "its buffer view does not exist"))?;
    let size = component.size() * components;
    // Written by some for values side by side.
    let stride = view.byte_stride.map(|stride| stride.0).filter(|stride| *stride > 0).unwrap_or(size);
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
    file.read.take(count.saturating_mul(size_of::<u32>() + size_of::<[T; N]>()), place)?;
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
