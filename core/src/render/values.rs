//! Pictures of one number per element: change, stated error. And which elements a picture shows at all.

use std::sync::atomic::{AtomicBool, Ordering};

use glam::Vec3;
use rayon::prelude::*;

use super::camera::Rays;
use super::palette::{Palette, nice_scale};
use super::shade::{first_seen, pixel_random, place, smooth_normal};
use super::{RenderOptions, Viewpoint, tiles, write_png};
use crate::export::ExportError;
use crate::job::{Canceled, Observer};
use crate::lightmap::LightMap;
use crate::random::R2;
use crate::transport::Surfel;
use crate::world::World;

/// One number per pixel, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct ValuePicture {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// The value looked up in the elements; 0 where there is no surface.
    pub values: Vec<f32>,
    /// Cosine between surface and line of sight, 0 where there is no surface: shows shapes, and carries no data.
    pub facing: Vec<f32>,
}

/// Per slot: mean over RGB of how much direct + indirect light (irradiance / π) changed between two worlds. Elements
/// of objects that were not there before count as unchanged: there is nothing to compare them with.
///
/// # Panics
/// Where a map has not one value per slot of its world.
pub fn change_since(before: (&World, &LightMap), after: (&World, &LightMap)) -> Vec<f32> {
    change_of(before, after, LightMap::total)
}

/// As [`change_since`], of what `value` takes from a map: indirect light alone, say.
///
/// # Panics
/// Where a map has not one value per slot of its world.
pub fn change_of(
    before: (&World, &LightMap),
    after: (&World, &LightMap),
    value: impl Fn(&LightMap, usize) -> Vec3 + Sync,
) -> Vec<f32> {
    let ((old_world, old), (world, new)) = (before, after);
    assert!(old.len() == old_world.slots() && new.len() == world.slots(), "a light map has one value per slot");
    let (old_owners, owners) = (&old_world.space.slots().owners, &world.space.slots().owners);
    let change = |slot: usize| match old_owners.get(slot) {
        // Keys are never used again: the same key is the same object.
        Some(owner) if *owner == owners[slot] => (value(new, slot) - value(old, slot)).element_sum() / 3.0,
        _ => 0.0,
    };
    (0..world.slots()).into_par_iter().map(change).collect()
}

/// Per slot: the stated standard error of direct + indirect light, mean over RGB.
pub fn stated_errors(map: &LightMap) -> Vec<f32> {
    map.light.variance.iter().map(|v| v.max(0.0).sqrt()).collect()
}

/// Renders one number per slot on the current rayon pool.
///
/// # Errors
/// [`Canceled`] where the observer says so; it is asked once per tile.
///
/// # Panics
/// Where there is not one value per slot of the world.
pub fn render_values(
    world: &World,
    values: &[f32],
    viewpoint: &Viewpoint,
    options: &RenderOptions,
    observer: &dyn Observer,
) -> Result<ValuePicture, Canceled> {
    assert_eq!(values.len(), world.slots(), "one value per slot");
    let rays = Rays::new(world, viewpoint, options.width, options.height);
    let sample = |x: usize, y: usize, u: [f32; 2]| {
        let (ray, hit) = first_seen(world, rays.through(x, y, u))?;
        let surfel = Surfel::new(world, &ray, &hit)?;
        let facing = smooth_normal(world, &surfel).dot(ray.direction).abs();
        Some((surfel.footprint.map_or(0.0, |footprint| footprint.interpolate(values)), facing))
    };
    let pixel = |x: usize, y: usize| {
        let within = R2::new(&mut pixel_random(options, x, y));
        let (mut value, mut facing) = (0.0, 0.0);
        for k in 0..options.samples {
            let (v, f) = sample(x, y, place(options, &within, k)).unwrap_or_default();
            value += v;
            facing += f;
        }
        (value / options.samples as f32, facing / options.samples as f32)
    };
    let (values, facing) = tiles(options, observer, pixel)?.into_iter().unzip();
    Ok(ValuePicture { width: options.width, height: options.height, values, facing })
}

/// Slots of the elements that pictures of these options look up where camera rays end, ascending.
///
/// # Errors
/// [`Canceled`] where the observer says so; it is asked once per tile.
pub fn visible_slots(
    world: &World,
    viewpoint: &Viewpoint,
    options: &RenderOptions,
    observer: &dyn Observer,
) -> Result<Vec<u32>, Canceled> {
    let rays = Rays::new(world, viewpoint, options.width, options.height);
    let seen: Vec<AtomicBool> = std::iter::repeat_with(AtomicBool::default).take(world.slots()).collect();
    tiles(options, observer, |x, y| {
        let within = R2::new(&mut pixel_random(options, x, y));
        for k in 0..options.samples {
            let met = first_seen(world, rays.through(x, y, place(options, &within, k)));
            let surfel = met.and_then(|(ray, hit)| Surfel::new(world, &ray, &hit));
            for &slot in surfel.and_then(|surfel| surfel.footprint).iter().flat_map(|footprint| footprint.slots()) {
                seen[slot as usize].store(true, Ordering::Relaxed);
            }
        }
    })?;
    Ok((0u32..).zip(seen).filter(|(_, seen)| seen.load(Ordering::Relaxed)).map(|(slot, _)| slot).collect())
}

impl ValuePicture {
    /// Colours as [`ValuePicture::png`] shows them, sRGB in 0..=1, without the bar.
    pub fn colors(&self, scale: f32, palette: Palette) -> Vec<Vec3> {
        let color = |(value, facing): (&f32, &f32)| {
            let light = if *facing > 0.0 { 0.45 + 0.55 * facing } else { 0.1 };
            palette.color(value / scale) * light
        };
        self.values.iter().zip(&self.facing).map(color).collect()
    }

    /// A round number that few pixels pass: what [`ValuePicture::png`] takes as `scale` where nobody chose one.
    pub fn auto_scale(&self) -> f32 {
        nice_scale(&self.values)
    }

    /// An 8-bit sRGB PNG: the palette's ends stand for ± `scale`, with its bar and numbers along the lower edge.
    /// Surfaces seen at a grazing angle are drawn darker, so that shapes can be told.
    ///
    /// # Errors
    /// [`ExportError`] where the picture is empty or too large for the format.
    pub fn png(&self, scale: f32, palette: Palette) -> Result<Vec<u8>, ExportError> {
        let colors = self.colors(scale, palette);
        let mut bytes: Vec<u8> =
            colors.iter().flat_map(|color| color.to_array().map(|c| (c * 255.0 + 0.5) as u8)).collect();
        palette.draw_bar(&mut bytes, self.width, self.height, scale);
        write_png(self.width, self.height, &bytes)
    }

    /// A 32-bit float OpenEXR picture of the values, the same in R, G and B.
    ///
    /// # Errors
    /// [`ExportError`] where the picture is empty or too large for the format.
    pub fn exr(&self, attributes: &[(&str, &str)]) -> Result<Vec<u8>, ExportError> {
        let pixels: Vec<Vec3> = self.values.iter().map(|v| Vec3::splat(*v)).collect();
        crate::export::write_picture_exr(&pixels, self.width, attributes)
    }
}
