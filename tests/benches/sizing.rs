//! Elements where light needs them beside one spacing, with as many elements: `cargo bench -p rebake-tests --bench sizing
//! [-- SCENES]`.
//!
//! Scenes of `../shared/scenes`, all of them where none is named: `cornell-box=0.06` sets the distance between elements in
//! metres, `scenes=FOLDER` where the files are; those that are not there are passed over. `samples=N` sets the samples per
//! element, `points=N` the points that light is read at.
//!
//! Prints, at one and a half times the distance, at it, and at two thirds of it, each for one spacing and by light: elements;
//! the error of light that is read between elements at random visible points, against a map of a quarter of the distance,
//! noise included, as part of the mean light, of all points and without the worst 1 %; the same with the noise of the map and
//! of the truth taken out; CPU seconds of the bake; the ratios of the two, also of the worst object that has at least 1 % of
//! the light; and what choosing the sizes takes, as part of a bake of 16 samples per element.
#![allow(clippy::print_stdout)]

mod asked;

use std::path::Path;
use std::sync::Arc;

use rebake_core::resolution::{Difference, ResolutionOptions, differences};
use rebake_core::scene::{LoadLimits, Scene, load};
use rebake_core::{Budget, LightMap, Spread, Unobserved, World, WorldOptions, bake};
use rebake_lab::bench::process_cpu_seconds;

use asked::Asked;

/// Distance between elements (m) of each scene, unless another is asked for.
const SPACINGS: [(&str, f32); 5] = [
    ("cornell-box", 0.06),
    ("dining-room.arealit.lite", 0.4),
    ("living-room-2.lite", 0.4),
    ("staircase.lite", 0.3),
    ("veach-ajar.lite", 0.3),
];

const SAMPLES: u32 = 128;
const POINTS: u32 = 8000;

/// What stands for the truth: so much finer, with so many samples per element, and so many per point.
const FINER: f32 = 4.0;
const TRUE_SAMPLES: u32 = 32;
const SAMPLES_OF_POINTS: u32 = 1024;

/// Points that are left out: the worst one in so many.
const WORST: usize = 100;

/// Part of the light that an object has to have.
const COUNTS: f64 = 0.01;

fn main() {
    rebake::keep_freed_memory();
    let asked = Asked::new();
    let folder = asked.folder();
    let number = |name: &str, default: u32| asked.value(name).and_then(|v| v.parse().ok()).unwrap_or(default);
    let (samples, points) = (number("samples", SAMPLES), number("points", POINTS));
    for (name, spacing) in asked.scenes(&SPACINGS) {
        match file(&folder, name) {
            Some(scene) => compare(name, &scene, spacing, samples, points),
            None => println!("{name}: passed over, it is not in {}", folder.display()),
        }
    }
}

fn file(folder: &Path, name: &str) -> Option<Scene> {
    Some(load(&std::fs::read(folder.join(format!("{name}.glb"))).ok()?, &LoadLimits::default()).expect("a scene"))
}

fn laid_out(scene: &Scene, spacing: f32, spread: Spread) -> World {
    World::new(scene.clone(), &WorldOptions { spacing: Some(spacing), spread, ..WorldOptions::default() })
        .expect("a world")
}

fn baked(world: &World, samples: u32) -> Arc<LightMap> {
    bake(world, &Budget { samples_per_element: samples, target_rmse: None }, 1, &Unobserved).expect("nobody cancels")
}

/// Of this process, so far; NaN where the system does not tell.
fn cpu_seconds() -> f64 {
    process_cpu_seconds().unwrap_or(f64::NAN)
}

/// CPU seconds that something takes, and what it makes.
fn timed<T>(f: impl FnOnce() -> T) -> (f64, T) {
    let start = cpu_seconds();
    let made = f();
    (cpu_seconds() - start, made)
}

