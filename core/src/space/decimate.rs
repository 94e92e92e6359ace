//! Fewer elements than cells have corners, where these lie closer than light needs: the file's triangles are small there, or
//! long and thin.
//!
//! Corners (vertices here) are removed one after the other, each by moving it onto a neighbour (Schroeder, Zarge and Lorensen
//! 1992, Decimation of triangle meshes), as long as edges stay shorter than elements may lie apart and the surface stays as
//! round as it is. Every vertex that was removed is followed to the triangle that lies where it was (Lee et al. 1998, MAPS)
//! and reads light there. The mesh that rays meet is not touched.

use glam::Vec3;
use rayon::prelude::*;

use super::mesh::{Mesh, Ring};
use super::reads::Read;

/// Edges between the vertices that are left are no longer than this, as a part of the distance that elements may have.
const LONGEST: f32 = 0.8;

/// Corners with an edge shorter than this, as a part of that distance, may go.
const DENSE: f32 = 0.4;

/// Fewer are not worth it, nor is a smaller part of all.
const FEWEST: usize = 12;
const LEAST_SHARE: f32 = 0.3;

/// Least cosine between normals at the ends of an edge, unless the vertex that goes has rounder ones, and between both sides of
/// a border where it goes: light goes with the normal, and of a cosine 30° wide a straight line is off by a thirtieth.
const SMOOTH: f32 = 0.866;

/// Least cosine between a triangle and the normals at its corners, unless there is one that is less along them.
const ALONG: f32 = 0.7;

/// What is as round as it was may be a little rounder by rounding.
const ROUNDING: f32 = 1e-3;

/// How far from the triangles that take its place a vertex may be, as a part of the distance that elements may have.
const FLAT: f32 = 0.1;

/// Least area of a triangle over its longest edge squared (√3/4 with equal sides), unless one that goes was as thin.
const LEAST_AREA: f32 = 0.06;

/// Pieces of surface so small, over the distance that elements may have, have one element or a few.
const SMALL: f32 = 0.2;

/// Rounds, in each of which no two vertices beside each other go, end where they remove less than this part of what is left.
const LEAST_OF_ROUND: f32 = 0.003;

/// A surface in cells.
pub(super) struct Fine<'f> {
    /// Corners, scene space, m.
    pub positions: &'f [Vec3],
    /// Unit.
    pub normals: &'f [Vec3],
    /// Cells.
    pub triangles: &'f [[u32; 3]],
}

/// A surface with fewer elements than corners.
pub(super) struct Decimated {
    /// What every corner reads.
    pub reads: Vec<Read>,
    /// Corners whose elements lie elsewhere: where, and their unit normals.
    pub placed: Vec<(u32, Vec3, Vec3)>,
}

impl Decimated {
    /// Corners that are elements.
    pub(super) fn left(&self) -> usize {
        (0..).zip(&self.reads).filter(|(corner, read)| **read == Read::own(*corner)).count()
    }
}

impl<'f> Fine<'f> {
    /// Which corners go; none where all stay. `size`: how far apart elements may lie at a point, m; nowhere more than
    /// `largest`.
    pub(super) fn decimated(&self, size: impl Fn(Vec3) -> f32 + Sync, largest: f32) -> Option<Decimated> {
        let least = self.least();
        if !self.is_dense(largest) {
            return None;
        }
        let sizes: Vec<f32> = self.positions.par_iter().map(|&at| size(at)).collect();
        let edges = self.shortest_edges();
        let is_dense = |corner: &u32| edges[*corner as usize] <= DENSE * sizes[*corner as usize];
        let dense: Vec<u32> = (0..self.positions.len() as u32).filter(is_dense).collect();
        if dense.len() < least {
            return None;
        }
        let mut decimation = Decimation {
            mesh: Mesh::new(self.positions, self.triangles, &self.welded(&dense)),
            normals: self.normals,
            sizes,
        };
        decimation.thin_out(&dense);
        let placed = decimation.gather_small();
        let decimated = Decimated { reads: decimation.mesh.reads(), placed };
        (decimated.left() + least <= self.positions.len()).then_some(decimated)
    }

    /// Whether some may go where elements lie so far apart, m.
    pub(super) fn is_dense(&self, size: f32) -> bool {
        let is_short = |edge: &&f32| **edge <= DENSE * size;
        self.shortest_edges().iter().filter(is_short).count() >= self.least()
    }

    /// Fewer are not worth it.
    fn least(&self) -> usize {
        FEWEST.max((LEAST_SHARE * self.positions.len() as f32) as usize)
    }

    /// Per corner, m; infinite without cells.
    fn shortest_edges(&self) -> Vec<f32> {
        let mut shortest = vec![f32::INFINITY; self.positions.len()];
        for corners in self.triangles {
            for (a, b) in [(0, 1), (1, 2), (2, 0)].map(|(a, b)| (corners[a] as usize, corners[b] as usize)) {
                let length = self.positions[a].distance(self.positions[b]);
                shortest[a] = shortest[a].min(length);
                shortest[b] = shortest[b].min(length);
            }
        }
        shortest
    }

