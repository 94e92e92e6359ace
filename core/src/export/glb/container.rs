//! Puts a binary glTF together: data into the binary chunk, JSON from small pieces.

use std::collections::{BTreeMap, BTreeSet};

use ::gltf::json::{Value, serialize};
use glam::{Vec2, Vec3, Vec4};

use crate::export::ExportError;

/// glTF's name of `f32`.
const FLOAT: u32 = 5126;
/// glTF's name of `u32`.
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// A JSON object.
pub(super) fn object<'k>(entries: impl IntoIterator<Item = (&'k str, Value)>) -> Value {
    entries.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}

/// A JSON array of numbers.
pub(super) fn numbers(values: impl IntoIterator<Item = f32>) -> Value {
    values.into_iter().map(Value::from).collect()
}

/// The lists of a document, and the binary chunk. What is added answers its index.
#[derive(Debug, Default)]
pub(super) struct Document {
    bin: Vec<u8>,
    accessors: Vec<Value>,
    views: Vec<Value>,
    /// Where there are none, all nodes are the roots of one.
    pub(super) scenes: Vec<Value>,
    pub(super) nodes: Vec<Value>,
    pub(super) meshes: Vec<Value>,
    pub(super) materials: Vec<Value>,
    pub(super) cameras: Vec<Value>,
    pub(super) lights: Vec<Value>,
    images: Vec<Value>,
    pub(super) textures: Vec<Value>,
    pub(super) samplers: Vec<Value>,
    /// Of the asset, beside what every file says.
    pub(super) asset: Vec<(&'static str, Value)>,
    /// Name and numbers of a material (as bits), and whether it is double-sided, to its index.
    pub(super) material_indices: BTreeMap<(String, [u32; 8], bool), Value>,
}

impl Document {
    /// A vertex attribute of `f32` triples. Bounds are required for positions.
    pub(super) fn add_vec3(&mut self, values: &[Vec3], with_bounds: bool) -> Value {
        let view = self.add_view(ARRAY_BUFFER, values.iter().flat_map(|value| value.to_array()).map(f32::to_le_bytes));
        let mut accessor = vec![
            ("bufferView", view),
            ("componentType", FLOAT.into()),
            ("count", values.len().into()),
            ("type", "VEC3".into()),
        ];
        if with_bounds {
            let bound = |pick: fn(Vec3, Vec3) -> Vec3| values.iter().copied().reduce(pick).unwrap_or_default();
            accessor.push(("min", numbers(bound(Vec3::min).to_array())));
            accessor.push(("max", numbers(bound(Vec3::max).to_array())));
        }
        push(&mut self.accessors, object(accessor))
    }

    /// A vertex attribute of `f32` pairs.
    pub(super) fn add_vec2(&mut self, values: &[Vec2]) -> Value {
        let numbers = values.iter().flat_map(|value| value.to_array());
        self.add_floats(numbers, values.len(), "VEC2")
    }

    /// A vertex attribute of four `f32`.
    pub(super) fn add_vec4(&mut self, values: &[Vec4]) -> Value {
        let numbers = values.iter().flat_map(|value| value.to_array());
        self.add_floats(numbers, values.len(), "VEC4")
    }

    fn add_floats(&mut self, numbers: impl Iterator<Item = f32>, count: usize, kind: &str) -> Value {
        let view = self.add_view(ARRAY_BUFFER, numbers.map(f32::to_le_bytes));
        let accessor =
            [("bufferView", view), ("componentType", FLOAT.into()), ("count", count.into()), ("type", kind.into())];
        push(&mut self.accessors, object(accessor))
    }

    /// A picture file as an image.
    pub(super) fn add_image(&mut self, name: Option<&str>, media_type: &str, bytes: &[u8]) -> Value {
        let start = self.bin.len();
        self.bin.extend(bytes);
        let view = [("buffer", 0.into()), ("byteOffset", start.into()), ("byteLength", bytes.len().into())];
        let view = push(&mut self.views, object(view));
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let image = [("bufferView", view), ("mimeType", media_type.into())];
        push(&mut self.images, object(image.into_iter().chain(name.map(|name| ("name", name.into())))))
    }

    /// Triangle indices.
    pub(super) fn add_indices(&mut self, triangles: &[[u32; 3]]) -> Value {
        let view = self.add_view(ELEMENT_ARRAY_BUFFER, triangles.iter().flatten().map(|index| index.to_le_bytes()));
        let accessor = [
            ("bufferView", view),
            ("componentType", UNSIGNED_INT.into()),
            ("count", (triangles.len() * 3).into()),
            ("type", "SCALAR".into()),
        ];
        push(&mut self.accessors, object(accessor))
    }

