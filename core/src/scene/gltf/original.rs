//! A file opened again, to be written back with light: what its scene keeps nothing of.

use std::sync::Arc;

use ::gltf::json;
use glam::{DMat3, DMat4};
use image::ImageFormat;
use serde::Deserialize;
use serde_json::value::RawValue;
use serde_json::{Map, Value};

use super::container::{self, File};
use super::files::{Archive, Files};
use super::material::Materials;
use super::mesh::{LoadedMesh, Meshes};
use super::nodes::PlacedNode;
use super::textures::image_bytes;
use super::warnings::Warnings;
use super::{LoadError, LoadLimits, document, instances, nodes, pose};
use crate::scene::Mesh;

/// A file as it was uploaded: its hierarchy, its meshes with all that light does not need, its materials and cameras as
/// JSON, its pictures as files, which are not decoded. Meshes are uncompressed and posed as [`super::load`] has them.
#[derive(Debug, Default)]
pub struct Original {
    /// Nodes of its scene in the order of the file.
    pub(crate) nodes: Vec<OriginalNode>,
    /// Lists of its document by their names: `materials`, `textures`, `samplers`, `images`, `cameras`.
    pub(crate) lists: Lists,
    /// Per image: its bytes and their media type, where it is there and in a format that is known.
    pub(crate) images: Vec<Option<(Vec<u8>, &'static str)>>,
    /// Name of its scene.
    pub(crate) scene_name: Option<String>,
    /// Whom it belongs to: `asset.copyright`.
    pub(crate) copyright: Option<String>,
}

/// Lists of a document, as they are.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(crate) struct Lists {
    pub(crate) materials: Vec<Value>,
    pub(crate) textures: Vec<Value>,
    pub(crate) samplers: Vec<Value>,
    pub(crate) images: Vec<Value>,
    pub(crate) cameras: Vec<Value>,
}

/// A node of a file.
#[derive(Debug)]
pub(crate) struct OriginalNode {
    /// Index in the file.
    pub(crate) index: usize,
    /// Place of the node above it in [`Original::nodes`].
    pub(crate) parent: Option<usize>,
    json: Box<RawValue>,
    /// Node space to world space.
    pub(crate) world_from_node: DMat4,
    /// Hidden, by itself or by a node above.
    pub(crate) is_hidden: bool,
    /// What it shows; none where it is hidden.
    pub(crate) mesh: Option<Arc<OriginalMesh>>,
    /// Per object that it is: object space to world space. Empty without a mesh.
    pub(crate) objects: Vec<DMat4>,
    /// Its objects are instances below it rather than itself (`EXT_mesh_gpu_instancing`).
    pub(crate) is_instanced: bool,
}

/// A mesh of a file as a node poses it.
#[derive(Debug)]
pub(crate) struct OriginalMesh {
    pub(crate) name: Option<String>,
    /// What light meets: triangles in the order of the object's mesh.
    pub(crate) solid: Whole,
    /// What lets all light through.
    pub(crate) clear: Option<Whole>,
}

/// Triangles with all that the file has of them.
#[derive(Debug)]
pub(crate) struct Whole {
    pub(crate) mesh: Arc<Mesh>,
    /// Per entry that [`Mesh::triangle_materials`] may hold: index of the material in the file.
    pub(crate) materials: Vec<Option<usize>>,
}

impl OriginalNode {
    /// What the file says of it.
    pub(crate) fn json(&self) -> Map<String, Value> {
        serde_json::from_str(self.json.get()).unwrap_or_default()
    }
}

