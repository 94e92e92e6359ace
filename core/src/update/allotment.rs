//! How many paths each representative gets for the bounces of a change: samples where variance × area says. Most of a
//! change is near its edit, and far from there a path seldom meets any of it. Where less than one is asked for,
//! neighbours share one.
//!
//! The variance of a path is at most the mean square of what it may meet, which needs no ray to be judged roughly:
//! squared light of some clusters of surfaces, as if nothing stood in between.

use std::f32::consts::PI;

use glam::Vec3;
use rayon::prelude::*;

use crate::solve::{Rows, Subset};
use crate::world::World;

/// Slots per task.
const CHUNK: usize = 4096;

/// Clusters of the change.
const CLUSTERS: usize = 32;

/// Places at most that clusters are made of, of those that have changed most and of the others.
const PLACES: usize = 1 << 12;

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

/// Rows at most that borrow paths of one another.
const NEIGHBOURS: usize = 16;

/// How much each representative needs paths.
pub(super) struct Allotment {
    /// Per representative: √(area × variance of one path), up to a factor.
    needs: Vec<f32>,
}

impl Allotment {
    /// For the amount per slot of what has changed.
    pub(super) fn new(world: &World, subset: &Subset, amounts: &[f32]) -> Allotment {
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
        let needs = subset.slots.par_iter().zip(subset.areas(world)).with_min_len(CHUNK).map(need).collect();
        Allotment { needs }
    }

    /// Rows for some representatives, and the paths of each. Together they have the noise that `each` would leave if
    /// all had it, with fewer.
    pub(super) fn rows(&self, world: &World, subset: &Subset, members: &Rows, each: u32) -> (Rows, Vec<u32>) {
        let needs = || members.members().iter().map(|&m| f64::from(self.needs[m as usize]));
        let (sum, squares) = needs().fold((0.0, 0.0), |(s, q), n| (s + n, q + n * n));
        let factor = if squares > 0.0 { MARGIN * sum / squares } else { 0.0 };
        let mut shares: Vec<Share> = Vec::new();
        for (need, &member) in needs().zip(members.members()) {
            let paths = f64::from(each) * (need * factor).min(f64::from(MOST));
            let slot = subset.slots[member as usize] as usize;
            match shares.last_mut().filter(|share| share.takes(world, slot, paths)) {
                Some(share) => (share.count, share.paths) = (share.count + 1, share.paths + paths),
                None => shares.push(Share { first: slot, count: 1, paths }),
            }
        }
        let mut neighbours: Vec<(usize, usize)> = Vec::new();
        for share in &shares {
            match neighbours.last_mut() {
                Some((first, count)) if *count < NEIGHBOURS && are_near(world, *first, share.first) => *count += 1,
                _ => neighbours.push((share.first, 1)),
            }
        }
        let rows = members.shared(shares.iter().map(|share| share.count), neighbours.iter().map(|n| n.1));
        (rows, shares.iter().map(|share| share.paths.round().max(1.0) as u32).collect())
    }
}

/// Neighbours that are one row.
struct Share {
    /// Slot of the first of them.
    first: usize,
    count: usize,
    /// That are asked for.
    paths: f64,
}

impl Share {
    /// Whether one more is near enough, and one path enough for all.
    fn takes(&self, world: &World, slot: usize, paths: f64) -> bool {
        self.paths + paths <= 1.0 && are_near(world, self.first, slot)
    }
}

fn are_near(world: &World, a: usize, b: usize) -> bool {
    let within = SHARED_WITHIN * world.resolution.smooth;
    world.positions()[a].distance_squared(world.positions()[b]) < within * within
        && world.normals()[a].dot(world.normals()[b]) > SHARED_COSINE
}

/// An element whose light has changed, or that stands for several of them.
#[derive(Clone, Copy)]
struct ChangedPoint {
    position: Vec3,
    /// m².
    area: f32,
    /// Amount of the change, mean over RGB.
    light: f32,
}

