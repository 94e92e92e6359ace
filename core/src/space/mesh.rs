//! A mesh that vertices are removed from, each of which is followed to where it was.

use glam::{DVec3, Vec3};

use super::cells::NONE;
use super::reads::Read;
use crate::surface::geometric_normal;

/// Vertices with more triangles than these stay, and those beside one that has very many.
const MOST_AROUND: usize = 32;
const VERY_MANY: usize = 1024;

const GONE: [u32; 3] = [NONE; 3];

pub(super) struct Mesh<'v> {
    positions: &'v [Vec3],
    /// Those that are gone are [`GONE`].
    triangles: Vec<[u32; 3]>,
    /// Per vertex: its triangles.
    around: Vec<Vec<u32>>,
    /// Per vertex: the one at the same place that it is part of.
    leaders: Vec<u32>,
    /// Per vertex that was removed: the triangle that lies where it was.
    places: Vec<u32>,
    /// Per triangle: the vertices that it took the place of.
    taken: Vec<Vec<u32>>,
    /// Per vertex: whose element it has.
    stand_ins: Vec<u32>,
}

/// The vertices around a vertex, counter-clockwise; at a border from one side of it to the other.
pub(super) struct Ring {
    pub vertices: Vec<u32>,
    pub is_closed: bool,
}

impl Ring {
    /// The triangles that there are when the vertex has moved onto one of the ring, which comes first in each.
    pub(super) fn triangles_onto(&self, onto: usize) -> impl Iterator<Item = [u32; 3]> {
        let count = self.vertices.len();
        let edges = if self.is_closed { count } else { count - 1 };
        let is_beside = move |edge: &usize| *edge != onto && (edge + 1) % count != onto;
        let triangle = move |edge: usize| [onto, edge, (edge + 1) % count].map(|k| self.vertices[k]);
        (0..edges).filter(is_beside).map(triangle)
    }
}

impl<'v> Mesh<'v> {
    /// Of triangles whose vertices are part of others (`leaders`, by index).
    pub(super) fn new(positions: &'v [Vec3], triangles: &[[u32; 3]], leaders: &[u32]) -> Mesh<'v> {
        let mut around = vec![Vec::new(); positions.len()];
        let triangles: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(|vertex| leaders[vertex as usize])).collect();
        for (triangle, index) in triangles.iter().zip(0..) {
            triangle.iter().for_each(|&vertex| around[vertex as usize].push(index));
        }
        let taken = vec![Vec::new(); triangles.len()];
        let stand_ins = (0..positions.len() as u32).collect();
        let places = vec![NONE; positions.len()];
        Mesh { positions, triangles, around, leaders: leaders.to_vec(), places, taken, stand_ins }
    }

    pub(super) fn position(&self, vertex: u32) -> Vec3 {
        self.positions[vertex as usize]
    }

    pub(super) fn leader(&self, vertex: u32) -> u32 {
        self.leaders[vertex as usize]
    }

    fn corners(&self, triangle: [u32; 3]) -> [Vec3; 3] {
        triangle.map(|vertex| self.position(vertex))
    }

    pub(super) fn normal(&self, triangle: [u32; 3]) -> Option<Vec3> {
        let [a, b, c] = self.corners(triangle);
        geometric_normal(a, b, c)
    }

