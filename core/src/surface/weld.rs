//! From an object's mesh to welded vertices in scene space with consistent winding and usable normals.

use glam::{DMat3, DMat4, DVec3, Vec3};

use super::{FileTriangle, Surface, SurfaceError, touching};
use crate::hash::FastMap;
use crate::scene::{Mesh, Object};

/// Least cosine between a shading normal and the geometric normal of a triangle. Below it a cosine-distributed
/// direction about the one would often lie beneath the other.
pub(crate) const MIN_COSINE: f32 = 0.05;

/// Transforms and welds: shared vertices are smooth, duplicated positions are hard edges. Triangles without an area in
/// scene space are dropped and counted.
pub(super) fn weld(object: &Object, scene_from_object: DMat4) -> Result<Surface, SurfaceError> {
    let linear = DMat3::from_mat4(scene_from_object);
    let determinant = linear.determinant();
    if !scene_from_object.is_finite() || !determinant.is_finite() || determinant == 0.0 {
        return Err(SurfaceError::Transform);
    }
    let mesh = &*object.mesh;
    check_indices(mesh, object.materials.len())?;
    let mut welder = Welder {
        positions: transform_positions(mesh, scene_from_object)?,
        normals: transform_normals(mesh, linear.inverse().transpose()),
        ids: FastMap::default(),
        id_of_vertex: vec![u32::MAX; mesh.positions.len()],
        welded: Surface::default(),
    };
    for (index, (triangle, &material)) in mesh.triangles.iter().zip(&mesh.triangle_materials).enumerate() {
        let [a, b, c] = *triangle;
        let mirrored = determinant < 0.0;
        let corners = if mirrored { [a, c, b] } else { [a, b, c] };
        let source = FileTriangle::new(index as u32, mirrored);
        welder.add(corners, source, material, object.materials[material as usize].double_sided);
    }
    Ok(welder.welded)
}

struct Welder {
    /// Of the mesh's vertices, in scene space.
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    ids: FastMap<[u32; 6], u32>,
    /// Of a vertex with its own normal, once known: most corners need no hashing.
    id_of_vertex: Vec<u32>,
    welded: Surface,
}

impl Welder {
    fn add(&mut self, mut corners: [u32; 3], mut source: FileTriangle, material: u32, double_sided: bool) {
        let [a, b, c] = corners.map(|corner| self.positions[corner as usize]);
        let Some(mut front) = geometric_normal(a, b, c) else {
            self.welded.dropped += 1;
            return;
        };
        let mut normals = corners.map(|corner| self.normals[corner as usize]);
        let opposes = normals.iter().sum::<Vec3>().dot(front) < 0.0;
        if opposes && double_sided {
            // Its front is where the normals point.
            corners.swap(1, 2);
            normals.swap(1, 2);
            source = FileTriangle::new(source.triangle() as u32, !source.turned());
            front = -front;
        } else if opposes {
            // Its front is the counter-clockwise side, whatever the normals say.
            normals = normals.map(|normal| -normal);
        }
        let triangle = std::array::from_fn(|i| {
            let is_usable = normals[i].dot(front) >= MIN_COSINE;
            self.id(corners[i], if is_usable { normals[i] } else { front })
        });
        let [a, b, c]: [u32; 3] = triangle;
        if a != b && b != c && c != a {
            self.welded.triangles.push(triangle);
            self.welded.triangle_materials.push(material);
            self.welded.sources.push(source);
        } else {
            self.welded.dropped += 1;
        }
    }

    fn id(&mut self, corner: u32, normal: Vec3) -> u32 {
        let has_own_normal = normal == self.normals[corner as usize];
        let known = self.id_of_vertex[corner as usize];
        if has_own_normal && known != u32::MAX {
            return known;
        }
        let (position, normal) = (self.positions[corner as usize], normal + Vec3::ZERO);
        let welded = &mut self.welded;
        let id = *self.ids.entry(bits(position, normal)).or_insert_with(|| {
            welded.positions.push(position);
            welded.normals.push(normal);
            (welded.positions.len() - 1) as u32
        });
        if has_own_normal {
            self.id_of_vertex[corner as usize] = id;
        }
        id
    }
}

fn bits(position: Vec3, normal: Vec3) -> [u32; 6] {
    let [a, b, c] = position.to_array().map(f32::to_bits);
    let [d, e, f] = normal.to_array().map(f32::to_bits);
    [a, b, c, d, e, f]
}

/// Unit normal of the counter-clockwise side; none where the triangle has no area.
pub(crate) fn geometric_normal(a: Vec3, b: Vec3, c: Vec3) -> Option<Vec3> {
    let (a, b, c) = (a.as_dvec3(), b.as_dvec3(), c.as_dvec3());
    (b - a).cross(c - a).try_normalize().map(DVec3::as_vec3)
}

/// In f64 up to the last step: scene space is near zero even where world space is far from it. Vertices that are meant to be
/// one are.
fn transform_positions(mesh: &Mesh, scene_from_object: DMat4) -> Result<Vec<Vec3>, SurfaceError> {
    let transform = |position: &Vec3| {
        // Adding zero turns −0 into 0.
        let position = scene_from_object.transform_point3(position.as_dvec3()).as_vec3() + Vec3::ZERO;
        position.is_finite().then_some(position).ok_or(SurfaceError::Transform)
    };
    let mut positions = mesh.positions.iter().map(transform).collect::<Result<Vec<Vec3>, _>>()?;
    touching::join(&mut positions);
    Ok(positions)
}

/// Zero vectors, also where the mesh has no normals at all, mark flat shading.
fn transform_normals(mesh: &Mesh, normal_matrix: DMat3) -> Vec<Vec3> {
    if mesh.normals.is_empty() {
        return vec![Vec3::ZERO; mesh.positions.len()];
    }
    let transform = |normal: &Vec3| (normal_matrix * normal.as_dvec3()).normalize_or_zero().as_vec3();
    mesh.normals.iter().map(transform).collect()
}

fn check_indices(mesh: &Mesh, materials: usize) -> Result<(), SurfaceError> {
    let vertices = mesh.positions.len();
    // A source keeps one bit for its turn.
    let is_consistent = mesh.triangles.len() < 1 << 31
        && (mesh.normals.is_empty() || mesh.normals.len() == vertices)
        && mesh.triangle_materials.len() == mesh.triangles.len()
        && mesh.triangles.iter().flatten().all(|&corner| (corner as usize) < vertices)
        && mesh.triangle_materials.iter().all(|&material| (material as usize) < materials);
    is_consistent.then_some(()).ok_or(SurfaceError::Mesh)
}
