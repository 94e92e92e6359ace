//! Splits triangles until no edge is longer than the spacing, without cracks.
//!
//! Every edge consists of a whole number of segments that depends on nothing but its two end points, and is split
//! at a point that depends on nothing but these and that number. So the two triangles at an edge, in one object or
//! in two, place the same points on it, bit for bit. Inside long triangles more would be placed than light needs: those
//! with one short edge are cut across into a strip of pieces, flat ones at their longest edge alone.

use glam::Vec3;

use super::cells::{Cells, Cut, Kind, NONE, Node, Root, turned};
use super::plan::{Child, Piece, Plan, Split, Triangle};
use super::sizing::{End, Sizes, Sizing};
use crate::hash::FastMap;
use crate::surface::{Surface, SurfaceError};

/// Cells per element at most: a closed surface has two, loose triangles a third.
const CELLS_PER_ELEMENT: usize = 4;

/// A triangle whose other edges have so many times the segments of its shortest is a strip.
const STRIP: u32 = 3;

/// Length over the spacing of edges across strips that are not split.
const DIAGONAL: f64 = 1.12;

/// A triangle whose longest edge has so many times its height is flat.
const FLAT: f64 = 6.0;

/// The elements of a surface before they are sorted.
pub(super) struct Subdivided {
    /// Those of the surface's vertices first, then those of points on edges. Scene space; never −0.
    pub positions: Vec<Vec3>,
    /// Unit.
    pub normals: Vec<Vec3>,
    pub cells: Cells,
}

/// Splits all triangles so that every edge is one segment, of at most `spacing` metres, or as long as `sizing` says where
/// there is one.
pub(super) fn subdivide(
    surface: &Surface,
    spacing: f32,
    sizing: Option<&Sizing>,
    max_elements: usize,
) -> Result<Subdivided, SurfaceError> {
    let mut splitter = Splitter {
        spacing: f64::from(spacing),
        sizing: sizing.map(Sizes::new),
        shortest: sizing.map_or(0.0, |sizing| f64::from(sizing.least())),
        sizes: vec![f32::NAN; if sizing.is_some() { surface.positions.len() } else { 0 }],
        max_elements,
        midpoints: FastMap::default(),
        positions: surface.positions.clone(),
        normals: surface.normals.clone(),
        cells: Cells { roots: Vec::with_capacity(surface.triangles.len()), ..Cells::default() },
        pending: Vec::new(),
    };
    for corners in &surface.triangles {
        splitter.split(*corners)?;
    }
    let Splitter { positions, normals, mut cells, .. } = splitter;
    cells.nodes.shrink_to_fit();
    cells.cuts.shrink_to_fit();
    Ok(Subdivided { positions, normals, cells })
}

struct Splitter<'s> {
    spacing: f64,
    /// In place of the spacing.
    sizing: Option<Sizes<'s>>,
    /// m: of what is not longer nobody asks whether it is to be split.
    shortest: f64,
    /// Per vertex, m; NaN where nobody has asked. Empty without `sizing`.
    sizes: Vec<f32>,
    max_elements: usize,
    /// Ends of an edge (the lexicographically smaller first) and its segments, to the vertex that splits it, and how far
    /// along it that is.
    midpoints: FastMap<[u32; 3], (u32, f64)>,
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    cells: Cells,
    /// Nodes that are not written yet.
    pending: Vec<(u32, Triangle)>,
}

