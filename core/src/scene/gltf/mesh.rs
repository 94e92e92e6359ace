//! Meshes: all primitives of a glTF mesh merged into one [`Mesh`].

use std::collections::BTreeMap;
use std::sync::Arc;

use ::gltf::json;
use glam::{DVec3, Vec2, Vec3, Vec4};
use json::mesh::{Mode, Primitive, Semantic};
use json::validation::Checked;

use super::accessor::Most;
use super::attributes::Attributes;
use super::container::File;
use super::material::{LoadedMaterial, Materials};
use super::pose::{Pose, Vertices};
use super::warnings::Warnings;
use super::{LoadError, LoadLimits, draco, malformed, too_large};
use crate::scene::{Mesh, capped_text};

/// A mesh, shared by the objects that show it.
#[derive(Debug)]
pub(super) struct LoadedMesh {
    pub(super) mesh: Arc<Mesh>,
    /// Indexed by [`Mesh::triangle_materials`].
    pub(super) materials: Vec<LoadedMaterial>,
    pub(super) degenerate_triangles: usize,
    /// What lets all light through and is no surface for it; only where meshes are read whole.
    pub(super) clear: Option<Box<LoadedMesh>>,
}

/// Meshes of a file, read when a node first uses them.
#[derive(Debug)]
pub(super) struct Meshes<'f> {
    file: &'f File<'f>,
    /// With what light does not need, as well.
    is_whole: bool,
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
    /// glTF material, and which of its textures have no place on the primitive, to index into `materials`.
    material_slots: BTreeMap<(Option<usize>, [bool; 4]), u32>,
    /// What primitives often share, by the accessors of all that is read of it.
    vertex_ranges: BTreeMap<Vec<Option<usize>>, (u32, usize)>,
    degenerate_triangles: usize,
}

impl<'f> Meshes<'f> {
    pub(super) fn new(file: &'f File<'f>, limits: &LoadLimits) -> Self {
        Self {
            file,
            is_whole: false,
            read: vec![None; file.root.meshes.len()],
            max_triangles: limits.max_triangles,
            // Vertex indices are 32 bits wide.
            vertices_left: limits.max_vertices.min(u32::MAX as usize),
            max_vertices: limits.max_vertices,
        }
    }

    /// Meshes with all texture coordinates of the first two sets and with what lets all light through. Triangles that
    /// light meets are the same, in the same order.
    pub(super) fn whole(file: &'f File<'f>, limits: &LoadLimits) -> Self {
        Self { is_whole: true, ..Self::new(file, limits) }
    }

    /// A mesh as a node poses it. Unposed ones are shared.
    pub(super) fn get(
        &mut self,
        index: json::Index<json::Mesh>,
        pose: &Pose,
        materials: &mut Materials<'f>,
        warnings: &mut Warnings,
    ) -> Result<Arc<LoadedMesh>, LoadError> {
        let index = index.value();
        if let Some(known) = self.read.get(index).and_then(Option::as_ref).filter(|_| pose.is_plain()) {
            return Ok(Arc::clone(known));
        }
        let missing = || malformed(&format!("mesh {index}"), "does not exist");
        let json = self.file.root.meshes.get(index).ok_or_else(missing)?;
        let name = format!("mesh {index} \"{}\"", json.name.as_deref().unwrap_or_default());
        if json.primitives.is_empty() {
            warnings.add("meshes without primitives are empty", &name);
        }
        let (mut draft, mut clear) = (Draft::default(), Draft::default());
        for (number, primitive) in json.primitives.iter().enumerate() {
            let place = format!("{name}, primitive {number}");
            let place = At { mesh: index, number, name: &place };
            self.add_primitive([&mut draft, &mut clear], primitive, &place, pose, materials, warnings)?;
        }
        let clear = (!clear.mesh.triangles.is_empty()).then(|| Box::new(clear.finish()));
        let loaded = Arc::new(LoadedMesh { clear, ..draft.finish() });
        if pose.is_plain() {
            self.read[index] = Some(Arc::clone(&loaded));
        }
        Ok(loaded)
    }

