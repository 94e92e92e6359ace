//! Tile after tile: each finished one is shown, the others keep their old light bit for bit, the end is as good as
//! ever.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use glam::{DMat4, DVec2, DVec3, Vec3};
use rebake_core::scene::{LightKind, Scene};
use rebake_core::{
    Budget, Edit, Focus, Importance, LightMap, Observer, Progress, Snapshot, TileMode, Tiles, Transition, Unobserved,
    World, bake, update,
};

use super::scenes::{crate_at, room_objects, world};
use super::statistics::{area_mean, assert_agrees, mean_total, replicate};

/// Keeps what is shown before the rest follows, and leaves the other tiles after `most` of them.
struct Shown {
    maps: Mutex<Vec<Arc<LightMap>>>,
    count: AtomicUsize,
    most: usize,
}

impl Shown {
    fn new(most: usize) -> Shown {
        Shown { maps: Mutex::default(), count: AtomicUsize::new(0), most }
    }
}

impl Observer for Shown {
    fn leaves_first(&self) -> bool {
        self.count.load(Ordering::Relaxed) >= self.most
    }

    fn snapshot(&self, map: &Arc<LightMap>, snapshot: Snapshot, _: &Progress) {
        if snapshot == Snapshot::Partial {
            self.count.fetch_add(1, Ordering::Relaxed);
            self.maps.lock().expect("nobody panics").push(Arc::clone(map));
        }
    }
}

const EYE: DVec3 = DVec3::new(2.0, 2.2, 2.0);

fn from_above() -> Focus {
    Focus::Camera { eye: EYE, target: DVec3::new(2.0, 0.0, 2.0), up: DVec3::X, fov_y: 1.2, aspect: 1.0 }
}

const PLACE: DVec3 = DVec3::new(2.2, 0.0, 1.6);

fn room_and_edit() -> (World, Transition) {
    let world = world(room_objects(0.7), 0.12);
    let asset = Arc::new(Scene::from_objects(vec![crate_at("c", 0.0, 0.0, Vec3::splat(0.3))]));
    let transform = DMat4::from_translation(PLACE);
    let transition = world.apply(&[Edit::Insert { asset, name: "crate".into(), transform }]).expect("an edit");
    (world, transition)
}

fn budget(samples: u32) -> Budget {
    Budget { samples_per_element: samples, target_rmse: None }
}

fn tiles(size: u32, samples: u32, mode: TileMode) -> Option<Tiles> {
    Some(Tiles { size, samples, mode })
}

/// Where an element is on screen, in half heights.
fn on_screen(p: DVec3) -> DVec2 {
    let to = p - EYE;
    DVec2::new(to.z, to.x) / -to.y / 0.6_f64.tan()
}

/// Slots of unchanged elements, whose values two maps do not share.
fn changed(before: &World, after: &World, a: &LightMap, b: &LightMap) -> Vec<usize> {
    let stays = |i: usize| i < before.slots() && before.is_valid(i) && after.is_valid(i) && before.areas()[i] > 0.0;
    let same = |i: usize| {
        a.light.direct[i] == b.light.direct[i]
            && a.light.indirect[i] == b.light.indirect[i]
            && a.light.variance[i] == b.light.variance[i]
    };
    (0..a.len()).filter(|&i| stays(i) && !same(i)).collect()
}

