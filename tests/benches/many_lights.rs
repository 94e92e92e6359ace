//! What many lamps cost: `cargo bench -p rebake-tests --bench many_lights [-- rooms=8x8x4 spacing=0.2 samples=16]`;
//! `glb=FILE` writes the building as a file instead.
//!
//! A building of rooms with doors between them and a lamp in each, a layer for each lamp. Prints, beside the same without
//! layers: the time of a bake and of inserting a box, bytes per element (and over those of eight layers that are kept in
//! every slot), layers that are told apart at an element, the part of all light that is left to none, the time of relighting
//! a lamp, and how far off a lamp alone is, lit ten times as bright, beside what is stated of it.
#![allow(clippy::print_stdout)]

#[path = "../oracle/building.rs"]
mod building;

use std::sync::Arc;
use std::time::Instant;

use glam::{DMat4, DVec3, Vec3};
use rebake_core::export::write_scene_glb;
use rebake_core::scene::{Material, Mesh, Object, Scene};
use rebake_core::{Budget, Edit, LightMap, Relight, Unobserved, World, WorldOptions, bake, update};

/// Runs of each; the median counts.
const RUNS: usize = 3;

/// Bytes of a slot in a layer that is kept everywhere.
const DENSE: usize = 28;

fn main() {
    rebake::keep_freed_memory();
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let value = |name: &str| arguments.iter().find_map(|argument| argument.strip_prefix(name)?.strip_prefix('='));
    let sides: Vec<usize> =
        value("rooms").unwrap_or("8x8x4").split('x').map(|side| side.parse().expect("a number of rooms")).collect();
    let size: building::Rooms = sides.try_into().expect("three numbers of rooms");
    let spacing = value("spacing").unwrap_or("0.2").parse().expect("spacing in metres");
    let samples = value("samples").unwrap_or("16").parse().expect("samples per element");
    if let Some(file) = value("glb") {
        let bytes = write_scene_glb(&building::building(size)).expect("a building");
        return std::fs::write(file, bytes).expect("a file that can be written");
    }
    let budget = Budget { samples_per_element: samples, target_rmse: None };
    let options = WorldOptions { spacing: Some(spacing), ..WorldOptions::default() };
    let plain = World::new(building::building(size), &options).expect("a building");
    let layered = plain.apply(&building::each_lamp(&plain.scene)).expect("groups").after;
    println!("{} lamps, {} elements, {samples} samples per element", plain.scene.lights.len(), plain.element_count());

    let mut maps = Vec::new();
    let mut times = [(); 2].map(|()| (Vec::new(), Vec::new()));
    for run in 0..RUNS as u64 {
        for (world, (bakes, inserts)) in [&plain, &layered].into_iter().zip(&mut times) {
            let (seconds, map) = timed(|| bake(world, &budget, run, &Unobserved).expect("nobody cancels"));
            bakes.push(seconds);
            let transition = world.apply(&[insert()]).expect("an insert");
            let updated = || update(&transition, &map, &budget, None, run, &Unobserved).expect("nobody cancels");
            inserts.push(timed(updated).0);
            maps.push(map);
        }
    }
    let [(bake_one, insert_one), (bake_all, insert_all)] =
        times.map(|(mut bakes, mut inserts)| (median(&mut bakes), median(&mut inserts)));
    println!("bake: {bake_all:.2} s, {bake_one:.2} s without layers, {:.2} of it", bake_all / bake_one);
    println!("insert: {insert_all:.3} s, {insert_one:.3} s without layers, {:.2} of it", insert_all / insert_one);
    let map = &maps[1];
    memory(map);
    let mut relights: Vec<f64> = (0..7).map(|run| relit(&layered, map, &budget, run).0).collect();
    println!("relight of a lamp: {:.1} ms", 1e3 * median(&mut relights));
    off(&layered, map, &budget);
}

fn memory(map: &LightMap) {
    let layers: usize = map.layers.iter().map(|layer| layer.light.memory_bytes()).sum();
    let rest = map.rest().expect("more layers than fit side by side");
    let light = |slot: usize| map.total(slot).abs().element_sum();
    let left = |slot: usize| (rest.light.at(slot).0 + rest.light.at(slot).1).abs().element_sum();
    let all: f32 = (0..map.len()).map(light).sum();
    println!(
        "{} bytes per element in layers, {:.2} of those of 8 that are everywhere; {:.1} layers at an element; {:.2} % of all \
         light is left to none",
        layers / map.len(),
        layers as f64 / (8 * DENSE * map.len()) as f64,
        layers as f64 / (DENSE * map.len()) as f64,
        100.0 * (0..map.len()).map(left).sum::<f32>() / all,
    );
}

/// Seconds until a lamp is ten times as bright, and the map then.
fn relit(world: &World, map: &LightMap, budget: &Budget, run: u64) -> (f64, Arc<LightMap>, World) {
    let light = building::lamp([run as usize % 2, 1, 0]);
    let before = world.scene.lights.iter().find(|found| found.name == light).expect("a lamp").intensity;
    let lights = vec![Relight { light, color: None, intensity: Some(10.0 * before) }];
    let transition = world.apply(&[Edit::Relight { lights }]).expect("a relight");
    let (seconds, map) = timed(|| update(&transition, map, budget, None, run, &Unobserved).expect("nobody cancels"));
    (seconds, map, transition.after)
}

/// Light of a lamp that is made ten times as bright, against a bake.
fn off(world: &World, map: &LightMap, budget: &Budget) {
    let (_, found, world) = relit(world, map, budget, 0);
    let plain = World::new(
        Scene { groups: Default::default(), ..Scene::clone(&world.scene) },
        &WorldOptions { spacing: Some(world.spacing()), ..WorldOptions::default() },
    )
    .expect("it was a world before");
    let truth = Budget { samples_per_element: 16 * budget.samples_per_element, ..*budget };
    let truth = bake(&plain, &truth, 99, &Unobserved).expect("nobody cancels");
    let fresh = bake(&plain, budget, 98, &Unobserved).expect("nobody cancels");
    let rmse = |map: &LightMap| {
        let square = |slot: usize| f64::from((map.total(slot) - truth.total(slot)).length_squared()) / 3.0;
        plain.area_mean((0..map.len()).filter(|&slot| plain.is_valid(slot)), square).sqrt()
    };
    let mean = plain.area_mean(0..truth.len(), |slot| f64::from(truth.total(slot).element_sum()) / 3.0);
    println!(
        "a lamp ten times as bright: RMSE {:.4}, stated {:.4}; a bake of as many samples {:.4}; mean light {mean:.4}",
        rmse(&found),
        found.estimated_rmse(world.areas()),
        rmse(&fresh),
    );
}

fn insert() -> Edit {
    let mesh = Mesh::cuboid(Vec3::ZERO, Vec3::new(0.5, 0.9, 0.5));
    let asset = Scene::from_objects(vec![Object::new("chair", mesh, Material::diffuse(Vec3::splat(0.5)))]);
    Edit::Insert {
        asset: Arc::new(asset),
        name: "chair".into(),
        transform: DMat4::from_translation(DVec3::new(2.4, 0.0, 2.6)),
    }
}

fn timed<T>(f: impl FnOnce() -> T) -> (f64, T) {
    let start = Instant::now();
    let value = f();
    (start.elapsed().as_secs_f64(), value)
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
