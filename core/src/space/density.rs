//! How far elements lie apart: chosen for a scene where nobody says so, and farther on what is too large for that.

use rayon::prelude::*;

use crate::scene::Scene;
use crate::surface::object_area;

/// Squares of one spacing that a scene is laid out with where nobody says how finely. Large flat surfaces get two to
/// three elements per square.
const DEFAULT_SQUARES: usize = 22_000;

/// Most elements per square: it is the diagonals of squares that must not exceed the spacing.
const ELEMENTS_PER_SQUARE: f64 = 3.0;

/// What has so many times the area of all smaller objects together is what they stand on or under: a ground, a dome.
const GROUND: f64 = 25.0;

/// An object of the usual size has fewer squares than these, whatever its spacing is rounded to.
const OBJECT_SQUARES: f64 = 1.2 * DEFAULT_SQUARES as f64;

/// The others get at least this part of [`DEFAULT_SQUARES`] then.
const LEAST_SHARE: f64 = 0.25;

/// How finely elements are laid out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Density {
    /// Largest distance between neighbouring elements, metres.
    pub spacing: f32,
    /// No object gets more squares of its spacing than these: the elements of larger ones lie farther apart.
    pub object_squares: f64,
}

impl Density {
    /// What is chosen for a scene: elements as if its area were 22,000 squares of one spacing, unless it lies on a
    /// ground (or under a dome) that would have them all. That one gets so many, and what stands on it its own.
    ///
    /// `areas`: of its objects, m² ([`object_areas`]).
    pub fn chosen(areas: &[f64]) -> Density {
        let mut areas = areas.to_vec();
        areas.sort_unstable_by(|a, b| b.total_cmp(a));
        let all: f64 = areas.iter().sum();
        // A ground, or a ground and a dome where there is more than a few objects.
        let most = if areas.len() < 5 { 1 } else { 2 };
        let split = (1..areas.len().min(most + 1)).map(|count| (areas[count - 1], areas[count..].iter().sum::<f64>()));
        let ground = split.into_iter().find(|(ground, rest)| *rest > 0.0 && *ground > GROUND * rest);
        // At the ratio where it begins it changes nothing.
        let of_rest =
            |(ground, rest): (f64, f64)| rest * ((GROUND + 1.0) * GROUND * rest / ground).max(1.0 / LEAST_SHARE);
        let effective = ground.map_or(all, of_rest).min(all);
        Density { spacing: default_spacing(effective, DEFAULT_SQUARES), object_squares: OBJECT_SQUARES }
    }

    /// The spacing of a scene whose objects have these areas (m²), metres, whatever it is that has the area.
    pub(crate) fn even_spacing(areas: &[f64]) -> f32 {
        default_spacing(areas.iter().sum(), DEFAULT_SQUARES)
    }

    /// Every object alike.
    pub fn even(spacing: f32) -> Density {
        Density { spacing, object_squares: f64::INFINITY }
    }

    /// This, with elements farther apart on the largest objects where the scene would have more than `max_elements`
    /// otherwise. Most objects keep their spacing, or there is no such density.
    ///
    /// `areas`: of its objects, m² ([`object_areas`]), which have so many vertices in all.
    pub fn within(self, areas: &[f64], vertices: usize, max_elements: usize) -> Option<Density> {
        let mut squares: Vec<f64> = areas.iter().map(|area| self.squares(*area)).collect();
        let room = (max_elements as f64 - vertices as f64) / ELEMENTS_PER_SQUARE;
        let mut left = room - squares.iter().sum::<f64>();
        if left >= 0.0 {
            return Some(self);
        }
        squares.sort_unstable_by(|a, b| b.total_cmp(a));
        for (count, large) in squares.iter().enumerate().take(squares.len() / 2) {
            // What the larger ones and this one may have, if they share it evenly.
            left += large;
            let share = left / (count + 1) as f64;
            if share >= squares.get(count + 1).copied().unwrap_or(0.0) && share > 0.0 {
                return Some(Density { object_squares: share, ..self });
            }
        }
        None
    }

    /// Metres between neighbouring elements of an object of `area` m², at most.
    pub fn of_object(&self, area: f64) -> f32 {
        self.spacing.max((area / self.object_squares).sqrt() as f32)
    }

    /// Elements that objects of these areas (m²) and so many vertices in all have at most.
    pub fn elements(&self, areas: &[f64], vertices: usize) -> f64 {
        vertices as f64 + ELEMENTS_PER_SQUARE * areas.iter().map(|area| self.squares(*area)).sum::<f64>()
    }

