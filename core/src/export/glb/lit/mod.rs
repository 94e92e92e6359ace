//! A scene with its light map, for engines and tools: the files that it was made of as edits have left them.

mod copied;
mod faces;
#[cfg(test)]
mod house;
mod material;
mod page;
mod primitive;
mod stand;
#[cfg(test)]
mod tests;
mod told;
mod tree;

use std::collections::BTreeMap;

use ::gltf::json::Value;
use glam::{DMat3, DVec2, Vec3};

use self::copied::{Copies, Sets, has_unread_texture, reads_second};
use self::faces::{Drawn, PrimitiveKey};
use self::material::{Shown, Surface};
use self::primitive::{Attributes, Primitive};
use self::stand::Stand;
pub use self::told::Originals;
use self::told::Told;
use super::container::{Document, numbers, object, push};
use crate::atlas::{Atlas, Coordinates, Entry, Rectangle};
use crate::export::ExportError;
use crate::scene::{Light, LightKind};
use crate::texels::TexelPage;
use crate::world::World;

/// A scene with its light map, to be written.
#[derive(Clone, Copy, Debug)]
pub struct LitExport<'a> {
    /// The scene as edits have left it.
    pub world: &'a World,
    /// The files that it was made of. Of objects whose file is not there what light knows is written.
    pub originals: &'a Originals,
    /// Its light.
    pub layout: LightLayout<'a>,
    /// Viewers without any light of their own show what surfaces send out.
    pub unlit: bool,
    /// What the light map is.
    pub about: LightAbout,
}

/// How a light map is laid out in the file.
#[derive(Clone, Copy, Debug)]
pub enum LightLayout<'a> {
    /// One value per slot, at the vertices of the subdivided meshes.
    Vertices(&'a [Vec3]),
    /// Texels on the pages of an atlas of the world.
    Atlas(&'a Atlas, &'a [TexelPage]),
}

/// What an exported light map is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LightAbout {
    /// Version of the light map, where it has one.
    pub version: Option<u64>,
    /// Stated error, where it is known.
    pub estimated_rmse: Option<f32>,
}

/// Writes a scene as binary glTF: nodes with their hierarchy, names and transforms, meshes with their texture
/// coordinates, materials with their textures, lights, cameras and what is transparent, all as the files have it and
/// edits have left it. Meshes are uncompressed and posed; animations, points and lines are left out.
///
/// The light map is irradiance / π, linear RGB: times the base colour it is what a surface sends out.
///
/// [`LightLayout::Atlas`]: `TEXCOORD_1` is a place on a page (the file's second set becomes `TEXCOORD_2` where a
/// texture reads it); the pages are PNG pictures, 8-bit sRGB of the light map over `gain`, which materials have as
/// `MOZ_lightmap`. With `unlit` what does not shine by itself has the page, times its mean albedo, as its emission
/// too.
///
/// [`LightLayout::Vertices`]: the meshes are the cells between elements; `COLOR_0` is the light map times the file's
/// vertex colours. With `unlit` it is at most 1, as the specification has it, and materials are `KHR_materials_unlit`,
/// but those that shine or transmit light. Where any of that changes it, `_LIGHT` is the light map as it is.
///
/// Surfaces whose backs have light of their own are drawn twice, single-sided, a ten-thousandth of the object's size
/// apart. `asset.extras.light_map` and `extras.light_map` of the nodes tell unit, version, stated error and places.
///
/// # Errors
/// [`ExportError`]: values or pages that do not fit the world, numbers that are not finite, more than 4 GiB.
pub fn write_lit_glb(export: &LitExport<'_>) -> Result<Vec<u8>, ExportError> {
    check(export)?;
    let mut document = Document::default();
    let (mut pages, mut gain) = (Vec::new(), 1.0);
    if let LightLayout::Atlas(_, texels) = export.layout {
        gain = page::gain_of(texels);
        pages = page::add_pages(&mut document, texels, gain)?;
    }
    let mut writer = Writer {
        export,
        document,
        copies: Copies::default(),
        lights: export.world.scene.lights.iter().filter_map(emissive).collect(),
        light_maps: Vec::new(),
        pages,
        gain,
        has_light: has_light(export),
        materials: BTreeMap::new(),
    };
    let light_map = writer.light_map();
    writer.light_maps = writer.pages.iter().map(|page| moz_lightmap(page, gain, &light_map)).collect();
    tree::write(&mut writer)?;
    writer.document.asset.push(("extras", object([("light_map", light_map)])));
    let copyright = export.originals.scene.as_ref().and_then(|file| file.copyright.as_deref());
    writer.document.asset.extend(copyright.map(|text| ("copyright", text.into())));
    writer.document.finish()
}

