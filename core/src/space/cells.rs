//! The layout of elements on a surface: every triangle of it is divided into cells, at whose corners the elements are,
//! and the cell of a point is found by descent.
//!
//! A division is a tree. Its nodes hold the elements that they add and where on the edges these lie; the corners of a
//! cell are known at the end of the descent and are stored nowhere.

use glam::Vec3;
use rayon::prelude::*;

use super::reads::Read;
use crate::surface::Surface;

/// In place of a node: there is none, and the triangle is a cell.
pub(super) const NONE: u32 = u32::MAX;

/// Patches that are worth a task each.
const TASKS: usize = 256;

/// The cells of one side of a surface.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cells {
    /// Per triangle of the surface.
    pub(super) roots: Vec<Root>,
    pub(super) nodes: Vec<Node>,
    /// Of all strips; behind the last of a strip comes one more, at its tip.
    pub(super) cuts: Vec<Cut>,
    /// Per corner of cells, what it reads where some are no elements; empty where every corner is one.
    pub(super) reads: Vec<Read>,
    /// How many cells there are.
    pub(super) count: u32,
}

/// A triangle of the surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Root {
    /// Elements.
    pub corners: [u32; 3],
    pub node: u32,
}

/// A triangle `abc` that is divided. Corners are those of the descent.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node {
    pub kind: Kind,
    /// Bit k: child k is a cell.
    pub cells: u8,
    /// The first child that is not; such children lie side by side.
    pub child: u32,
    /// Elements on the edges, and how far along them. `Four`: on ab, bc, ca. `Two`: on the first edge, alone. `Strip`:
    /// the first cut, and how many there are.
    pub points: [u32; 3],
    pub fractions: [f32; 3],
}

/// How a triangle is divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Points m, n, o on all edges: amo, mbn, onc, mno.
    Four,
    /// Four, with m, n and o in the middle of their edges.
    Halves,
    /// A point m on one edge, of the corners turned by so many: amc, mbc.
    Two(u8),
    /// A triangle with a short edge, of the corners turned by so many: cut across, from the short edge ca to the corner
    /// b.
    Strip(u8),
}

/// From the edge ab to the edge cb of a strip, and the piece that begins here: it has the next cut's new end as third
/// corner.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cut {
    /// How far along ab and cb.
    pub s: f32,
    pub t: f32,
    /// Elements there.
    pub p: u32,
    pub q: u32,
    /// Where the piece is divided.
    pub node: u32,
}

/// Where a point of a surface lies among its elements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Location {
    /// The cell.
    pub cell: u32,
    /// Elements at its corners, or those that count most there.
    pub elements: [u32; 3],
    /// Barycentric weights, not negative, of sum 1.
    pub weights: [f32; 3],
}

/// A triangle on the way to its cells.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Patch {
    /// The cell, where it is one.
    pub cell: u32,
    /// Triangle of the surface.
    pub face: u32,
    /// Elements at the corners. Where some of the surface's corners are none: those that count most, in no order.
    pub elements: [u32; 3],
    /// What its corners are numbered, elements or not.
    pub(super) points: [u32; 3],
    /// Counter-clockwise from the front, scene space.
    pub corners: [Vec3; 3],
    node: u32,
}

impl Node {
    /// The node of a child, or [`NONE`].
    #[inline]
    fn child(&self, k: u32) -> u32 {
        let divided = !self.cells;
        if divided >> k & 1 == 0 { NONE } else { self.child + (divided & ((1 << k) - 1)).count_ones() }
    }
}

impl Cells {
    /// Ids of cells are below this; not all of them are in use.
    pub(crate) fn ids(&self) -> u32 {
        (self.roots.len() + 4 * self.nodes.len() + self.cuts.len()) as u32
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.roots.capacity() * size_of::<Root>()
            + self.nodes.capacity() * size_of::<Node>()
            + self.cuts.capacity() * size_of::<Cut>()
            + self.reads.capacity() * size_of::<Read>()
    }