/// What is read of a document beside what [`container::open`] reads.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Raw {
    asset: Asset,
    scene: Option<usize>,
    scenes: Vec<Named>,
    nodes: Vec<Box<RawValue>>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Asset {
    copyright: Option<String>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Named {
    name: Option<String>,
}

impl Original {
    /// Opens a file that [`super::load`] has read: what that accepts.
    ///
    /// # Errors
    /// [`LoadError`], as [`super::load`].
    pub fn open(bytes: &[u8], limits: &LoadLimits) -> Result<Original, LoadError> {
        if !bytes.starts_with(b"PK") {
            return open_document(bytes, &Files::None, limits);
        }
        let archive = Archive::open(bytes)?;
        let document = archive.document(limits)?;
        open_document(&document, &Files::Archive(archive), limits)
    }
}

/// As [`super::load_path`] finds files.
pub(super) fn open_document(bytes: &[u8], files: &Files<'_>, limits: &LoadLimits) -> Result<Original, LoadError> {
    // More is read of it than when it was accepted.
    let limits = &LoadLimits {
        max_unpacked_bytes: limits.max_unpacked_bytes.saturating_mul(2),
        max_read_bytes: usize::MAX,
        max_triangles: usize::MAX,
        max_vertices: usize::MAX,
        ..limits.clone()
    };
    let file = container::open(bytes, files, limits)?;
    // What nobody read before may be no text.
    let text = String::from_utf8_lossy(container::text(bytes)?);
    let raw: Raw = document::read(text.as_bytes())?;
    let mut warnings = Warnings::default();
    let placed = nodes::place(&file, limits, &mut warnings)?;
    let nodes = read_nodes(&file, &placed, raw.nodes, limits, &mut warnings)?;
    // Pictures that no material uses were not looked at before.
    let picture = |index: usize| {
        let bytes = image_bytes(&file, index, &format!("image {index}")).ok()??;
        let media_type = media_type(&bytes)?;
        Some((bytes.into_owned(), media_type))
    };
    Ok(Original {
        nodes,
        images: (0..file.root.images.len()).map(picture).collect(),
        scene_name: raw.scenes.into_iter().nth(raw.scene.unwrap_or(0)).and_then(|scene| scene.name),
        copyright: raw.asset.copyright,
        lists: document::read(text.as_bytes()).unwrap_or_default(),
    })
}

fn read_nodes(
    file: &File<'_>,
    placed: &[PlacedNode],
    texts: Vec<Box<RawValue>>,
    limits: &LoadLimits,
    warnings: &mut Warnings,
) -> Result<Vec<OriginalNode>, LoadError> {
    let parents = parents(&file.root, placed);
    let mut texts: Vec<Option<Box<RawValue>>> = texts.into_iter().map(Some).collect();
    let mut materials = Materials::undecoded(file, limits);
    let mut meshes = Meshes::whole(file, limits);
    let mut known: std::collections::BTreeMap<*const LoadedMesh, Arc<OriginalMesh>> = Default::default();
    // Held, so that no address is given twice.
    let mut held: Vec<Arc<LoadedMesh>> = Vec::new();
    let mut read = Vec::with_capacity(placed.len());
    for (node, parent) in placed.iter().zip(parents) {
        let (mut mesh, mut objects) = (None, Vec::new());
        if let Some(index) = file.root.nodes[node.index].mesh.filter(|_| !node.is_hidden) {
            let pose = pose::of_node(file, node, placed, warnings)?;
            let loaded = meshes.get(index, &pose, &mut materials, warnings)?;
            let name = file.root.get(index).and_then(|mesh| mesh.name.clone());
            let whole = known.entry(Arc::as_ptr(&loaded)).or_insert_with(|| Arc::new(OriginalMesh::of(&loaded, name)));
            mesh = Some(Arc::clone(whole));
            held.push(loaded);
            objects = instances::of_node(file, node, limits)?;
            objects.retain(|place| place.is_finite() && DMat3::from_mat4(*place).determinant() != 0.0);
        }
        let json = texts.get_mut(node.index).and_then(Option::take);
        let json = json.ok_or_else(|| super::malformed(&format!("node {}", node.index), "does not exist"))?;
        let is_instanced = file.more.node(node.index).is_some_and(|extensions| extensions.instancing.is_some());
        let (world_from_node, is_hidden) = (node.world_from_node, node.is_hidden);
        read.push(OriginalNode {
            index: node.index,
            parent,
            json,
            world_from_node,
            is_hidden,
            mesh,
            objects,
            is_instanced,
        });
    }
    Ok(read)
}

impl OriginalMesh {
    fn of(loaded: &LoadedMesh, name: Option<String>) -> OriginalMesh {
        let whole = |of: &LoadedMesh| Whole {
            mesh: Arc::clone(&of.mesh),
            materials: of.materials.iter().map(|material| material.index).collect(),
        };
        OriginalMesh { name, solid: whole(loaded), clear: loaded.clear.as_deref().map(whole) }
    }
}

/// Per placed node the place of the one above.
fn parents(root: &json::Root, placed: &[PlacedNode]) -> Vec<Option<usize>> {
    let mut parents = vec![None; placed.len()];
    for (place, node) in placed.iter().enumerate() {
        for child in root.nodes[node.index].children.iter().flatten() {
            if let Ok(below) = placed.binary_search_by_key(&child.value(), |node| node.index) {
                parents[below] = Some(place);
            }
        }
    }
    parents
}

/// By the first bytes: the stated type is often wrong.
fn media_type(bytes: &[u8]) -> Option<&'static str> {
    if super::ktx2::is_ktx2(bytes) {
        return Some("image/ktx2");
    }
    match image::guess_format(bytes).ok()? {
        ImageFormat::Png => Some("image/png"),
        ImageFormat::Jpeg => Some("image/jpeg"),
        ImageFormat::WebP => Some("image/webp"),
        ImageFormat::Avif => Some("image/avif"),
        ImageFormat::Dds => Some("image/vnd-ms.dds"),
        _ => None,
    }
}
