//! Reads glTF 2.0 files into a [`Scene`]: `.glb`, `.gltf` with its files in a zip archive or a folder.
//!
//! The `gltf` crate has the types of the JSON. Every index, range and number is checked here before it is used, since
//! the crate's own accessors and part of its validation panic on files that break the specification. Nothing is ever
//! fetched from a network, and uploads reach no file but those of their own archive.

mod accessor;
mod attributes;
mod container;
mod departures;
mod document;
mod draco;
mod extensions;
mod files;
mod instances;
mod ktx2;
mod lights;
mod material;
mod mesh;
mod nodes;
mod original;
mod pack;
mod pose;
#[cfg(test)]
mod tests;
mod textures;
mod views;
mod warnings;

use std::path::Path;
use std::sync::Arc;

use ::gltf::json;
use glam::{DMat3, DMat4, DVec3};

use self::container::File;
use self::files::{Archive, Files};
use self::lights::Lights;
use self::material::Materials;
use self::mesh::{LoadedMesh, Meshes};
use self::nodes::PlacedNode;
pub use self::original::Original;
pub(crate) use self::original::{OriginalMesh, OriginalNode};
pub use self::pack::packed;
use self::warnings::Warnings;
use super::names::UniqueNames;
use super::{Camera, DEFAULT_MAX_ALBEDO, Object, Scene};
use crate::allowed::Allowed;

/// Upper bounds on what one file may ask for. Beyond them [`load`] answers [`LoadError::TooLarge`].
#[derive(Clone, Debug, PartialEq)]
pub struct LoadLimits {
    /// Bytes of the file.
    pub max_bytes: usize,
    /// Bytes of all that is unpacked: files of an archive, compressed meshes, data within the JSON.
    pub max_unpacked_bytes: usize,
    /// Bytes of all values that are read, of accessors and of compressed meshes: an accessor that is used twice counts
    /// twice, and so bounds the time as well. In memory at a time are those of one mesh.
    pub max_read_bytes: usize,
    /// Of these the bytes of values that the file does not hold: accessors without a buffer view are zeros.
    pub max_zero_bytes: usize,
    /// Nodes, used or not. The other lists and the JSON as a whole are bounded in proportion.
    pub max_nodes: usize,
    /// Materials, and any other list of the document that is not named here.
    pub max_materials: usize,
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
    /// Texels of all textures that are kept for the light map; beyond some part of it they are kept smaller.
    pub max_kept_texels: usize,
    /// Largest albedo without a warning: the cap of the world that the scene is for
    /// ([`crate::WorldOptions::max_albedo`]).
    pub max_albedo: f32,
}

impl Default for LoadLimits {
    fn default() -> Self {
        Self {
            max_bytes: 1 << 30,
            max_unpacked_bytes: 2 << 30,
            max_read_bytes: 4_000_000_000,
            max_zero_bytes: 1 << 27,
            max_nodes: 1_000_000,
            max_materials: 100_000,
            max_depth: 256,
            max_objects: 100_000,
            max_lights: 10_000,
            max_triangles: 20_000_000,
            max_vertices: 60_000_000,
            max_texture_pixels: 1 << 26,
            max_total_texture_pixels: 1 << 30,
            max_kept_texels: 1 << 25,
            max_albedo: DEFAULT_MAX_ALBEDO,
        }
    }
}

/// Why a file was refused. The text names the place in the file and is meant for the person who uploaded it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LoadError {
    /// The file breaks the specification: damaged, inconsistent, or no glTF at all (HTTP 400).
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

/// Reads a file: a `.glb`, a `.gltf` with all data within its JSON, or a zip archive that holds one of either with its
/// files. What it is shows in its first bytes.
///
/// Deterministic: the same bytes give the same scene. Never panics, whatever the bytes.
///
/// # Errors
/// [`LoadError`], with a text that names the place in the file.
pub fn load(bytes: &[u8], limits: &LoadLimits) -> Result<Scene, LoadError> {
    if bytes.len() > limits.max_bytes {
        return Err(LoadError::TooLarge(format!(
            "the file has {} bytes; at most {} are allowed",
            bytes.len(),
            limits.max_bytes
        )));
    }
    if !bytes.starts_with(b"PK") {
        return load_document(bytes, &Files::None, limits);
    }
    let archive = Archive::open(bytes)?;
    let document = archive.document(limits)?;
    load_document(&document, &Files::Archive(archive), limits)
}

/// Reads a file of this machine: as [`load`], and a `.gltf` finds its files where it names them.
///
/// # Errors
/// [`LoadError`], with a text that names the place in the file.
pub fn load_path(path: &Path, limits: &LoadLimits) -> Result<Scene, LoadError> {
    let unreadable = |error: std::io::Error| LoadError::Malformed(format!("{}: {error}", path.display()));
    let length = std::fs::metadata(path).map_err(unreadable)?.len();
    if length > limits.max_bytes as u64 {
        let text = format!("the file has {length} bytes; at most {} are allowed", limits.max_bytes);
        return Err(LoadError::TooLarge(text));
    }
    let bytes = std::fs::read(path).map_err(unreadable)?;
    if bytes.starts_with(b"PK") {
        return load(&bytes, limits);
    }
    let folder = path.parent().unwrap_or(Path::new("")).to_owned();
    load_document(&bytes, &Files::Folder(folder), limits)
}

