//! Materials: what of a glTF material matters to diffuse light.

use std::sync::Arc;

use ::gltf::json;
use glam::{Vec3, Vec4};
use json::validation::Checked;

use super::container::File;
use super::textures::{Texels, Textures};
use super::warnings::Warnings;
use super::{LoadError, LoadLimits, malformed};
use crate::allowed::Allowed;
use crate::scene::{AlphaMode, AlphaUse, Look, Material, TextureUse};

/// A material, what of it varies, and how its emission splits into the two numbers of a light.
#[derive(Clone, Debug)]
pub(super) struct LoadedMaterial {
    /// Index in the file; none for the specification's default.
    pub(super) index: Option<usize>,
    /// Its name; empty where it has none.
    pub(super) name: Arc<str>,
    /// What the engine sees.
    pub(super) material: Material,
    /// Reflects more than the world allows, where no vertex colours take from it.
    pub(super) is_bright: bool,
    /// What varies from place to place; absent where `material` says all.
    pub(super) look: Option<Arc<Look>>,
    /// Emissive factor; zero where nothing is emitted.
    pub(super) emission_color: Vec3,
    /// `KHR_materials_emissive_strength`.
    pub(super) emission_intensity: f32,
    /// All light goes through everywhere: triangles of this material are left out.
    pub(super) is_clear: bool,
    /// Which set of the file's texture coordinates its textures read as their first. Meshes keep two: where no texture
    /// reads TEXCOORD_0, a later set takes its place.
    pub(super) first_set: usize,
}

impl LoadedMaterial {
    /// As warnings name it.
    pub(super) fn place(&self) -> String {
        self.index.map_or("those without a material".to_owned(), |index| place_of(index, &self.name))
    }
}

fn place_of(index: usize, name: &str) -> String {
    format!("material {index} \"{name}\"")
}

/// Materials of a file, read when a primitive first uses them.
#[derive(Debug)]
pub(super) struct Materials<'f> {
    file: &'f File<'f>,
    textures: Textures<'f>,
    pub(super) max_albedo: f32,
    /// Per material: some primitive of it has vertex colours with alpha.
    has_vertex_alpha: Vec<bool>,
    read: Vec<Option<LoadedMaterial>>,
}

/// Albedo of a texture that is not there, linear.
const MID_GREY: f32 = 0.5;
/// Transmission of what shines: paths that meet it by chance have to meet it now and then.
const MOST_BESIDE_EMISSION: f32 = 0.999;
/// How far factors may lie outside 0..=1 by rounding.
const ROUNDING: f32 = 1e-3;

impl LoadedMaterial {
    /// Whether a texture of it reads a set of texture coordinates.
    pub(super) fn uses_texcoord(&self, set: usize) -> bool {
        self.look.iter().flat_map(|look| look.textures()).any(|texture| texture.texcoord == set)
    }

    /// The material where the mesh has only some of its texture coordinates: a texture without them shows its mean all
    /// over. And which of its textures that is.
    pub(super) fn with_texcoords(mut self, has: impl Fn(usize) -> bool) -> (Self, [bool; 4]) {
        let Some(look) = &self.look else { return (self, [false; 4]) };
        let mut look = Look::clone(look);
        let take_unplaced = |texture: &mut Option<TextureUse>| {
            texture.take_if(|texture| !has(texture.texcoord)).map(|texture| texture.texture.mean())
        };
        let (base, emissive) = (take_unplaced(&mut look.base_color), take_unplaced(&mut look.emissive));
        let transmission = take_unplaced(&mut look.transmission_texture);
        let thickness = take_unplaced(&mut look.thickness_texture);
        if let Some(mean) = base {
            look.factor *= mean.color;
            if look.alpha_mode == AlphaMode::Blend {
                look.alpha *= mean.weight;
            }
        }
        if let Some(mean) = emissive {
            look.emission *= mean.color;
            self.material.emission *= mean.color;
            self.emission_color *= mean.color;
        }
        look.transmission *= transmission.map_or(1.0, |mean| mean.color.x);
        look.thickness *= thickness.map_or(1.0, |mean| mean.color.y);
        let unplaced = [base, emissive, transmission, thickness].map(|mean| mean.is_some());
        if unplaced != [false; 4] {
            self.look = look.varies().then(|| Arc::new(look));
        }
        (self, unplaced)
    }
}

impl<'f> Materials<'f> {
    pub(super) fn new(file: &'f File<'f>, limits: &LoadLimits) -> Self {
        Self::with(file, limits, Textures::new(file, limits))
    }

    /// Without decoding a picture: colours that pictures decide are not right, the rest is.
    pub(super) fn undecoded(file: &'f File<'f>, limits: &LoadLimits) -> Self {
        Self::with(file, limits, Textures::undecoded(file, limits))
    }

