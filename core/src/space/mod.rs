//! Where light lives: elements, beside the triangles that rays meet.
//!
//! Every object owns ranges of slots: one entry of a light map per element, of its front and then of its back where
//! light is seen there, too. [`Space`] answers for a hit which slots hold the light there, with what weights, and how
//! much is reflected. How a surface is divided is known in here only; others see its cells ([`Patch`]) and ask
//! [`Layout`].

mod albedo;
mod cells;
mod decimate;
mod density;
mod elements;
mod footprint;
mod holes;
mod layout;
mod mesh;
mod neighbours;
mod offset;
mod part;
mod plan;
mod reads;
mod sizing;
mod slots;
mod subdivide;
#[cfg(test)]
mod tests;

pub(crate) use albedo::{Albedo, Albedos};
pub(crate) use cells::Patch;
pub use density::{Density, object_areas};
pub use footprint::Footprint;
pub(crate) use footprint::Spot;
pub(crate) use layout::{Distances, Elements, Layout};
pub(crate) use offset::ray_offset;
pub(crate) use part::Part;
pub(crate) use reads::Read;
pub(crate) use sizing::{Cone, Sizing};
pub use slots::NO_OBJECT;
pub use slots::Placement;
pub(crate) use slots::Slots;

use std::ops::Range;
use std::sync::Arc;

use glam::Vec3;

use self::holes::Holes;
use crate::bits::Bits;
use crate::bvh::Hit;
use crate::surface::Surface;

/// How surfaces are divided into elements: raised whenever the same scene is divided in another way, so that light maps
/// that were kept are never read for elements that they are not of.
pub const LAYOUT_VERSION: u32 = 3;

/// All elements of a world and the way from triangles to them. Cheap to clone: an edit copies what it changes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Space {
    slots: Arc<Slots>,
    faces: Arc<Faces>,
    parts: Arc<Parts>,
    /// Cells that a wall stands on, by id.
    cuts: Arc<Bits>,
}

/// Per triangle slot: index of its part.
#[derive(Clone, Debug, Default)]
struct Faces {
    parts: Vec<u32>,
    free: Holes,
}

#[derive(Clone, Debug, Default)]
struct Parts {
    list: Vec<Part>,
    free: Holes,
    /// Ids of cells that are in use, or were, and those among them that are free.
    cells: usize,
    free_cells: Holes,
}

impl Space {
    /// Gives an object slots for its elements and triangles, ids for its cells, and a part per material.
    pub(crate) fn place(
        &mut self,
        (surface, layout, elements): (&Surface, &Arc<Layout>, &Elements),
        albedos: Option<&Arc<[Vec3]>>,
        materials: impl ExactSizeIterator<Item = (Albedo, bool)>,
        key: u32,
        with_back: bool,
    ) -> Placement {
        let extent = surface.largest_extent();
        let elements = Arc::make_mut(&mut self.slots).place(elements, extent, key, with_back);
        let parts = Arc::make_mut(&mut self.parts);
        let cells = parts.take_cells(layout.ids());
        let faces = Arc::make_mut(&mut self.faces);
        let first_face = faces.take(surface.triangles.len());
        let part = |(albedo, double_sided): (Albedo, bool)| Part {
            albedo: albedo.reflected,
            told_albedo: albedo.told,
            is_capped: albedo.is_capped,
            albedos: albedos.cloned(),
            object: key,
            extent,
            double_sided,
            solid: false,
            first_slot: elements.start,
            back_offset: if with_back { layout.len() as u32 } else { 0 },
            first_face,
            first_cell: cells.start,
            layout: Arc::clone(layout),
        };
        let of_object = parts.place(materials.map(part));
        let range = first_face..first_face + surface.triangles.len() as u32;
        for (face, material) in faces.parts[range.start as usize..].iter_mut().zip(&surface.triangle_materials) {
            *face = of_object.start + material;
        }
        Placement { elements, faces: range, cells, parts: of_object }
    }

    /// Makes room for so many more slots: objects are placed without moving those before them.
    pub(crate) fn reserve(&mut self, slots: usize) {
        let there = self.slots.owners.len();
        Arc::make_mut(&mut self.slots).reserve(there + slots);
    }

    /// Frees what an object has.
    pub(crate) fn clear(&mut self, placement: &Placement) {
        Arc::make_mut(&mut self.slots).clear(placement.element_indices());
        let faces = Arc::make_mut(&mut self.faces);
        faces.parts[placement.face_indices()].fill(NO_PART);
        faces.free.give(placement.face_indices());
        let parts = Arc::make_mut(&mut self.parts);
        parts.list[placement.part_indices()].fill(Part::free());
        parts.free.give(placement.part_indices());
        parts.free_cells.give(placement.cell_indices());
        if !self.cuts.is_empty() {
            self.set_cuts(placement.cells.clone().map(|cell| (cell, false)));
        }
    }

    /// Writes other elements into the slots of an object.
    pub(crate) fn write(&mut self, placement: &Placement, elements: &Elements, with_back: bool) {
        Arc::make_mut(&mut self.slots).write(elements, placement.elements.start as usize, with_back);
    }

