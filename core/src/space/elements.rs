//! Area and sample point of every element.

use glam::{DVec3, Vec3};

use super::layout::Elements;
use crate::surface::{MIN_COSINE, geometric_normal, triangle_area};

/// How far from a vertex at a border its sample point lies, as a part of the way to the centroid of the triangle.
/// Its distance to the triangle's edges there is this part of a third of the triangle's heights.
const INSET: f64 = 0.04;

/// A vertex is within the surface where its triangles leave less of a gap than this: the integral of the directions
/// that they cover, over the sum of their chords (0: all around, 0.64: half a plane, 1: a needle).
const MAX_GAP: f32 = 0.15;

/// Cosines closer than this count as equal when a triangle is chosen for a sample point.
const COSINE_TIE: f32 = 1e-4;

/// Computes all elements of a subdivided surface: of its vertices, from the triangles that have an area.
pub(super) fn sample_points(positions: &[Vec3], normals: &[Vec3], triangles: &[[u32; 3]]) -> Elements {
    let mesh = Mesh { positions, normals, triangles };
    let fans = Fans::new(&mesh);
    let front = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|corner| positions[corner as usize]);
        geometric_normal(a, b, c).unwrap_or_default()
    };
    let fronts: Vec<Vec3> = triangles.iter().map(front).collect();
    let count = positions.len();
    let mut result =
        Elements { positions: Vec::with_capacity(count), normals: Vec::with_capacity(count), areas: areas(&mesh) };
    for vertex in 0..count {
        let (position, normal) = sample_point(&mesh, &fronts, vertex, fans.of(vertex));
        result.positions.push(position);
        result.normals.push(normal);
    }
    result
}

/// A subdivided surface: its vertices are the elements, its triangles the cells.
struct Mesh<'m> {
    positions: &'m [Vec3],
    normals: &'m [Vec3],
    triangles: &'m [[u32; 3]],
}

/// A third of the area of the triangles at each vertex, m². Vertices between cells that rounding has flattened have
/// next to none, but are no holes.
fn areas(mesh: &Mesh) -> Vec<f32> {
    let mut areas = vec![0.0_f64; mesh.positions.len()];
    for triangle in mesh.triangles {
        let third = triangle_area(triangle.map(|corner| mesh.positions[corner as usize])) / 3.0;
        for &corner in triangle {
            areas[corner as usize] += third;
        }
    }
    areas.into_iter().map(|area| (area as f32).max(f32::MIN_POSITIVE)).collect()
}

/// The triangles at each vertex, in one flat list.
struct Fans {
    /// Vertex `v` has `corners[starts[v]..starts[v + 1]]`.
    starts: Vec<u32>,
    /// Triangle and which of its corners it is.
    corners: Vec<(u32, u8)>,
}

impl Fans {
    fn new(mesh: &Mesh) -> Self {
        let mut starts = vec![0_u32; mesh.positions.len() + 1];
        for &corner in mesh.triangles.iter().flatten() {
            starts[corner as usize + 1] += 1;
        }
        for vertex in 1..starts.len() {
            starts[vertex] += starts[vertex - 1];
        }
        let mut next = starts.clone();
        let mut corners = vec![(0, 0); mesh.triangles.len() * 3];
        for (index, triangle) in mesh.triangles.iter().enumerate() {
            for (which, &corner) in triangle.iter().enumerate() {
                let slot = &mut next[corner as usize];
                corners[*slot as usize] = (index as u32, which as u8);
                *slot += 1;
            }
        }
        Self { starts, corners }
    }

    fn of(&self, vertex: usize) -> &[(u32, u8)] {
        &self.corners[self.starts[vertex] as usize..self.starts[vertex + 1] as usize]
    }
}

/// Where an element is evaluated, and with which normal: the vertex itself within a surface, otherwise a point in
/// one of its triangles, so that rays do not start on the edge to another surface.
fn sample_point(mesh: &Mesh, fronts: &[Vec3], vertex: usize, fan: &[(u32, u8)]) -> (Vec3, Vec3) {
    let (position, normal) = (mesh.positions[vertex], mesh.normals[vertex]);
    let (mut turn, mut chords, mut best) = (Vec3::ZERO, 0.0_f32, f32::NEG_INFINITY);
    for &corner in fan {
        let [along, back] =
            neighbours(mesh, corner).map(|other| (other - position).reject_from_normalized(normal).normalize_or_zero());
        let chord = back - along;
        turn += chord;
        chords += chord.length();
        best = best.max(fronts[corner.0 as usize].dot(normal));
    }
    // The integral of the directions from `along` to `back` is their difference, turned by a right angle: around a
    // whole fan the differences cancel.
    let covered = turn.cross(normal);
    let is_within = covered.length() < MAX_GAP * chords;
    if is_within && best >= MIN_COSINE {
        return (position, normal);
    }
    let Some(&(triangle, which)) = flattest(mesh, fronts, vertex, fan, best - COSINE_TIE, covered) else {
        return (position, normal);
    };
    let usable = if best < MIN_COSINE { fronts[triangle as usize] } else { normal };
    if is_within {
        return (position, usable);
    }
    let inset = position.as_dvec3() + inward(mesh, position, (triangle, which)) * INSET;
    (inset.as_vec3(), usable)
}

/// The triangle whose plane agrees best with the normal; of several, the one that lies most in the middle.
fn flattest<'f>(
    mesh: &Mesh,
    fronts: &[Vec3],
    vertex: usize,
    fan: &'f [(u32, u8)],
    least_cosine: f32,
    covered: Vec3,
) -> Option<&'f (u32, u8)> {
    let (position, normal) = (mesh.positions[vertex], mesh.normals[vertex]);
    let is_flat = |corner: &&(u32, u8)| fronts[corner.0 as usize].dot(normal) >= least_cosine;
    let agreement = |corner: &(u32, u8)| inward(mesh, position, *corner).as_vec3().normalize_or_zero().dot(covered);
    fan.iter().filter(is_flat).max_by(|a, b| agreement(a).total_cmp(&agreement(b)))
}

/// The other two corners of a triangle, counter-clockwise.
fn neighbours(mesh: &Mesh, (triangle, which): (u32, u8)) -> [Vec3; 2] {
    let corners = mesh.triangles[triangle as usize];
    [1, 2].map(|step| mesh.positions[corners[(which as usize + step) % 3] as usize])
}

/// From a corner of a triangle to its centroid, metres.
fn inward(mesh: &Mesh, position: Vec3, corner: (u32, u8)) -> DVec3 {
    let [from, to] = neighbours(mesh, corner).map(|other| other.as_dvec3() - position.as_dvec3());
    (from + to) / 3.0
}
