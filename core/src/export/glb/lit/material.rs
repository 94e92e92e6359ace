//! Materials as they are after edits, with their light map.

use ::gltf::json::Value;
use glam::{Vec3, Vec4};
use serde_json::Map;

use super::super::container::{numbers, object};
use super::super::emission_parts;
use super::super::scene::light_parts;
use crate::scene::{Light, Look, Object};

/// Albedo of a texture that could not be read, linear: what light took for it.
const MID_GREY: f32 = 0.5;

/// A material of an object.
pub(super) struct Surface<'a> {
    pub(super) item: &'a Object,
    pub(super) slot: usize,
    /// What shines where it does.
    pub(super) light: Option<&'a Light>,
    /// Mid grey stood for its base colour texture.
    pub(super) is_unread: bool,
    /// It is drawn from its own side alone, whatever it says.
    pub(super) is_apart: bool,
}

/// How its light is shown.
pub(super) enum Shown<'a> {
    /// By vertex colours; `true`: and by nothing else.
    Colors(bool),
    /// By a page of the atlas.
    Page {
        /// The light map, as `MOZ_lightmap` has it.
        light_map: &'a Value,
        /// Its texture, and what 1 there stands for, where the material shall shine by it.
        shines: Option<(&'a Value, f32)>,
    },
}