    /// Gives every element its new number, by old number.
    pub(super) fn renumber(&mut self, number: &[u32]) {
        let renumber = |element: &mut u32| {
            if *element != NONE {
                *element = number[*element as usize];
            }
        };
        self.roots.iter_mut().flat_map(|root| &mut root.corners).for_each(renumber);
        let nodes = self.nodes.iter_mut().filter(|node| !matches!(node.kind, Kind::Strip(_)));
        nodes.flat_map(|node| &mut node.points).for_each(renumber);
        self.cuts.iter_mut().flat_map(|cut| [&mut cut.p, &mut cut.q]).for_each(renumber);
    }

    #[inline]
    fn id_of_child(&self, node: u32, k: u32) -> u32 {
        self.roots.len() as u32 + 4 * node + k
    }

    fn id_of_piece(&self, cut: u32) -> u32 {
        (self.roots.len() + 4 * self.nodes.len()) as u32 + cut
    }

    /// The cell of a point of a triangle, given by its barycentric weights.
    #[inline]
    pub(crate) fn locate(&self, face: u32, mut weights: [f32; 3]) -> Location {
        let root = &self.roots[face as usize];
        let (mut cell, mut node, mut elements) = (face, root.node, root.corners);
        while node != NONE {
            let divided = &self.nodes[node as usize];
            let k;
            (k, elements, weights) = match divided.kind {
                Kind::Halves => in_halves(divided.points, elements, weights),
                Kind::Four => in_four(divided, elements, weights),
                Kind::Two(turn) => in_two(divided, turned(elements, turn), turned(weights, turn)),
                Kind::Strip(turn) => {
                    let cut;
                    (cut, elements, weights) = self.in_strip(divided, turned(weights, turn));
                    (cell, node) = (self.id_of_piece(cut), self.cuts[cut as usize].node);
                    continue;
                }
            };
            (cell, node) = (self.id_of_child(node, k), divided.child(k));
        }
        if self.reads.is_empty() {
            return Location { cell, elements, weights: normalized(weights) };
        }
        let Read { elements, weights } = self.mix(elements, weights);
        Location { cell, elements, weights }
    }

    /// The cut where the piece of a point begins, its corners and the point's weights among them.
    fn in_strip(&self, node: &Node, [a, b, c]: [f32; 3]) -> (u32, [u32; 3], [f32; 3]) {
        let [first, count, _] = node.points;
        let cuts = &self.cuts[first as usize..=(first + count) as usize];
        // Negative towards the tip b.
        let side = |cut: &Cut| (1.0 - cut.s) * (cut.t * c - (1.0 - cut.t) * b) + cut.s * (1.0 - cut.t) * a;
        let k = cuts[1..count as usize].partition_point(|cut| side(cut) <= 0.0);
        let (cut, next) = (&cuts[k], &cuts[k + 1]);
        // The corner on the edge of which this piece has no part has its weight from the third coordinate alone; what
        // is left lies on the other edge.
        let along = |far: f32, other: f32, middle: f32, at: f32, from: f32, to: f32| {
            let alone = if at < 1.0 { far / (1.0 - at) } else { 0.0 };
            let (rest, here) = (other + middle - alone * at, middle - alone * at);
            let end = (here - rest * from) / (to - from);
            (alone, rest - end, end)
        };
        let (corners, weights) = if next.p != cut.p {
            let (q, from, to) = along(c, a, b, cut.t, cut.s, next.s);
            ([cut.p, next.p, cut.q], [from, to, q])
        } else {
            let (p, from, to) = along(a, c, b, cut.s, cut.t, next.t);
            ([cut.p, next.q, cut.q], [p, to, from])
        };
        (first + k as u32, corners, weights)
    }

    /// A triangle of a surface.
    fn face(&self, surface: &Surface, face: u32) -> Patch {
        let (root, corners) = (&self.roots[face as usize], surface.corners(face as usize));
        Patch { cell: face, face, elements: root.corners, points: root.corners, corners, node: root.node }
    }

