//! Flat arrays over all elements and triangles of a world, indexed by slot.
//!
//! Every object owns one range of element slots and one of triangle slots. Slots are stable: a removed object leaves
//! a hole, which a later one may fill.

use std::ops::Range;

use glam::Vec3;

use super::holes::Holes;
use crate::surface::Surface;

/// Marks a slot without an object.
pub const NO_OBJECT: u32 = u32::MAX;

/// Marks a triangle slot without a triangle.
pub(crate) const NO_PART: u32 = u32::MAX;

/// Elements and triangles of all objects.
#[derive(Debug, Default)]
pub(crate) struct Geometry {
    /// Sample points, scene space. Per element slot.
    pub positions: Vec<Vec3>,
    /// Unit normals.
    pub normals: Vec<Vec3>,
    /// m²; zero in holes.
    pub areas: Vec<f32>,
    /// Key of the owning object, or [`NO_OBJECT`].
    pub owners: Vec<u32>,
    /// Per triangle slot.
    pub triangles: Vec<TriangleRecord>,
    free_elements: Holes,
    free_triangles: Holes,
}

/// What a ray needs to know of the triangle it hit, beside its corners (which the tree holds).
#[derive(Clone, Copy, Debug)]
#[repr(C, align(16))]
pub(crate) struct TriangleRecord {
    /// Element slots of the corners, front side.
    pub elements: [u32; 3],
    /// Index into [`super::World::parts`] with `CUT` as a flag, or [`NO_PART`].
    part: u32,
}

/// Flag of triangles whose corners do not all see each other: a wall stands on them.
const CUT: u32 = 1 << 31;

impl TriangleRecord {
    const EMPTY: TriangleRecord = TriangleRecord { elements: [0; 3], part: NO_PART };

    /// Index into [`super::World::parts`].
    #[inline]
    pub(crate) fn part(&self) -> u32 {
        self.part & !CUT
    }

    /// Whether a wall stands on the triangle: light must not be interpolated across it.
    #[inline]
    pub(crate) fn is_cut(&self) -> bool {
        self.part & CUT != 0
    }

    pub(crate) fn set_cut(&mut self, cut: bool) {
        if self.part != NO_PART {
            self.part = self.part() | if cut { CUT } else { 0 };
        }
    }
}

/// The triangles of one object that share a material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Part {
    /// Diffuse albedo.
    pub albedo: Vec3,
    /// Key of the object.
    pub object: u32,
    /// Both sides reflect.
    pub double_sided: bool,
    /// The object bounds a volume that light does not enter: a ray that meets its back starts inside it.
    pub solid: bool,
    /// What to add to front slots to get those of the back; 0: the back has no elements.
    pub back_offset: u32,
}

/// Where an object's elements and triangles lie.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Placement {
    /// Element slots: the front's, then the back's where it has any.
    pub elements: Range<u32>,
    /// Triangle slots.
    pub triangles: Range<u32>,
}

impl Placement {
    /// The element slots as indices of arrays.
    pub(crate) fn element_indices(&self) -> Range<usize> {
        self.elements.start as usize..self.elements.end as usize
    }
}

/// An edit copies all arrays: on two threads.
impl Clone for Geometry {
    fn clone(&self) -> Self {
        let elements = || (self.positions.clone(), self.normals.clone(), self.areas.clone(), self.owners.clone());
        let ((positions, normals, areas, owners), triangles) = rayon::join(elements, || self.triangles.clone());
        let (free_elements, free_triangles) = (self.free_elements.clone(), self.free_triangles.clone());
        Geometry { positions, normals, areas, owners, triangles, free_elements, free_triangles }
    }
}

impl Geometry {
    /// Puts an object's surface into free slots. `parts_first` is the index of the part of its material 0.
    pub(crate) fn place(&mut self, surface: &Surface, key: u32, with_back: bool, parts_first: u32) -> Placement {
        let front = surface.positions.len();
        let count = if with_back { 2 * front } else { front };
        let first = self.free_elements.take(count, self.owners.len());
        let first_triangle = self.free_triangles.take(surface.triangles.len(), self.triangles.len());
        let end = first + count;
        if end > self.owners.len() {
            self.positions.resize(end, Vec3::ZERO);
            self.normals.resize(end, Vec3::ZERO);
            self.areas.resize(end, 0.0);
            self.owners.resize(end, NO_OBJECT);
        }
        self.owners[first..end].fill(key);
        self.write_elements(surface, first, with_back);
        let triangles_end = first_triangle + surface.triangles.len();
        if triangles_end > self.triangles.len() {
            self.triangles.resize(triangles_end, TriangleRecord::EMPTY);
        }
        for (slot, (corners, material)) in self.triangles[first_triangle..triangles_end]
            .iter_mut()
            .zip(surface.triangles.iter().zip(&surface.triangle_materials))
        {
            *slot = TriangleRecord { elements: corners.map(|c| c + first as u32), part: parts_first + material };
        }
        Placement { elements: first as u32..end as u32, triangles: first_triangle as u32..triangles_end as u32 }
    }

    /// Positions, normals and areas of an object whose slots are there already.
    pub(crate) fn write_elements(&mut self, surface: &Surface, first: usize, with_back: bool) {
        let n = surface.positions.len();
        self.positions[first..first + n].copy_from_slice(&surface.positions);
        self.normals[first..first + n].copy_from_slice(&surface.normals);
        self.areas[first..first + n].copy_from_slice(&surface.areas);
        if with_back {
            self.positions[first + n..first + 2 * n].copy_from_slice(&surface.positions);
            self.areas[first + n..first + 2 * n].copy_from_slice(&surface.areas);
            for (back, front) in self.normals[first + n..first + 2 * n].iter_mut().zip(&surface.normals) {
                *back = -*front;
            }
        }
    }

    /// Frees an object's slots.
    pub(crate) fn clear(&mut self, placement: &Placement) {
        let range = placement.element_indices();
        self.positions[range.clone()].fill(Vec3::ZERO);
        self.normals[range.clone()].fill(Vec3::ZERO);
        self.areas[range.clone()].fill(0.0);
        self.owners[range.clone()].fill(NO_OBJECT);
        self.free_elements.give(range);
        let triangles = placement.triangles.start as usize..placement.triangles.end as usize;
        self.triangles[triangles.clone()].fill(TriangleRecord::EMPTY);
        self.free_triangles.give(triangles);
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.positions.capacity() * 12
            + self.normals.capacity() * 12
            + self.areas.capacity() * 4
            + self.owners.capacity() * 4
            + self.triangles.capacity() * size_of::<TriangleRecord>()
    }
}
