//! The error of resolution: how far off the light is that is read between elements, apart from the noise of the map. At
//! random points of the surfaces that can be seen, some exact samples (direct light, and one gather over the map) are
//! held against what is read there.
//!
//! Of a point's read light r and an independent exact estimate e, E\[(r − e)²\] = (E\[r\] − E\[e\])² + Var\[r\] + Var\[e\].
//! Both variances are known, so that their difference is an unbiased estimate of the squared error of resolution.

mod meter;

pub use meter::Meter;

use glam::{DVec3, Vec3};

use crate::bvh::{Hit, Ray};
use crate::job::{Canceled, Observer};
use crate::lightmap::{LightMap, LightPart};
use crate::points::{PointLight, PointOptions, light_at};
use crate::random::{Pcg32, subseed};
use crate::sampling::uniform_barycentrics;
use crate::space::Footprint;
use crate::surface::{geometric_normal, triangle_area};
use crate::transport::Surfel;
use crate::world::{Placed, Stated, World};

/// A mean of fewer squares is not told: a few of them are much larger than the others.
const LEAST_POINTS: u32 = 32;

/// Nor is one that is not so many times its standard error: its root is a quarter off then, at a standard error.
const LEAST_CERTAINTY: f64 = 2.0;

/// Part of the squared light that a squared difference of rounding may be.
const ROUNDING: f32 = 1e-11;

/// How much is sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ResolutionOptions {
    /// Points, one in every part of the surfaces of the same area; those that nobody can see do not count.
    pub points: u32,
    /// Samples per point: paths that are gathered, and rays to each light. At least two are taken.
    pub samples: u32,
    /// Seed of the random numbers.
    pub seed: u64,
}

/// Errors of resolution of a light map, of the light that its world states the error of ([`Stated`]).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ResolutionError {
    /// Of all surfaces that can be seen.
    pub all: MeanSquare,
    /// Of each object of the world, in its order.
    pub objects: Vec<MeanSquare>,
    /// Rays that were traced for it.
    pub rays: u64,
    /// Of one exact sample: variance, summed over all points.
    scatter: f64,
}

impl ResolutionError {
    /// This and another measurement of the same elements as one.
    fn pool(&mut self, other: &ResolutionError) {
        self.all.pool(other.all);
        self.objects.iter_mut().zip(&other.objects).for_each(|(own, other)| own.pool(*other));
        self.rays += other.rays;
        self.scatter += other.scatter;
    }
}

/// The mean of a squared error over the area, (irradiance / π)², mean over RGB.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MeanSquare {
    /// Points that it was measured at.
    pub points: u32,
    /// Of weights w and squared errors q: w, w q, w², w² q, w² q².
    sums: [f64; 5],
}

impl MeanSquare {
    /// Adds a squared error by its weight, which is of the samples that it was measured with.
    fn add(&mut self, square: f64, weight: f64) {
        self.points += 1;
        let (value, weight2) = (weight * square, weight * weight);
        let added = [weight, value, weight2, weight * value, value * value];
        self.sums.iter_mut().zip(added).for_each(|(sum, added)| *sum += added);
    }

    /// What it is kept by: points, and sums over them.
    pub fn sums(&self) -> (u32, [f64; 5]) {
        (self.points, self.sums)
    }

    /// As it was kept ([`MeanSquare::sums`]).
    pub fn of_sums((points, sums): (u32, [f64; 5])) -> MeanSquare {
        MeanSquare { points, sums }
    }

    fn pool(&mut self, other: MeanSquare) {
        self.points += other.points;
        self.sums.iter_mut().zip(other.sums).for_each(|(sum, other)| *sum += other);
    }

    /// The mean; unbiased, and below zero where chance has it so.
    pub fn mean(&self) -> f64 {
        if self.points > 0 { self.sums[1] / self.sums[0] } else { 0.0 }
    }

    /// Standard error of the mean; infinite of less than two points.
    pub fn standard_error(&self) -> f64 {
        if self.points < 2 {
            return f64::INFINITY;
        }
        let (mean, [all, _, ww, wwq, wwqq]) = (self.mean(), self.sums);
        let n = f64::from(self.points);
        ((wwqq - 2.0 * mean * wwq + mean * mean * ww).max(0.0) * n / (n - 1.0)).sqrt() / all
    }

