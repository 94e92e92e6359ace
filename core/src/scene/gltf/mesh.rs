//! Meshes: all primitives of a glTF mesh merged into one [`Mesh`].

use std::collections::BTreeMap;
use std::sync::Arc;

use ::gltf::json;
use glam::{DVec3, Vec3};
use json::mesh::{Mode, Primitive, Semantic};
use json::validation::Checked;

use super::accessor::{read_indices, read_vec3};
use super::container::File;
use super::material::{LoadedMaterial, Materials};
use super::warnings::Warnings;
use super::{LoadError, LoadLimits, malformed, too_large};
use crate::scene::Mesh;

/// A mesh, shared by the objects that show it.
#[derive(Debug)]
pub(super) struct LoadedMesh {
    pub(super) mesh: Arc<Mesh>,
    /// Indexed by [`Mesh::triangle_materials`].
    pub(super) materials: Vec<LoadedMaterial>,
    pub(super) degenerate_triangles: usize,
}

/// Meshes of a file, read when a node first uses them.
#[derive(Debug)]
pub(super) struct Meshes<'f> {
    file: &'f File<'f>,
    read: Vec<Option<Arc<LoadedMesh>>>,
    max_triangles: usize,
    vertices_left: usize,
    max_vertices: usize,
}

/// A mesh while its primitives are added.
#[derive(Default)]
struct Draft {
    mesh: Mesh,
    has_normals: bool,
    materials: Vec<LoadedMaterial>,
    /// glTF material to index into `materials`.
    material_slots: BTreeMap<Option<usize>, u32>,
    /// Position and normal accessor to first vertex and number of vertices: primitives often share them.
    vertex_ranges: BTreeMap<(usize, Option<usize>), (u32, usize)>,
    degenerate_triangles: usize,
}

impl<'f> Meshes<'f> {
    pub(super) fn new(file: &'f File<'f>, limits: &LoadLimits) -> Self {
        Self {
            file,
            read: vec![None; file.root.meshes.len()],
            max_triangles: limits.max_triangles,
            // Vertex indices are 32 bits wide.
            vertices_left: limits.max_vertices.min(u32::MAX as usize),
            max_vertices: limits.max_vertices,
        }
    }

    pub(super) fn get(
        &mut self,
        index: json::Index<json::Mesh>,
        materials: &mut Materials<'f>,
        warnings: &mut Warnings,
    ) -> Result<Arc<LoadedMesh>, LoadError> {
        let index = index.value();
        if let Some(known) = self.read.get(index).and_then(Option::as_ref) {
            return Ok(Arc::clone(known));
        }
        let missing = || malformed(&format!("mesh {index}"), "does not exist");
        let json = self.file.root.meshes.get(index).ok_or_else(missing)?;
        let name = format!("mesh {index} \"{}\"", json.name.as_deref().unwrap_or_default());
        if json.primitives.is_empty() {
            return Err(malformed(&name, "has no primitives"));
        }
        let mut draft = Draft::default();
        for (number, primitive) in json.primitives.iter().enumerate() {
            let place = format!("{name}, primitive {number}");
            self.add_primitive(&mut draft, primitive, &place, materials, warnings)?;
        }
        let loaded = Arc::new(draft.finish());
        self.read[index] = Some(Arc::clone(&loaded));
        Ok(loaded)
    }

    fn add_primitive(
        &mut self,
        draft: &mut Draft,
        primitive: &Primitive,
        place: &str,
        materials: &mut Materials<'f>,
        warnings: &mut Warnings,
    ) -> Result<(), LoadError> {
        let mode = match primitive.mode {
            Checked::Valid(mode @ (Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan)) => mode,
            Checked::Valid(_) => {
                warnings.add("points and lines are left out", place);
                return Ok(());
            }
            Checked::Invalid => return Err(malformed(place, "its mode is unknown")),
        };
        if primitive.targets.as_ref().is_some_and(|targets| !targets.is_empty()) {
            warnings.add("morph targets are ignored", place);
        }
        let material = materials.get(primitive.material, warnings)?;
        if material.is_transparent {
            return Ok(());
        }
        let (first, count) = self.vertices(draft, primitive, place)?;
        let full = |error| match error {
            LoadError::TooLarge(_) => too_large("triangles", self.max_triangles),
            other => other,
        };
        // A strip or fan of n indices has n − 2 triangles, a list a third of n.
        let max_indices = self.max_triangles.saturating_mul(3).saturating_add(2);
        let indices = match primitive.indices {
            Some(index) => read_indices(self.file, index, max_indices, &format!("{place}, indices")).map_err(full)?,
            None => (0..count as u32).collect(),
        };
        if let Some(bad) = indices.iter().find(|&&index| index as usize >= count) {
            return Err(malformed(place, &format!("index {bad} is out of range, there are {count} vertices")));
        }
        let corners = triangle_corners(mode, &indices, place)?;
        if draft.mesh.triangles.len() + corners.len() > self.max_triangles {
            return Err(too_large("triangles", self.max_triangles));
        }
        let slot = draft.material_slot(primitive.material.map(|index| index.value()), material);
        draft.add_triangles(&corners, first, slot);
        Ok(())
    }

