//! Pages of an atlas: what elements hold, read at the centres of texels.
//!
//! Every texel whose centre lies on a surface reads the light there as a ray that met the surface would, so both sides of
//! a seam read the same field; those beside an edge read the nearest point of it, and those beyond are filled from
//! them, so that bilinear look-ups and small mip levels meet no black. Where a smooth surface is cut, or goes on in another
//! object, texels beside the cut change a little, so that look-ups agree on both sides.

mod borders;
mod seams;
#[cfg(test)]
mod tests;

use glam::{DVec2, Vec2, Vec3};
use rayon::prelude::*;

use self::borders::Borders;
use crate::atlas::{Atlas, Entry, Rectangle, for_rows, nearest};
use crate::bvh::{Hit, Ray};
use crate::job::{Canceled, Observer};
use crate::surface::geometric_normal;
use crate::transport::Surfel;
use crate::world::World;

/// Look-ups of a point read texels whose centres are nearer than this, in either direction.
const REACH: f64 = 1.0;

/// Texels past those that were read that are filled.
const DILATION: usize = 4;

/// Texels per task.
const CHUNK: usize = 1024;

/// One page, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct TexelPage {
    /// Texels across.
    pub width: usize,
    /// Texels down.
    pub height: usize,
    /// What was read, per texel; zero where there is nothing.
    pub values: Vec<Vec3>,
    /// Whether a texel was read from a surface at its centre, or beside an edge less than a texel from it. What is
    /// filled past edges was not.
    pub valid: Vec<bool>,
}

/// Reads `values` (per element slot) for a page of an atlas of this world.
///
/// # Errors
/// [`Canceled`] where the observer says so; it is asked once per object.
///
/// # Panics
/// Where there is not one value per slot, or no such page.
pub fn read_page(
    world: &World,
    atlas: &Atlas,
    page: usize,
    values: &[Vec3],
    observer: &dyn Observer,
) -> Result<TexelPage, Canceled> {
    assert_eq!(values.len(), world.slots(), "one value per slot");
    let size = atlas.pages()[page];
    let (width, height) = (size.width as usize, size.height as usize);
    let entries = world.scene.objects.iter().enumerate().filter_map(|(k, o)| Some((k, atlas.entry(&o.name)?)));
    let sides = entries.flat_map(|(index, entry)| {
        let sides = [Some((&entry.front, false)), entry.back.as_ref().map(|back| (back, true))];
        sides.into_iter().flatten().map(move |(rectangle, is_back)| Side { index, entry, rectangle, is_back })
    });
    let sides: Vec<Side> = sides.filter(|side| side.rectangle.page == page).collect();
    let borders = Borders::new(world, atlas.texels_per_metre());
    let read = |side: &Side| if observer.canceled() { Err(Canceled) } else { Ok(side.read(world, &borders, values)) };
    let sheets: Vec<Sheet> = sides.par_iter().map(read).collect::<Result<_, _>>()?;
    let mut result =
        TexelPage { width, height, values: vec![Vec3::ZERO; width * height], valid: vec![false; width * height] };
    for (side, sheet) in sides.iter().zip(&sheets) {
        let ([x, y], w) = (side.rectangle.corner.map(|c| c as usize), sheet.width);
        for (row, (values, valid)) in sheet.values.chunks(w).zip(sheet.valid.chunks(w)).enumerate() {
            let start = (y + row) * width + x;
            result.values[start..start + w].copy_from_slice(values);
            result.valid[start..start + w].copy_from_slice(valid);
        }
    }
    Ok(result)
}

/// One side of an object.
struct Side<'a> {
    index: usize,
    entry: &'a Entry,
    rectangle: &'a Rectangle,
    is_back: bool,
}

/// What lies in a rectangle.
struct Sheet {
    width: usize,
    values: Vec<Vec3>,
    valid: Vec<bool>,
}

/// A point of a surface.
#[derive(Clone, Copy)]
struct Place {
    face: u32,
    /// Of the second and third corner.
    weights: [f32; 2],
}

impl Place {
    /// On the way to another place of the same face.
    fn towards(&self, other: &Place, t: f32) -> Place {
        let mix = |k: usize| self.weights[k] + (other.weights[k] - self.weights[k]) * t;
        Place { face: self.face, weights: [mix(0), mix(1)] }
    }
}

/// The point of a surface that is nearest to a texel's centre.
#[derive(Clone, Copy)]
struct Point {
    place: Place,
    /// Texels, squared.
    distance2: f32,
}

const NO_FACE: u32 = u32::MAX;

