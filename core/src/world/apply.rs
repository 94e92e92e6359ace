//! Edits applied to a world: validated as a whole, then carried out on copies that share what stays the same.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;

use glam::{DMat4, Vec3};

use super::build;
use super::check::{check_kind, check_name, check_relit, check_strength, check_transform, error, invalid, unknown};
use super::motion::{is_rigid, move_light, transformed_light};
use super::openings::Openings;
use super::{Placed, Transition, Trees, Validity, World, WorldError, probe};
use crate::allowed::Allowed;
use crate::atlas::Atlas;
use crate::bvh::{BuildQuality, Bvh};
use crate::edit::{Edit, EditError, EditErrorKind, Lights, name_matches};
use crate::scene::{Light, LightKind, Object, Scene, merge_as_object};

impl World {
    /// Applies edits as a unit.
    ///
    /// # Errors
    /// [`EditError`], which names the field at fault; nothing has changed then.
    pub fn apply(&self, edits: &[Edit]) -> Result<Transition, EditError> {
        let draft = self.drafted(edits, Allowed::ASKED)?;
        check_relit(Allowed::ASKED, edits, &draft.world.scene.lights)?;
        draft.finish(self)
    }

    /// Applies edits that were accepted once: names and strengths may be what [`Allowed::KEPT`] says.
    ///
    /// # Errors
    /// [`EditError`], which names the field at fault.
    pub fn apply_again(&self, edits: &[Edit]) -> Result<Transition, EditError> {
        self.drafted(edits, Allowed::KEPT)?.finish(self)
    }

    fn drafted(&self, edits: &[Edit], allowed: Allowed) -> Result<Draft, EditError> {
        if edits.is_empty() {
            return Err(error("edits", "is empty", EditErrorKind::Invalid));
        }
        let mut draft = Draft::new(self, allowed);
        for (i, edit) in edits.iter().enumerate() {
            draft.apply(edit).map_err(|e| EditError { field: format!("edits[{i}].{}", e.field), ..e })?;
        }
        Ok(draft)
    }
}

/// A world under construction.
pub(super) struct Draft {
    pub(super) world: World,
    /// What names and strengths may be.
    pub(super) allowed: Allowed,
    /// Objects of the old world whose geometry is there no more, as they were.
    gone: BTreeMap<u32, Arc<Placed>>,
    /// Keys of objects whose geometry is new.
    come: BTreeSet<u32>,
    /// Where geometry changed, scene space.
    touched: Vec<(Vec3, Vec3)>,
}

impl Draft {
    fn new(world: &World, allowed: Allowed) -> Draft {
        Draft { world: world.clone(), allowed, gone: BTreeMap::new(), come: BTreeSet::new(), touched: Vec::new() }
    }

    /// The scene, to be changed.
    pub(super) fn scene_mut(&mut self) -> &mut Scene {
        Arc::make_mut(&mut self.world.scene)
    }

    /// An object, to be changed.
    pub(super) fn object_mut(&mut self, index: usize) -> &mut Object {
        Arc::make_mut(&mut self.scene_mut().objects[index])
    }

