//! What triangles of one object and material have in common.

use std::sync::Arc;

use glam::Vec3;

use super::albedo::Albedo;
use super::layout::Layout;
use super::slots::NO_OBJECT;

/// The triangles of one object that share a material.
#[derive(Clone, Debug)]
pub(crate) struct Part {
    /// Diffuse albedo as light has it, where it is the same all over; that of its mean elsewhere.
    pub albedo: Vec3,
    /// What clients are told: of the file or the paint, before the world's cap; where albedo goes by place, the mean
    /// over the object.
    pub told_albedo: Vec3,
    /// What clients are told is somewhere above the world's cap.
    pub is_capped: bool,
    /// Per element of one side of the object, where it is not.
    pub albedos: Option<Arc<[Vec3]>>,
    /// Key of the object; [`super::NO_OBJECT`] where the part is free.
    pub object: u32,
    /// Of the object's triangles: longest side of their boxes, m.
    pub extent: f32,
    /// Both sides reflect.
    pub double_sided: bool,
    /// The object bounds a volume that light does not enter: a ray that meets its back starts inside it.
    pub solid: bool,
    /// Slot of the object's first element.
    pub(super) first_slot: u32,
    /// What to add to slots of the front to get those of the back; 0: the back has no elements.
    pub(super) back_offset: u32,
    /// Slot of the object's first triangle.
    pub(super) first_face: u32,
    /// Id of the object's first cell.
    pub(super) first_cell: u32,
    pub(super) layout: Arc<Layout>,
}

impl Part {
    /// Of no object.
    pub(super) fn free() -> Part {
        Part {
            albedo: Vec3::ZERO,
            told_albedo: Vec3::ZERO,
            is_capped: false,
            albedos: None,
            object: NO_OBJECT,
            extent: 0.0,
            double_sided: false,
            solid: false,
            first_slot: 0,
            back_offset: 0,
            first_face: 0,
            first_cell: 0,
            layout: Arc::default(),
        }
    }

    /// What it reflects, as it was placed.
    pub(crate) fn albedo(&self) -> Albedo {
        Albedo { told: self.told_albedo, reflected: self.albedo, is_capped: self.is_capped }
    }

    /// Whether light that meets one is reflected as by the other.
    pub(crate) fn reflects_like(&self, other: &Part) -> bool {
        let same_albedos = match (&self.albedos, &other.albedos) {
            (Some(a), Some(b)) => Arc::ptr_eq(a, b) || a == b,
            (a, b) => a.is_none() && b.is_none(),
        };
        self.albedo == other.albedo
            && same_albedos
            && self.double_sided == other.double_sided
            && self.solid == other.solid
    }
}

/// Equal where light is: layouts are compared by identity.
impl PartialEq for Part {
    fn eq(&self, other: &Part) -> bool {
        let of = |part: &Part| {
            let places = [part.object, part.first_slot, part.back_offset, part.first_face, part.first_cell];
            (part.albedo, part.double_sided, part.solid, places)
        };
        let same_albedos = match (&self.albedos, &other.albedos) {
            (Some(a), Some(b)) => Arc::ptr_eq(a, b),
            (a, b) => a.is_none() && b.is_none(),
        };
        same_albedos && of(self) == of(other) && Arc::ptr_eq(&self.layout, &other.layout)
    }
}
