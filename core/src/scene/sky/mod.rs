//! Pictures of the sky: radiance from outside, by direction.

mod load;
#[cfg(test)]
mod tests;

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

pub use self::load::{LoadedSky, is_sky, load_sky};
use crate::allowed::Allowed;
use crate::sampling::{Equirect, TexelChoice};

/// Larger pictures are averaged down to at most this many texels across and half as many down: a sixth of a degree, a
/// third of the sun.
const MAX_WIDTH: usize = 2048;

/// Luminance up to so many times the mean is left to rays that are not aimed: a sky above dark ground is even.
const EVEN: f32 = 4.0;

/// Mean square of what is bright beyond that, over the squared mean, from which on it is aimed at: what single rays find of
/// it makes noise by that, however little light it is.
const WORTH_AIMING: f64 = 0.05;

/// Radiance beyond it is a mistake; below it nothing overflows.
const BRIGHTEST: f32 = Allowed::ASKED.brightest;

/// Radiance of the sky by direction: an equirectangular picture with +y at its top, whose middle lies towards +x and its
/// right half towards +z, as three.js has it and Blender once it is exported to glTF.
///
/// The picture is the sum of two: an even one, which no direction brings much more of than others, and what is bright
/// beyond it, such as the sun, which is sampled by its brightness.
#[derive(Clone)]
pub struct SkyPicture {
    grid: Equirect,
    /// Linear RGB radiance, row by row from the top.
    texels: Vec<Vec3>,
    /// Luminance up to which a texel belongs to the even part.
    even: f32,
    bright: Option<Bright>,
}

/// What is bright beyond the even part.
#[derive(Clone)]
struct Bright {
    choice: TexelChoice,
    /// ∫ radiance dΩ, mean over RGB.
    power: f32,
}

/// Why numbers are no picture of a sky.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SkyError {
    /// No pixels, or not as many as its sides say.
    #[error("a picture of {width} × {height} pixels has {pixels}")]
    Size {
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
        /// Pixels there are.
        pixels: usize,
    },
    /// A pixel that is no number, or above 1e9.
    #[error("pixel ({x}, {y}) is not finite or above {BRIGHTEST:e}")]
    Radiance {
        /// Column.
        x: usize,
        /// Row.
        y: usize,
    },
    /// All pixels are black.
    #[error("all pixels are black")]
    Black,
}

impl SkyPicture {
    /// Of linear RGB radiance, three numbers per pixel, row by row from the top; each finite and at most 1e9. What is
    /// negative, as filters leave it, counts as 0. Pictures of more than 2048 × 1024 are averaged down, which keeps the
    /// light they send.
    ///
    /// # Errors
    /// [`SkyError`] where this is no picture, or not of light.
    pub fn new(width: usize, height: usize, rgb: &[f32]) -> Result<SkyPicture, SkyError> {
        let (pixels, rest) = rgb.as_chunks::<3>();
        if pixels.is_empty() || !rest.is_empty() || width.checked_mul(height) != Some(pixels.len()) {
            return Err(SkyError::Size { width, height, pixels: pixels.len() });
        }
        if let Some(at) = pixels.iter().position(|pixel| !pixel.iter().all(|x| x.is_finite() && *x <= BRIGHTEST)) {
            return Err(SkyError::Radiance { x: at % width, y: at / width });
        }
        let pixel = |(row, column): (usize, usize)| Vec3::from(pixels[row * width + column]).max(Vec3::ZERO);
        let grid = Equirect { width: width.min(MAX_WIDTH), height: height.min(MAX_WIDTH / 2) };
        let texels = averaged(Equirect { width, height }, pixel, grid);
        let mean = mean(grid, &texels, luminance);
        if mean <= 0.0 {
            return Err(SkyError::Black);
        }
        let mut sky = SkyPicture { grid, texels, even: EVEN * mean as f32, bright: None };
        let power = sky.integral(|sky, texel| sky.bright_part(texel));
        let squares = integral(grid, &sky.texels, |texel| {
            let bright = f64::from(luminance(sky.bright_part(texel)));
            DVec3::splat(bright * bright)
        });
        let is_worth_it = squares.x > WORTH_AIMING * 4.0 * PI * mean * mean;
        let weight = |row: usize, column: usize| luminance(sky.bright_part(sky.texels[row * grid.width + column]));
        let choice = if is_worth_it { TexelChoice::new(grid, weight) } else { None };
        match choice {
            Some(choice) => sky.bright = Some(Bright { choice, power: (power.element_sum() / 3.0) as f32 }),
            None => sky.even = f32::INFINITY,
        }
        Ok(sky)
    }

