//! The JSON of a glTF document, read under limits into the `gltf` crate's types and a few of our own.
//!
//! What is not used (animations) is skipped unread, so that it cannot be at fault.

use std::fmt;

use ::gltf::json;
use serde::Deserialize;
use serde::de::{DeserializeSeed, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};

use super::{LoadError, LoadLimits, too_large};

/// Objects and arrays of the document, per node that is allowed.
const CONTAINERS_PER_NODE: usize = 8;
/// Commas of the document, per node that is allowed: a bound on its numbers.
const COMMAS_PER_NODE: usize = 32;
/// Characters of a parser's message that are passed on.
const MESSAGE_CHARS: usize = 300;

/// A parsed document.
#[derive(Debug)]
pub(super) struct Document {
    /// What the `gltf` crate knows. Its animations are left out.
    pub(super) root: json::Root,
    /// Extensions that the `gltf` crate does not know.
    pub(super) more: Extensions,
    /// Whether there are animations.
    pub(super) has_animations: bool,
}

/// Parses a document, `{ … }`.
pub(super) fn parse(text: &[u8], limits: &LoadLimits) -> Result<Document, LoadError> {
    // Tolerated by parsers in the field: a byte order mark.
    let text = text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text);
    check_counts(text, limits)?;
    let Outline { root, has_animations } = read::<Outline>(text)?;
    Ok(Document { root, more: read(text)?, has_animations })
}

/// What `T` wants of a document.
pub(super) fn read<'t, T: Deserialize<'t>>(text: &'t [u8]) -> Result<T, LoadError> {
    serde_json::from_slice(text).map_err(|error| not_gltf(&error))
}

fn not_gltf(error: &serde_json::Error) -> LoadError {
    let message: String = error.to_string().chars().take(MESSAGE_CHARS).collect();
    LoadError::Malformed(format!("the JSON is not a glTF document: {message}"))
}

/// Counts what the document has before memory is spent on it: `{}` takes two bytes there and hundreds as a material.
fn check_counts(text: &[u8], limits: &LoadLimits) -> Result<(), LoadError> {
    let mut counts = serde_json::Deserializer::from_slice(text);
    let exceeded = CountLists { limits }.deserialize(&mut counts).map_err(|error| not_gltf(&error))?;
    if let Some((list, limit)) = exceeded {
        return Err(too_large(&list, limit));
    }
    let of = |wanted: fn(&u8) -> bool| text.iter().filter(|byte| wanted(byte)).count();
    let containers = limits.max_nodes.max(1 << 10).saturating_mul(CONTAINERS_PER_NODE);
    if of(|byte| matches!(byte, b'{' | b'[')) > containers {
        return Err(too_large("objects and lists in its JSON", containers));
    }
    let commas = limits.max_nodes.max(1 << 10).saturating_mul(COMMAS_PER_NODE);
    if of(|byte| *byte == b',') > commas {
        return Err(too_large("numbers in its JSON", commas));
    }
    Ok(())
}

fn limit_of(list: &str, limits: &LoadLimits) -> usize {
    match list {
        "nodes" => limits.max_nodes,
        "accessors" | "bufferViews" | "meshes" => limits.max_nodes.saturating_mul(4),
        _ => limits.max_materials,
    }
}

/// Visits the top level and answers the first list that has more entries than allowed, with what is allowed.
struct CountLists<'l> {
    limits: &'l LoadLimits,
}

impl<'de> DeserializeSeed<'de> for CountLists<'_> {
    type Value = Option<(String, usize)>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for CountLists<'_> {
    type Value = Option<(String, usize)>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a glTF document")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut exceeded = None;
        while let Some(list) = map.next_key::<String>()? {
            // Not used, and not kept.
            if list == "animations" || list == "extensions" || list == "extras" {
                map.next_value::<IgnoredAny>()?;
                continue;
            }
            let Length(length) = map.next_value()?;
            let limit = limit_of(&list, self.limits);
            if length > limit && exceeded.is_none() {
                exceeded = Some((list, limit));
            }
        }
        Ok(exceeded)
    }
}

/// Entries of a list; 0 for anything else.
struct Length(usize);

impl<'de> Deserialize<'de> for Length {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(LengthVisitor)
    }
}

struct LengthVisitor;

