//! Hard cases as a suite that prints figures:
//! `cargo bench -p rebake-tests --bench hard_cases [-- PART-OF-A-NAME] [--quick]`.
//!
//! Per case: the error of an update of 64 samples (RMSE against path tracing, whose own noise is taken out, over the
//! mean light), how well that is known, what is stated, the mean over the true one, rays per element, the error of a
//! bake of as many samples, and that of the published iteration (Lu et al. 2025) after 4 and after 16 steps. Medians of
//! three seeds. `tests/oracle` holds the same kinds of cases to bounds.
#![allow(clippy::print_stdout)]

#[path = "hard_cases/cases.rs"]
mod cases;
#[path = "oracle/scenes.rs"]
#[allow(dead_code)]
mod scenes;

use std::sync::{Arc, Mutex};

use rebake_core::{Budget, LightMap, Observer, Progress, Snapshot, Stated, Transition, Unobserved, bake, update};
use rebake_lab::bench::Reference;
use rebake_lab::paper::{PaperOptions, paper_update};

use cases::HardCase;

/// How much is computed.
struct Effort {
    samples: u32,
    base_samples: u32,
    elements: usize,
    paths: u32,
    seeds: u64,
}

/// Counts rays.
#[derive(Default)]
struct Rays(Mutex<u64>);

impl Observer for Rays {
    fn snapshot(&self, _: &Arc<LightMap>, _: Snapshot, progress: &Progress) {
        *self.0.lock().expect("nobody panics") = progress.rays;
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let quick = arguments.iter().any(|argument| argument == "--quick");
    let wanted = arguments.iter().find(|argument| !argument.starts_with("--"));
    let effort = match quick {
        true => Effort { samples: 4, base_samples: 8, elements: 50, paths: 16, seeds: 1 },
        false => Effort { samples: 64, base_samples: 512, elements: 2000, paths: 4096, seeds: 3 },
    };
    println!("errors and stated errors in % of the mean light\n");
    println!(
        "{:44} {:>8} {:>7} {:>5} {:>7} {:>6} {:>7} {:>6} {:>7} {:>9} {:>9}",
        "case", "elements", "error", "±", "stated", "ratio", "mean", "rays", "bake", "paper 4", "paper 16"
    );
    for case in cases::all().iter().filter(|case| wanted.is_none_or(|part| case.name.contains(part.as_str()))) {
        println!("{}", measure(case, &effort));
    }
}

/// One line of the table.
fn measure(case: &HardCase, effort: &Effort) -> String {
    let before = &case.before;
    let budget = |samples| Budget { samples_per_element: samples, target_rmse: None };
    let base = bake(before, &budget(effort.base_samples), 77, &Unobserved).expect("nobody cancels");
    let (transition, base) = last_of(case, base, effort);
    let after = &transition.after;
    let after = after.with_trees(after.rebuilt_trees()).expect("nothing has changed since");
    let truth = Reference::trace(&after, effort.elements, effort.paths, 5);
    let mean = truth.mean(Stated::Full);
    let share = |value: f64| if mean > 0.0 { 100.0 * value / mean } else { 100.0 * value };
    let square = |map: &LightMap| truth.mean_square_error(map, Stated::Full);
    let error = |map: &LightMap| share(square(map).root());
    let rays = Rays::default();
    let mut errors = (Vec::new(), Vec::new(), Vec::new(), [Vec::new(), Vec::new()]);
    let (mut ratios, mut known) = (Vec::new(), Vec::new());
    for seed in 0..effort.seeds {
        let map = update(&transition, &base, &budget(effort.samples), None, seed, &rays).expect("nobody cancels");
        errors.0.push(error(&map));
        known.push(share(square(&map).root_error()));
        errors.1.push(share(f64::from(map.estimated_rmse(after.areas()))));
        ratios.push(truth.mean_of(&map, Stated::Full) / mean);
        errors.2.push(error(&bake(&after, &budget(effort.samples), seed, &Unobserved).expect("nobody cancels")));
        for (iterations, errors) in [4, 16].into_iter().zip(&mut errors.3) {
            let options = PaperOptions { samples: effort.samples, iterations, ..PaperOptions::default() };
            let done = paper_update(&transition, &base, &options, seed, &Unobserved).ok();
            errors.extend(done.map(|done| error(&done.map)));
        }
    }
    let elements = after.element_count();
    let (found, stated) = (median(&mut errors.0), median(&mut errors.1));
    let rays = *rays.0.lock().expect("nobody panics") as f64 / elements as f64;
    let [four, sixteen] = errors.3.map(|mut errors| told(median(&mut errors)));
    format!(
        "{:44} {elements:>8} {:>7} {:>5} {:>7} {:>6.2} {:>7.4} {rays:>6.0} {:>7} {four:>9} {sixteen:>9}",
        case.name,
        told(found),
        told(median(&mut known)),
        told(stated),
        stated / found,
        median(&mut ratios),
        told(median(&mut errors.2)),
    )
}

/// The last edit of a case, with the map from before it.
fn last_of(case: &HardCase, base: Arc<LightMap>, effort: &Effort) -> (Transition, Arc<LightMap>) {
    let (last, first) = case.edits.split_last().expect("a case has an edit");
    let (mut world, mut map) = (case.before.clone(), base);
    for (k, edit) in first.iter().enumerate() {
        let transition = world.apply(edit).expect("an edit");
        let budget = Budget { samples_per_element: effort.samples, target_rmse: None };
        map = update(&transition, &map, &budget, None, 1000 + k as u64, &Unobserved).expect("nobody cancels");
        world = transition.after;
        if world.needs_rebuild() {
            let trees = world.rebuilt_trees();
            world = world.with_trees(trees).expect("nothing has changed since");
        }
    }
    (world.apply(last).expect("an edit"), map)
}

fn told(value: f64) -> String {
    match value {
        v if v.is_nan() => "-".to_owned(),
        v if v >= 1e4 => format!("{v:.1e}"),
        v if v >= 100.0 => format!("{v:.0}"),
        v => format!("{v:.2}"),
    }
}

/// Not a number where there is none.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}
