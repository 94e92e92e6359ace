use std::collections::BTreeMap;

use super::nearby::{Nearby, REACH};
use super::*;
use crate::job::Unobserved;
use crate::metrics::Family;
use crate::random::Pcg32;
use crate::scene::{Material, Mesh, Object, Scene};
use crate::world::WorldOptions;

const SPACING: f32 = 0.03;

/// Standard deviation of the noise.
const NOISE: f32 = 0.1;

/// A floor of 2 m × 2 m of two tiles that are objects of their own, and a wall on it.
fn tiled() -> World {
    let object = |name: &str, mesh| Object::new(name, mesh, Material::diffuse(Vec3::ONE));
    let objects = vec![
        object("left", Mesh::quad(Vec3::ZERO, Vec3::Z * 2.0, Vec3::X)),
        object("right", Mesh::quad(Vec3::X, Vec3::Z * 2.0, Vec3::X)),
        object("wall", Mesh::quad(Vec3::new(0.0, 0.0, 2.0), Vec3::Y, Vec3::X * 2.0)),
    ];
    let options = WorldOptions { spacing: Some(SPACING), ..WorldOptions::default() };
    World::new(Scene::from_objects(objects), &options).expect("a world")
}

/// `light` with noise of that variance, uniformly distributed, the same in all channels.
fn with_noise(world: &World, seed: u64, light: impl Fn(Vec3) -> f32) -> Vec<Vec3> {
    let mut rng = Pcg32::new(seed, 1);
    let noisy = |p: &Vec3| Vec3::splat(light(*p) + NOISE * 12f32.sqrt() * (rng.next_f32() - 0.5));
    world.positions().iter().map(noisy).collect()
}

/// A map of that light whose elements all state the variance of the noise.
fn map_of(light: &[Vec3]) -> LightMap {
    let variance = vec![NOISE * NOISE; light.len()];
    LightValues { direct: vec![Vec3::ZERO; light.len()], indirect: light.to_vec(), variance }.into()
}

fn filtered(world: &World, map: &LightMap) -> LightMap {
    filter(world, map, |_| true, &Unobserved).expect("nobody cancels")
}

fn mean(world: &World, values: &[Vec3]) -> f64 {
    world.area_mean(0..values.len(), |slot| f64::from(values[slot].x))
}

/// Mean over the slots that `counts` of what `square` says.
fn rms(world: &World, counts: impl Fn(Vec3) -> bool, square: impl Fn(usize) -> f64) -> f64 {
    let slots = (0..world.slots()).filter(|&slot| counts(world.positions()[slot]));
    world.area_mean(slots, square).sqrt()
}

#[test]
fn noise_falls_to_what_is_stated_and_the_mean_stays() {
    let world = tiled();
    let light = |p: Vec3| 1.0 + 0.2 * p.x + 0.1 * p.z - 0.1 * p.y;
    let ratios: Vec<f64> = (0..8)
        .map(|seed| {
            let noisy = with_noise(&world, seed, light);
            let filtered = filtered(&world, &map_of(&noisy));
            assert!((mean(&world, &filtered.light.indirect) - mean(&world, &noisy)).abs() < 1e-6);
            let stated = rms(&world, |_| true, |slot| f64::from(filtered.light.variance[slot]));
            let of = |slot: usize| f64::from(filtered.light.indirect[slot].x - light(world.positions()[slot])).powi(2);
            let found = rms(&world, |_| true, of);
            assert!(found < 0.4 * f64::from(NOISE), "{found}");
            (found / stated).powi(2)
        })
        .collect();
    let count = ratios.len() as f64;
    let average = ratios.iter().sum::<f64>() / count;
    let deviation = (ratios.iter().map(|r| (r - average).powi(2)).sum::<f64>() / (count * (count - 1.0))).sqrt();
    // What averaging once more changes holds some of the noise that is left, too: the stated error errs to the safe side.
    let (least, most) = (1.0 / 1.5f64.powi(2), 1.0);
    let mut family = Family::of_freedom(count - 1.0);
    family.compare_within("ratio", average - (least + most) / 2.0, deviation, (most - least) / 2.0);
    family.assert_agrees();
}

#[test]
fn tiles_of_one_floor_are_one_surface_and_a_wall_is_another() {
    let world = tiled();
    let noisy = with_noise(&world, 3, |p| if p.y > 0.0 { 1.2 } else { 1.0 });
    let filtered = filtered(&world, &map_of(&noisy)).light.indirect;
    let error = |slot: usize| f64::from(filtered[slot].x - 1.0).powi(2);
    let on_floor = |p: Vec3| p.y == 0.0 && p.z > 0.1 && p.z < 1.9 && p.x > 0.1 && p.x < 1.9;
    let beside = rms(&world, |p| on_floor(p) && (p.x - 1.0).abs() < SPACING, error);
    let amid = rms(&world, |p| on_floor(p) && (p.x - 1.0).abs() > 0.2, error);
    // About 250 and 2,300 elements, of which some twenty share their noise: relative deviations of 0.2 and 0.07. Beside an
    // edge of one tile alone the half of the elements would be missing, and the noise √2 times as large.
    assert!(beside < 1.3 * amid, "{beside} {amid}");
    let wall = world.area_mean((0..world.slots()).filter(|&s| world.positions()[s].y > 0.0), |s| filtered[s].x.into());
    assert!((wall - 1.2).abs() < 0.01, "{wall}: nothing crosses an edge");
}

