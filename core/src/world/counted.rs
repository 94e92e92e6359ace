//! How far elements lie apart where somebody says how many there are to be.

use rayon::prelude::*;

use super::World;
use super::build::scene_from_object;
use super::options::{WorldError, WorldOptions};
use crate::scene::Scene;
use crate::space::{Density, Distances, Layout, object_areas};
use crate::surface::Surface;

/// So much of what is asked for is near enough.
const NEAR: f64 = 0.97;

/// What is tried next aims at so much of it.
const AIM: f64 = 0.985;

/// Densities that are tried, at most.
const TRIES: usize = 24;

/// By this factor the spacing changes where nothing tells how far to go, and at most by this where it is told.
const STEP: f64 = 2.0;
const FAR: f64 = 8.0;

/// A factor on the spacing beyond which there are no fewer elements.
const COARSEST: f64 = 1e3;

/// Spacings this near to each other are not told apart.
const SAME: f64 = 1.002;

/// Elements of the world that tells which backs have some: few rays are as sure of it as many.
const ELEMENTS_TO_LOOK: usize = 20_000;

impl Density {
    /// The density at which a scene has nearly `elements` elements, and no more unless its pieces of surface are more.
    /// A ground is coarser than what stands on it as far as it is at the density that is chosen where nobody asks. The
    /// same on any number of threads.
    ///
    /// # Errors
    /// [`WorldError`]: an object cannot be laid out.
    pub fn of_elements(scene: &Scene, elements: usize) -> Result<Density, WorldError> {
        let areas = object_areas(scene);
        let chosen = Density::chosen(&areas);
        if areas.iter().sum::<f64>() <= 0.0 {
            return Ok(chosen);
        }
        let surfaces: Vec<Surface> = scene
            .objects
            .par_iter()
            .map(|object| {
                let error = |source| WorldError::Surface { object: object.name.clone(), source };
                Surface::build(object, scene_from_object(scene, object)).map_err(error)
            })
            .collect::<Result<_, _>>()?;
        let mut objects: Vec<Counted> =
            surfaces.iter().zip(areas).map(|(surface, area)| Counted { surface, area, sides: 1 }).collect();
        let density = nearest(chosen, &objects, elements);
        if !scene.objects.iter().flat_map(|object| &object.materials).any(|material| material.double_sided) {
            return Ok(density);
        }
        let looked = nearest(chosen, &objects, elements.min(ELEMENTS_TO_LOOK));
        let options = WorldOptions {
            spacing: Some(looked.spacing),
            object_squares: Some(looked.object_squares),
            max_elements: u32::MAX as usize,
            max_triangles: usize::MAX,
            ..WorldOptions::default()
        };
        let world = World::new(scene.clone(), &options)?;
        for (object, placed) in objects.iter_mut().zip(&world.placed) {
            object.sides = if placed.with_back { 2 } else { 1 };
        }
        Ok(nearest(chosen, &objects, elements))
    }
}

/// An object whose elements are counted.
struct Counted<'s> {
    surface: &'s Surface,
    /// m²
    area: f64,
    /// Sides that have elements.
    sides: usize,
}

/// The density whose elements are nearest below what is asked for.
fn nearest(chosen: Density, objects: &[Counted], elements: usize) -> Density {
    let (mut most, mut is_least) = (elements, false);
    let (mut scale, mut fine, mut coarse, mut last) = (1.0, None::<f64>, None::<f64>, None);
    for _ in 0..TRIES {
        let count = count(scaled(chosen, scale), objects, most);
        if let Some(count) = count.filter(|count| *count > most && scale >= COARSEST) {
            (most, is_least) = (count, true);
        }
        match count.filter(|count| *count <= most) {
            Some(count) if count as f64 >= NEAR * most as f64 && !is_least => return scaled(chosen, scale),
            Some(_) => coarse = Some(scale),
            None => fine = Some(scale),
        }
        let next = count.map(|count| toward(AIM * most as f64, (scale, count as f64), last));
        last = count.map(|count| (scale, count as f64)).or(last);
        scale = match (fine, coarse) {
            // Where there cannot be fewer, how much finer it might be matters little.
            (Some(fine), Some(coarse)) if coarse / fine < if is_least { STEP } else { SAME } => break,
            (Some(fine), Some(coarse)) => {
                let is_between = |next: &f64| (fine * SAME.sqrt()..coarse / SAME.sqrt()).contains(next);
                next.filter(is_between).unwrap_or((fine * coarse).sqrt())
            }
            (None, _) => next.unwrap_or(scale).clamp(scale / FAR, 0.9 * scale),
            (_, None) => next.unwrap_or(STEP * scale).clamp(1.1 * scale, FAR * scale),
        };
    }
    scaled(chosen, coarse.unwrap_or(scale))
}

/// The scale at which there would be so many elements, if they went with its inverse square: all of them, or those that are
/// not there at any scale, as two counts tell.
fn toward(aim: f64, (scale, count): (f64, f64), last: Option<(f64, f64)>) -> f64 {
    let squares = |scale: f64| scale.powi(-2);
    let per_square = match last {
        Some((other, known)) if (known - count) * (other - scale) < 0.0 => {
            (known - count) / (squares(other) - squares(scale))
        }
        _ => count / squares(scale),
    };
    let wanted = squares(scale) + (aim - count) / per_square;
    if wanted > 0.0 { wanted.powf(-0.5) } else { f64::INFINITY }
}

