//! The end of a request: trees of what was inserted, what it hides and closes, and the way from the world before to
//! that after.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;

use glam::Vec3;

use super::apply::Draft;
use super::build;
use super::check::error;
use super::openings::Openings;
use super::{Placed, Transition, Trees, Validity, World, probe};
use crate::atlas::Atlas;
use crate::bvh::{BuildQuality, Bvh};
use crate::edit::{EditError, EditErrorKind};
use crate::scene::LightKind;

impl Draft {
    /// The transition from the world before, which is `before`.
    pub(super) fn finish(mut self, before: &World) -> Result<Transition, EditError> {
        let scene = self.scene_mut();
        let names: BTreeSet<&str> = scene.lights.iter().map(|light| light.name.as_str()).collect();
        scene.groups.retain(|light, _| names.contains(light.as_str()));
        self.world.emitters = Arc::new(self.world.resolve_emitters());
        self.open_to_new_lamps(before)?;
        // An object that is inserted and removed within the request leaves a trace in `touched` only, which is
        // harmless.
        let changed = !self.removed.is_empty() || !self.inserted.is_empty();
        let common = self.world.trees.clone();
        if changed {
            self.build_small_trees();
            self.finish_new_objects()?;
        } else {
            // Slots that an object had while it was there.
            self.world.space.take_geometry(&before.space);
        }
        let Draft { mut world, removed, inserted, touched, .. } = self;
        let mut ranges = Vec::new();
        if changed {
            let placed = world.placed.iter().filter(|p| inserted.contains(&p.key));
            ranges = placed.map(|p| p.placement.elements.clone()).collect();
            let grown: Vec<(Vec3, Vec3)> = touched
                .iter()
                .map(|(l, h)| (*l - Vec3::splat(world.spacing()), *h + Vec3::splat(world.spacing())))
                .collect();
            world.validity = Arc::new(Validity::updated(&before.validity, &world, &ranges, &grown));
            world.look_around(Some(&grown), |placed| inserted.contains(&placed.key));
            world.find_behind(Some(&grown), |placed| inserted.contains(&placed.key));
            world.atlas = next_atlas(&world)?;
        }
        let inserted_trees = world.placed.iter().filter(|p| inserted.contains(&p.key));
        let inserted_tree = merged_tree(inserted_trees.map(|p| &**p), &world.trees.openings);
        let removed_tree = merged_tree(removed.values().map(|p| &**p), &before.trees.openings);
        let new_slots = new_slots(before, &world, &ranges);
        let inserted = |slot: &u32| ranges.iter().any(|r| r.contains(slot));
        let filled_slots = new_slots.iter().copied().filter(|slot| !inserted(slot)).collect();
        Ok(Transition {
            before: before.clone(),
            common,
            removed: removed_tree,
            inserted: inserted_tree,
            new_slots,
            filled_slots,
            after: world,
        })
    }

    /// Objects on whose backs lamps shine that come or move take new slots, which have a back.
    fn open_to_new_lamps(&mut self, before: &World) -> Result<(), EditError> {
        let of_before: BTreeMap<&str, &LightKind> =
            before.scene.lights.iter().map(|light| (light.name.as_str(), &light.kind)).collect();
        let lights = self.world.scene.lights.iter();
        let new: BTreeSet<&str> = lights
            .filter(|light| of_before.get(light.name.as_str()).is_none_or(|kind| **kind != light.kind))
            .map(|light| light.name.as_str())
            .collect();
        let lit = self.world.lit_from_behind(|lamp| lamp.object.is_none() && new.contains(lamp.name.as_str()));
        for &index in &lit {
            let object = Arc::clone(&self.world.scene.objects[index]);
            self.replace_object(index, object).map_err(|e| EditError { field: "edits".to_owned(), ..e })?;
        }
        if !lit.is_empty() {
            self.world.emitters = Arc::new(self.world.resolve_emitters());
        }
        Ok(())
    }

    /// Trees of what was inserted.
    fn build_small_trees(&mut self) {
        self.world.trees.generation += 1;
        self.note_openings();
        for placed in self.world.placed.iter().filter(|p| self.inserted.contains(&p.key)) {
            self.world.trees.small.push((placed.key, build::small_tree(placed)));
        }
    }

    /// Backs and solidity of what was inserted, now that it can be asked with rays.
    fn finish_new_objects(&mut self) -> Result<(), EditError> {
        let indices: Vec<usize> =
            (0..self.world.placed.len()).filter(|&i| self.inserted.contains(&self.world.placed[i].key)).collect();
        for index in indices {
            let placed = Arc::clone(&self.world.placed[index]);
            if !placed.with_back && probe::back_seen(&self.world, index) {
                self.give_back(index, &placed);
            }
            let placed = Arc::clone(&self.world.placed[index]);
            let solid = self.world.is_solid(&placed);
            self.world.space.parts_of_mut(&placed.placement).iter_mut().for_each(|p| p.solid = solid);
        }
        let limit = self.world.options.max_elements;
        if self.world.element_count() > limit {
            let reason = format!("the scene would have more than {limit} elements");
            return Err(error("edits", reason, EditErrorKind::TooLarge));
        }
        Ok(())
    }

    /// What lets light through now.
    fn note_openings(&mut self) {
        self.world.trees.openings = Openings::of(self.world.placed.iter().map(|placed| &**placed));
    }

    /// Places an object again, with elements on its back.
    fn give_back(&mut self, index: usize, old: &Placed) {
        let ready = build::Ready::again(&self.world, old);
        self.world.space.clear(&old.placement);
        let placed = ready.place(&mut self.world.space, &self.world.scene.objects[index], old.key, true);
        // The triangles may have found another hole than before.
        let tree = build::small_tree(&placed);
        self.world.trees.small.retain(|(key, _)| *key != placed.key);
        self.world.trees.small.push((placed.key, tree));
        self.world.placed[index] = Arc::new(placed);
        self.note_openings();
    }
}

/// One tree over some objects of a world that has these openings.
fn merged_tree<'a>(objects: impl Iterator<Item = &'a Placed>, openings: &Option<Arc<Openings>>) -> Option<Trees> {
    let (corners, ids) = build::corners_of(objects);
    (!ids.is_empty()).then(|| Trees::of(Bvh::build(&corners, &ids, BuildQuality::Fast), openings.clone(), 0))
}

/// Slots that get their first value: of inserted objects, and of elements that were invalid. Ascending.
fn new_slots(before: &World, after: &World, ranges: &[Range<u32>]) -> Vec<u32> {
    let is_of_new = |slot: u32| ranges.iter().any(|range| range.contains(&slot));
    let inserted = ranges.iter().cloned().flatten();
    let uncovered = before.validity.invalid_of(&(0..u32::MAX)).iter().copied().filter(|&slot| {
        let owners =
            [&before.space.slots().owners, &after.space.slots().owners].map(|owners| owners.get(slot as usize));
        owners[0] == owners[1] && !is_of_new(slot)
    });
    let mut slots: Vec<u32> = inserted.chain(uncovered).filter(|&slot| after.is_computed(slot as usize)).collect();
    slots.sort_unstable();
    slots
}

/// The atlas of a world whose own is that before an edit.
fn next_atlas(world: &World) -> Result<Option<Arc<Atlas>>, EditError> {
    let Some(atlas) = &world.atlas else { return Ok(None) };
    let next = atlas.next(world.atlas_items());
    next.map(|next| Some(Arc::new(next))).map_err(|e| error("edits", e.to_string(), EditErrorKind::TooLarge))
}