    /// Area over the square of the longest edge.
    pub(super) fn shape(&self, triangle: [u32; 3]) -> f32 {
        let [a, b, c] = self.corners(triangle);
        let longest = a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a));
        0.5 * (b - a).cross(c - a).length() / longest
    }

    /// The least shape of the triangles around a vertex.
    pub(super) fn thinnest(&self, vertex: u32) -> f32 {
        let around = self.around[vertex as usize].iter();
        around.map(|&triangle| self.shape(self.triangles[triangle as usize])).fold(f32::INFINITY, f32::min)
    }

    /// The least cosine between a triangle around a vertex and the normals (per vertex) at its corners.
    pub(super) fn least_along(&self, vertex: u32, normals: &[Vec3]) -> f32 {
        let along = |triangle: [u32; 3]| {
            let normal = self.normal(triangle)?;
            Some(triangle.iter().map(|&corner| normals[corner as usize].dot(normal)).fold(1.0, f32::min))
        };
        self.triangles_of(vertex).filter_map(along).fold(1.0, f32::min)
    }

    /// Whether there is a triangle with these vertices, in any order.
    pub(super) fn has(&self, [a, b, c]: [u32; 3]) -> bool {
        self.triangles_of(a).any(|triangle| triangle.contains(&b) && triangle.contains(&c))
    }

    fn triangles_of(&self, vertex: u32) -> impl Iterator<Item = [u32; 3]> {
        self.around[vertex as usize].iter().map(|&triangle| self.triangles[triangle as usize])
    }

    /// None where surface around a vertex is no disc, nor half of one.
    pub(super) fn ring(&self, vertex: u32) -> Option<Ring> {
        let around = &self.around[vertex as usize];
        if around.is_empty() || around.len() > MOST_AROUND {
            return None;
        }
        let edge = |[a, b, c]: [u32; 3]| {
            if a == vertex {
                (b, c)
            } else if b == vertex {
                (c, a)
            } else {
                (a, b)
            }
        };
        let edges: Vec<(u32, u32)> = self.triangles_of(vertex).map(edge).collect();
        let mut starts = edges.iter().map(|edge| edge.0).filter(|start| edges.iter().all(|edge| edge.1 != *start));
        let (start, other) = (starts.next(), starts.next());
        let (first, is_closed) = (start.unwrap_or(edges[0].0), start.is_none());
        let mut vertices = vec![first];
        while let Some((_, next)) = edges.iter().find(|edge| edge.0 == vertices[vertices.len() - 1]) {
            if *next == first || vertices.len() > edges.len() {
                break;
            }
            vertices.push(*next);
        }
        let met = if is_closed { vertices.len() } else { vertices.len() - 1 };
        let least = if is_closed { 3 } else { 2 };
        if vertices.iter().any(|&other| self.around[other as usize].len() > VERY_MANY) {
            return None;
        }
        let is_disc = other.is_none() && met == edges.len() && vertices.len() >= least;
        is_disc.then_some(Ring { vertices, is_closed })
    }

    /// Whether the surface stays one when a vertex moves onto one of its ring: no other triangle joins that one with the
    /// rest of the ring.
    pub(super) fn can_collapse(&self, vertex: u32, ring: &Ring, onto: usize) -> bool {
        let count = ring.vertices.len();
        let target = ring.vertices[onto];
        let is_beside = |k: usize| {
            (k + 1) % count == onto && (ring.is_closed || onto > 0)
                || (onto + 1) % count == k && (ring.is_closed || k > 0)
        };
        let others = || self.triangles_of(target).filter(|triangle| !triangle.contains(&vertex));
        let is_free =
            |k: usize| k == onto || is_beside(k) || others().all(|triangle| !triangle.contains(&ring.vertices[k]));
        (0..count).all(is_free)
    }

    /// Moves a vertex onto one of its ring. What it and its triangles stood for, those that are left take over.
    pub(super) fn collapse(&mut self, vertex: u32, ring: &Ring, onto: usize) {
        let target = ring.vertices[onto];
        let mut homeless = vec![vertex];
        let mut left = Vec::new();
        for index in std::mem::take(&mut self.around[vertex as usize]) {
            homeless.append(&mut self.taken[index as usize]);
            let triangle = self.triangles[index as usize];
            if triangle.contains(&target) {
                self.triangles[index as usize] = GONE;
                for other in triangle.into_iter().filter(|&other| other != vertex) {
                    self.around[other as usize].retain(|&kept| kept != index);
                }
            } else {
                self.triangles[index as usize] = triangle.map(|v| if v == vertex { target } else { v });
                self.around[target as usize].push(index);
                left.push(index);
            }
        }
        for vertex in homeless {
            let point = self.position(vertex);
            let inside = |index: u32| {
                weights(point, self.corners(self.triangles[index as usize])).into_iter().fold(1.0, f64::min)
            };
            let best = left.iter().copied().max_by(|&a, &b| inside(a).total_cmp(&inside(b)));
            let Some(best) = best else { continue };
            self.places[vertex as usize] = best;
            self.taken[best as usize].push(vertex);
        }
    }

    /// Has a vertex read the element of another.
    pub(super) fn stand_in(&mut self, vertex: u32, other: u32) {
        self.stand_ins[vertex as usize] = other;
    }

    /// The vertices that a triangle took the place of.
    pub(super) fn taken_by(&self, triangle: u32) -> &[u32] {
        &self.taken[triangle as usize]
    }

    /// Middle and normal of a triangle.
    pub(super) fn center(&self, triangle: u32) -> Option<(Vec3, Vec3)> {
        let corners = self.triangles[triangle as usize];
        Some((self.corners(corners).iter().sum::<Vec3>() / 3.0, self.normal(corners)?))
    }

    /// Vertices that are joined by triangles, and these, of every piece of surface; in an order that depends on nothing but
    /// the mesh.
    pub(super) fn pieces(&self) -> Vec<(Vec<u32>, Vec<u32>)> {
        let (mut is_met, mut is_known) = (vec![false; self.positions.len()], vec![false; self.triangles.len()]);
        let mut pieces = Vec::new();
        for first in self.triangles.iter().filter(|triangle| **triangle != GONE).map(|triangle| triangle[0]) {
            if std::mem::replace(&mut is_met[first as usize], true) {
                continue;
            }
            let (mut vertices, mut triangles, mut next) = (vec![first], Vec::new(), 0);
            while let Some(&vertex) = vertices.get(next) {
                for &triangle in &self.around[vertex as usize] {
                    if std::mem::replace(&mut is_known[triangle as usize], true) {
                        continue;
                    }
                    triangles.push(triangle);
                    for other in self.triangles[triangle as usize] {
                        if !std::mem::replace(&mut is_met[other as usize], true) {
                            vertices.push(other);
                        }
                    }
                }
                next += 1;
            }
            pieces.push((vertices, triangles));
        }
        pieces
    }

    /// What every vertex reads.
    pub(super) fn reads(&self) -> Vec<Read> {
        let element = |vertex: u32| self.stand_ins[vertex as usize];
        let read = |vertex: u32| {
            let vertex = self.leader(vertex);
            let triangle = match self.places[vertex as usize] {
                NONE => return Read::own(element(vertex)),
                place => self.triangles[place as usize],
            };
            let inside = weights(self.position(vertex), self.corners(triangle)).map(|weight| weight.max(0.0));
            let sum: f64 = inside.iter().sum();
            let elements = triangle.map(element);
            if elements == [elements[0]; 3] {
                return Read::own(elements[0]);
            }
            Read { elements, weights: inside.map(|weight| (weight / sum) as f32) }
        };
        (0..self.positions.len() as u32).map(read).collect()
    }
}

/// Weights of the corners of a triangle at the point of its plane nearest to one; of sum 1, and negative outside.
fn weights(point: Vec3, corners: [Vec3; 3]) -> [f64; 3] {
    let [a, b, c] = corners.map(|corner| (corner - point).as_dvec3());
    let n = (b - a).cross(c - a);
    let part = |p: DVec3, q: DVec3| p.cross(q).dot(n) / n.length_squared();
    [part(b, c), part(c, a), part(a, b)]
}
