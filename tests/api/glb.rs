//! Small binary glTF files, put together by hand.

use serde_json::{Value, json};

/// A file under construction.
#[derive(Default)]
pub(crate) struct Glb {
    nodes: Vec<Value>,
    meshes: Vec<Value>,
    materials: Vec<Value>,
    accessors: Vec<Value>,
    views: Vec<Value>,
    lights: Vec<Value>,
    cameras: Vec<Value>,
    bin: Vec<u8>,
}

impl Glb {
    /// Adds a mesh of quads as a node of its own. Corners go counter-clockwise seen from the front.
    pub(crate) fn quads(&mut self, name: &str, quads: &[[[f32; 3]; 4]], albedo: f32, emission: f32) -> &mut Self {
        let mut positions = Vec::new();
        let mut indices = Vec::<u32>::new();
        for quad in quads {
            let first = positions.len() as u32;
            positions.extend_from_slice(quad);
            indices.extend([0, 1, 2, 0, 2, 3].map(|i| first + i));
        }
        let low = [0, 1, 2].map(|k| positions.iter().map(|p| p[k]).fold(f32::INFINITY, f32::min));
        let high = [0, 1, 2].map(|k| positions.iter().map(|p| p[k]).fold(f32::NEG_INFINITY, f32::max));
        let bytes: Vec<u8> = positions.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
        let position = self.accessor(
            &bytes,
            json!({
                "componentType": 5126, "type": "VEC3", "count": positions.len(), "min": low, "max": high
            }),
        );
        let bytes: Vec<u8> = indices.iter().flat_map(|i| i.to_le_bytes()).collect();
        let index = self.accessor(&bytes, json!({ "componentType": 5125, "type": "SCALAR", "count": indices.len() }));
        self.materials.push(json!({
            "pbrMetallicRoughness": { "baseColorFactor": [albedo, albedo, albedo, 1.0], "metallicFactor": 0.0 },
            "emissiveFactor": [emission.min(1.0), emission.min(1.0), emission.min(1.0)],
            "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": emission.max(1.0) } }
        }));
        let primitive = json!({
            "attributes": { "POSITION": position }, "indices": index, "material": self.materials.len() - 1
        });
        self.meshes.push(json!({ "primitives": [primitive] }));
        self.nodes.push(json!({ "name": name, "mesh": self.meshes.len() - 1 }));
        self
    }

    /// Adds an axis-aligned box whose faces look outward, or inward for a room.
    pub(crate) fn cuboid(&mut self, name: &str, low: [f32; 3], high: [f32; 3], albedo: f32, inward: bool) -> &mut Self {
        let ([x, y, z], [u, v, w]) = (low, high);
        let mut faces = [
            [[x, y, z], [u, y, z], [u, y, w], [x, y, w]],
            [[x, v, w], [u, v, w], [u, v, z], [x, v, z]],
            [[x, y, w], [u, y, w], [u, v, w], [x, v, w]],
            [[u, y, z], [x, y, z], [x, v, z], [u, v, z]],
            [[u, y, w], [u, y, z], [u, v, z], [u, v, w]],
            [[x, y, z], [x, y, w], [x, v, w], [x, v, z]],
        ];
        if inward {
            for face in &mut faces {
                face.reverse();
            }
        }
        self.quads(name, &faces, albedo, 0.0)
    }

    /// Adds a point light.
    pub(crate) fn point_light(&mut self, name: &str, position: [f32; 3], intensity: f32) -> &mut Self {
        self.lights.push(json!({ "type": "point", "intensity": intensity }));
        let light = self.lights.len() - 1;
        self.nodes.push(json!({
            "name": name, "translation": position, "extensions": { "KHR_lights_punctual": { "light": light } }
        }));
        self
    }

    /// Adds a camera that looks along −z.
    pub(crate) fn camera(&mut self, name: &str, position: [f32; 3]) -> &mut Self {
        self.cameras.push(json!({ "type": "perspective", "perspective": { "yfov": 1.0, "znear": 0.01 } }));
        let camera = self.cameras.len() - 1;
        self.nodes.push(json!({ "name": name, "translation": position, "camera": camera }));
        self
    }

    fn accessor(&mut self, bytes: &[u8], mut accessor: Value) -> usize {
        self.views.push(json!({ "buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len() }));
        self.bin.extend_from_slice(bytes);
        accessor["bufferView"] = json!(self.views.len() - 1);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// The document.
    pub(crate) fn document(&self) -> Value {
        let mut document = json!({
            "asset": { "version": "2.0" },
            "scene": 0,
            "scenes": [{ "nodes": (0..self.nodes.len()).collect::<Vec<_>>() }],
            "nodes": self.nodes,
            "meshes": self.meshes,
            "materials": self.materials,
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{ "byteLength": self.bin.len() }],
            "extensionsUsed": ["KHR_lights_punctual", "KHR_materials_emissive_strength"],
        });
        if !self.cameras.is_empty() {
            document["cameras"] = json!(self.cameras);
        }
        if !self.lights.is_empty() {
            document["extensions"] = json!({ "KHR_lights_punctual": { "lights": self.lights } });
        }
        document
    }

    /// The file.
    pub(crate) fn bytes(&self) -> Vec<u8> {
        pack(&self.document(), &self.bin)
    }

    /// The file with its document changed.
    pub(crate) fn bytes_with(&self, change: impl FnOnce(&mut Value)) -> Vec<u8> {
        let mut document = self.document();
        change(&mut document);
        pack(&document, &self.bin)
    }
}

/// A binary glTF container.
pub(crate) fn pack(document: &Value, bin: &[u8]) -> Vec<u8> {
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut padded = bin.to_vec();
    padded.resize(bin.len().next_multiple_of(4), 0);
    let mut chunks = Vec::new();
    for (kind, bytes) in [(0x4E4F_534Au32, &json), (0x004E_4942, &padded)] {
        chunks.extend((bytes.len() as u32).to_le_bytes());
        chunks.extend(kind.to_le_bytes());
        chunks.extend(bytes);
    }
    let mut file = b"glTF".to_vec();
    file.extend(2u32.to_le_bytes());
    file.extend((12 + chunks.len() as u32).to_le_bytes());
    file.extend(chunks);
    file
}

/// A closed room, 4 × 3 × 4 m, with a cupboard, a lamp and a camera.
pub(crate) fn room() -> Glb {
    let mut glb = Glb::default();
    glb.cuboid("room", [0.0, 0.0, 0.0], [4.0, 3.0, 4.0], 0.7, true)
        .cuboid("cupboard", [0.5, 0.02, 0.5], [1.5, 1.5, 1.0], 0.5, false)
        .point_light("lamp", [2.0, 2.0, 2.0], 20.0)
        .camera("view", [2.0, 1.5, 3.5]);
    glb
}

/// A crate of half a metre at the origin, to be inserted.
pub(crate) fn crate_asset() -> Vec<u8> {
    let mut glb = Glb::default();
    glb.cuboid("crate", [0.0, 0.0, 0.0], [0.5, 0.5, 0.5], 0.4, false);
    glb.bytes()
}

/// Column-major translation.
pub(crate) fn translation(x: f64, y: f64, z: f64) -> Value {
    json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1])
}