    fn apply(&mut self, edit: &Edit) -> Result<(), EditError> {
        match edit {
            Edit::Insert { asset, name, transform } => {
                check_transform(transform)?;
                self.check_free_name(name)?;
                let (mut object, lights) = merge_as_object(asset, name);
                object.world_from_object = *transform;
                for light in lights {
                    self.check_free_light(&light.name, Allowed::KEPT)?;
                    self.scene_mut().light_parents.insert(light.name.clone(), name.clone());
                    self.scene_mut().lights.push(transformed_light(light, transform));
                }
                self.add_object(Arc::new(object))
            }
            Edit::Remove { objects } => {
                self.find_all(objects)?.into_iter().rev().for_each(|i| self.remove_object(i));
                Ok(())
            }
            Edit::Move { object, transform } => {
                check_transform(transform)?;
                let index = self.object_index(object)?;
                self.move_object(index, transform)
            }
            Edit::Material { object, albedo } => self.repaint(object, *albedo),
            Edit::NamedMaterial { object, material, albedo } => {
                self.repaint_named(object.as_deref(), material, *albedo)
            }
            Edit::Hide { objects } => self.set_hidden(objects, true),
            Edit::Show { objects } => self.set_hidden(objects, false),
            Edit::Restore(restore) => self.restore(restore),
            Edit::Relight { lights } => lights.iter().enumerate().try_for_each(|(k, r)| {
                self.relight(r).map_err(|e| EditError { field: format!("lights[{k}].{}", e.field), ..e })
            }),
            Edit::InsertLight { name, kind, color, intensity } => {
                self.check_free_light(name, self.allowed)?;
                check_strength(self.allowed, Some(*color), Some(*intensity))?;
                if matches!(kind, LightKind::Emissive { .. }) {
                    return Err(invalid("light.kind", "an emissive surface is inserted as an object"));
                }
                let light = Light { name: name.clone(), kind: kind.clone(), color: *color, intensity: *intensity };
                check_kind(&light.kind)?;
                self.scene_mut().lights.push(light);
                Ok(())
            }
            Edit::Sky { kind, color, intensity } => self.set_sky(kind, *color, *intensity),
            Edit::RemoveLight { light } => {
                let index = self.light_index("light", light)?;
                self.scene_mut().lights.remove(index);
                self.scene_mut().light_parents.remove(light);
                Ok(())
            }
            Edit::MoveLight { light, position, direction, own_layer } => {
                let index = self.light_index("light", light)?;
                if *own_layer {
                    self.set_apart(light);
                }
                move_light(&mut self.scene_mut().lights[index].kind, *position, *direction)
            }
            Edit::GroupLights { group, lights } => self.group_lights(group.as_deref(), lights),
        }
    }

    /// Indices of all objects whose names match.
    pub(super) fn find_all(&self, patterns: &[String]) -> Result<BTreeSet<usize>, EditError> {
        if patterns.is_empty() {
            return Err(invalid("objects", "is empty"));
        }
        let mut indices = BTreeSet::new();
        for (k, name) in patterns.iter().enumerate() {
            let found = self.find_objects(name);
            if found.is_empty() {
                return Err(unknown(&format!("objects[{k}]"), "object", name));
            }
            indices.extend(found);
        }
        Ok(indices)
    }

    fn find_objects(&self, pattern: &str) -> Vec<usize> {
        let objects = self.world.scene.objects.iter().enumerate();
        let exact: Vec<usize> = objects.clone().filter(|(_, o)| o.name == pattern).map(|(i, _)| i).collect();
        if !exact.is_empty() || !pattern.contains('*') {
            return exact;
        }
        objects.filter(|(_, o)| name_matches(pattern, &o.name)).map(|(i, _)| i).collect()
    }

    pub(super) fn object_index(&self, name: &str) -> Result<usize, EditError> {
        let objects = &self.world.scene.objects;
        objects.iter().position(|o| o.name == name).ok_or_else(|| unknown("object", "object", name))
    }

    pub(super) fn light_index(&self, field: &str, name: &str) -> Result<usize, EditError> {
        let lights = &self.world.scene.lights;
        lights.iter().position(|l| l.name == name).ok_or_else(|| unknown(field, "light", name))
    }

    pub(super) fn check_free_name(&self, name: &str) -> Result<(), EditError> {
        check_name(self.allowed, name)?;
        if self.world.scene.objects.iter().any(|o| o.name == name) {
            return Err(error("name", format!("there is an object named {name:?} already"), EditErrorKind::Conflict));
        }
        Ok(())
    }

    fn check_free_light(&self, name: &str, allowed: Allowed) -> Result<(), EditError> {
        check_name(allowed, name)?;
        let Scene { lights, hidden_lights, .. } = &*self.world.scene;
        let hidden = hidden_lights.values().flatten().map(|hidden| &hidden.light);
        if lights.iter().chain(hidden).any(|l| l.name == name) {
            return Err(error("name", format!("there is a light named {name:?} already"), EditErrorKind::Conflict));
        }
        Ok(())
    }

    pub(super) fn add_object(&mut self, object: Arc<Object>) -> Result<(), EditError> {
        let world = &self.world;
        let ready =
            build::Ready::new(&world.scene, &object, world.resolution, &world.options).map_err(|e| too_large(&e))?;
        let present = self.world.placed.iter().map(|p| &*p.layout).chain([&*ready.layout]);
        build::check_size(present, world.spacing(), &world.options).map_err(|e| too_large(&e))?;
        let key = self.world.next_key;
        self.world.next_key += 1;
        let placed = ready.place(&mut self.world.space, &object, key, false);
        self.touched.push(placed.surface.bounds());
        self.scene_mut().objects.push(object);
        self.world.placed.push(Arc::new(placed));
        self.come.insert(key);
        Ok(())
    }