impl Side<'_> {
    fn read(&self, world: &World, borders: &Borders, values: &[Vec3]) -> Sheet {
        let width = self.rectangle.size[0] as usize;
        let points = self.points(world);
        let light =
            |point: &Point| (point.place.face != NO_FACE).then(|| self.light(world, &point.place, values)).flatten();
        let found: Vec<Option<Vec3>> = points.par_iter().with_min_len(CHUNK).map(light).collect();
        let valid: Vec<bool> = found.iter().map(Option::is_some).collect();
        let mut sheet = Sheet { width, values: found.into_iter().map(Option::unwrap_or_default).collect(), valid };
        let seams = seams::seams(&world.placed[self.index].surface, self.entry);
        let targets = borders::targets(world, self, borders.of(self.index), values);
        seams::close((&seams, &targets), width, &sheet.valid, &mut sheet.values);
        sheet.dilate();
        sheet
    }

    /// Per texel of the rectangle.
    fn points(&self, world: &World) -> Vec<Point> {
        let [width, height] = self.rectangle.size;
        let none = Point { place: Place { face: NO_FACE, weights: [0.0; 2] }, distance2: f32::INFINITY };
        let mut points = vec![none; width as usize * height as usize];
        let surface = &world.placed[self.index].surface;
        for (face, source) in surface.sources.iter().enumerate() {
            let corners = self.entry.places_of(*source);
            for_rows(corners, REACH, [width, height], |x, y| {
                let point = &mut points[y as usize * width as usize + x as usize];
                if point.distance2 == 0.0 {
                    return;
                }
                let (weights, distance2) = nearest(corners, DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
                if (distance2 as f32) < point.distance2 {
                    let weights = [weights[1] as f32, weights[2] as f32];
                    *point = Point { place: Place { face: face as u32, weights }, distance2: distance2 as f32 };
                }
            });
        }
        points
    }

    fn light(&self, world: &World, place: &Place, values: &[Vec3]) -> Option<Vec3> {
        light_of(world, (self.index, self.is_back), place, values)
    }

    /// Texels of the rectangle.
    fn on_rectangle(&self, world: &World, place: &Place) -> Vec2 {
        let [a, b, c] = self.entry.places_of(world.placed[self.index].surface.sources[place.face as usize]);
        let [u, v] = place.weights;
        a * (1.0 - u - v) + b * u + c * v
    }
}

/// Light of one side of an object, as a ray that meets the surface there reads it; none where no element knows it.
fn light_of(world: &World, (object, is_back): (usize, bool), place: &Place, values: &[Vec3]) -> Option<Vec3> {
    let placed = &world.placed[object];
    let [a, b, c] = placed.surface.corners(place.face as usize);
    let normal = geometric_normal(a, b, c)?;
    let [u, v] = place.weights;
    let origin = a * (1.0 - u - v) + b * u + c * v;
    let direction = if is_back { normal } else { -normal };
    let ray = Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY };
    let hit = Hit { t: 0.0, u, v, triangle: placed.placement.faces.start + place.face, normal };
    let value = Surfel::to_look_up(world, &ray, &hit, &mut 0)?.footprint?.interpolate(values);
    // Infinite errors that do not count.
    Some(if value.is_nan() { Vec3::INFINITY } else { value })
}

impl Sheet {
    /// Fills texels past those that are valid with the mean of their neighbours, ring by ring.
    fn dilate(&mut self) {
        let (width, height) = (self.width as i64, (self.values.len() / self.width.max(1)) as i64);
        let index = |x: i64, y: i64| (y * width + x) as usize;
        let around = |at: usize| {
            let (x, y) = (at as i64 % width, at as i64 / width);
            let all = (-1..=1).flat_map(move |dy| (-1..=1).map(move |dx| (x + dx, y + dy)));
            let within = all.filter(move |(x, y)| (0..width).contains(x) && (0..height).contains(y));
            within.map(move |(x, y)| index(x, y))
        };
        let mut is_full = self.valid.clone();
        let mut ring: Vec<usize> = (0..is_full.len()).filter(|&k| is_full[k]).collect();
        for _ in 0..DILATION {
            let mut next: Vec<usize> = ring.iter().flat_map(|&k| around(k)).filter(|&k| !is_full[k]).collect();
            next.sort_unstable();
            next.dedup();
            let mean = |&k: &usize| {
                let (sum, count) = around(k)
                    .filter(|&k| is_full[k])
                    .fold((Vec3::ZERO, 0.0), |(sum, count), k| (sum + self.values[k], count + 1.0));
                sum / count
            };
            let means: Vec<Vec3> = next.iter().map(mean).collect();
            for (&k, mean) in next.iter().zip(means) {
                (self.values[k], is_full[k]) = (mean, true);
            }
            ring = next;
        }
    }
}
