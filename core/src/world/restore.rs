//! Undo and redo: a scene becomes what it was.

use std::sync::Arc;

use super::apply::Draft;
use crate::edit::{EditError, Lights, Restore, Restored};

impl Draft {
    /// Takes the scene to the state that `restore` leads to. Lights come last: objects take theirs along.
    pub(super) fn restore(&mut self, restore: &Restore) -> Result<(), EditError> {
        let lights = restore.lights.clone().unwrap_or_else(|| Lights::of(&self.world.scene));
        for restored in &restore.objects {
            self.restore_object(restored)?;
        }
        self.set_lights(lights);
        Ok(())
    }

    fn restore_object(&mut self, restored: &Restored) -> Result<(), EditError> {
        if let Restored::Back(index, object) = restored {
            self.check_free_name(&object.name)?;
            self.add_object(Arc::clone(object))?;
            let index = (*index).min(self.world.scene.objects.len() - 1);
            self.scene_mut().objects[index..].rotate_right(1);
            self.world.placed[index..].rotate_right(1);
            return Ok(());
        }
        let index = self.object_index(restored.name())?;
        match restored {
            Restored::Gone(_) => self.remove_object(index),
            Restored::Moved(object) => self.move_object(index, &object.world_from_object)?,
            Restored::Painted(object) if object.looks.is_empty() && object.mesh.colors.is_empty() => {
                self.object_mut(index).materials.clone_from(&object.materials);
                self.show_materials(index);
            }
            Restored::Back(_, object) | Restored::Painted(object) | Restored::Replaced(object) => {
                self.replace_object(index, Arc::clone(object))?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DMat4, DVec3, Vec3, Vec4};

    use crate::edit::{Edit, Relight, Restore};
    use crate::scene::{LightKind, Material, Mesh, Object, Scene};
    use crate::world::{World, WorldOptions};

    fn cube(name: &str, at: f32) -> Object {
        let low = Vec3::splat(at);
        Object::new(name, Mesh::cuboid(low, low + Vec3::ONE), Material::diffuse(Vec3::splat(0.5)))
    }

    fn world() -> World {
        let mut tinted = cube("tinted", 6.0);
        Arc::make_mut(&mut tinted.mesh).colors = vec![Vec4::splat(0.5); tinted.mesh.positions.len()];
        tinted.material_names = vec!["wood".into()];
        let lamp = Object::new("lamp", Mesh::quad(Vec3::Y * 9.0, Vec3::X, Vec3::Z), Material::emissive(Vec3::ONE));
        let scene = Scene::from_objects(vec![cube("a", 0.0), cube("b", 3.0), tinted, lamp]);
        World::new(scene, &WorldOptions { spacing: Some(0.25), ..WorldOptions::default() }).expect("a world")
    }

    fn edits() -> Vec<Vec<Edit>> {
        let objects = |name: &str| vec![name.to_owned()];
        let at = |x| DMat4::from_translation(DVec3::X * x);
        let asset = Arc::new(Scene::from_objects(vec![
            cube("c", 12.0),
            Object::new("bulb", Mesh::icosphere(0.5, 1), Material::emissive(Vec3::ONE)),
        ]));
        let insert = Edit::Insert { asset, name: "c".into(), transform: DMat4::IDENTITY };
        let relight = Relight { light: "lamp".into(), color: None, intensity: Some(0.25) };
        let sky =
            Edit::InsertLight { name: "sky".into(), kind: LightKind::Environment, color: Vec3::ONE, intensity: 1.0 };
        let wood = |object: Option<&str>| Edit::NamedMaterial {
            object: object.map(str::to_owned),
            material: "wood".into(),
            albedo: Vec3::splat(0.3),
        };
        let group = Edit::GroupLights { group: Some("all".into()), lights: vec!["lamp".into()] };
        vec![
            vec![insert.clone()],
            vec![Edit::Remove { objects: objects("a") }],
            vec![Edit::Remove { objects: objects("lamp") }],
            vec![Edit::Move { object: "b".into(), transform: at(2.0) }],
            vec![Edit::Move { object: "b".into(), transform: at(2.0) * DMat4::from_scale(DVec3::splat(0.5)) }],
            vec![Edit::Material { object: "a".into(), albedo: Vec3::splat(0.1) }],
            vec![Edit::Material { object: "tinted".into(), albedo: Vec3::splat(0.1) }],
            vec![wood(None)],
            vec![wood(Some("tinted"))],
            vec![Edit::Hide { objects: objects("*") }],
            vec![Edit::Relight { lights: vec![relight] }],
            vec![sky],
            vec![Edit::RemoveLight { light: "lamp".into() }],
            vec![group],
            vec![
                Edit::Remove { objects: objects("a") },
                insert,
                Edit::Move { object: "c".into(), transform: at(-1.0) },
                Edit::Hide { objects: objects("b") },
            ],
        ]
    }

    #[test]
    fn every_kind_of_edit_is_taken_back_and_made_again() {
        let start = world();
        for edits in edits() {
            let done = start.apply(&edits).expect("an edit").after;
            let [back, again] = [(&done, &start), (&start, &done)]
                .map(|(from, to)| Edit::Restore(Arc::new(Restore::between(&from.scene, &to.scene))));
            let undone = done.apply(std::slice::from_ref(&back)).expect("an undo").after;
            assert!(undone.is_lit_like(&start), "{edits:?}");
            let redone = undone.apply(&[again]).expect("a redo").after;
            // What several edits bring may come back in other slots.
            assert!(edits.len() > 1 || redone.is_lit_like(&done), "{edits:?}");
            for (a, b) in [(&undone, &start), (&redone, &done)] {
                let names = |world: &World| -> Vec<String> { world.objects().map(|o| o.name.to_owned()).collect() };
                assert_eq!((names(a), &a.scene.lights, &a.scene.groups), (names(b), &b.scene.lights, &b.scene.groups));
                let left = Restore::between(&a.scene, &b.scene);
                // Meshes that were painted are copies.
                assert!(left.objects.is_empty() && left.lights.is_none(), "{edits:?}: {left:?}");
            }
        }
    }
}