fn check(export: &LitExport<'_>) -> Result<(), ExportError> {
    let fits = match export.layout {
        LightLayout::Vertices(values) if values.iter().any(|value| !value.is_finite()) => {
            return Err(ExportError::NotFinite("the light map".to_owned()));
        }
        LightLayout::Vertices(values) => values.len() == export.world.slots(),
        LightLayout::Atlas(atlas, pages) => {
            let sizes = atlas.pages();
            let is_of = |(page, of): (&TexelPage, &crate::atlas::Page)| {
                (page.width, page.height) == (of.width as usize, of.height as usize)
            };
            pages.len() == sizes.len() && pages.iter().zip(&sizes).all(is_of)
        }
    };
    if fits { Ok(()) } else { Err(ExportError::Lists("the light map".to_owned())) }
}

/// Whether colours of vertices are not the light map itself.
fn has_light(export: &LitExport<'_>) -> bool {
    let LightLayout::Vertices(values) = export.layout else { return false };
    let is_colored = export.world.scene.objects.iter().any(|item| !item.is_hidden && !item.mesh.colors.is_empty());
    is_colored || export.unlit && values.iter().any(|value| value.max_element() > 1.0)
}

fn emissive(light: &Light) -> Option<((&str, u32), &Light)> {
    match &light.kind {
        LightKind::Emissive { object, material } => Some(((object.as_str(), *material), light)),
        _ => None,
    }
}

/// A page as the light map of a material.
fn moz_lightmap(page: &Value, gain: f32, light_map: &Value) -> Value {
    object([("index", page.clone()), ("texCoord", 1.into()), ("intensity", gain.into()), ("extras", light_map.clone())])
}

struct Writer<'a> {
    export: &'a LitExport<'a>,
    document: Document,
    copies: Copies,
    /// By object and material.
    lights: BTreeMap<(&'a str, u32), &'a Light>,
    /// Textures of the pages.
    pages: Vec<Value>,
    /// Per page, the `MOZ_lightmap` that materials have.
    light_maps: Vec<Value>,
    gain: f32,
    has_light: bool,
    /// By what they say.
    materials: BTreeMap<String, Value>,
}

impl<'a> Writer<'a> {
    /// What the light map is.
    fn light_map(&self) -> Value {
        let about = &self.export.about;
        let mut json = vec![
            ("unit", "irradiance / pi, linear RGB".into()),
            ("version", about.version.into()),
            ("estimated_rmse", about.estimated_rmse.filter(|rmse| rmse.is_finite()).into()),
        ];
        match self.export.layout {
            LightLayout::Vertices(_) => {
                json.push(("attribute", if self.has_light { "_LIGHT" } else { "COLOR_0" }.into()));
            }
            LightLayout::Atlas(..) => {
                json.push(("encoding", "sRGB; times gain".into()));
                json.push(("gain", self.gain.into()));
                json.push(("texCoord", 1.into()));
            }
        }
        object(json)
    }

    /// What the node of an object says of its light map.
    fn place(&self, index: usize) -> Value {
        let name = &self.export.world.scene.objects[index].name;
        let mut json = vec![("object", name.as_str().into())];
        if let LightLayout::Atlas(atlas, _) = self.export.layout
            && let Some(entry) = atlas.entry(name)
        {
            let texcoord = match entry.coordinates() {
                Coordinates::File => "file",
                Coordinates::Made => "made",
            };
            json.push(("texcoord", texcoord.into()));
            json.extend(place_of(atlas, entry, &entry.front));
            let back = entry.back.as_ref().map(|back| object(place_of(atlas, entry, back)));
            json.extend(back.map(|back| ("back", back)));
        }
        object(json)
    }

    /// The mesh of an object; none where there is nothing to be drawn.
    fn add_mesh(&mut self, index: usize, stand: &Stand) -> Result<Option<Value>, ExportError> {
        let world = self.export.world;
        let (item, placed) = (&*world.scene.objects[index], &world.placed[index]);
        let told = Told::of(self.export.originals, item);
        let is_mirrored = DMat3::from_mat4(stand.world_from_node).determinant() < 0.0;
        let drawn = Drawn { item, placed, told, baked: stand.baked, is_mirrored };
        let mut primitives = Vec::new();
        match self.export.layout {
            LightLayout::Vertices(values) => {
                let parts = drawn.by_element(world, &values[placed.placement.element_indices()], self.export.unlit);
                let texcoords = [0, 1].into_iter().rposition(|set| drawn.has_texcoords(set)).map_or(0, |last| last + 1);
                let attributes = Attributes { texcoords, has_color: true, has_light: self.has_light };
                let has = [0, 1].map(|set| drawn.has_texcoords(set));
                for (key, part) in parts {
                    let sets = Sets { has, second: 1 };
                    let material =
                        self.material(&drawn, key, &part, sets, &Shown::Colors(self.export.unlit), placed.with_back);
                    primitives.extend(part.write(&mut self.document, attributes, material));
                }
            }
            LightLayout::Atlas(atlas, _) => {
                if let Some(entry) = atlas.entry(&item.name) {
                    for (key, part) in drawn.on_pages(atlas, entry) {
                        primitives.extend(self.on_page(&drawn, key, &part, entry));
                    }
                }
            }
        }
        self.add_clear(&drawn, &mut primitives);
        if primitives.is_empty() {
            return Ok(None);
        }
        let name = drawn.told.as_ref().and_then(|told| told.pieces.first()?.mesh.name.clone());
        let name = name.filter(|name| item.asset.is_none() && !name.is_empty()).unwrap_or_else(|| item.name.clone());
        let mesh = object([("name", name.into()), ("primitives", primitives.into())]);
        Ok(Some(push(&mut self.document.meshes, mesh)))
    }

