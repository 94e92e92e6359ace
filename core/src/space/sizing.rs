//! How far elements lie apart from place to place, where that is not one spacing.
//!
//! The size at a point is the least of many cones, one for each place where a size is wanted. It depends on nothing but
//! the point, so that triangles on both sides of an edge, in one object or in two, get the same answer; and it changes
//! by at most [`SLOPE`] times the distance between two points.

use glam::Vec3;

use crate::hash::FastMap;
use crate::order::{along_curve, in_order};

/// Cones per leaf of the tree over them.
const LEAF: usize = 8;

/// Change of the size over a distance, at most.
const SLOPE: f32 = 0.5;

/// Ways this many times as long as the size at their ends are not looked at within: the size changes little there.
const SHORT: f32 = 2.0;

/// Edge of the cells whose cones are kept together, as part of the largest size.
const CELL: f32 = 0.8;

/// A factor on bounds.
const ROUNDED_DOWN: f32 = 0.9999;

/// A fraction of an edge at which it may be split, and one minus that.
const LEAST_FRACTION: f64 = 0.05;

/// A place where a size is wanted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cone {
    /// Scene space.
    pub at: Vec3,
    /// How far around it, m.
    pub radius: f32,
    /// m
    pub size: f32,
}

impl Cone {
    /// What it says of a place so far away.
    fn size_at(&self, distance: f32) -> f32 {
        self.size + SLOPE * (distance - self.radius).max(0.0)
    }
}

/// A part of a tree of cones: the bounds of their places, and the least that any says of its own.
#[derive(Clone, Copy, Debug)]
struct Node {
    low: Vec3,
    high: Vec3,
    least: f32,
}

impl Node {
    const NONE: Node = Node { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY, least: f32::INFINITY };

    fn with(self, other: Node) -> Node {
        Node { low: self.low.min(other.low), high: self.high.max(other.high), least: self.least.min(other.least) }
    }

    /// No cone in it says less of any point of a box.
    fn bound(&self, (low, high): (Vec3, Vec3)) -> f32 {
        self.least + SLOPE * (self.low - high).max(low - self.high).max(Vec3::ZERO).length()
    }
}

/// Sizes of elements over a scene.
#[derive(Clone, Debug)]
pub(crate) struct Sizing {
    /// Along a curve.
    cones: Vec<Cone>,
    /// Of a full binary tree, from 1; its leaves hold [`LEAF`] cones each.
    nodes: Vec<Node>,
    leaves: usize,
    /// m
    bounds: (f32, f32),
}

impl Sizing {
    /// Sizes that lie within bounds (m): the larger one where no cone says less.
    pub(crate) fn new(cones: &[Cone], bounds: (f32, f32)) -> Sizing {
        let places: Vec<Vec3> = cones.iter().map(|cone| cone.at).collect();
        let mut cones = in_order(cones, &along_curve(&places));
        cones.iter_mut().for_each(|cone| cone.size = cone.size.clamp(bounds.0, bounds.1));
        let leaves = cones.len().div_ceil(LEAF).max(1).next_power_of_two();
        let mut nodes = vec![Node::NONE; 2 * leaves];
        let node = |cone: &Cone| Node { low: cone.at, high: cone.at, least: cone.size - SLOPE * cone.radius };
        for (node_of_leaf, leaf) in nodes[leaves..].iter_mut().zip(cones.chunks(LEAF)) {
            *node_of_leaf = leaf.iter().map(node).fold(Node::NONE, Node::with);
        }
        for k in (1..leaves).rev() {
            nodes[k] = nodes[2 * k].with(nodes[2 * k + 1]);
        }
        Sizing { cones, nodes, leaves, bounds }
    }

    /// m, no size is below.
    pub(crate) fn least(&self) -> f32 {
        self.bounds.0
    }

    /// m, no size is above.
    pub(super) fn largest(&self) -> f32 {
        self.bounds.1
    }

    /// The size at a point, m.
    pub(crate) fn at(&self, point: Vec3) -> f32 {
        let mut size = self.bounds.1;
        self.visit((point, point), &mut size, |cone, size| *size = size.min(cone.size_at(cone.at.distance(point))));
        size
    }

