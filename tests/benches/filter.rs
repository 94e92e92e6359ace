//! What filtered light is worth: `cargo bench -p rebake-tests --bench filter [-- SCENES]`.
//!
//! Scenes of `../shared/scenes`, all of them where none is named: `cornell-box=0.05` sets the distance between elements
//! in metres, `scenes=FOLDER` where the files are; those that are not there are passed over. `reference=N` sets the
//! samples per element of the map that stands for the truth.
//!
//! Prints, for maps of 4 to 64 samples per element, the error (area-weighted RMSE) as it is and filtered, without the
//! worst 1 % of elements too; the filtered error as stated over the true one; the object that gains least, among those
//! that have at least 1 % of the squared error; and what filtering takes beside the bake, in seconds.
#![allow(clippy::print_stdout)]

mod asked;

use std::path::Path;
use std::time::Instant;

use glam::Vec3;
use rebake_core::filter::filter;
use rebake_core::scene::{LoadLimits, load};
use rebake_core::{Budget, LightMap, LightPart, Unobserved, World, WorldOptions, bake};

use asked::Asked;

const SAMPLES: [u32; 4] = [4, 8, 16, 64];

/// Samples per element of the reference.
const REFERENCE: u32 = 1024;

const SEED: u64 = 1;

/// Another one, so that the reference holds none of the noise.
const REFERENCE_SEED: u64 = 2;

/// Distance between elements (m) of each scene, unless another is asked for.
const SPACINGS: [(&str, f32); 5] = [
    ("cornell-box", 0.05),
    ("dining-room.arealit.lite", 0.4),
    ("living-room-2.lite", 0.8),
    ("staircase.lite", 0.4),
    ("veach-ajar.lite", 0.25),
];

fn main() {
    rebake::keep_freed_memory();
    let asked = Asked::new();
    let folder = asked.folder();
    let reference = asked.value("reference").and_then(|v| v.parse().ok()).unwrap_or(REFERENCE);
    for (name, spacing) in asked.scenes(&SPACINGS) {
        match file(&folder, name, spacing) {
            Some(world) => compare(name, &world, reference),
            None => println!("{name}: passed over, it is not in {}", folder.display()),
        }
    }
}

fn file(folder: &Path, name: &str, spacing: f32) -> Option<World> {
    let scene =
        load(&std::fs::read(folder.join(format!("{name}.glb"))).ok()?, &LoadLimits::default()).expect("a scene");
    Some(World::new(scene, &WorldOptions { spacing: Some(spacing), ..WorldOptions::default() }).expect("a world"))
}

fn compare(name: &str, world: &World, reference: u32) {
    let map = |samples: u32, seed: u64| {
        let budget = Budget { samples_per_element: samples, target_rmse: None };
        bake(world, &budget, seed, &Unobserved).expect("nobody cancels")
    };
    let truth = world.delivered(&map(reference, REFERENCE_SEED), LightPart::Full);
    let mean = world.area_mean(0..world.slots(), |slot| f64::from(truth[slot].element_sum() / 3.0));
    println!("{name}: {} elements, mean {mean:.3}", world.element_count());
    for samples in SAMPLES {
        let start = Instant::now();
        let map = map(samples, SEED);
        let baked = start.elapsed().as_secs_f64();
        compare_one(world, &truth, &map, samples);
        println!(", bake {baked:.2} s");
    }
}

fn compare_one(world: &World, truth: &[Vec3], map: &LightMap, samples: u32) {
    let light = world.delivered(map, LightPart::Full);
    let start = Instant::now();
    let map_filtered = filter(world, map, |_| true, &Unobserved).expect("nobody cancels");
    let took = start.elapsed().as_secs_f64();
    let filtered = world.delivered(&map_filtered, LightPart::Full);
    let squares = |values: &[Vec3]| -> Vec<f64> {
        values.iter().zip(truth).map(|(a, b)| f64::from((*a - *b).length_squared() / 3.0)).collect()
    };
    let [raw, smooth] = [squares(&light), squares(&filtered)];
    let rms = |squares: &[f64], slots: &[usize]| world.area_mean(slots.iter().copied(), |slot| squares[slot]).sqrt();
    let all: Vec<usize> = (0..world.slots()).collect();
    let without_worst = |squares: &[f64]| {
        let mut slots: Vec<usize> = all.iter().copied().filter(|&slot| world.areas()[slot] > 0.0).collect();
        slots.sort_by(|&a, &b| squares[a].total_cmp(&squares[b]));
        slots.truncate(slots.len() * 99 / 100);
        rms(squares, &slots)
    };
    let [as_stated, stated] = [map, &map_filtered].map(|map| f64::from(map.estimated_rmse(world.areas())));
    print!("{samples:4} samples: {:.5}, filtered {:.5}", rms(&raw, &all), rms(&smooth, &all));
    print!(
        " ({:.2}; {:.2} without 1 %)",
        rms(&smooth, &all) / rms(&raw, &all),
        without_worst(&smooth) / without_worst(&raw)
    );
    print!(", stated {:.2} and {:.2} of the true", as_stated / rms(&raw, &all), stated / rms(&smooth, &all));
    print!(", least gain {:.2}, {took:.2} s", least_gain(world, &raw, &smooth));
}

/// The largest ratio of an object's errors among those that count.
fn least_gain(world: &World, raw: &[f64], filtered: &[f64]) -> f64 {
    let sum = |squares: &[f64], slots: std::ops::Range<usize>| -> f64 {
        slots.map(|slot| squares[slot] * f64::from(world.areas()[slot])).sum()
    };
    let all = sum(raw, 0..world.slots());
    let ratio = |object: rebake_core::ObjectInfo| {
        let first = object.first_element as usize;
        let slots = first..first + object.element_count as usize;
        let before = sum(raw, slots.clone());
        (before > 0.01 * all).then(|| (sum(filtered, slots) / before).sqrt())
    };
    world.objects().filter_map(ratio).fold(0.0, f64::max)
}