    /// Texels across and down.
    pub fn size(&self) -> (usize, usize) {
        (self.grid.width, self.grid.height)
    }

    /// Linear RGB radiance from a unit direction.
    #[inline]
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        let (row, column) = self.grid.texel(direction);
        self.texels[row * self.grid.width + column]
    }

    /// Mean over all directions.
    pub fn mean(&self) -> Vec3 {
        (self.integral(|_, texel| texel) / (4.0 * PI)).as_vec3()
    }

    /// The even part of the radiance from a unit direction.
    #[inline]
    pub(crate) fn even(&self, direction: Vec3) -> Vec3 {
        let texel = self.radiance(direction);
        texel - self.bright_part(texel)
    }

    /// The rest of it.
    #[inline]
    pub(crate) fn bright(&self, direction: Vec3) -> Vec3 {
        self.bright_part(self.radiance(direction))
    }

    /// Directions by the luminance of what is bright, with ∫ radiance dΩ of it (mean over RGB); none where nothing is.
    #[inline]
    pub(crate) fn bright_places(&self) -> Option<(&TexelChoice, f32)> {
        self.bright.as_ref().map(|bright| (&bright.choice, bright.power))
    }

    /// Bytes that it holds.
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&*self.texels) + self.bright.as_ref().map_or(0, |bright| bright.choice.memory_bytes())
    }

    #[inline]
    fn bright_part(&self, texel: Vec3) -> Vec3 {
        let luminance = luminance(texel);
        if luminance > self.even { texel * (1.0 - self.even / luminance) } else { Vec3::ZERO }
    }

    fn integral(&self, value: impl Fn(&SkyPicture, Vec3) -> Vec3) -> DVec3 {
        integral(self.grid, &self.texels, |texel| value(self, texel).as_dvec3())
    }
}

impl PartialEq for SkyPicture {
    fn eq(&self, other: &SkyPicture) -> bool {
        std::ptr::eq(self, other) || self.grid == other.grid && self.texels == other.texels
    }
}

impl std::fmt::Debug for SkyPicture {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SkyPicture").field("size", &self.size()).field("mean", &self.mean()).finish_non_exhaustive()
    }
}

/// Of linear Rec. 709.
#[inline]
fn luminance(color: Vec3) -> f32 {
    color.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

/// ∫ value dΩ.
fn integral(grid: Equirect, texels: &[Vec3], value: impl Fn(Vec3) -> DVec3) -> DVec3 {
    let rows = texels.chunks_exact(grid.width).enumerate();
    rows.map(|(row, texels)| texels.iter().map(|texel| value(*texel)).sum::<DVec3>() * grid.solid_angle(row)).sum()
}

fn mean(grid: Equirect, texels: &[Vec3], value: impl Fn(Vec3) -> f32) -> f64 {
    integral(grid, texels, |texel| DVec3::splat(f64::from(value(texel)))).x / (4.0 * PI)
}

/// The means of a picture over the texels of a coarser one, by solid angle.
fn averaged(from: Equirect, pixel: impl Fn((usize, usize)) -> Vec3, to: Equirect) -> Vec<Vec3> {
    if from == to {
        return (0..to.height).flat_map(|row| (0..to.width).map(move |column| (row, column))).map(pixel).collect();
    }
    let (rows, columns) = (overlaps(from.height, to.height), overlaps(from.width, to.width));
    let mut texels = Vec::with_capacity(to.width * to.height);
    for of_rows in &rows {
        for of_columns in &columns {
            let (mut sum, mut total) = (DVec3::ZERO, 0.0);
            for (row, top, bottom) in of_rows {
                let tall = (PI * top).cos() - (PI * bottom).cos();
                for (column, left, right) in of_columns {
                    let solid_angle = tall * (right - left);
                    sum += pixel((*row, *column)).as_dvec3() * solid_angle;
                    total += solid_angle;
                }
            }
            texels.push((sum / total).as_vec3());
        }
    }
    texels
}

/// For each of `to` equal parts of a line, which of `from` equal parts it covers, and from where to where along the line.
fn overlaps(from: usize, to: usize) -> Vec<Vec<(usize, f64, f64)>> {
    let along = |units: usize| units as f64 / (from * to) as f64;
    let part = |k: usize| {
        // In units of 1 / (from · to) nothing is rounded.
        let (low, high) = (k * from, (k + 1) * from);
        let of = |i: usize| (i, along(low.max(i * to)), along(high.min((i + 1) * to)));
        (low / to..high.div_ceil(to)).map(of).collect()
    };
    (0..to).map(part).collect()
}