/// The places that have changed most, and the others; where there are many, some stand for all.
fn places(world: &World, amounts: &[f32]) -> Vec<ChangedPoint> {
    let (positions, areas) = (world.positions(), world.areas());
    let square = |slot: usize| f64::from(amounts[slot] * amounts[slot]);
    let limit = world.area_mean(0..amounts.len(), square);
    let (most, others): (Vec<usize>, Vec<usize>) =
        (0..amounts.len()).into_par_iter().filter(|&slot| areas[slot] > 0.0).partition(|&slot| square(slot) > limit);
    let thinned = |slots: &[usize]| -> Vec<ChangedPoint> {
        let step = slots.len().div_ceil(PLACES).max(1);
        let place = |&slot: &usize| {
            let area = areas[slot] * step as f32;
            ChangedPoint { position: positions[slot], area, light: amounts[slot] }
        };
        slots.iter().step_by(step).map(place).collect()
    };
    [thinned(&most), thinned(&others)].concat()
}

/// Places seen as one from afar.
struct Cluster {
    middle: Vec3,
    /// Squared, m².
    radius2: f32,
    /// Σ A L and Σ A L², over π.
    light: f32,
    squares: f32,
}

impl Cluster {
    fn of(places: &[ChangedPoint]) -> Cluster {
        let power = |p: &ChangedPoint| p.light * p.light * p.area;
        let squares: f32 = places.iter().map(power).sum();
        let middle = match squares > 0.0 {
            true => places.iter().map(|p| p.position * power(p)).sum::<Vec3>() / squares,
            false => places.first().map_or(Vec3::ZERO, |p| p.position),
        };
        let spread: f32 = places.iter().map(|p| p.position.distance_squared(middle) * power(p)).sum();
        let radius2 = if squares > 0.0 { spread / squares } else { 0.0 };
        let light: f32 = places.iter().map(|p| p.light * p.area).sum();
        // Never smaller than its own area.
        let area: f32 = places.iter().map(|p| p.area).sum();
        Cluster { middle, radius2: radius2.max(area / PI), light: light / PI, squares: squares / PI }
    }

    /// Cosine over squared distance.
    fn seen_from(&self, point: Vec3, normal: Vec3) -> f32 {
        let w = self.middle - point;
        let distance2 = w.length_squared() + self.radius2;
        let distance = distance2.sqrt();
        ((normal.dot(w) + self.radius2.sqrt()) / distance).clamp(0.0, 1.0) / distance2
    }
}

/// Halves what is most spread out, as often as there are clusters.
fn clusters(places: Vec<ChangedPoint>) -> Vec<Cluster> {
    let mut parts: Vec<(Vec<ChangedPoint>, Cluster)> = Vec::with_capacity(CLUSTERS);
    let with_cluster = |places: Vec<ChangedPoint>| {
        let cluster = Cluster::of(&places);
        (places, cluster)
    };
    parts.push(with_cluster(places));
    while parts.len() < CLUSTERS {
        let spread = |c: &Cluster| c.squares * c.radius2;
        let Some(widest) = (0..parts.len()).max_by(|&a, &b| spread(&parts[a].1).total_cmp(&spread(&parts[b].1))) else {
            break;
        };
        let (places, cluster) = parts.swap_remove(widest);
        let (low, high) = places
            .iter()
            .filter(|p| p.light > 0.0)
            .fold((cluster.middle, cluster.middle), |(l, h), p| (l.min(p.position), h.max(p.position)));
        let size = high - low;
        let axis = (0..3).fold(0, |best, axis| if size[axis] > size[best] { axis } else { best });
        let (below, above): (Vec<ChangedPoint>, Vec<ChangedPoint>) =
            places.into_iter().partition(|p| p.position[axis] < cluster.middle[axis]);
        if below.is_empty() || above.is_empty() {
            parts.push(with_cluster([below, above].concat()));
            break;
        }
        parts.extend([with_cluster(below), with_cluster(above)]);
    }
    parts.into_iter().map(|(_, cluster)| cluster).filter(|cluster| cluster.light > 0.0).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

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
        let (rows, paths) = Allotment::new(&world, &subset, &amounts).rows(&world, &subset, &all, EACH);
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
        let (rows, paths) = Allotment::new(&world, &subset, &amounts).rows(&world, &subset, &all, 1);
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
        let allotment = Allotment::new(&world, &subset, &vec![0.0; world.slots()]);
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

    /// All elements are interpolated from representatives: so are all areas.
    #[test]
    fn areas_of_representatives_add_up() {
        let world = room(0.5);
        let sum = Subset::new(&world).areas(&world).iter().map(|a| f64::from(*a)).sum::<f64>();
        let area = world.computed_slots().iter().map(|&slot| f64::from(world.areas()[slot as usize])).sum::<f64>();
        assert!((sum / area - 1.0).abs() < 0.02, "{sum} and {area}");
    }
}
