//! What a scene's size costs: `cargo bench -p rebake-tests --bench scaling [-- SPACING]`.
//!
//! A house of closed rooms of 6 × 3 × 6 m, side by side, each with boxes and a lamp; a box is put into the first.
//! Prints, for 1, 2 and 4 rooms: elements and triangles; bytes of the scene and its light map, over what 200 bytes per
//! element and 150 per triangle would be; and how long after the edit the first map comes and the last one of 16
//! samples, without a focus and with a sphere of a metre around the edit, over what that is with one room. Runs
//! alternate; the median counts.
#![allow(clippy::print_stdout)]

use std::sync::{Arc, Mutex};
use std::time::Instant;

use glam::{DMat4, DVec3, Vec3};
use rebake_core::scene::{Material, Mesh, Object, Scene};
use rebake_core::{
    Budget, Edit, Focus, Importance, LightMap, Observer, Progress, Snapshot, Unobserved, World, WorldOptions, bake,
    update,
};

const RUNS: usize = 7;

const ROOMS: [usize; 3] = [1, 2, 4];

const BUDGET: Budget = Budget { samples_per_element: 16, target_rmse: None };

/// Where the box is put.
const PLACE: DVec3 = DVec3::new(4.0, 0.0, 1.2);

/// Seconds from the edit to its first and its last map.
#[derive(Clone, Copy)]
struct Times {
    first: f64,
    last: f64,
}

/// One size of the house.
struct House {
    world: World,
    map: Arc<LightMap>,
    /// Without and with a focus.
    times: [Vec<Times>; 2],
}

fn main() {
    rebake::keep_freed_memory();
    let spacing = std::env::args().skip(1).find_map(|a| a.parse().ok()).unwrap_or(0.06);
    let mut houses = ROOMS.map(|rooms| {
        let world = house(rooms, spacing);
        let map = bake(&world, &BUDGET, 1, &Unobserved).expect("nobody cancels");
        House { world, map, times: [Vec::new(), Vec::new()] }
    });
    let focus = Focus::Sphere { point: PLACE, radius: 1.0 };
    let importance = [None, Some(Importance { focus: Some(focus), tiles: None })];
    for run in 0..RUNS {
        for house in &mut houses {
            for (times, importance) in house.times.iter_mut().zip(&importance) {
                times.push(insert(&house.world, &house.map, importance.as_ref(), run as u64));
            }
        }
    }
    let one = houses[0].times.each_ref().map(|times| median(times));
    for (rooms, house) in ROOMS.iter().zip(&houses) {
        let (elements, triangles) = (house.world.element_count(), house.world.triangle_count());
        let bytes = house.world.memory_bytes() + house.map.memory_bytes();
        println!(
            "{rooms} rooms: {elements} elements, {triangles} triangles; {} bytes per element, triangles included, {:.2} \
             of 200 per element and 150 per triangle",
            bytes / elements,
            bytes as f64 / (200 * elements + 150 * triangles) as f64
        );
        for ((name, times), one) in ["no focus", "focus"].iter().zip(&house.times).zip(one) {
            let Times { first, last } = median(times);
            println!(
                "    {name}: first map after {:.1} ms, {:.2} of one room; last after {:.1} ms, {:.2}",
                1e3 * first,
                first / one.first,
                1e3 * last,
                last / one.last
            );
        }
    }
}

/// When the first map was shown.
struct First {
    start: Instant,
    seconds: Mutex<Option<f64>>,
}

impl Observer for First {
    fn snapshot(&self, _: &Arc<LightMap>, _: Snapshot, _: &Progress) {
        self.seconds.lock().expect("no thread panics").get_or_insert(self.start.elapsed().as_secs_f64());
    }
}

fn insert(world: &World, map: &LightMap, importance: Option<&Importance>, seed: u64) -> Times {
    let first = First { start: Instant::now(), seconds: Mutex::default() };
    let asset = Arc::new(Scene::from_objects(vec![boxed("inserted".into(), Vec3::ZERO)]));
    let edit = Edit::Insert { asset, name: "inserted".into(), transform: DMat4::from_translation(PLACE) };
    let transition = world.apply(&[edit]).expect("an insert");
    update(&transition, map, &BUDGET, importance, seed, &first).expect("nobody cancels");
    let last = first.start.elapsed().as_secs_f64();
    Times { first: first.seconds.into_inner().expect("no thread panics").unwrap_or(last), last }
}

fn median(times: &[Times]) -> Times {
    let of = |part: fn(&Times) -> f64| {
        let mut sorted: Vec<f64> = times.iter().map(part).collect();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() / 2]
    };
    Times { first: of(|t| t.first), last: of(|t| t.last) }
}

fn boxed(name: String, at: Vec3) -> Object {
    let mesh = Mesh::cuboid(at, at + Vec3::new(0.6, 0.9, 0.5));
    Object::new(name, mesh, Material::diffuse(Vec3::new(0.6, 0.5, 0.3)))
}

/// Rooms that see nothing of one another.
fn house(rooms: usize, spacing: f32) -> World {
    let mut objects = Vec::new();
    for room in 0..rooms {
        let low = Vec3::X * 7.0 * room as f32;
        let walls = Mesh::cuboid(low, low + Vec3::new(6.0, 3.0, 6.0)).inside_out();
        objects.push(Object::new(format!("room {room}"), walls, Material::diffuse(Vec3::splat(0.7))));
        for i in 0..6 {
            let at = low + Vec3::new(0.5 + 0.8 * i as f32, 0.0, 1.5 + 0.6 * i as f32);
            objects.push(boxed(format!("box {room} {i}"), at));
        }
        let lamp = Mesh::quad(low + Vec3::new(2.7, 2.9, 2.7), Vec3::X * 0.6, Vec3::Z * 0.6);
        objects.push(Object::new(format!("lamp {room}"), lamp, Material::emissive(Vec3::splat(8.0))));
    }
    let options = WorldOptions { spacing: Some(spacing), ..WorldOptions::default() };
    World::new(Scene::from_objects(objects), &options).expect("a house")
}
