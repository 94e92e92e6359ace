//! From one world to the next.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::{Placed, Trees, World, build};
use crate::lightmap::{BLOCK_SLOTS, Layer, LightBlock, LightMap, LightValues, SparseLight};
use crate::space::{NO_OBJECT, Part};

/// Slots per task.
const CHUNK: usize = 4096;

/// From one world to the next: what an update needs to know.
#[derive(Clone)]
pub struct Transition {
    /// The world the present map is right for.
    pub before: World,
    /// The world after all edits.
    pub after: World,
    /// What stands in both worlds.
    pub(crate) common: Trees,
    /// What stood only in `before`; ids are triangle slots of `before`.
    pub(crate) removed: Option<Trees>,
    /// What stands only in `after`; ids are triangle slots of `after`.
    pub(crate) inserted: Option<Trees>,
    /// Elements without an old value that is worth anything: of inserted and moved objects, and those that were invalid
    /// (inside a solid or behind a surface) and are so no more. Valid ones only, ascending.
    pub(crate) new_slots: Vec<u32>,
    /// Those of them that belong to unchanged objects: they had values copied from neighbours.
    pub(crate) filled_slots: Vec<u32>,
}

impl std::fmt::Debug for Transition {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Transition")
            .field("slots", &(self.before.slots(), self.after.slots()))
            .field("removed", &self.removed.as_ref().map(|t| t.triangle_count()))
            .field("inserted", &self.inserted.as_ref().map(|t| t.triangle_count()))
            .field("new_slots", &self.new_slots.len())
            .finish_non_exhaustive()
    }
}

impl Transition {
    /// The old map in the slots of the new world: old values where elements stay, zero where they go or come.
    pub fn carry_over(&self, map: &LightMap) -> LightMap {
        let carry = |light: &LightValues| LightValues {
            direct: self.carry(&light.direct),
            indirect: self.carry(&light.indirect),
            variance: self.carry(&light.variance),
        };
        let layers = map.layers.iter().map(|layer| self.carried_layer(layer)).collect();
        LightMap { light: carry(&map.light), layers }
    }

    /// A layer in the slots of the new world; itself where every slot keeps its element.
    pub(crate) fn carried_layer(&self, layer: &Arc<Layer>) -> Arc<Layer> {
        if self.keeps_slots() {
            return Arc::clone(layer);
        }
        let (name, lights) = (layer.name.clone(), layer.lights.clone());
        Arc::new(Layer { name, lights, light: self.carry_layer(&layer.light) })
    }

    /// A layer in the slots of the new world, with nothing in those that are `out`.
    pub(crate) fn carried_without(&self, layer: &Arc<Layer>, out: &[bool]) -> Arc<Layer> {
        let touches = |(index, block): (usize, LightBlock)| {
            let first = index * BLOCK_SLOTS;
            out[first..first + block.direct.len()].iter().any(|out| *out)
        };
        if self.keeps_slots() && !layer.light.blocks().any(touches) {
            return Arc::clone(layer);
        }
        let (name, lights) = (layer.name.clone(), layer.lights.clone());
        Arc::new(Layer { name, lights, light: self.carry_blocks(&layer.light, |slot| self.keeps(slot) && !out[slot]) })
    }

    /// The light of a layer in the slots of the new world.
    fn carry_layer(&self, light: &SparseLight) -> SparseLight {
        self.carry_blocks(light, |slot| self.keeps(slot))
    }

    fn carry_blocks(&self, light: &SparseLight, keeps: impl Fn(usize) -> bool) -> SparseLight {
        let slots = self.after.slots();
        let carried = |(index, block): (usize, LightBlock)| {
            let own = index * BLOCK_SLOTS..slots.min((index + 1) * BLOCK_SLOTS);
            let mut values = LightValues::black(own.len());
            let stays = |k: &usize| keeps(own.start + k);
            for k in (0..block.direct.len().min(own.len())).filter(stays) {
                (values.direct[k], values.indirect[k]) = (block.direct[k], block.indirect[k]);
                values.variance[k] = block.variance[k];
            }
            (index, values)
        };
        let blocks: Vec<(usize, LightValues)> = light.blocks().map(carried).collect();
        SparseLight::of_blocks(slots, blocks.iter().map(|(index, values)| (*index, values.block(0))))
    }

    /// The map of [`Transition::carry_over`]: the old one itself where every slot keeps its element, as by edits of
    /// lights and albedos.
    pub fn carried(&self, map: &Arc<LightMap>) -> Arc<LightMap> {
        if self.keeps_slots() { Arc::clone(map) } else { Arc::new(self.carry_over(map)) }
    }