    /// Vertices at one place whose normals differ little: the first stands for all of them. Flat shading splits them, and
    /// light has no edge there.
    fn welded(&self, dense: &[u32]) -> Vec<u32> {
        let mut leaders: Vec<u32> = (0..self.positions.len() as u32).collect();
        let place = |vertex: u32| self.positions[vertex as usize].to_array().map(f32::to_bits);
        let mut by_place = dense.to_vec();
        by_place.sort_unstable_by_key(|&vertex| (place(vertex), vertex));
        for group in by_place.chunk_by(|&a, &b| place(a) == place(b)) {
            // Few: they face apart.
            let mut first: Vec<u32> = Vec::new();
            for &vertex in group {
                let is_alike =
                    |other: &&u32| self.normals[**other as usize].dot(self.normals[vertex as usize]) >= SMOOTH;
                match first.iter().find(is_alike) {
                    Some(&leader) => leaders[vertex as usize] = leader,
                    None => first.push(vertex),
                }
            }
        }
        leaders
    }
}

/// What a triangle has to keep to.
struct Limits {
    /// Least area over the longest edge squared.
    shape: f32,
    /// Least cosine between normals at the ends of its edges.
    smooth: f32,
    /// Least cosine between its normal and those at its corners.
    along: f32,
}

struct Decimation<'v> {
    mesh: Mesh<'v>,
    normals: &'v [Vec3],
    /// Per corner: how far apart elements may lie there, m.
    sizes: Vec<f32>,
}

