//! `KHR_draco_mesh_compression`.

use std::collections::BTreeMap;

use draco_core::{DecodeLimits, DecoderBuffer, ErrorKind, FaceIndex, Mesh, MeshDecoder};

use super::container::File;
use super::document::DracoMesh;
use super::views::view_bytes;
use super::{LoadError, malformed};

/// A decoded primitive: a list of triangles with its attributes.
pub(super) struct Decoded<'f> {
    file: &'f File<'f>,
    mesh: Mesh,
    /// Attribute name to the unique id in `mesh`.
    ids: &'f BTreeMap<String, u32>,
}

/// Decodes a primitive of at most so many vertices and triangles.
pub(super) fn decode<'f>(
    file: &'f File<'f>,
    extension: &'f DracoMesh,
    max_vertices: usize,
    max_triangles: usize,
    place: &str,
) -> Result<Decoded<'f>, LoadError> {
    let bytes = view_bytes(file, extension.buffer_view, place)?;
    let left = file.unpacked.left();
    let limits = DecodeLimits::default()
        .with_max_points(max_vertices as u64)
        .with_max_faces(max_triangles as u64)
        .with_max_decoded_bytes(left as u64);
    let mut mesh = Mesh::new();
    let decoded = MeshDecoder::new().decode(&mut DecoderBuffer::new(bytes).with_limits(limits), &mut mesh);
    decoded.map_err(|error| {
        let text = format!("{place}: cannot be decompressed (KHR_draco_mesh_compression): {error}");
        if error.kind() == ErrorKind::LimitExceeded { LoadError::TooLarge(text) } else { LoadError::Malformed(text) }
    })?;
    if mesh.num_points() > max_vertices || mesh.num_faces() > max_triangles {
        return Err(LoadError::TooLarge(format!("{place}: decompressed, it has too many vertices or triangles")));
    }
    file.unpacked.take(bytes_of(&mesh), place)?;
    Ok(Decoded { file, mesh, ids: &extension.attributes })
}

/// Bytes that a decoded mesh holds.
fn bytes_of(mesh: &Mesh) -> usize {
    let attributes = (0..mesh.num_attributes()).map(|id| mesh.attribute(id).buffer().data_size());
    attributes.sum::<usize>() + mesh.num_faces() * size_of::<[u32; 3]>()
}

impl Decoded<'_> {
    /// Number of vertices.
    pub(super) fn count(&self) -> usize {
        self.mesh.num_points()
    }

    /// Whether the attribute is among the compressed ones.
    pub(super) fn has(&self, name: &str) -> bool {
        self.ids.contains_key(name)
    }

    /// An attribute of `N` numbers a vertex, as they are stored: normalised integers are not yet fractions.
    pub(super) fn floats<const N: usize>(&self, name: &str, place: &str) -> Result<Vec<[f32; N]>, LoadError> {
        let attribute = self.ids.get(name).and_then(|id| self.mesh.attribute_by_unique_id(*id));
        let attribute = attribute.ok_or_else(|| malformed(place, "is not in the compressed data"))?;
        if usize::from(attribute.num_components()) != N {
            let text = format!("has {} components, expected are {N}", attribute.num_components());
            return Err(malformed(place, &text));
        }
        self.file.read.take(self.count().saturating_mul(size_of::<[f32; N]>()), place)?;
        let values = attribute.read_f32s(self.count(), N);
        Ok(values.as_chunks::<N>().0.to_vec())
    }

    /// Number of components of an attribute; 0 where it is not there.
    pub(super) fn components(&self, name: &str) -> usize {
        let attribute = self.ids.get(name).and_then(|id| self.mesh.attribute_by_unique_id(*id));
        attribute.map_or(0, |attribute| usize::from(attribute.num_components()))
    }

    /// Three vertex indices a triangle, some perhaps out of range.
    pub(super) fn indices(&self, place: &str) -> Result<Vec<u32>, LoadError> {
        self.file.read.take(self.mesh.num_faces().saturating_mul(size_of::<[u32; 3]>()), place)?;
        let faces = (0..self.mesh.num_faces() as u32).map(|face| self.mesh.face(FaceIndex(face)));
        Ok(faces.flat_map(|face| face.map(|point| point.0)).collect())
    }
}
