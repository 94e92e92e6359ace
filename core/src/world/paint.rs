//! Edits of materials.

use std::sync::Arc;

use glam::Vec3;

use super::apply::Draft;
use super::check::{error, invalid};
use crate::edit::{EditError, EditErrorKind};
use crate::scene::{Look, Mesh, Object};
use crate::space::Albedo;

impl Draft {
    /// Gives materials another albedo all over: those of a name, of one object or of all, or all of an object.
    pub(super) fn repaint(
        &mut self,
        object: Option<&str>,
        material: Option<&str>,
        albedo: Vec3,
    ) -> Result<(), EditError> {
        let found = self.materials_of(object, material)?;
        check_albedo(albedo)?;
        found.into_iter().try_for_each(|(index, materials)| self.paint(index, |k| materials.contains(&k), albedo))
    }

    /// Objects with which of their materials are meant: those of a name, of one object or of all, or all of an object.
    pub(super) fn materials_of(
        &self,
        object: Option<&str>,
        material: Option<&str>,
    ) -> Result<Vec<(usize, Vec<usize>)>, EditError> {
        let only = object.map(|name| self.object_index(name)).transpose()?;
        let objects = &self.world.scene.objects;
        let Some(material) = material else {
            let only = only.ok_or_else(|| invalid("object", "neither it nor a material is given"))?;
            return Ok(vec![(only, (0..objects[only].materials.len()).collect())]);
        };
        let is_named = |name: &Arc<str>| !material.is_empty() && **name == *material;
        let meant = |object: &Object| -> Vec<usize> {
            let names = object.material_names.iter().enumerate();
            names.filter(|(_, name)| is_named(name)).map(|(k, _)| k).collect()
        };
        let found = objects.iter().enumerate().filter(|(index, _)| only.is_none_or(|only| only == *index));
        let found = found.map(|(index, object)| (index, meant(object))).filter(|(_, meant)| !meant.is_empty());
        let found: Vec<_> = found.collect();
        if found.is_empty() {
            let of = object.map_or_else(|| "no object has a".to_owned(), |object| format!("{object:?} has no"));
            let reason = format!("{of} material named {material:?}");
            return Err(error("material", reason, EditErrorKind::NotFound));
        }
        Ok(found)
    }

    /// Those materials of an object that `is_painted` says yes to.
    fn paint(&mut self, index: usize, is_painted: impl Fn(usize) -> bool, albedo: Vec3) -> Result<(), EditError> {
        let materials = self.object_mut(index).materials.iter_mut().enumerate();
        materials.filter(|(k, _)| is_painted(*k)).for_each(|(_, material)| material.albedo = albedo);
        let parts = self.world.space.parts_of(&self.world.placed[index].placement);
        if parts.iter().any(|part| part.albedos.is_some()) {
            return self.paint_over(index, is_painted);
        }
        self.show_materials(index);
        Ok(())
    }

    /// Takes over the albedos of an object that has the same all over each material.
    pub(super) fn show_materials(&mut self, index: usize) {
        let materials = &self.world.scene.objects[index].materials;
        let parts = self.world.space.parts_of_mut(&self.world.placed[index].placement);
        for (part, material) in parts.iter_mut().zip(materials) {
            let albedo = Albedo::new(material.albedo, self.world.options.max_albedo);
            (part.albedo, part.told_albedo, part.is_capped) = (albedo.reflected, albedo.told, albedo.is_capped);
        }
    }

    /// Takes the pictures off an object: to its light it is another one in the same place.
    fn paint_over(&mut self, index: usize, is_painted: impl Fn(usize) -> bool) -> Result<(), EditError> {
        let mut object = Object::clone(&self.world.scene.objects[index]);
        for (_, look) in object.looks.iter_mut().enumerate().filter(|(k, _)| is_painted(*k)) {
            // What goes through and what shines stays as it was.
            let kept = look.take().filter(|look| look.may_let_light_through() || look.emissive.is_some());
            *look = kept.map(|look| Arc::new(Look { is_painted: true, ..(*look).clone() }));
        }
        if object.looks.iter().all(Option::is_none) {
            object.looks = Vec::new();
        }
        if !object.mesh.colors.is_empty() {
            object.mesh = Arc::new(without_colors(&object.mesh, is_painted, !object.looks.is_empty()));
        }
        self.replace_object(index, Arc::new(object))
    }
}

pub(super) fn check_albedo(albedo: Vec3) -> Result<(), EditError> {
    if !albedo.is_finite() || albedo.cmplt(Vec3::ZERO).any() || albedo.cmpgt(Vec3::ONE).any() {
        return Err(invalid("albedo", "must hold three numbers from 0 to 1"));
    }
    Ok(())
}

/// A mesh whose triangles of some materials have no vertex colours, but for alpha where that is kept. Vertices that others
/// use stay for those.
fn without_colors(mesh: &Mesh, is_painted: impl Fn(usize) -> bool, keeps_alpha: bool) -> Mesh {
    let mut mesh = mesh.clone();
    let is_plain = |triangle: usize| is_painted(mesh.triangle_materials[triangle] as usize);
    let plain: Vec<usize> = (0..mesh.triangles.len()).filter(|&triangle| is_plain(triangle)).collect();
    if plain.len() == mesh.triangles.len() {
        match keeps_alpha {
            true => mesh.colors.iter_mut().for_each(|color| *color = Vec3::ONE.extend(color.w)),
            false => mesh.colors = Vec::new(),
        }
        return mesh;
    }
    for triangle in plain {
        for corner in 0..3 {
            let old = mesh.triangles[triangle][corner] as usize;
            mesh.triangles[triangle][corner] = mesh.positions.len() as u32;
            mesh.positions.push(mesh.positions[old]);
            mesh.colors.push(Vec3::ONE.extend(mesh.colors[old].w));
            if let Some(normal) = mesh.normals.get(old).copied() {
                mesh.normals.push(normal);
            }
            for set in &mut mesh.texcoords {
                if let Some(uv) = set.get(old).copied() {
                    set.push(uv);
                }
            }
        }
    }
    mesh
}

