//! Borders: where surfaces of two objects touch and go on as one, as the tiles of a floor do, look-ups on either side are to
//! find the same. Each side holds the light of its own elements; what both are drawn to is the mean of the two.

use std::collections::BTreeSet;
use std::sync::Arc;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::seams::look_ups;
use super::{Place, Side, light_of};
use crate::hash::FastMap;
use crate::surface::{Surface, geometric_normal};
use crate::world::{Placed, World};

/// How far apart edges that touch may be, texels.
const GAP: f32 = 0.1;

/// Least cosine between the normals of surfaces that are one.
const SMOOTH: f32 = 0.97;

/// Greatest cosine between edges that run beside each other: of surfaces with the same front they run in opposite directions.
const OPPOSITE: f32 = -0.999;

/// Edges shorter than this, in texels, change nothing that can be seen.
const SHORTEST: f32 = 0.5;

/// An edge that no other triangle of its object has.
#[derive(Clone, Copy)]
struct Edge {
    object: u32,
    face: u32,
    /// It goes from this corner of the triangle to the next.
    corner: u8,
    /// Scene space.
    ends: [Vec3; 2],
    /// m
    length: f32,
    /// Of its triangle.
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

/// Where objects of a world go on in others.
pub(super) struct Borders {
    of_object: Vec<Vec<Border>>,
}

/// Open edges by cells as large as they are long: each passes few of its own size.
struct Grid {
    edges: Vec<Edge>,
    /// By the power of two that is the edge of cells (m), and place.
    cells: FastMap<(i32, [i32; 3]), Vec<u32>>,
    /// Powers that there are.
    levels: BTreeSet<i32>,
    /// How far apart edges may be that touch, m.
    gap: f32,
}

impl Borders {
    /// Of all objects of a world that have places on an atlas of so many texels per metre.
    pub(super) fn new(world: &World, texels_per_metre: f32) -> Borders {
        let grid = Grid::new(world, texels_per_metre);
        let pairs: Vec<(u32, u32)> =
            (0..grid.edges.len() as u32).into_par_iter().flat_map_iter(|edge| grid.beside(edge)).collect();
        let mut of_object: Vec<Vec<Border>> = world.placed.iter().map(|_| Vec::new()).collect();
        for [a, b] in pairs.into_iter().flat_map(|(a, b)| [[a, b], [b, a]]) {
            let [edge, other] = [a, b].map(|index| &grid.edges[index as usize]);
            of_object[edge.object as usize].extend(edge.shared_with(other, grid.gap));
        }
        Borders { of_object }
    }

    /// Where other objects go on where one ends.
    pub(super) fn of(&self, object: usize) -> &[Border] {
        &self.of_object[object]
    }

    /// As if no objects of so many touched.
    #[cfg(test)]
    pub(super) fn none(objects: usize) -> Borders {
        Borders { of_object: (0..objects).map(|_| Vec::new()).collect() }
    }
}

impl Grid {
    fn new(world: &World, texels_per_metre: f32) -> Grid {
        let (gap, shortest) = (GAP / texels_per_metre, SHORTEST / texels_per_metre);
        let mut grid = Grid { edges: Vec::new(), cells: FastMap::default(), levels: BTreeSet::new(), gap };
        if world.placed.len() < 2 {
            return grid;
        }
        let of_object = |(object, placed): (usize, &Arc<Placed>)| open_edges(&placed.surface, object as u32, shortest);
        grid.edges = world.placed.par_iter().enumerate().flat_map_iter(of_object).collect();
        for (edge, index) in grid.edges.iter().zip(0..) {
            let (level, [a, b]) = (edge.level(), edge.ends);
            grid.levels.insert(level);
            let [low, high] = [a.min(b) - gap, a.max(b) + gap].map(|at| cell(level, at));
            let along = |axis: usize| low[axis]..=high[axis];
            let keys = along(0).flat_map(|x| along(1).flat_map(move |y| along(2).map(move |z| [x, y, z])));
            keys.for_each(|key| grid.cells.entry((level, key)).or_default().push(index));
        }
        grid
    }