    /// Adds the vertices of a primitive; answers the first one's index and their number.
    fn vertices(&mut self, draft: &mut Draft, primitive: &Primitive, place: &str) -> Result<(u32, usize), LoadError> {
        let attribute = |semantic| primitive.attributes.get(&Checked::Valid(semantic)).copied();
        let Some(position_index) = attribute(Semantic::Positions) else {
            return Err(malformed(place, "has no POSITION"));
        };
        let normal_index = attribute(Semantic::Normals);
        let key = (position_index.value(), normal_index.map(|index| index.value()));
        if let Some(known) = draft.vertex_ranges.get(&key) {
            return Ok(*known);
        }
        let full = |error| match error {
            LoadError::TooLarge(_) => too_large("vertices", self.max_vertices),
            other => other,
        };
        let positions = read_vec3(self.file, position_index, self.vertices_left, &format!("{place}, POSITION"));
        let positions = positions.map_err(full)?;
        let first = draft.mesh.positions.len() as u32;
        if let Some(index) = normal_index {
            let normals = read_vec3(self.file, index, self.vertices_left, &format!("{place}, NORMAL")).map_err(full)?;
            if normals.len() != positions.len() {
                let text = format!("has {} positions but {} normals", positions.len(), normals.len());
                return Err(malformed(place, &text));
            }
            // In f64: the square of a tiny f32 vanishes. What has no direction counts as absent.
            let unit = |n: &[f32; 3]| Vec3::from_array(*n).as_dvec3().normalize_or_zero().as_vec3();
            draft.mesh.normals.extend(normals.iter().map(unit));
            draft.has_normals = true;
        } else {
            draft.mesh.normals.extend(std::iter::repeat_n(Vec3::ZERO, positions.len()));
        }
        self.vertices_left -= positions.len();
        let count = positions.len();
        draft.mesh.positions.extend(positions.into_iter().map(Vec3::from_array));
        draft.vertex_ranges.insert(key, (first, count));
        Ok((first, count))
    }
}

impl Draft {
    fn material_slot(&mut self, index: Option<usize>, material: LoadedMaterial) -> u32 {
        let next = self.materials.len() as u32;
        let slot = *self.material_slots.entry(index).or_insert(next);
        if slot == next {
            self.materials.push(material);
        }
        slot
    }

    fn add_triangles(&mut self, corners: &[[u32; 3]], first: u32, material: u32) {
        let mesh = &mut self.mesh;
        for triangle in corners {
            let triangle = triangle.map(|corner| first + corner);
            if is_degenerate(triangle.map(|corner| mesh.positions[corner as usize])) {
                self.degenerate_triangles += 1;
            } else {
                mesh.triangles.push(triangle);
                mesh.triangle_materials.push(material);
            }
        }
    }

    fn finish(mut self) -> LoadedMesh {
        if !self.has_normals {
            self.mesh.normals = Vec::new();
        }
        LoadedMesh {
            mesh: Arc::new(self.mesh),
            materials: self.materials,
            degenerate_triangles: self.degenerate_triangles,
        }
    }
}

fn triangle_corners(mode: Mode, indices: &[u32], place: &str) -> Result<Vec<[u32; 3]>, LoadError> {
    let count = indices.len();
    let is_list = mode == Mode::Triangles;
    if count < 3 || (is_list && !count.is_multiple_of(3)) {
        return Err(malformed(place, &format!("{count} vertices do not make whole triangles")));
    }
    Ok(match mode {
        Mode::TriangleStrip => {
            (0..count - 2).map(|i| [indices[i], indices[i + 1 + i % 2], indices[i + 2 - i % 2]]).collect()
        }
        Mode::TriangleFan => (0..count - 2).map(|i| [indices[i + 1], indices[i + 2], indices[0]]).collect(),
        _ => indices.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(),
    })
}

/// No area, or so flat that its normal would be noise.
fn is_degenerate(corners: [Vec3; 3]) -> bool {
    let [a, b, c] = corners.map(|corner| corner.as_dvec3());
    let (ab, ac, bc): (DVec3, DVec3, DVec3) = (b - a, c - a, c - b);
    let longest_squared = ab.length_squared().max(ac.length_squared()).max(bc.length_squared());
    let double_area = ab.cross(ac).length();
    // `f32` positions carry seven digits: a height below a tenth of that, relative to the length, is rounding.
    double_area <= 1e-8 * longest_squared
}
