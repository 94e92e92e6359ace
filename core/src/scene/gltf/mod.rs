//! Reads a binary glTF 2.0 file (`.glb`) into a [`Scene`].
//!
//! The `gltf` crate parses the JSON. Every index, range and number is checked here before it is used, since the
//! crate's own accessors and part of its validation panic on files that break the specification. Nothing outside
//! the file is ever read: neither other files nor the network.

mod accessor;
mod container;
mod extensions;
mod image_mean;
mod lights;
mod material;
mod mesh;
mod nodes;
#[cfg(test)]
mod tests;
mod warnings;

use std::sync::Arc;

use ::gltf::json;
use glam::{DMat3, DMat4, DVec3};

use self::container::File;
use self::material::Materials;
use self::mesh::{LoadedMesh, Meshes};
use self::nodes::PlacedNode;
use self::warnings::Warnings;
use super::names::UniqueNames;
use super::{Camera, Object, Scene};

/// Upper bounds on what one file may ask for. Beyond them [`load_glb`] answers [`LoadError::TooLarge`].
#[derive(Clone, Debug, PartialEq)]
pub struct LoadLimits {
    /// Bytes of the file.
    pub max_bytes: usize,
    /// Nodes, used or not.
    pub max_nodes: usize,
    /// Levels of the node hierarchy.
    pub max_depth: usize,
    /// Objects: nodes with a mesh.
    pub max_objects: usize,
    /// Lights, emissive surfaces included.
    pub max_lights: usize,
    /// Triangles, those of a mesh counted once per object that uses it.
    pub max_triangles: usize,
    /// Vertices of all meshes.
    pub max_vertices: usize,
    /// Pixels of one texture.
    pub max_texture_pixels: u64,
    /// Pixels of all textures.
    pub max_total_texture_pixels: u64,
}

impl Default for LoadLimits {
    fn default() -> Self {
        Self {
            max_bytes: 1 << 30,
            max_nodes: 1_000_000,
            max_depth: 256,
            max_objects: 100_000,
            max_lights: 10_000,
            max_triangles: 20_000_000,
            max_vertices: 60_000_000,
            max_texture_pixels: 1 << 26,
            max_total_texture_pixels: 1 << 28,
        }
    }
}

/// Why a file was refused. The text names the place in the file and is meant for the person who uploaded it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LoadError {
    /// The file breaks the specification: damaged, inconsistent, or not a binary glTF at all (HTTP 400).
    #[error("{0}")]
    Malformed(String),
    /// The file is (as far as seen) valid, but cannot be baked: it requires an extension that is not implemented,
    /// refers to other files, or holds no triangle (HTTP 422).
    #[error("{0}")]
    Unsupported(String),
    /// The file exceeds one of the [`LoadLimits`] (HTTP 413).
    #[error("{0}")]
    TooLarge(String),
}

/// Largest extent of a scene, metres: products of four lengths must stay far from the end of `f32`.
const MAX_EXTENT: f64 = 1e8;

/// Reads a `.glb` file with an embedded binary chunk.
///
/// Deterministic: the same bytes give the same scene. Never panics, whatever the bytes.
///
/// # Errors
/// [`LoadError`], with a text that names the place in the file.
pub fn load_glb(bytes: &[u8], limits: &LoadLimits) -> Result<Scene, LoadError> {
    let file = container::open(bytes, limits)?;
    let mut warnings = Warnings::default();
    extensions::check(&file.root, &mut warnings)?;
    let nodes = nodes::place(&file.root, limits, &mut warnings)?;
    let (objects, degenerate_triangles) = read_objects(&file, &nodes, limits, &mut warnings)?;
    let bounds = world_bounds(&objects)?;
    let lights = lights::collect(&file.root, &nodes, &objects, limits, &mut warnings)?;
    let cameras = read_cameras(&file.root, &nodes, &mut warnings)?;
    if degenerate_triangles > 0 {
        warnings.add(format!("{degenerate_triangles} triangles without an area were dropped"), "");
    }
    Ok(Scene {
        origin: choose_origin(bounds),
        objects: objects.into_iter().map(|(object, _)| object).collect(),
        lights,
        groups: std::collections::BTreeMap::new(),
        cameras,
        warnings: warnings.into_texts(),
        degenerate_triangles,
    })
}

