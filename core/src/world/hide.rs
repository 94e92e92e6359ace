//! Objects that are there and take no part in light: without surface, elements and lights until they are shown again.

use std::sync::Arc;

use super::apply::Draft;
use crate::edit::{EditError, Lights};
use crate::scene::{HiddenLight, Light, LightKind, Object, Scene};

impl Draft {
    /// Hides objects, or shows them. What is so already stays as it is.
    pub(super) fn set_hidden(&mut self, patterns: &[String], is_hidden: bool) -> Result<(), EditError> {
        for index in self.find_all(patterns)? {
            let mut object = Object::clone(&self.world.scene.objects[index]);
            if object.is_hidden == is_hidden {
                continue;
            }
            object.is_hidden = is_hidden;
            let name = object.name.clone();
            if is_hidden {
                self.put_out(&name);
            }
            self.replace_object(index, Arc::new(object))?;
            if !is_hidden {
                self.put_on(&name);
            }
        }
        Ok(())
    }

    /// Takes the lights of an object out of the scene, and keeps them.
    fn put_out(&mut self, object: &str) {
        let Scene { lights, light_parents, groups, hidden_lights, .. } = self.scene_mut();
        let is_its = |light: &Light| match &light.kind {
            LightKind::Emissive { object: owner, .. } => owner == object,
            _ => light_parents.get(&light.name).is_some_and(|parent| parent == object),
        };
        let (off, on): (Vec<Light>, Vec<Light>) = lights.drain(..).partition(is_its);
        *lights = on;
        let hide = |light: Light| HiddenLight {
            hangs: light_parents.remove(&light.name).is_some(),
            group: groups.remove(&light.name),
            light,
        };
        hidden_lights.insert(object.to_owned(), off.into_iter().map(hide).collect());
    }

    /// Puts them back.
    fn put_on(&mut self, object: &str) {
        let Scene { lights, light_parents, groups, hidden_lights, .. } = self.scene_mut();
        for HiddenLight { light, hangs, group } in hidden_lights.remove(object).unwrap_or_default() {
            if hangs {
                light_parents.insert(light.name.clone(), object.to_owned());
            }
            groups.extend(group.map(|group| (light.name.clone(), group)));
            lights.push(light);
        }
    }

    /// All that the scene knows of lights.
    pub(super) fn set_lights(&mut self, to: Lights) {
        let Scene { lights, light_parents, groups, hidden_lights, .. } = self.scene_mut();
        (*lights, *light_parents, *groups, *hidden_lights) = (to.lights, to.parents, to.groups, to.hidden);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DMat4, DVec3, Vec3};

    use crate::edit::{Edit, EditErrorKind};
    use crate::scene::{Light, LightKind, Material, Mesh, Object, Scene};
    use crate::world::{World, WorldOptions};

    /// A floor, and a lamp with a glowing shade on it and a bulb.
    fn world() -> World {
        let floor = Mesh::quad(Vec3::ZERO, Vec3::Z * 4.0, Vec3::X * 4.0);
        let floor = Object::new("floor", floor, Material::diffuse(Vec3::splat(0.5)));
        let shade = Mesh::cuboid(Vec3::new(1.0, 1.0, 1.0), Vec3::new(2.0, 2.0, 2.0));
        let lamp = Object::new("lamp", shade, Material::emissive(Vec3::ONE));
        let last = Object::new("last", Mesh::icosphere(0.3, 2), Material::diffuse(Vec3::ONE));
        let kind = LightKind::Point { position: DVec3::new(1.5, 0.5, 1.5), range: None };
        let bulb = Light { name: "bulb".into(), kind, color: Vec3::ONE, intensity: 2.0 };
        let mut scene = Scene::from_objects(vec![floor, lamp, last]).with_light(bulb);
        scene.light_parents.insert("bulb".into(), "lamp".into());
        scene.groups.insert("bulb".into(), "bulbs".into());
        World::new(scene, &WorldOptions { spacing: Some(0.5), ..WorldOptions::default() }).expect("a world")
    }

    fn apply(world: &World, edit: Edit) -> World {
        world.apply(&[edit]).expect("an edit").after
    }

    fn hide(name: &str) -> Edit {
        Edit::Hide { objects: vec![name.into()] }
    }

    fn show(name: &str) -> Edit {
        Edit::Show { objects: vec![name.into()] }
    }

    #[test]
    fn what_is_hidden_is_to_light_as_if_it_were_removed() {
        let world = world();
        let hidden = apply(&world, hide("lamp"));
        let removed = apply(&world, Edit::Remove { objects: vec!["lamp".into()] });
        assert!(hidden.is_lit_like(&removed) && !hidden.is_lit_like(&world));
        assert!(hidden.scene.lights.is_empty() && hidden.scene.groups.is_empty());
        let names: Vec<&str> = hidden.objects().map(|object| object.name).collect();
        assert_eq!(names, ["floor", "lamp", "last"], "it keeps its place in the list");
        assert_eq!(hidden.objects().nth(1).unwrap().element_count, 0);
        // Once more changes nothing.
        assert!(apply(&hidden, hide("la*p")).is_lit_like(&hidden));
        let gone = apply(&hidden, Edit::Remove { objects: vec!["lamp".into()] });
        assert!(gone.scene.hidden_lights.is_empty() && gone.is_lit_like(&removed));
    }

    #[test]
    fn it_comes_back_where_it_was() {
        let world = world();
        let back = apply(&apply(&world, hide("l*")), show("*"));
        assert!(back.is_lit_like(&world));
        assert_eq!(back.scene.light_parents, world.scene.light_parents);
        assert_eq!(back.scene.groups, world.scene.groups);
        let moved = Edit::Move { object: "lamp".into(), transform: DMat4::from_translation(DVec3::X) };
        let there = apply(&apply(&apply(&world, hide("lamp")), moved.clone()), show("lamp"));
        assert!(there.is_lit_like(&apply(&world, moved)), "what was moved meanwhile comes back there, with its bulb");
    }

    #[test]
    fn names_of_hidden_lights_are_taken() {
        let hidden = apply(&world(), hide("lamp"));
        let kind = LightKind::Environment;
        let insert = Edit::InsertLight { name: "bulb".into(), kind, color: Vec3::ONE, intensity: 1.0 };
        assert_eq!(hidden.apply(&[insert]).unwrap_err().kind, EditErrorKind::Conflict);
        let asset = Arc::new(Scene::from_objects(Vec::new()));
        let insert = Edit::Insert { asset, name: "lamp".into(), transform: DMat4::IDENTITY };
        assert_eq!(hidden.apply(&[insert]).unwrap_err().kind, EditErrorKind::Conflict);
        assert_eq!(hidden.apply(&[show("nothing")]).unwrap_err().field, "edits[0].objects[0]");
    }
}
