//! Light layers: every layer stays what a bake of its lights alone would give, and relighting needs no ray.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DMat4, DVec3, Vec3};
use rebake_core::layers::Layer;
use rebake_core::random::Pcg32;
use rebake_core::scene::{Light, LightKind, Material, Mesh, Object, Scene};
use rebake_core::{
    Budget, DragBasis, Edit, LightMap, LightPart, Observer, Progress, Relight, Snapshot, Unobserved, World,
    WorldOptions, bake, update,
};

use super::scenes::{crate_at, room_objects, world};
use super::statistics::{area_mean, assert_agrees, replicate};

pub(super) fn budget(samples: u32) -> Budget {
    Budget { samples_per_element: samples, target_rmse: None }
}

pub(super) fn baked(world: &World, samples: u32, seed: u64) -> Arc<LightMap> {
    bake(world, &budget(samples), seed, &Unobserved).expect("nobody cancels")
}

fn bulb(name: &str, position: [f64; 3], intensity: f32) -> Edit {
    let kind = LightKind::Point { position: DVec3::from_array(position), range: None };
    Edit::InsertLight { name: name.into(), kind, color: Vec3::ONE, intensity }
}

fn relight(light: &str, color: Vec3, intensity: f32) -> Edit {
    Edit::Relight { lights: vec![Relight { light: light.into(), color: Some(color), intensity: Some(intensity) }] }
}

/// A room with the ceiling's lamp and three bulbs.
fn room(spacing: f32) -> World {
    let bulbs =
        [bulb("red", [0.8, 1.5, 2.2], 1.5), bulb("green", [2.3, 1.2, 0.7], 1.0), bulb("blue", [2.2, 0.6, 2.3], 0.5)];
    world(room_objects(0.7), spacing).apply(&bulbs).expect("bulbs").after
}

fn each_alone(world: &World) -> World {
    let names = |world: &World| -> Vec<String> { world.lights().map(|l| l.light.name.clone()).collect() };
    let edits: Vec<Edit> = names(world)
        .into_iter()
        .map(|name| Edit::GroupLights { group: Some(name.clone()), lights: vec![name] })
        .collect();
    world.apply(&edits).expect("groups").after
}

/// Counts rays and snapshots.
#[derive(Default)]
pub(super) struct Count {
    pub(super) rays: AtomicU64,
    snapshots: AtomicU64,
}

impl Observer for Count {
    fn snapshot(&self, _: &Arc<LightMap>, _: Snapshot, progress: &Progress) {
        self.rays.store(progress.rays, Ordering::Relaxed);
        self.snapshots.fetch_add(1, Ordering::Relaxed);
    }
}

/// The scene with the lights of one layer only, at the strength that the layer holds.
fn alone(world: &World, layer: &Layer) -> World {
    let reference = |light: &Light| layer.lights.iter().find(|l| l.name == light.name).map(|l| l.reference);
    let lit = |light: &Light| reference(light).map(|color| Light { color, intensity: 1.0, ..light.clone() });
    let lights = world.scene.lights.iter().filter_map(lit).collect();
    let scene = Scene { lights, groups: std::collections::BTreeMap::new(), ..Scene::clone(&world.scene) };
    let options = WorldOptions { spacing: Some(world.spacing()), ..WorldOptions::default() };
    World::new(scene, &options).expect("it was a scene before")
}

/// The parts of a layer of several maps against bakes of that layer alone: means of objects that both worlds have.
fn check_layer(name: &str, world: &World, maps: &[Arc<LightMap>], layer: usize, bias: f64) {
    let alone = alone(world, &maps[0].layers[layer]);
    let fresh: Vec<Arc<LightMap>> = (0..4).map(|seed| baked(&alone, 128, 900 + seed)).collect();
    for part in [LightPart::Direct, LightPart::Indirect] {
        let mean = |world: &World, values: &[Vec3]| area_mean(world, |_| true, |i| values[i].as_dvec3());
        let of_map = |map: &LightMap| mean(&alone, &map.light.part(part));
        let of_fresh = replicate(fresh.len() as u64, |i| of_map(&fresh[i as usize]));
        let truth = fresh.iter().map(|map| of_map(map)).sum::<f64>() / fresh.len() as f64;
        let of_layer = |i: u64| mean(world, &maps[i as usize].layers[layer].light.part(part));
        let estimate = replicate(maps.len() as u64, of_layer);
        let name = format!("{name}, layer {}, {part:?}", maps[0].layers[layer].name);
        assert_agrees(&name, estimate, truth, bias * truth + 5.0 * of_fresh.error);
    }
}

