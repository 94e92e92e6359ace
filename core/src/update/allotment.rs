//! How many paths each representative gets for the bounces of a change: samples where variance × area says. Most of a
//! change is near its edit, and far from there a path seldom meets any of it. Where less than one is asked for,
//! neighbours share one.
//!
//! The variance of a path is at most the mean square of what it may meet, which needs no ray to be judged roughly:
//! squared light of some clusters of surfaces, as if nothing stood in between.

use rayon::prelude::*;

use super::clusters::{clusters, places};
use crate::solve::{Rows, Subset};
use crate::world::World;

/// Slots per task.
const CHUNK: usize = 4096;

/// A usual albedo, to guess bounces with.
pub(super) const ALBEDO: f32 = 0.5;

/// Paths of a representative at most, over those that all would get.
const MOST: f32 = 8.0;

/// Paths over those that would do if needs were known exactly: what is judged roughly takes more. Measured on three
/// edits: the same or more is known per second than with 1.0 (up to 1.5 times as much).
const MARGIN: f64 = 1.3;

/// Neighbours that share paths are within so many spacings of the first of them, and turned by no more than this
/// cosine.
const SHARED_WITHIN: f32 = 16.0;
const SHARED_COSINE: f32 = 0.8;

/// They have at most so many times the light of one another, that below a part of the mean not told apart: the dark outside
/// of a wall is near its inside, and often turned as what stands there.
const ALIKE: f32 = 8.0;
const LEAST_LIGHT: f32 = 1e-3;

/// Rows at most that borrow paths of one another.
const NEIGHBOURS: usize = 16;

/// How much each representative needs paths.
pub(super) struct Allotment {
    /// Per representative: √(area × variance of one path), up to a factor.
    needs: Vec<f32>,
    /// Per representative: light that was there, mean over RGB.
    lights: Vec<f32>,
}

impl Allotment {
    /// For the amount per slot of what has changed, and of the light that was there.
    pub(super) fn new(world: &World, subset: &Subset, amounts: &[f32], light: impl Fn(usize) -> f32) -> Allotment {
        let places = places(world, amounts);
        let area: f32 = places.iter().map(|p| p.area).sum();
        // The mean of all later bounces.
        let ambient =
            if area > 0.0 { ALBEDO * places.iter().map(|p| p.light * p.area).sum::<f32>() / area } else { 0.0 };
        let clusters = clusters(places);
        let need = |(&slot, area): (&u32, f32)| {
            let (point, normal) = (world.positions()[slot as usize], world.normals()[slot as usize]);
            let (mut light, mut squares) = (0.0, 0.0);
            for cluster in &clusters {
                let seen = cluster.seen_from(point, normal);
                light += seen * cluster.light;
                squares += seen * cluster.squares;
            }
            let bounces = ALBEDO * light + ambient;
            ((squares + bounces * bounces) * area).sqrt()
        };
        let areas = subset.areas(world);
        let needs = subset.slots.par_iter().zip(&areas).with_min_len(CHUNK).map(|(slot, area)| need((slot, *area)));
        let lights: Vec<f32> = subset.slots.iter().map(|&slot| light(slot as usize)).collect();
        let sums = lights.iter().zip(&areas).fold([0.0; 2], |[light, area], (l, a)| [light + l * a, area + a]);
        let least = LEAST_LIGHT * sums[0] / sums[1].max(f32::MIN_POSITIVE);
        let lights = lights.into_iter().map(|light| light.max(least)).collect();
        Allotment { needs: needs.collect(), lights }
    }

