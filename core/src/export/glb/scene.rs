//! A scene back into a file that [`crate::scene::load`] reads.

use std::collections::BTreeMap;

use ::gltf::json::Value;
use glam::{DMat4, DQuat, DVec3, Vec2, Vec3};

use super::container::{Document, numbers, object, push};
use super::{add_material, emission_parts};
use crate::export::ExportError;
use crate::scene::{Camera, Light, LightKind, Object, Scene};

/// Part of a spot's outer angle that its inner one is at most: the format wants it below.
const LARGEST_INNER: f32 = 0.9999;
/// The largest `f32` that is not above π/2.
const LARGEST_OUTER: f32 = std::f32::consts::FRAC_PI_2.next_down();
/// Distance of the near plane that a glTF camera must state, metres. rebake's cameras have none.
const CAMERA_NEAR: f32 = 0.01;

/// Writes objects with their transforms and materials, lights and cameras.
///
/// The emission of a material is the strength of its light (times the mean of its texture), so that a relit scene is read
/// back as it is lit. Light
/// from outside has no place in glTF and is left out. Transforms become `f32`.
///
/// # Errors
/// [`ExportError`]: an object whose lists do not fit together, a transform that is not finite, more than 4 GiB.
pub fn write_scene_glb(scene: &Scene) -> Result<Vec<u8>, ExportError> {
    let mut document = Document::default();
    let mut emission: BTreeMap<(&str, u32), &Light> = BTreeMap::new();
    for light in &scene.lights {
        if let LightKind::Emissive { object, material } = &light.kind {
            emission.insert((object, *material), light);
        }
    }
    for item in &scene.objects {
        let mesh = add_mesh(&mut document, item, &emission, false)?;
        let matrix = transform(item.world_from_object, &item.name)?;
        document.nodes.push(object([("name", item.name.as_str().into()), ("mesh", mesh)].into_iter().chain(matrix)));
    }
    for light in &scene.lights {
        add_punctual(&mut document, light)?;
    }
    for camera in &scene.cameras {
        add_camera(&mut document, camera)?;
    }
    document.finish()
}

/// A camera with its node.
pub(super) fn add_camera(document: &mut Document, camera: &Camera) -> Result<Value, ExportError> {
    let perspective = object([("yfov", camera.fov_y.into()), ("znear", CAMERA_NEAR.into())]);
    let json = object([("type", "perspective".into()), ("perspective", perspective)]);
    let index = push(&mut document.cameras, json);
    let matrix = transform(camera.world_from_camera, &camera.name)?;
    let node = [("name", camera.name.as_str().into()), ("camera", index)].into_iter().chain(matrix);
    Ok(push(&mut document.nodes, object(node)))
}

/// A primitive per material, and apart from it one for its flat triangles (those without normals). An object without
/// triangles gets one without an area, which readers drop: a mesh has to have a primitive. `is_told`: with texture
/// coordinates and the names of materials, which nothing else in the file refers to.
pub(super) fn add_mesh(
    document: &mut Document,
    item: &Object,
    emission: &BTreeMap<(&str, u32), &Light>,
    is_told: bool,
) -> Result<Value, ExportError> {
    let mesh = &*item.mesh;
    let vertices = mesh.positions.len();
    let lists = || ExportError::Lists(item.name.clone());
    if !(mesh.normals.is_empty() || mesh.normals.len() == vertices)
        || mesh.triangle_materials.len() != mesh.triangles.len()
        || mesh.triangles.iter().flatten().any(|&corner| corner as usize >= vertices)
    {
        return Err(lists());
    }
    if mesh.triangles.is_empty() {
        let attributes = object([("POSITION", document.add_vec3(&[Vec3::ZERO; 3], true))]);
        let primitive = object([("attributes", attributes), ("indices", document.add_indices(&[[0, 1, 2]]))]);
        let json = object([("name", item.name.as_str().into()), ("primitives", vec![primitive].into())]);
        return Ok(push(&mut document.meshes, json));
    }
    let has_normal = |corner: &u32| mesh.normals.get(*corner as usize).is_some_and(|normal| *normal != Vec3::ZERO);
    let mut groups: BTreeMap<(u32, bool), Vec<[u32; 3]>> = BTreeMap::new();
    for (triangle, &material) in mesh.triangles.iter().zip(&mesh.triangle_materials) {
        groups.entry((material, triangle.iter().all(has_normal))).or_default().push(*triangle);
    }
    let positions = document.add_vec3(&mesh.positions, true);
    let sets = if is_told { add_texcoords(document, &mesh.texcoords, vertices).ok_or_else(lists)? } else { Vec::new() };
    let mut normals = None;
    let mut primitives = Vec::with_capacity(groups.len());
    for ((material, is_smooth), triangles) in groups {
        let mut attributes = vec![("POSITION", positions.clone())];
        if is_smooth {
            // Zero vectors are not valid in a file. No smooth triangle uses those replaced.
            let valid = |normal: &Vec3| if *normal == Vec3::ZERO { Vec3::Z } else { *normal };
            let add = || document.add_vec3(&mesh.normals.iter().map(valid).collect::<Vec<_>>(), false);
            attributes.push(("NORMAL", normals.get_or_insert_with(add).clone()));
        }
        attributes.extend(["TEXCOORD_0", "TEXCOORD_1"].into_iter().zip(sets.iter().cloned()));
        let light = emission.get(&(item.name.as_str(), material));
        let mean = item.mean_emission(material as usize);
        let parts = light.map_or((Vec3::ZERO, 1.0), |light| light_parts(light.color * mean, light.intensity));
        let opacity = item.mean_opacity(material as usize);
        let name = item.material_names.get(material as usize).filter(|_| is_told).map_or("", |name| &**name);
        let material = item.materials.get(material as usize).ok_or_else(lists)?;
        primitives.push(object([
            ("attributes", object(attributes)),
            ("indices", document.add_indices(&triangles)),
            ("material", add_material(document, name, material, opacity, parts)),
        ]));
    }
    let json = object([("name", item.name.as_str().into()), ("primitives", primitives.into())]);
    Ok(push(&mut document.meshes, json))
}

