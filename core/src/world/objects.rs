//! Objects that come, go, move or change places, in a world under construction.

use std::sync::Arc;

use glam::DMat4;

use super::apply::Draft;
use super::build;
use super::motion::{is_rigid, transformed_light};
use super::{Placed, WorldError};
use crate::edit::{EditError, EditErrorKind, Lights};
use crate::scene::{Light, LightKind, Object, Scene};

impl Draft {
    pub(super) fn add_object(&mut self, object: Arc<Object>) -> Result<(), EditError> {
        let world = &self.world;
        let ready =
            build::Ready::new(&world.scene, &object, &world.resolution, &world.options).map_err(|e| too_large(&e))?;
        let present = self.world.placed.iter().map(|p| &*p.layout).chain([&*ready.layout]);
        build::check_size(present, world.spacing(), &world.options).map_err(|e| too_large(&e))?;
        let key = self.world.next_key;
        self.world.next_key += 1;
        let placed = ready.place(&mut self.world.space, &object, key, false);
        self.touched.push(placed.surface.bounds());
        self.scene_mut().objects.push(object);
        self.world.placed.push(Arc::new(placed));
        self.inserted.insert(key);
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
        if !self.inserted.remove(&placed.key) {
            self.removed.entry(placed.key).or_insert_with(|| Arc::clone(placed));
        }
        let trees = &mut self.world.trees;
        let small = trees.small.len();
        trees.small.retain(|(key, _)| *key != placed.key);
        if trees.small.len() == small {
            let mut mask = trees.removed.as_deref().cloned().unwrap_or_default();
            placed.placement.faces.clone().for_each(|id| mask.set(id, true));
            trees.removed = Some(Arc::new(mask));
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
        self.inserted.insert(old.key);
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

    /// An object leaves its slots and another comes in new ones. In the list it stays where it was, and what hangs on
    /// it stays there, too.
    pub(super) fn replace_object(&mut self, index: usize, object: Arc<Object>) -> Result<(), EditError> {
        let lights = Lights::of(&self.world.scene);
        self.remove_object(index);
        self.add_object(object)?;
        self.scene_mut().objects[index..].rotate_right(1);
        self.world.placed[index..].rotate_right(1);
        self.set_lights(lights);
        Ok(())
    }
}

fn too_large(error: &WorldError) -> EditError {
    EditError { field: "asset".to_owned(), reason: error.to_string(), kind: EditErrorKind::TooLarge }
}
