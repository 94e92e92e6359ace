//! Borders: where surfaces of two objects touch and go on as one, as the tiles of a floor do, look-ups on either side are to
//! find the same. Each side holds the light of its own elements; what both are drawn to is the mean of the two.

use std::collections::BTreeSet;
use std::ops::Range;

use glam::{Vec2, Vec3};

use super::seams::look_ups;
use super::{Place, Side, light_of};
use crate::hash::FastMap;
use crate::surface::{Surface, geometric_normal};
use crate::world::World;

/// How far apart edges that touch may be, texels.
const GAP: f32 = 0.1;

/// Least cosine between the normals of surfaces that are one.
const SMOOTH: f32 = 0.97;

/// Greatest cosine between edges that run beside each other: of surfaces with the same front they run in opposite directions.
const OPPOSITE: f32 = -0.999;

/// Edge of the cells that edges are found by, texels.
const CELL: f32 = 16.0;

/// Edges that are longer than so many cells are found by fewer of them.
const MOST_CELLS: usize = 1024;

/// An edge that no other triangle of its object has.
#[derive(Clone, Copy)]
struct Edge {
    object: u32,
    face: u32,
    /// It goes from this corner of the triangle to the next.
    corner: u8,
    /// Scene space.
    ends: [Vec3; 2],
    normal: Vec3,
}

/// A part of an edge along which another object goes on.
pub(super) struct Border {
    /// Both ends on this object.
    pub here: [Place; 2],
    /// The other object, by its position in the scene.
    pub object: usize,
    /// Both ends there.
    pub there: [Place; 2],
}

/// The edges of all objects.
pub(super) struct Borders {
    edges: Vec<Edge>,
    /// Edges of each object.
    of_object: Vec<Range<usize>>,
    cells: FastMap<[i32; 3], Vec<u32>>,
    /// m
    cell: f32,
    gap: f32,
}

impl Borders {
    /// Of all objects of a world that have places on an atlas of so many texels per metre.
    pub(super) fn new(world: &World, texels_per_metre: f32) -> Borders {
        let (cell, gap) = (CELL / texels_per_metre, GAP / texels_per_metre);
        let mut borders = Borders { edges: Vec::new(), of_object: Vec::new(), cells: FastMap::default(), cell, gap };
        if world.placed.len() < 2 {
            return borders;
        }
        let bounds: Vec<(Vec3, Vec3)> = world.placed.iter().map(|placed| placed.surface.bounds()).collect();
        let touches = |a: usize, b: usize| {
            let ((low, high), (other_low, other_high)) = (bounds[a], bounds[b]);
            a != b && (low - gap).cmple(other_high).all() && (other_low - gap).cmple(high).all()
        };
        for (object, placed) in world.placed.iter().enumerate() {
            let first = borders.edges.len();
            if (0..bounds.len()).any(|other| touches(object, other)) {
                borders.edges.extend(open_edges(&placed.surface, object as u32));
            }
            borders.of_object.push(first..borders.edges.len());
        }
        for index in 0..borders.edges.len() {
            for key in borders.keys(borders.edges[index].ends) {
                borders.cells.entry(key).or_default().push(index as u32);
            }
        }
        borders
    }

    /// As if no objects touched.
    #[cfg(test)]
    pub(super) fn none() -> Borders {
        Borders { edges: Vec::new(), of_object: Vec::new(), cells: FastMap::default(), cell: 1.0, gap: 0.0 }
    }

    /// Cells that an edge passes.
    fn keys(&self, [from, to]: [Vec3; 2]) -> BTreeSet<[i32; 3]> {
        let steps = ((2.0 * from.distance(to) / self.cell).ceil() as usize).clamp(1, MOST_CELLS);
        let key = |k: usize| (from.lerp(to, k as f32 / steps as f32) / self.cell).floor().as_ivec3().to_array();
        (0..=steps).map(key).collect()
    }

    /// Where other objects go on where one ends.
    pub(super) fn of(&self, object: usize) -> Vec<Border> {
        let Some(own) = self.of_object.get(object) else { return Vec::new() };
        self.edges[own.clone()].iter().flat_map(|edge| self.beside(edge)).collect()
    }

