//! Materials: what of a glTF material matters to diffuse light.

use std::sync::Arc;

use ::gltf::json;
use glam::{Vec3, Vec4};
use json::validation::Checked;

use super::container::File;
use super::textures::Textures;
use super::warnings::Warnings;
use super::{LoadError, LoadLimits, malformed};
use crate::scene::{AlphaMode, AlphaUse, Look, Material, TextureUse};

/// A material, what of it varies, and how its emission splits into the two numbers of a light.
#[derive(Clone, Debug)]
pub(super) struct LoadedMaterial {
    /// Its name; empty where it has none.
    pub(super) name: Arc<str>,
    /// What the engine sees.
    pub(super) material: Material,
    /// What varies from place to place; absent where `material` says all.
    pub(super) look: Option<Arc<Look>>,
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
    textures: Textures<'f>,
    max_albedo: f32,
    read: Vec<Option<LoadedMaterial>>,
}

/// Albedo of a texture that is not there, linear.
const MID_GREY: f32 = 0.5;
/// How far factors may lie outside 0..=1 by rounding.
const ROUNDING: f32 = 1e-3;
/// Largest strength of a light: as edits have it.
const MAX_STRENGTH: f32 = 1e12;
/// Transmission from which on a surface counts as not there.
const CLEAR: f32 = 0.5;

impl LoadedMaterial {
    /// Whether a texture of it reads a set of texture coordinates.
    pub(super) fn uses_texcoord(&self, set: usize) -> bool {
        let textures = self.look.iter().flat_map(|look| [&look.base_color, &look.emissive]);
        textures.flatten().any(|texture| texture.texcoord == set)
    }
}

impl<'f> Materials<'f> {
    pub(super) fn new(file: &'f File<'f>, limits: &LoadLimits) -> Self {
        let textures = Textures::new(file, limits);
        Self { file, textures, max_albedo: limits.max_albedo, read: vec![None; file.root.materials.len()] }
    }

    /// The material of a primitive; the specification's default (white) where it has none.
    pub(super) fn get(
        &mut self,
        index: Option<json::Index<json::Material>>,
        warnings: &mut Warnings,
    ) -> Result<LoadedMaterial, LoadError> {
        let Some(index) = index else {
            warnings.add("primitives without a material are white", "");
            let (albedo, look) = self.capped(Vec3::ONE, None, "those without a material", warnings);
            return Ok(LoadedMaterial {
                name: "".into(),
                material: Material::diffuse(albedo),
                look,
                emission_color: Vec3::ZERO,
                emission_intensity: 1.0,
                is_transparent: false,
            });
        };
        let index = index.value();
        if let Some(known) = self.read.get(index).and_then(Option::as_ref) {
            return Ok(known.clone());
        }
        let loaded = self.read_one(index, warnings)?;
        self.read[index] = Some(loaded.clone());
        Ok(loaded)
    }

    fn read_one(&mut self, index: usize, warnings: &mut Warnings) -> Result<LoadedMaterial, LoadError> {
        let missing = || malformed(&format!("material {index}"), "does not exist");
        let json = self.file.root.materials.get(index).ok_or_else(missing)?;
        let place = format!("material {index} \"{}\"", json.name.as_deref().unwrap_or_default());
        let base = self.base(json, &place, warnings)?;
        let transmission = transmission(json, &place)?;
        let (mut color, mut intensity) = emission(json, &place)?;
        let mut factor = color * intensity;
        let is_clear = base.is_transparent() || transmission >= CLEAR;
        let mut emissive = None;
        if is_clear {
            let text = match base.alpha_mode {
                AlphaMode::Blend => "transparent materials (alphaMode BLEND) neither block nor reflect light",
                _ => "transmissive materials (KHR_materials_transmission) let all light through",
            };
            warnings.add(text, &place);
            color = Vec3::ZERO;
        } else if let Some(info) = json.emissive_texture.as_ref().filter(|_| color != Vec3::ZERO) {
            emissive = self.textures.get(info, AlphaUse::Ignored, "emissive", &place, warnings)?;
            match &emissive {
                Some(texture) => {
                    color *= texture.texture.mean().color;
                    warnings.add("emissive textures count with their mean colour", &place);
                }
                None => (color, factor) = (color * MID_GREY, factor * MID_GREY),
            }
        }
        if !factor.is_finite() || factor.max_element() > MAX_STRENGTH {
            return Err(malformed(&place, &format!("its emission is not finite, or above {MAX_STRENGTH:e}")));
        }
        if color == Vec3::ZERO {
            intensity = 1.0;
        }
        let mean = base.texture.as_ref().map_or(base.missing, |texture| texture.texture.mean().color);
        let by_place = Look {
            factor: base.factor * base.missing,
            alpha: base.alpha,
            alpha_mode: base.alpha_mode,
            base_color: base.texture,
            emission: factor,
            emissive,
            transmission,
        };
        let (albedo, look) = self.capped(base.factor * mean, Some(by_place), &place, warnings);
        let emission = color * intensity;
        let material = Material { albedo, emission, double_sided: json.double_sided };
        Ok(LoadedMaterial {
            name: json.name.as_deref().unwrap_or_default().into(),
            material,
            look,
            emission_color: color,
            emission_intensity: intensity,
            is_transparent: is_clear,
        })
    }