fn compare(name: &str, scene: &Scene, spacing: f32, samples: u32, points: u32) {
    let fine = laid_out(scene, spacing / FINER, Spread::Uniform);
    let exact = baked(&fine, TRUE_SAMPLES);
    println!("{name}: truth of {} elements", fine.element_count());
    for spacing in [1.5 * spacing, spacing, spacing / 1.5] {
        let [even, by_light] = [Spread::Uniform, Spread::ByLight].map(|spread| {
            let (building, world) = timed(|| laid_out(scene, spacing, spread));
            let (baking, map) = timed(|| baked(&world, samples));
            let options = ResolutionOptions { points, samples: SAMPLES_OF_POINTS, seed: 5 };
            let found = differences((&world, &map), (&fine, &exact), &options, &Unobserved).expect("nobody cancels");
            Found { elements: world.element_count(), building, baking, points: found.expect("noise is known") }
        });
        let (short, _) = timed(|| baked(&laid_out(scene, spacing, Spread::Uniform), 16));
        let sizing = 100.0 * (by_light.building - even.building) / (short - even.building);
        println!("{spacing:.3} m, one spacing: {}", even.line());
        println!("{spacing:.3} m, by light:    {}", by_light.line());
        let ratio = |of: &dyn Fn(&Found) -> f64| of(&by_light) / of(&even);
        println!(
            "         ratios: all {:.2}, without the worst {:.2}; of resolution alone {:.2}, {:.2}; worst object {:.2}; sizes \
             {sizing:.1} % of 16 samples",
            ratio(&|found| found.rmse(false, false)),
            ratio(&|found| found.rmse(true, false)),
            ratio(&|found| found.rmse(false, true)),
            ratio(&|found| found.rmse(true, true)),
            worst_object(&even, &by_light),
        );
    }
}

struct Found {
    elements: usize,
    building: f64,
    baking: f64,
    points: Vec<Difference>,
}

impl Found {
    fn mean(&self) -> f64 {
        let light = |point: &Difference| f64::from(point.exact.light.element_sum() / 3.0);
        self.points.iter().map(light).sum::<f64>() / self.points.len() as f64
    }

    /// As part of the mean light, without the worst points or without noise.
    fn rmse(&self, is_trimmed: bool, is_noiseless: bool) -> f64 {
        let mut sorted: Vec<&Difference> = self.points.iter().collect();
        sorted.sort_by(|a, b| a.square().total_cmp(&b.square()));
        sorted.truncate(self.points.len() - if is_trimmed { self.points.len() / WORST } else { 0 });
        mean_square(sorted, is_noiseless).max(0.0).sqrt() / self.mean()
    }

    fn line(&self) -> String {
        let [all, trimmed, own, own_trimmed] = [(false, false), (true, false), (false, true), (true, true)]
            .map(|(is_trimmed, is_noiseless)| 100.0 * self.rmse(is_trimmed, is_noiseless));
        let Found { elements, baking, .. } = self;
        format!(
            "{elements} elements, {all:.2} % ({trimmed:.2} %), of resolution {own:.2} % ({own_trimmed:.2} %), {baking:.1} s"
        )
    }
}

fn mean_square<'d>(points: impl IntoIterator<Item = &'d Difference>, is_noiseless: bool) -> f64 {
    let square = |point: &Difference| {
        let noise = point.noise + f64::from(point.exact.error).powi(2);
        point.square() - if is_noiseless { noise } else { 0.0 }
    };
    let (sum, count) = points.into_iter().fold((0.0, 0.0), |(sum, count), point| (sum + square(point), count + 1.0));
    sum / f64::max(count, 1.0)
}

/// The largest ratio of the errors of an object that has its part of the light.
fn worst_object(even: &Found, by_light: &Found) -> f64 {
    let of = |found: &Found, object: usize| {
        mean_square(found.points.iter().filter(|point| point.object == object), false).sqrt()
    };
    let light = |object: Option<usize>| -> f64 {
        let points = even.points.iter().filter(|point| object.is_none_or(|object| point.object == object));
        points.map(|point| f64::from(point.exact.light.element_sum())).sum()
    };
    let last = even.points.iter().map(|point| point.object).max().unwrap_or(0);
    let counts = |&object: &usize| light(Some(object)) > COUNTS * light(None);
    (0..=last).filter(counts).map(|object| of(by_light, object) / of(even, object)).fold(0.0, f64::max)
}
