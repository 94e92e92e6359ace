//! Bright spots: few cells that send out much of all light, such as what a lamp near a wall, or the sun through a
//! window, lights. Directions towards them are sampled along with those by the cosine, which seldom find them, and both
//! are combined by the balance heuristic (Veach and Guibas 1995). The light of an update is a change and
//! its spots may be dark ones.

use std::f32::consts::PI;
use std::ops::Range;
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::Surfel;
use super::walk::is_near;
use super::work::sums;
use crate::bvh::Hit;
use crate::sampling::{Discrete, uniform_barycentrics};
use crate::space::Patch;
use crate::value::Value;
use crate::world::{Placed, World};

/// Radiance over the mean one from which on a cell belongs to a spot.
const BRIGHT: f64 = 8.0;

/// Part of all squared radiance from which on spots are worth directions of their own.
const WORTHWHILE: f64 = 0.5;

/// Part of all squared radiance, of the change that an update carries on, from which on spots are worth directions of
/// their own: those of furniture have .92 to .98, and there it does not pay.
const EXTREME: f64 = 0.98;

/// Places per task, and per partial sum: fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 4096;

/// Where to aim.
#[derive(Clone, Debug)]
pub(crate) struct Spots {
    targets: Vec<Target>,
    /// By power.
    choice: Discrete,
    /// Per id of a cell, front and back: density of aimed points, 1/m²; zero off all spots.
    densities: Vec<[f32; 2]>,
}

/// One side of a cell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Target {
    /// Id of the cell.
    pub cell: u32,
    /// Its back is meant.
    pub back: bool,
    /// Counter-clockwise from the front.
    pub corners: [Vec3; 3],
    /// Longest side of the boxes of the object's triangles, m: rays start off it by as much as hits are inexact.
    pub extent: f32,
    /// Element slots of the corners, on this side.
    pub elements: [u32; 3],
    /// Diffuse albedo.
    pub albedo: Vec3,
}

impl Target {
    /// A point and the normal on this side there, from two numbers in [0, 1).
    #[inline]
    pub(crate) fn point(&self, u: [f32; 2]) -> From {
        let [a, b, c] = self.corners;
        let (b1, b2) = uniform_barycentrics(u);
        let n = (b - a).cross(c - a).normalize_or_zero();
        (a + (b - a) * b1 + (c - a) * b2, if self.back { -n } else { n })
    }
}

/// Where a path begins: a point and its unit normal.
pub(crate) type From = (Vec3, Vec3);

impl Spots {
    /// The spots of light sent out; `radiance(side)` tells its amount. None where there are none worth it.
    pub(crate) fn new(world: &World, radiance: impl Fn(&Target) -> f32 + Sync) -> Option<Spots> {
        let amounts_of = |placed: &Arc<Placed>| sides(world, placed, |area, target| Some((area, radiance(&target))));
        let amounts: Vec<Vec<(f32, f32)>> = world.placed.par_iter().map(amounts_of).collect();
        let places = || amounts.par_iter().map(|of_object| of_object.iter().copied());
        let limit = limit(places());
        (share_of_bright(places(), limit) > WORTHWHILE).then_some(())?;
        let has_bright = |(_, amounts): &(_, &Vec<(f32, f32)>)| amounts.iter().any(|(_, radiance)| *radiance > limit);
        // In the same order as before: radiance is costly, what it was is not asked again.
        let bright = |(placed, amounts): (&Arc<Placed>, &Vec<(f32, f32)>)| -> Vec<Spot> {
            let targets = sides(world, placed, |_, target| Some(target));
            let spots = targets.into_iter().zip(amounts).filter(|(_, (_, radiance))| *radiance > limit);
            spots.map(|(target, &(area, radiance))| Spot { target, area, power: area * radiance }).collect()
        };
        let objects = world.placed.par_iter().zip(&amounts).filter(has_bright);
        Spots::of(world, &objects.flat_map_iter(bright).collect::<Vec<Spot>>())
    }

    /// The spots of a light map, irradiance / π per slot, by what each layer weighs.
    pub(crate) fn of_map<V: Value>(world: &World, light: &[V], weights: &[Vec3]) -> Option<Spots> {
        Spots::of_most(world, light, weights, (WORTHWHILE, false))
    }

    /// The spots of a change: where nearly all of it is in few of the places that change.
    pub(crate) fn of_change<V: Value>(world: &World, light: &[V], weights: &[Vec3]) -> Option<Spots> {
        Spots::of_most(world, light, weights, (EXTREME, true))
    }