/// Opens a file of this machine to be written back: as [`Original::open`], and a `.gltf` finds its files where it names
/// them.
///
/// # Errors
/// [`LoadError`], with a text that names the place in the file.
pub fn open_original(path: &Path, limits: &LoadLimits) -> Result<Original, LoadError> {
    let bytes = std::fs::read(path).map_err(|error| LoadError::Malformed(format!("{}: {error}", path.display())))?;
    if bytes.starts_with(b"PK") {
        return Original::open(&bytes, limits);
    }
    let folder = path.parent().unwrap_or(Path::new("")).to_owned();
    original::open_document(&bytes, &Files::Folder(folder), limits)
}

fn load_document(bytes: &[u8], files: &Files<'_>, limits: &LoadLimits) -> Result<Scene, LoadError> {
    let file = container::open(bytes, files, limits)?;
    let mut warnings = Warnings::default();
    extensions::check(&file, &mut warnings)?;
    departures::remark(&file.root, &mut warnings);
    let nodes = nodes::place(&file, limits, &mut warnings)?;
    let (objects, degenerate_triangles) = read_objects(&file, &nodes, limits, &mut warnings)?;
    let bounds = world_bounds(&objects)?;
    let Lights { lights, parents, nodes: light_nodes } =
        lights::collect(&file.root, &nodes, &objects, limits, &mut warnings)?;
    let cameras = read_cameras(&file.root, &nodes, &mut warnings)?;
    if degenerate_triangles > 0 {
        warnings.add(format!("{degenerate_triangles} triangles without an area were dropped"), "");
    }
    Ok(Scene {
        origin: choose_origin(bounds),
        objects: objects.into_iter().map(|loaded| Arc::new(loaded.object)).collect(),
        lights,
        groups: std::collections::BTreeMap::new(),
        light_parents: parents,
        light_nodes,
        hidden_lights: std::collections::BTreeMap::new(),
        cameras,
        asset: None,
        warnings: warnings.into_texts(),
        degenerate_triangles,
    })
}

/// An object with what it came from.
struct LoadedObject {
    object: Object,
    loaded: Arc<LoadedMesh>,
    /// Index of its node.
    node: usize,
}

/// An object per node with a mesh, or per instance of it; and the number of dropped triangles.
fn read_objects(
    file: &File<'_>,
    nodes: &[PlacedNode],
    limits: &LoadLimits,
    warnings: &mut Warnings,
) -> Result<(Vec<LoadedObject>, usize), LoadError> {
    let mut materials = Materials::new(file, limits);
    let mut meshes = Meshes::new(file, limits);
    let mut names = UniqueNames::default();
    let mut objects: Vec<LoadedObject> = Vec::new();
    let (mut triangles, mut degenerate) = (0_usize, 0_usize);
    for node in nodes.iter().filter(|node| !node.is_hidden) {
        let Some(mesh_index) = file.root.nodes[node.index].mesh else { continue };
        let pose = pose::of_node(file, node, nodes, warnings)?;
        let loaded = meshes.get(mesh_index, &pose, &mut materials, warnings)?;
        let place = || format!("node {} \"{}\"", node.index, node.name);
        if loaded.mesh.triangles.is_empty() {
            // It stays an object that edits can name.
            warnings.add("nodes whose mesh has no triangle that blocks light have no elements", place());
        }
        let instances = instances::of_node(file, node, limits)?;
        for (number, world_from_object) in instances.into_iter().enumerate() {
            let world_from_object = instances::with_thickness(world_from_object, &loaded.mesh);
            if !world_from_object.is_finite() || DMat3::from_mat4(world_from_object).determinant() == 0.0 {
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
            if name != node.name && number == 0 {
                warnings.add("nodes of the same name were renamed", format!("\"{}\" to \"{name}\"", node.name));
            }
            let mesh = Arc::clone(&loaded.mesh);
            let materials = loaded.materials.iter().map(|m| m.material).collect();
            let material_names = loaded.materials.iter().map(|m| Arc::clone(&m.name)).collect();
            let looks = if loaded.materials.iter().any(|m| m.look.is_some()) {
                loaded.materials.iter().map(|m| m.look.clone()).collect()
            } else {
                Vec::new()
            };
            let source = Some(nodes::source(&file.root, node.index));
            let object = Object {
                name,
                mesh,
                materials,
                material_names,
                looks,
                world_from_object,
                is_hidden: false,
                is_inserted: false,
                node: source,
                asset: None,
            };
            objects.push(LoadedObject { object, loaded: Arc::clone(&loaded), node: node.index });
        }
    }
    if triangles == 0 {
        warnings.add("the scene has no triangle that light could fall on", "");
    }
    Ok((objects, degenerate))
}

/// Bounds of all triangles in world space, metres.
fn world_bounds(objects: &[LoadedObject]) -> Result<(DVec3, DVec3), LoadError> {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for object in objects.iter().map(|loaded| &loaded.object) {
        let Some((object_low, object_high)) = object.bounds() else { continue };
        (low, high) = (low.min(object_low), high.max(object_high));
        let extent = (high - low).max_element();
        // A far away scene keeps its precision (see `Scene::origin`), a vast one does not.
        let most = Allowed::ASKED.farthest;
        if !extent.is_finite() || extent > most {
            return Err(LoadError::Malformed(format!(
                "object \"{}\": with it the scene spans {extent:.3e} metres; at most {most:e} are possible",
                object.name
            )));
        }
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