    /// The root of the mean: the error of resolution, irradiance / π. None where it was measured at too few points, or
    /// is too small to be told from the noise of the samples.
    pub fn rmse(&self) -> Option<f32> {
        let is_known = self.points >= LEAST_POINTS && self.mean() > LEAST_CERTAINTY * self.standard_error();
        is_known.then(|| self.mean().sqrt() as f32)
    }
}

/// Measures the error of resolution of a light map. None where its noise is not known, as after a single round. The same
/// inputs and seed give the same bits on any number of threads.
///
/// # Errors
/// [`Canceled`] where the observer says so.
///
/// # Panics
/// Where the map has not one value per slot of the world.
pub fn resolution_error(
    world: &World,
    map: &LightMap,
    options: &ResolutionOptions,
    observer: &dyn Observer,
) -> Result<Option<ResolutionError>, Canceled> {
    error_against((world, map), (world, map), options, observer)
}

/// As [`resolution_error`], with exact samples that are gathered over another map, of the same scene: over one with much
/// finer elements what a map has wrong everywhere, since it holds too little of the light that is sent out, is in its
/// error, too.
///
/// # Errors
/// [`Canceled`] where the observer says so.
///
/// # Panics
/// Where a map has not one value per slot of its world.
pub fn error_against(
    of: (&World, &LightMap),
    exact: (&World, &LightMap),
    options: &ResolutionOptions,
    observer: &dyn Observer,
) -> Result<Option<ResolutionError>, Canceled> {
    let Some(points) = differences(of, exact, options, observer)? else { return Ok(None) };
    let mut error = ResolutionError { objects: vec![MeanSquare::default(); of.0.placed.len()], ..Default::default() };
    for point in &points {
        let variance = point.noise + f64::from(point.exact.error).powi(2);
        let square = point.square() - variance;
        // What is left of rounding is none.
        let rounding = f64::from(ROUNDING * point.exact.light.length_squared());
        let square = if square.abs() > rounding { square } else { 0.0 };
        error.rays += point.exact.rays;
        if square.is_finite() {
            let samples = f64::from(options.samples.max(2));
            error.all.add(square, samples);
            error.objects[point.object].add(square, samples);
            error.scatter += samples * f64::from(point.exact.error).powi(2);
        }
    }
    Ok(Some(error))
}

/// Light that is read at a point between elements, and what is there.
#[derive(Clone, Copy, Debug)]
pub struct Difference {
    /// Index of the object.
    pub object: usize,
    /// As it is read, irradiance / π.
    pub read: Vec3,
    /// Variance of what is read, by that of the elements, mean over RGB.
    pub noise: f64,
    /// As it is.
    pub exact: PointLight,
}

impl Difference {
    /// Squared difference, mean over RGB: of resolution and of noise.
    pub fn square(&self) -> f64 {
        f64::from((self.read - self.exact.light).length_squared()) / 3.0
    }
}

/// What [`error_against`] makes its mean of, point by point: random points of the surfaces that can be seen, evenly over
/// their area.
///
/// # Errors
/// [`Canceled`] where the observer says so.
///
/// # Panics
/// Where a map has not one value per slot of its world.
pub fn differences(
    (world, map): (&World, &LightMap),
    (exact_world, exact_map): (&World, &LightMap),
    options: &ResolutionOptions,
    observer: &dyn Observer,
) -> Result<Option<Vec<Difference>>, Canceled> {
    assert_eq!(map.len(), world.slots(), "a light map has one value per slot");
    if map.light.variance.is_empty() {
        return Ok(None);
    }
    let part = match world.stated() {
        Stated::Full => LightPart::Full,
        Stated::Indirect => LightPart::Indirect,
    };
    let values = map.light.part(part);
    let places = surface_points(world, options);
    let points: Vec<(DVec3, Vec3)> =
        places.iter().map(|place| (world.scene.origin + place.point.as_dvec3(), place.normal)).collect();
    let seed = subseed(options.seed, 0xe8ac);
    let exact =
        light_at(exact_world, exact_map, &points, &PointOptions { part, samples: options.samples, seed }, observer)?;
    let difference = |(place, exact): (&SurfacePoint, PointLight)| {
        let noise: f32 =
            place.footprint.slots_and_weights().map(|(slot, w)| w * w * map.light.variance[slot as usize]).sum();
        Difference { object: place.object, read: place.footprint.interpolate(&*values), noise: f64::from(noise), exact }
    };
    Ok(Some(places.iter().zip(exact).map(difference).collect()))
}

