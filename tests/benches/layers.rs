//! What light layers cost: `cargo bench -p rebake-tests --bench layers [-- SCENES]`.
//!
//! Scenes: `room`, a closed room of 6 × 3 × 6 m with 16 lamps in a grid below its ceiling and some boxes;
//! `cornell-box`, with two lamps more; `living-room-2`, with its four lights; and `million`, the room at a million
//! elements, for relights only. All of them where none is named. `room=0.05` sets the distance between elements in
//! metres, `scenes=FOLDER` where the files of the others are; those that are not there are passed over.
//!
//! Prints, in alternating runs, the time of a bake and of an insert with some numbers of layers over that with none,
//! and the time of separate solutions, each with the lights of one layer only, over that of all layers together; the
//! time of a relight beside that of reading all layers' bytes once; when a bake with the most layers has something to
//! show, and how far off that is; and the frames per second of a dragged light.
#![allow(clippy::print_stdout)]

mod asked;

use std::hint::black_box;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use glam::{DMat4, DVec3, Vec3};
use rebake_core::layers::{Layer, LightBlock, blocks_of};
use rebake_core::scene::{LightKind, LoadLimits, Material, Mesh, Object, Scene, load};
use rebake_core::{
    Budget, DragBasis, Edit, LightMap, Observer, Progress, Relight, Snapshot, Unobserved, World, WorldOptions, bake,
    update,
};

use asked::Asked;

/// Runs of each; the median counts.
const RUNS: usize = 5;

/// Runs of separate solutions.
const SEPARATE_RUNS: usize = 3;

const BUDGET: Budget = Budget { samples_per_element: 16, target_rmse: None };

/// Distance between elements (m) of each scene, unless another is asked for: some 60,000 to 260,000 elements, and a
/// million.
const SPACINGS: [(&str, f32); 4] = [("room", 0.08), ("cornell-box", 0.04), ("living-room-2", 0.3), ("million", 0.0213)];

fn main() {
    rebake::keep_freed_memory();
    let asked = Asked::new();
    let folder = asked.folder();
    for (name, spacing) in asked.scenes(&SPACINGS) {
        match name {
            "room" => {
                let world = room(16, spacing);
                let floor = DMat4::from_translation(DVec3::new(3.0, 0.0, 1.0));
                let split = compare(name, &world, &[1, 3, 8, 16], floor);
                split.iter().for_each(|(layers, world)| relights(*layers, world));
                drag(&world);
            }
            "million" => {
                let world = grouped(&room(16, spacing), 8);
                println!("{name}: {} elements", world.element_count());
                relights(8, &world);
            }
            _ => match file(&folder, name, spacing) {
                Some((world, place)) => drop(compare(name, &world, &[1, world.lights().count()], place)),
                None => println!("{name}: passed over, there is no {name} in {}", folder.display()),
            },
        }
    }
}

/// Prints what layers cost in a scene where a box is put at `place`; the scene with each number of layers above one.
fn compare(name: &str, plain: &World, layers: &[usize], place: DMat4) -> Vec<(usize, World)> {
    let (elements, triangles) = (plain.element_count(), plain.triangle_count());
    println!("{name}: {elements} elements, {triangles} triangles, {} lights", plain.lights().count());
    let worlds: Vec<(usize, World)> = layers.iter().map(|&k| (k, grouped(plain, k))).collect();
    let mut times = vec![(Vec::new(), Vec::new()); worlds.len()];
    let mut apart = vec![(Vec::new(), Vec::new()); worlds.len()];
    for run in 0..RUNS {
        for (k, (layers, world)) in worlds.iter().enumerate() {
            let (bake, insert) = solve(world, place, run as u64);
            times[k].0.push(bake);
            times[k].1.push(insert);
            if run < SEPARATE_RUNS && *layers > 1 {
                let each = (0..*layers).map(|layer| solve(&only(plain, *layers, layer), place, run as u64));
                let (bake, insert) = each.fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
                apart[k].0.push(bake);
                apart[k].1.push(insert);
            }
        }
    }
    first_picture(&worlds[worlds.len() - 1].1);
    let times: Vec<(f64, f64)> = times.iter_mut().map(|(a, b)| (median(a), median(b))).collect();
    for (((layers, _), time), apart) in worlds.iter().zip(&times).zip(&mut apart) {
        print!("{layers:2} layers: bake {:.3} s, {:.2} of one layer", time.0, time.0 / times[0].0);
        print!("; insert {:.3} s, {:.2} of one layer", time.1, time.1 / times[0].1);
        match *layers {
            1 => println!(),
            _ => println!(
                "; separate solutions {:.1} and {:.1} times as long",
                median(&mut apart.0) / time.0,
                median(&mut apart.1) / time.1
            ),
        }
    }
    worlds.into_iter().filter(|(layers, _)| *layers > 1).collect()
}

/// Keeps what a bake shows first, with the time it came at, and ends the bake after its first round.
struct First {
    wants_estimates: bool,
    start: Instant,
    shown: Mutex<Vec<(f64, Arc<LightMap>)>>,
}

impl Observer for First {
    fn plan_round(&self, so_far: &Progress, proposed: u32) -> u32 {
        if so_far.samples_per_element == 0 { proposed } else { 0 }
    }

    fn wants_estimates(&self) -> bool {
        self.wants_estimates
    }

    fn snapshot(&self, map: &Arc<LightMap>, _: Snapshot, _: &Progress) {
        self.shown.lock().expect("one thread").push((self.start.elapsed().as_secs_f64(), map.clone()));
    }
}

