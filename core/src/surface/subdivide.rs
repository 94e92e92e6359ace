//! Splits triangles until no edge is longer than the spacing, without cracks.
//!
//! Every edge consists of a whole number of segments that depends on nothing but its two end points, and is split
//! at a point that depends on nothing but these and that number. So the two triangles at an edge, in one object or
//! in two, place the same points on it, bit for bit.

use glam::Vec3;

use super::SurfaceError;
use super::hash::FastMap;
use super::weld::Welded;

/// Triangles per element at most: a closed surface has two, loose triangles a third.
const TRIANGLES_PER_ELEMENT: usize = 4;

/// A triangle yet to be split. Edge `i` goes from corner `i` to corner `i + 1`.
#[derive(Clone, Copy)]
struct Pending {
    corners: [u32; 3],
    /// Segments per edge.
    segments: [u32; 3],
}

/// Splits all triangles so that every edge is one segment, of at most `spacing` metres.
pub(super) fn subdivide(mesh: Welded, spacing: f32, max_elements: usize) -> Result<Welded, SurfaceError> {
    let Welded { positions, normals, triangles, materials } = mesh;
    let mut splitter = Splitter {
        spacing: f64::from(spacing),
        max_elements,
        midpoints: FastMap::default(),
        positions,
        normals,
        triangles: Vec::with_capacity(triangles.len()),
    };
    let mut split_materials = Vec::with_capacity(triangles.len());
    for (corners, material) in triangles.into_iter().zip(materials) {
        splitter.split(corners)?;
        split_materials.resize(splitter.triangles.len(), material);
    }
    Ok(Welded {
        positions: splitter.positions,
        normals: splitter.normals,
        triangles: splitter.triangles,
        materials: split_materials,
    })
}

struct Splitter {
    spacing: f64,
    max_elements: usize,
    /// Ends of an edge (the lexicographically smaller first) and its segments, to the vertex that splits it.
    midpoints: FastMap<[u32; 3], u32>,
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
}

/// An edge after its split: the vertex between its ends and the segments on either side.
#[derive(Clone, Copy)]
struct Split {
    middle: u32,
    /// Segments from the edge's first corner to the middle, and from there to its second corner.
    segments: [u32; 2],
}

impl Splitter {
    /// Splits one triangle all the way down.
    fn split(&mut self, corners: [u32; 3]) -> Result<(), SurfaceError> {
        let [a, b, c] = corners;
        let segments = [self.segments(a, b)?, self.segments(b, c)?, self.segments(c, a)?];
        let mut stack = vec![Pending { corners, segments }];
        while let Some(triangle) = stack.pop() {
            if self.triangles.len() >= self.max_elements.saturating_mul(TRIANGLES_PER_ELEMENT) {
                return Err(SurfaceError::TooManyElements { limit: self.max_elements });
            }
            self.split_once(triangle, &mut stack)?;
        }
        Ok(())
    }

    /// Splits the edges of several segments once each. Emits the triangle if there is none.
    fn split_once(&mut self, triangle: Pending, stack: &mut Vec<Pending>) -> Result<(), SurfaceError> {
        let Pending { corners, segments } = triangle;
        let mut splits = [None; 3];
        for edge in 0..3 {
            splits[edge] = self.split_edge(corners[edge], corners[(edge + 1) % 3], segments[edge])?;
        }
        match splits {
            [None, None, None] => self.triangles.push(corners),
            [Some(ab), Some(bc), Some(ca)] => self.split_in_four(corners, [ab, bc, ca], stack)?,
            _ => {
                // Turned so that an edge that is split comes first, and one that is not comes last.
                let first = (0..3).find(|&e| splits[e].is_some() && splits[(e + 2) % 3].is_none()).unwrap_or(0);
                let turned = [0, 1, 2].map(|i| corners[(first + i) % 3]);
                let kept = [1, 2].map(|i| segments[(first + i) % 3]);
                match (splits[first], splits[(first + 1) % 3]) {
                    (Some(ab), Some(bc)) => self.split_in_three(turned, ab, bc, kept[1], stack)?,
                    (Some(ab), None) => self.split_in_two(turned, ab, kept, stack)?,
                    (None, _) => self.triangles.push(corners),
                }
            }
        }
        Ok(())
    }