/// The weighted sum of its layers is the map, up to rounding.
pub(super) fn check_sum(world: &World, map: &LightMap) {
    let weights = map.layer_weights(&world.scene);
    for slot in 0..map.len() {
        let sum: Vec3 =
            map.layers.iter().zip(&weights).map(|(l, w)| (l.light.at(slot).0 + l.light.at(slot).1) * *w).sum();
        let off = (sum - map.total(slot)).abs().max_element();
        assert!(off <= 1e-5 * (1.0 + sum.abs().max_element()), "slot {slot}: {sum} {}", map.total(slot));
    }
}

#[test]
fn layers_of_a_bake_are_bakes_of_their_lights() {
    let world = each_alone(&room(0.2));
    let maps: Vec<Arc<LightMap>> = (0..8).map(|seed| baked(&world, 64, seed)).collect();
    assert_eq!(maps[0].layers.len(), 4);
    check_sum(&world, &maps[0]);
    for layer in 0..4 {
        check_layer("bake", &world, &maps, layer, 1e-3);
    }
    // All together are the light of a bake that tells none apart.
    let together = room(0.2);
    let mean = |world: &World, map: &LightMap| area_mean(world, |_| true, |i| map.total(i).as_dvec3());
    let plain: Vec<Arc<LightMap>> = (0..8).map(|seed| baked(&together, 64, 50 + seed)).collect();
    let truth = replicate(8, |i| mean(&together, &plain[i as usize]));
    let estimate = replicate(8, |i| mean(&world, &maps[i as usize]));
    assert_agrees("layers together", estimate, truth.mean, 5.0 * truth.error);
}

#[test]
fn a_light_that_is_relit_gets_a_layer_of_its_own_and_then_needs_no_ray() {
    let start = room(0.2);
    let first = start.apply(&[relight("red", Vec3::new(1.0, 0.2, 0.1), 3.0)]).expect("a relight");
    let maps: Vec<Arc<LightMap>> = (0..8)
        .map(|seed| {
            let old = baked(&start, 64, seed);
            update(&first, &old, &budget(32), None, seed, &Unobserved).expect("nobody cancels")
        })
        .collect();
    let names: Vec<&str> = maps[0].layers.iter().map(|l| l.name.as_str()).collect();
    assert_eq!(names, ["shared", "red"]);
    check_sum(&first.after, &maps[0]);
    for layer in 0..2 {
        check_layer("split", &first.after, &maps, layer, 3e-3);
    }
    // What is stated is what is there, against a mean of many: light that left one layer for another counts once.
    let n = maps.len() as f64;
    let mean = |slot: usize| maps.iter().map(|m| m.total(slot).as_dvec3()).sum::<DVec3>() / n;
    let scatter = area_mean(
        &first.after,
        |_| true,
        |i| {
            let mean = mean(i);
            maps.iter().map(|m| (m.total(i).as_dvec3() - mean).powf(2.0)).sum::<DVec3>() / (n - 1.0)
        },
    );
    let stated = area_mean(
        &first.after,
        |_| true,
        |i| DVec3::splat(maps.iter().map(|m| f64::from(m.light.variance[i])).sum::<f64>() / n),
    );
    let ratio = (stated / scatter).sqrt();
    assert!((0.67..1.5).contains(&ratio), "stated over found error: {ratio}");
    let steps = [relight("red", Vec3::ZERO, 0.0), relight("red", Vec3::new(0.0, 1.0, 5.0), 2.0)];
    let (mut world, mut map) = (first.after.clone(), maps[0].clone());
    for step in steps {
        let transition = world.apply(&[step]).expect("a relight");
        let count = Count::default();
        let new = update(&transition, &map, &budget(16), None, 7, &count).expect("nobody cancels");
        assert_eq!((count.rays.into_inner(), count.snapshots.into_inner()), (0, 1));
        check_sum(&transition.after, &new);
        assert!(Arc::ptr_eq(&new.layers[1], &map.layers[1]), "no layer has changed");
        (world, map) = (transition.after, new);
    }
    // Back at its old strength the light is what it was, bit for bit.
    let back = world.apply(&[relight("red", Vec3::new(1.0, 0.2, 0.1), 3.0)]).expect("a relight");
    let back = update(&back, &map, &budget(16), None, 8, &Unobserved).expect("nobody cancels");
    assert_eq!(back.light.direct, maps[0].light.direct);
    assert_eq!(back.light.indirect, maps[0].light.indirect);
}

