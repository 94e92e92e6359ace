//! Subset of an object's elements at which smooth light is evaluated, and the weights that carry values back to all.

use std::ops::Range;

use glam::{IVec3, Vec3};

use crate::hash::FastMap;
use crate::indices::Indices;

/// Representatives of one side of an object and, per element, the representatives it is interpolated from.
#[derive(Clone, Debug, Default)]
pub(crate) struct Coarse {
    /// Representatives, as indices of the object's elements.
    pub representatives: Vec<u32>,
    /// m² of the elements that are interpolated from each, by weight.
    pub areas: Vec<f32>,
    /// `offsets[i]..offsets[i + 1]` are the entries of element `i`.
    offsets: Vec<u32>,
    /// Per entry, an index into `representatives`.
    entries: Indices,
    /// Per entry, its weight over [`UNIT`]; those of one element sum to about that.
    weights: Vec<u16>,
    /// How far an element is from its representatives at most, m.
    pub reach: f32,
}

/// What weights are stored in parts of: they take two bytes.
const UNIT: f32 = u16::MAX as f32;

/// At most this many representatives per element.
const MAX_ENTRIES: usize = 4;

/// Cells are cubes of size `radius`, one set per dominant direction of the normal.
type Cell = (u8, i32, i32, i32);

fn cell_of(position: Vec3, normal: Vec3, radius: f32) -> Cell {
    let a = normal.abs();
    let axis = if a.x >= a.y && a.x >= a.z {
        0
    } else if a.y >= a.z {
        1
    } else {
        2
    };
    let side = axis * 2 + u8::from(normal[axis as usize] < 0.0);
    let c = (position / radius).floor().as_ivec3();
    (side, c.x, c.y, c.z)
}

impl Coarse {
    /// Chooses one representative per cell of `radius` metres.
    pub(crate) fn new(positions: &[Vec3], normals: &[Vec3], areas: &[f32], radius: f32) -> Coarse {
        let mut cells: FastMap<Cell, Vec<u32>> = FastMap::default();
        for (i, (p, n)) in positions.iter().zip(normals).enumerate() {
            cells.entry(cell_of(*p, *n, radius)).or_default().push(i as u32);
        }
        let mut chosen: Vec<(u32, Cell)> =
            cells.iter().map(|(cell, members)| (nearest_to_mean(members, positions, areas), *cell)).collect();
        // Side by side in the elements' spatial order, whatever that of the cells is: neighbours lie together.
        chosen.sort_unstable_by_key(|(element, cell)| (cell.0, *element));
        let cell_index: FastMap<Cell, u32> = chosen.iter().map(|(_, cell)| *cell).zip(0..).collect();
        let representatives: Vec<u32> = chosen.into_iter().map(|(element, _)| element).collect();
        let around = Around { positions, normals, radius, representatives: &representatives, cell_index };
        let (mut offsets, mut entries, mut weights, mut reach) = (vec![0], Vec::new(), Vec::new(), 0.0_f32);
        let mut of_each = vec![0.0; representatives.len()];
        for ((p, n), area) in positions.iter().zip(normals).zip(areas) {
            for (r, weight) in around.entries(*p, *n) {
                let weight = (weight * UNIT).round().max(1.0);
                of_each[r as usize] += area * weight / UNIT;
                reach = reach.max(p.distance(positions[representatives[r as usize] as usize]));
                entries.push(r);
                weights.push(weight as u16);
            }
            offsets.push(entries.len() as u32);
        }
        weights.shrink_to_fit();
        Coarse { representatives, areas: of_each, offsets, entries: entries.into(), weights, reach }
    }
}

/// Representatives to interpolate from.
struct Around<'a> {
    positions: &'a [Vec3],
    normals: &'a [Vec3],
    radius: f32,
    representatives: &'a [u32],
    /// Of each cell, an index into `representatives`.
    cell_index: FastMap<Cell, u32>,
}