    /// Edge `ab` is split.
    fn split_in_two(
        &self,
        [a, b, c]: [u32; 3],
        ab: Split,
        [bc_segments, ca_segments]: [u32; 2],
        stack: &mut Vec<Pending>,
    ) -> Result<(), SurfaceError> {
        let m = ab.middle;
        let mc = self.segments(m, c)?;
        stack.push(Pending { corners: [a, m, c], segments: [ab.segments[0], mc, ca_segments] });
        stack.push(Pending { corners: [m, b, c], segments: [ab.segments[1], bc_segments, mc] });
        Ok(())
    }

    /// Edges `ab` and `bc` are split: a triangle at `b`, and a quadrilateral cut along its shorter diagonal.
    fn split_in_three(
        &self,
        [a, b, c]: [u32; 3],
        ab: Split,
        bc: Split,
        ca_segments: u32,
        stack: &mut Vec<Pending>,
    ) -> Result<(), SurfaceError> {
        let (m, n) = (ab.middle, bc.middle);
        let mn = self.segments(m, n)?;
        stack.push(Pending { corners: [m, b, n], segments: [ab.segments[1], bc.segments[0], mn] });
        if self.length(a, n) <= self.length(m, c) {
            let an = self.segments(a, n)?;
            stack.push(Pending { corners: [a, m, n], segments: [ab.segments[0], mn, an] });
            stack.push(Pending { corners: [a, n, c], segments: [an, bc.segments[1], ca_segments] });
        } else {
            let mc = self.segments(m, c)?;
            stack.push(Pending { corners: [a, m, c], segments: [ab.segments[0], mc, ca_segments] });
            stack.push(Pending { corners: [m, n, c], segments: [mn, bc.segments[1], mc] });
        }
        Ok(())
    }

    /// All edges are split: a triangle at each corner and one between the three new vertices.
    fn split_in_four(
        &self,
        [a, b, c]: [u32; 3],
        [ab, bc, ca]: [Split; 3],
        stack: &mut Vec<Pending>,
    ) -> Result<(), SurfaceError> {
        let (m, n, o) = (ab.middle, bc.middle, ca.middle);
        let [mn, no, om] = [self.segments(m, n)?, self.segments(n, o)?, self.segments(o, m)?];
        stack.push(Pending { corners: [a, m, o], segments: [ab.segments[0], om, ca.segments[1]] });
        stack.push(Pending { corners: [m, b, n], segments: [ab.segments[1], bc.segments[0], mn] });
        stack.push(Pending { corners: [o, n, c], segments: [no, bc.segments[1], ca.segments[0]] });
        stack.push(Pending { corners: [m, n, o], segments: [mn, no, om] });
        Ok(())
    }

    /// Splits an edge of several segments; none where it has one, or is too short for `f32` to hold a point on it.
    fn split_edge(&mut self, a: u32, b: u32, segments: u32) -> Result<Option<Split>, SurfaceError> {
        if segments <= 1 {
            return Ok(None);
        }
        let swapped = self.key(b) < self.key(a);
        let (low, high) = if swapped { (b, a) } else { (a, b) };
        let (low_segments, high_segments) = (segments / 2, segments - segments / 2);
        let middle = match self.midpoints.get(&[low, high, segments]) {
            Some(&known) => known,
            None => match self.add_middle(low, high, f64::from(low_segments) / f64::from(segments))? {
                Some(middle) => {
                    self.midpoints.insert([low, high, segments], middle);
                    middle
                }
                None => return Ok(None),
            },
        };
        let parts = [low_segments, high_segments];
        Ok(Some(Split { middle, segments: if swapped { [parts[1], parts[0]] } else { parts } }))
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

    /// Number of segments of an edge: the least that are not longer than the spacing.
    fn segments(&self, a: u32, b: u32) -> Result<u32, SurfaceError> {
        let count = (self.length(a, b) / self.spacing).ceil();
        if count > self.max_elements.min(u32::MAX as usize) as f64 {
            return Err(SurfaceError::TooManyElements { limit: self.max_elements });
        }
        Ok((count as u32).max(1))
    }
}