#[test]
fn tiles_are_done_one_by_one_from_the_edit_outwards() {
    let (before, transition) = room_and_edit();
    let after = &transition.after;
    let old = bake(&before, &budget(64), 1, &Unobserved).expect("nobody cancels");
    let importance = Importance { focus: Some(from_above()), tiles: tiles(64, 16, TileMode::Continuous) };
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let shown = Shown::new(usize::MAX);
        let done = pool.install(|| update(&transition, &old, &budget(16), Some(&importance), 2, &shown));
        let mut maps = shown.maps.into_inner().expect("nobody panics");
        maps.push(done.expect("nobody cancels"));
        maps
    };
    let maps = run(1);
    assert!(maps == run(2), "the same bits on two threads");

    let carried = transition.carry_over(&old);
    let (_, shown) = maps.split_last().expect("an end");
    assert!(shown.len() > 12, "{} tiles", shown.len());
    let size = (after.slots() - before.slots()) as f64;
    // The middle of the crate's box.
    let there = on_screen(PLACE + DVec3::new(0.0, 0.15, 0.0));
    let distance = |i: usize| (on_screen(after.positions()[i].as_dvec3()) - there).abs().max_element();
    let (mut last, mut is_done, mut least) = (&carried, vec![false; after.slots()], Vec::new());
    for map in shown {
        let tile = changed(&before, after, last, map);
        assert!(tile.len() <= 64 + 32, "{} elements changed at once", tile.len());
        assert!(tile.iter().all(|&i| !is_done[i]), "a tile that is done changes no more before the rest follows");
        tile.iter().for_each(|&i| is_done[i] = true);
        // Tiles of the crate itself have none that stay.
        least.extend(tile.iter().map(|&i| distance(i)).reduce(f64::min));
        last = map;
    }
    assert!(least.len() > 8 && size > 0.0, "{} tiles of what stays", least.len());
    // An element of the crate may have brought a tile forward.
    let late = least.windows(2).filter(|pair| pair[0] > pair[1] + 0.05).count();
    assert!(late <= 1 && least[0] < 0.35, "{least:?}");
    let outside = |i: &usize| distance(*i) > 2.0 || after.positions()[*i].y > 1.5;
    assert_eq!(changed(&before, after, &carried, last).into_iter().filter(outside).count(), 0);
}

/// New values of finished tiles are right, whatever else is old: without bias against bakes of the new scene.
#[test]
fn tiles_have_no_bias() {
    let (before, transition) = room_and_edit();
    let after = &transition.after;
    let middle = PLACE.as_vec3();
    let region = |i: usize| {
        let p = after.positions()[i];
        i < before.slots() && p.y < 1e-3 && (0.3..0.8).contains(&p.distance(middle))
    };
    let of = |map: &LightMap| area_mean(after, region, |i| map.total(i).as_dvec3());
    let focus = Some(Focus::Sphere { point: PLACE, radius: 0.9 });
    let importance = Importance { focus, tiles: tiles(48, 16, TileMode::Incremental) };
    let (truth, stale) = {
        let fresh = replicate(6, |seed| of(&bake(after, &budget(256), 100 + seed, &Unobserved).expect("a bake")));
        let stale = bake(&before, &budget(256), 5, &Unobserved).expect("a bake");
        (fresh, of(&transition.carry_over(&stale)))
    };
    let shown = replicate(8, |seed| {
        let old = bake(&before, &budget(128), 50 + seed, &Unobserved).expect("a bake");
        let observer = Shown::new(usize::MAX);
        update(&transition, &old, &budget(64), Some(&importance), seed, &observer).expect("nobody cancels");
        let maps = observer.maps.into_inner().expect("nobody panics");
        of(maps.last().expect("a tile"))
    });
    assert!((stale - truth.mean).abs() > 20.0 * shown.error, "the edit does not show: {stale} {truth:?} {shown:?}");
    // Edits agree with bakes up to this much (`super::edits`).
    assert_agrees("what tiles show", shown, truth.mean, 0.004 * truth.mean + 5.0 * truth.error);
}

#[test]
fn incremental_ends_at_tile_quality_and_continuous_goes_on() {
    let (before, transition) = room_and_edit();
    let old = bake(&before, &budget(64), 1, &Unobserved).expect("nobody cancels");
    #[derive(Default)]
    struct Last(Mutex<u32>);
    impl Observer for Last {
        fn snapshot(&self, _: &Arc<LightMap>, _: Snapshot, progress: &Progress) {
            *self.0.lock().expect("nobody panics") = progress.samples_per_element;
        }
    }
    let run = |mode: TileMode| {
        let importance = Importance { focus: Some(from_above()), tiles: tiles(4096, 8, mode) };
        let last = Last::default();
        let map = update(&transition, &old, &budget(32), Some(&importance), 2, &last).expect("nobody cancels");
        (last.0.into_inner().expect("nobody panics"), map)
    };
    let (incremental, continuous) = (run(TileMode::Incremental), run(TileMode::Continuous));
    assert_eq!((incremental.0, continuous.0, run(TileMode::Global).0), (8, 32, 32));
    let ratio = mean_total(&transition.after, &incremental.1) / mean_total(&transition.after, &continuous.1);
    assert!((ratio - 1.0).abs() < 5e-3, "{ratio}");
    let first = Importance { focus: Some(from_above()), tiles: tiles(1 << 20, 64, TileMode::Global) };
    let plain = update(&transition, &old, &budget(16), Some(&from_above().into()), 3, &Unobserved);
    assert!(plain == update(&transition, &old, &budget(16), Some(&first), 3, &Unobserved), "global is what focus does");
}