impl Splitter<'_> {
    /// Splits one triangle all the way down.
    fn split(&mut self, corners: [u32; 3]) -> Result<(), SurfaceError> {
        let [a, b, c] = corners;
        let segments = [self.segments(a, b)?, self.segments(b, c)?, self.segments(c, a)?];
        let node = self.add(Child::new(corners, segments))?;
        self.cells.roots.push(Root { corners, node });
        while let Some((node, triangle)) = self.pending.pop() {
            self.cells.nodes[node as usize] = self.divide(triangle)?;
        }
        Ok(())
    }

    /// The node of a triangle that is to be split; [`NONE`] where it is a cell.
    fn add(&mut self, child: Child) -> Result<u32, SurfaceError> {
        let Child { corners, segments, plan } = child;
        let plan = match plan {
            Some(plan) => Some(plan),
            None => self.plan(corners, segments)?,
        };
        let Some(plan) = plan else {
            self.cells.count += 1;
            if self.cells.count as usize > self.max_elements.saturating_mul(CELLS_PER_ELEMENT) {
                return Err(SurfaceError::TooManyElements { limit: self.max_elements });
            }
            return Ok(NONE);
        };
        let node = self.cells.nodes.len() as u32;
        self.cells.nodes.push(Node {
            kind: Kind::Halves,
            cells: 0,
            child: NONE,
            points: [NONE; 3],
            fractions: [0.0; 3],
        });
        self.pending.push((node, Triangle { corners, segments, plan }));
        Ok(node)
    }

    fn plan(&mut self, corners: [u32; 3], segments: [u32; 3]) -> Result<Option<Plan>, SurfaceError> {
        if segments == [1; 3] {
            return Ok(None);
        }
        if let Some(turn) = short_edge(segments) {
            let ([a, b, c], [ab, bc, ca]) = (turned(corners, turn), turned(segments, turn));
            let (ab, cb) = (self.pieces(a, b, ab, ca)?, self.pieces(c, b, bc, ca)?);
            return Ok((ab.len() + cb.len() > 2).then_some(Plan::Strip { turn, ab, cb }));
        }
        let mut splits = [None; 3];
        let flat = self.longest_of_flat(corners);
        for edge in (0..3).filter(|edge| flat.is_none_or(|longest| longest == *edge)) {
            splits[edge] = self.split_edge(corners[edge], corners[(edge + 1) % 3], segments[edge])?;
        }
        Ok(Plan::of_edges(splits))
    }

    /// The longest edge of a triangle that has next to no height above it.
    fn longest_of_flat(&mut self, corners: [u32; 3]) -> Option<usize> {
        let [a, b, c] = corners.map(|corner| self.positions[corner as usize].as_dvec3());
        let lengths = [a.distance(b), b.distance(c), c.distance(a)];
        let longest = (0..3).fold(0, |best, edge| if lengths[edge] > lengths[best] { edge } else { best });
        let height = (b - a).cross(c - a).length() / lengths[longest];
        (FLAT * height < lengths[longest] && lengths[longest] > self.least_of(corners)).then_some(longest)
    }

    /// An edge in parts of at most `most` segments.
    fn pieces(&mut self, a: u32, b: u32, segments: u32, most: u32) -> Result<Vec<Piece>, SurfaceError> {
        let (mut pieces, mut done) = (Vec::new(), 0);
        let mut left = vec![(a, b, segments, 0.0, 1.0)];
        while let Some((a, b, part, from, to)) = left.pop() {
            match if part > most { self.split_edge(a, b, part)? } else { None } {
                Some(split @ Split { middle, segments: [first, second], .. }) => {
                    let at = from + (to - from) * f64::from(split.at);
                    left.extend([(middle, b, second, at, to), (a, middle, first, from, at)]);
                }
                None => {
                    done += part;
                    let at = if self.sizing.is_none() { f64::from(done) / f64::from(segments) } else { to } as f32;
                    pieces.push(Piece { end: b, at, segments: part });
                }
            }
        }
        Ok(pieces)
    }

    /// A triangle's node; its children are added to what is pending.
    fn divide(&mut self, triangle: Triangle) -> Result<Node, SurfaceError> {
        let Triangle { corners, segments, plan } = triangle;
        match plan {
            Plan::Four(splits) => self.divide_in_four(corners, splits),
            Plan::Two { turn, ab, bc } => {
                self.divide_in_two(turn, turned(corners, turn), turned(segments, turn), ab, bc)
            }
            Plan::Strip { turn, ab, cb } => {
                self.divide_strip(turn, turned(corners, turn), turned(segments, turn)[2], &ab, &cb)
            }
        }
    }

    /// Edge `ab` is split. Where `bc` is too, a quadrilateral is left at either end of the triangle: it is cut along
    /// its shorter diagonal.
    fn divide_in_two(
        &mut self,
        turn: u8,
        [a, b, c]: [u32; 3],
        [ab_segments, bc_segments, ca_segments]: [u32; 3],
        ab: Split,
        bc: Option<Split>,
    ) -> Result<Node, SurfaceError> {
        let m = ab.middle;
        match bc {
            Some(bc) if self.length(a, bc.middle) <= self.length(m, c) => {
                let n = bc.middle;
                let an = self.segments(a, n)?;
                let tip = Child::new([b, n, a], [bc.segments[0], an, ab_segments]).with_split(2, ab);
                let rest = Child::new([n, c, a], [bc.segments[1], ca_segments, an]);
                self.node(Kind::Two((turn + 1) % 3), [n, NONE, NONE], [bc.at, 0.0, 0.0], [tip, rest])
            }
            _ => {
                let mc = self.segments(m, c)?;
                let near = Child::new([a, m, c], [ab.segments[0], mc, ca_segments]);
                let far = Child::new([m, b, c], [ab.segments[1], bc_segments, mc]);
                let far = match bc {
                    Some(bc) => far.with_split(1, bc),
                    None => far,
                };
                self.node(Kind::Two(turn), [m, NONE, NONE], [ab.at, 0.0, 0.0], [near, far])
            }
        }
    }

    /// All edges are split: a triangle at each corner and one between the three new vertices.
    fn divide_in_four(&mut self, [a, b, c]: [u32; 3], [ab, bc, ca]: [Split; 3]) -> Result<Node, SurfaceError> {
        let (m, n, o) = (ab.middle, bc.middle, ca.middle);
        let [mn, no, om] = [self.segments(m, n)?, self.segments(n, o)?, self.segments(o, m)?];
        let fractions = [ab, bc, ca].map(|split| split.at);
        let kind = if fractions == [0.5; 3] { Kind::Halves } else { Kind::Four };
        let children = [
            Child::new([a, m, o], [ab.segments[0], om, ca.segments[1]]),
            Child::new([m, b, n], [ab.segments[1], bc.segments[0], mn]),
            Child::new([o, n, c], [no, bc.segments[1], ca.segments[0]]),
            Child::new([m, n, o], [mn, no, om]),
        ];
        self.node(kind, [m, n, o], fractions, children)
    }

    fn node<const N: usize>(
        &mut self,
        kind: Kind,
        points: [u32; 3],
        fractions: [f32; 3],
        children: [Child; N],
    ) -> Result<Node, SurfaceError> {
        let mut node = Node { kind, cells: 0, child: NONE, points, fractions };
        for (k, child) in children.into_iter().enumerate() {
            match self.add(child)? {
                NONE => node.cells |= 1 << k,
                first => node.child = node.child.min(first),
            }
        }
        Ok(node)
    }

    /// Cuts a triangle across, from its short edge `ca` to its tip `b`, by the shorter of two diagonals each time.
    fn divide_strip(
        &mut self,
        turn: u8,
        [a, b, c]: [u32; 3],
        ca_segments: u32,
        ab: &[Piece],
        cb: &[Piece],
    ) -> Result<Node, SurfaceError> {
        let first = self.cells.cuts.len();
        let start = |end| Piece { end, at: 0.0, segments: 0 };
        let (mut p, mut q, mut across) = (start(a), start(c), ca_segments);
        let (mut ab, mut cb) = (ab.iter(), cb.iter());
        let (mut next_p, mut next_q) = (ab.next(), cb.next());
        while let (Some(to_p), Some(to_q)) = (next_p, next_q) {
            let mut cut = Cut { s: p.at, t: q.at, p: p.end, q: q.end, node: NONE };
            let is_last = to_p.end == b && to_q.end == b;
            let along_ab = is_last
                || to_p.end != b && (to_q.end == b || self.length(to_p.end, q.end) <= self.length(p.end, to_q.end));
            let at = self.cells.cuts.len();
            self.cells.cuts.push(cut);
            let piece = if along_ab {
                let next = if is_last { to_q.segments } else { self.segments_across(to_p.end, q.end)? };
                let piece = Child::new([p.end, to_p.end, q.end], [to_p.segments, next, across]);
                (p, next_p, across) = (*to_p, ab.next(), next);
                piece
            } else {
                let next = self.segments_across(p.end, to_q.end)?;
                let piece = Child::new([p.end, to_q.end, q.end], [next, to_q.segments, across]);
                (q, next_q, across) = (*to_q, cb.next(), next);
                piece
            };
            cut.node = self.add(piece)?;
            self.cells.cuts[at] = cut;
        }
        let count = self.cells.cuts.len() - first;
        self.cells.cuts.push(Cut { s: 1.0, t: q.at, p: b, q: q.end, node: NONE });
        let points = [first as u32, count as u32, NONE];
        Ok(Node { kind: Kind::Strip(turn), cells: 0, child: NONE, points, fractions: [0.0; 3] })
    }

    /// Splits an edge of several segments; none where it has one, or is too short for `f32` to hold a point on it.
    fn split_edge(&mut self, a: u32, b: u32, segments: u32) -> Result<Option<Split>, SurfaceError> {
        if segments <= 1 {
            return Ok(None);
        }
        let swapped = self.key(b) < self.key(a);
        let (low, high) = if swapped { (b, a) } else { (a, b) };
        let (low_segments, high_segments) = (segments / 2, segments - segments / 2);
        let (middle, fraction) = match self.midpoints.get(&[low, high, segments]) {
            Some(&known) => known,
            None => {
                let fraction = self.fraction(low, high, f64::from(low_segments) / f64::from(segments));
                let Some(middle) = self.add_middle(low, high, fraction)? else { return Ok(None) };
                self.midpoints.insert([low, high, segments], (middle, fraction));
                (middle, fraction)
            }
        };
        let (parts, at) = match (swapped, &self.sizing) {
            (false, _) => ([low_segments, high_segments], fraction),
            (true, None) => ([high_segments, low_segments], f64::from(high_segments) / f64::from(segments)),
            (true, Some(_)) => ([high_segments, low_segments], 1.0 - fraction),
        };
        Ok(Some(Split { middle, segments: parts, at: at as f32 }))
    }

    fn add_middle(&mut self, low: u32, high: u32, fraction: f64) -> Result<Option<u32>, SurfaceError> {
        let (low, high) = (low as usize, high as usize);
        let mix = |from: Vec3, to: Vec3| from.as_dvec3().lerp(to.as_dvec3(), fraction);
        let position = mix(self.positions[low], self.positions[high]).as_vec3() + Vec3::ZERO;
        if position == self.positions[low] || position == self.positions[high] {
            return Ok(None);
        }
        if self.positions.len() >= self.max_elements {
            return Err(SurfaceError::TooManyElements { limit: self.max_elements });
        }
        let (from, to) = (self.normals[low], self.normals[high]);
        let normal = if from == to { from } else { mix(from, to).normalize_or(from.as_dvec3()).as_vec3() };
        self.positions.push(position);
        self.normals.push(normal);
        self.sizes.extend(self.sizing.is_some().then_some(f32::NAN));
        Ok(Some((self.positions.len() - 1) as u32))
    }

    /// Orders vertices by position: the same in every triangle and object.
    fn key(&self, vertex: u32) -> (f32, f32, f32) {
        self.positions[vertex as usize].into()
    }

    /// Metres. Bitwise the same from both ends: negation is exact.
    fn length(&self, a: u32, b: u32) -> f64 {
        self.positions[a as usize].as_dvec3().distance(self.positions[b as usize].as_dvec3())
    }

    /// A vertex as an end of a way along which sizes count.
    fn end(&mut self, vertex: u32) -> End {
        let position = self.positions[vertex as usize];
        let size = self.sizes.get(vertex as usize).copied().unwrap_or(f32::NAN);
        match &mut self.sizing {
            Some(sizing) if size.is_nan() => {
                let size = sizing.at(position);
                self.sizes[vertex as usize] = size;
                (position, size)
            }
            _ => (position, size),
        }
    }

    /// How far along an edge a share of its segments ends.
    fn fraction(&mut self, low: u32, high: u32, share: f64) -> f64 {
        let (low, high) = (self.end(low), self.end(high));
        self.sizing.as_mut().map_or(share, |sizing| sizing.fraction(low, high, share))
    }

    /// The least distance between elements at some vertices, m.
    fn least_of(&mut self, corners: [u32; 3]) -> f64 {
        if self.sizing.is_none() {
            return self.spacing;
        }
        corners.into_iter().map(|corner| f64::from(self.end(corner).1)).fold(f64::INFINITY, f64::min)
    }

    /// Number of segments of an edge: the least that are not longer than the spacing, or the size along them.
    fn segments(&mut self, a: u32, b: u32) -> Result<u32, SurfaceError> {
        self.segments_of(a, b, 1.0)
    }

    /// Number of segments of an edge across a strip. Every second one is a diagonal, a little longer than the spacing.
    fn segments_across(&mut self, a: u32, b: u32) -> Result<u32, SurfaceError> {
        self.segments_of(a, b, DIAGONAL)
    }

    fn segments_of(&mut self, a: u32, b: u32, longest: f64) -> Result<u32, SurfaceError> {
        let length = self.length(a, b);
        let (low, high) = if self.key(b) < self.key(a) { (b, a) } else { (a, b) };
        let count = match self.sizing {
            None => (length / (longest * self.spacing)).ceil(),
            Some(_) if length <= self.shortest => 1.0,
            Some(_) => {
                let (low, high) = (self.end(low), self.end(high));
                self.sizing.as_mut().map_or(1.0, |sizing| (sizing.length(low, high) / longest).ceil())
            }
        };
        if count > self.max_elements.min(u32::MAX as usize) as f64 {
            return Err(SurfaceError::TooManyElements { limit: self.max_elements });
        }
        Ok((count as u32).max(1))
    }
}

/// By how much corners are turned so that the last edge is one that has far fewer segments than both others.
fn short_edge(segments: [u32; 3]) -> Option<u8> {
    (0..3u8).find(|&turn| {
        let [ab, bc, ca] = turned(segments, turn);
        ab.min(bc) >= STRIP * ca
    })
}
