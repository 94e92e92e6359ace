//! How much sooner what somebody looks at has a given error, with `focus` and without.

use anyhow::{Context, Result, ensure};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use rebake_core::bvh::{BuildQuality, Bvh, Ray};
use rebake_core::{Focus, Stated, World};
use serde_json::{Map, Value, json};

use super::report::ReferenceReport;
use super::run::median;
use super::study::{Curve, Point, StudyCase, TimeToError, as_map};
use super::{Base, Options, PreparedCase, Reference, Seen, Service, Watcher};

/// Noise that two runs of the same number of samples may differ by: an error counts as reached up to this factor.
const TOLERANCE: f64 = 1.1;

/// What somebody looks at, as edits carry it.
pub(super) struct View<'a> {
    pub(super) focus: &'a Value,
    pub(super) tiles: Option<&'a Value>,
    /// Samples per element of an edit.
    pub(super) samples: u32,
}

impl View<'_> {
    /// What the request has beside its edits.
    fn beside_edits(&self, with_focus: bool) -> Map<String, Value> {
        let mut fields = Map::new();
        fields.insert("budget".to_owned(), json!({ "samples_per_element": self.samples }));
        if with_focus {
            fields.insert("focus".to_owned(), self.focus.clone());
            self.tiles.map(|tiles| fields.insert("tiles".to_owned(), tiles.clone()));
        }
        fields
    }
}

/// Runs a case's edit through the service with and without the focus.
pub(super) fn measure(
    case: &PreparedCase,
    view: &View<'_>,
    options: &Options,
    service: &dyn Service,
    watcher: &mut dyn Watcher,
) -> Result<StudyCase> {
    let mode = options.mode;
    let looks = service.read_focus(view.focus, &case.before)?;
    let is_seen = looked_at(&case.after, &looks);
    let (share, count) = share_of(&case.after, &is_seen);
    ensure!(count > 0, "focus: there is no element in it");
    watcher.step(&case.name, "reference");
    let (elements, paths) = (options.reference_elements, options.reference_samples);
    let reference = Reference::trace_among(&case.after, elements, paths, options.seed, |slot| is_seen[slot]);
    let mut runs = Vec::new();
    for k in 0..options.seeds {
        watcher.step(&case.name, &format!("run {}", k + 1));
        let base = Base::of_run(options, k);
        let one = |with_focus: bool| -> Result<Vec<Point>> {
            let seen = service.watch(case, base, view.beside_edits(with_focus))?;
            Ok(seen.into_iter().map(|seen| point(seen, &reference, mode)).collect())
        };
        runs.push([one(false)?, one(true)?]);
    }
    let first = runs.first().context("no run")?;
    Ok(StudyCase {
        name: case.name.clone(),
        about: format!("{:.1} % of the area in view, {count} elements", 100.0 * share),
        reference: ReferenceReport::of(&reference, mode),
        curves: ["without focus", "with focus"]
            .into_iter()
            .zip(first)
            .map(|(label, points)| Curve { label: label.to_owned(), points: points.clone(), mean_rmse: None })
            .collect(),
        times: times(&runs),
    })
}

fn point(seen: Seen, reference: &Reference, mode: Stated) -> Point {
    let rmse = reference.mean_square_error(&as_map(seen.values, mode), mode).root();
    Point { seconds: seen.seconds, rmse }
}

/// When the errors are reached that the first run without focus has step by step, from the first that is worth it.
fn times(runs: &[[Vec<Point>; 2]]) -> Vec<TimeToError> {
    /// The first version has the old light: what brings less than this part of its error away says nothing.
    const WORTH: f64 = 0.8;
    let Some([steps, _]) = runs.first() else { return Vec::new() };
    let stale = steps.first().map_or(0.0, |point| point.rmse);
    let time = |points: &[Point], rmse: f64| points.iter().find(|point| point.rmse <= rmse).map(|p| p.seconds);
    let mut list: Vec<TimeToError> = Vec::new();
    for step in steps.iter().skip(1) {
        let rmse = step.rmse * TOLERANCE;
        if rmse <= 0.0 || rmse > WORTH * stale || list.last().is_some_and(|last| rmse > last.rmse / TOLERANCE) {
            continue;
        }
        let reached = |which: usize| {
            let times: Option<Vec<f64>> = runs.iter().map(|run| time(&run[which], rmse)).collect();
            times.map(median)
        };
        let (without_focus, with_focus) = (reached(0), reached(1));
        let ratio = without_focus.zip(with_focus).map(|(without, with)| without / with);
        list.push(TimeToError { rmse, without_focus, with_focus, ratio });
    }
    list
}

/// (part of the area, elements) that is seen.
fn share_of(world: &World, is_seen: &[bool]) -> (f64, usize) {
    let area = |wanted: &dyn Fn(usize) -> bool| -> f64 {
        (0..world.slots()).filter(|slot| wanted(*slot)).map(|slot| f64::from(world.areas()[slot])).sum()
    };
    let seen = area(&|slot| is_seen[slot]);
    (seen / area(&|_| true), is_seen.iter().filter(|seen| **seen).count())
}

