//! Whether a surface bounds a volume, and which.

use super::Surface;
use crate::hash::FastMap;

/// Whether every directed edge has exactly one opposite (vertices are the same where their positions are), and the
/// signed volume in m³.
pub(super) fn closed_volume(mesh: &Surface) -> (bool, f64) {
    (is_closed(mesh), volume(mesh))
}

fn is_closed(mesh: &Surface) -> bool {
    let mut ids: FastMap<[u32; 3], u32> = FastMap::default();
    let mut id_of_vertex = Vec::with_capacity(mesh.positions.len());
    for position in &mesh.positions {
        let next = ids.len() as u32;
        id_of_vertex.push(*ids.entry(position.to_array().map(f32::to_bits)).or_insert(next));
    }
    // Smaller end, larger end, direction: an edge of a closed surface makes one pair of neighbours after sorting.
    let mut edges = Vec::with_capacity(mesh.triangles.len() * 3);
    for triangle in &mesh.triangles {
        let corners = triangle.map(|corner| id_of_vertex[corner as usize]);
        for edge in 0..3 {
            let (from, to) = (corners[edge], corners[(edge + 1) % 3]);
            edges.push((u64::from(from.min(to)) << 32 | u64::from(from.max(to)), from > to));
        }
    }
    edges.sort_unstable();
    let (pairs, rest) = edges.as_chunks::<2>();
    let is_pair = |[a, b]: &[(u64, bool); 2]| a.0 == b.0 && !a.1 && b.1;
    !edges.is_empty()
        && rest.is_empty()
        && pairs.iter().all(is_pair)
        && pairs.windows(2).all(|two| two[0][0].0 != two[1][0].0)
}

/// Sum of the signed tetrahedra between the triangles and a point near them.
fn volume(mesh: &Surface) -> f64 {
    let Some(base) = mesh.positions.first().map(|position| position.as_dvec3()) else { return 0.0 };
    let corner = |vertex: u32| mesh.positions[vertex as usize].as_dvec3() - base;
    let six_times = |&[a, b, c]: &[u32; 3]| corner(a).dot(corner(b).cross(corner(c)));
    mesh.triangles.iter().map(six_times).sum::<f64>() / 6.0
}
