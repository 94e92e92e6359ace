//! Binary glTF: the subdivided meshes with their light map, and whole scenes.

mod container;
mod lit;
mod object;
mod scene;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use ::gltf::json::Value;
use glam::{DVec3, Vec3};

pub use self::lit::{LightAbout, LightLayout, LitExport, Originals, write_lit_glb};
pub use self::object::{ObjectExport, write_object_glb};
pub use self::scene::write_scene_glb;

use self::container::{Document, numbers, object, push};
use super::ExportError;
use crate::scene::Material;

/// One object with its light map. Lists of the same kind have the same length.
#[derive(Clone, Copy, Debug)]
pub struct MeshExport<'a> {
    /// Name of the object: that of the node and of the mesh.
    pub name: &'a str,
    /// Vertices (elements) in scene space, metres.
    pub positions: &'a [Vec3],
    /// Unit normals per vertex.
    pub normals: &'a [Vec3],
    /// Light map values per vertex, linear RGB; written as they are, whatever their range.
    pub colors: &'a [Vec3],
    /// Per vertex: three elements whose light it has, by number within the object, and their weights, of sum 1. Empty where
    /// every vertex is an element.
    pub reads: (&'a [Vec3], &'a [Vec3]),
    /// Vertex indices.
    pub triangles: &'a [[u32; 3]],
    /// Per triangle: index into `materials`.
    pub triangle_materials: &'a [u32],
    /// Albedo and sides; `emission` is the radiance in force.
    pub materials: &'a [Material],
    /// Per material: mean share of light that does not go through, 0..=1; empty where all are opaque.
    pub opacities: &'a [f32],
}

/// Writes meshes with their light map as float `COLOR_0`: shown without further light, `baseColorFactor × COLOR_0`
/// is the outgoing radiance. One node and mesh per object; objects without triangles are left out.
///
/// Vertices beyond the elements have means over the light of several: `_ELEMENTS` and `_WEIGHTS`, of every vertex of such
/// an object.
///
/// `origin` (world space, metres) is the zero of the positions' space. It becomes the translation of the nodes, so
/// that the vertices of a scene far from the world's zero keep their precision.
///
/// # Errors
/// [`ExportError`]: lists that do not fit together, numbers that are not finite, more than 4 GiB.
pub fn write_glb(meshes: &[MeshExport<'_>], origin: DVec3) -> Result<Vec<u8>, ExportError> {
    let mut document = Document::default();
    for mesh in meshes.iter().filter(|mesh| !mesh.triangles.is_empty()) {
        let mut node = vec![("name", mesh.name.into()), ("mesh", add_light_mesh(&mut document, mesh)?)];
        if origin != DVec3::ZERO {
            node.push(("translation", numbers(origin.as_vec3().to_array())));
        }
        document.nodes.push(object(node));
    }
    document.finish()
}

/// Adds a mesh with its light map as float `COLOR_0`.
fn add_light_mesh(document: &mut Document, mesh: &MeshExport<'_>) -> Result<Value, ExportError> {
    check(mesh)?;
    let mut attributes = vec![
        ("POSITION", document.add_vec3(mesh.positions, true)),
        ("NORMAL", document.add_vec3(mesh.normals, false)),
        ("COLOR_0", document.add_vec3(mesh.colors, false)),
    ];
    let (elements, weights) = mesh.reads;
    if !elements.is_empty() {
        attributes.push(("_ELEMENTS", document.add_vec3(elements, false)));
        attributes.push(("_WEIGHTS", document.add_vec3(weights, false)));
    }
    let attributes = object(attributes);
    let mut by_material: BTreeMap<u32, Vec<[u32; 3]>> = BTreeMap::new();
    for (triangle, &material) in mesh.triangles.iter().zip(mesh.triangle_materials) {
        by_material.entry(material).or_default().push(*triangle);
    }
    let mut primitives = Vec::with_capacity(by_material.len());
    for (material, triangles) in by_material {
        let opacity = mesh.opacities.get(material as usize).copied().unwrap_or(1.0);
        let material = &mesh.materials[material as usize];
        let emission = emission_parts(material.emission);
        primitives.push(object([
            ("attributes", attributes.clone()),
            ("indices", document.add_indices(&triangles)),
            ("material", add_material(document, "", material, opacity, emission)),
        ]));
    }
    let json = object([("name", mesh.name.into()), ("primitives", primitives.into())]);
    Ok(push(&mut document.meshes, json))
}

fn check(mesh: &MeshExport<'_>) -> Result<(), ExportError> {
    let count = mesh.positions.len();
    let fits = mesh.normals.len() == count
        && mesh.colors.len() == count
        && [mesh.reads.0, mesh.reads.1].iter().all(|reads| reads.is_empty() || reads.len() == count)
        && mesh.triangle_materials.len() == mesh.triangles.len()
        && mesh.triangles.iter().flatten().all(|&corner| (corner as usize) < count)
        && mesh.triangle_materials.iter().all(|&material| (material as usize) < mesh.materials.len());
    if !fits {
        return Err(ExportError::Lists(mesh.name.to_owned()));
    }
    let is_finite = |values: &[Vec3]| values.iter().all(|value| value.is_finite());
    if !(is_finite(mesh.positions) && is_finite(mesh.normals) && is_finite(mesh.colors)) {
        return Err(ExportError::NotFinite(mesh.name.to_owned()));
    }
    Ok(())
}

/// Emission as factor (each part at most 1, as the specification has it) and strength.
fn emission_parts(emission: Vec3) -> (Vec3, f32) {
    let strength = emission.max_element();
    if strength <= 1.0 { (emission, 1.0) } else { (emission / strength, strength) }
}

/// Adds a diffuse material that emits `color × strength`. Of what lets light through the mean alone is written, as alpha.
/// It is nameless where the name is empty.
fn add_material(
    document: &mut Document,
    name: &str,
    material: &Material,
    opacity: f32,
    (color, strength): (Vec3, f32),
) -> Value {
    let [r, g, b] = material.albedo.to_array();
    let pbr = object([
        ("baseColorFactor", numbers([r, g, b, opacity])),
        ("metallicFactor", 0.into()),
        ("roughnessFactor", 1.into()),
    ]);
    let mut json = vec![("pbrMetallicRoughness", pbr)];
    if !name.is_empty() {
        json.push(("name", name.into()));
    }
    if opacity < 1.0 {
        json.push(("alphaMode", "BLEND".into()));
    }
    if material.double_sided {
        json.push(("doubleSided", true.into()));
    }
    if color != Vec3::ZERO {
        json.push(("emissiveFactor", numbers(color.to_array())));
        if strength != 1.0 {
            let extension = object([("emissiveStrength", strength.into())]);
            json.push(("extensions", object([("KHR_materials_emissive_strength", extension)])));
        }
    }
    // Objects share few materials; a file with thousands of equal ones is slow to open elsewhere.
    let [er, eg, eb] = color.to_array();
    let numbers = [r, g, b, opacity, er, eg, eb, strength].map(f32::to_bits);
    let key = (name.to_owned(), numbers, material.double_sided);
    let materials = &mut document.materials;
    document.material_indices.entry(key).or_insert_with(|| push(materials, object(json))).clone()
}
