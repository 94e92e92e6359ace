//! Which glTF extensions a file may require, and what is said of those that are ignored.

use super::container::File;
use super::warnings::Warnings;
use super::{LoadError, malformed};

/// Read, or taken into account in some way that has a warning of its own.
const READ: &[&str] = &[
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_draco_mesh_compression",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_node_visibility",
    "KHR_texture_basisu",
    "KHR_texture_transform",
];

/// Formats of textures that are not read: refused where a texture that counts has no other, see `textures`.
const TEXTURES: &[&str] = &["EXT_texture_avif", "MSFT_texture_dds"];

/// Without effect on diffuse light: accepted even where required.
const HARMLESS: &[&str] = &[
    "AGI_articulations",
    "EXT_mesh_features",
    "EXT_mesh_manifold",
    "EXT_structural_metadata",
    "KHR_animation_pointer",
    "KHR_audio_emitter",
    "KHR_interactivity",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_dispersion",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_variants",
    "KHR_node_hoverability",
    "KHR_node_selectability",
    "KHR_physics_rigid_bodies",
    "KHR_implicit_shapes",
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "MSFT_lod",
    "MSFT_packing_normalRoughnessMetallic",
    "MSFT_packing_occlusionRoughnessMetallic",
];

/// Refuses required extensions that would change the geometry or the materials, remarks on ignored ones.
pub(super) fn check(file: &File<'_>, warnings: &mut Warnings) -> Result<(), LoadError> {
    let root = &file.root;
    let is_any = |name: &str, lists: &[&[&str]]| lists.iter().any(|list| list.contains(&name));
    for name in &root.extensions_required {
        if !is_any(name, &[READ, TEXTURES, HARMLESS]) {
            return Err(LoadError::Unsupported(format!(
                "the file requires the extension {}, which is not supported",
                shorten(name)
            )));
        }
    }
    if root.extensions_used.len() > 1000 {
        return Err(malformed("extensionsUsed", "has more than 1000 entries"));
    }
    for name in root.extensions_used.iter().filter(|name| !is_any(name, &[READ, TEXTURES])) {
        let text = if is_any(name, &[HARMLESS]) {
            "extensions without effect on the light map are ignored"
        } else {
            "extensions that are not known are ignored, whatever effect they have"
        };
        warnings.add(text, shorten(name));
    }
    if root.extensions_used.iter().any(|name| name == "KHR_materials_unlit") {
        warnings.add("unlit materials (KHR_materials_unlit) are taken as diffuse ones of the same base colour", "");
    }
    if file.has_animations {
        warnings.add("animations are ignored: nodes stand where the file puts them", "");
    }
    Ok(())
}

fn shorten(name: &str) -> String {
    name.chars().take(64).collect()
}