impl Surface<'_> {
    fn look(&self) -> Option<&Look> {
        self.item.looks.get(self.slot).and_then(Option::as_deref)
    }

    /// What is known without a file.
    pub(super) fn untold(&self) -> Map<String, Value> {
        let Some(material) = self.item.materials.get(self.slot) else { return Map::new() };
        let (Vec3 { x, y, z }, opacity) = (material.albedo, self.item.mean_opacity(self.slot));
        let factor = numbers([x, y, z, opacity]);
        let pbr = [("baseColorFactor", factor), ("metallicFactor", 0.into()), ("roughnessFactor", 1.into())];
        let mut json = vec![("pbrMetallicRoughness", object(pbr))];
        let name = self.item.material_names.get(self.slot).filter(|name| !name.is_empty());
        json.extend(name.map(|name| ("name", (&**name).into())));
        json.extend((opacity < 1.0).then(|| ("alphaMode", "BLEND".into())));
        json.extend(material.double_sided.then(|| ("doubleSided", true.into())));
        let mut json = json.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
        if let Some(light) = self.light {
            let mean = self.item.mean_emission(self.slot);
            set_emission(&mut json, light_parts(light.color * mean, light.intensity));
        }
        json
    }

    /// The file's material as edits have left it.
    pub(super) fn edited(&self, mut json: Map<String, Value>) -> Map<String, Value> {
        self.paint(&mut json);
        let at_upload = self.item.materials.get(self.slot).map_or(Vec3::ZERO, |material| material.emission);
        match self.light {
            Some(light) if light.strength() == at_upload => {}
            Some(light) => {
                if self.look().is_none_or(|look| look.emissive.is_none()) {
                    json.remove("emissiveTexture");
                }
                set_emission(&mut json, light_parts(light.color, light.intensity));
            }
            None if at_upload == Vec3::ZERO => {}
            None => {
                json.remove("emissiveTexture");
                set_emission(&mut json, (Vec3::ZERO, 1.0));
            }
        }
        json
    }

    /// Gives it the albedo that light meets, where an edit has changed it.
    fn paint(&self, json: &mut Map<String, Value>) {
        let Some(albedo) = self.item.materials.get(self.slot).map(|material| material.albedo) else { return };
        let other = json.get_mut("extensions").and_then(|e| e.get_mut("KHR_materials_pbrSpecularGlossiness"));
        let (base, keys) = match other.and_then(Value::as_object_mut) {
            Some(other) => (other, ["diffuseFactor", "diffuseTexture"]),
            None => (entry(json, "pbrMetallicRoughness"), ["baseColorFactor", "baseColorTexture"]),
        };
        let [factor_key, texture_key] = keys;
        let factor = base.get(factor_key).and_then(vec4).unwrap_or(Vec4::ONE);
        let mean = self.look().and_then(|look| look.base_color.as_ref()).map(|texture| texture.texture.mean().color);
        let has_texture = base.contains_key(texture_key);
        let at_upload = match self.look() {
            Some(look) if has_texture => (!look.is_painted).then(|| look.factor * mean.unwrap_or(Vec3::ONE)),
            None if has_texture => self.is_unread.then(|| factor.truncate() * MID_GREY),
            _ => Some(factor.truncate()),
        };
        if at_upload.is_some_and(|color| color.clamp(Vec3::ZERO, Vec3::ONE) == albedo) {
            // What lies outside by rounding was mended when it was read; an edit may have tinted the texture.
            let tinted = self.look().filter(|look| look.base_color.is_some()).map(|look| look.factor.extend(factor.w));
            let kept = tinted.unwrap_or(factor).clamp(Vec4::ZERO, Vec4::ONE);
            if kept != factor {
                base.insert(factor_key.to_owned(), numbers(kept.to_array()));
            }
            json.retain(|_, value| !value.as_object().is_some_and(Map::is_empty));
            return;
        }
        // A texture that also tells what light goes through stays: its mean becomes the albedo.
        let kept = mean.filter(|_| has_texture && self.look().is_some_and(Look::may_let_light_through));
        if kept.is_none() {
            base.remove(texture_key);
        }
        let color = kept.map_or(albedo, |mean| (albedo / mean.max(Vec3::splat(1e-3))).min(Vec3::ONE));
        base.insert(factor_key.to_owned(), numbers(color.extend(factor.w.clamp(0.0, 1.0)).to_array()));
    }

    /// Adds its light.
    pub(super) fn lit(&self, mut json: Map<String, Value>, shown: &Shown<'_>) -> Value {
        if self.is_apart {
            json.remove("doubleSided");
        }
        match shown {
            Shown::Colors(is_alone) => {
                let extensions = json.get("extensions");
                let has = |name: &str| extensions.is_some_and(|e| e.get(name).is_some());
                // What shines by itself is not seen on an unlit material, and neither is what lies behind.
                if *is_alone && self.light.is_none() && !has("KHR_materials_transmission") {
                    let unlit = object([("KHR_materials_unlit", object([]))]);
                    json.insert("extensions".to_owned(), unlit);
                }
            }
            Shown::Page { light_map, shines } => {
                entry(&mut json, "extensions").insert("MOZ_lightmap".to_owned(), (*light_map).clone());
                if let Some((texture, gain)) = shines.filter(|_| self.light.is_none()) {
                    let albedo = self.item.materials.get(self.slot).map_or(Vec3::ZERO, |material| material.albedo);
                    set_emission(&mut json, emission_parts(albedo * gain));
                    let texture = object([("index", texture.clone()), ("texCoord", 1.into())]);
                    json.insert("emissiveTexture".to_owned(), texture);
                }
            }
        }
        json.into()
    }
}

fn set_emission(json: &mut Map<String, Value>, (color, strength): (Vec3, f32)) {
    json.insert("emissiveFactor".to_owned(), numbers(color.to_array()));
    let extensions = entry(json, "extensions");
    match strength == 1.0 {
        true => extensions.remove("KHR_materials_emissive_strength"),
        false => {
            let extension = object([("emissiveStrength", strength.into())]);
            extensions.insert("KHR_materials_emissive_strength".to_owned(), extension)
        }
    };
    if extensions.is_empty() {
        json.remove("extensions");
    }
}

/// An object in an object, made where it is missing.
fn entry<'j>(json: &'j mut Map<String, Value>, key: &str) -> &'j mut Map<String, Value> {
    let value = json.entry(key.to_owned()).or_insert_with(|| Value::Object(Map::new()));
    if !value.is_object() {
        *value = Value::Object(Map::new());
    }
    let Value::Object(map) = value else { unreachable!("it was made one") };
    map
}

fn vec4(value: &Value) -> Option<Vec4> {
    let part = |k: usize| Some(value.get(k)?.as_f64()? as f32);
    Some(Vec4::new(part(0)?, part(1)?, part(2)?, part(3)?))
}
