//! An asset as one object: what an `insert` puts into a scene.

use std::sync::Arc;

use glam::{DMat3, DMat4};

use super::names::UniqueNames;
use super::{Light, LightKind, Look, Mesh, Object, Scene};

/// Merges all objects of an asset into one called `name`, in the asset's world space (its own transform is the
/// identity), and names its lights after it: emissive materials `name`, `name/2`, …; punctual lights
/// `name/<light>`, where they stand in the asset's space. A light from outside is left out.
///
/// Positions become `f32` in the asset's world space: an asset belongs near its zero.
pub fn merge_as_object(asset: &Scene, name: &str) -> (Object, Vec<Light>) {
    let mut mesh = Mesh::default();
    let (mut materials, mut material_names, mut looks) = (Vec::new(), Vec::new(), Vec::new());
    // Of each object: where its materials begin in the merged list.
    let mut first_material = Vec::new();
    for object in &asset.objects {
        let first = materials.len() as u32;
        first_material.push((object.name.as_str(), first));
        append(&mut mesh, object, first);
        let scale = DMat3::from_mat4(object.world_from_object).determinant().abs().cbrt() as f32;
        let own: Vec<_> = object.looks.iter().map(|look| look.as_ref().map(|look| scaled(look, scale))).collect();
        extend(&mut looks, &own, materials.len(), object.materials.len(), None);
        materials.extend_from_slice(&object.materials);
        material_names.extend_from_slice(&object.material_names);
    }
    let object = Object {
        name: name.to_owned(),
        mesh: Arc::new(mesh),
        materials,
        material_names,
        looks,
        world_from_object: DMat4::IDENTITY,
        is_hidden: false,
        is_inserted: true,
        node: None,
        asset: asset.asset.clone(),
    };
    let mut names = UniqueNames::default();
    let (mut emissive, mut punctual) = (Vec::new(), Vec::new());
    for light in &asset.lights {
        match &light.kind {
            LightKind::Emissive { object: owner, material } => {
                let Some(&(_, first)) = first_material.iter().find(|(known, _)| known == owner) else { continue };
                let kind = LightKind::Emissive { object: name.to_owned(), material: first + material };
                emissive.push(Light { name: names.claim_with(name, '/'), kind, ..light.clone() });
            }
            LightKind::Environment | LightKind::Sky { .. } => {}
            LightKind::Point { .. } | LightKind::Spot { .. } | LightKind::Directional { .. } => punctual.push(light),
        }
    }
    let rename = |light: &Light| Light { name: names.claim(&format!("{name}/{}", light.name)), ..light.clone() };
    let punctual: Vec<Light> = punctual.into_iter().map(rename).collect();
    emissive.extend(punctual);
    (object, emissive)
}

/// A look with its lengths in the asset's world space.
fn scaled(look: &Arc<Look>, scale: f32) -> Arc<Look> {
    if look.thickness == 0.0 || scale == 1.0 {
        return Arc::clone(look);
    }
    Arc::new(Look { thickness: look.thickness * scale, ..(**look).clone() })
}

/// Appends an object's mesh, transformed to world space.
fn append(mesh: &mut Mesh, object: &Object, first_material: u32) {
    let first = mesh.positions.len() as u32;
    let source = &*object.mesh;
    let world_from_object = object.world_from_object;
    let linear = DMat3::from_mat4(world_from_object);
    let mirrors = linear.determinant() < 0.0;
    let normal_matrix = linear.inverse().transpose();
    let to_world = |position: &glam::Vec3| world_from_object.transform_point3(position.as_dvec3()).as_vec3();
    mesh.positions.extend(source.positions.iter().map(to_world));
    // A zero vector stands for "flat", where this object has no normals but others do.
    let turn = |normal: &glam::Vec3| (normal_matrix * normal.as_dvec3()).normalize_or_zero().as_vec3();
    mesh.normals.extend(source.normals.iter().map(turn));
    mesh.normals.resize(mesh.positions.len(), glam::Vec3::ZERO);
    for (set, of_source) in mesh.texcoords.iter_mut().zip(&source.texcoords) {
        extend(set, of_source, first as usize, source.positions.len(), glam::Vec2::ZERO);
    }
    extend(&mut mesh.colors, &source.colors, first as usize, source.positions.len(), glam::Vec4::ONE);
    mesh.triangles.extend(source.triangles.iter().map(|&[a, b, c]| {
        let triangle = if mirrors { [a, c, b] } else { [a, b, c] };
        triangle.map(|corner| first + corner)
    }));
    mesh.triangle_materials.extend(source.triangle_materials.iter().map(|material| first_material + material));
}

