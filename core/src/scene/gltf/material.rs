//! Materials: what of a glTF material matters to diffuse light.

use ::gltf::json;
use glam::Vec3;
use json::material::AlphaMode;
use json::validation::Checked;

use super::container::File;
use super::image_mean::TextureMeans;
use super::warnings::Warnings;
use super::{LoadError, LoadLimits, malformed};
use crate::scene::Material;

/// A material and how its emission splits into the two numbers of a light.
#[derive(Clone, Copy, Debug)]
pub(super) struct LoadedMaterial {
    /// What the engine sees.
    pub(super) material: Material,
    /// Emissive factor (times the mean of the emissive texture); zero where nothing is emitted.
    pub(super) emission_color: Vec3,
    /// `KHR_materials_emissive_strength`.
    pub(super) emission_intensity: f32,
    /// Transparent: triangles of this material neither block nor reflect and are left out.
    pub(super) is_transparent: bool,
}

/// Materials of a file, read when a primitive first uses them.
#[derive(Debug)]
pub(super) struct Materials<'f> {
    file: &'f File<'f>,
    textures: TextureMeans<'f>,
    read: Vec<Option<LoadedMaterial>>,
}

impl<'f> Materials<'f> {
    pub(super) fn new(file: &'f File<'f>, limits: &LoadLimits) -> Self {
        let textures = TextureMeans::new(file, limits);
        Self { file, textures, read: vec![None; file.root.materials.len()] }
    }

    /// The material of a primitive; the specification's default (white) where it has none.
    pub(super) fn get(
        &mut self,
        index: Option<json::Index<json::Material>>,
        warnings: &mut Warnings,
    ) -> Result<LoadedMaterial, LoadError> {
        let Some(index) = index else {
            let material = Material { albedo: Vec3::ONE, emission: Vec3::ZERO, double_sided: false };
            warnings.add("primitives without a material are white", "");
            return Ok(LoadedMaterial {
                material,
                emission_color: Vec3::ZERO,
                emission_intensity: 1.0,
                is_transparent: false,
            });
        };
        let index = index.value();
        if let Some(known) = self.read.get(index).copied().flatten() {
            return Ok(known);
        }
        let loaded = self.read_one(index, warnings)?;
        self.read[index] = Some(loaded);
        Ok(loaded)
    }

    fn read_one(&mut self, index: usize, warnings: &mut Warnings) -> Result<LoadedMaterial, LoadError> {
        let missing = || malformed(&format!("material {index}"), "does not exist");
        let json = self.file.root.materials.get(index).ok_or_else(missing)?;
        let place = format!("material {index} \"{}\"", json.name.as_deref().unwrap_or_default());
        let pbr = &json.pbr_metallic_roughness;
        let alpha_mode = match json.alpha_mode {
            Checked::Valid(mode) => mode,
            Checked::Invalid => return Err(malformed(&place, "its alphaMode is unknown")),
        };
        let is_transparent = alpha_mode == AlphaMode::Blend;
        match alpha_mode {
            AlphaMode::Opaque => {}
            AlphaMode::Mask => warnings.add("masked materials (alphaMode MASK) are taken as opaque", &place),
            AlphaMode::Blend => {
                warnings.add("transparent materials (alphaMode BLEND) neither block nor reflect light", &place);
            }
        }
        if pbr.metallic_factor.0 > 0.0 && !is_transparent {
            warnings.add("metallic materials are taken as diffuse ones of the same base colour", &place);
        }
        let [r, g, b, _] = pbr.base_color_factor.0;
        let mut albedo = Vec3::new(r, g, b);
        if !(albedo.min_element() >= 0.0 && albedo.max_element() <= 1.0 && albedo.is_finite()) {
            return Err(malformed(
                &place,
                &format!("its baseColorFactor is {albedo}, each part must be within 0 and 1"),
            ));
        }
        let (mut color, intensity) = emission(json, &place)?;
        if is_transparent {
            color = Vec3::ZERO;
        } else {
            if let Some(texture) = &pbr.base_color_texture {
                albedo *= self.textures.mean(texture, &place, "base colour", warnings)?;
            }
            if let Some(texture) = json.emissive_texture.as_ref().filter(|_| color != Vec3::ZERO) {
                color *= self.textures.mean(texture, &place, "emissive", warnings)?;
            }
        }
        let material = Material { albedo, emission: color * intensity, double_sided: json.double_sided };
        if !material.emission.is_finite() {
            return Err(malformed(&place, "its emission is not finite"));
        }
        Ok(LoadedMaterial { material, emission_color: color, emission_intensity: intensity, is_transparent })
    }
}

/// Emissive factor and strength.
fn emission(json: &json::Material, place: &str) -> Result<(Vec3, f32), LoadError> {
    let color = Vec3::from_array(json.emissive_factor.0);
    if !color.is_finite() || color.min_element() < 0.0 {
        return Err(malformed(place, &format!("its emissiveFactor is {color}, each part must be 0 or more")));
    }
    let extension = json.extensions.as_ref().and_then(|e| e.emissive_strength.as_ref());
    let intensity = extension.map_or(1.0, |e| e.emissive_strength.0);
    if !intensity.is_finite() || intensity < 0.0 {
        return Err(malformed(place, &format!("its emissiveStrength is {intensity}, it must be 0 or more")));
    }
    Ok((color, intensity))
}