    /// Rows for some representatives, and the paths of each. Together they have the noise that `each` would leave if
    /// all had it, with fewer.
    pub(super) fn rows(&self, world: &World, subset: &Subset, members: &Rows, each: u32) -> (Rows, Vec<u32>) {
        let needs = || members.members().iter().map(|&m| f64::from(self.needs[m as usize]));
        let (sum, squares) = needs().fold((0.0, 0.0), |(s, q), n| (s + n, q + n * n));
        let factor = if squares > 0.0 { MARGIN * sum / squares } else { 0.0 };
        let mut shares: Vec<Share> = Vec::new();
        let are_near = |a: u32, b: u32| self.are_near(world, subset, a, b);
        for (need, &member) in needs().zip(members.members()) {
            let paths = f64::from(each) * (need * factor).min(f64::from(MOST));
            // One path is enough for all.
            let takes = |share: &Share| share.paths + paths <= 1.0 && are_near(share.first, member);
            match shares.last_mut().filter(|share| takes(share)) {
                Some(share) => (share.count, share.paths) = (share.count + 1, share.paths + paths),
                None => shares.push(Share { first: member, count: 1, paths }),
            }
        }
        let mut neighbours: Vec<(u32, usize)> = Vec::new();
        for share in &shares {
            match neighbours.last_mut() {
                Some((first, count)) if *count < NEIGHBOURS && are_near(*first, share.first) => *count += 1,
                _ => neighbours.push((share.first, 1)),
            }
        }
        let rows = members.shared(shares.iter().map(|share| share.count), neighbours.iter().map(|n| n.1));
        (rows, shares.iter().map(|share| share.paths.round().max(1.0) as u32).collect())
    }

    /// Whether two representatives lie beside each other, in light of the same kind.
    fn are_near(&self, world: &World, subset: &Subset, a: u32, b: u32) -> bool {
        let within = SHARED_WITHIN * world.resolution.smooth;
        let [first, second] = [a, b].map(|member| self.lights[member as usize]);
        let [a, b] = [a, b].map(|member| subset.slots[member as usize] as usize);
        first.max(second) <= ALIKE * first.min(second)
            && world.positions()[a].distance_squared(world.positions()[b]) < within * within
            && world.normals()[a].dot(world.normals()[b]) > SHARED_COSINE
    }
}

/// Neighbours that are one row.
struct Share {
    /// The first of them.
    first: u32,
    count: usize,
    /// That are asked for.
    paths: f64,
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::Vec3;

    use super::*;
    use crate::job::Unobserved;
    use crate::metrics::Family;
    use crate::random::{PartSeed, Pcg32};
    use crate::scene::{Material, Mesh, Object, Scene};
    use crate::solve::{Exchange, Paths};
    use crate::transport::{Source, Surfel, Work};
    use crate::world::WorldOptions;

    /// A long closed room, with a box near one end of it.
    fn room(albedo: f32) -> World {
        let white = Material::diffuse(Vec3::splat(albedo));
        let (x, y, z) = (Vec3::X * 16.0, Vec3::Y * 2.0, Vec3::Z * 2.0);
        let walls = [(Vec3::ZERO, z, x), (y, x, z), (Vec3::ZERO, x, y), (z, y, x), (Vec3::ZERO, y, z), (x, z, y)];
        let wall = |(k, (corner, u, v))| Object::new(format!("wall {k}"), Mesh::quad(corner, u, v), white);
        let mut objects: Vec<Object> = walls.into_iter().enumerate().map(wall).collect();
        objects.push(Object::new("box", Mesh::cuboid(Vec3::new(1.0, 0.0, 1.0), Vec3::splat(1.3)), white));
        let options = WorldOptions { spacing: Some(0.15), ..WorldOptions::default() };
        World::new(Scene::from_objects(objects), &options).expect("a room")
    }

    /// A change near the box, and its amount.
    fn change(world: &World) -> (Vec<Vec3>, Vec<f32>) {
        let near = |p: &Vec3| f32::from(p.distance(Vec3::new(1.15, 0.0, 1.15)) < 0.8);
        let amounts: Vec<f32> = world.positions().iter().map(near).collect();
        (amounts.iter().map(|amount| Vec3::splat(*amount)).collect(), amounts)
    }

    /// One matrix, with what its rows gather of a change.
    fn traced(
        world: &World,
        subset: &Subset,
        change: &[Vec3],
        rows: &Arc<Rows>,
        paths: Paths,
        seed: u64,
    ) -> Exchange<Vec3> {
        let radiance = |_: u32, s: &Surfel, _: bool, share: Vec3, _: &mut Pcg32, _: &mut u64, light: &mut Vec3| {
            *light += s.footprint.map_or(Vec3::ZERO, |footprint| footprint.interpolate(change) * s.albedo) * share;
        };
        let source = Source { radiance, looked_up: change, skies: &[], spots: None };
        Exchange::trace(world, subset, rows, &source, paths, PartSeed::whole(seed), &Work::new(&Unobserved))
            .expect("nobody cancels")
    }