    /// A cell with its elements: those that count most where some of its corners are none.
    fn resolved(&self, mut patch: Patch) -> Patch {
        if !self.reads.is_empty() {
            patch.elements = self.mix(patch.points, [1.0 / 3.0; 3]).elements;
        }
        patch
    }

    /// Pushes the children of a patch that is divided.
    fn divide(&self, patch: &Patch, out: &mut Vec<Patch>) {
        let node = &self.nodes[patch.node as usize];
        let child = |k: u32, points, corners| Patch {
            cell: self.id_of_child(patch.node, k),
            face: patch.face,
            elements: points,
            points,
            corners,
            node: node.child(k),
        };
        match node.kind {
            Kind::Four | Kind::Halves => {
                let ([a, b, c], [m, n, o]) = (patch.points, node.points);
                let [x, y, z] = patch.corners;
                let [f, g, h] = node.fractions;
                let (xy, yz, zx) = (x.lerp(y, f), y.lerp(z, g), z.lerp(x, h));
                out.extend([
                    child(0, [a, m, o], [x, xy, zx]),
                    child(1, [m, b, n], [xy, y, yz]),
                    child(2, [o, n, c], [zx, yz, z]),
                    child(3, [m, n, o], [xy, yz, zx]),
                ]);
            }
            Kind::Two(turn) => {
                let ([a, b, c], m) = (turned(patch.points, turn), node.points[0]);
                let [x, y, z] = turned(patch.corners, turn);
                let xy = x.lerp(y, node.fractions[0]);
                out.extend([child(0, [a, m, c], [x, xy, z]), child(1, [m, b, c], [xy, y, z])]);
            }
            Kind::Strip(turn) => {
                let [x, y, z] = turned(patch.corners, turn);
                let [first, count, _] = node.points;
                for at in first..first + count {
                    let (cut, next) = (&self.cuts[at as usize], &self.cuts[at as usize + 1]);
                    let (p, q) = (x.lerp(y, cut.s), z.lerp(y, cut.t));
                    let (element, corner) =
                        if next.p != cut.p { (next.p, x.lerp(y, next.s)) } else { (next.q, z.lerp(y, next.t)) };
                    let (points, corners) = ([cut.p, element, cut.q], [p, corner, q]);
                    let cell = self.id_of_piece(at);
                    out.push(Patch { cell, face: patch.face, elements: points, points, corners, node: cut.node });
                }
            }
        }
    }

    /// What `f` makes of every cell, in an order that depends on nothing but the layout. Triangles on the way to cells
    /// that `is_wanted` refuses are left out, with all cells within.
    pub(crate) fn collect<T: Send>(
        &self,
        surface: &Surface,
        is_wanted: impl Fn(&Patch) -> bool + Sync,
        f: impl Fn(&Patch) -> Option<T> + Sync,
    ) -> Vec<T> {
        let of_cells = |patches: &mut dyn Iterator<Item = Patch>| {
            let (mut stack, mut found) = (Vec::new(), Vec::new());
            for patch in patches {
                stack.push(patch);
                while let Some(patch) = stack.pop() {
                    if !is_wanted(&patch) {
                        continue;
                    }
                    if patch.node == NONE {
                        found.extend(f(&self.resolved(patch)));
                    } else {
                        self.divide(&patch, &mut stack);
                    }
                }
            }
            found
        };
        let faces = 0..self.roots.len() as u32;
        if self.roots.len() >= TASKS {
            let size = self.roots.len().div_ceil(TASKS) as u32;
            let task = |first: u32| first..faces.end.min(first + size);
            let tasks = (0..faces.end.div_ceil(size)).into_par_iter().map(|k| task(k * size));
            return tasks.flat_map_iter(|task| of_cells(&mut task.map(|face| self.face(surface, face)))).collect();
        }
        // Few large triangles are divided until there are enough of them.
        let mut tasks: Vec<Patch> = faces.map(|face| self.face(surface, face)).filter(&is_wanted).collect();
        while tasks.len() < TASKS && tasks.iter().any(|patch| patch.node != NONE) {
            let mut finer = Vec::with_capacity(4 * tasks.len());
            for patch in &tasks {
                if patch.node == NONE { finer.push(*patch) } else { self.divide(patch, &mut finer) }
            }
            finer.retain(&is_wanted);
            tasks = finer;
        }
        let size = tasks.len().div_ceil(TASKS).max(1);
        tasks.par_chunks(size).flat_map_iter(|task| of_cells(&mut task.iter().copied())).collect()
    }
}