/// Appends `count` values from `first` on, which some objects lack; where all lack them the list stays empty.
fn extend<T: Clone>(list: &mut Vec<T>, values: &[T], first: usize, count: usize, absent: T) {
    if !(list.is_empty() && values.is_empty()) {
        list.resize(first, absent.clone());
        list.extend_from_slice(values);
        list.resize(first + count, absent);
    }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3, Vec3};

    use super::*;
    use crate::scene::Material;
    use crate::surface::Surface;

    /// How deep light goes below a pane is a length: it grows with the object.
    #[test]
    fn depths_keep_their_length() {
        let look = Look { transmission: 1.0, thickness: 0.25, ..Look::plain(Vec3::ONE) };
        let mut pane = Object::new("pane", Mesh::cuboid(Vec3::ZERO, Vec3::ONE), Material::diffuse(Vec3::ONE));
        pane.looks = vec![Some(Arc::new(look))];
        let scaled = pane.clone().placed(DMat4::from_scale(DVec3::splat(-3.0)));
        let (object, _) = merge_as_object(&Scene::from_objects(vec![pane, scaled]), "panes");
        let depths: Vec<f32> = object.looks.iter().flatten().map(|look| look.thickness).collect();
        assert_eq!(depths, [0.25, 0.75]);
    }

    /// A mirrored lamp and a plain box: one closed object, lights renamed and pointing at the right materials.
    #[test]
    fn an_asset_becomes_one_object_with_its_lights() {
        let turn = DQuat::from_rotation_y(0.7);
        let mirrored =
            DMat4::from_scale_rotation_translation(DVec3::new(-1.0, 2.0, 1.0), turn, DVec3::new(5.0, 0.0, 0.0));
        let bulb = Object::new("bulb", Mesh::icosphere(0.5, 2), Material::emissive(Vec3::new(2.0, 1.0, 0.5)));
        let mut cube = Object::new("cube", Mesh::cuboid(Vec3::ZERO, Vec3::ONE), Material::emissive(Vec3::ONE));
        cube.materials.insert(0, Material::diffuse(Vec3::splat(0.5)));
        Arc::make_mut(&mut cube.mesh).triangle_materials[0] = 1;
        Arc::make_mut(&mut cube.mesh).normals = Vec::new();
        let spot = Light {
            name: "spot".into(),
            kind: LightKind::Point { position: DVec3::new(1.0, 2.0, 3.0), range: None },
            color: Vec3::ONE,
            intensity: 4.0,
        };
        let asset = Scene::from_objects(vec![bulb.placed(mirrored), cube]).with_light(spot.clone());
        let (object, lights) = merge_as_object(&asset, "lamp");
        let names: Vec<&str> = lights.iter().map(|light| light.name.as_str()).collect();
        assert_eq!(names, ["lamp", "lamp/2", "lamp/spot"]);
        for (light, index) in lights.iter().zip([0, 2]) {
            assert_eq!(light.kind, LightKind::Emissive { object: "lamp".into(), material: index });
            assert_eq!(light.strength(), object.materials[index as usize].emission);
        }
        assert_eq!(lights[2].kind, spot.kind);
        let apart = asset.objects.iter().map(|part| Surface::build(part, part.world_from_object).unwrap());
        let (area, volume) = apart.fold((0.0, 0.0), |(a, v), part| (a + part.area(), v + part.volume));
        let merged = Surface::build(&object, DMat4::IDENTITY).unwrap();
        merged.validate().unwrap();
        assert!(merged.closed && (merged.volume / volume - 1.0).abs() < 1e-5, "{} {volume}", merged.volume);
        assert!((merged.area() / area - 1.0).abs() < 1e-5);
    }
}