    /// Slots of the new world whose elements get no light of their own by [`Transition::carry_over`]: those of objects
    /// that came or moved, and those that came out of solids. In no order, some more than once.
    pub fn slots_without_light(&self) -> Vec<u32> {
        let known: BTreeMap<u32, &Arc<Placed>> = self.before.placed.iter().map(|p| (p.key, p)).collect();
        let stays = |p: &&Arc<Placed>| {
            let old = known.get(&p.key);
            old.is_some_and(|old| {
                Arc::ptr_eq(&old.surface, &p.surface) && old.placement.elements == p.placement.elements
            })
        };
        let inserted = self.after.placed.iter().filter(|p| !stays(p)).flat_map(|p| p.placement.elements.clone());
        self.new_slots.iter().copied().chain(inserted).collect()
    }

    /// Whether every slot holds the same element in both worlds.
    pub(crate) fn keeps_slots(&self) -> bool {
        self.before.space.has_slots_of(&self.after.space)
    }

    /// Whether a slot of the new world holds the same element in both.
    #[inline]
    pub(crate) fn keeps(&self, slot: usize) -> bool {
        let (old, new) = (&self.before.space.slots().owners, &self.after.space.slots().owners);
        new[slot] != NO_OBJECT && old.get(slot) == Some(&new[slot])
    }

    /// Values in the slots of the new world.
    pub(crate) fn carry<T: Copy + Default + Send + Sync>(&self, values: &[T]) -> Vec<T> {
        // Nothing is known, unless there was nothing to know it of.
        let is_absent = values.is_empty() && self.before.slots() > 0;
        if is_absent { Vec::new() } else { self.carry_each(|slot| values[slot]) }
    }

    /// What `value` tells of every slot of the old world, in the slots of the new world.
    pub(crate) fn carry_each<T: Default + Send>(&self, value: impl Fn(usize) -> T + Send + Sync) -> Vec<T> {
        let slots = (0..self.after.slots()).into_par_iter().with_min_len(CHUNK);
        if self.keeps_slots() {
            return slots.map(value).collect();
        }
        slots.map(|slot| if self.keeps(slot) { value(slot) } else { T::default() }).collect()
    }

    /// Corners of everything that was inserted or removed.
    pub(crate) fn changed_triangles(&self) -> Vec<[Vec3; 3]> {
        build::corners_of(self.changed_objects()).0
    }

    /// Boxes around every object that was inserted, removed or moved, where it was and where it is.
    pub(crate) fn changed_bounds(&self) -> Vec<(Vec3, Vec3)> {
        self.changed_objects().into_iter().map(|p| p.surface.bounds()).collect()
    }

    /// Keys of every object that was inserted, removed or moved.
    pub(crate) fn changed_keys(&self) -> Vec<u32> {
        self.changed_objects().into_iter().map(|placed| placed.key).collect()
    }

    fn changed_objects(&self) -> Vec<&Placed> {
        let same = |a: &Placed, b: &Placed| a.key == b.key && Arc::ptr_eq(&a.surface, &b.surface);
        let only = |these: &'_ [Arc<Placed>], those: &[Arc<Placed>]| -> Vec<usize> {
            let known: BTreeMap<u32, &Arc<Placed>> = those.iter().map(|p| (p.key, p)).collect();
            let differs = |&i: &usize| {
                !these[i].surface.triangles.is_empty() && !known.get(&these[i].key).is_some_and(|q| same(&these[i], q))
            };
            (0..these.len()).filter(differs).collect()
        };
        let (before, after) = (&self.before.placed, &self.after.placed);
        let removed = only(before, after).into_iter().map(|i| &*before[i]);
        removed.chain(only(after, before).into_iter().map(|i| &*after[i])).collect()
    }

    /// Change of albedo per part of the new world.
    pub(crate) fn repaint(&self) -> Vec<Vec3> {
        let before = self.before.space.parts();
        let change = |(i, part): (usize, &Part)| {
            let old = before.get(i).filter(|old| old.object == part.object);
            old.map_or(Vec3::ZERO, |old| part.albedo - old.albedo)
        };
        self.after.space.parts().iter().enumerate().map(change).collect()
    }

    /// Whether an albedo changed.
    pub(crate) fn repaints_anything(&self) -> bool {
        self.repaint().iter().any(|change| *change != Vec3::ZERO)
    }

    /// Whether surfaces changed, their places or their albedos, and not only lights.
    pub(crate) fn changes_surfaces(&self) -> bool {
        self.moves_geometry() || !self.new_slots.is_empty() || self.repaints_anything()
    }

    /// Whether geometry changed (and not only light or albedo).
    pub fn moves_geometry(&self) -> bool {
        self.removed.is_some() || self.inserted.is_some()
    }
}