    pub(super) fn remove_object(&mut self, index: usize) {
        let object = self.scene_mut().objects.remove(index);
        let placed = self.world.placed.remove(index);
        let Scene { lights, light_parents, hidden_lights, .. } = self.scene_mut();
        hidden_lights.remove(&object.name);
        // Its emissive surfaces go with it, and the lamps that hang on it.
        lights.retain(|l| match &l.kind {
            LightKind::Emissive { object: o, .. } => *o != object.name,
            _ => light_parents.get(&l.name) != Some(&object.name),
        });
        light_parents.retain(|_, parent| *parent != object.name);
        self.world.space.clear(&placed.placement);
        self.take_out(&placed);
    }

    /// Notes that an object's present geometry goes, and takes it out of the trees.
    fn take_out(&mut self, placed: &Arc<Placed>) {
        self.touched.push(placed.surface.bounds());
        if !self.come.remove(&placed.key) {
            self.gone.entry(placed.key).or_insert_with(|| Arc::clone(placed));
        }
        let trees = &mut self.world.trees;
        let small = trees.small.len();
        trees.small.retain(|(key, _)| *key != placed.key);
        if trees.small.len() == small {
            let mut mask = trees.gone.as_deref().cloned().unwrap_or_default();
            placed.placement.faces.clone().for_each(|id| mask.set(id, true));
            trees.gone = Some(Arc::new(mask));
        }
    }

    pub(super) fn move_object(&mut self, index: usize, transform: &DMat4) -> Result<(), EditError> {
        let old = Arc::clone(&self.world.placed[index]);
        let mut object = Object::clone(&self.world.scene.objects[index]);
        let step = *transform * object.world_from_object.inverse();
        object.world_from_object = *transform;
        self.move_lamps_of(&object.name, &step);
        if object.is_hidden {
            self.scene_mut().objects[index] = Arc::new(object);
            return Ok(());
        }
        if !is_rigid(&step) {
            // Another size asks for other elements.
            return self.replace_object(index, Arc::new(object));
        }
        let to_scene = DMat4::from_translation(-self.world.scene.origin);
        let motion = to_scene * step * to_scene.inverse();
        let surface = Arc::new(old.surface.transformed(&motion));
        let elements = self.world.space.elements_of(&old.placement, &old.layout).transformed(&motion);
        self.world.space.write(&old.placement, &elements, old.with_back);
        self.take_out(&old);
        self.touched.push(surface.bounds());
        self.come.insert(old.key);
        let placed = Placed {
            key: old.key,
            surface,
            see_through: old.see_through.clone(),
            facets: old.facets.clone(),
            layout: Arc::clone(&old.layout),
            coarse: Arc::clone(&old.coarse),
            placement: old.placement.clone(),
            with_back: old.with_back,
            reach: elements.reach(),
        };
        self.scene_mut().objects[index] = Arc::new(object);
        self.world.placed[index] = Arc::new(placed);
        Ok(())
    }

    /// Lamps that hang on an object go where it goes.
    fn move_lamps_of(&mut self, object: &str, step: &DMat4) {
        let Scene { lights, light_parents, hidden_lights, .. } = self.scene_mut();
        let of_object = |light: &&mut Light| light_parents.get(&light.name).is_some_and(|parent| parent == object);
        let hidden = hidden_lights.get_mut(object).into_iter().flatten().filter(|hidden| hidden.hangs);
        let all = lights.iter_mut().filter(of_object).chain(hidden.map(|hidden| &mut hidden.light));
        all.for_each(|light| *light = transformed_light(light.clone(), step));
    }

    /// An object leaves its slots and another comes in new ones. In the list it stays where it was, and what hangs on it
    /// stays there, too.
    pub(super) fn replace_object(&mut self, index: usize, object: Arc<Object>) -> Result<(), EditError> {
        let lights = Lights::of(&self.world.scene);
        self.remove_object(index);
        self.add_object(object)?;
        self.scene_mut().objects[index..].rotate_right(1);
        self.world.placed[index..].rotate_right(1);
        self.set_lights(lights);
        Ok(())
    }