    /// Base colour and alpha.
    fn base(&mut self, json: &json::Material, place: &str, warnings: &mut Warnings) -> Result<Base, LoadError> {
        let pbr = &json.pbr_metallic_roughness;
        let other = json.extensions.as_ref().and_then(|e| e.pbr_specular_glossiness.as_ref());
        let (factor, info) = match other {
            Some(other) => (other.diffuse_factor.0, other.diffuse_texture.as_ref()),
            None => (pbr.base_color_factor.0, pbr.base_color_texture.as_ref()),
        };
        if other.is_some() {
            let text = "of materials with specular and glossiness (KHR_materials_pbrSpecularGlossiness) the diffuse part counts";
            warnings.add(text, place);
        }
        let factor = within_bounds(Vec4::from_array(factor), place, warnings)?;
        let cutoff = json.alpha_cutoff.map_or(0.5, |cutoff| cutoff.0);
        let (alpha_mode, alpha_use) = match json.alpha_mode {
            Checked::Valid(json::material::AlphaMode::Opaque) => (AlphaMode::Opaque, AlphaUse::Ignored),
            Checked::Valid(json::material::AlphaMode::Mask) => {
                // A texel counts where its alpha times the factor is not below the cut-off.
                let of_texel = if factor.w > 0.0 { (cutoff / factor.w).clamp(0.0, 2.0) } else { 2.0 };
                (AlphaMode::Mask(cutoff), AlphaUse::Cutoff(of_texel))
            }
            Checked::Valid(json::material::AlphaMode::Blend) => (AlphaMode::Blend, AlphaUse::Blend),
            Checked::Invalid => return Err(malformed(place, "its alphaMode is unknown")),
        };
        if matches!(alpha_mode, AlphaMode::Mask(_)) {
            warnings.add("masked materials (alphaMode MASK) are taken as opaque", place);
        }
        if pbr.metallic_factor.0 > 0.0 && other.is_none() {
            warnings.add("metallic materials are taken as diffuse ones of the same base colour", place);
        }
        let mut base =
            Base { factor: factor.truncate(), alpha: factor.w, alpha_mode, texture: None, missing: Vec3::ONE };
        if let Some(info) = info {
            base.texture = self.textures.get(info, alpha_use, "base colour", place, warnings)?;
            match base.texture {
                Some(_) => warnings.add("base colour textures count with their mean colour", place),
                None => base.missing = Vec3::splat(MID_GREY),
            }
        }
        // Written by many exporters for what is opaque all over.
        let is_seen_through = base.texture.as_ref().is_some_and(|texture| texture.texture.is_transparent());
        if base.alpha_mode == AlphaMode::Blend && base.alpha >= 1.0 && !is_seen_through {
            base.alpha_mode = AlphaMode::Opaque;
        }
        Ok(base)
    }

    /// The albedo within bounds, and the look where it says more than the albedo.
    fn capped(
        &self,
        albedo: Vec3,
        look: Option<Look>,
        place: &str,
        warnings: &mut Warnings,
    ) -> (Vec3, Option<Arc<Look>>) {
        let albedo = albedo.clamp(Vec3::ZERO, Vec3::ONE);
        let is_capped = albedo.max_element() > self.max_albedo;
        if is_capped {
            let text = format!(
                "an albedo above {} is taken as that, since light in a closed room would have no end (max_albedo says otherwise)",
                self.max_albedo
            );
            warnings.add(text, place);
        }
        let look = look.unwrap_or_else(|| Look::plain(albedo));
        let says_more = is_capped || look.varies();
        (albedo.min(Vec3::splat(self.max_albedo)), says_more.then(|| Arc::new(look)))
    }
}

/// Base colour of a material.
struct Base {
    factor: Vec3,
    alpha: f32,
    alpha_mode: AlphaMode,
    texture: Option<TextureUse>,
    /// Stands for a texture that is not there; else 1.
    missing: Vec3,
}

impl Base {
    /// Taken as not there.
    fn is_transparent(&self) -> bool {
        self.alpha_mode == AlphaMode::Blend
    }
}

/// Factors within 0..=1; what lies outside by rounding is mended.
fn within_bounds(factor: Vec4, place: &str, warnings: &mut Warnings) -> Result<Vec4, LoadError> {
    let mended = factor.clamp(Vec4::ZERO, Vec4::ONE);
    if !factor.is_finite() || (factor - mended).abs().max_element() > ROUNDING {
        return Err(malformed(place, &format!("its baseColorFactor is {factor}, each part must be within 0 and 1")));
    }
    if mended != factor {
        warnings.add("factors just outside 0 to 1 are taken as the nearest within", place);
    }
    Ok(mended)
}

fn transmission(json: &json::Material, place: &str) -> Result<f32, LoadError> {
    let extension = json.extensions.as_ref().and_then(|extensions| extensions.transmission.as_ref());
    let factor = extension.map_or(0.0, |transmission| transmission.transmission_factor.0);
    if factor.is_finite() {
        return Ok(factor.clamp(0.0, 1.0));
    }
    Err(malformed(place, &format!("its transmissionFactor is {factor}, it must be within 0 and 1")))
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