/// A density with everything so many times as far apart. A few digits are the same when they are read again from text.
fn scaled(chosen: Density, scale: f64) -> Density {
    let spacing = rounded(f64::from(chosen.spacing) * scale, 4) as f32;
    Density { spacing, object_squares: rounded(chosen.object_squares / (scale * scale), 6) }
}

/// A number to so many digits: one division of whole numbers.
fn rounded(x: f64, digits: i32) -> f64 {
    let power = digits - 1 - x.log10().floor() as i32;
    let unit = 10_f64.powi(power.abs());
    if power >= 0 { (x * unit).round() / unit } else { (x / unit).round() * unit }
}

/// Elements that objects have at a density; none where one has more than `most` by far, which is not counted to its end.
fn count(density: Density, objects: &[Counted], most: usize) -> Option<usize> {
    let limit = most.saturating_mul(FAR as usize);
    let of_object = |object: &Counted| {
        let distances = Distances::even(density.of_object(object.area));
        Some(Layout::count(object.surface, &distances, limit).ok()? * object.sides)
    };
    let counts: Option<Vec<usize>> = objects.par_iter().map(of_object).collect();
    counts.map(|counts| counts.iter().sum())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::Vec3;

    use super::*;
    use crate::scene::{Material, Mesh, Object};

    fn grey() -> Material {
        Material::diffuse(Vec3::splat(0.5))
    }

    /// A room with a box and a sheet of cloth that is seen from both sides, on a ground of so many metres.
    fn scene(ground: f32) -> Scene {
        let sheet = Mesh::quad(Vec3::new(1.0, 1.0, 1.0), Vec3::X * 2.0, Vec3::Y * 1.5);
        let corner = Vec3::new(-0.5 * ground, -0.1, -0.5 * ground);
        let mut objects = vec![
            Object::new("room", Mesh::cuboid(Vec3::ZERO, Vec3::new(4.0, 3.0, 5.0)).inside_out(), grey()),
            Object::new("box", Mesh::cuboid(Vec3::new(1.0, 0.01, 3.0), Vec3::new(1.7, 0.6, 3.9)), grey()),
            Object::new("sheet", sheet, grey().double_sided()),
        ];
        if ground > 0.0 {
            let mesh = Mesh::quad(corner, Vec3::Z * ground, Vec3::X * ground);
            objects.push(Object::new("ground", mesh, grey()));
        }
        Scene::from_objects(objects)
    }

    fn world(ground: f32, elements: usize) -> World {
        World::new(scene(ground), &WorldOptions { elements: Some(elements), ..WorldOptions::default() })
            .expect("a world")
    }

    #[test]
    fn there_are_nearly_as_many_elements_as_asked_for_and_no_more() {
        for ground in [0.0, 2000.0] {
            // Of a few hundred, one step of the room's edges is a tenth.
            for (asked, least) in [(300, 240), (1000, 900), (7000, 6300), (50_000, 48_000), (150_000, 145_000)] {
                let world = world(ground, asked);
                assert!(world.placed[2].with_back, "the sheet is seen from both sides");
                let count = world.element_count();
                assert!((least..=asked).contains(&count), "{ground} {asked}: {count}");
                let is_coarse = |warning: &String| warning.contains("\"ground\"");
                assert_eq!(world.scene.warnings.iter().any(is_coarse), ground > 0.0);
                assert!(world.scene.warnings.iter().all(is_coarse), "{:?}", world.scene.warnings);
            }
        }
    }

    #[test]
    fn every_piece_of_surface_has_an_element_whatever_is_asked_for() {
        let world = world(0.0, 10);
        // Of the walls, of the box, and of both sides of the cloth, which has too few vertices to share.
        assert_eq!(world.element_count(), 6 + 6 + 8);
        let told = &world.scene.warnings[0];
        assert!(told.contains("20 elements") && told.contains("10 were asked for"), "{told}");
    }

    #[test]
    fn a_file_may_have_more_vertices_than_elements_are_asked_for() {
        let mut scene = scene(0.0);
        scene.objects.push(Arc::new(Object::new("ball", Mesh::icosphere(0.3, 6), grey())));
        for asked in [1000, 4000] {
            let options = WorldOptions { elements: Some(asked), ..WorldOptions::default() };
            let world = World::new(scene.clone(), &options).expect("a world");
            let count = world.element_count();
            assert!(count <= asked && 10 * count > 7 * asked, "{asked}: {count}");
            assert!(world.scene.warnings.is_empty(), "{:?}", world.scene.warnings);
            // As a service builds it again.
            let options = WorldOptions { spacing: Some(world.spacing()), ..options };
            let again = World::new(scene.clone(), &options).expect("the same");
            assert_eq!(again.element_count(), count);
        }
    }

    #[test]
    fn a_density_is_the_same_when_it_is_read_again() {
        let chosen = Density { spacing: 0.1237, object_squares: 26_400.0 };
        for k in 1..200 {
            let density = scaled(chosen, 0.01 * f64::from(k));
            let [spacing, squares] = [f64::from(density.spacing), density.object_squares].map(|x| x.to_string());
            assert_eq!(spacing.parse::<f64>().ok().map(|x| x as f32), Some(density.spacing));
            assert_eq!(squares.parse(), Ok(density.object_squares));
            assert!(squares.len() <= 9, "{squares} has few digits");
        }
        let nothing = Density::of_elements(&Scene::from_objects(Vec::new()), 1000);
        assert_eq!(nothing.expect("nothing to lay out"), Density::chosen(&[]));
    }
}