impl<'de> Visitor<'de> for LengthVisitor {
    type Value = Length;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("any value")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Length, A::Error> {
        let mut length = 0;
        while list.next_element::<IgnoredAny>()?.is_some() {
            length += 1;
        }
        Ok(Length(length))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Length, A::Error> {
        while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
        Ok(Length(0))
    }

    fn visit_str<E>(self, _: &str) -> Result<Length, E> {
        Ok(Length(0))
    }

    fn visit_u64<E>(self, _: u64) -> Result<Length, E> {
        Ok(Length(0))
    }

    fn visit_i64<E>(self, _: i64) -> Result<Length, E> {
        Ok(Length(0))
    }

    fn visit_f64<E>(self, _: f64) -> Result<Length, E> {
        Ok(Length(0))
    }

    fn visit_bool<E>(self, _: bool) -> Result<Length, E> {
        Ok(Length(0))
    }

    fn visit_unit<E>(self) -> Result<Length, E> {
        Ok(Length(0))
    }
}

/// [`json::Root`] as files have it rather than as they ought to.
struct Outline {
    root: json::Root,
    has_animations: bool,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct RawRoot {
    asset: json::Asset,
    scene: Option<json::Index<json::Scene>>,
    extensions: Option<json::extensions::root::Root>,
    #[serde(default)]
    accessors: Vec<json::Accessor>,
    #[serde(default)]
    animations: Vec<IgnoredAny>,
    #[serde(default)]
    buffers: Vec<json::Buffer>,
    #[serde(default)]
    buffer_views: Vec<json::buffer::View>,
    #[serde(default)]
    extensions_used: Vec<String>,
    #[serde(default)]
    extensions_required: Vec<String>,
    #[serde(default)]
    cameras: Vec<json::Camera>,
    #[serde(default)]
    images: Vec<json::Image>,
    #[serde(default)]
    materials: Vec<json::Material>,
    #[serde(default)]
    meshes: Vec<json::Mesh>,
    #[serde(default)]
    nodes: Vec<json::Node>,
    #[serde(default)]
    samplers: Vec<json::texture::Sampler>,
    #[serde(default)]
    scenes: Vec<RawScene>,
    #[serde(default)]
    skins: Vec<json::Skin>,
    #[serde(default)]
    textures: Vec<json::Texture>,
}

/// A scene whose `nodes` may be absent, as an empty scene is often written.
#[derive(Deserialize)]
struct RawScene {
    name: Option<String>,
    #[serde(default)]
    nodes: Vec<json::Index<json::Node>>,
}

impl<'de> Deserialize<'de> for Outline {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let raw = RawRoot::deserialize(deserializer)?;
        let scene =
            |scene: RawScene| json::Scene { extensions: None, extras: None, name: scene.name, nodes: scene.nodes };
        let has_animations = !raw.animations.is_empty();
        let root = json::Root {
            asset: raw.asset,
            scene: raw.scene,
            extensions: raw.extensions,
            accessors: raw.accessors,
            animations: Vec::new(),
            buffers: raw.buffers,
            buffer_views: raw.buffer_views,
            extras: None,
            extensions_used: raw.extensions_used,
            extensions_required: raw.extensions_required,
            cameras: raw.cameras,
            images: raw.images,
            materials: raw.materials,
            meshes: raw.meshes,
            nodes: raw.nodes,
            samplers: raw.samplers,
            scenes: raw.scenes.into_iter().map(scene).collect(),
            skins: raw.skins,
            textures: raw.textures,
        };
        Ok(Self { root, has_animations })
    }
}

/// Extensions that the `gltf` crate does not know, by the lists that they extend. Entries have the index of what they
/// extend; a list may be shorter than the document's.
#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct Extensions {
    nodes: Vec<Extended<NodeExtensions>>,
    buffers: Vec<Extended<MeshoptOf<FallbackBuffer>>>,
    buffer_views: Vec<Extended<MeshoptOf<CompressedView>>>,
    meshes: Vec<MeshPrimitives>,
    textures: Vec<Extended<TextureExtensions>>,
}