#[test]
fn lights_that_come_go_and_move_touch_their_own_layer_only() {
    let start = each_alone(&room(0.2));
    let old = baked(&start, 64, 1);
    let apply = |world: &World, map: &LightMap, edit: Edit, seed: u64| {
        let transition = world.apply(&[edit]).expect("an edit");
        let map = update(&transition, map, &budget(32), None, seed, &Unobserved).expect("nobody cancels");
        (transition.after, map)
    };
    let place = Some(DVec3::new(1.2, 1.0, 2.5));
    let moved = Edit::MoveLight { light: "red".into(), position: place, direction: None, own_layer: false };
    let (world, map) = apply(&start, &old, moved, 2);
    let red = map.layers.iter().position(|l| l.name == "red").expect("a layer");
    for (k, (new, old)) in map.layers.iter().zip(&old.layers).enumerate() {
        assert_eq!(Arc::ptr_eq(new, old), k != red, "layer {}", new.name);
    }
    let maps: Vec<Arc<LightMap>> = (0..8)
        .map(|seed| {
            let moved = Edit::MoveLight { light: "red".into(), position: place, direction: None, own_layer: false };
            apply(&start, &old, moved, 20 + seed).1
        })
        .collect();
    check_layer("moved", &world, &maps, red, 3e-3);
    let (world, map) = apply(&world, &map, bulb("white", [1.5, 0.4, 0.4], 1.0), 3);
    assert_eq!(map.layers.len(), 5);
    check_sum(&world, &map);
    // Removing a light takes its layer away and leaves the others alone, without rays.
    let transition = world.apply(&[Edit::RemoveLight { light: "white".into() }]).expect("it goes");
    let count = Count::default();
    let without = update(&transition, &map, &budget(16), None, 4, &count).expect("nobody cancels");
    assert_eq!((without.layers.len(), count.rays.into_inner()), (4, 0));
    check_sum(&transition.after, &without);
    // Together in one group, at what they shine with now.
    let group = Edit::GroupLights { group: Some("pair".into()), lights: vec!["red".into(), "green".into()] };
    let transition = transition.after.apply(&[group]).expect("a group");
    let count = Count::default();
    let paired = update(&transition, &without, &budget(16), None, 5, &count).expect("nobody cancels");
    assert_eq!((paired.layers.len(), count.rays.into_inner()), (3, 0));
    check_sum(&transition.after, &paired);
}

#[test]
fn thirty_edits_leave_every_layer_what_a_bake_gives() {
    const TURNS: u64 = 30;
    let start = each_alone(&room(0.2));
    let run = |seed: u64| {
        let (mut world, mut map) = (start.clone(), baked(&start, 128, seed));
        // The same edits in all runs.
        let mut dice = Pcg32::new(11, 12);
        for turn in 0..TURNS {
            let transition = world.apply(&[random_edit(&mut dice, &world, turn)]).expect("an edit");
            map = update(&transition, &map, &budget(32), None, 1000 * seed + turn, &Unobserved).expect("no cancel");
            world = transition.after;
            if world.needs_rebuild() {
                let trees = world.rebuilt_trees();
                world = world.with_trees(trees).expect("nothing has changed since");
            }
        }
        (world, map)
    };
    let runs: Vec<(World, Arc<LightMap>)> = (0..3).map(run).collect();
    let maps: Vec<Arc<LightMap>> = runs.iter().map(|r| r.1.clone()).collect();
    check_sum(&runs[0].0, &maps[0]);
    assert!(maps[0].layers.len() >= 4);
    for layer in 0..maps[0].layers.len() {
        // Thirty times the bias of an edit (a tenth of what the tests of edits allow).
        check_layer("thirty edits", &runs[0].0, &maps, layer, 1e-2);
    }
}