    fn beside(&self, edge: &Edge) -> Vec<Border> {
        let mut near = BTreeSet::new();
        for key in self.keys(edge.ends) {
            let around = (0..27).map(|k| [key[0] + k % 3 - 1, key[1] + k / 3 % 3 - 1, key[2] + k / 9 - 1]);
            near.extend(around.filter_map(|key| self.cells.get(&key)).flatten());
        }
        near.into_iter().filter_map(|&other| edge.shared_with(&self.edges[other as usize], self.gap)).collect()
    }
}

impl Edge {
    /// The part that lies on an edge of another object, whose surface goes on there.
    fn shared_with(&self, other: &Edge, gap: f32) -> Option<Border> {
        let [a, b] = self.ends;
        let [p, q] = other.ends;
        let (along, length) = ((b - a).try_normalize()?, a.distance(b));
        let is_one = self.object != other.object
            && self.normal.dot(other.normal) >= SMOOTH
            && along.dot((q - p).try_normalize()?) <= OPPOSITE;
        let is_beside = |point: Vec3| (point - a).reject_from_normalized(along).length() <= gap;
        if !(is_one && is_beside(p) && is_beside(q)) {
            return None;
        }
        // The other one begins where this one ends.
        let [first, last] = [q, p].map(|point| ((point - a).dot(along) / length).clamp(0.0, 1.0));
        let to_other = |t: f32| ((a.lerp(b, t) - p).dot(q - p) / p.distance_squared(q)).clamp(0.0, 1.0);
        (last - first > 1e-4).then(|| Border {
            here: [first, last].map(|t| self.place(t)),
            object: other.object as usize,
            there: [first, last].map(|t| other.place(to_other(t))),
        })
    }

    fn place(&self, t: f32) -> Place {
        let mut weights = [0.0; 3];
        (weights[self.corner as usize], weights[(self.corner as usize + 1) % 3]) = (1.0 - t, t);
        Place { face: self.face, weights: [weights[1], weights[2]] }
    }
}

/// The edges of a surface that only one of its triangles has.
fn open_edges(surface: &Surface, object: u32) -> Vec<Edge> {
    let corners = |face: usize| (0..3).map(move |k| (face, k, (k + 1) % 3));
    let all = || (0..surface.triangles.len()).flat_map(corners);
    let mut counts: FastMap<(u32, u32), u32> = FastMap::default();
    let key = |face: usize, from: usize, to: usize| {
        let [a, b] = [from, to].map(|k| surface.triangles[face][k]);
        (a.min(b), a.max(b))
    };
    all().for_each(|(face, from, to)| *counts.entry(key(face, from, to)).or_default() += 1);
    let edge = |(face, from, to): (usize, usize, usize)| {
        let places = surface.corners(face);
        let [a, b, c] = places;
        let normal = geometric_normal(a, b, c).filter(|_| counts[&key(face, from, to)] == 1)?;
        Some(Edge { object, face: face as u32, corner: from as u8, ends: [places[from], places[to]], normal })
    };
    all().filter_map(edge).collect()
}

/// What look-ups along the borders of one side of an object are to find: places on its rectangle, texels, and values.
pub(super) fn targets(world: &World, side: &Side, borders: &[Border], values: &[Vec3]) -> Vec<(Vec2, Vec3)> {
    let mut targets = Vec::new();
    for Border { here, object, there } in borders {
        if side.is_back && !world.placed[*object].with_back {
            continue;
        }
        let ends = here.map(|place| side.on_rectangle(world, &place));
        let count = look_ups(ends[0].distance(ends[1]));
        for k in 0..=count {
            let t = k as f32 / count as f32;
            let own = side.light(world, &here[0].towards(&here[1], t), values);
            let other = light_of(world, (*object, side.is_back), &there[0].towards(&there[1], t), values);
            if let (Some(own), Some(other)) = (own, other) {
                targets.push((ends[0].lerp(ends[1], t), 0.5 * (own + other)));
            }
        }
    }
    targets
}
