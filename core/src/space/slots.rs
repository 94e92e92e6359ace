//! Flat arrays over the elements of a world, indexed by slot. Slots are stable: a removed object leaves a hole, which a
//! later one may fill.

use std::ops::Range;

use glam::Vec3;

use super::holes::Holes;
use super::layout::Elements;
use super::offset::ray_offset;
use crate::chunks::Chunks;

/// Marks a slot without an object.
pub const NO_OBJECT: u32 = u32::MAX;

/// Elements of all objects.
#[derive(Clone, Debug, Default)]
pub(crate) struct Slots {
    /// Sample points, scene space.
    pub positions: Chunks<Vec3>,
    /// Unit normals.
    pub normals: Chunks<Vec3>,
    /// m²; zero in holes.
    pub areas: Chunks<f32>,
    /// Key of the owning object, or [`NO_OBJECT`].
    pub owners: Chunks<u32>,
    /// By key of an object: longest side of its triangles' boxes, m.
    extents: Vec<f32>,
    free: Holes,
}

/// What of a world's lists belongs to an object.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Placement {
    /// Element slots: the front's, then the back's where it has any.
    pub elements: Range<u32>,
    /// Triangle slots: what trees call their triangles.
    pub faces: Range<u32>,
    /// Ids of cells.
    pub cells: Range<u32>,
    /// Parts, one per material.
    pub parts: Range<u32>,
}

impl Placement {
    /// The element slots as indices of arrays.
    pub(crate) fn element_indices(&self) -> Range<usize> {
        indices(&self.elements)
    }

    /// The parts as indices of arrays.
    pub(crate) fn part_indices(&self) -> Range<usize> {
        indices(&self.parts)
    }

    /// The triangle slots as indices of arrays.
    pub(super) fn face_indices(&self) -> Range<usize> {
        indices(&self.faces)
    }

    /// Ids of cells as indices of arrays.
    pub(super) fn cell_indices(&self) -> Range<usize> {
        indices(&self.cells)
    }
}

fn indices(range: &Range<u32>) -> Range<usize> {
    range.start as usize..range.end as usize
}

impl Slots {
    /// Puts elements into free slots, those of the back behind those of the front.
    pub(super) fn place(&mut self, elements: &Elements, extent: f32, key: u32, with_back: bool) -> Range<u32> {
        let front = elements.positions.len();
        let count = if with_back { 2 * front } else { front };
        let first = self.free.take(count, self.owners.len());
        let end = first + count;
        if end > self.owners.len() {
            self.positions.grow(end);
            self.normals.grow(end);
            self.areas.grow(end);
            self.owners.grow(end);
        }
        self.owners.fill(first..end, key);
        if self.extents.len() <= key as usize {
            self.extents.resize(key as usize + 1, 0.0);
        }
        self.extents[key as usize] = extent;
        self.write(elements, first, with_back);
        first as u32..end as u32
    }

    /// Makes room for so many slots, and no more.
    pub(super) fn reserve(&mut self, slots: usize) {
        self.positions.reserve(slots);
        self.normals.reserve(slots);
        self.areas.reserve(slots);
        self.owners.reserve(slots);
    }

    /// Writes elements whose slots are there already.
    pub(super) fn write(&mut self, elements: &Elements, first: usize, with_back: bool) {
        let n = elements.positions.len();
        for first in [Some(first), with_back.then_some(first + n)].into_iter().flatten() {
            self.positions.write(first, &elements.positions);
            self.areas.write(first, &elements.areas);
        }
        self.normals.write(first, &elements.normals);
        if with_back {
            let backwards: Vec<Vec3> = elements.normals.iter().map(|normal| -normal).collect();
            self.normals.write(first + n, &backwards);
        }
    }

    /// The elements of the front of an object.
    pub(super) fn read(&self, first: usize, count: usize) -> Elements {
        let range = first..first + count;
        Elements {
            positions: self.positions.copy(range.clone()),
            normals: self.normals.copy(range.clone()),
            areas: self.areas.copy(range),
        }
    }

    /// How far rays of an element start off its surface, m.
    #[inline]
    pub(crate) fn offset(&self, slot: usize) -> f32 {
        let extent = self.extents.get(self.owners[slot] as usize).copied().unwrap_or(0.0);
        ray_offset(self.positions[slot], extent)
    }

    /// Frees slots.
    pub(super) fn clear(&mut self, range: Range<usize>) {
        self.positions.fill(range.clone(), Vec3::ZERO);
        self.normals.fill(range.clone(), Vec3::ZERO);
        self.areas.fill(range.clone(), 0.0);
        self.owners.fill(range.clone(), NO_OBJECT);
        self.free.give(range);
    }

    /// Bytes held.
    pub(super) fn memory_bytes(&self) -> usize {
        self.positions.memory_bytes()
            + self.normals.memory_bytes()
            + self.areas.memory_bytes()
            + self.owners.memory_bytes()
            + self.extents.capacity() * size_of::<f32>()
    }
}
