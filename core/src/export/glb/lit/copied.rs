//! Materials of a file with the textures that they use, as they are: pictures are copied and not decoded.

use std::collections::BTreeMap;

use ::gltf::json::Value;
use serde_json::Map;

use super::super::container::{Document, push};
use crate::scene::Original;

/// What was copied so far, by file and index there.
#[derive(Default)]
pub(super) struct Copies {
    textures: BTreeMap<(usize, usize), Option<Value>>,
    images: BTreeMap<(usize, usize), Option<Value>>,
    samplers: BTreeMap<(usize, usize), Option<Value>>,
}

/// How a primitive has the two sets of texture coordinates of its file.
#[derive(Clone, Copy)]
pub(super) struct Sets {
    pub(super) has: [bool; 2],
    /// Number of the second in what is written.
    pub(super) second: u64,
}

/// Whether a material of a file reads the second set of texture coordinates.
pub(super) fn reads_second(json: &Value) -> bool {
    let Value::Object(entries) = json else { return false };
    entries.iter().any(|(key, value)| (is_reference(key, value) && texcoord(value) == 1) || reads_second(value))
}

/// Whether light could not read the base colour texture of a material: mid grey stood for it.
pub(super) fn has_unread_texture(file: &Original, index: usize) -> bool {
    let material = file.lists.materials.get(index);
    let base = material.and_then(|material| {
        let other = material.get("extensions").and_then(|e| e.get("KHR_materials_pbrSpecularGlossiness"));
        other.map_or_else(|| material.get("pbrMetallicRoughness")?.get("baseColorTexture"), |o| o.get("diffuseTexture"))
    });
    let texture = base.and_then(|base| file.lists.textures.get(base.get("index")?.as_u64()? as usize));
    let webp = |texture: &Value| texture.get("extensions")?.get("EXT_texture_webp")?.get("source").cloned();
    let source = texture.and_then(|texture| webp(texture).or_else(|| texture.get("source").cloned()));
    let image = source.and_then(|source| file.images.get(source.as_u64()? as usize)?.as_ref());
    let is_read = image.is_some_and(|(_, media_type)| ["image/png", "image/jpeg", "image/webp"].contains(media_type));
    base.is_some() && !is_read
}

impl Copies {
    /// A material of a file that refers to copies of its textures. Those that are not there, or that the primitive has
    /// no place on, are left out; so are extensions that are no look.
    pub(super) fn material(
        &mut self,
        document: &mut Document,
        file: &Original,
        index: usize,
        sets: Sets,
    ) -> Map<String, Value> {
        let json = file.lists.materials.get(index).and_then(Value::as_object);
        let mut json = json.cloned().unwrap_or_default();
        keep_extensions(&mut json, |name| name.starts_with("KHR_materials_") || name.starts_with("EXT_materials_"));
        self.refer(document, file, &mut json, sets);
        json
    }

    fn refer(&mut self, document: &mut Document, file: &Original, json: &mut Map<String, Value>, sets: Sets) {
        json.retain(|key, value| {
            if key == "extras" {
                return true;
            }
            if !is_reference(key, value) {
                value.as_object_mut().into_iter().for_each(|below| self.refer(document, file, below, sets));
                return true;
            }
            let set = texcoord(value);
            let Value::Object(reference) = value else { return true };
            let index = reference.get("index").and_then(Value::as_u64).unwrap_or(u64::MAX);
            if set > 1 || !sets.has[set as usize] {
                return false;
            }
            let Some(texture) = self.texture(document, file, index as usize) else { return false };
            reference.insert("index".to_owned(), texture);
            keep_extensions(reference, |name| name == "KHR_texture_transform");
            place_in(reference, if set == 1 { sets.second } else { 0 });
            true
        });
    }

    fn texture(&mut self, document: &mut Document, file: &Original, index: usize) -> Option<Value> {
        let key = (std::ptr::from_ref(file) as usize, index);
        if let Some(known) = self.textures.get(&key) {
            return known.clone();
        }
        let copied = self.copy_texture(document, file, index);
        self.textures.insert(key, copied.clone());
        copied
    }

    fn copy_texture(&mut self, document: &mut Document, file: &Original, index: usize) -> Option<Value> {
        let mut json = file.lists.textures.get(index)?.as_object()?.clone();
        let own = self.image_of(document, file, json.remove("source").as_ref());
        let mut has_picture = own.is_some();
        json.extend(own.map(|image| ("source".to_owned(), image)));
        if let Some(Value::Object(mut extensions)) = json.remove("extensions") {
            // Pictures in formats that the core specification does not have.
            extensions.retain(|_, extension| {
                let image = self.image_of(document, file, extension.get("source"));
                image.is_some_and(|image| {
                    extension.as_object_mut().is_some_and(|e| e.insert("source".to_owned(), image).is_some())
                })
            });
            has_picture |= !extensions.is_empty();
            json.extend((!extensions.is_empty()).then(|| ("extensions".to_owned(), extensions.into())));
        }
        let sampler =
            json.remove("sampler").and_then(|sampler| self.sampler(document, file, sampler.as_u64()? as usize));
        json.extend(sampler.map(|sampler| ("sampler".to_owned(), sampler)));
        has_picture.then(|| push(&mut document.textures, json.into()))
    }

    fn image_of(&mut self, document: &mut Document, file: &Original, source: Option<&Value>) -> Option<Value> {
        let index = source?.as_u64()? as usize;
        let (bytes, media_type) = file.images.get(index)?.as_ref()?;
        let name = file.lists.images.get(index).and_then(|image| image.get("name")?.as_str());
        let key = (std::ptr::from_ref(file) as usize, index);
        let add = || Some(document.add_image(name, media_type, bytes));
        self.images.entry(key).or_insert_with(add).clone()
    }

    fn sampler(&mut self, document: &mut Document, file: &Original, index: usize) -> Option<Value> {
        let json = file.lists.samplers.get(index)?.clone();
        let key = (std::ptr::from_ref(file) as usize, index);
        self.samplers.entry(key).or_insert_with(|| Some(push(&mut document.samplers, json))).clone()
    }
}

/// Whether an entry of a material refers to a texture, as all of the core specification and of its extensions do.
fn is_reference(key: &str, value: &Value) -> bool {
    key.ends_with("Texture") && value.get("index").is_some_and(Value::is_u64)
}

/// The set that a reference reads.
fn texcoord(reference: &Value) -> u64 {
    let of = |value: &Value| value.get("texCoord").and_then(Value::as_u64);
    let transform = reference.get("extensions").and_then(|extensions| extensions.get("KHR_texture_transform"));
    transform.and_then(of).or(of(reference)).unwrap_or(0)
}

/// Has a reference read another set.
fn place_in(reference: &mut Map<String, Value>, set: u64) {
    let transform = reference.get_mut("extensions").and_then(|extensions| extensions.get_mut("KHR_texture_transform"));
    transform.and_then(Value::as_object_mut).map(|transform| transform.remove("texCoord"));
    reference.remove("texCoord");
    if set > 0 {
        reference.insert("texCoord".to_owned(), set.into());
    }
}

fn keep_extensions(json: &mut Map<String, Value>, is_kept: impl Fn(&str) -> bool) {
    if let Some(Value::Object(mut extensions)) = json.remove("extensions") {
        extensions.retain(|name, _| is_kept(name));
        json.extend((!extensions.is_empty()).then(|| ("extensions".to_owned(), extensions.into())));
    }
}