/// Prints when the first picture of a bake comes, with an estimate before the first round and without, and how far off
/// it is.
fn first_picture(world: &World) {
    let converged =
        bake(world, &Budget { samples_per_element: 64, ..BUDGET }, 99, &Unobserved).expect("nobody cancels");
    let (mut with, mut without, mut round) = (Vec::new(), Vec::new(), Vec::new());
    let mut maps = Vec::new();
    for run in 0..RUNS as u64 {
        for wants_estimates in [true, false] {
            let first = First { wants_estimates, start: Instant::now(), shown: Mutex::default() };
            bake(world, &BUDGET, run, &first).expect("nobody cancels");
            let shown = first.shown.into_inner().expect("one thread");
            match shown.as_slice() {
                [(soon, estimate), (later, map)] => {
                    with.push(*soon);
                    round.push(*later);
                    maps = vec![estimate.clone(), map.clone()];
                }
                [(later, _)] => without.push(*later),
                _ => unreachable!("a bake shows its first round, and an estimate before it where one is wanted"),
            }
        }
    }
    let rmse = |value: &dyn Fn(usize) -> Vec3| {
        let square = |slot: usize| f64::from((value(slot) - converged.total(slot)).length_squared()) / 3.0;
        world.area_mean((0..world.slots()).filter(|&slot| world.is_valid(slot)), square).sqrt()
    };
    println!(
        "first picture: after {:.3} s with RMSE {:.4} ({:.4} without the ambient term), first round \
         after {:.3} s with {:.4}; without an estimate after {:.3} s",
        median(&mut with),
        rmse(&|slot| maps[0].total(slot)),
        rmse(&|slot| maps[0].light.direct[slot]),
        median(&mut round),
        rmse(&|slot| maps[1].total(slot)),
        median(&mut without),
    );
}

/// Seconds of a bake, and of an insert into its map.
fn solve(world: &World, place: DMat4, seed: u64) -> (f64, f64) {
    let (baked, map) = timed(|| bake(world, &BUDGET, seed, &Unobserved).expect("nobody cancels"));
    let edit = Edit::Insert {
        asset: Arc::new(Scene::from_objects(vec![boxed(Vec3::ZERO)])),
        name: "inserted box".into(),
        transform: place,
    };
    let transition = world.apply(&[edit]).expect("an insert");
    let (inserted, _) = timed(|| update(&transition, &map, &BUDGET, None, seed, &Unobserved).expect("no cancel"));
    (baked, inserted)
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
        let step = Edit::MoveLight { light: "bulb".into(), position, direction: None, own_layer: false };
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
    let bytes = map.layers.iter().map(|l| l.light.memory_bytes()).sum::<usize>();
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
    let vectors = |values: &[Vec3]| values.iter().map(|v| v.x + v.y + v.z).sum::<f32>();
    let of_block =
        |block: LightBlock| vectors(block.direct) + vectors(block.indirect) + block.variance.iter().sum::<f32>();
    let of_layer = |layer: &Layer| -> f32 {
        let blocks = (0..blocks_of(layer.light.len())).into_par_iter().with_min_len(64);
        blocks.filter_map(|block| layer.light.block(block)).map(of_block).sum()
    };
    map.layers.iter().map(|layer| of_layer(layer)).sum()
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

/// Names of lights, by the layer out of `layers` that each is in.
fn lights_of(world: &World, layers: usize) -> Vec<(usize, String)> {
    world.lights().enumerate().map(|(i, light)| (i % layers, light.light.name.clone())).collect()
}

/// All lights in `layers` layers, the shared one among them.
fn grouped(world: &World, layers: usize) -> World {
    if layers == 1 {
        return world.clone();
    }
    let lights = lights_of(world, layers).into_iter().filter(|(layer, _)| *layer != 0);
    let group = |(layer, light)| Edit::GroupLights { group: Some(format!("group {layer}")), lights: vec![light] };
    world.apply(&lights.map(group).collect::<Vec<_>>()).expect("groups").after
}

/// Only the lights of one out of `layers` layers shine.
fn only(world: &World, layers: usize, layer: usize) -> World {
    let others = lights_of(world, layers).into_iter().filter(|(its, _)| *its != layer);
    let lights = others.map(|(_, light)| Relight { light, color: None, intensity: Some(0.0) }).collect();
    world.apply(&[Edit::Relight { lights }]).expect("a relight").after
}

/// A scene that is not the project's own, and where a box is put in it; none where it is not there.
fn file(folder: &std::path::Path, name: &str, spacing: f32) -> Option<(World, DMat4)> {
    let file = if name == "living-room-2" { "living-room-2.lite.glb".to_owned() } else { format!("{name}.glb") };
    let scene = load(&std::fs::read(folder.join(file)).ok()?, &LoadLimits::default()).expect("a scene");
    let options = WorldOptions { spacing: Some(spacing), ..WorldOptions::default() };
    let world = World::new(scene, &options).expect("a world");
    if name == "living-room-2" {
        return Some((world, DMat4::from_translation(DVec3::new(0.0, 0.0, 3.0))));
    }
    let lamp = |(name, x): (&str, f32)| {
        let quad = Mesh::quad(Vec3::new(x, 1.5, -0.9), Vec3::X * 0.2, Vec3::Z * 0.2);
        let asset = Arc::new(Scene::from_objects(vec![Object::new(name, quad, Material::emissive(Vec3::splat(8.0)))]));
        Edit::Insert { asset, name: name.into(), transform: DMat4::IDENTITY }
    };
    let world = world.apply(&[("left lamp", -0.9), ("right lamp", 0.7)].map(lamp)).expect("lamps").after;
    let trees = world.rebuilt_trees();
    let world = world.with_trees(trees).expect("nothing has changed since");
    Some((world, DMat4::from_translation(DVec3::new(-0.1, 0.0, 0.6)) * DMat4::from_scale(DVec3::splat(0.4))))
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
