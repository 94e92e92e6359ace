//! What light layers cost: `cargo bench -p rebake-core --bench layers [-- LAMPS SPACING]`.
//!
//! A closed room of 6 × 3 × 6 m with 16 lamps in a grid below its ceiling and some boxes. Prints, in alternating runs, the
//! time of a bake and of an insert with 1, 3, 8 and 16 layers over that with none, over that many separate solutions, and
//! the time of a relight beside that of reading all layers' bytes once, and the frames per second of a dragged light.
#![allow(clippy::print_stdout)]

use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use glam::{DMat4, DVec3, Vec3};
use rebake_core::scene::{LightKind, Material, Mesh, Object, Scene};
use rebake_core::{Budget, DragBasis, Edit, LightMap, Relight, Unobserved, World, WorldOptions, bake, update};

/// Runs of each; the median counts.
const RUNS: usize = 5;

const BUDGET: Budget = Budget { samples_per_element: 16, target_rmse: None };

fn main() {
    let mut arguments = std::env::args().skip(1).filter_map(|argument| argument.parse::<f32>().ok());
    let lamps = arguments.next().map_or(16, |n| n as usize);
    let spacing = arguments.next().unwrap_or(0.06);
    let plain = room(lamps, spacing);
    println!("{} elements, {} triangles, {lamps} lamps", plain.element_count(), plain.triangle_count());
    let worlds: Vec<(usize, World)> =
        [1, 3, 8, 16].into_iter().filter(|k| *k <= lamps).map(|k| (k, grouped(&plain, lamps, k))).collect();
    let mut times = vec![Vec::new(); worlds.len()];
    let mut inserts = vec![Vec::new(); worlds.len()];
    for run in 0..RUNS as u64 {
        for (k, (_, world)) in worlds.iter().enumerate() {
            let (seconds, map) = timed(|| bake(world, &BUDGET, run, &Unobserved).expect("nobody cancels"));
            times[k].push(seconds);
            let edit = Edit::Insert {
                asset: Arc::new(Scene::from_objects(vec![boxed(Vec3::ZERO)])),
                name: "box".into(),
                transform: DMat4::from_translation(DVec3::new(3.0, 0.0, 1.0)),
            };
            let transition = world.apply(&[edit]).expect("an insert");
            let (seconds, _) = timed(|| update(&transition, &map, &BUDGET, None, run, &Unobserved).expect("no cancel"));
            inserts[k].push(seconds);
        }
    }
    let one = (median(&mut times[0]), median(&mut inserts[0]));
    for (k, (layers, _)) in worlds.iter().enumerate() {
        let (bake, insert) = (median(&mut times[k]), median(&mut inserts[k]));
        println!(
            "{layers:2} layers: bake {bake:.3} s, {:.2} of one layer, separate ones {:.1} times as long; insert {insert:.3} s, {:.2}, {:.1}",
            bake / one.0,
            *layers as f64 * one.0 / bake,
            insert / one.1,
            *layers as f64 * one.1 / insert,
        );
    }
    for (layers, world) in worlds.iter().filter(|(k, _)| *k > 1) {
        relights(*layers, world);
    }
    drag(&plain);
}

/// Frames per second of a bulb that is dragged through the room.
fn drag(world: &World) {
    let kind = LightKind::Point { position: DVec3::new(3.0, 1.5, 3.0), range: None };
    let bulb = Edit::InsertLight { name: "bulb".into(), kind, color: Vec3::ONE, intensity: 2.0 };
    let group = Edit::GroupLights { group: Some("bulb".into()), lights: vec!["bulb".into()] };
    let world = world.apply(&[bulb, group]).expect("a bulb").after;
    let map = bake(&world, &Budget { samples_per_element: 4, ..BUDGET }, 1, &Unobserved).expect("nobody cancels");
    let (built, basis) = timed(|| DragBasis::new(&world, 1, &Unobserved).expect("nobody cancels"));
    let mut seconds = Vec::new();
    for k in 0..20 {
        let position = Some(DVec3::new(1.0 + 0.2 * f64::from(k), 1.2, 2.0));
        let step = Edit::MoveLight { light: "bulb".into(), position, direction: None, drag: false };
        let (time, frame) = timed(|| {
            let transition = world.apply(&[step]).expect("a move");
            basis.frame(&transition, &map, 1, &Unobserved).expect("nobody cancels")
        });
        assert!(frame.is_some(), "a light of its own layer has frames");
        seconds.push(time);
    }
    let bytes = basis.memory_bytes() / world.element_count();
    println!(
        "drag: basis {built:.3} s, {bytes} bytes per element; {:.1} frames per second",
        1.0 / median(&mut seconds)
    );
}

