//! What is lit: objects, materials, lights and cameras as plain data, without a tree and without a light map.
//!
//! All positions are metres in **scene space**: world space minus [`Scene::origin`], so that a scene that lies
//! far from the world's origin keeps the full precision of `f32`. What leaves the engine is put back into world space.

mod gltf;
mod light;
mod look;
mod merge;
mod names;
mod outside;
mod primitives;
mod sky;
mod texture;

pub use self::gltf::{LoadError, LoadLimits, Original, load, load_path, open_original, packed};
pub(crate) use self::gltf::{OriginalMesh, OriginalNode};
pub use self::light::{ENVIRONMENT, Light, LightKind};
pub use self::look::{AlphaMode, Look};
pub(crate) use self::look::{Passage, Through};
pub use self::merge::merge_as_object;
pub use self::outside::Outside;
pub use self::sky::{LoadedSky, SkyError, SkyPicture, is_sky, load_sky};
pub use self::texture::{AlphaUse, Texture, TextureMean, TextureUse, Wrap};

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{DMat4, DVec3, Vec2, Vec3, Vec4};

/// A scene without its light map. Cheap to clone: objects are shared.
#[derive(Clone, Debug)]
pub struct Scene {
    /// World-space point (metres) that is the zero of scene space.
    pub origin: DVec3,
    /// Objects in the order of their glTF nodes, inserted ones behind them. Names are unique.
    pub objects: Vec<Arc<Object>>,
    /// All lights, emissive surfaces included. Names are unique.
    pub lights: Vec<Light>,
    /// Names of lights that shall share a layer of the light map, with the name of that layer.
    pub groups: BTreeMap<String, String>,
    /// Names of punctual lights whose nodes lie under an object's node in the file (or that came with an inserted
    /// object), with the name of that object.
    pub light_parents: BTreeMap<String, String>,
    /// Names of the file's punctual lights, with their nodes there.
    pub light_nodes: BTreeMap<String, NodeSource>,
    /// Lights of hidden objects, by the name of the object. Their names are taken.
    pub hidden_lights: BTreeMap<String, Vec<HiddenLight>>,
    /// Cameras of the file, in its order.
    pub cameras: Vec<Camera>,
    /// What the file is found by where it is kept; objects that are inserted from it have it as well ([`Object::asset`]).
    pub asset: Option<Arc<str>>,
    /// What the file asked for and did not get, in words for a person.
    pub warnings: Vec<String>,
    /// Triangles without an area that were dropped.
    pub degenerate_triangles: usize,
}

impl Scene {
    /// Bytes of all textures; those that objects share count once.
    pub(crate) fn texture_bytes(&self) -> usize {
        let looks = self.objects.iter().flat_map(|object| object.looks.iter().flatten());
        let textures = looks.flat_map(|look| look.textures());
        let by_address: BTreeMap<*const Texture, usize> =
            textures.map(|of| (Arc::as_ptr(&of.texture), of.texture.bytes())).collect();
        by_address.values().sum()
    }
}

/// A named glTF node with a mesh: the unit of an edit.
#[derive(Clone, Debug)]
pub struct Object {
    /// Unique name within the scene.
    pub name: String,
    /// Geometry in object space.
    pub mesh: Arc<Mesh>,
    /// Materials, indexed by [`Mesh::triangle_materials`].
    pub materials: Vec<Material>,
    /// Per material: its name in the file; empty where it has none.
    pub material_names: Vec<Arc<str>>,
    /// Per material: what varies from place to place; absent where the material says all. Empty where all are absent.
    pub looks: Vec<Option<Arc<Look>>>,
    /// Object space to world space (not scene space), metres.
    pub world_from_object: DMat4,
    /// Hidden by an edit: it has no surface for light and no elements, and comes back as it is.
    pub is_hidden: bool,
    /// An edit has inserted it.
    pub is_inserted: bool,
    /// Where it comes from; none for what was inserted or made in code.
    pub node: Option<NodeSource>,
    /// The file that it was inserted from ([`Scene::asset`]).
    pub asset: Option<Arc<str>>,
}

/// The node of the file that an object or a light is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeSource {
    /// Index in the file's list of nodes.
    pub index: u32,
    /// `extras.id` of the node: what the program that wrote the file knows it by.
    pub id: Option<Arc<str>>,
}

/// A light that is off while its object is hidden.
#[derive(Clone, Debug, PartialEq)]
pub struct HiddenLight {
    /// As it was, or as it has moved with its object.
    pub light: Light,
    /// It hangs on the object ([`Scene::light_parents`]), and is no emissive surface of it.
    pub hangs: bool,
    /// Its layer ([`Scene::groups`]).
    pub group: Option<String>,
}

/// Triangles in object space, as the file gave them (winding not yet flipped for mirroring transforms).
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Vertex positions.
    pub positions: Vec<Vec3>,
    /// Unit vertex normals; empty where the file has none for any primitive (flat shading). A zero vector marks a
    /// vertex of a primitive without normals.
    pub normals: Vec<Vec3>,
    /// Vertex indices, counter-clockwise seen from the front.
    pub triangles: Vec<[u32; 3]>,
    /// Per triangle: index into [`Object::materials`].
    pub triangle_materials: Vec<u32>,
    /// Two sets of texture coordinates per vertex, u to the right, v down. The first is empty where no material reads it;
    /// the second, which light maps may use, where the file has none that can be read.
    pub texcoords: [Vec<Vec2>; 2],
    /// Linear RGBA per vertex, which multiplies the base colour; empty where the file has none.
    pub colors: Vec<Vec4>,
}

/// Largest albedo that light meets where nothing else is said.
pub const DEFAULT_MAX_ALBEDO: f32 = 0.95;

/// A diffuse material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Diffuse albedo, linear RGB, each in 0..=1: the mean over the material's textures. Light meets at most what its
    /// world allows ([`crate::WorldOptions::max_albedo`]).
    pub albedo: Vec3,
    /// Emitted radiance at upload, linear RGB; an emissive texture multiplies it by place ([`Look::emissive`]). The radiance in
    /// force is the strength of the [`Light`] of this material.
    pub emission: Vec3,
    /// Both sides reflect (and emit). The back of a single-sided surface blocks light and reflects none.
    pub double_sided: bool,
}

/// What is said where materials reflect more than light may meet; the materials are named behind it.
pub(crate) fn capped_text(max_albedo: f32) -> String {
    format!(
        "an albedo above {max_albedo} is taken as that, since light in a closed room would have no end (max_albedo says otherwise)"
    )
}

/// A perspective camera of the file, in world space.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Name of its node.
    pub name: String,
    /// Camera space (looking down −z, +y up) to world space.
    pub world_from_camera: DMat4,
    /// Vertical field of view, radians.
    pub fov_y: f32,
}