#[derive(Debug, Default, Deserialize)]
struct Extended<T> {
    extensions: Option<T>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct MeshPrimitives {
    primitives: Vec<Extended<PrimitiveExtensions>>,
}

/// Of a node.
#[derive(Debug, Deserialize)]
pub(super) struct NodeExtensions {
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    pub(super) instancing: Option<Instancing>,
    #[serde(rename = "KHR_node_visibility")]
    pub(super) visibility: Option<Visibility>,
}

/// `EXT_mesh_gpu_instancing`: accessors of the instances' transforms.
#[derive(Debug, Deserialize)]
pub(super) struct Instancing {
    pub(super) attributes: InstanceAttributes,
}

/// Accessors, by what they hold.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub(super) struct InstanceAttributes {
    pub(super) translation: Option<json::Index<json::Accessor>>,
    pub(super) rotation: Option<json::Index<json::Accessor>>,
    pub(super) scale: Option<json::Index<json::Accessor>>,
}

/// `KHR_node_visibility`.
#[derive(Debug, Deserialize)]
pub(super) struct Visibility {
    #[serde(default = "visible_by_default")]
    pub(super) visible: bool,
}

fn visible_by_default() -> bool {
    true
}

/// `EXT_meshopt_compression` and its successor, which has newer streams and one filter more.
#[derive(Debug, Deserialize)]
struct MeshoptOf<T> {
    #[serde(rename = "EXT_meshopt_compression")]
    ext: Option<T>,
    #[serde(rename = "KHR_meshopt_compression")]
    khr: Option<T>,
}

impl<T> MeshoptOf<T> {
    fn any(&self) -> Option<&T> {
        self.khr.as_ref().or(self.ext.as_ref())
    }
}

/// Marks a buffer whose views are all compressed: it may have no data.
#[derive(Debug, Deserialize)]
struct FallbackBuffer {
    #[serde(default)]
    fallback: bool,
}

/// Where the compressed data of a buffer view lies, and what it becomes.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct CompressedView {
    pub(super) buffer: json::Index<json::Buffer>,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) byte_length: u64,
    pub(super) byte_stride: u64,
    pub(super) count: u64,
    pub(super) mode: String,
    pub(super) filter: Option<String>,
}

/// Of a primitive.
#[derive(Debug, Deserialize)]
struct PrimitiveExtensions {
    #[serde(rename = "KHR_draco_mesh_compression")]
    draco: Option<DracoMesh>,
}

/// `KHR_draco_mesh_compression`.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct DracoMesh {
    pub(super) buffer_view: json::Index<json::buffer::View>,
    /// Attribute name to the unique id within the compressed data.
    pub(super) attributes: std::collections::BTreeMap<String, u32>,
}

/// Of a texture: images in formats that the core specification does not have.
#[derive(Debug, Deserialize)]
pub(super) struct TextureExtensions {
    #[serde(rename = "EXT_texture_webp")]
    pub(super) webp: Option<OtherSource>,
    #[serde(rename = "KHR_texture_basisu")]
    pub(super) basisu: Option<OtherSource>,
    #[serde(rename = "EXT_texture_avif")]
    pub(super) avif: Option<OtherSource>,
    #[serde(rename = "MSFT_texture_dds")]
    pub(super) dds: Option<OtherSource>,
}

/// An image instead of the texture's own.
#[derive(Debug, Deserialize)]
pub(super) struct OtherSource {
    pub(super) source: Option<json::Index<json::Image>>,
}

impl Extensions {
    pub(super) fn node(&self, index: usize) -> Option<&NodeExtensions> {
        self.nodes.get(index)?.extensions.as_ref()
    }

    pub(super) fn is_visible(&self, node: usize) -> bool {
        self.node(node).and_then(|node| node.visibility.as_ref()).is_none_or(|visibility| visibility.visible)
    }

    pub(super) fn is_fallback(&self, buffer: usize) -> bool {
        let extension = self.buffers.get(buffer).and_then(|buffer| buffer.extensions.as_ref());
        extension.and_then(MeshoptOf::any).is_some_and(|meshopt| meshopt.fallback)
    }

    pub(super) fn compressed_view(&self, view: usize) -> Option<&CompressedView> {
        self.buffer_views.get(view)?.extensions.as_ref()?.any()
    }

    pub(super) fn draco(&self, mesh: usize, primitive: usize) -> Option<&DracoMesh> {
        self.meshes.get(mesh)?.primitives.get(primitive)?.extensions.as_ref()?.draco.as_ref()
    }

    pub(super) fn texture(&self, index: usize) -> Option<&TextureExtensions> {
        self.textures.get(index)?.extensions.as_ref()
    }
}