    fn on_page(&mut self, drawn: &Drawn<'_>, key: PrimitiveKey, part: &Primitive, entry: &Entry) -> Option<Value> {
        let (_, _, is_back) = key;
        let rectangle = if is_back { entry.back.as_ref()? } else { &entry.front };
        let file = drawn.told.as_ref().map(|told| told.file);
        let json = file.zip(part.told_material).and_then(|(file, index)| file.lists.materials.get(index));
        let has_second = drawn.has_texcoords(1) && json.is_some_and(reads_second);
        let light_map = self.light_maps.get(rectangle.page)?.clone();
        let page = self.pages.get(rectangle.page)?.clone();
        let shown = Shown::Page { light_map: &light_map, shines: self.export.unlit.then_some((&page, self.gain)) };
        let sets = Sets { has: [drawn.has_texcoords(0), has_second], second: 2 };
        let material = self.material(drawn, key, part, sets, &shown, entry.back.is_some());
        let attributes = Attributes { texcoords: if has_second { 3 } else { 2 }, ..Attributes::default() };
        part.write(&mut self.document, attributes, material)
    }

    /// What lets all light through, as the file has it.
    fn add_clear(&mut self, drawn: &Drawn<'_>, primitives: &mut Vec<Value>) {
        let Some(told) = &drawn.told else { return };
        let of_clear = |set: usize| {
            let clear = told.pieces.iter().filter_map(|piece| piece.mesh.clear.as_ref());
            clear.into_iter().any(|clear| !clear.mesh.texcoords[set].is_empty())
        };
        let has = [0, 1].map(of_clear);
        let texcoords = has.iter().rposition(|has| *has).map_or(0, |last| last + 1);
        for (index, part) in drawn.clear() {
            let sets = Sets { has, second: 1 };
            let json = index.map(|index| self.copies.material(&mut self.document, told.file, index, sets));
            let material = self.unique(json.unwrap_or_default().into());
            let attributes = Attributes { texcoords, ..Attributes::default() };
            primitives.extend(part.write(&mut self.document, attributes, material));
        }
    }

    fn material(
        &mut self,
        drawn: &Drawn<'_>,
        (slot, _, _): PrimitiveKey,
        part: &Primitive,
        sets: Sets,
        shown: &Shown<'_>,
        is_apart: bool,
    ) -> Value {
        let light = self.lights.get(&(drawn.item.name.as_str(), slot)).copied();
        let file = drawn.told.as_ref().map(|told| told.file).zip(part.told_material);
        let is_unread = file.is_some_and(|(file, index)| has_unread_texture(file, index));
        let surface = Surface { item: drawn.item, slot: slot as usize, light, is_unread, is_apart };
        let json = match (&drawn.told, part.told_material) {
            (None, _) => surface.untold(),
            (Some(_), None) => surface.edited(serde_json::Map::new()),
            (Some(told), Some(index)) => {
                surface.edited(self.copies.material(&mut self.document, told.file, index, sets))
            }
        };
        self.unique(surface.lit(json, shown))
    }

    /// Materials that say the same are one.
    fn unique(&mut self, json: Value) -> Value {
        let materials = &mut self.document.materials;
        self.materials.entry(json.to_string()).or_insert_with(|| push(materials, json)).clone()
    }
}

/// Page, scale and offset of a rectangle: its place on the page is texcoord × scale + offset.
fn place_of(atlas: &Atlas, entry: &Entry, rectangle: &Rectangle) -> Vec<(&'static str, Value)> {
    let (scale, offset) = entry.to_page(rectangle, atlas.pages()[rectangle.page]);
    let pair = |pair: DVec2| numbers(pair.as_vec2().to_array());
    vec![("page", rectangle.page.into()), ("scale", pair(scale)), ("offset", pair(offset))]
}
