//! What is stated of resolution beside a bake, held against the truth: `cargo bench -p rebake-tests --bench resolution [-- SCENES]`.
//!
//! Scenes of `../shared/scenes`, all of them where none is named: `cornell-box=0.05` sets the distance between elements
//! in metres, `scenes=FOLDER` where the files are; those that are not there are passed over. `samples=N` sets the samples
//! per element of the bakes, `runs=N` how often each is timed with and without.
//!
//! Prints, at one and a half times the distance, at it, and at two thirds of it: the error of resolution as it is stated
//! and as a map of a quarter of the distance shows it, their ratio, the same of the objects that have at least 1 % of the
//! squared error and whose error is stated (least and largest ratio), the share of the rays that measuring takes, and
//! what it adds to the CPU time of the bake.
#![allow(clippy::print_stdout)]

mod asked;

use std::path::Path;
use std::sync::{Arc, Mutex};

use rebake_core::resolution::{Meter, ResolutionError, ResolutionOptions, error_against};
use rebake_core::scene::{LoadLimits, Scene, load};
use rebake_core::{Budget, LightMap, Observer, Progress, Snapshot, Unobserved, World, WorldOptions, bake};
use rebake_lab::bench::process_cpu_seconds;

use asked::Asked;

/// Distance between elements (m) of each scene, unless another is asked for.
const SPACINGS: [(&str, f32); 5] = [
    ("cornell-box", 0.08),
    ("dining-room.arealit.lite", 0.4),
    ("living-room-2.lite", 0.8),
    ("staircase.lite", 0.5),
    ("veach-ajar.lite", 0.35),
];

const SAMPLES: u32 = 128;
const RUNS: u32 = 3;

/// What stands for the truth: so much finer, with so many samples per element, at so many points.
const FINER: f32 = 4.0;
const TRUE_SAMPLES: u32 = 64;
const POINTS: ResolutionOptions = ResolutionOptions { points: 30_000, samples: 64, seed: 5 };

fn main() {
    rebake::keep_freed_memory();
    let asked = Asked::new();
    let folder = asked.folder();
    let number = |name: &str, default: u32| asked.value(name).and_then(|v| v.parse().ok()).unwrap_or(default);
    let (samples, runs) = (number("samples", SAMPLES), number("runs", RUNS));
    for (name, spacing) in asked.scenes(&SPACINGS) {
        match file(&folder, name) {
            Some(scene) => compare(name, &scene, spacing, samples, runs),
            None => println!("{name}: passed over, it is not in {}", folder.display()),
        }
    }
}

fn file(folder: &Path, name: &str) -> Option<Scene> {
    Some(load(&std::fs::read(folder.join(format!("{name}.glb"))).ok()?, &LoadLimits::default()).expect("a scene"))
}

fn laid_out(scene: &Scene, spacing: f32) -> World {
    World::new(scene.clone(), &WorldOptions { spacing: Some(spacing), ..WorldOptions::default() }).expect("a world")
}

/// Measures while a map is baked, as the service does.
struct Watch<'w> {
    world: &'w World,
    seen: Mutex<(Meter, u64)>,
}

impl Observer for Watch<'_> {
    fn snapshot(&self, map: &Arc<LightMap>, snapshot: Snapshot, progress: &Progress) {
        if let Snapshot::Complete { stated: Some(_) } = snapshot {
            let mut seen = self.seen.lock().expect("one thread measures");
            seen.0.measure(self.world, map, progress.rays, 1, &Unobserved).expect("nobody cancels");
            seen.1 = progress.rays;
        }
    }
}

/// Of this process, so far; it says nothing where the system does not tell.
fn cpu_seconds() -> f64 {
    process_cpu_seconds().unwrap_or(f64::NAN)
}

fn compare(name: &str, scene: &Scene, spacing: f32, samples: u32, runs: u32) {
    let baked = |world: &World, samples: u32, observer: &dyn Observer| {
        let budget = Budget { samples_per_element: samples, target_rmse: None };
        bake(world, &budget, 1, observer).expect("nobody cancels")
    };
    let fine = laid_out(scene, spacing / FINER);
    let exact = baked(&fine, TRUE_SAMPLES, &Unobserved);
    let mean = fine.area_mean(0..fine.slots(), |slot| f64::from(exact.total(slot).element_sum() / 3.0));
    println!("{name}: mean {mean:.3}, truth of {} elements", fine.element_count());
    for spacing in [1.5 * spacing, spacing, spacing / 1.5] {
        let world = laid_out(scene, spacing);
        let (mut without, mut with) = (f64::INFINITY, f64::INFINITY);
        let mut last = None;
        for _ in 0..runs {
            let start = cpu_seconds();
            baked(&world, samples, &Unobserved);
            let middle = cpu_seconds();
            let watch = Watch { world: &world, seen: Mutex::default() };
            let map = baked(&world, samples, &watch);
            let end = cpu_seconds();
            (without, with) = (without.min(middle - start), with.min(end - middle));
            last = Some((map, watch.seen.into_inner().expect("one thread measures")));
        }
        let Some((map, (meter, rays))) = last else { continue };
        let truth = error_against((&world, &map), (&fine, &exact), &POINTS, &Unobserved).expect("nobody cancels");
        let truth = truth.expect("noise is known");
        print!("{spacing:6.3} m, {:6} elements: ", world.element_count());
        tell(meter.error(), &truth);
        let share = 100.0 * meter.rays() as f64 / rays as f64;
        println!("; {share:.2} % of the rays, {:+.2} % CPU ({without:.2} s)", 100.0 * (with / without - 1.0));
    }
}

/// Prints the error as it is stated and as it is, and how these are apart for the objects that count.
fn tell(stated: Option<&ResolutionError>, truth: &ResolutionError) {
    let true_rmse = truth.all.mean().max(0.0).sqrt();
    let Some((error, rmse)) = stated.and_then(|error| Some((error, f64::from(error.all.rmse()?)))) else {
        return print!("not stated, true {true_rmse:.5}");
    };
    print!("stated {rmse:.5}, true {true_rmse:.5} ({:.2})", rmse / true_rmse);
    let squares: f64 = truth.objects.iter().map(|object| f64::from(object.points) * object.mean().max(0.0)).sum();
    let ratios = error.objects.iter().zip(&truth.objects).filter_map(|(stated, truth)| {
        let counts = f64::from(truth.points) * truth.mean() > 0.01 * squares;
        Some(f64::from(stated.rmse().filter(|_| counts)?) / truth.mean().sqrt())
    });
    let (least, most, count) = ratios.fold((f64::INFINITY, 0.0_f64, 0), |(l, m, n), r| (l.min(r), m.max(r), n + 1));
    if count > 0 {
        print!(", {count} objects {least:.2} to {most:.2}");
    }
}