/// Without a focus the order is by the bound on the change, and what it cannot reach comes with the rest.
#[test]
fn without_focus_what_the_edit_can_change_most_comes_first() {
    let (before, transition) = room_and_edit();
    let after = &transition.after;
    let old = bake(&before, &budget(64), 1, &Unobserved).expect("nobody cancels");
    let importance = Importance { focus: None, tiles: tiles(64, 8, TileMode::Continuous) };
    let shown = Shown::new(3);
    let done = update(&transition, &old, &budget(16), Some(&importance), 2, &shown).expect("nobody cancels");
    let maps = shown.maps.into_inner().expect("nobody panics");
    assert_eq!(maps.len(), 3, "the observer left the others");
    let carried = transition.carry_over(&old);
    let first = changed(&before, after, &carried, &maps[2]);
    let far = first.iter().map(|&i| after.positions()[i].as_dvec3().distance(PLACE)).fold(0.0, f64::max);
    assert!(!first.is_empty() && far < 1.3, "{} elements, up to {far} m away", first.len());
    let plain = update(&transition, &old, &budget(16), None, 3, &Unobserved).expect("nobody cancels");
    let ratio = mean_total(after, &done) / mean_total(after, &plain);
    assert!((ratio - 1.0).abs() < 5e-3, "the whole map is {ratio} of that without tiles");
}

/// Maps with layers go through the same: a lamp that shines elsewhere has nothing but tiles of new light.
#[test]
fn maps_with_layers_go_tile_by_tile_too() {
    let kind = LightKind::Point { position: DVec3::new(1.0, 1.8, 1.0), range: None };
    let bulb = Edit::InsertLight { name: "bulb".into(), kind, color: Vec3::ONE, intensity: 3.0 };
    let group = Edit::GroupLights { group: Some("bulb".into()), lights: vec!["bulb".into()] };
    let before = world(room_objects(0.7), 0.12).apply(&[bulb, group]).expect("a bulb").after;
    let old = bake(&before, &budget(64), 1, &Unobserved).expect("nobody cancels");
    let asset = Arc::new(Scene::from_objects(vec![crate_at("c", 0.0, 0.0, Vec3::splat(0.3))]));
    let transform = DMat4::from_translation(PLACE);
    let transition = before.apply(&[Edit::Insert { asset, name: "crate".into(), transform }]).expect("an edit");
    let focus = Some(Focus::Sphere { point: PLACE, radius: 0.7 });
    let importance = Importance { focus, tiles: tiles(64, 8, TileMode::Continuous) };
    let shown = Shown::new(usize::MAX);
    let done = update(&transition, &old, &budget(16), Some(&importance), 2, &shown).expect("nobody cancels");
    let maps = shown.maps.into_inner().expect("nobody panics");
    let (first, carried) = (maps.first().expect("a tile"), transition.carry_over(&old));
    assert!(maps.len() > 2 && first.layers.len() == done.layers.len() && done.layers.len() > 1);
    let last = maps.last().expect("a tile");
    let far = changed(&before, &transition.after, &carried, last).into_iter().filter(|&i| {
        let p = transition.after.positions()[i].as_dvec3();
        p.distance(PLACE) > 1.0
    });
    // Layers are summed anew where they changed; the same layers make the same sum.
    let layers_differ = |i: usize| last.layers.iter().zip(&carried.layers).any(|(a, b)| a.light.at(i) != b.light.at(i));
    assert_eq!(far.filter(|&i| layers_differ(i)).count(), 0);
}
