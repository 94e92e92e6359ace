//! What is looked at comes first, the rest follows, and nothing is lost on the way.

use std::sync::{Arc, Mutex};

use glam::{DMat4, DVec3, Vec3};
use rebake_core::scene::{LightKind, Scene};
use rebake_core::{
    Budget, Edit, Focus, Importance, LightMap, Observer, Progress, Snapshot, Transition, Unobserved, World, bake,
    update,
};

use super::scenes::{crate_at, room_objects, world};
use super::statistics::{area_mean, mean_total};

/// Keeps all snapshots.
#[derive(Default)]
struct Snapshots(Mutex<Vec<Arc<LightMap>>>, Mutex<Vec<(Snapshot, Progress)>>);

impl Observer for Snapshots {
    fn snapshot(&self, map: &Arc<LightMap>, snapshot: Snapshot, progress: &Progress) {
        self.1.lock().expect("nobody panics").push((snapshot, *progress));
        self.0.lock().expect("nobody panics").push(Arc::clone(map));
    }
}

fn room_and_edit() -> (World, Transition) {
    let world = world(room_objects(0.7), 0.15);
    let asset = Arc::new(Scene::from_objects(vec![crate_at("c", 0.0, 0.0, Vec3::splat(0.3))]));
    let transform = DMat4::from_translation(DVec3::new(2.2, 0.0, 1.9));
    let transition = world.apply(&[Edit::Insert { asset, name: "crate".into(), transform }]).expect("an edit");
    (world, transition)
}

fn budget(samples: u32) -> Budget {
    Budget { samples_per_element: samples, target_rmse: None }
}

/// The first snapshot is new where `inside` says so and old where `outside` does; the last is as good as without focus.
fn check(focus: &Focus, inside: impl Fn(Vec3) -> bool, outside: impl Fn(Vec3) -> bool) {
    let (before, transition) = room_and_edit();
    let after = &transition.after;
    let old = bake(&before, &budget(256), 1, &Unobserved).expect("nobody cancels");
    let carried = transition.carry_over(&old);
    let snapshots = Snapshots::default();
    let done =
        update(&transition, &old, &budget(32), Some(&Importance::from(*focus)), 2, &snapshots).expect("nobody cancels");
    let plain = update(&transition, &old, &budget(64), None, 3, &Unobserved).expect("nobody cancels");
    let first = Arc::clone(&snapshots.0.lock().expect("nobody panics")[0]);
    let is_static = |i: usize| i < before.slots() && before.areas()[i] > 0.0;
    let (mut changed, mut kept) = (0, 0);
    for i in (0..after.slots()).filter(|&i| is_static(i) && before.is_valid(i) && after.is_valid(i)) {
        let p = after.positions()[i];
        if outside(p) {
            assert_eq!(first.total(i), carried.total(i), "element {i} at {p} is not looked at");
            kept += 1;
        } else if inside(p) {
            changed += usize::from(first.total(i) != carried.total(i));
        }
    }
    assert!(changed > 20 && kept > 1000, "{changed} changed, {kept} kept");
    // Four samples against sixty-four, on what both worlds have and somebody looks at.
    let region = |i: usize| is_static(i) && inside(after.positions()[i]);
    let mean = |m: &LightMap| area_mean(after, region, |i| m.total(i).as_dvec3());
    let (early, late, stale) = (mean(&first), mean(&plain), mean(&carried));
    assert!((early - late).abs() < 0.25 * (stale - late).abs(), "{early} at first, {late} at last, {stale} before");
    // The last map before the rest follows is right where somebody looks.
    let parts = snapshots.1.lock().expect("nobody panics").iter().filter(|(s, _)| *s == Snapshot::Partial).count();
    let seen = mean(&snapshots.0.lock().expect("nobody panics")[parts - 1]);
    assert!(parts > 2 && (seen - late).abs() < 0.1 * (stale - late).abs(), "{seen} after {parts}, {late} at last");
    let ratio = mean_total(after, &done) / mean_total(after, &plain);
    assert!((ratio - 1.0).abs() < 5e-3, "the whole map is {ratio} of that without focus");
    let last = snapshots.0.lock().expect("nobody panics").pop().expect("a snapshot");
    assert!(Arc::ptr_eq(&last, &done));
}

#[test]
fn a_sphere_comes_first() {
    let middle = Vec3::new(2.2, 0.0, 1.9);
    let focus = Focus::Sphere { point: middle.as_dvec3(), radius: 0.8 };
    check(&focus, |p| p.distance(middle) < 0.75, |p| p.distance(middle) > 1.0);
}