    /// All values are four bytes wide, and pictures are padded, so that every view begins aligned.
    fn add_view(&mut self, target: u32, words: impl Iterator<Item = [u8; 4]>) -> Value {
        let start = self.bin.len();
        self.bin.extend(words.flatten());
        let view = [
            ("buffer", 0.into()),
            ("byteOffset", start.into()),
            ("byteLength", (self.bin.len() - start).into()),
            ("target", target.into()),
        ];
        push(&mut self.views, object(view))
    }

    /// The bytes of the file.
    pub(super) fn finish(mut self) -> Result<Vec<u8>, ExportError> {
        let bin = std::mem::take(&mut self.bin);
        let mut document = serialize::to_vec(&self.into_json(bin.len())).map_err(|_| ExportError::Json)?;
        document.resize(document.len().next_multiple_of(4), b' ');
        let bin_chunk = if bin.is_empty() { 0 } else { 8 + bin.len() };
        let length = u32::try_from(12 + 8 + document.len() + bin_chunk).map_err(|_| ExportError::TooLarge)?;
        let mut file = Vec::with_capacity(length as usize);
        file.extend(b"glTF");
        file.extend(2_u32.to_le_bytes());
        file.extend(length.to_le_bytes());
        // Both lengths are below that of the file, which fits.
        file.extend((document.len() as u32).to_le_bytes());
        file.extend(b"JSON");
        file.extend(document);
        if !bin.is_empty() {
            file.extend((bin.len() as u32).to_le_bytes());
            file.extend(b"BIN\0");
            file.extend(bin);
        }
        Ok(file)
    }

    fn into_json(self, bin_bytes: usize) -> Value {
        let mut asset = vec![("version", "2.0".into()), ("generator", "rebake".into())];
        asset.extend(self.asset);
        let asset = object(asset);
        let mut extensions = BTreeSet::new();
        let lists = [&self.nodes, &self.materials, &self.textures];
        lists.into_iter().flatten().for_each(|value| named_extensions(value, &mut extensions));
        let required = required_extensions(&self.textures);
        let scenes = match self.scenes.is_empty() {
            false => self.scenes,
            true if self.nodes.is_empty() => vec![object([])],
            true => vec![object([("nodes", (0..self.nodes.len()).collect::<Vec<usize>>().into())])],
        };
        let mut entries = vec![("asset", asset), ("scene", 0.into()), ("scenes", scenes.into())];
        if !self.lights.is_empty() {
            let lights = object([("lights", self.lights.into())]);
            entries.push(("extensions", object([("KHR_lights_punctual", lights)])));
        }
        if bin_bytes > 0 {
            entries.push(("buffers", vec![object([("byteLength", bin_bytes.into())])].into()));
        }
        // The specification forbids empty lists.
        let lists = [
            ("nodes", self.nodes),
            ("meshes", self.meshes),
            ("materials", self.materials),
            ("cameras", self.cameras),
            ("images", self.images),
            ("textures", self.textures),
            ("samplers", self.samplers),
            ("accessors", self.accessors),
            ("bufferViews", self.views),
        ];
        entries.extend(lists.into_iter().filter(|(_, list)| !list.is_empty()).map(|(key, list)| (key, list.into())));
        if !extensions.is_empty() {
            entries.push(("extensionsUsed", extensions.into_iter().collect()));
        }
        if !required.is_empty() {
            entries.push(("extensionsRequired", required.into_iter().collect()));
        }
        object(entries)
    }
}

/// Names of the extensions anywhere in a value; what is said in `extras` is not ours.
fn named_extensions(value: &Value, found: &mut BTreeSet<String>) {
    match value {
        Value::Object(entries) => {
            for (key, value) in entries.iter().filter(|(key, _)| *key != "extras") {
                if let Value::Object(extensions) = value
                    && key == "extensions"
                {
                    found.extend(extensions.keys().cloned());
                }
                named_extensions(value, found);
            }
        }
        Value::Array(list) => list.iter().for_each(|value| named_extensions(value, found)),
        _ => {}
    }
}

/// Those without which some texture has no picture.
fn required_extensions(textures: &[Value]) -> BTreeSet<String> {
    let alone = textures.iter().filter(|texture| texture.get("source").is_none());
    let names = alone.filter_map(|texture| texture.get("extensions")?.as_object());
    names.flat_map(|extensions| extensions.keys().cloned()).collect()
}

/// Appends; answers the index as JSON.
pub(super) fn push(list: &mut Vec<Value>, value: Value) -> Value {
    list.push(value);
    (list.len() - 1).into()
}
