//! A file to be written back, put together by hand.

use ::gltf::json::Value;
use serde_json::json;

/// A file while it is put together.
#[derive(Default)]
struct File {
    bin: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl File {
    fn view(&mut self, bytes: &[u8]) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        self.views.push(json!({ "buffer": 0, "byteOffset": self.bin.len(), "byteLength": bytes.len() }));
        self.bin.extend_from_slice(bytes);
        self.views.len() - 1
    }

    fn floats(&mut self, values: &[f32], kind: &str, parts: usize) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let view = self.view(&bytes);
        let count = values.len() / parts;
        self.accessors.push(json!({ "bufferView": view, "componentType": 5126, "count": count, "type": kind }));
        self.accessors.len() - 1
    }

    /// A square of `size` in the xz plane that looks up, with normals and two sets of texture coordinates.
    fn square(&mut self, size: f32, material: usize) -> Value {
        let corners = [[0.0, 0.0], [0.0, size], [size, size], [size, 0.0]];
        let positions: Vec<f32> = corners.iter().flat_map(|[x, z]| [*x, 0.0, *z]).collect();
        let places: Vec<f32> = corners.iter().flat_map(|[x, z]| [x / size, z / size]).collect();
        let second: Vec<f32> = places.iter().map(|place| 0.25 + place * 0.5).collect();
        let indices: Vec<u8> = [0_u16, 1, 2, 0, 2, 3].iter().flat_map(|index| index.to_le_bytes()).collect();
        let view = self.view(&indices);
        self.accessors.push(json!({ "bufferView": view, "componentType": 5123, "count": 6, "type": "SCALAR" }));
        let indices = self.accessors.len() - 1;
        let attributes = json!({
            "POSITION": self.floats(&positions, "VEC3", 3),
            "NORMAL": self.floats(&[0.0, 1.0, 0.0].repeat(4), "VEC3", 3),
            "TEXCOORD_0": self.floats(&places, "VEC2", 2), "TEXCOORD_1": self.floats(&second, "VEC2", 2),
        });
        json!({ "attributes": attributes, "indices": indices, "material": material })
    }

    fn bytes(self, mut document: Value) -> Vec<u8> {
        document["buffers"] = json!([{ "byteLength": self.bin.len() }]);
        (document["bufferViews"], document["accessors"]) = (self.views.into(), self.accessors.into());
        pack(&document, &self.bin)
    }
}

fn pack(document: &Value, bin: &[u8]) -> Vec<u8> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut bin = bin.to_vec();
    bin.resize(bin.len().next_multiple_of(4), 0);
    let mut file = [b"glTF".to_vec(), 2_u32.to_le_bytes().into()].concat();
    file.extend((28 + (text.len() + bin.len()) as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", text), (b"BIN\0", bin)] {
        file.extend((chunk.len() as u32).to_le_bytes());
        file.extend(kind);
        file.extend(chunk);
    }
    file
}

pub(super) fn picture() -> Vec<u8> {
    let pixels = [[200_u8, 100, 50], [100, 50, 25], [100, 50, 25], [200, 100, 50]].concat();
    crate::export::write_png(2, 2, &pixels).expect("a picture")
}

/// Squares below groups that are turned and stretched: planks with a texture, of which the second set is read too, and
/// on them a box of two materials; a pane that all light goes through, a lamp; a punctual light and a camera below a
/// node.
pub(super) fn house() -> Vec<u8> {
    let mut file = File::default();
    let picture = file.view(&picture());
    let meshes = json!([
        { "name": "planks", "primitives": [file.square(4.0, 0)] },
        { "name": "box", "primitives": [file.square(1.0, 1), file.square(0.5, 2)] },
        { "name": "window", "primitives": [file.square(1.0, 3), file.square(0.5, 1)] },
        { "name": "lamp", "primitives": [file.square(0.5, 4)] },
        { "name": "cloth", "primitives": [file.square(1.0, 5)] },
    ]);
    let paint =
        |name: &str, color: [f32; 4]| json!({ "name": name, "pbrMetallicRoughness": { "baseColorFactor": color } });
    let mut materials = [
        paint("Wood", [1.0, 0.5, 0.5, 1.0]),
        paint("Red", [0.6, 0.1, 0.1, 1.0]),
        paint("Blue", [0.1, 0.1, 0.6, 1.0]),
        paint("Glass", [1.0, 1.0, 1.0, 0.0]),
        paint("Glow", [0.5, 0.5, 0.5, 1.0]),
        paint("Cloth", [0.5, 0.5, 0.5, 1.0]),
    ];
    materials[0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": 0 });
    materials[0]["occlusionTexture"] = json!({ "index": 0, "texCoord": 1 });
    materials[3]["alphaMode"] = "BLEND".into();
    materials[4]["emissiveFactor"] = json!([1.0, 0.5, 0.25]);
    materials[5]["doubleSided"] = true.into();
    let turned = [0.0, 0.5_f32.sqrt(), 0.0, 0.5_f32.sqrt()];
    let spot = json!({ "type": "spot", "intensity": 20, "spot": { "innerConeAngle": 0.2, "outerConeAngle": 0.5 } });
    file.bytes(json!({
        "asset": { "version": "2.0", "copyright": "nobody" },
        "scene": 0,
        "scenes": [{ "name": "House", "nodes": [9, 0] }],
        "nodes": [
            { "name": "Floor", "children": [1, 6], "translation": [1, 0, 0], "scale": [2, 1, 1] },
            { "name": "Planks", "mesh": 0, "children": [2, 4] },
            { "name": "Group", "children": [3], "translation": [0, 1, 0], "rotation": turned },
            { "name": "Box", "mesh": 1, "scale": [0.5, 0.5, 0.5], "extras": { "id": "b", "kept": 1 } },
            { "name": "Lamp", "mesh": 3, "translation": [0, 3, 0] , "children": [5] },
            { "name": "Spot", "translation": [1, 1, 1], "extensions": { "KHR_lights_punctual": { "light": 0 } } },
            { "name": "Window", "mesh": 2, "translation": [0, 2, 0] },
            { "name": "Marker" },
            { "name": "Cloth", "mesh": 4, "translation": [0, 4, 0] },
            { "name": "Top", "children": [7, 8, 10] },
            { "name": "Camera", "camera": 0, "translation": [0, 1, 9] },
        ],
        "meshes": meshes,
        "materials": materials,
        "cameras": [{ "type": "perspective", "perspective": { "yfov": 0.75, "znear": 0.1 } }],
        "images": [{ "name": "wood", "bufferView": picture, "mimeType": "image/png" }],
        "samplers": [{ "wrapS": 33648 }],
        "textures": [{ "source": 0, "sampler": 0 }],
        "extensions": { "KHR_lights_punctual": { "lights": [spot] } },
        "extensionsUsed": ["KHR_lights_punctual"],
    }))
}
