//! Which glTF extensions a file may require, and what is said of those that are ignored.

use ::gltf::json;

use super::warnings::Warnings;
use super::{LoadError, malformed};

/// Fully read.
const READ: &[&str] = &["KHR_lights_punctual", "KHR_materials_emissive_strength", "KHR_mesh_quantization"];

/// Without effect on diffuse light, or on the mean of a texture: accepted even where required.
const HARMLESS: &[&str] = &[
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_dispersion",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_texture_transform",
    "KHR_xmp_json_ld",
];

/// Refuses required extensions that would change the geometry or the materials, remarks on ignored ones.
pub(super) fn check(root: &json::Root, warnings: &mut Warnings) -> Result<(), LoadError> {
    for name in &root.extensions_required {
        if !READ.contains(&name.as_str()) && !HARMLESS.contains(&name.as_str()) {
            return Err(LoadError::Unsupported(format!(
                "the file requires the extension {}, which is not supported",
                shorten(name)
            )));
        }
    }
    if root.extensions_used.len() > 1000 {
        return Err(malformed("extensionsUsed", "has more than 1000 entries"));
    }
    for name in root.extensions_used.iter().filter(|name| !READ.contains(&name.as_str())) {
        warnings.add("extensions without effect on the light map are ignored", shorten(name));
    }
    if !root.animations.is_empty() {
        warnings.add("animations are ignored: nodes stand where the file puts them", "");
    }
    Ok(())
}

fn shorten(name: &str) -> String {
    name.chars().take(64).collect()
}