/// The stated error of each object of the world, in its order: the root of the mean variance over its elements. None
/// where nothing is known of it.
pub fn noise_of_objects(world: &World, map: &LightMap) -> Vec<Option<f32>> {
    let variance = &map.light.variance;
    let of_object = |placed: &Placed| {
        let slots = placed.placement.element_indices();
        let is_known = !slots.is_empty() && slots.end <= variance.len();
        is_known.then(|| world.area_mean(slots, |slot| f64::from(variance[slot])).sqrt() as f32)
    };
    world.placed.iter().map(|placed| of_object(placed)).collect()
}

/// Where light is read and sampled.
struct SurfacePoint {
    /// Index of the object.
    object: usize,
    /// Scene space, on the round surface that shading normals promise.
    point: Vec3,
    /// Unit, of the side that is meant.
    normal: Vec3,
    footprint: Footprint,
}

/// One point in every part of the surfaces of the same area, of those that can be seen.
fn surface_points(world: &World, options: &ResolutionOptions) -> Vec<SurfacePoint> {
    let sides = |placed: &Placed| if placed.with_back { 2 } else { 1 };
    let area = |placed: &Placed| sides(placed) as f64 * placed.surface.all_corners().map(triangle_area).sum::<f64>();
    let all: f64 = world.placed.iter().map(|placed| area(placed)).sum();
    let step = all / f64::from(options.points.max(1));
    let mut rng = Pcg32::new(options.seed, 0x9e50);
    let (mut places, mut done, mut next) = (Vec::new(), 0.0, step * f64::from(rng.next_f32()));
    let mut stratum = 1.0;
    for (object, placed) in world.placed.iter().enumerate() {
        for is_back in [false, true].into_iter().take(sides(placed)) {
            for (face, corners) in placed.surface.all_corners().enumerate() {
                done += triangle_area(corners);
                while next < done {
                    let place = point_on(world, (object, placed), (face, corners), is_back, rng.next_2d());
                    places.extend(place.filter(|place| !world.is_in_solid(place.point, place.normal, &mut rng)));
                    next = step * (stratum + f64::from(rng.next_f32()));
                    stratum += 1.0;
                }
            }
        }
    }
    places
}