#[test]
fn an_edge_of_light_stays() {
    let world = tiled();
    let light = |p: Vec3| if p.x < 0.6 { 1.0 } else { 2.5 };
    let noisy = with_noise(&world, 4, light);
    let filtered = filtered(&world, &map_of(&noisy)).light.indirect;
    let error = |slot: usize| f64::from(filtered[slot].x - light(world.positions()[slot])).powi(2);
    let beside = rms(&world, |p| (p.x - 0.6).abs() < SPACING, error);
    assert!(beside < 0.8 * f64::from(NOISE), "{beside}: averaged with what is ten deviations away");
}

#[test]
fn what_is_exact_or_unknown_neither_gives_nor_takes() {
    let world = tiled();
    let noisy = with_noise(&world, 5, |_| 1.0);
    let variance: Vec<f32> = world.positions().iter().map(|p| if p.x < 1.0 { 0.0 } else { NOISE * NOISE }).collect();
    let is_known = |slot: usize| world.positions()[slot].x < 1.5;
    let mut map = map_of(&noisy);
    map.light.variance = variance;
    let found = filter(&world, &map, is_known, &Unobserved).expect("nobody cancels");
    let LightValues { indirect: filtered, variance: errors, .. } = found.light;
    for (slot, p) in world.positions().iter().enumerate() {
        match p.x {
            x if x < 1.0 => assert_eq!((filtered[slot], errors[slot]), (noisy[slot], 0.0)),
            x if x >= 1.5 => assert_eq!(filtered[slot], noisy[slot]),
            _ => {}
        }
    }
    assert_ne!(filtered, noisy);
}

#[test]
fn parts_and_layers_add_up_and_threads_do_not_matter() {
    let world = tiled();
    let noisy = with_noise(&world, 6, |p| 1.0 + p.x);
    let direct: Vec<Vec3> = world.positions().iter().map(|p| Vec3::new(p.x, p.z, 0.5)).collect();
    let indirect: Vec<Vec3> = noisy.iter().zip(&direct).map(|(a, b)| *a - *b).collect();
    let layer = |name: &str, direct: &[Vec3], indirect: &[Vec3]| {
        let variance = vec![NOISE * NOISE; direct.len()];
        let (direct, indirect) = (direct.to_vec(), indirect.to_vec());
        let light = LightValues { direct, indirect, variance };
        Arc::new(Layer { name: name.to_owned(), lights: Vec::new(), light: light.into() })
    };
    let none = vec![Vec3::ZERO; direct.len()];
    let layers = vec![layer("a", &direct, &none), layer("b", &none, &indirect)];
    let variance = vec![NOISE * NOISE; direct.len()];
    let map = LightMap { light: LightValues { direct, indirect, variance }, layers };
    let whole = filtered(&world, &map);
    let alone = filtered(&world, &map_of(&noisy));
    for slot in 0..world.slots() {
        let light = whole.layers.iter().map(|layer| layer.light.at(slot));
        let sum: Vec3 = light.map(|(direct, indirect)| direct + indirect).sum();
        assert!((sum - whole.total(slot)).abs().max_element() < 1e-5);
        assert!((alone.total(slot) - whole.total(slot)).abs().max_element() < 1e-5);
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().expect("threads");
    assert_eq!(whole, pool.install(|| filtered(&world, &map)));
}

#[test]
fn elements_of_unequal_size_find_each_other() {
    let fine = Object::new("fine", Mesh::quad(Vec3::ZERO, Vec3::Z, Vec3::X), Material::diffuse(Vec3::ONE));
    let options = |spacing| WorldOptions { spacing: Some(spacing), ..WorldOptions::default() };
    for spacing in [0.01, 0.017, 0.03, 0.06, 0.1] {
        let world = World::new(Scene::from_objects(vec![fine.clone()]), &options(spacing)).expect("a world");
        let nearby = Nearby::new(&world);
        let count = |part: &mut Vec<(usize, usize)>, slot: u32, near: &[_]| part.push((slot as usize, near.len()));
        let counts = nearby.each(&Unobserved, count).expect("nobody cancels");
        let found: BTreeMap<usize, usize> = counts.into_iter().flatten().collect();
        let (positions, areas) = (world.positions(), world.areas());
        for slot in (0..world.slots()).step_by(world.slots() / 50 + 1) {
            let is_near = |other: &usize| {
                let distance = positions[slot].distance(positions[*other]);
                let (smaller, larger) = (areas[slot].min(areas[*other]), areas[slot].max(areas[*other]));
                *other != slot && distance <= REACH * smaller.sqrt() * 0.9999 && larger < 3.999 * smaller
            };
            let all = (0..world.slots()).filter(is_near).count();
            assert!(found[&slot] >= all, "{} of {all}", found[&slot]);
        }
    }
}

#[test]
fn a_canceled_filter_ends() {
    struct Cancel;
    impl Observer for Cancel {
        fn canceled(&self) -> bool {
            true
        }
    }
    let world = tiled();
    let map = map_of(&with_noise(&world, 7, |_| 1.0));
    assert_eq!(filter(&world, &map, |_| true, &Cancel), Err(Canceled));
}
