//! Objects as they are, with places in an atlas and its pages as pictures.

use std::collections::BTreeMap;

use ::gltf::json::Value;
use glam::{DMat3, Vec2, Vec3};

use super::container::{Document, numbers, object, push};
use super::emission_parts;
use super::scene::transform;
use crate::atlas::{Atlas, Entry, Rectangle};
use crate::export::{ExportError, srgb_from_linear, write_png};
use crate::hash::FastMap;
use crate::scene::{LightKind, Material, Object};
use crate::texels::TexelPage;
use crate::world::World;

/// Part of the texels that may be brighter than what pictures can show.
const CLIPPED: f64 = 0.002;

/// What an exported light map is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AtlasAbout {
    /// Version of the light map.
    pub version: u64,
    /// Stated error, where it is known.
    pub estimated_rmse: Option<f32>,
}

/// Writes objects with their own triangles, `TEXCOORD_1` on the pages of an atlas, and the pages as PNG pictures: 8-bit
/// sRGB of the light map (irradiance / π) over a `gain` that `asset.extras.light_map` tells. Materials have them as
/// emissive textures times albedo, so that viewers without any light of their own show what surfaces send out. Backs with
/// light of their own are single-sided copies.
///
/// # Errors
/// [`ExportError`]: pages that are not those of the atlas, more than 4 GiB.
pub fn write_atlas_glb(
    world: &World,
    atlas: &Atlas,
    pages: &[TexelPage],
    about: &AtlasAbout,
) -> Result<Vec<u8>, ExportError> {
    let fits = |(page, of): (&TexelPage, &crate::atlas::Page)| {
        (page.width, page.height) == (of.width as usize, of.height as usize)
    };
    if pages.len() != atlas.pages().len() || !pages.iter().zip(&atlas.pages()).all(fits) {
        return Err(ExportError::Lists("the atlas".to_owned()));
    }
    let mut writer =
        Writer { world, atlas, document: Document::default(), gain: gain_of(pages), materials: BTreeMap::new() };
    for (index, page) in pages.iter().enumerate() {
        writer.add_page(index, page)?;
    }
    for (index, item) in world.scene.objects.iter().enumerate() {
        if let Some(entry) = atlas.entry(&item.name) {
            writer.add_object(index, item, entry)?;
        }
    }
    let light_map = object([
        ("unit", "irradiance / pi, linear RGB".into()),
        ("encoding", "sRGB; times gain".into()),
        ("gain", writer.gain.into()),
        ("texCoord", 1.into()),
        ("version", about.version.into()),
        ("estimated_rmse", about.estimated_rmse.filter(|rmse| rmse.is_finite()).into()),
    ]);
    writer.document.extras = Some(object([("light_map", light_map)]));
    writer.document.finish()
}

/// What 1 in a picture stands for: all but a few texels are darker.
fn gain_of(pages: &[TexelPage]) -> f32 {
    let valid = pages.iter().flat_map(|page| page.values.iter().zip(&page.valid)).filter(|(_, valid)| **valid);
    let mut brightest: Vec<f32> = valid.map(|(v, _)| v.max_element()).filter(|v| v.is_finite() && *v > 0.0).collect();
    if brightest.is_empty() {
        return 1.0;
    }
    let at = ((brightest.len() as f64 * (1.0 - CLIPPED)) as usize).min(brightest.len() - 1);
    *brightest.select_nth_unstable_by(at, f32::total_cmp).1
}

struct Writer<'a> {
    world: &'a World,
    atlas: &'a Atlas,
    document: Document,
    gain: f32,
    /// By the bits of albedo and emission, the page, and whether both sides are drawn.
    materials: BTreeMap<([u32; 6], usize, bool), Value>,
}

/// One side of an object.
struct Side<'a> {
    rectangle: &'a Rectangle,
    is_back: bool,
    /// Single-sided whatever the material says.
    is_apart: bool,
}

