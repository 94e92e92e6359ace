//! What light maps state as their error is the scatter of runs.

use std::sync::Arc;

use glam::{DMat4, DVec3, Vec3};
use rebake_core::scene::Scene;
use rebake_core::{Budget, Edit, LightMap, Stated, Unobserved, World, WorldOptions, bake, update};

use super::scenes::{crate_at, room_objects};
use super::statistics::area_mean;

const RUNS: u64 = 12;

/// Stated over found, and what is found, of independent runs; errors are of `light`.
fn calibration(world: &World, runs: &[Arc<LightMap>], light: impl Fn(&LightMap, usize) -> Vec3) -> (f64, f64) {
    let n = runs.len() as f64;
    let scatter = |i: usize| {
        let mean = runs.iter().map(|run| light(run, i).as_dvec3()).sum::<DVec3>() / n;
        runs.iter().map(|run| (light(run, i).as_dvec3() - mean).length_squared() / 3.0).sum::<f64>() / (n - 1.0)
    };
    let found = area_mean(world, |_| true, |i| DVec3::splat(scatter(i)));
    let stated = runs.iter().map(|run| f64::from(run.estimated_rmse(world.areas())).powi(2)).sum::<f64>() / n;
    ((stated / found).sqrt(), found.sqrt())
}

/// Share of the elements whose error is more than three times what the map states for them, where the truth is the mean
/// of all other runs.
fn surprises(world: &World, runs: &[Arc<LightMap>], light: impl Fn(&LightMap, usize) -> Vec3) -> f64 {
    let others = (runs.len() - 1) as f32;
    let mean = |map: &LightMap, i: usize| light(map, i).element_sum() / 3.0;
    let (mut surprises, mut count) = (0.0, 0.0);
    for i in (0..world.slots()).filter(|&i| world.is_valid(i)) {
        let sum: f32 = runs.iter().map(|run| mean(run, i)).sum();
        let variances: f32 = runs.iter().map(|run| run.light.variance[i]).sum();
        for run in runs {
            let error = mean(run, i) - (sum - mean(run, i)) / others;
            let variance = run.light.variance[i] + (variances - run.light.variance[i]) / (others * others);
            surprises += f64::from(u8::from(error * error > 9.0 * variance));
            count += 1.0;
        }
    }
    surprises / count
}

fn full(map: &LightMap, slot: usize) -> Vec3 {
    map.total(slot)
}

fn indirect(map: &LightMap, slot: usize) -> Vec3 {
    map.light.indirect[slot]
}

/// A client of indirect light is told the error of indirect light, by bakes and by updates, as a whole and of each
/// element: 16 samples are three rounds, which by themselves tell a variance so badly that one in twenty is surprised.
#[test]
fn is_of_the_light_that_is_asked_for() {
    let mut found = Vec::new();
    for (stated, light) in [(Stated::Full, full as fn(&LightMap, usize) -> Vec3), (Stated::Indirect, indirect)] {
        let options = WorldOptions { spacing: Some(0.2), stated, ..WorldOptions::default() };
        let before = World::new(Scene::from_objects(room_objects(0.1)), &options).expect("a dark room");
        let budget = Budget { samples_per_element: 16, target_rmse: None };
        let bakes: Vec<Arc<LightMap>> =
            (0..RUNS).map(|seed| bake(&before, &budget, seed, &Unobserved).expect("nobody cancels")).collect();
        let asset = Arc::new(Scene::from_objects(vec![crate_at("c", 0.0, 0.0, Vec3::splat(0.3))]));
        let transform = DMat4::from_translation(DVec3::new(2.2, 0.0, 1.9));
        let edit = Edit::Insert { asset, name: "crate".into(), transform };
        let transition = before.apply(&[edit]).expect("an edit");
        let updates: Vec<Arc<LightMap>> = (0..RUNS)
            .zip(&bakes)
            .map(|(seed, map)| {
                update(&transition, map, &budget, None, 100 + seed, &Unobserved).expect("nobody cancels")
            })
            .collect();
        for (name, world, maps) in [("bake", &before, &bakes), ("update", &transition.after, &updates)] {
            let (ratio, error) = calibration(world, maps, light);
            assert!((0.67..1.5).contains(&ratio), "{name}, {stated:?}: stated over found is {ratio:.3}");
            let surprised = surprises(world, maps, light);
            assert!(
                surprised < 0.02,
                "{name}, {stated:?}: {:.2} % are off by three of their errors",
                100.0 * surprised
            );
            found.push(error);
        }
    }
    assert!(found[2] < 0.5 * found[0], "no test where the errors are alike: {found:?}");
}