    /// The spots where bright places have at least so much of all squared light; `None` elsewhere. Whether places that are
    /// black count for nothing: what an edit does not reach must not make all that it does reach a bright spot.
    fn of_most<V: Value>(
        world: &World,
        light: &[V],
        weights: &[Vec3],
        (least, without_black): (f64, bool),
    ) -> Option<Spots> {
        let amount = |light: V| light.weighted(weights).abs();
        let amounts: Vec<f32> = light.par_iter().with_min_len(CHUNK).map(|l| amount(*l).element_sum()).collect();
        let places = || {
            let areas = |first: usize, count: usize| world.areas().range(first..first + count).copied();
            let counts = move |(_, amount): &(f32, f32)| !without_black || *amount > 0.0;
            let chunks = amounts.par_chunks(CHUNK).enumerate();
            chunks.map(move |(k, amounts)| areas(k * CHUNK, amounts.len()).zip(amounts.iter().copied()).filter(counts))
        };
        let limit = limit(places());
        (share_of_bright(places(), limit) > least).then_some(())?;
        // Most objects have no bright element, and of the others most cells have none.
        let has_bright = |placed: &&Arc<Placed>| amounts[placed.placement.element_indices()].iter().any(|a| *a > limit);
        let bright = |placed: &Arc<Placed>| {
            sides(world, placed, |area, target| {
                let bright = target.elements.iter().any(|&e| amounts[e as usize] > limit);
                let mean = bright.then(|| target.elements.map(|e| light[e as usize]).into_iter().sum::<V>() / 3.0);
                let mean = amount(mean?);
                let power = area * (mean * target.albedo).element_sum();
                (mean.element_sum() > limit).then_some(Spot { target, area, power })
            })
        };
        let objects = world.placed.par_iter().filter(has_bright);
        Spots::of(world, &objects.flat_map_iter(bright).collect::<Vec<Spot>>())
    }

    fn of(world: &World, spots: &[Spot]) -> Option<Spots> {
        let choice = Discrete::new(spots.iter().map(|s| f64::from(s.power)))?;
        let mut densities = vec![[0.0; 2]; world.space.cells()];
        for (k, s) in spots.iter().enumerate() {
            densities[s.target.cell as usize][usize::from(s.target.back)] = choice.pdf(k) / s.area;
        }
        Some(Spots { targets: spots.iter().map(|s| s.target).collect(), choice, densities })
    }

    /// A direction to a spot and the cell to be met there; none where it is below a horizon.
    #[inline]
    pub(crate) fn aim(&self, (point, n): From, [u, v]: [f32; 2]) -> Option<(Vec3, u32)> {
        let (index, u) = self.choice.sample(u);
        let target = &self.targets[index];
        let (there, normal) = target.point([u, v]);
        let w = there - point;
        (n.dot(w) > 0.0 && normal.dot(w) < 0.0).then(|| (w.normalize(), target.cell))
    }

    /// How densely directions from where a ray begins are aimed at the cell that it met, per unit of solid angle.
    #[inline]
    pub(crate) fn towards(&self, direction: Vec3, hit: &Hit, cell: u32) -> f32 {
        let cos = -hit.normal.dot(direction);
        let density = self.densities[cell as usize][usize::from(cos < 0.0)];
        if density == 0.0 { 0.0 } else { density * hit.t * hit.t / cos.abs().max(f32::MIN_POSITIVE) }
    }

    /// How much of what a surface sends to a point counts where `ratio` directions are aimed for each drawn by the
    /// cosine, whichever met it: the balance heuristic. All of it where none is aimed at.
    #[inline]
    pub(crate) fn share(&self, world: &World, (point, n): From, surfel: &Surfel, ratio: f32) -> f32 {
        let density = self.densities[surfel.cell as usize][usize::from(surfel.is_back)];
        if density == 0.0 {
            return 1.0;
        }
        let w = surfel.position - point;
        let distance2 = w.length_squared();
        // cos_there / distance² and cos_here / π, both times the distance.
        let (here, there) = (n.dot(w), -surfel.normal.dot(w));
        let is_near = || surfel.footprint.is_none_or(|footprint| is_near(world, &footprint, distance2));
        if here <= 0.0 || there <= 0.0 || is_near() {
            return 1.0;
        }
        1.0 / (1.0 + ratio * density * PI * distance2 * distance2 / (here * there))
    }
}