    fn add_primitive(
        &mut self,
        [draft, clear]: [&mut Draft; 2],
        primitive: &'f Primitive,
        place: &At<'_>,
        pose: &Pose,
        materials: &mut Materials<'f>,
        warnings: &mut Warnings,
    ) -> Result<(), LoadError> {
        let mode = match primitive.mode {
            Checked::Valid(mode @ (Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan)) => mode,
            Checked::Valid(_) => {
                warnings.add("points and lines are left out", place.name);
                return Ok(());
            }
            Checked::Invalid => return Err(malformed(place.name, "its mode is unknown")),
        };
        let material = materials.get(primitive.material, warnings)?;
        if material.is_bright && !primitive.attributes.contains_key(&Checked::Valid(Semantic::Colors(0))) {
            warnings.add(capped_text(materials.max_albedo), material.place());
        }
        if !material.is_clear {
            return self.add_surface(draft, (primitive, mode), material, place, pose, warnings);
        }
        if self.is_whole {
            // What light does not meet was not looked at before: where it is broken it is left out.
            let _ = self.add_surface(clear, (primitive, mode), material, place, pose, warnings);
        }
        Ok(())
    }

    fn add_surface(
        &mut self,
        draft: &mut Draft,
        (primitive, mode): (&'f Primitive, Mode),
        material: LoadedMaterial,
        place: &At<'_>,
        pose: &Pose,
        warnings: &mut Warnings,
    ) -> Result<(), LoadError> {
        let first_set = material.first_set;
        let is_there = |set: usize| primitive.attributes.contains_key(&Checked::Valid(Semantic::TexCoords(set as u32)));
        let has = |set: usize| set < 2 && is_there(if set == 0 { first_set } else { set });
        let (material, unplaced) = material.with_texcoords(has);
        if unplaced != [false; 4] {
            warnings.add("textures without texture coordinates on the mesh count with their mean colour", place.name);
        }
        let compressed = self.file.more.draco(place.mesh, place.number);
        let decode =
            |extension| draco::decode(self.file, extension, self.vertices_left, self.max_triangles, place.name);
        let draco = compressed.map(decode).transpose()?;
        // Decompressed, strips are lists.
        let mode = if draco.is_some() { Mode::Triangles } else { mode };
        let max_vertices = Most { count: self.vertices_left, of: ("vertices", self.max_vertices) };
        let attributes = Attributes { file: self.file, primitive, draco, max_vertices, place: place.name };
        let (first, count) = self.vertices(draft, &attributes, &material, pose, warnings)?;
        // A strip or fan of n indices has n − 2 triangles, a list a third of n.
        let max_indices = self.max_triangles.saturating_mul(3).saturating_add(2);
        let indices = attributes.indices(count, Most { count: max_indices, of: ("triangles", self.max_triangles) })?;
        if let Some(bad) = indices.iter().find(|&&index| index as usize >= count) {
            return Err(malformed(place.name, &format!("index {bad} is out of range, there are {count} vertices")));
        }
        let (corners, is_whole) = triangle_corners(mode, &indices);
        if !is_whole {
            warnings.add("vertices that make no whole triangle are left out", place.name);
        }
        if draft.mesh.triangles.len() + corners.len() > self.max_triangles {
            return Err(too_large("triangles", self.max_triangles));
        }
        let slot = draft.material_slot((primitive.material.map(|index| index.value()), unplaced), material);
        draft.add_triangles(&corners, first, slot);
        Ok(())
    }

    /// Adds the vertices of a primitive; answers the first one's index and their number.
    fn vertices(
        &mut self,
        draft: &mut Draft,
        attributes: &Attributes<'_>,
        material: &LoadedMaterial,
        pose: &Pose,
        warnings: &mut Warnings,
    ) -> Result<(u32, usize), LoadError> {
        let key = self.shared_by(attributes, material).filter(|_| pose.is_plain());
        if let Some(known) = key.as_ref().and_then(|key| draft.vertex_ranges.get(key)) {
            return Ok(*known);
        }
        let positions = attributes.positions()?;
        let count = positions.len();
        let normals = attributes.normals(count)?.unwrap_or_default();
        let mut vertices = Vertices { positions, normals };
        if !pose.is_plain() {
            pose.apply(attributes, &mut vertices)?;
        }
        let first = draft.mesh.positions.len();
        if !vertices.normals.is_empty() {
            draft.has_normals = true;
            if vertices.normals.iter().flatten().any(|part| !part.is_finite()) {
                warnings.add("normals that are not finite count as absent", attributes.place);
            }
        }
        // In f64: the square of a tiny f32 vanishes. What has no direction counts as absent.
        let unit = |n: [f32; 3]| Vec3::from_array(n).as_dvec3().normalize_or_zero().as_vec3();
        draft.mesh.normals.extend(vertices.normals.into_iter().map(unit));
        draft.mesh.positions.extend(vertices.positions.into_iter().map(Vec3::from_array));
        draft.mesh.normals.resize(first + count, Vec3::ZERO);
        for set in 0..2 {
            let of_file = if set == 0 { self.first_set(material) } else { 1 };
            let is_needed = material.uses_texcoord(set) && (set == 1 || of_file == material.first_set as u32);
            let values = match is_needed {
                true => attributes.texcoords(of_file, count)?,
                // An atlas may use the second set, and does without it where it is of no use.
                false if set == 1 || self.is_whole => attributes.texcoords(of_file, count).unwrap_or(None),
                false => None,
            };
            if values.iter().flatten().flatten().any(|part| !part.is_finite()) {
                warnings.add("texture coordinates that are not finite count as 0", attributes.place);
            }
            let finite = |uv: [f32; 2]| Some(Vec2::from_array(uv)).filter(|uv| uv.is_finite()).unwrap_or_default();
            let values = values.map(|values| values.into_iter().map(finite));
            append(&mut draft.mesh.texcoords[set], first, values, Vec2::ZERO);
        }
        if attributes.has_plain_integer_colors() {
            warnings.add("vertex colours of integers count as fractions, normalized or not", attributes.place);
        }
        let colors = attributes.colors(count)?.map(|colors| colors.into_iter().map(Vec4::from_array));
        append(&mut draft.mesh.colors, first, colors, Vec4::ONE);
        self.vertices_left -= count;
        let range = (first as u32, count);
        key.map(|key| draft.vertex_ranges.insert(key, range));
        Ok(range)
    }

    /// The set of the file that is a mesh's first.
    fn first_set(&self, material: &LoadedMaterial) -> u32 {
        // Files that are written back keep theirs.
        if self.is_whole { 0 } else { material.first_set as u32 }
    }

    /// The accessors that decide about a primitive's vertices; none for compressed ones, which are their own.
    fn shared_by(&self, attributes: &Attributes<'_>, material: &LoadedMaterial) -> Option<Vec<Option<usize>>> {
        let of = |semantic| attributes.accessor(semantic).map(|index| index.value());
        let first = of(Semantic::TexCoords(self.first_set(material)));
        let first = first.filter(|_| self.is_whole || material.uses_texcoord(0));
        let positions = of(Semantic::Positions);
        let all = vec![positions, of(Semantic::Normals), of(Semantic::Colors(0)), first, of(Semantic::TexCoords(1))];
        attributes.draco.is_none().then_some(all)
    }
}

/// Where a primitive stands in the document.
struct At<'p> {
    mesh: usize,
    number: usize,
    name: &'p str,
}