impl Decimation<'_> {
    /// Removes what can be removed.
    fn thin_out(&mut self, dense: &[u32]) {
        let mut left: Vec<u32> = dense.iter().copied().filter(|&vertex| self.mesh.leader(vertex) == vertex).collect();
        // Beside one that went in this round; nothing has changed around it since it could not go.
        let (mut is_locked, mut is_settled) = (vec![false; self.sizes.len()], vec![false; self.sizes.len()]);
        loop {
            let before = left.len();
            left.retain(|&vertex| {
                if is_locked[vertex as usize] || is_settled[vertex as usize] {
                    return true;
                }
                let ring = self.remove(vertex);
                is_settled[vertex as usize] = ring.is_none();
                for other in ring.iter().flat_map(|ring| &ring.vertices) {
                    (is_locked[*other as usize], is_settled[*other as usize]) = (true, false);
                }
                ring.is_none()
            });
            is_locked.fill(false);
            if ((before - left.len()) as f32) <= LEAST_OF_ROUND * before as f32 {
                break;
            }
        }
    }

    /// Moves a vertex onto the nearest of its neighbours that it may move onto; none where there is no such.
    fn remove(&mut self, vertex: u32) -> Option<Ring> {
        let ring = self.mesh.ring(vertex)?;
        if !ring.is_closed && !self.is_straight(vertex, &ring) {
            return None;
        }
        let limits = self.limits(vertex, &ring);
        let count = ring.vertices.len();
        let mut onto: Vec<usize> = if ring.is_closed { (0..count).collect() } else { vec![0, count - 1] };
        let at = self.mesh.position(vertex);
        let distance = |k: usize| self.mesh.position(ring.vertices[k]).distance_squared(at);
        onto.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        let onto = onto.into_iter().find(|&k| self.may_move(vertex, &ring, k, &limits))?;
        self.mesh.collapse(vertex, &ring, onto);
        Some(ring)
    }

    /// Whether a vertex may move onto one of its ring.
    fn may_move(&self, vertex: u32, ring: &Ring, onto: usize, limits: &Limits) -> bool {
        let target = ring.vertices[onto];
        let away = self.mesh.position(vertex) - self.mesh.position(target);
        let (mut nearest, mut count) = (f32::INFINITY, 0);
        for corners in ring.triangles_onto(onto) {
            if !(self.is_short(target, corners[1], limits) && self.is_short(target, corners[2], limits)) {
                return false;
            }
            let Some(normal) = self.mesh.normal(corners) else { return false };
            let is_along = |corner: u32| self.normals[corner as usize].dot(normal) >= limits.along;
            let all_along = corners.into_iter().chain([vertex]).all(is_along);
            if !all_along || self.mesh.shape(corners) < limits.shape || self.mesh.has(corners) {
                return false;
            }
            nearest = nearest.min(away.dot(normal).abs());
            count += 1;
        }
        count > 0 && nearest <= FLAT * self.sizes[vertex as usize] && self.mesh.can_collapse(vertex, ring, onto)
    }

    /// What triangles have to keep to when a vertex goes: no worse than those around it.
    fn limits(&self, vertex: u32, ring: &Ring) -> Limits {
        let normal = self.normals[vertex as usize];
        let others = ring.vertices.iter().map(|&other| self.normals[other as usize]);
        let smooth = others.map(|other| other.dot(normal)).fold(1.0, f32::min);
        Limits {
            shape: LEAST_AREA.min(self.mesh.thinnest(vertex)),
            smooth: SMOOTH.min(smooth - ROUNDING),
            along: ALONG.min(self.mesh.least_along(vertex, self.normals) - ROUNDING),
        }
    }

    /// Whether an edge is no longer than it may be, and its ends face much the same way.
    fn is_short(&self, a: u32, b: u32, limits: &Limits) -> bool {
        let size = self.sizes[a as usize].min(self.sizes[b as usize]);
        self.mesh.position(a).distance(self.mesh.position(b)) <= LONGEST * size
            && self.normals[a as usize].dot(self.normals[b as usize]) >= limits.smooth
    }

    /// Whether a border goes straight on at one of its vertices.
    fn is_straight(&self, vertex: u32, ring: &Ring) -> bool {
        let at = self.mesh.position(vertex);
        let [from, to] = [ring.vertices[0], ring.vertices[ring.vertices.len() - 1]].map(|end| self.mesh.position(end));
        (at - from).normalize_or_zero().dot((to - at).normalize_or_zero()) >= SMOOTH
    }

    /// Gives pieces of surface that are small beside the distance of elements one element each, or one for each way that
    /// they face. Returns those that are at no vertex.
    fn gather_small(&mut self) -> Vec<(u32, Vec3, Vec3)> {
        let mut placed = Vec::new();
        for (vertices, triangles) in self.mesh.pieces() {
            if !self.is_small(&vertices) {
                continue;
            }
            if self.is_flat(&vertices) {
                placed.extend(self.gather_flat(&vertices, &triangles));
                continue;
            }
            for way in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::NEG_X, Vec3::NEG_Y, Vec3::NEG_Z] {
                let faces = |vertex: u32| self.normals[vertex as usize].dot(way);
                let is_this = |&vertex: &u32| facing(self.normals[vertex as usize]) == way;
                let group: Vec<u32> = vertices.iter().copied().filter(is_this).collect();
                let keeper = group.iter().copied().max_by(|&a, &b| faces(a).total_cmp(&faces(b)));
                group.iter().for_each(|&vertex| self.mesh.stand_in(vertex, keeper.unwrap_or(vertex)));
            }
        }
        placed
    }

    /// One element in the middle: at a border it could be in what the piece stands in. Returns it where it is at no vertex.
    fn gather_flat(&mut self, vertices: &[u32], triangles: &[u32]) -> Option<(u32, Vec3, Vec3)> {
        let middle = vertices.iter().map(|&vertex| self.mesh.position(vertex)).sum::<Vec3>() / vertices.len() as f32;
        let distance = |at: Vec3| at.distance_squared(middle);
        let removed = triangles.iter().flat_map(|&triangle| self.mesh.taken_by(triangle)).copied();
        let of_vertex = |vertex: &u32| distance(self.mesh.position(*vertex));
        let nearest = removed.min_by(|a, b| of_vertex(a).total_cmp(&of_vertex(b)));
        let keeper = nearest.unwrap_or(vertices[0]);
        vertices.iter().for_each(|&vertex| self.mesh.stand_in(vertex, keeper));
        let centers = triangles.iter().filter_map(|&triangle| self.mesh.center(triangle));
        let center = centers.min_by(|a, b| distance(a.0).total_cmp(&distance(b.0)));
        center.filter(|_| nearest.is_none()).map(|(at, normal)| (keeper, at, normal))
    }

    fn is_small(&self, piece: &[u32]) -> bool {
        let places = || piece.iter().map(|&vertex| self.mesh.position(vertex));
        let (low, high) = (places().fold(Vec3::INFINITY, Vec3::min), places().fold(Vec3::NEG_INFINITY, Vec3::max));
        let size = piece.iter().map(|&vertex| self.sizes[vertex as usize]).fold(f32::INFINITY, f32::min);
        low.distance(high) <= SMALL * size
    }

    fn is_flat(&self, piece: &[u32]) -> bool {
        let normals = || piece.iter().map(|&vertex| self.normals[vertex as usize]);
        let mean = normals().sum::<Vec3>().normalize_or_zero();
        normals().all(|normal| normal.dot(mean) >= SMOOTH)
    }
}

/// The axis that a normal is nearest to.
fn facing(normal: Vec3) -> Vec3 {
    let size = normal.abs();
    let axis = match () {
        () if size.x >= size.y && size.x >= size.z => Vec3::X,
        () if size.y >= size.z => Vec3::Y,
        () => Vec3::Z,
    };
    if normal.dot(axis) < 0.0 { -axis } else { axis }
}