impl Patch {
    /// Low and high corner of its box, scene space.
    #[inline]
    pub(crate) fn bounds(&self) -> (Vec3, Vec3) {
        let [a, b, c] = self.corners;
        (a.min(b).min(c), a.max(b).max(c))
    }
}

/// The corners, or what belongs to them, turned by so many.
#[inline]
pub(super) fn turned<T: Copy>([a, b, c]: [T; 3], turn: u8) -> [T; 3] {
    match turn {
        0 => [a, b, c],
        1 => [b, c, a],
        _ => [c, a, b],
    }
}

/// Which child a point lies in, its corners and the point's weights among them.
type Child = (u32, [u32; 3], [f32; 3]);

#[inline]
fn in_halves([m, n, o]: [u32; 3], [a, b, c]: [u32; 3], [x, y, z]: [f32; 3]) -> Child {
    let (u, v, w) = (x + x, y + y, z + z);
    if u >= 1.0 {
        (0, [a, m, o], [u - 1.0, v, w])
    } else if v >= 1.0 {
        (1, [m, b, n], [u, v - 1.0, w])
    } else if w >= 1.0 {
        (2, [o, n, c], [u, v, w - 1.0])
    } else {
        (3, [m, n, o], [1.0 - w, 1.0 - u, 1.0 - v])
    }
}

#[inline]
fn in_four(node: &Node, [a, b, c]: [u32; 3], [x, y, z]: [f32; 3]) -> Child {
    let ([m, n, o], [f, g, h]) = (node.points, node.fractions);
    let (f1, g1, h1) = (1.0 - f, 1.0 - g, 1.0 - h);
    let (am, ao) = (y / f, z / h1);
    if am + ao <= 1.0 {
        return (0, [a, m, o], [1.0 - am - ao, am, ao]);
    }
    let (bm, bn) = (x / f1, z / g);
    if bm + bn <= 1.0 {
        return (1, [m, b, n], [bm, 1.0 - bm - bn, bn]);
    }
    let (cn, co) = (y / g1, x / h);
    if cn + co <= 1.0 {
        return (2, [o, n, c], [co, cn, 1.0 - cn - co]);
    }
    // x = (1 − f) m + h o, y = f m + (1 − g) n, z = g n + (1 − h) o, by Cramer's rule.
    let scale = 1.0 / (f1 * g1 * h1 + f * g * h);
    let to_m = x * g1 * h1 + h * (y * g - g1 * z);
    let to_n = f1 * h1 * y - f * h1 * x + f * h * z;
    let to_o = f1 * g1 * z - f1 * g * y + f * g * x;
    (3, [m, n, o], [to_m * scale, to_n * scale, to_o * scale])
}

#[inline]
fn in_two(node: &Node, [a, b, c]: [u32; 3], [x, y, z]: [f32; 3]) -> Child {
    let (m, f) = (node.points[0], node.fractions[0]);
    let to_a = x - y * (1.0 - f) / f;
    if to_a >= 0.0 {
        (0, [a, m, c], [to_a, y / f, z])
    } else {
        (1, [m, b, c], [x / (1.0 - f), y - x * f / (1.0 - f), z])
    }
}

/// Rounding may leave a weight below zero, and of nothing but rounding there is nothing left.
#[inline]
fn normalized(weights: [f32; 3]) -> [f32; 3] {
    let [a, b, c] = weights.map(|w| w.max(0.0));
    let sum = a + b + c;
    if sum > 0.0 && sum.is_finite() { [a / sum, b / sum, c / sum] } else { [1.0, 0.0, 0.0] }
}