#[cfg(test)]
mod tests {
    use glam::Vec4;

    use super::*;
    use crate::edit::Edit;
    use crate::scene::{Material, Object, Scene};
    use crate::world::{World, WorldOptions};

    /// A box whose first two sides are of wood, the rest of steel, and a plate of wood.
    fn world(colors: bool) -> World {
        let named = |names: &[&str]| -> Vec<Arc<str>> { names.iter().map(|name| Arc::from(*name)).collect() };
        let (mut mesh, grey) = (Mesh::cuboid(Vec3::ZERO, Vec3::ONE), Material::diffuse(Vec3::splat(0.5)));
        mesh.triangle_materials[4..].fill(1);
        if colors {
            mesh.colors = vec![Vec4::splat(0.5); mesh.positions.len()];
        }
        let mut cube = Object::new("box", mesh, grey);
        (cube.materials, cube.material_names) = (vec![grey; 2], named(&["wood", "steel"]));
        let mut plate = Object::new("plate", Mesh::quad(Vec3::Y * 3.0, Vec3::X, Vec3::Z), grey);
        plate.material_names = named(&["wood"]);
        let options = WorldOptions { spacing: Some(0.5), ..WorldOptions::default() };
        World::new(Scene::from_objects(vec![cube, plate]), &options).expect("a box and a plate")
    }

    fn paint(world: &World, object: Option<&str>, material: &str) -> Result<World, EditError> {
        let edit = Edit::NamedMaterial {
            object: object.map(str::to_owned),
            material: material.to_owned(),
            albedo: Vec3::new(0.1, 0.2, 0.3),
        };
        world.apply(&[edit]).map(|transition| transition.after)
    }

    /// Mean albedos as clients see them, red.
    fn reds(world: &World) -> Vec<f32> {
        world.objects().map(|object| (object.albedo.x * 1000.0).round() / 1000.0).collect()
    }

    #[test]
    fn a_material_is_painted_where_it_is() {
        // Of the box a third is wood.
        let mixed = |wood: f32, steel: f32| ((wood + 2.0 * steel) / 3.0 * 1000.0).round() / 1000.0;
        for (colors, was) in [(false, 0.5), (true, 0.25)] {
            let world = world(colors);
            assert_eq!(reds(&world), [was, 0.5]);
            assert_eq!(reds(&paint(&world, None, "wood").unwrap()), [mixed(0.1, was), 0.1]);
            assert_eq!(reds(&paint(&world, Some("box"), "wood").unwrap()), [mixed(0.1, was), 0.5]);
            assert_eq!(reds(&paint(&world, Some("box"), "steel").unwrap()), [mixed(was, 0.1), 0.5]);
        }
    }

    /// What reflects more than the world allows is told while it does, by vertex colours and paint alike.
    #[test]
    fn what_is_capped_is_told_by_material() {
        let capped = |world: &World| world.warnings().into_iter().find(|text| text.starts_with("an albedo above 0.95"));
        let white =
            |material: &str| Edit::NamedMaterial { object: None, material: material.to_owned(), albedo: Vec3::ONE };
        for colors in [false, true] {
            let world = world(colors);
            assert_eq!(capped(&world), None);
            let painted = world.apply(&[white("steel"), white("wood")]).unwrap().after;
            let told = capped(&painted).expect("white paint");
            assert!(told.ends_with(": material \"steel\", material \"wood\""), "{told}");
            let again = paint(&painted, None, "wood").unwrap();
            assert!(capped(&again).expect("steel").ends_with(": material \"steel\""));
            assert_eq!(capped(&paint(&again, None, "steel").unwrap()), None);
        }
        // White that vertex colours darken is not; two named sides and what has no name are.
        let mut cube = Object::new("cube", Mesh::cuboid(Vec3::ZERO, Vec3::ONE), Material::diffuse(Vec3::ONE));
        cube.material_names = vec!["".into()];
        let of = |mesh: Mesh| {
            let cube = Object { mesh: Arc::new(mesh), ..cube.clone() };
            World::new(Scene::from_objects(vec![cube]), &WorldOptions { spacing: Some(0.5), ..WorldOptions::default() })
                .unwrap()
        };
        let colored = |bright: usize| {
            let mut mesh = Mesh::cuboid(Vec3::ZERO, Vec3::ONE);
            mesh.colors = vec![Vec4::new(0.3, 0.3, 0.3, 1.0); mesh.positions.len()];
            mesh.colors[..bright].fill(Vec4::ONE);
            mesh
        };
        assert_eq!(capped(&of(colored(0))), None);
        assert!(capped(&of(colored(4))).expect("a white side").ends_with(": a material of \"cube\""));
    }

    #[test]
    fn a_material_that_is_not_there_is_told() {
        let world = world(false);
        for (object, material, field) in [
            (None, "gold", "material"),
            (Some("plate"), "steel", "material"),
            (Some("x"), "wood", "object"),
            (None, "", "material"),
        ] {
            let error = paint(&world, object, material).unwrap_err();
            assert_eq!((error.kind, error.field), (EditErrorKind::NotFound, format!("edits[0].{field}")));
        }
    }
}