    /// Squares of its spacing that an object of `area` m² has.
    fn squares(&self, area: f64) -> f64 {
        (area / f64::from(self.spacing).powi(2)).min(self.object_squares)
    }
}

/// m² of each object of a scene, in order: sums of them are the same on any number of threads.
pub fn object_areas(scene: &Scene) -> Vec<f64> {
    scene.objects.par_iter().map(|object| object_area(object)).collect()
}

/// The spacing in metres at which `total_area` (m²) has about `elements` squares of that side, rounded to two digits.
///
/// Large flat surfaces get two to three elements per square, since it is the diagonals that must not exceed the
/// spacing.
fn default_spacing(total_area: f64, elements: usize) -> f32 {
    let spacing = (total_area / elements.max(1) as f64).sqrt();
    if !(spacing.is_finite() && spacing > 0.0) {
        return 1.0;
    }
    let unit = 10_f64.powf(spacing.log10().floor() - 1.0);
    let rounded = ((spacing / unit).round() * unit) as f32;
    if rounded.is_finite() && rounded > 0.0 { rounded } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::scene::{Material, Mesh, Object};

    /// Squares of these areas, m².
    fn scene(areas: &[f32]) -> Scene {
        let square = |(index, area): (usize, &f32)| {
            let mesh = Mesh::quad(Vec3::ZERO, Vec3::Z * area.sqrt(), Vec3::X * area.sqrt());
            Object::new(index.to_string(), mesh, Material::diffuse(Vec3::ONE))
        };
        Scene::from_objects(areas.iter().enumerate().map(square).collect())
    }

    #[test]
    fn a_ground_does_not_decide_for_what_stands_on_it() {
        let even = |areas: &[f32]| default_spacing(areas.iter().map(|a| f64::from(*a)).sum(), DEFAULT_SQUARES);
        for usual in [
            &[10.0_f32][..],
            &[100.0, 40.0, 5.0],
            &[20.0, 1.0],
            &[4e6, 1e6],
            &[90.0, 40.0, 5.0, 0.01],
            &[9.0, 0.5],
            &[0.3],
            &[],
        ] {
            let density = Density::chosen(&object_areas(&scene(usual)));
            assert_eq!(density.spacing, even(usual), "{usual:?}");
            assert!(usual.iter().all(|area| density.of_object(f64::from(*area)) <= density.spacing));
        }
        for ground in [&[1e6_f32, 120.0, 80.0][..], &[1e6, 200.0], &[4e6, 1e6, 50.0, 70.0, 80.0]] {
            let density = Density::chosen(&object_areas(&scene(ground)));
            assert!((0.15..0.2).contains(&density.spacing), "{density:?}");
            let of_ground = density.of_object(1e6);
            assert!((6.0..6.3).contains(&of_ground), "{of_ground}");
        }
        // A little more ground changes little.
        let of = |ground: f64| Density::chosen(&[ground, 1.0]).spacing;
        assert!((of(25.5) / of(24.5) - 1.0).abs() < 0.05);
    }

    #[test]
    fn a_limit_is_met_by_what_is_large() {
        let density = Density::even(0.1);
        let areas = [1000.0, 500.0, 10.0, 10.0, 10.0];
        assert_eq!(density.within(&areas, 20, 1_000_000), Some(density));
        for limit in [20_000, 50_000, 200_000, 400_000] {
            let within = density.within(&areas, 20, limit).unwrap();
            let elements = within.elements(&areas, 20);
            assert!(elements <= 1.001 * limit as f64 && elements > 0.99 * limit as f64, "{limit}: {elements}");
            assert_eq!((within.spacing, within.of_object(10.0)), (0.1, 0.1));
        }
        // Not by all of them.
        assert_eq!(density.within(&areas, 20, 10_000), None);
        assert_eq!(density.within(&[100.0], 4, 9_000), None);
    }

    #[test]
    fn default_spacing_has_two_digits() {
        assert_eq!(default_spacing(130.0 * 0.0123 * 0.0123, 130), 0.012);
        assert_eq!(default_spacing(0.0, 100), 1.0);
        assert_eq!(default_spacing(f64::NAN, 100), 1.0);
        assert_eq!(default_spacing(f64::INFINITY, 100), 1.0);
        assert!(default_spacing(1e-300, 100) > 0.0);
    }
}