    /// Visits all cones that may say less of some point of a box than `most` does, and perhaps others.
    fn visit(&self, space: (Vec3, Vec3), most: &mut f32, mut f: impl FnMut(&Cone, &mut f32)) {
        // A tree has at most 32 levels, and each leaves one node behind.
        let (mut stack, mut depth) = ([1_usize; 40], 1);
        while depth > 0 {
            depth -= 1;
            let k = stack[depth];
            // Rounding leaves none out that says as little.
            if ROUNDED_DOWN * self.nodes[k].bound(space) > *most {
                continue;
            }
            if k >= self.leaves {
                let first = (k - self.leaves) * LEAF;
                let last = self.cones.len().min(first + LEAF);
                self.cones[first.min(last)..last].iter().for_each(|cone| f(cone, most));
                continue;
            }
            let [left, right] = [2 * k, 2 * k + 1];
            let is_left_near = self.nodes[left].bound(space) <= self.nodes[right].bound(space);
            (stack[depth], stack[depth + 1]) = if is_left_near { (right, left) } else { (left, right) };
            depth += 2;
        }
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.cones.capacity() * size_of::<Cone>() + self.nodes.capacity() * size_of::<Node>()
    }
}

/// Asks for sizes at many points, and keeps what answers for those beside each other.
pub(super) struct Sizes<'s> {
    sizing: &'s Sizing,
    /// Cubes of space, to their cones in `cones`.
    cells: FastMap<u64, (u32, u32)>,
    cones: Vec<Cone>,
    edge: f32,
}

/// An end of a way: where it is, and the size there, m.
pub(super) type End = (Vec3, f32);