/// Appends values of the vertices from `first` on, which earlier vertices may lack. An empty list stays empty where
/// there are none.
fn append<T: Copy>(list: &mut Vec<T>, first: usize, values: Option<impl Iterator<Item = T>>, absent: T) {
    if let Some(values) = values {
        list.resize(first, absent);
        list.extend(values);
    }
}

impl Draft {
    fn material_slot(&mut self, key: (Option<usize>, [bool; 4]), material: LoadedMaterial) -> u32 {
        let next = self.materials.len() as u32;
        let slot = *self.material_slots.entry(key).or_insert(next);
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
        let mesh = &mut self.mesh;
        if !self.has_normals {
            mesh.normals = Vec::new();
        }
        let count = mesh.positions.len();
        mesh.texcoords.iter_mut().filter(|set| !set.is_empty()).for_each(|set| set.resize(count, Vec2::ZERO));
        if !mesh.colors.is_empty() {
            mesh.colors.resize(count, Vec4::ONE);
        }
        LoadedMesh {
            mesh: Arc::new(self.mesh),
            materials: self.materials,
            degenerate_triangles: self.degenerate_triangles,
            clear: None,
        }
    }
}

/// The triangles of a primitive, and whether its indices make whole ones.
fn triangle_corners(mode: Mode, indices: &[u32]) -> (Vec<[u32; 3]>, bool) {
    let after_two = 0..indices.len().saturating_sub(2);
    let corners = match mode {
        Mode::TriangleStrip => {
            after_two.map(|i| [indices[i], indices[i + 1 + i % 2], indices[i + 2 - i % 2]]).collect()
        }
        Mode::TriangleFan => after_two.map(|i| [indices[i + 1], indices[i + 2], indices[0]]).collect(),
        _ => indices.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(),
    };
    (corners, indices.len() >= 3 && (mode != Mode::Triangles || indices.len().is_multiple_of(3)))
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