/// An edit of any kind that the world can take.
fn random_edit(dice: &mut Pcg32, world: &World, turn: u64) -> Edit {
    let mut number = || dice.next_f32();
    let (x, z) = (f64::from(0.6 + 1.8 * number()), f64::from(0.6 + 1.8 * number()));
    let place = DMat4::from_translation(DVec3::new(x, 0.0, z));
    let albedo = Vec3::new(number(), number(), number()) * 0.6 + 0.2;
    let has = |name: &str| world.objects().any(|o| o.name == name);
    let is_lit = |name: &str| world.lights().any(|l| l.light.name == name);
    match turn % 8 {
        0 if !has("crate") => Edit::Insert {
            asset: Arc::new(Scene::from_objects(vec![crate_at("c", 0.0, 0.0, albedo)])),
            name: "crate".into(),
            transform: place,
        },
        1 if has("crate") => Edit::Move { object: "crate".into(), transform: place },
        2 => Edit::Material { object: "back".into(), albedo },
        3 => relight("green", albedo, 0.5 + number()),
        4 if !is_lit("white") => bulb("white", [x, 1.4, z], 0.8),
        5 => Edit::MoveLight {
            light: "blue".into(),
            position: Some(DVec3::new(x, 0.9, z)),
            direction: None,
            own_layer: false,
        },
        6 if is_lit("white") => Edit::RemoveLight { light: "white".into() },
        7 if has("crate") => Edit::Remove { objects: vec!["crate".into()] },
        _ => relight("lamp", albedo, 8.0),
    }
}

#[test]
fn a_dragged_light_has_frames_near_the_exact_update() {
    let start = each_alone(&room(0.1));
    let map = baked(&start, 64, 1);
    let basis = DragBasis::new(&start, 2, &Unobserved).expect("nobody cancels");
    assert!(basis.fits(&start) && basis.memory_bytes() > 0);
    let moved = |light: &str, place: [f64; 3]| Edit::MoveLight {
        light: light.into(),
        position: Some(DVec3::from_array(place)),
        direction: None,
        own_layer: false,
    };
    let transition = start.apply(&[moved("red", [1.9, 1.1, 1.3])]).expect("a move");
    let count = Count::default();
    let frame = basis.frame(&transition, &map, 3, &count).expect("nobody cancels").expect("a frame");
    check_sum(&transition.after, &frame);
    let red = frame.layers.iter().position(|l| l.name == "red").expect("a layer");
    let others = |m: &LightMap| -> Vec<Arc<Layer>> { m.layers.iter().filter(|l| l.name != "red").cloned().collect() };
    assert!(others(&frame).iter().zip(others(&map)).all(|(a, b)| Arc::ptr_eq(a, &b)));
    // A bulb's direct light is exact; the rest leaves out a little light in corners, and what is finer than its subset.
    let exact = baked(&alone(&transition.after, &frame.layers[red]), 256, 4);
    let mean = |values: &[Vec3]| area_mean(&transition.after, |_| true, |i| values[i].as_dvec3());
    let [frame, old] = [&frame, &*map].map(|map| map.layers[red].light.to_dense());
    assert!((mean(&frame.direct) / mean(&exact.light.direct) - 1.0).abs() < 1e-4);
    let ratio = mean(&frame.indirect) / mean(&exact.light.indirect);
    let error = |values: &[Vec3]| {
        area_mean(&transition.after, |_| true, |i| (values[i] - exact.light.indirect[i]).as_dvec3().powf(2.0)).sqrt()
    };
    let (off, without) = (error(&frame.indirect), error(&old.indirect));
    assert!((0.93..1.03).contains(&ratio), "indirect light of the frame is {ratio:.4} of a bake's");
    assert!(off < 0.3 * without, "off by {off}, by {without} without the frame");
    // Other edits have no frames.
    for edit in [relight("green", Vec3::ONE, 2.0), Edit::Remove { objects: vec!["block".into()] }] {
        let transition = start.apply(&[edit]).expect("an edit");
        assert!(basis.frame(&transition, &map, 3, &Unobserved).expect("nobody cancels").is_none());
    }
    let elsewhere = start.apply(&[Edit::Material { object: "back".into(), albedo: Vec3::ZERO }]).expect("paint").after;
    assert!(!basis.fits(&elsewhere));
}

