//! Pages of an atlas as pictures.

use ::gltf::json::Value;
use glam::Vec3;

use super::super::container::{Document, object, push};
use crate::export::{ExportError, srgb_from_linear, write_png};
use crate::texels::TexelPage;

/// Part of the texels that may be brighter than what pictures can show.
const CLIPPED: f64 = 0.002;

/// What 1 in a picture stands for: all but a few texels are darker.
pub(super) fn gain_of(pages: &[TexelPage]) -> f32 {
    let valid = pages.iter().flat_map(|page| page.values.iter().zip(&page.valid)).filter(|(_, valid)| **valid);
    let mut brightest: Vec<f32> = valid.map(|(v, _)| v.max_element()).filter(|v| v.is_finite() && *v > 0.0).collect();
    if brightest.is_empty() {
        return 1.0;
    }
    let at = ((brightest.len() as f64 * (1.0 - CLIPPED)) as usize).min(brightest.len() - 1);
    *brightest.select_nth_unstable_by(at, f32::total_cmp).1
}

/// Adds pages as 8-bit sRGB of their values over the gain; answers the texture of each.
pub(super) fn add_pages(document: &mut Document, pages: &[TexelPage], gain: f32) -> Result<Vec<Value>, ExportError> {
    if pages.is_empty() {
        return Ok(Vec::new());
    }
    // Linear, clamped to the edge.
    let clamp = [("magFilter", 9729), ("minFilter", 9729), ("wrapS", 33071), ("wrapT", 33071)];
    let sampler = push(&mut document.samplers, object(clamp.map(|(name, value)| (name, value.into()))));
    let mut textures = Vec::with_capacity(pages.len());
    for (index, page) in pages.iter().enumerate() {
        let encode = |value: &Vec3| (*value / gain).to_array().map(|c| (srgb(c) * 255.0 + 0.5) as u8);
        let bytes: Vec<u8> = page.values.iter().flat_map(encode).collect();
        let png = write_png(page.width, page.height, &bytes)?;
        let source = document.add_image(Some(&format!("light map {index}")), "image/png", &png);
        let texture = object([("source", source), ("sampler", sampler.clone())]);
        textures.push(push(&mut document.textures, texture));
    }
    Ok(textures)
}

/// In 0..=1.
fn srgb(c: f32) -> f32 {
    srgb_from_linear(c.clamp(0.0, 1.0)).clamp(0.0, 1.0)
}