impl Writer<'_> {
    fn add_page(&mut self, index: usize, page: &TexelPage) -> Result<(), ExportError> {
        let encode = |value: &Vec3| (*value / self.gain).to_array().map(|c| (srgb(c) * 255.0 + 0.5) as u8);
        let bytes: Vec<u8> = page.values.iter().flat_map(encode).collect();
        let png = write_png(page.width, page.height, &bytes)?;
        self.document.add_picture(&format!("light map {index}"), &png);
        Ok(())
    }

    fn add_object(&mut self, index: usize, item: &Object, entry: &Entry) -> Result<(), ExportError> {
        let is_apart = entry.back.is_some();
        let front = Side { rectangle: &entry.front, is_back: false, is_apart };
        let back = entry.back.as_ref().map(|rectangle| Side { rectangle, is_back: true, is_apart });
        let mut primitives = Vec::new();
        for side in std::iter::once(front).chain(back) {
            self.add_side(index, item, entry, &side, &mut primitives)?;
        }
        let mesh = object([("name", item.name.as_str().into()), ("primitives", primitives.into())]);
        let mesh = push(&mut self.document.meshes, mesh);
        let matrix = transform(item.world_from_object, &item.name)?;
        let node = object([("name", item.name.as_str().into()), ("mesh", mesh)].into_iter().chain(matrix));
        self.document.nodes.push(node);
        Ok(())
    }

    /// A primitive per material, with vertices of its own.
    fn add_side(
        &mut self,
        index: usize,
        item: &Object,
        entry: &Entry,
        side: &Side,
        primitives: &mut Vec<Value>,
    ) -> Result<(), ExportError> {
        let (scale, offset) = entry.to_page(side.rectangle, self.atlas.pages()[side.rectangle.page]);
        let (scale, offset) = (scale.as_vec2(), offset.as_vec2());
        let texcoords: Vec<[Vec2; 3]> = entry.texcoords().collect();
        let surface = &self.world.placed[index].surface;
        // glTF turns the triangles of a mirrored node by itself.
        let is_mirrored = DMat3::from_mat4(item.world_from_object).determinant() < 0.0;
        let mut by_material: BTreeMap<u32, Vertices> = BTreeMap::new();
        for (source, &material) in surface.sources.iter().zip(&surface.triangle_materials) {
            let triangle = source.triangle();
            let is_turned = source.turned() != is_mirrored;
            let vertices = by_material.entry(material).or_default();
            let corners: [usize; 3] = if is_turned != side.is_back { [0, 2, 1] } else { [0, 1, 2] };
            let corner =
                |k: usize| vertices.id(item.mesh.triangles[triangle][k], texcoords[triangle][k] * scale + offset);
            let corners = corners.map(corner);
            vertices.triangles.push(corners);
        }
        for (material, vertices) in by_material {
            let lists = || ExportError::Lists(item.name.clone());
            let of = item.materials.get(material as usize).ok_or_else(lists)?;
            let material = self.add_material(item, material, of, side);
            primitives.push(vertices.add(&mut self.document, item, side.is_back, material));
        }
        Ok(())
    }

    fn add_material(&mut self, item: &Object, number: u32, material: &Material, side: &Side) -> Value {
        let of_this = |kind: &LightKind| matches!(kind, LightKind::Emissive { object, material } if *object == item.name && *material == number);
        let light = self.world.scene.lights.iter().find(|light| of_this(&light.kind));
        let emission = light.map_or(Vec3::ZERO, |light| light.strength());
        let albedo = material.albedo;
        let double_sided = material.double_sided && !side.is_apart;
        let bits = [albedo, emission].map(|v| v.to_array().map(f32::to_bits));
        let key = (
            [bits[0][0], bits[0][1], bits[0][2], bits[1][0], bits[1][1], bits[1][2]],
            side.rectangle.page,
            double_sided,
        );
        if let Some(known) = self.materials.get(&key) {
            return known.clone();
        }
        let [r, g, b] = albedo.to_array();
        let pbr = object([
            ("baseColorFactor", numbers([r, g, b, 1.0])),
            ("metallicFactor", 0.into()),
            ("roughnessFactor", 1.into()),
        ]);
        let is_lamp = emission != Vec3::ZERO;
        let (color, strength) = emission_parts(if is_lamp { emission } else { albedo * self.gain });
        let mut json = vec![("pbrMetallicRoughness", pbr), ("emissiveFactor", numbers(color.to_array()))];
        if !is_lamp {
            let texture = object([("index", side.rectangle.page.into()), ("texCoord", 1.into())]);
            json.push(("emissiveTexture", texture));
        }
        if double_sided {
            json.push(("doubleSided", true.into()));
        }
        if strength != 1.0 {
            let extension = object([("emissiveStrength", strength.into())]);
            json.push(("extensions", object([("KHR_materials_emissive_strength", extension)])));
            self.document.has_emissive_strength = true;
        }
        let index = push(&mut self.document.materials, object(json));
        self.materials.insert(key, index.clone());
        index
    }
}

/// In 0..=1.
fn srgb(c: f32) -> f32 {
    srgb_from_linear(c.clamp(0.0, 1.0)).clamp(0.0, 1.0)
}

/// Vertices that differ in what the mesh has there or in their place on the page.
#[derive(Default)]
struct Vertices {
    ids: FastMap<(u32, [u32; 2]), u32>,
    list: Vec<(u32, Vec2)>,
    triangles: Vec<[u32; 3]>,
}

impl Vertices {
    fn id(&mut self, vertex: u32, place: Vec2) -> u32 {
        let list = &mut self.list;
        *self.ids.entry((vertex, place.to_array().map(f32::to_bits))).or_insert_with(|| {
            list.push((vertex, place));
            list.len() as u32 - 1
        })
    }

    fn add(&self, document: &mut Document, item: &Object, is_back: bool, material: Value) -> Value {
        let mesh = &item.mesh;
        let positions: Vec<Vec3> = self.list.iter().map(|(v, _)| mesh.positions[*v as usize]).collect();
        let normals: Vec<Vec3> = self
            .list
            .iter()
            .filter_map(|(v, _)| mesh.normals.get(*v as usize).copied())
            .map(|n| if is_back { -n } else { n })
            .collect();
        let mut attributes = vec![("POSITION", document.add_vec3(&positions, true))];
        if normals.len() == positions.len() && normals.iter().all(|normal| *normal != Vec3::ZERO) {
            attributes.push(("NORMAL", document.add_vec3(&normals, false)));
        }
        let places: Vec<Vec2> = self.list.iter().map(|(_, place)| *place).collect();
        // The format knows no second set without a first.
        let second = document.add_vec2(&places);
        let first: Vec<Vec2> =
            self.list.iter().filter_map(|(v, _)| mesh.texcoords[0].get(*v as usize).copied()).collect();
        let is_there = first.len() == places.len();
        attributes.push(("TEXCOORD_0", if is_there { document.add_vec2(&first) } else { second.clone() }));
        attributes.push(("TEXCOORD_1", second));
        object([
            ("attributes", object(attributes)),
            ("indices", document.add_indices(&self.triangles)),
            ("material", material),
        ])
    }
}