impl<'s> Sizes<'s> {
    pub(super) fn new(sizing: &'s Sizing) -> Sizes<'s> {
        Sizes { sizing, cells: FastMap::default(), cones: Vec::new(), edge: CELL * sizing.bounds.1 }
    }

    /// [`Sizing::at`], bit for bit.
    pub(super) fn at(&mut self, point: Vec3) -> f32 {
        let cell = (point / self.edge).floor();
        // 21 bits per axis; cells that share a key would only mix what they know, so the key is not enough far out.
        let key = cell.to_array().map(|c| c as i64);
        if key.iter().any(|c| c.unsigned_abs() >= 1 << 20) {
            return self.sizing.at(point);
        }
        let [x, y, z] = key.map(|c| (c + (1 << 20)) as u64);
        let (first, last) = match self.cells.get(&(x << 42 | y << 21 | z)) {
            Some(known) => *known,
            None => {
                let known = self.of_cell(cell);
                self.cells.insert(x << 42 | y << 21 | z, known);
                known
            }
        };
        let of = |size: f32, cone: &Cone| size.min(cone.size_at(cone.at.distance(point)));
        self.cones[first as usize..last as usize].iter().fold(self.sizing.bounds.1, of)
    }

    /// Finds the cones that count in a cube.
    fn of_cell(&mut self, cell: Vec3) -> (u32, u32) {
        let first = self.cones.len() as u32;
        // A little larger than it is: rounding leaves no point outside.
        let margin = Vec3::splat(1e-3 * self.edge);
        let space = (cell * self.edge - margin, (cell + 1.0) * self.edge + margin);
        let middle = (space.0 + space.1) * 0.5;
        let half = 0.5 * (space.1 - space.0).length();
        let mut most = 1.001 * (self.sizing.at(middle) + SLOPE * half);
        let cones = &mut self.cones;
        self.sizing.visit(space, &mut most, |cone, most| {
            let outside = (space.0 - cone.at).max(cone.at - space.1).max(Vec3::ZERO).length();
            if cone.size_at(outside) <= *most {
                cones.push(*cone);
            }
        });
        (first, self.cones.len() as u32)
    }

    /// How many elements lie apart along a way: the integral of the distance over the size.
    pub(super) fn length(&mut self, a: End, b: End) -> f64 {
        match self.middle(a, b) {
            None => f64::from(a.0.distance(b.0)) * 0.5 * (1.0 / f64::from(a.1) + 1.0 / f64::from(b.1)),
            Some(middle) => self.length(a, middle) + self.length(middle, b),
        }
    }

    /// The middle of a way that has to be looked at within.
    fn middle(&mut self, (a, size_a): End, (b, size_b): End) -> Option<End> {
        if a.distance(b) <= SHORT * size_a.min(size_b) {
            return None;
        }
        let middle = a.as_dvec3().lerp(b.as_dvec3(), 0.5).as_vec3();
        (middle != a && middle != b).then(|| (middle, self.at(middle)))
    }

    /// How far along a way a share of its [`Sizes::length`] ends, as part of the distance.
    pub(super) fn fraction(&mut self, mut a: End, mut b: End, share: f64) -> f64 {
        let (mut from, mut to) = (0.0, 1.0);
        let mut left = share * self.length(a, b);
        while let Some(middle) = self.middle(a, b) {
            let first = self.length(a, middle);
            let half = 0.5 * (from + to);
            if left <= first {
                (b, to) = (middle, half);
            } else {
                (a, from, left) = (middle, half, left - first);
            }
        }
        let within = (left / self.length(a, b)).clamp(0.0, 1.0);
        (from + (to - from) * within).clamp(LEAST_FRACTION, 1.0 - LEAST_FRACTION)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Pcg32;

    fn cones(count: u32) -> Vec<Cone> {
        let mut rng = Pcg32::new(3, 1);
        let mut number = move |scale: f32| scale * rng.next_f32();
        let cone = |_| Cone {
            at: Vec3::new(number(4.0), number(3.0), number(5.0)),
            radius: number(0.2),
            size: 0.02 + number(0.5),
        };
        (0..count).map(cone).collect()
    }

    /// Against the plain least over all cones; and it never changes by more than half of a distance.
    #[test]
    fn sizes_are_the_least_of_all_cones_and_change_slowly() {
        for count in [0, 1, 7, 300] {
            let cones = cones(count);
            let sizing = Sizing::new(&cones, (0.05, 0.4));
            let mut sizes = Sizes::new(&sizing);
            let mut rng = Pcg32::new(5, 2);
            let mut last: Option<(Vec3, f32)> = None;
            for k in 0..20_000 {
                let point = Vec3::new(rng.next_f32() * 6.0 - 1.0, rng.next_f32() * 4.0, rng.next_f32() * 6.0);
                // Many pairs lie close together.
                let point = match last {
                    Some((before, _)) if k % 2 == 1 => before + (point - before) * 0.02,
                    _ => point,
                };
                let size = sizing.at(point);
                assert_eq!(size.to_bits(), sizes.at(point).to_bits(), "{point}");
                let of =
                    |cone: &Cone| Cone { size: cone.size.clamp(0.05, 0.4), ..*cone }.size_at(cone.at.distance(point));
                assert_eq!(size, cones.iter().map(of).fold(0.4, f32::min), "{point}");
                assert!((0.05..=0.4).contains(&size));
                if let Some((before, other)) = last {
                    assert!((size - other).abs() <= 0.5 * before.distance(point) + 1e-6, "{before} {point}");
                }
                last = Some((point, size));
            }
        }
    }

    /// Where the size is x / 2 a way from 1 to 4 has 2 ln 4 elements, and half of them lie before 2.
    #[test]
    fn lengths_and_fractions_are_those_of_the_integral() {
        let cone = Cone { at: Vec3::ZERO, radius: 0.0, size: 0.001 };
        let sizing = Sizing::new(&[cone], (0.001, 100.0));
        let mut sizes = Sizes::new(&sizing);
        let mut end = |x: f32| (Vec3::X * x, sizes.at(Vec3::X * x));
        let (a, b) = (end(1.0), end(4.0));
        let length = sizes.length(a, b);
        assert!((length / (2.0 * 4.0_f64.ln()) - 1.0).abs() < 0.1, "{length}");
        let half = 1.0 + 3.0 * sizes.fraction(a, b, 0.5);
        assert!((half / 2.0 - 1.0).abs() < 0.1, "{half}");
        let back = 4.0 - 3.0 * sizes.fraction(b, a, 0.5);
        assert!((back / half - 1.0).abs() < 1e-6, "{back} {half}");
    }
}