    fn with(file: &'f File<'f>, limits: &LoadLimits, textures: Textures<'f>) -> Self {
        let read = vec![None; file.root.materials.len()];
        Self { file, textures, max_albedo: limits.max_albedo, has_vertex_alpha: vertex_alpha(&file.root), read }
    }

    /// The material of a primitive; the specification's default (white) where it has none.
    pub(super) fn get(
        &mut self,
        index: Option<json::Index<json::Material>>,
        warnings: &mut Warnings,
    ) -> Result<LoadedMaterial, LoadError> {
        let Some(index) = index else {
            warnings.add("primitives without a material are white", "");
            return Ok(LoadedMaterial {
                index: None,
                name: "".into(),
                material: Material::diffuse(Vec3::ONE),
                is_bright: self.max_albedo < 1.0,
                look: None,
                emission_color: Vec3::ZERO,
                emission_intensity: 1.0,
                is_clear: false,
                first_set: 0,
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
        let place = place_of(index, json.name.as_deref().unwrap_or_default());
        let mut look = self.base(index, json, &place, warnings)?;
        self.read_transmission(json, &mut look, &place, warnings)?;
        let (mut color, mut intensity) = emission(json, &place)?;
        let mut factor = color * intensity;
        // By what the file says, so that it is the same whether pictures are decoded or not.
        let has_picture = json.extensions.as_ref().and_then(|e| e.transmission.as_ref()?.transmission_texture.as_ref());
        let shines = factor != Vec3::ZERO && !look.is_gone();
        let is_clear = look.is_clear() && has_picture.is_none() && !shines;
        if shines {
            look.transmission = look.transmission.min(MOST_BESIDE_EMISSION);
        }
        let mut emissive = None;
        if is_clear {
            warnings.add("materials that let all light through are left out", &place);
            color = Vec3::ZERO;
        } else if let Some(info) = json.emissive_texture.as_ref().filter(|_| color != Vec3::ZERO) {
            emissive = self.textures.get(info, Texels::Colors(AlphaUse::Ignored), "emissive", &place, warnings)?;
            match &emissive {
                Some(texture) if texture.texture.mean().color == Vec3::ZERO => (color, emissive) = (Vec3::ZERO, None),
                Some(_) => {}
                None => (color, factor) = (color * MID_GREY, factor * MID_GREY),
            }
        }
        if Allowed::KEPT.check_product(factor, 1.0).is_err() {
            let most = Allowed::KEPT.brightest;
            return Err(malformed(&place, &format!("its emission is not finite, or above {most:e}")));
        }
        if color == Vec3::ZERO {
            intensity = 1.0;
        }
        let mean = look.base_color.as_ref().map_or(Vec3::ONE, |texture| texture.texture.mean().color);
        let mut look = Look { emission: factor, emissive, ..look };
        let first_set = take_first_set(&mut look);
        if look.textures().any(|texture| texture.texcoord > 1) {
            let text =
                "where a material reads TEXCOORD_0, its textures of sets beyond TEXCOORD_1 count with their mean";
            warnings.add(text, &place);
        }
        let albedo = look.factor * mean;
        let is_bright = albedo.max_element() > self.max_albedo;
        let albedo = albedo.clamp(Vec3::ZERO, Vec3::ONE);
        let look = look.varies().then(|| Arc::new(look));
        let emission = color * intensity;
        let material = Material { albedo, emission, double_sided: json.double_sided };
        let name = json.name.as_deref().unwrap_or_default().into();
        let index = Some(index);
        Ok(LoadedMaterial {
            index,
            name,
            material,
            is_bright,
            look,
            emission_color: color,
            emission_intensity: intensity,
            is_clear,
            first_set,
        })
    }

    /// Base colour and alpha.
    fn base(
        &mut self,
        index: usize,
        json: &json::Material,
        place: &str,
        warnings: &mut Warnings,
    ) -> Result<Look, LoadError> {
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
        if !cutoff.is_finite() {
            return Err(malformed(place, &format!("its alphaCutoff is {cutoff}, it must be a finite number")));
        }
        let (alpha_mode, alpha_use) = match json.alpha_mode {
            Checked::Valid(json::material::AlphaMode::Opaque) => (AlphaMode::Opaque, AlphaUse::Ignored),
            // No alpha is below it.
            Checked::Valid(json::material::AlphaMode::Mask) if cutoff <= 0.0 => (AlphaMode::Opaque, AlphaUse::Ignored),
            Checked::Valid(json::material::AlphaMode::Mask) => {
                // A texel counts where its alpha times the factor is not below the cut-off.
                let of_texel = if factor.w > 0.0 { (cutoff / factor.w).clamp(0.0, 2.0) } else { 2.0 };
                let is_colored = self.has_vertex_alpha[index];
                (AlphaMode::Mask(cutoff), if is_colored { AlphaUse::Blend } else { AlphaUse::Cutoff(of_texel) })
            }
            Checked::Valid(json::material::AlphaMode::Blend) => (AlphaMode::Blend, AlphaUse::Blend),
            Checked::Invalid => return Err(malformed(place, "its alphaMode is unknown")),
        };
        if pbr.metallic_factor.0 > 0.0 && other.is_none() {
            warnings.add("metallic materials are taken as diffuse ones of the same base colour", place);
        }
        let mut look = Look { alpha: factor.w, alpha_mode, ..Look::plain(factor.truncate()) };
        if let Some(info) = info {
            look.base_color = self.textures.get(info, Texels::Colors(alpha_use), "base colour", place, warnings)?;
            match look.base_color {
                Some(_) => warnings.add("base colour textures count with their mean colour over each element", place),
                None => look.factor *= MID_GREY,
            }
        }
        // Written by many exporters for what is opaque all over.
        let is_seen_through = look.base_color.as_ref().is_some_and(|texture| texture.texture.is_transparent());
        let is_full = look.alpha >= 1.0 && !is_seen_through && !self.has_vertex_alpha[index];
        if look.alpha_mode == AlphaMode::Blend && is_full {
            look.alpha_mode = AlphaMode::Opaque;
        }
        Ok(look)
    }

    /// What goes through, and what a volume takes of it.
    fn read_transmission(
        &mut self,
        json: &json::Material,
        look: &mut Look,
        place: &str,
        warnings: &mut Warnings,
    ) -> Result<(), LoadError> {
        let Some(extensions) = &json.extensions else { return Ok(()) };
        let Some(transmission) = &extensions.transmission else { return Ok(()) };
        let within = |value: f32, name: &str, most: f32| {
            let problem = || malformed(place, &format!("its {name} is {value}, it must be within 0 and {most}"));
            if value.is_finite() { Ok(value.clamp(0.0, most)) } else { Err(problem()) }
        };
        let pbr = &json.pbr_metallic_roughness;
        // Metal lets nothing through. Where a texture says what is metal, it is not asked.
        let metallic = if pbr.metallic_roughness_texture.is_none() { pbr.metallic_factor.0 } else { 0.0 };
        look.transmission = within(transmission.transmission_factor.0, "transmissionFactor", 1.0)? * (1.0 - metallic);
        if look.transmission == 0.0 {
            return Ok(());
        }
        warnings.add("transmissive materials (KHR_materials_transmission) let light through without bending it", place);
        if let Some(info) = &transmission.transmission_texture {
            look.transmission_texture = self.textures.get(info, Texels::Numbers, "transmission", place, warnings)?;
        }
        let Some(volume) = &extensions.volume else { return Ok(()) };
        look.thickness = within(volume.thickness_factor.0, "thicknessFactor", f32::MAX)?;
        let distance = volume.attenuation_distance.0;
        let color = Vec3::from_array(volume.attenuation_color.0);
        if !color.is_finite() || distance.is_nan() {
            return Err(malformed(place, "its attenuation is not a number"));
        }
        if distance > 0.0 && distance.is_finite() {
            // Of black some 1e-9 is left.
            look.absorption = -color.clamp(Vec3::splat(1e-9), Vec3::ONE).ln() / distance;
        }
        let takes = look.thickness > 0.0 && look.absorption != Vec3::ZERO;
        if let Some(info) = volume.thickness_texture.as_ref().filter(|_| takes) {
            look.thickness_texture = self.textures.get(info, Texels::Numbers, "thickness", place, warnings)?;
        }
        Ok(())
    }
}

/// Lets the first of the sets beyond the second be the first, where no texture reads that; answers which it is.
fn take_first_set(look: &mut Look) -> usize {
    let sets = || look.textures().map(|texture| texture.texcoord);
    let Some(later) = sets().filter(|set| *set > 1).min().filter(|_| sets().all(|set| set != 0)) else { return 0 };
    let textures = look.textures_mut().filter(|texture| texture.texcoord == later);
    textures.for_each(|texture| texture.texcoord = 0);
    later
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

/// Per material: whether some primitive of it has vertex colours with alpha.
fn vertex_alpha(root: &json::Root) -> Vec<bool> {
    let mut found = vec![false; root.materials.len()];
    for primitive in root.meshes.iter().flat_map(|mesh| &mesh.primitives) {
        let colors = primitive.attributes.get(&Checked::Valid(json::mesh::Semantic::Colors(0)));
        let colors = colors.and_then(|colors| root.get(*colors));
        let has_alpha = colors.is_some_and(|colors| colors.type_ == Checked::Valid(json::accessor::Type::Vec4));
        let material = primitive.material.and_then(|index| found.get_mut(index.value()));
        material.filter(|_| has_alpha).into_iter().for_each(|found| *found = true);
    }
    found
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