    fn finish(mut self, before: &World) -> Result<Transition, EditError> {
        let scene = self.scene_mut();
        let names: BTreeSet<&str> = scene.lights.iter().map(|light| light.name.as_str()).collect();
        scene.groups.retain(|light, _| names.contains(light.as_str()));
        // An object that came and went within the request leaves a trace in `touched` only, which is harmless.
        let changed = !self.gone.is_empty() || !self.come.is_empty();
        let common = self.world.trees.clone();
        self.world.emitters = Arc::new(self.world.resolve_emitters());
        if changed {
            self.build_small_trees();
            self.settle_new_objects()?;
        } else {
            // Slots that an object had while it was there.
            self.world.space.take_geometry(&before.space);
        }
        let Draft { mut world, gone, come, touched, .. } = self;
        let mut ranges = Vec::new();
        if changed {
            let placed = world.placed.iter().filter(|p| come.contains(&p.key));
            ranges = placed.map(|p| p.placement.elements.clone()).collect();
            let grown: Vec<(Vec3, Vec3)> = touched
                .iter()
                .map(|(l, h)| (*l - Vec3::splat(world.spacing()), *h + Vec3::splat(world.spacing())))
                .collect();
            world.validity = Arc::new(Validity::updated(&before.validity, &world, &ranges, &grown));
            world.look_around(Some(&grown), |placed| come.contains(&placed.key));
            world.find_behind(Some(&grown), |placed| come.contains(&placed.key));
            world.atlas = next_atlas(&world)?;
        }
        let come_trees = world.placed.iter().filter(|p| come.contains(&p.key));
        let come_tree = merged_tree(come_trees.map(|p| &**p), &world.trees.openings);
        let gone_tree = merged_tree(gone.values().map(|p| &**p), &before.trees.openings);
        let new_rows = new_rows(before, &world, &ranges);
        let came = |slot: &u32| ranges.iter().any(|r| r.contains(slot));
        let filled_rows = new_rows.iter().copied().filter(|slot| !came(slot)).collect();
        Ok(Transition {
            before: before.clone(),
            common,
            gone: gone_tree,
            come: come_tree,
            new_rows,
            filled_rows,
            after: world,
        })
    }

    /// Trees of what came.
    fn build_small_trees(&mut self) {
        self.world.trees.generation += 1;
        self.note_openings();
        for placed in self.world.placed.iter().filter(|p| self.come.contains(&p.key)) {
            self.world.trees.small.push((placed.key, build::small_tree(placed)));
        }
    }

    /// Backs and solidity of what came, now that it can be asked with rays.
    fn settle_new_objects(&mut self) -> Result<(), EditError> {
        let indices: Vec<usize> =
            (0..self.world.placed.len()).filter(|&i| self.come.contains(&self.world.placed[i].key)).collect();
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

/// Rows that get their first value: of objects that came, and of elements that were invalid. Ascending.
fn new_rows(before: &World, after: &World, ranges: &[Range<u32>]) -> Vec<u32> {
    let is_computed = |slot: u32| after.areas()[slot as usize] > 0.0 && after.validity.is_valid(slot as usize);
    let is_of_new = |slot: u32| ranges.iter().any(|range| range.contains(&slot));
    let came = ranges.iter().cloned().flatten();
    let came_out = before.validity.invalid_of(&(0..u32::MAX)).iter().copied().filter(|&slot| {
        let owners =
            [&before.space.slots().owners, &after.space.slots().owners].map(|owners| owners.get(slot as usize));
        owners[0] == owners[1] && !is_of_new(slot)
    });
    let mut rows: Vec<u32> = came.chain(came_out).filter(|&slot| is_computed(slot)).collect();
    rows.sort_unstable();
    rows
}

/// The atlas of a world whose own is that before an edit.
fn next_atlas(world: &World) -> Result<Option<Arc<Atlas>>, EditError> {
    let Some(atlas) = &world.atlas else { return Ok(None) };
    let next = atlas.next(world.atlas_items());
    next.map(|next| Some(Arc::new(next))).map_err(|e| error("edits", e.to_string(), EditErrorKind::TooLarge))
}

fn too_large(error: &WorldError) -> EditError {
    EditError { field: "asset".to_owned(), reason: error.to_string(), kind: EditErrorKind::TooLarge }
}