/// Of a light map with layers, after a crate moved in a room whose lamps were off, and as they come on again.
#[test]
fn what_changes_in_the_dark_is_as_good_as_what_changes_in_the_light() {
    const RUNS: u64 = 6;
    let start = each_alone(&room(0.2)).apply(&[insert_crate()]).expect("a crate").after;
    let old = baked(&start, 64, 1);
    let apply = |(world, map): (&World, &Arc<LightMap>), edits: &[Edit], seed: u64| {
        let transition = world.apply(edits).expect("edits");
        let map = update(&transition, map, &budget(16), None, seed, &Unobserved).expect("nobody cancels");
        (transition.after, map)
    };
    let strengths: Vec<(String, f32)> = start.lights().map(|l| (l.light.name.clone(), l.light.intensity)).collect();
    let relit = |factor: f32| Edit::Relight {
        lights: (strengths.iter())
            .map(|(light, was)| Relight { light: light.clone(), color: None, intensity: Some(factor * was) })
            .collect(),
    };
    let moved = Edit::Move { object: "crate".into(), transform: DMat4::from_translation(DVec3::new(0.7, 0.0, 0.3)) };
    let runs = |edits: &[Edit]| -> (World, Vec<Arc<LightMap>>) {
        let run = |seed: u64| {
            let first = (start.clone(), Arc::clone(&old));
            edits.iter().fold(first, |(world, map), edit| apply((&world, &map), std::slice::from_ref(edit), seed))
        };
        let worlds: Vec<_> = (0..RUNS).map(run).collect();
        (worlds[0].0.clone(), worlds.into_iter().map(|(_, map)| map).collect())
    };
    // What is found anew, beside the old map's noise, which all have in common.
    let noise = |edits: &[Edit]| {
        let (world, maps) = runs(edits);
        let mean = |i: usize| maps.iter().map(|m| m.total(i).as_dvec3()).sum::<DVec3>() / RUNS as f64;
        let square = |i: usize, m: &Arc<LightMap>| (m.total(i).as_dvec3() - mean(i)).powf(2.0);
        area_mean(&world, |_| true, |i| maps.iter().map(|m| square(i, m)).sum::<DVec3>() / (RUNS - 1) as f64)
    };
    let (lit, dark) = (noise(std::slice::from_ref(&moved)), noise(&[relit(0.0), moved, relit(1.0)]));
    assert!(dark < 1.5 * lit, "variance of what changes in the dark {dark}, in the light {lit}");
}

fn insert_crate() -> Edit {
    let asset = Arc::new(Scene::from_objects(vec![crate_at("c", 0.0, 0.0, Vec3::splat(0.5))]));
    Edit::Insert { asset, name: "crate".into(), transform: DMat4::from_translation(DVec3::new(1.6, 0.0, 1.5)) }
}

/// Whether a change outgrows the light that is left is judged at the layer's own scale.
#[test]
fn a_single_layer_is_brought_up_to_date_alike_at_any_strength() {
    let start = each_alone(&world(room_objects(0.7), 0.2));
    let old = baked(&start, 16, 1);
    assert_eq!(old.layers.len(), 1);
    let lamp = start.lights().next().expect("a lamp").light.name.clone();
    let plate = Object::new(
        "plate",
        Mesh::cuboid(Vec3::new(0.2, 1.6, 0.2), Vec3::new(2.8, 1.7, 2.8)),
        Material::diffuse(Vec3::ONE),
    );
    let plate = Edit::Insert {
        asset: Arc::new(Scene::from_objects(vec![plate])),
        name: "plate".into(),
        transform: DMat4::IDENTITY,
    };
    let at = |intensity: f32| {
        let relit = start.apply(&[relight(&lamp, Vec3::ONE, intensity)]).expect("a relight");
        let map = update(&relit, &old, &budget(8), None, 2, &Unobserved).expect("nobody cancels");
        let hidden = relit.after.apply(std::slice::from_ref(&plate)).expect("a plate");
        update(&hidden, &map, &budget(8), None, 3, &Unobserved).expect("nobody cancels")
    };
    let (dim, bright) = (at(1e-3), at(1e3));
    for part in [LightPart::Direct, LightPart::Indirect] {
        assert_eq!(dim.layers[0].light.part(part), bright.layers[0].light.part(part));
    }
}