/// An object per node with a mesh, each with the glTF side of its mesh; and the number of
/// dropped triangles.
#[expect(clippy::type_complexity, reason = "a list of pairs and a count, read once, right below its only call")]
fn read_objects(
    file: &File<'_>,
    nodes: &[PlacedNode],
    limits: &LoadLimits,
    warnings: &mut Warnings,
) -> Result<(Vec<(Object, Arc<LoadedMesh>)>, usize), LoadError> {
    let mut materials = Materials::new(file, limits);
    let mut meshes = Meshes::new(file, limits);
    let mut names = UniqueNames::default();
    let mut objects: Vec<(Object, Arc<LoadedMesh>)> = Vec::new();
    let (mut triangles, mut degenerate) = (0_usize, 0_usize);
    for node in nodes {
        let Some(mesh_index) = file.root.nodes[node.index].mesh else { continue };
        let loaded = meshes.get(mesh_index, &mut materials, warnings)?;
        let place = || format!("node {} \"{}\"", node.index, node.name);
        if loaded.mesh.triangles.is_empty() {
            // It stays an object that edits can name.
            warnings.add("nodes whose mesh has no triangle that blocks light have no elements", place());
        }
        if DMat3::from_mat4(node.world_from_node).determinant() == 0.0 {
            warnings.add("nodes with a scale of zero are left out", place());
            continue;
        }
        if objects.len() >= limits.max_objects {
            return Err(too_large("objects (nodes with a mesh)", limits.max_objects));
        }
        triangles += loaded.mesh.triangles.len();
        if triangles > limits.max_triangles {
            return Err(too_large("triangles", limits.max_triangles));
        }
        degenerate += loaded.degenerate_triangles;
        let name = names.claim(&node.name);
        if name != node.name {
            warnings.add("nodes of the same name were renamed", format!("\"{}\" to \"{name}\"", node.name));
        }
        let object = Object {
            name,
            mesh: Arc::clone(&loaded.mesh),
            materials: loaded.materials.iter().map(|m| m.material).collect(),
            world_from_object: node.world_from_node,
        };
        objects.push((object, loaded));
    }
    if triangles == 0 {
        let notes = std::mem::take(warnings).into_texts();
        let notes = if notes.is_empty() { String::new() } else { format!(" ({})", notes.join("; ")) };
        return Err(LoadError::Unsupported(format!("the scene has no triangle that light could fall on{notes}")));
    }
    Ok((objects, degenerate))
}

/// Bounds of all triangles in world space, metres.
fn world_bounds(objects: &[(Object, Arc<LoadedMesh>)]) -> Result<(DVec3, DVec3), LoadError> {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for (object, _) in objects.iter().filter(|(o, _)| !o.mesh.triangles.is_empty()) {
        let mesh = &object.mesh;
        let (mut object_low, mut object_high) = (low, high);
        for &corner in mesh.triangles.iter().flatten() {
            let position = object.world_from_object.transform_point3(mesh.positions[corner as usize].as_dvec3());
            (object_low, object_high) = (object_low.min(position), object_high.max(position));
        }
        let extent = (object_high - object_low).max_element();
        // A far away scene keeps its precision (see `Scene::origin`), a vast one does not.
        if !extent.is_finite() || extent > MAX_EXTENT {
            return Err(LoadError::Malformed(format!(
                "object \"{}\": with it the scene spans {extent:.3e} metres; at most {MAX_EXTENT:.0e} are possible",
                object.name
            )));
        }
        (low, high) = (object_low, object_high);
    }
    Ok((low, high))
}

/// The zero of scene space: the world's own zero where it is near (positions then equal those of the file, bit for
/// bit), otherwise the centre of the bounds, rounded to a power of two so that adding it back is nearly exact.
fn choose_origin((low, high): (DVec3, DVec3)) -> DVec3 {
    let extent = (high - low).max_element();
    let centre = (low + high) * 0.5;
    if extent <= 0.0 || centre.abs().max_element() <= 2.0 * extent {
        return DVec3::ZERO;
    }
    let step = extent.log2().floor().exp2() / 8.0;
    (centre / step).round() * step
}

fn read_cameras(root: &json::Root, nodes: &[PlacedNode], warnings: &mut Warnings) -> Result<Vec<Camera>, LoadError> {
    let mut names = UniqueNames::default();
    let mut cameras = Vec::new();
    for node in nodes {
        let Some(index) = root.nodes[node.index].camera else { continue };
        let place = format!("camera {} \"{}\"", index.value(), node.name);
        let camera = root.get(index).ok_or_else(|| malformed(&place, "does not exist"))?;
        let Some(perspective) = &camera.perspective else {
            warnings.add("orthographic cameras are left out", place);
            continue;
        };
        let fov_y = perspective.yfov;
        if !(fov_y > 0.0 && fov_y < std::f32::consts::PI) {
            return Err(malformed(&place, &format!("yfov is {fov_y}, it must be above 0 and below pi")));
        }
        // The specification has a camera ignore the scale of its node.
        let (scale, rotation, position) = node.world_from_node.to_scale_rotation_translation();
        if !rotation.is_finite() || scale.min_element() == 0.0 {
            warnings.add("cameras whose node has a scale of zero are left out", place);
            continue;
        }
        let world_from_camera = DMat4::from_rotation_translation(rotation.normalize(), position);
        cameras.push(Camera { name: names.claim(&node.name), world_from_camera, fov_y });
    }
    Ok(cameras)
}

fn malformed(place: &str, what: &str) -> LoadError {
    LoadError::Malformed(format!("{place}: {what}"))
}

fn too_large(what: &str, limit: usize) -> LoadError {
    LoadError::TooLarge(format!("the file has too many {what}: at most {limit} are allowed"))
}
