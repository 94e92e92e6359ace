//! Coordinates that a file brings: the second set, where it can be used.

use glam::{DVec2, DVec3, Vec2};

use super::charts::is_inside;
use super::pages::MAX_PAGE_SIDE;
use super::raster::for_rows;
use super::unwrap::{Coordinates, MARGIN, Unwrap};
use crate::hash::FastMap;
use crate::scene::Mesh;

/// How far coordinates may leave the unit square: rounding of whoever wrote them.
const OUTSIDE: f32 = 1e-3;

/// Part of the area that may have next to no texels, and of the texels that two places may share.
const TOLERATED: f64 = 0.01;

/// Texels per metre of a place, as part of the mean, below which it has next to none.
const LEAST_DENSITY: f64 = 0.1;

/// The texels of coordinates' box per texel that they cover, at most: the rest would be wasted.
const MOST_WASTE: f64 = 8.0;

/// Coordinates of a file at some density.
pub(super) struct OfFile {
    places: Vec<[Vec2; 3]>,
    size: [u32; 2],
    scale: f64,
    offset: DVec2,
}

impl OfFile {
    pub(super) fn into_unwrap(self, base: Unwrap) -> Unwrap {
        let OfFile { places, size, scale, offset } = self;
        Unwrap { coordinates: Coordinates::File, places, size, scale: DVec2::splat(scale), offset, ..base }
    }
}

/// The file's coordinates of a mesh whose vertices lie at `positions` (metres); none where there are none, or where
/// they leave the unit square, lie on top of each other, or closer than a texel at that density.
pub(super) fn of_file(mesh: &Mesh, positions: &[DVec3], texels_per_metre: f64) -> Option<OfFile> {
    let coordinates = &mesh.texcoords[1];
    let in_square = |uv: &Vec2| uv.cmpge(Vec2::splat(-OUTSIDE)).all() && uv.cmple(Vec2::splat(1.0 + OUTSIDE)).all();
    let used = || mesh.triangles.iter().flatten().map(|&corner| coordinates[corner as usize]);
    if coordinates.len() != mesh.positions.len() || mesh.triangles.is_empty() || !used().all(|uv| in_square(&uv)) {
        return None;
    }
    let scale = scale_of(mesh, positions, texels_per_metre)?;
    let (low, high) = used().fold((Vec2::INFINITY, Vec2::NEG_INFINITY), |(l, h), uv| (l.min(uv), h.max(uv)));
    let (low, extent) = (low.as_dvec2() * scale, (high - low).as_dvec2() * scale);
    if extent.max_element() > f64::from(MAX_PAGE_SIDE - 2 * MARGIN - 2) {
        return None;
    }
    // The least corner is the centre of a texel.
    let offset = DVec2::splat(f64::from(MARGIN) + 0.5) - low;
    let size = [extent.x, extent.y].map(|side| side.ceil() as u32 + 2 * MARGIN + 2);
    let place = |corner: u32| (coordinates[corner as usize].as_dvec2() * scale + offset).as_vec2();
    let places: Vec<[Vec2; 3]> = mesh.triangles.iter().map(|corners| corners.map(place)).collect();
    has_room(mesh, &places, size).then_some(OfFile { places, size, scale, offset })
}

/// Texels of the unit square; none where too much of the surface would have next to none.
fn scale_of(mesh: &Mesh, positions: &[DVec3], texels_per_metre: f64) -> Option<f64> {
    let areas = mesh.triangles.iter().map(|corners| {
        let [a, b, c] = corners.map(|corner| positions[corner as usize]);
        let [p, q, r] = corners.map(|corner| mesh.texcoords[1][corner as usize].as_dvec2());
        ((b - a).cross(c - a).length(), (q - p).perp_dot(r - p).abs())
    });
    let areas: Vec<(f64, f64)> = areas.collect();
    let (surface, square) = areas.iter().fold((0.0, 0.0), |(s, q), (surface, square)| (s + surface, q + square));
    let mean = square / surface;
    let has_few = |(surface, square): &&(f64, f64)| square / surface < LEAST_DENSITY * LEAST_DENSITY * mean;
    let few: f64 = areas.iter().filter(has_few).map(|(surface, _)| surface).sum();
    let scale = texels_per_metre / mean.sqrt();
    (scale.is_finite() && scale > 0.0 && few <= TOLERATED * surface).then_some(scale)
}

/// Whether, but for a few texels, every texel belongs to one place, and so do its neighbours that look-ups read.
fn has_room(mesh: &Mesh, places: &[[Vec2; 3]], size: [u32; 2]) -> bool {
    const FREE: u32 = u32::MAX;
    let texels = size[0] as usize * size[1] as usize;
    let index = |x: u32, y: u32| y as usize * size[0] as usize + x as usize;
    let (mut owners, mut charts) = (vec![FREE; texels], vec![FREE; texels]);
    let (mut covered, mut shared, mut near, mut contested) = (0u64, 0u64, 0u64, 0u64);
    let chart_of = connected(mesh);
    for (triangle, corners) in places.iter().enumerate() {
        for_rows(*corners, 0.0, size, |x, y| {
            if is_inside(*corners, x, y) {
                let is_first = std::mem::replace(&mut owners[index(x, y)], triangle as u32) == FREE;
                covered += u64::from(is_first);
                shared += u64::from(!is_first);
            }
        });
        for_rows(*corners, 1.0, size, |x, y| {
            let chart = &mut charts[index(x, y)];
            near += u64::from(*chart == FREE);
            contested += u64::from(*chart != FREE && *chart != chart_of[triangle]);
            *chart = chart_of[triangle];
        });
    }
    let few = |count: u64, of: u64| count as f64 <= TOLERATED * of as f64;
    few(shared, covered) && few(contested, near) && texels as f64 <= MOST_WASTE * near as f64
}

/// Per triangle: the piece that it is part of, connected by edges that have the same coordinates on both sides.
fn connected(mesh: &Mesh) -> Vec<u32> {
    let bits = |corner: u32| {
        let [x, y, z] = mesh.positions[corner as usize].to_array().map(f32::to_bits);
        let [u, v] = mesh.texcoords[1][corner as usize].to_array().map(f32::to_bits);
        [x, y, z, u, v]
    };
    let mut ids: FastMap<[u32; 5], u32> = FastMap::default();
    let mut id = |corner: u32| {
        let next = ids.len() as u32;
        *ids.entry(bits(corner)).or_insert(next)
    };
    let corners: Vec<[u32; 3]> = mesh.triangles.iter().map(|triangle| triangle.map(&mut id)).collect();
    let mut parents: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
    let mut of_edge: FastMap<(u32, u32), u32> = FastMap::default();
    for (triangle, corners) in corners.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            let other = *of_edge.entry((a.min(b), a.max(b))).or_insert(triangle as u32);
            let (one, other) = (root(&mut parents, triangle as u32), root(&mut parents, other));
            parents[one.max(other) as usize] = one.min(other);
        }
    }
    (0..mesh.triangles.len() as u32).map(|triangle| root(&mut parents, triangle)).collect()
}

/// The first triangle of the piece; shortens the way there.
fn root(parents: &mut [u32], mut triangle: u32) -> u32 {
    while parents[triangle as usize] != triangle {
        let above = parents[parents[triangle as usize] as usize];
        parents[triangle as usize] = above;
        triangle = above;
    }
    triangle
}