/// The sets of texture coordinates that there are; none where one does not fit. The first is zeros where there is only
/// the second, since they are numbered from 0 without gaps.
fn add_texcoords(document: &mut Document, sets: &[Vec<Vec2>; 2], vertices: usize) -> Option<Vec<Value>> {
    let used = sets.iter().rposition(|set| !set.is_empty()).map_or(0, |last| last + 1);
    let add = |set: &Vec<Vec2>| match set.len() {
        0 => Some(document.add_vec2(&vec![Vec2::ZERO; vertices])),
        len => (len == vertices).then(|| document.add_vec2(set)),
    };
    sets[..used].iter().map(add).collect()
}

/// Colour and intensity, kept apart as they are where the colour is a valid factor.
pub(super) fn light_parts(color: Vec3, intensity: f32) -> (Vec3, f32) {
    if color.max_element() <= 1.0 { (color, intensity) } else { emission_parts(color * intensity) }
}

fn add_punctual(document: &mut Document, light: &Light) -> Result<(), ExportError> {
    let (Some(json), Some(frame)) = (light_json(light), frame_of(light)) else { return Ok(()) };
    let index = push(&mut document.lights, json);
    let matrix = transform(frame, &light.name)?;
    let extension = object([("KHR_lights_punctual", object([("light", index)]))]);
    let node = [("name", light.name.as_str().into()), ("extensions", extension)].into_iter().chain(matrix);
    document.nodes.push(object(node));
    Ok(())
}

/// What `KHR_lights_punctual` says of a light; none for others.
pub(super) fn light_json(light: &Light) -> Option<Value> {
    let (kind, range) = match &light.kind {
        LightKind::Emissive { .. } | LightKind::Environment | LightKind::Sky { .. } => return None,
        LightKind::Point { range, .. } => ("point", *range),
        LightKind::Spot { range, .. } => ("spot", *range),
        LightKind::Directional { .. } => ("directional", None),
    };
    // As for emissive factors, the parts of a colour are at most 1.
    let (color, intensity) = light_parts(light.color, light.intensity);
    let mut json = vec![
        ("name", light.name.as_str().into()),
        ("type", kind.into()),
        ("color", numbers(color.to_array())),
        ("intensity", intensity.into()),
    ];
    if let Some(range) = range {
        json.push(("range", range.into()));
    }
    if let LightKind::Spot { inner_cone_angle, outer_cone_angle, .. } = light.kind {
        let outer = outer_cone_angle.min(LARGEST_OUTER);
        let inner = inner_cone_angle.min(outer * LARGEST_INNER);
        json.push(("spot", object([("innerConeAngle", inner.into()), ("outerConeAngle", outer.into())])));
    }
    Some(object(json))
}

/// Where the node of a light stands, and how it is turned; none for lights that have no node.
pub(super) fn frame_of(light: &Light) -> Option<DMat4> {
    let (position, direction) = match &light.kind {
        LightKind::Emissive { .. } | LightKind::Environment | LightKind::Sky { .. } => return None,
        LightKind::Point { position, .. } => (*position, Vec3::NEG_Z),
        LightKind::Spot { position, direction, .. } => (*position, *direction),
        LightKind::Directional { direction, .. } => (DVec3::ZERO, *direction),
    };
    let rotation = DQuat::from_rotation_arc(DVec3::NEG_Z, direction.as_dvec3().normalize_or(DVec3::NEG_Z));
    Some(DMat4::from_rotation_translation(rotation, position))
}

/// The `matrix` of a node; none where it is the identity.
pub(super) fn transform(matrix: DMat4, name: &str) -> Result<Option<(&'static str, Value)>, ExportError> {
    if !matrix.as_mat4().is_finite() {
        return Err(ExportError::NotFinite(name.to_owned()));
    }
    Ok((matrix != DMat4::IDENTITY).then(|| ("matrix", numbers(matrix.as_mat4().to_cols_array()))))
}