/// Times of relights of one layer, and of reading all layers.
fn relights(layers: usize, world: &World) {
    let map = bake(world, &Budget { samples_per_element: 1, ..BUDGET }, 1, &Unobserved).expect("nobody cancels");
    let (mut seconds, mut reads) = (Vec::new(), Vec::new());
    let light = map.layers[0].lights.iter().map(|light| light.name.clone());
    let lights = light.map(|light| Relight { light, color: None, intensity: Some(3.0) }).collect();
    let transition = world.apply(&[Edit::Relight { lights }]).expect("a relight");
    for run in 0..3 * RUNS as u64 {
        let (time, new) = timed(|| update(&transition, &map, &BUDGET, None, run, &Unobserved).expect("no cancel"));
        black_box(new);
        seconds.push(time);
        reads.push(timed(|| black_box(sum_of(&map))).0);
    }
    let (relight, read) = (median(&mut seconds), median(&mut reads));
    let bytes = map.layers.iter().map(|l| 28 * l.direct.len()).sum::<usize>();
    println!(
        "{layers:2} layers: relight {:.1} ms, reading their {} MB {:.1} ms, {:.1} of it; {} bytes per element",
        1e3 * relight,
        bytes >> 20,
        1e3 * read,
        relight / read,
        map.memory_bytes() / map.len(),
    );
}

/// Reads all layers once, on all threads.
fn sum_of(map: &LightMap) -> f32 {
    use rayon::prelude::*;
    let vectors =
        |v: &Vec<Vec3>| v.par_chunks(4096).map(|c| c.iter().map(|v| v.x + v.y + v.z).sum::<f32>()).sum::<f32>();
    let scalars = |v: &Vec<f32>| v.par_chunks(4096).map(|c| c.iter().sum::<f32>()).sum::<f32>();
    map.layers.iter().map(|l| vectors(&l.direct) + vectors(&l.indirect) + scalars(&l.variance)).sum()
}

fn timed<T>(f: impl FnOnce() -> T) -> (f64, T) {
    let start = Instant::now();
    let value = f();
    (start.elapsed().as_secs_f64(), value)
}

fn median(times: &mut [f64]) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn boxed(at: Vec3) -> Object {
    Object::new("box", Mesh::cuboid(at, at + Vec3::new(0.6, 0.9, 0.5)), Material::diffuse(Vec3::new(0.6, 0.5, 0.3)))
}

/// All lamps in `layers` layers, the shared one among them.
fn grouped(world: &World, lamps: usize, layers: usize) -> World {
    if layers == 1 {
        return world.clone();
    }
    let group = |i: usize| Edit::GroupLights {
        group: Some(format!("group {}", i % layers)),
        lights: vec![format!("lamp {i}")],
    };
    world.apply(&(0..lamps).filter(|i| i % layers != 0).map(group).collect::<Vec<_>>()).expect("groups").after
}

fn room(lamps: usize, spacing: f32) -> World {
    let (low, high) = (Vec3::ZERO, Vec3::new(6.0, 3.0, 6.0));
    let mut objects =
        vec![Object::new("room", Mesh::cuboid(low, high).inside_out(), Material::diffuse(Vec3::splat(0.7)))];
    for i in 0..6 {
        let mut object = boxed(Vec3::new(0.5 + 0.8 * i as f32, 0.0, 1.5 + 0.6 * i as f32));
        object.name = format!("box {i}");
        objects.push(object);
    }
    let side = (lamps as f32).sqrt().ceil() as usize;
    for i in 0..lamps {
        let cell = 6.0 / side as f32;
        let corner = Vec3::new(cell * (0.4 + (i % side) as f32), 2.9, cell * (0.4 + (i / side) as f32));
        let mesh = Mesh::quad(corner, Vec3::X * 0.2, Vec3::Z * 0.2);
        let material = Material::emissive(Vec3::new(6.0, 5.0 + (i % 3) as f32, 4.0));
        objects.push(Object::new(format!("lamp {i}"), mesh, material));
    }
    let options = WorldOptions { spacing: Some(spacing), ..WorldOptions::default() };
    World::new(Scene::from_objects(objects), &options).expect("a room")
}