/// Amount from which on a place is bright, of chunks of places (area, amount).
fn limit<I: Iterator<Item = (f32, f32)>>(places: impl IndexedParallelIterator<Item = I>) -> f32 {
    let [area, power] = sums(places, |(area, amount)| [area, area * amount].map(f64::from));
    (BRIGHT * power / area) as f32
}

/// Part of Σ A x² that places above `limit` have.
fn share_of_bright<I: Iterator<Item = (f32, f32)>>(places: impl IndexedParallelIterator<Item = I>, limit: f32) -> f64 {
    let [all, bright] = sums(places, |(area, amount)| {
        let square = f64::from(area) * f64::from(amount) * f64::from(amount);
        [square, if amount > limit { square } else { 0.0 }]
    });
    bright / all
}

/// A bright side.
struct Spot {
    target: Target,
    /// m².
    area: f32,
    /// Radiance × area.
    power: f32,
}

/// What `f` makes of all sides of an object's cells that have elements, with their areas (m²).
fn sides<T: Send>(world: &World, placed: &Placed, f: impl Fn(f32, Target) -> Option<T> + Sync) -> Vec<T> {
    let parts = world.space.parts_of(&placed.placement);
    let of_cell = |patch: &Patch| {
        let corners @ [a, b, c] = patch.corners;
        let area = 0.5 * (b - a).cross(c - a).length();
        let part = &parts[placed.surface.triangle_materials[patch.face as usize] as usize];
        let albedo = match &part.albedos {
            None => part.albedo,
            Some(albedos) => patch.elements.map(|e| albedos[e as usize]).into_iter().sum::<Vec3>() / 3.0,
        };
        let cell = placed.placement.cells.start + patch.cell;
        let side = |(side, back): (Range<u32>, bool)| {
            let elements = patch.elements.map(|element| side.start + element);
            let target = Target { cell, back, corners, extent: part.extent, elements, albedo };
            if area > 0.0 { f(area, target) } else { None }
        };
        let mut found = placed.sides().zip([false, true]).map(side);
        let found = [found.next().flatten(), found.next().flatten()];
        found.iter().any(Option::is_some).then_some(found)
    };
    placed.layout.of_cells(&placed.surface, of_cell).into_iter().flatten().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::Family;
    use crate::random::Pcg32;
    use crate::sampling::cosine_hemisphere;
    use crate::scene::{Material, Mesh, Object, Scene};
    use crate::transport::{Field, Rough};
    use crate::world::WorldOptions;

    /// A closed room with a shelf in a corner: points there see it from near.
    fn room() -> World {
        let white = Material::diffuse(Vec3::splat(0.5));
        let (x, y, z) = (Vec3::X * 2.0, Vec3::Y * 2.0, Vec3::Z * 2.0);
        let walls = [(Vec3::ZERO, z, x), (y, x, z), (Vec3::ZERO, x, y), (z, y, x), (Vec3::ZERO, y, z), (x, z, y)];
        let wall = |(k, (corner, u, v))| Object::new(format!("wall {k}"), Mesh::quad(corner, u, v), white);
        let mut objects: Vec<Object> = walls.into_iter().enumerate().map(wall).collect();
        objects.push(Object::new("shelf", Mesh::cuboid(Vec3::splat(1.7), Vec3::splat(1.9)), white));
        let options = WorldOptions { spacing: Some(0.2), ..WorldOptions::default() };
        World::new(Scene::from_objects(objects), &options).expect("a room")
    }

    /// Light in a round spot on the floor, and little elsewhere.
    fn light(world: &World, there: f32) -> Vec<Vec3> {
        let is_there = |p: Vec3| p.y < 0.01 && p.distance(Vec3::new(0.6, 0.0, 0.6)) < 0.3;
        world.positions().iter().map(|p| Vec3::splat(if is_there(*p) { there } else { 1.0 })).collect()
    }

    /// Mean and variance of the mean of what arrives at a slot, from batches of `samples` directions.
    fn arriving(world: &World, light: &[Vec3], spots: Option<&Spots>, slot: u32, samples: u32) -> (f64, f64) {
        let rough = Rough::default();
        let field = Field { total: light, indirect: &[], rough: &rough };
        let source = field.source(world, spots);
        let from = world.ray_origin(slot as usize);
        let batch = |k: u64| {
            let (mut rng, mut rays) = (Pcg32::new(7, 1000 * u64::from(slot) + k), 0);
            let aims = source.aims(samples);
            let ratio = aims as f32 / samples as f32;
            let mut sum = Vec3::ZERO;
            for _ in 0..samples {
                let direction = cosine_hemisphere(from.1, rng.next_2d());
                let (_, landed) = source.along(world, slot, from, direction, ratio, &mut rng, &mut rays, &mut sum);
                source.add_landed(landed.as_ref(), &mut rng, &mut rays, &mut sum);
            }
            for _ in 0..aims {
                let u = rng.next_2d();
                source.aimed(world, slot, from, u, (ratio, Vec3::ONE), &mut rng, &mut rays, &mut sum);
            }
            f64::from(sum.x / samples as f32)
        };
        const BATCHES: u64 = 400;
        let values: Vec<f64> = (0..BATCHES).into_par_iter().map(batch).collect();
        let mean = values.iter().sum::<f64>() / BATCHES as f64;
        let squares: f64 = values.iter().map(|v| (v - mean) * (v - mean)).sum();
        (mean, squares / (BATCHES * (BATCHES - 1)) as f64)
    }

    /// Both techniques together have the mean of one of them, at points near and far, and less noise.
    #[test]
    fn aimed_directions_change_the_noise_and_nothing_else() {
        let world = room();
        let light = light(&world, 200.0);
        let spots = Spots::of_map(&world, &light, &[Vec3::ONE]).expect("a spot");
        let slots: Vec<u32> = world.computed_slots().into_iter().step_by(23).collect();
        let (mut squares, mut with, mut without) = (0.0, 0.0, 0.0);
        let mut family = Family::of_known_errors();
        for &slot in &slots {
            let a = arriving(&world, &light, Some(&spots), slot, 6);
            let b = arriving(&world, &light, None, slot, 24);
            let z = (a.0 - b.0) / (a.1 + b.1).sqrt().max(1e-9);
            family.compare(format!("slot {slot}"), z, 1.0);
            squares += z * z;
            (with, without) = (with + a.1, without + b.1);
        }
        let n = slots.len() as f64;
        family.compare("all slots", squares / n - 1.0, (2.0 / n).sqrt());
        family.assert_agrees();
        assert!(n > 40.0, "{n}");
        // A quarter of the directions, less noise.
        assert!(with < 0.6 * without, "{with} against {without}");
    }

    #[test]
    fn even_light_has_no_spots() {
        let world = room();
        assert!(Spots::of_map(&world, &light(&world, 4.0), &[Vec3::ONE]).is_none());
        assert!(Spots::of_map(&world, &light(&world, 0.0), &[Vec3::ZERO]).is_none());
        // A change may be negative.
        assert!(Spots::of_map(&world, &light(&world, -500.0), &[Vec3::ONE]).is_some());
    }

    /// A change of one kind everywhere that it reaches is no spot, however little that is of a house.
    #[test]
    fn what_a_change_does_not_reach_makes_no_spot_of_the_rest() {
        let world = room();
        let is_reached = |p: &Vec3| p.y < 0.01 && p.distance(Vec3::new(0.6, 0.0, 0.6)) < 0.3;
        let change = |there: f32, elsewhere: f32| -> Vec<Vec3> {
            let of = |p: &Vec3| Vec3::splat(if is_reached(p) { there } else { elsewhere });
            world.positions().iter().map(of).collect()
        };
        assert!(Spots::of_change(&world, &change(200.0, 0.0), &[Vec3::ONE]).is_none());
        assert!(Spots::of_change(&world, &change(200.0, 0.1), &[Vec3::ONE]).is_some());
    }

    /// As often as cells are aimed at: the density that the balance heuristic knows.
    #[test]
    fn densities_are_those_of_the_points() {
        let world = room();
        let spots = Spots::of_map(&world, &light(&world, 200.0), &[Vec3::ONE]).expect("a spot");
        let area = |t: &Target| {
            let [a, b, c] = t.corners;
            0.5 * (b - a).cross(c - a).length()
        };
        let density = |t: &Target| spots.densities[t.cell as usize][usize::from(t.back)];
        let sum: f64 = spots.targets.iter().map(|t| f64::from(density(t) * area(t))).sum();
        assert!((sum - 1.0).abs() < 1e-5, "{sum}");
    }
}