#[test]
fn what_a_camera_sees_comes_first() {
    // From above, down on the floor around the crate.
    let focus = Focus::Camera {
        eye: DVec3::new(2.2, 2.0, 1.9),
        target: DVec3::new(2.2, 0.0, 1.9),
        up: DVec3::X,
        fov_y: 0.8,
        aspect: 1.0,
    };
    let floor = |p: Vec3| p.y < 1e-3;
    let offset = |p: Vec3| (p.x - 2.2).abs().max((p.z - 1.9).abs());
    // Half the frame is 2 m · tan 0.4 = 0.85 m; the crate hides 0.43 m around its middle; the ceiling is behind the
    // eye.
    check(&focus, |p| floor(p) && (0.45..0.8).contains(&offset(p)), |p| p.y > 2.1 || floor(p) && offset(p) > 1.0);
}

/// A lamp that moves is baked anew, and there, too, what is looked at comes first.
#[test]
fn a_moved_lamp_comes_first_where_somebody_looks() {
    let kind = LightKind::Point { position: DVec3::new(1.0, 1.8, 1.0), range: None };
    let bulb = Edit::InsertLight { name: "bulb".into(), kind, color: Vec3::ONE, intensity: 3.0 };
    let group = Edit::GroupLights { group: Some("bulb".into()), lights: vec!["bulb".into()] };
    let world = world(room_objects(0.7), 0.1).apply(&[bulb, group]).expect("a bulb").after;
    let old = bake(&world, &budget(64), 1, &Unobserved).expect("nobody cancels");
    let position = Some(DVec3::new(2.0, 1.5, 2.2));
    let edit = Edit::MoveLight { light: "bulb".into(), position, direction: None, own_layer: false };
    let transition = world.apply(&[edit]).expect("a move");
    let middle = Vec3::new(2.2, 0.0, 1.9);
    let focus = Focus::Sphere { point: middle.as_dvec3(), radius: 0.8 };
    let (with, without) = (Snapshots::default(), Snapshots::default());
    let done = update(&transition, &old, &budget(32), Some(&focus.into()), 2, &with).expect("nobody cancels");
    let plain = update(&transition, &old, &budget(64), None, 3, &without).expect("nobody cancels");

    let (first, progress) = (with.0.lock().expect("no panic")[0].clone(), with.1.lock().expect("no panic").clone());
    let rays = without.1.lock().expect("no panic")[0].1.rays;
    let (snapshot, progress) = progress[0];
    assert_eq!((snapshot, progress.samples_per_element, progress.estimated_rmse), (Snapshot::Partial, 0, None));
    assert!(progress.rays < rays * 7 / 10, "{} rays to the first sight of it, {rays} without focus", progress.rays);
    let region = |i: usize| world.areas()[i] > 0.0 && world.positions()[i].distance(middle) < 0.75;
    let mean = |m: &LightMap| area_mean(&world, region, |i| m.total(i).as_dvec3());
    let (early, late, stale) = (mean(&first), mean(&plain), mean(&old));
    assert!((early - late).abs() < 0.1 * (stale - late).abs(), "{early} at first, {late} at last, {stale} before");
    let ratio = mean_total(&world, &done) / mean_total(&world, &plain);
    assert!((ratio - 1.0).abs() < 5e-3, "the whole map is {ratio} of that without focus");
}

/// What is not looked at is estimated once for all rounds: that must not make what is stated of the view too small.
#[test]
fn what_is_stated_of_the_view_is_the_scatter_of_runs() {
    const RUNS: u64 = 12;
    let (before, transition) = room_and_edit();
    let after = &transition.after;
    let old = bake(&before, &budget(64), 1, &Unobserved).expect("nobody cancels");
    let carried = transition.carry_over(&old);
    let middle = Vec3::new(2.2, 0.0, 1.9);
    let focus = Focus::Sphere { point: middle.as_dvec3(), radius: 0.8 };
    let runs: Vec<Arc<LightMap>> = (0..RUNS)
        .map(|seed| {
            update(&transition, &old, &budget(16), Some(&focus.into()), seed, &Unobserved).expect("nobody cancels")
        })
        .collect();
    let region = |i: usize| i < before.slots() && before.is_valid(i) && after.positions()[i].distance(middle) < 0.75;
    let n = RUNS as f64;
    let scatter = |i: usize| {
        let mean = runs.iter().map(|run| run.total(i).as_dvec3()).sum::<glam::DVec3>() / n;
        runs.iter().map(|run| (run.total(i).as_dvec3() - mean).length_squared() / 3.0).sum::<f64>() / (n - 1.0)
    };
    // All runs start from the same map: its noise is stated, too, and no part of the scatter.
    let stated =
        |i: usize| runs.iter().map(|run| f64::from(run.light.variance[i] - carried.light.variance[i])).sum::<f64>() / n;
    let found = area_mean(after, region, |i| glam::DVec3::splat(scatter(i)));
    let claimed = area_mean(after, region, |i| glam::DVec3::splat(stated(i)));
    let ratio = (claimed / found).sqrt();
    assert!((0.67..1.5).contains(&ratio), "stated over found: {ratio:.3}");
}
