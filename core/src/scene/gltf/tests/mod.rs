//! Tests of the reader: what it accepts, what it refuses, and that it never panics.

mod accepted;
mod compressed;
mod files;
mod fuzz;
mod mended;
mod posed;
mod refused;
mod textured;

use super::{LoadError, LoadLimits};
use crate::scene::Scene;

/// A square with normals and 16-bit indices, a camera, a lamp. Offsets: positions 0, normals 48, indices 96 (6),
/// bytes 108 (8-bit indices 0 1 2), sparse index 112, sparse value 116.
pub(super) const SQUARE: &str = r#"{
  "asset": {"version": "2.0"},
  "extensionsUsed": ["KHR_lights_punctual", "KHR_materials_emissive_strength"],
  "extensions": {"KHR_lights_punctual": {"lights": [
    {"type": "spot", "color": [1, 0.5, 0.25],
     "intensity": 40, "range": 8, "spot": {"innerConeAngle": 0.25, "outerConeAngle": 0.5}}
  ]}},
  "scene": 0,
  "scenes": [{"nodes": [0, 1]}],
  "nodes": [
    {"name": "Wall", "mesh": 0, "translation": [1, 2, 3], "scale": [2, 2, 2]},
    {"name": "Rig", "rotation": [0.7071068, 0, 0, 0.7071068], "children": [2, 3]},
    {"name": "Camera", "camera": 0},
    {"name": "Lamp", "translation": [0, 1, 0], "extensions": {"KHR_lights_punctual": {"light": 0}}}
  ],
  "cameras": [{"type": "perspective", "perspective": {"yfov": 0.75, "znear": 0.1}}],
  "materials": [{
    "name": "Paint", "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 0.125, 1], "metallicFactor": 0},
    "emissiveFactor": [1, 0.5, 0], "doubleSided": true,
    "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 3}}
  }],
  "meshes": [{"name": "Square", "primitives": [
    {"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2, "material": 0, "mode": 4}
  ]}],
  "accessors": [
    {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
    {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC3"},
    {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"}
  ],
  "bufferViews": [
    {"buffer": 0, "byteOffset": 0, "byteLength": 48},
    {"buffer": 0, "byteOffset": 48, "byteLength": 48},
    {"buffer": 0, "byteOffset": 96, "byteLength": 12},
    {"buffer": 0, "byteOffset": 108, "byteLength": 4},
    {"buffer": 0, "byteOffset": 112, "byteLength": 16}
  ],
  "buffers": [{"byteLength": 128}]
}"#;

/// The data of [`SQUARE`].
pub(super) fn square_data() -> Vec<u8> {
    let mut bin = Vec::new();
    let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0_f32]];
    bin.extend(positions.iter().flatten().flat_map(|value| value.to_le_bytes()));
    bin.extend([[0.0, 0.0, 1.0_f32]; 4].iter().flatten().flat_map(|value| value.to_le_bytes()));
    bin.extend([0_u16, 1, 2, 0, 2, 3].iter().flat_map(|value| value.to_le_bytes()));
    bin.extend([0_u8, 1, 2, 0]);
    bin.extend(2_u32.to_le_bytes());
    bin.extend([3.0_f32, 3.0, 0.0].iter().flat_map(|value| value.to_le_bytes()));
    bin
}

/// Puts a file together.
pub(super) fn glb(json: &str, bin: &[u8]) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut file = b"glTF".to_vec();
    file.extend(2_u32.to_le_bytes());
    file.extend((28 + json.len() as u32 + bin.len() as u32).to_le_bytes());
    file.extend((json.len() as u32).to_le_bytes());
    file.extend(b"JSON");
    file.extend(json);
    file.extend((bin.len() as u32).to_le_bytes());
    file.extend(b"BIN\0");
    file.extend(bin);
    file
}

/// [`SQUARE`] with some texts replaced; each must occur.
fn edited(replacements: &[(&str, &str)]) -> Vec<u8> {
    let mut json = SQUARE.to_owned();
    for (from, to) in replacements {
        assert!(json.contains(from), "{from}");
        json = json.replace(from, to);
    }
    glb(&json, &square_data())
}

fn load(bytes: &[u8]) -> Result<Scene, LoadError> {
    super::load(bytes, &LoadLimits::default())
}