impl Around<'_> {
    /// (index into `representatives`, weight) for an element at a point with a normal, heaviest first; the weights sum to 1.
    fn entries(&self, p: Vec3, n: Vec3) -> Vec<(u32, f32)> {
        let (side, x, y, z) = cell_of(p, n, self.radius);
        let mut found: Vec<(u32, f32)> = Vec::with_capacity(27);
        for d in 0..27 {
            let step = IVec3::new(d % 3 - 1, d / 3 % 3 - 1, d / 9 - 1);
            let Some(&r) = self.cell_index.get(&(side, x + step.x, y + step.y, z + step.z)) else { continue };
            let element = self.representatives[r as usize] as usize;
            let w = kernel(p, n, self.positions[element], self.normals[element], self.radius);
            if w > 0.0 {
                found.push((r, w));
            }
        }
        if found.is_empty() {
            found.push((self.cell_index[&(side, x, y, z)], 1.0));
        }
        found.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        // Weights fall to zero at the first one that is left out, so that no jump appears where the set changes.
        let floor = found.get(MAX_ENTRIES).map_or(0.0, |e| e.1);
        found.truncate(MAX_ENTRIES);
        if found[0].1 > floor {
            found.iter_mut().for_each(|e| e.1 -= floor);
        }
        found.retain(|e| e.1 > 0.0);
        let total: f32 = found.iter().map(|e| e.1).sum();
        found.iter_mut().for_each(|e| e.1 /= total);
        found
    }
}

/// Weight of a representative: falls with distance, turning of the normal and distance from the tangent plane.
fn kernel(p: Vec3, n: Vec3, q: Vec3, m: Vec3, radius: f32) -> f32 {
    let d = q - p;
    let reach = 1.0 - d.length() / (1.9 * radius);
    let plane = 1.0 - (d.dot(n).abs() + d.dot(m).abs()) / radius;
    let turn = n.dot(m);
    if reach <= 0.0 || plane <= 0.0 || turn <= 0.3 { 0.0 } else { reach * reach * plane * plane * turn.powi(4) }
}

fn nearest_to_mean(members: &[u32], positions: &[Vec3], areas: &[f32]) -> u32 {
    let total: f32 = members.iter().map(|&i| areas[i as usize]).sum();
    let mean = if total > 0.0 {
        members.iter().map(|&i| positions[i as usize] * areas[i as usize]).sum::<Vec3>() / total
    } else {
        positions[members[0] as usize]
    };
    let distance = |i: u32| positions[i as usize].distance_squared(mean);
    members.iter().copied().min_by(|&a, &b| distance(a).total_cmp(&distance(b)).then(a.cmp(&b))).unwrap_or(0)
}

impl Coarse {
    /// The entries of an element, heaviest first.
    #[inline]
    pub(crate) fn range_of(&self, element: u32) -> Range<usize> {
        self.offsets[element as usize] as usize..self.offsets[element as usize + 1] as usize
    }

    /// How many entries there are.
    pub(crate) fn entry_count(&self) -> usize {
        self.entries.len()
    }

    /// Of an entry, the index into `representatives`.
    #[inline]
    pub(crate) fn representative_of(&self, entry: usize) -> usize {
        self.entries.at(entry) as usize
    }

    /// (index into `representatives`, weight) of an element, heaviest first; the weights sum to about 1.
    #[inline]
    pub(crate) fn entries_of(&self, element: u32) -> impl Iterator<Item = (usize, f32)> + '_ {
        let range = self.range_of(element);
        let weights = self.weights[range.clone()].iter().map(|&weight| f32::from(weight) / UNIT);
        self.entries.range(range).map(|r| r as usize).zip(weights)
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        (self.representatives.capacity() + self.areas.capacity() + self.offsets.capacity()) * size_of::<u32>()
            + self.entries.memory_bytes()
            + self.weights.capacity() * size_of::<u16>()
    }
}