/// A point of a triangle; none where no element knows the light there.
fn point_on(
    world: &World,
    (object, placed): (usize, &Placed),
    (face, corners): (usize, [Vec3; 3]),
    is_back: bool,
    u: [f32; 2],
) -> Option<SurfacePoint> {
    let [a, b, c] = corners;
    let flat = geometric_normal(a, b, c)?;
    let (u, v) = uniform_barycentrics(u);
    let on_face = a + (b - a) * u + (c - a) * v;
    let direction = if is_back { flat } else { -flat };
    let ray = Ray { origin: on_face, direction, t_min: 0.0, t_max: f32::INFINITY };
    let hit = Hit { t: 0.0, u, v, triangle: placed.placement.faces.start + face as u32, normal: flat };
    let footprint = Surfel::to_look_up(world, &ray, &hit, &mut 0)?.footprint?;
    let mean = |values: &dyn Fn(usize) -> Vec3| {
        footprint.slots_and_weights().map(|(slot, w)| values(slot as usize) * w).sum::<Vec3>()
    };
    let normal = mean(&|slot| world.normals()[slot]).try_normalize()?;
    let lift = (mean(&|slot| world.positions()[slot]) - on_face).dot(normal).max(0.0);
    Some(SurfacePoint { object, point: on_face + normal * lift, normal, footprint })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::bake;
    use crate::job::{Budget, Unobserved};
    use crate::scene::{Light, LightKind, Material, Mesh, Object, Scene};
    use crate::world::WorldOptions;

    fn floor(spacing: f32, light: Option<LightKind>) -> World {
        let mesh = Mesh::quad(Vec3::new(-2.0, 0.0, -2.0), Vec3::Z * 4.0, Vec3::X * 4.0);
        let mut scene = Scene::from_objects(vec![Object::new("floor", mesh, Material::diffuse(Vec3::ZERO))]);
        scene.lights.extend(light.map(|kind| Light { name: "l".into(), kind, color: Vec3::ONE, intensity: 3.0 }));
        World::new(scene, &WorldOptions { spacing: Some(spacing), ..WorldOptions::default() }).expect("a world")
    }

    fn measured(world: &World, map: &LightMap, options: ResolutionOptions) -> MeanSquare {
        let error =
            resolution_error(world, map, &options, &Unobserved).expect("nobody cancels").expect("noise is known");
        assert_eq!(error.objects[0], error.all, "there is one object");
        error.all
    }

    /// Nothing shines, and the map says 0.3 x with noise of known variance: the squared error is the mean of 0.09 x²,
    /// whatever the noise.
    #[test]
    fn noise_is_not_taken_for_an_error_of_resolution() {
        let world = floor(0.1, None);
        let mut squares = Vec::new();
        for seed in 0..24 {
            let mut rng = Pcg32::new(7, seed);
            let mut map = LightMap::black(world.slots());
            for slot in 0..world.slots() {
                // Uniform numbers have a variance of 1/12.
                let noise = 0.5 * (rng.next_f32() - 0.5);
                map.light.direct[slot] = Vec3::splat(0.3 * world.positions()[slot].x + noise);
                map.light.variance[slot] = 0.25 / 12.0;
            }
            squares.push(measured(&world, &map, ResolutionOptions { points: 500, samples: 2, seed }));
        }
        let n = squares.len() as f64;
        let mean = squares.iter().map(MeanSquare::mean).sum::<f64>() / n;
        let error = squares.iter().map(|s| (s.mean() - mean).powi(2)).sum::<f64>().sqrt() / n;
        // Mean of x² over −2..2; elements at the border are a little inside of it.
        let exact = 0.09 * 4.0 / 3.0;
        assert!((mean - exact).abs() < 4.0 * error + 1e-3 * exact, "{mean} {exact} ± {error}");
        let stated = (squares.iter().map(|s| s.standard_error().powi(2)).sum::<f64>() / n).sqrt();
        assert!(
            (0.8..2.0).contains(&(stated / (error * n.sqrt()))),
            "{stated} {error}: strata may only make it better"
        );
    }

    /// A lamp above a floor: what is read between elements against I h / (π r³), on a grid of points, in three
    /// resolutions.
    #[test]
    fn it_is_the_error_that_a_dense_grid_shows() {
        let lamp = DVec3::new(0.13, 0.5, -0.21);
        let exact = |p: Vec3| 3.0 * lamp.y / (std::f64::consts::PI * (p.as_dvec3() - lamp).length().powi(3));
        let mut last = f64::INFINITY;
        for spacing in [1.0, 0.5, 0.25] {
            let world = floor(spacing, Some(LightKind::Point { position: lamp, range: None }));
            let budget = Budget { samples_per_element: 8, target_rmse: None };
            let map = bake(&world, &budget, 1, &Unobserved).expect("nobody cancels");
            let found = measured(&world, &map, ResolutionOptions { points: 6000, samples: 2, seed: 3 });
            let values = map.light.part(LightPart::Direct);
            let mut rng = Pcg32::new(1, 1);
            let corners: Vec<[Vec3; 3]> = world.placed[0].surface.all_corners().collect();
            let (mut sum, mut count) = (0.0, 0.0);
            for k in 0..100_000 {
                let (face, u) = (k % corners.len(), rng.next_2d());
                let place = point_on(&world, (0, &world.placed[0]), (face, corners[face]), false, u).expect("a place");
                sum += (f64::from(place.footprint.interpolate(&*values).x) - exact(place.point)).powi(2);
                count += 1.0;
            }
            let (dense, error) = (sum / count, found.standard_error());
            assert!((found.mean() - dense).abs() < 4.0 * error, "{spacing}: {} {dense} ± {error}", found.mean());
            let rmse = f64::from(found.rmse().expect("it is told from noise"));
            assert!((rmse / dense.sqrt()).ln().abs() < 1.5_f64.ln() && rmse < last, "{spacing}: {rmse}");
            last = rmse;
        }
    }

    #[test]
    fn what_is_not_known_is_not_told() {
        let world = floor(0.5, Some(LightKind::Environment));
        let options = ResolutionOptions { points: 200, samples: 4, seed: 1 };
        let mut map =
            bake(&world, &Budget { samples_per_element: 16, target_rmse: None }, 1, &Unobserved).expect("a map");
        // The light of an open sky is the same everywhere.
        assert_eq!(measured(&world, &map, options).rmse(), None);
        assert_eq!(measured(&world, &map, ResolutionOptions { points: 8, ..options }).rmse(), None);
        std::sync::Arc::make_mut(&mut map).light.variance.clear();
        assert_eq!(resolution_error(&world, &map, &options, &Unobserved), Ok(None));
    }
}
