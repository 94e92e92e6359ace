//! What leaves as bytes: element records, OpenEXR pictures, glTF, pages of atlases.

use std::borrow::Cow;
use std::sync::Arc;

use glam::Vec3;
use rebake_core::LightPart;
use rebake_core::export::{
    EXR_WIDTH, LightLayout, LitExport, Precision, write_exr, write_lit_glb, write_page_exr, write_pages_ktx2,
};
use rebake_core::render::{Picture, ToneMap, auto_exposure};
use rebake_core::scene::Original;
use rebake_core::texels::TexelPage;
pub(crate) use rebake_core::texels::read_page;

use super::{
    Atlas, Canceled, Layer, LightAbout, LoadError, ObjectSummary, Observer, Originals, World, accepted_before,
};

/// Bytes of one element record of [`element_records`].
pub(crate) const ELEMENT_BYTES: usize = 32;

/// Per slot: world-space position, normal, area, object index; little-endian.
pub(crate) fn element_records(world: &World) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(world.slots() * ELEMENT_BYTES);
    for (slot, object) in world.object_indices().into_iter().enumerate() {
        push_element(&mut bytes, world, slot, object);
    }
    bytes
}

/// Per element of one object: what [`element_records`] tells, its light (three `f32`) and the standard error of that.
pub(crate) fn object_records(world: &World, object: &ObjectSummary, light: &[Vec3], errors: &[Vec3]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(object.elements as usize * (ELEMENT_BYTES + 16));
    for slot in object.first_element as usize..(object.first_element + object.elements) as usize {
        push_element(&mut bytes, world, slot, object.index);
        for number in light[slot].to_array().into_iter().chain([errors[slot].x]) {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
    }
    bytes
}

fn push_element(bytes: &mut Vec<u8>, world: &World, slot: usize, object: u32) {
    let position = (world.positions()[slot].as_dvec3() + world.scene.origin).as_vec3();
    for number in position.to_array().into_iter().chain(world.normals()[slot].to_array()) {
        bytes.extend_from_slice(&number.to_le_bytes());
    }
    bytes.extend_from_slice(&world.areas()[slot].to_le_bytes());
    bytes.extend_from_slice(&object.to_le_bytes());
}

/// A scene with its light map as binary glTF.
pub(crate) struct LitScene<'a> {
    pub(crate) world: &'a World,
    /// By texel on its pages; by element where absent.
    pub(crate) atlas: Option<&'a Atlas>,
    /// One per slot.
    pub(crate) values: &'a [Vec3],
    pub(crate) originals: &'a Originals,
    pub(crate) unlit: bool,
    pub(crate) about: LightAbout,
}

/// The subdivided meshes of a scene with one value per slot as `COLOR_0`, vertices in the order of slots.
pub(crate) fn lightmap_glb(world: &World, values: &[Vec3]) -> Result<Vec<u8>, String> {
    rebake_core::export::lightmap_glb(world, values).map_err(|error| error.to_string())
}

/// A scene with its light map, and all that the files have that it was made of, as binary glTF.
pub(crate) fn lit_glb(scene: &LitScene<'_>, observer: &dyn Observer) -> Result<Vec<u8>, String> {
    let LitScene { world, values, .. } = *scene;
    let mut pages = Vec::new();
    if let Some(atlas) = scene.atlas {
        let read = |page| read_page(world, atlas, page, values, observer);
        let read = (0..atlas.pages().len()).map(read).collect::<Result<Vec<_>, Canceled>>();
        pages = read.map_err(|Canceled| "nobody waits for it".to_owned())?;
    }
    let layout = scene.atlas.map_or(LightLayout::Vertices(values), |atlas| LightLayout::Atlas(atlas, &pages));
    let LitScene { originals, unlit, about, .. } = *scene;
    write_lit_glb(&LitExport { world, originals, layout, unlit, about }).map_err(|error| error.to_string())
}

/// Opens a file that was read before, to be written back.
pub(crate) fn open_original(file: &[u8]) -> Result<Original, LoadError> {
    Original::open(file, &accepted_before(None))
}

/// As which file a page of an atlas leaves.
#[derive(Clone, Copy, Debug)]
pub(crate) enum AtlasPicture {
    /// OpenEXR.
    Exr(Precision),
    /// KTX2.
    Ktx2(Precision),
    /// PNG, with automatic exposure.
    Png,
}

/// A page of an atlas as a file, and the stops of its exposure where it is a PNG.
pub(crate) fn atlas_page(
    page: TexelPage,
    picture: AtlasPicture,
    about: &[(&str, &str)],
) -> Result<(Vec<u8>, Option<f32>), String> {
    let file = match picture {
        AtlasPicture::Exr(precision) => (write_page_exr(&page, precision, about), None),
        AtlasPicture::Ktx2(precision) => (write_pages_ktx2(&[("", page)], precision, about), None),
        AtlasPicture::Png => {
            let valid = page.values.iter().zip(&page.valid).filter(|(_, valid)| **valid);
            let exposure = auto_exposure(&valid.map(|(value, _)| *value).collect::<Vec<_>>());
            let picture = Picture { width: page.width, height: page.height, pixels: page.values };
            (picture.png(exposure, ToneMap::default()), Some(exposure))
        }
    };
    file.0.map(|bytes| (bytes, file.1)).map_err(|error| error.to_string())
}

/// One object, by its index: its mesh as the file has it, and its elements with their light, as binary glTF.
pub(crate) fn object_glb(world: &World, index: u32, light: &[Vec3]) -> Result<Vec<u8>, String> {
    let written = rebake_core::export::object_glb(world, index as usize, light).ok_or("there is no such object")?;
    written.map_err(|error| error.to_string())
}

/// Layers side by side as an OpenEXR picture, direct and indirect light apart, with what they are in its header.
pub(crate) fn layers_exr(layers: &[Arc<Layer>], about: &[(&str, &str)]) -> Result<Vec<u8>, String> {
    /// Names of channels have 255 bytes.
    const LONGEST: usize = 200;
    let names: Vec<[String; 2]> = layers
        .iter()
        .enumerate()
        .map(|(index, layer)| {
            let is_possible = (1..=LONGEST).contains(&layer.name.len()) && !layer.name.contains('\0');
            let name = if is_possible { layer.name.clone() } else { format!("layer-{index}") };
            [format!("{name}.direct"), format!("{name}.indirect")]
        })
        .collect();
    let parts = [LightPart::Direct, LightPart::Indirect];
    let values = layers.iter().flat_map(|layer| parts.map(|part| layer.light.part(part)));
    let values: Vec<Cow<'_, [Vec3]>> = values.collect();
    let names = names.iter().flatten().map(String::as_str);
    let channels: Vec<(&str, &[Vec3])> = names.zip(values.iter().map(|values| &**values)).collect();
    write_exr(&channels, EXR_WIDTH, about).map_err(|error| error.to_string())
}

/// The values as an OpenEXR picture, with what they are in its header.
pub(crate) fn lightmap_exr(values: &[Vec3], about: &[(&str, &str)]) -> Result<Vec<u8>, String> {
    write_exr(&[("", values)], EXR_WIDTH, about).map_err(|error| error.to_string())
}
