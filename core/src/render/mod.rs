//! Preview pictures: direct light per pixel by ray tracing, indirect light from the light map (Lu et al. 2025,
//! section 3.4).
//!
//! Direct light has the sharp details (shadow edges) that a map of finite spacing smooths over, and costs one ray per
//! light and sample; indirect light is smooth and would cost whole paths. So a picture takes the first from rays and
//! looks the second up. The same inputs and seed give the same bits on any number of threads.

mod camera;
mod lines;
mod palette;
mod read;
mod shade;
#[cfg(test)]
mod tests;
mod tone;
mod values;

pub use crate::export::{srgb_from_linear, write_png};
pub use camera::{Viewpoint, ViewpointError};
pub use palette::{Palette, nice_scale};
pub use read::{Loaded, read_picture};
pub use tone::{ToneMap, auto_exposure};
pub use values::{ValuePicture, change_of, change_since, render_values, stated_errors, visible_slots};

use glam::Vec3;
use rayon::prelude::*;

use crate::export::ExportError;
use crate::job::{Canceled, Observer};
use crate::lightmap::LightMap;
use crate::world::World;
use camera::Rays;
use shade::Shading;

/// Pixels along the side of a tile: the unit of work, and of cancellation.
const TILE: usize = 16;

/// Size and quality of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RenderOptions {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Samples per pixel: each is a camera ray and a shadow ray per light.
    pub samples: u32,
    /// Seed of the random numbers.
    pub seed: u64,
}

/// Which light a picture shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum View {
    /// Emission, direct and indirect light: radiance towards the camera.
    Full,
    /// Emission and direct light.
    Direct,
    /// Reflected indirect light.
    Indirect,
    /// The light map alone, as it is stored: irradiance / π, direct + indirect, without albedo.
    LightMap,
    /// [`View::LightMap`] with lines between neighbouring elements.
    Elements,
}

/// A rectangle of linear RGB (Rec. 709 primaries), row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Radiance, or what the [`View`] says.
    pub pixels: Vec<Vec3>,
}

/// Renders a view of a world with its light map on the current rayon pool.
///
/// Camera rays pass through the backs of single-sided surfaces, as glTF asks of a viewer: a closed room can be looked
/// into from outside. All other rays are blocked by them, as in a bake.
///
/// # Errors
/// [`Canceled`] where the observer says so; it is asked once per tile.
///
/// # Panics
/// Where the map has not one value per slot of the world.
pub fn render(
    world: &World,
    map: &LightMap,
    viewpoint: &Viewpoint,
    view: View,
    options: &RenderOptions,
    observer: &dyn Observer,
) -> Result<Picture, Canceled> {
    assert_eq!(map.len(), world.slots(), "a light map has one value per slot");
    let rays = Rays::new(world, viewpoint, options.width, options.height);
    let shading = Shading::new(world, map, view, rays.pixel());
    let pixels = tiles(options, observer, |x, y| shading.pixel(&rays, x, y, options))?;
    Ok(Picture { width: options.width, height: options.height, pixels })
}

impl Picture {
    /// An 8-bit sRGB PNG: `2^exposure` times the value, through the tone map.
    ///
    /// # Errors
    /// [`ExportError`] where the picture is empty or too large for the format.
    pub fn png(&self, exposure: f32, tone: ToneMap) -> Result<Vec<u8>, ExportError> {
        let gain = exposure.exp2();
        let bytes: Vec<u8> = self.pixels.par_iter().flat_map_iter(|p| tone.encode(*p * gain)).collect();
        write_png(self.width, self.height, &bytes)
    }

    /// A 32-bit float OpenEXR picture of the values as they are.
    ///
    /// # Errors
    /// [`ExportError`] where the picture is empty or too large for the format.
    pub fn exr(&self, attributes: &[(&str, &str)]) -> Result<Vec<u8>, ExportError> {
        crate::export::write_picture_exr(&self.pixels, self.width, attributes)
    }
}

/// Evaluates `pixel(x, y)` for all pixels in parallel. The result does not depend on how the work is cut.
fn tiles<T: Copy + Default + Send>(
    options: &RenderOptions,
    observer: &dyn Observer,
    pixel: impl Fn(usize, usize) -> T + Sync,
) -> Result<Vec<T>, Canceled> {
    let (width, height) = (options.width, options.height);
    let across = width.div_ceil(TILE);
    let count = across * height.div_ceil(TILE);
    let extent = |tile: usize| {
        let (x, y) = (tile % across * TILE, tile / across * TILE);
        (x..(x + TILE).min(width), y..(y + TILE).min(height))
    };
    let one = |tile: usize| {
        if observer.canceled() {
            return Err(Canceled);
        }
        let (columns, rows) = extent(tile);
        Ok(rows.flat_map(|y| columns.clone().map(move |x| (x, y))).map(|(x, y)| pixel(x, y)).collect::<Vec<T>>())
    };
    let done = (0..count).into_par_iter().map(one).collect::<Result<Vec<_>, Canceled>>()?;
    let mut pixels = vec![T::default(); width * height];
    for (tile, values) in done.into_iter().enumerate() {
        let (columns, rows) = extent(tile);
        for (row, values) in rows.zip(values.chunks_exact(columns.len())) {
            pixels[row * width + columns.start..][..columns.len()].copy_from_slice(values);
        }
    }
    Ok(pixels)
}
