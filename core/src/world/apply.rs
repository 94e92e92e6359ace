//! Edits applied to a world: validated as a whole, then carried out on copies that share what stays the same.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use glam::Vec3;

use super::check::{check_kind, check_name, check_relit, check_strength, check_transform, error, invalid, unknown};
use super::motion::{move_light, transformed_light};
use super::{Placed, Transition, World};
use crate::allowed::Allowed;
use crate::edit::{Edit, EditError, EditErrorKind, name_matches};
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

    /// Whether objects may go where edits put them: told before anybody asks what their elements would take.
    ///
    /// # Errors
    /// [`EditError`], which names the field at fault.
    pub fn check_places(&self, edits: &[Edit]) -> Result<(), EditError> {
        for (i, edit) in edits.iter().enumerate() {
            let (Edit::Insert { transform, .. } | Edit::Move { transform, .. }) = edit else { continue };
            check_transform(Allowed::ASKED, self.scene.origin, transform).map_err(|e| e.in_list(i))?;
        }
        Ok(())
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
            draft.apply(edit).map_err(|e| e.in_list(i))?;
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
    pub(super) removed: BTreeMap<u32, Arc<Placed>>,
    /// Keys of objects whose geometry is new.
    pub(super) inserted: BTreeSet<u32>,
    /// Where geometry changed, scene space.
    pub(super) touched: Vec<(Vec3, Vec3)>,
}

impl Draft {
    fn new(world: &World, allowed: Allowed) -> Draft {
        Draft {
            world: world.clone(),
            allowed,
            removed: BTreeMap::new(),
            inserted: BTreeSet::new(),
            touched: Vec::new(),
        }
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
                check_transform(self.allowed, self.world.scene.origin, transform)?;
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
                check_transform(self.allowed, self.world.scene.origin, transform)?;
                let index = self.object_index(object)?;
                self.move_object(index, transform)
            }
            Edit::Material { object, albedo } => self.repaint(Some(object), None, *albedo),
            Edit::NamedMaterial { object, material, albedo } => {
                self.repaint(object.as_deref(), Some(material), *albedo)
            }
            Edit::Tint { object, material, factor } => self.tint(object.as_deref(), material.as_deref(), *factor),
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
                check_kind(self.allowed, self.world.scene.origin, &light.kind)?;
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
                let origin = self.world.scene.origin;
                let far = |reason: String| invalid("position", &reason);
                position.map_or(Ok(()), |to| self.allowed.check_place(to, origin).map_err(far))?;
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
}
