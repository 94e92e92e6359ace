//! What a client may ask of a world.

use std::collections::BTreeSet;

use glam::{DVec3, Vec3};

use super::World;
use crate::scene::{Light, LightKind, Object, capped_text};
use crate::space::NO_OBJECT;

/// An object as clients see it.
#[derive(Clone, Debug)]
pub struct ObjectInfo<'a> {
    /// Position in the list of objects: what [`World::object_indices`] answers.
    pub index: u32,
    /// Unique name.
    pub name: &'a str,
    /// First element slot.
    pub first_element: u32,
    /// Element slots; those of the back, where it has any, are the second half.
    pub element_count: u32,
    /// The second half of the slots belongs to the back.
    pub with_back: bool,
    /// Triangles between its elements.
    pub triangle_count: u32,
    /// World-space bounds, metres.
    pub bounds: (DVec3, DVec3),
    /// Area-weighted mean of the albedo as the file or a repaint has it; light meets at most
    /// [`crate::WorldOptions::max_albedo`].
    pub albedo: Vec3,
}

/// A light as clients see it.
#[derive(Clone, Debug)]
pub struct LightInfo<'a> {
    /// The light itself.
    pub light: &'a Light,
    /// `emissive`, `point`, `spot`, `directional` or `environment`.
    pub kind: &'static str,
}

impl World {
    /// All objects, in order.
    pub fn objects(&self) -> impl Iterator<Item = ObjectInfo<'_>> {
        self.placed.iter().zip(&self.scene.objects).enumerate().map(|(index, (placed, object))| {
            let surface = &placed.surface;
            // An object without triangles is where its origin is.
            let place = (object.world_from_object.w_axis.truncate() - self.scene.origin).as_vec3();
            let (low, high) = if surface.positions.is_empty() { (place, place) } else { surface.bounds() };
            let (mut albedo, mut area) = (Vec3::ZERO, 0.0);
            let parts = self.space.parts_of(&placed.placement);
            for ([a, b, c], m) in surface.all_corners().zip(&surface.triangle_materials) {
                let weight = (b - a).cross(c - a).length();
                albedo += parts[*m as usize].told_albedo * weight;
                area += weight;
            }
            ObjectInfo {
                index: index as u32,
                name: &object.name,
                first_element: placed.placement.elements.start,
                element_count: placed.placement.elements.len() as u32,
                with_back: placed.with_back,
                triangle_count: placed.layout.cell_count() as u32,
                bounds: (low.as_dvec3() + self.scene.origin, high.as_dvec3() + self.scene.origin),
                albedo: if area > 0.0 { albedo / area } else { mean_albedo(object) },
            }
        })
    }

    /// What a client should know of the scene as it is: the warnings of its file that still hold, and which materials
    /// reflect more than the world allows, be it by an edit.
    pub fn warnings(&self) -> Vec<String> {
        const NAMED: usize = 4;
        let text = capped_text(self.options.max_albedo);
        let of_file = self.scene.present_warnings();
        let mut warnings: Vec<String> = of_file.into_iter().filter(|warning| !warning.starts_with(&text)).collect();
        let mut capped = BTreeSet::new();
        for (placed, object) in self.placed.iter().zip(&self.scene.objects) {
            let parts = self.space.parts_of(&placed.placement).iter().enumerate();
            capped.extend(parts.filter(|(_, part)| part.is_capped).map(|(k, _)| {
                let name = object.material_names.get(k).filter(|name| !name.is_empty());
                name.map_or(format!("a material of {:?}", object.name), |name| format!("material {name:?}"))
            }));
        }
        if !capped.is_empty() {
            let more = capped.len().saturating_sub(NAMED);
            let named = capped.into_iter().take(NAMED).collect::<Vec<_>>().join(", ");
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            warnings.push(format!("{text}: {named}{more}"));
        }
        warnings
    }

    /// All lights, in order.
    pub fn lights(&self) -> impl Iterator<Item = LightInfo<'_>> {
        self.scene.lights.iter().map(|light| LightInfo { light, kind: kind_name(&light.kind) })
    }

    /// Position in [`World::objects`] of the object of each slot; [`NO_OBJECT`] in holes.
    pub fn object_indices(&self) -> Vec<u32> {
        let mut indices = vec![NO_OBJECT; self.slots()];
        for (index, placed) in self.placed.iter().enumerate() {
            let range = placed.placement.element_indices();
            indices[range].fill(index as u32);
        }
        indices
    }
}

/// Of an object without a surface for light: the mean of its materials.
fn mean_albedo(object: &Object) -> Vec3 {
    let sum: Vec3 = object.materials.iter().map(|material| material.albedo).sum();
    sum / object.materials.len().max(1) as f32
}

fn kind_name(kind: &LightKind) -> &'static str {
    match kind {
        LightKind::Emissive { .. } => "emissive",
        LightKind::Point { .. } => "point",
        LightKind::Spot { .. } => "spot",
        LightKind::Directional { .. } => "directional",
        LightKind::Environment | LightKind::Sky { .. } => "environment",
    }
}