/// Per slot: whether the focus looks at it. The engine has a test of its own; what is measured shall not depend on it.
fn looked_at(world: &World, focus: &Focus) -> Vec<bool> {
    let origin = world.scene.origin;
    let is_in: Box<dyn Fn(usize) -> bool + Sync> = match *focus {
        Focus::Sphere { point, radius } => {
            let middle = (point - origin).as_vec3();
            Box::new(move |slot| world.positions()[slot].distance(middle) <= radius)
        }
        Focus::Camera { eye, target, up, fov_y, aspect } => {
            let walls = walls(world);
            let forward = (target - eye).normalize_or(DVec3::NEG_Z);
            let right = forward.cross(up).normalize_or(forward.any_orthonormal_vector());
            let frame = [right, right.cross(forward), forward].map(|axis| axis.as_vec3());
            let half_height = (0.5 * fov_y).tan();
            let (eye, half) = ((eye - origin).as_vec3(), [half_height * aspect, half_height]);
            Box::new(move |slot| is_visible(world, &walls, slot, eye, frame, half))
        }
    };
    (0..world.slots()).into_par_iter().map(|slot| world.areas()[slot] > 0.0 && is_in(slot)).collect()
}

fn is_visible(world: &World, walls: &Bvh, slot: usize, eye: Vec3, frame: [Vec3; 3], half: [f32; 2]) -> bool {
    let (point, normal) = (world.positions()[slot], world.normals()[slot]);
    let [x, y, depth] = frame.map(|axis| (point - eye).dot(axis));
    if depth <= 0.0 || x.abs() > half[0] * depth || y.abs() > half[1] * depth || normal.dot(eye - point) <= 0.0 {
        return false;
    }
    let from = point + normal * (0.02 * world.spacing());
    !walls.any_hit(&Ray { origin: from, direction: eye - from, t_min: 0.0, t_max: 1.0 }, None)
}

/// A tree over all triangles of a scene, in scene space.
fn walls(world: &World) -> Bvh {
    let scene = &world.scene;
    let mut corners = Vec::new();
    for object in &scene.objects {
        let place = |i: u32| {
            let point = object.mesh.positions[i as usize].as_dvec3();
            (object.world_from_object.transform_point3(point) - scene.origin).as_vec3()
        };
        corners.extend(object.mesh.triangles.iter().map(|triangle| triangle.map(place)));
    }
    let ids: Vec<u32> = (0..corners.len() as u32).collect();
    Bvh::build(&corners, &ids, BuildQuality::Good)
}

#[cfg(test)]
mod tests {
    use rebake_core::WorldOptions;
    use rebake_core::scene::{Material, Mesh, Object, Scene};

    use super::*;

    #[test]
    fn a_camera_sees_what_faces_it_in_its_frame_and_is_not_hidden() {
        let quad = |name: &str, y: f32, half: f32| {
            let mesh = Mesh::quad(Vec3::new(-half, y, -half), Vec3::Z * 2.0 * half, Vec3::X * 2.0 * half);
            Object::new(name, mesh, Material::diffuse(Vec3::splat(0.5)))
        };
        // Both look up at a camera that looks down; the small one hides the middle of the large one.
        let scene = Scene::from_objects(vec![quad("floor", 0.0, 3.0), quad("table", 1.0, 0.5)]);
        let world = World::new(scene, &WorldOptions { spacing: Some(0.1), ..WorldOptions::default() }).unwrap();
        let camera = Focus::Camera {
            eye: DVec3::new(0.0, 2.0, 0.0),
            target: DVec3::ZERO,
            up: DVec3::X,
            fov_y: std::f32::consts::FRAC_PI_2,
            aspect: 1.0,
        };
        let is_seen = looked_at(&world, &camera);
        let origin = world.scene.origin.as_vec3();
        for slot in (0..world.slots()).filter(|slot| world.areas()[*slot] > 0.0) {
            let p = world.positions()[slot] + origin;
            let out = p.x.abs().max(p.z.abs());
            // On the floor the table's shadow ends at 1 m and the frame at 2 m.
            let faces = world.normals()[slot].y > 0.0;
            let expected = faces && if p.y > 0.5 { true } else { out > 1.0 && out <= 2.0 };
            let is_at_an_edge = [1.0, 2.0].iter().any(|edge| (out - edge).abs() < 0.02) && p.y < 0.5;
            assert!(is_at_an_edge || is_seen[slot] == expected, "{p}");
        }
    }

    #[test]
    fn times_are_those_of_the_first_version_that_is_good_enough() {
        let points = |list: &[(f64, f64)]| list.iter().map(|&(seconds, rmse)| Point { seconds, rmse }).collect();
        let without = points(&[(0.1, 1.0), (1.0, 0.9), (2.0, 0.4), (4.0, 0.2)]);
        let with = points(&[(0.1, 1.0), (0.5, 0.41), (3.0, 0.3)]);
        let times = times(&[[without, with]]);
        let found: Vec<_> = times.iter().map(|t| (t.without_focus, t.with_focus, t.ratio)).collect();
        assert_eq!(found, [(Some(2.0), Some(0.5), Some(4.0)), (Some(4.0), None, None)]);
    }
}