    /// Means and variances over runs of what every row gathers.
    fn gathered(world: &World, subset: &Subset, change: &[Vec3], rows: &Arc<Rows>, paths: Paths) -> Vec<(f64, f64)> {
        let mut sums = vec![(0.0, 0.0); rows.len()];
        for seed in 0..RUNS {
            let found = traced(world, subset, change, rows, paths, seed).first;
            for (sum, light) in sums.iter_mut().zip(found) {
                *sum = (sum.0 + f64::from(light.x), sum.1 + f64::from(light.x * light.x));
            }
        }
        let n = RUNS as f64;
        sums.into_iter().map(|(sum, squares)| (sum / n, (squares - sum * sum / n).max(0.0) / (n - 1.0))).collect()
    }

    const RUNS: u64 = 60;

    #[test]
    fn local_changes_need_fewer_paths_for_the_same_noise() {
        let world = room(0.5);
        let subset = Subset::new(&world);
        let (change, amounts) = change(&world);
        let all = Arc::new(Rows::all(&subset));
        const EACH: u32 = 16;
        let (rows, paths) = Allotment::new(&world, &subset, &amounts, |_| 1.0).rows(&world, &subset, &all, EACH);
        let count: u32 = paths.iter().sum();
        assert!(f64::from(count) < 0.6 * f64::from(EACH) * all.len() as f64, "{count}");

        let rows = Arc::new(rows);
        let with = gathered(&world, &subset, &change, &rows, Paths::OfRows(&paths));
        let without = gathered(&world, &subset, &change, &all, Paths::Each(EACH));
        let (mut squares, mut rows_seen) = (0.0, 0.0);
        let mut family = Family::of_freedom((RUNS - 1) as f64);
        for (row, a) in with.iter().enumerate() {
            // A row that is shared has the mean of its members.
            let members = rows.members_of(row);
            let n = members.len() as f64;
            let of_members = members.iter().map(|&m| without[m as usize]);
            let b = of_members.fold((0.0, 0.0), |sum, m| (sum.0 + m.0 / n, sum.1 + m.1 / (n * n)));
            // Rows that the change is hidden from gather nothing either way.
            if a.1 == 0.0 || b.1 == 0.0 {
                continue;
            }
            let z = (a.0 - b.0) / ((a.1 + b.1) / RUNS as f64).sqrt();
            family.compare(format!("row {row}"), z, 1.0);
            (squares, rows_seen) = (squares + z * z, rows_seen + 1.0);
        }
        family.assert_agrees();
        assert!(rows_seen > 300.0 && squares / rows_seen < 1.4, "{squares} over {rows_seen}");
        let areas = subset.areas(&world);
        let noise = |rows: &Rows, found: &[(f64, f64)]| -> f64 {
            let of_row = |row: usize| rows.members_of(row).iter().map(|&m| f64::from(areas[m as usize])).sum::<f64>();
            found.iter().enumerate().map(|(row, f)| of_row(row) * f.1).sum()
        };
        let (with, without) = (noise(&rows, &with), noise(&all, &without));
        assert!(with < 1.25 * without, "{with} and {without}");
    }