    /// Pairs of an edge with others, which are no shorter, that have some part in common: an end of the shorter one lies on
    /// the other then.
    fn beside(&self, index: u32) -> Vec<(u32, u32)> {
        let edge = &self.edges[index as usize];
        let is_pair = |&other: &u32| {
            let known = &self.edges[other as usize];
            (known.length, other) > (edge.length, index) && edge.shared_with(known, self.gap).is_some()
        };
        let keys = self.levels.range(edge.level()..).flat_map(|&level| edge.ends.map(|end| (level, cell(level, end))));
        let near = keys.filter_map(|key| self.cells.get(&key)).flatten().copied();
        let found: BTreeSet<u32> = near.filter(is_pair).collect();
        found.into_iter().map(|other| (index, other)).collect()
    }
}

/// The cell of a level that a point lies in.
fn cell(level: i32, at: Vec3) -> [i32; 3] {
    // `as` saturates.
    (at / 2.0_f32.powi(level)).floor().to_array().map(|x| x as i32)
}

impl Edge {
    /// The power of two, in metres, that it is not longer than.
    fn level(&self) -> i32 {
        self.length.log2().ceil() as i32
    }

    /// The part that lies on an edge of another object, whose surface goes on there.
    fn shared_with(&self, other: &Edge, gap: f32) -> Option<Border> {
        let [a, b] = self.ends;
        let [p, q] = other.ends;
        let (along, length) = ((b - a).try_normalize()?, self.length);
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

/// The edges of a surface, but for `shortest` (m) and shorter ones, that only one of its triangles has.
fn open_edges(surface: &Surface, object: u32, shortest: f32) -> Vec<Edge> {
    let corners = |face: usize| (0..3).map(move |k| (face, k, (k + 1) % 3));
    let all = || (0..surface.triangles.len()).flat_map(corners);
    let mut counts: FastMap<(u32, u32), u32> = FastMap::default();
    let key = |face: usize, from: usize, to: usize| {
        let [a, b] = [from, to].map(|k| surface.triangles[face][k]);
        (a.min(b), a.max(b))
    };
    all().for_each(|(face, from, to)| *counts.entry(key(face, from, to)).or_default() += 1);
    let edge = |(face, from, to): (usize, usize, usize)| {
        let places @ [a, b, c] = surface.corners(face);
        let ends = [places[from], places[to]];
        let length = ends[0].distance(ends[1]);
        if length <= shortest || counts[&key(face, from, to)] > 1 {
            return None;
        }
        let normal = geometric_normal(a, b, c)?;
        Some(Edge { object, face: face as u32, corner: from as u8, ends, length, normal })
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Pcg32;
    use crate::scene::{Material, Mesh, Object, Scene};
    use crate::world::WorldOptions;

    /// Tiles of many sizes on one floor, some of which touch: those are found that a look at all pairs finds.
    #[test]
    fn borders_are_those_of_all_pairs() {
        let mut rng = Pcg32::new(3, 1);
        let mut of = |count: u32| (rng.next_u32() % count) as f32;
        let tile = |name: usize| {
            let (x, z, size) = (0.25 * of(20), 0.25 * of(20), 0.25 * 2.0_f32.powi(of(4) as i32 - 1));
            let mesh = Mesh::quad(Vec3::new(x, 0.0, z), Vec3::Z * size, Vec3::X * size);
            Object::new(name.to_string(), mesh, Material::diffuse(Vec3::splat(0.5)))
        };
        let scene = Scene::from_objects((0..60).map(tile).collect());
        let world = World::new(scene, &WorldOptions { spacing: Some(0.5), ..WorldOptions::default() }).expect("tiles");
        let (borders, grid) = (Borders::new(&world, 20.0), Grid::new(&world, 20.0));
        let told = |border: &Border| {
            let places = [border.here, border.there].map(|ends| ends.map(|at| (at.face, at.weights.map(f32::to_bits))));
            (border.object, places)
        };
        let mut count = 0;
        for object in 0..60 {
            let of_object = grid.edges.iter().filter(|edge| edge.object == object as u32);
            let all =
                of_object.flat_map(|edge| grid.edges.iter().filter_map(|other| edge.shared_with(other, grid.gap)));
            let all: BTreeSet<_> = all.map(|border| told(&border)).collect();
            assert_eq!(borders.of(object).iter().map(told).collect::<BTreeSet<_>>(), all);
            assert_eq!(borders.of(object).len(), all.len());
            count += all.len();
        }
        assert!(count > 40, "{count}");
    }
}
