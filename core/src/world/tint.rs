//! Edits of base colour factors: what textures and vertex colours show is multiplied.

use std::sync::Arc;

use glam::Vec3;

use super::apply::Draft;
use super::paint::check_albedo;
use crate::edit::EditError;
use crate::scene::{Look, Object};

impl Draft {
    /// Gives materials another base colour factor: those of a name, of one object or of all, or all of an object.
    pub(super) fn tint(&mut self, object: Option<&str>, material: Option<&str>, factor: Vec3) -> Result<(), EditError> {
        check_albedo(factor)?;
        for (index, materials) in self.materials_of(object, material)? {
            self.tint_object(index, &materials, factor)?;
        }
        Ok(())
    }

    fn tint_object(&mut self, index: usize, materials: &[usize], factor: Vec3) -> Result<(), EditError> {
        let mut object = Object::clone(&self.world.scene.objects[index]);
        let mut lets_through = false;
        for &k in materials {
            let look = object.looks.get_mut(k).and_then(Option::as_mut);
            let picture = look.as_ref().filter(|look| !look.is_painted).and_then(|look| look.base_color.as_ref());
            object.materials[k].albedo = factor * picture.map_or(Vec3::ONE, |picture| picture.texture.mean().color);
            if let Some(look) = look {
                lets_through |= look.may_let_light_through();
                *look = Arc::new(Look { factor, ..(**look).clone() });
            }
        }
        let parts = self.world.space.parts_of(&self.world.placed[index].placement);
        if lets_through || parts.iter().any(|part| part.albedos.is_some()) {
            // To its light it is another one in the same place.
            return self.replace_object(index, Arc::new(object));
        }
        *self.object_mut(index) = object;
        self.show_materials(index);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use glam::{Mat2, Vec2, Vec4};

    use super::*;
    use crate::edit::{Edit, EditErrorKind, Restore};
    use crate::scene::{AlphaUse, Material, Mesh, Scene, Texture, TextureUse, Wrap};
    use crate::world::{World, WorldOptions};

    /// A square of wood whose picture is white on the left and black on the right, a coloured one, and a plain one.
    fn world() -> World {
        let square = |name: &str, x: f32, material: &str| {
            let mesh = Mesh::quad(Vec3::X * x, Vec3::X, Vec3::Y);
            let mut object = Object::new(name, mesh, Material::diffuse(Vec3::splat(0.5)));
            object.material_names = vec![material.into()];
            object
        };
        let mut wood = square("wood", 0.0, "wood");
        let texels = [[255, 255, 255, 255], [0, 0, 0, 255]].concat();
        let texture = Arc::new(Texture::new(2, 1, &texels, AlphaUse::Ignored, 1 << 20));
        let picture =
            TextureUse { texture, texcoord: 0, linear: Mat2::IDENTITY, offset: Vec2::ZERO, wrap: [Wrap::Clamp; 2] };
        wood.looks = vec![Some(Arc::new(Look { base_color: Some(picture), ..Look::plain(Vec3::ONE) }))];
        let mesh = Arc::make_mut(&mut wood.mesh);
        mesh.texcoords[0] = mesh.positions.iter().map(|p| Vec2::new(p.x, p.y)).collect();
        let mut colored = square("coloured", 2.0, "wood");
        Arc::make_mut(&mut colored.mesh).colors = vec![Vec4::new(1.0, 0.5, 0.25, 1.0); 4];
        let scene = Scene::from_objects(vec![wood, colored, square("plain", 4.0, "steel")]);
        let options = WorldOptions { spacing: Some(0.25), max_albedo: 0.95, ..WorldOptions::default() };
        World::new(scene, &options).expect("three squares")
    }

    fn tint(object: Option<&str>, material: Option<&str>) -> Edit {
        let factor = Vec3::new(0.2, 0.4, 0.8);
        Edit::Tint { object: object.map(str::to_owned), material: material.map(str::to_owned), factor }
    }

    fn albedos(world: &World) -> Vec<Vec3> {
        world.objects().map(|object| (object.albedo * 1000.0).round() / 1000.0).collect()
    }

    #[test]
    fn a_tint_multiplies_what_is_shown() {
        let world = world();
        let (told, half) = (albedos(&world), Vec3::splat(0.5));
        assert_eq!(told, [half, half * Vec3::new(1.0, 0.5, 0.25), half].map(|a| (a * 1000.0).round() / 1000.0));
        let tinted = [Vec3::new(0.1, 0.2, 0.4), Vec3::new(0.2, 0.2, 0.2), Vec3::new(0.2, 0.4, 0.8)];
        let after = |edits: &[Edit]| world.apply(edits).expect("a tint").after;
        assert_eq!(albedos(&after(&[tint(None, Some("wood"))])), [tinted[0], tinted[1], told[2]]);
        assert_eq!(albedos(&after(&[tint(Some("wood"), Some("wood"))])), [tinted[0], told[1], told[2]]);
        assert_eq!(albedos(&after(&[tint(Some("plain"), None)])), [told[0], told[1], tinted[2]]);
        // It is a factor that is set: twice is once. The picture is still there, by place.
        let twice = after(&[tint(Some("wood"), None), tint(Some("wood"), None)]);
        assert_eq!(albedos(&twice)[0], tinted[0]);
        let part = &twice.space.parts_of(&twice.placed[0].placement)[0];
        let by_place = part.albedos.as_ref().expect("albedos by place");
        assert!(by_place.iter().any(|albedo| albedo.x > 0.19) && by_place.iter().any(|albedo| albedo.x < 0.01));
        // What was painted over has no picture any more; undo brings all back.
        let paint = Edit::Material { object: "wood".into(), albedo: Vec3::ONE };
        assert_eq!(albedos(&after(&[paint, tint(Some("wood"), None)]))[0], tinted[2]);
        let restore = Restore::between(&twice.scene, &world.scene);
        let back = twice.apply(&[Edit::Restore(Arc::new(restore))]).expect("an undo").after;
        assert_eq!(albedos(&back), told);
    }

    #[test]
    fn what_cannot_be_tinted_is_told() {
        let world = world();
        for (edit, kind, field) in [
            (tint(Some("x"), None), EditErrorKind::NotFound, "object"),
            (tint(None, Some("gold")), EditErrorKind::NotFound, "material"),
            (tint(None, None), EditErrorKind::Invalid, "object"),
            (
                Edit::Tint { object: Some("wood".into()), material: None, factor: Vec3::splat(1.5) },
                EditErrorKind::Invalid,
                "albedo",
            ),
        ] {
            let error = world.apply(&[edit]).expect_err(field);
            assert_eq!((error.kind, error.field), (kind, format!("edits[0].{field}")));
        }
    }
}