    /// A few paths alone may all end where they came from; those that are borrowed lead out.
    #[test]
    fn what_rows_borrow_keeps_light_from_going_round() {
        let world = room(0.95);
        let subset = Subset::new(&world);
        let (change, amounts) = change(&world);
        let all = Arc::new(Rows::all(&subset));
        let bounces = |rows: &Arc<Rows>, paths: Paths, seed: u64| {
            let traced = traced(&world, &subset, &change, rows, paths, seed);
            traced.to_representatives(&subset, &traced.all_bounces(&traced.first))
        };
        let exact = bounces(&all, Paths::Each(3000), 1);
        let (rows, paths) = Allotment::new(&world, &subset, &amounts, |_| 1.0).rows(&world, &subset, &all, 1);
        let alone = all.shared((0..rows.len()).map(|row| rows.members_of(row).len()), std::iter::empty());
        let areas = subset.areas(&world);
        // Squared error, by area, over the exact solution squared; the mean over its mean, and that one's standard
        // error.
        const RUNS: u64 = 16;
        let judged = |rows: Rows| {
            let rows = Arc::new(rows);
            let exact: Vec<f64> = exact.iter().map(|light| f64::from(light.x)).collect();
            let mean =
                |of: &dyn Fn(usize) -> f64| areas.iter().enumerate().map(|(k, a)| f64::from(*a) * of(k)).sum::<f64>();
            let (mut error, mut means) = (0.0, Vec::new());
            for seed in 0..RUNS {
                let found = bounces(&rows, Paths::OfRows(&paths), 100 + seed);
                let found = |k: usize| f64::from(found[k].x);
                error += mean(&|k| (found(k) - exact[k]).powi(2)) / mean(&|k| exact[k].powi(2)) / RUNS as f64;
                means.push(mean(&found) / mean(&|k| exact[k]));
            }
            let n = RUNS as f64;
            let m = means.iter().sum::<f64>() / n;
            (error, m, (means.iter().map(|x| (x - m).powi(2)).sum::<f64>() / (n * (n - 1.0))).sqrt())
        };
        let (with, without) = (judged(rows), judged(alone));
        assert!(with.0 < 0.5 * without.0, "{with:?} and {without:?}");
        let mut family = Family::of_freedom((RUNS - 1) as f64);
        family.compare_within("mean", with.1 - 1.0, with.2, 0.01);
        family.assert_agrees();
    }

    /// Where nothing changes neighbours share a path, and nobody is left out.
    #[test]
    fn quiet_neighbours_share_one_path() {
        let world = room(0.5);
        let subset = Subset::new(&world);
        let all = Rows::all(&subset);
        let allotment = Allotment::new(&world, &subset, &vec![0.0; world.slots()], |_| 0.0);
        let (rows, paths) = allotment.rows(&world, &subset, &all, 16);
        assert!(paths.iter().all(|paths| *paths == 1));
        assert_eq!(rows.members(), all.members());
        assert!(4 * rows.len() < all.len(), "{} rows of {}", rows.len(), all.len());
        for members in (0..rows.len()).map(|row| rows.members_of(row)) {
            let place = |m: u32| {
                let slot = subset.slots[m as usize] as usize;
                (world.positions()[slot], world.normals()[slot])
            };
            let (first, normal) = place(members[0]);
            let is_near = |(p, n): (Vec3, Vec3)| p.distance(first) < 16.0 * 0.15 && n.dot(normal) > 0.8;
            assert!(members.iter().all(|&m| is_near(place(m))));
        }
    }

    /// A path of what stands in the light tells nothing of what is dark beside it.
    #[test]
    fn what_is_dark_shares_no_path_with_what_is_lit() {
        let world = room(0.5);
        let subset = Subset::new(&world);
        let all = Rows::all(&subset);
        let light = |slot: usize| if world.positions()[slot].x > 8.0 { 0.3 } else { 1e-6 };
        let allotment = Allotment::new(&world, &subset, &vec![0.0; world.slots()], light);
        let (rows, _) = allotment.rows(&world, &subset, &all, 16);
        assert!(4 * rows.len() < all.len(), "{} rows of {}", rows.len(), all.len());
        for members in (0..rows.len()).map(|row| rows.members_of(row)) {
            let first = light(subset.slots[members[0] as usize] as usize);
            assert!(members.iter().all(|&m| light(subset.slots[m as usize] as usize) == first));
        }
    }

    /// All elements are interpolated from representatives: so are all areas.
    #[test]
    fn areas_of_representatives_add_up() {
        let world = room(0.5);
        let sum = Subset::new(&world).areas(&world).iter().map(|a| f64::from(*a)).sum::<f64>();
        let area = world.computed_slots().iter().map(|&slot| f64::from(world.areas()[slot as usize])).sum::<f64>();
        assert!((sum / area - 1.0).abs() < 0.02, "{sum} and {area}");
    }
}