    /// The elements of an object's front.
    pub(crate) fn elements_of(&self, placement: &Placement, layout: &Layout) -> Elements {
        self.slots.read(placement.elements.start as usize, layout.len())
    }

    /// Flat arrays over all slots.
    #[inline]
    pub(crate) fn slots(&self) -> &Slots {
        &self.slots
    }

    /// Parts of all objects; those that are free belong to none.
    #[inline]
    pub(crate) fn parts(&self) -> &[Part] {
        &self.parts.list
    }

    /// The parts of an object, one per material.
    pub(crate) fn parts_of(&self, placement: &Placement) -> &[Part] {
        &self.parts.list[placement.part_indices()]
    }

    /// The parts of an object, to be changed.
    pub(crate) fn parts_of_mut(&mut self, placement: &Placement) -> &mut [Part] {
        &mut Arc::make_mut(&mut self.parts).list[placement.part_indices()]
    }

    /// Index of the part of a triangle that a ray met.
    #[inline]
    pub(crate) fn part_index(&self, triangle: u32) -> u32 {
        self.faces.parts[triangle as usize]
    }

    /// The part of a triangle that a ray met.
    #[inline]
    pub(crate) fn part(&self, triangle: u32) -> &Part {
        &self.parts.list[self.part_index(triangle) as usize]
    }

    /// Whether triangles of an object that a ray met share elements.
    pub(crate) fn is_shared(&self, triangle: u32) -> bool {
        self.part(triangle).layout.is_shared()
    }

    /// Where a ray met one side of a triangle, which is of `part`.
    #[inline]
    pub(crate) fn spot(&self, hit: &Hit, part: &Part, back: bool) -> Spot {
        let place = part.layout.cells.locate(hit.triangle - part.first_face, [1.0 - hit.u - hit.v, hit.u, hit.v]);
        let first = match (back, part.back_offset) {
            (false, _) => Some(part.first_slot),
            (true, 0) => None,
            (true, offset) => Some(part.first_slot + offset),
        };
        let albedo = match &part.albedos {
            None => part.albedo,
            Some(albedos) => {
                let at = |(element, weight): (u32, f32)| albedos[element as usize] * weight;
                place.elements.into_iter().zip(place.weights).map(at).sum()
            }
        };
        let footprint = first.map(|first| Footprint::of_triangle(place.elements.map(|e| e + first), place.weights));
        Spot { cell: part.first_cell + place.cell, footprint, albedo }
    }

    /// Ids of cells are below this.
    pub(crate) fn cells(&self) -> usize {
        self.parts.cells
    }

    /// Whether a wall stands on a cell: light must not be interpolated across it.
    #[inline]
    pub(crate) fn is_cut(&self, cell: u32) -> bool {
        self.cuts.contains(cell as usize)
    }

    /// Says of some cells whether a wall stands on them.
    pub(crate) fn set_cuts(&mut self, cells: impl IntoIterator<Item = (u32, bool)>) {
        let changes: Vec<(u32, bool)> = cells.into_iter().filter(|&(cell, cut)| self.is_cut(cell) != cut).collect();
        if changes.is_empty() {
            return;
        }
        let cuts = Arc::make_mut(&mut self.cuts);
        changes.into_iter().for_each(|(cell, cut)| cuts.set(cell as usize, cut));
    }

    /// Whether every slot holds the same element as in another space.
    pub(crate) fn has_slots_of(&self, other: &Space) -> bool {
        Arc::ptr_eq(&self.slots, &other.slots)
    }

    /// Takes the elements, triangles and cells of another space, and leaves the parts as they are: for edits that
    /// change geometry and change it back.
    pub(crate) fn take_geometry(&mut self, other: &Space) {
        (self.slots, self.faces, self.cuts) =
            (Arc::clone(&other.slots), Arc::clone(&other.faces), Arc::clone(&other.cuts));
    }

    /// Bytes held, without layouts.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.slots.memory_bytes()
            + self.faces.parts.capacity() * size_of::<u32>()
            + self.parts.list.capacity() * size_of::<Part>()
            + self.cuts.memory_bytes()
    }
}

/// Marks a triangle slot without a triangle.
const NO_PART: u32 = u32::MAX;

impl Faces {
    fn take(&mut self, count: usize) -> u32 {
        let first = self.free.take(count, self.parts.len());
        if first + count > self.parts.len() {
            self.parts.resize(first + count, NO_PART);
        }
        first as u32
    }
}

impl Parts {
    fn place(&mut self, parts: impl ExactSizeIterator<Item = Part>) -> Range<u32> {
        let count = parts.len();
        let first = self.free.take(count, self.list.len());
        if first + count > self.list.len() {
            self.list.resize(first + count, Part::free());
        }
        self.list[first..first + count].iter_mut().zip(parts).for_each(|(to, part)| *to = part);
        first as u32..(first + count) as u32
    }

    fn take_cells(&mut self, count: u32) -> Range<u32> {
        let first = self.free_cells.take(count as usize, self.cells);
        self.cells = self.cells.max(first + count as usize);
        first as u32..first as u32 + count
    }
}
