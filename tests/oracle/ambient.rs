//! The ambient term that a bake is shown with before its first round: what it holds, and that nothing is left of it.

use std::sync::{Arc, Mutex};

use glam::{DVec3, Vec3};
use rebake_core::scene::{LightKind, Material, Mesh, Object};
use rebake_core::{Budget, Edit, LightMap, Observer, Progress, Snapshot, Unobserved, World, bake};

use super::scenes::{room_objects, world};
use super::statistics::{area_mean, assert_agrees, replicate};

fn budget(samples: u32) -> Budget {
    Budget { samples_per_element: samples, target_rmse: None }
}

/// Keeps what it is shown, in order: whether it is an estimate, and the map.
#[derive(Default)]
struct Shown(Mutex<Vec<(bool, Arc<LightMap>)>>);

impl Observer for Shown {
    fn wants_estimates(&self) -> bool {
        true
    }

    fn snapshot(&self, map: &Arc<LightMap>, snapshot: Snapshot, progress: &Progress) {
        let is_estimate = snapshot == Snapshot::Estimate;
        assert_eq!(is_estimate, progress.estimated_rmse.is_none());
        assert_eq!(is_estimate, progress.samples_per_element == 0);
        self.0.lock().unwrap().push((is_estimate, map.clone()));
    }
}

/// The only estimate of a bake, which comes first, and the map that the bake gives.
fn estimated(world: &World, samples: u32, seed: u64) -> (Arc<LightMap>, Arc<LightMap>) {
    let shown = Shown::default();
    let map = bake(world, &budget(samples), seed, &shown).expect("nobody cancels");
    let shown = shown.0.into_inner().unwrap();
    assert_eq!(shown.iter().map(|s| s.0).collect::<Vec<bool>>(), [vec![true], vec![false; shown.len() - 1]].concat());
    (shown[0].1.clone(), map)
}

/// A layer per light.
fn each_alone(world: &World) -> World {
    let group = |name: &String| Edit::GroupLights { group: Some(name.clone()), lights: vec![name.clone()] };
    let names: Vec<String> = world.lights().map(|l| l.light.name.clone()).collect();
    world.apply(&names.iter().map(group).collect::<Vec<_>>()).expect("groups").after
}

/// A closed box whose walls reflect alike: by reciprocity the mean light is mean emission / (1 − ρ), and the bounces
/// are ρ of it, whichever walls emit.
#[test]
fn the_ambient_term_of_a_furnace_is_all_its_indirect_light() {
    let (x, y, z) = (Vec3::X * 2.0, Vec3::Y * 1.5, Vec3::Z);
    let albedo = Vec3::new(0.8, 0.5, 0.2);
    let wall = |name: &str, corner: Vec3, u: Vec3, v: Vec3, emission: Vec3| {
        Object::new(name, Mesh::quad(corner, u, v), Material { emission, ..Material::diffuse(albedo) })
    };
    let (red, green) = (Vec3::new(3.0, 0.5, 0.1), Vec3::new(0.2, 2.0, 0.4));
    let walls = vec![
        wall("floor", Vec3::ZERO, z, x, red),
        wall("ceiling", y, x, z, Vec3::ONE),
        wall("back", Vec3::ZERO, x, y, Vec3::ONE),
        wall("front", z, y, x, Vec3::ONE),
        wall("left", Vec3::ZERO, y, z, Vec3::ONE),
        wall("right", x, z, y, green),
    ];
    let area = 2.0 * (2.0 * 1.5 + 2.0 + 1.5);
    let world = each_alone(&world(walls, 0.15));
    let estimates: Vec<Arc<LightMap>> = (0..8).map(|seed| estimated(&world, 1, seed).0).collect();
    for (name, part) in [("floor", 2.0), ("right", 1.5)] {
        let layer = |i: u64| {
            let layer = estimates[i as usize].layers.iter().find(|layer| layer.name == name).expect("a layer");
            assert!(layer.lights.iter().all(|light| light.reference == Vec3::ONE));
            area_mean(&world, |_| true, |slot| layer.light.at(slot).1.as_dvec3())
        };
        let truth = (albedo / (1.0 - albedo)).as_dvec3().element_sum() / 3.0 * part / area;
        assert_agrees(&format!("ambient term of the {name}"), replicate(8, layer), truth, 0.0);
    }
    // All together at their strengths, channel by channel.
    let emission = (red * 2.0 + green * 1.5 + (area as f32 - 3.5)) / area as f32;
    for channel in 0..3 {
        let of = |map: &LightMap| {
            area_mean(&world, |_| true, |slot| DVec3::splat(f64::from(map.light.indirect[slot][channel])))
        };
        let truth = emission[channel] * albedo[channel] / (1.0 - albedo[channel]);
        let found = replicate(8, |i| of(&estimates[i as usize]));
        assert_agrees(&format!("ambient term, channel {channel}"), found, f64::from(truth), 0.0);
    }
}

#[test]
fn nothing_comes_back_from_where_nothing_is() {
    let boxed = Object::new("box", Mesh::cuboid(Vec3::ZERO, Vec3::ONE), Material::diffuse(Vec3::splat(0.9)));
    let sky = Edit::InsertLight { name: "sky".into(), kind: LightKind::Environment, color: Vec3::ONE, intensity: 1.0 };
    let world = world(vec![boxed], 0.1).apply(&[sky]).expect("a sky").after;
    let (estimate, _) = estimated(&world, 1, 1);
    assert!(estimate.light.indirect.iter().all(|light| *light == Vec3::ZERO));
    let lit = (0..world.slots()).filter(|&slot| world.areas()[slot] > 0.0);
    assert!(lit.map(|slot| estimate.light.direct[slot]).all(|light| light == Vec3::ONE));
}

#[test]
fn the_ambient_term_is_nearer_to_the_light_than_none_and_not_in_the_map() {
    for layered in [false, true] {
        let plain = world(room_objects(0.7), 0.15);
        let bulb = LightKind::Point { position: DVec3::new(2.2, 0.6, 2.3), range: None };
        let bulb =
            Edit::InsertLight { name: "bulb".into(), kind: bulb, color: Vec3::new(0.2, 0.3, 1.0), intensity: 1.0 };
        let plain = plain.apply(&[bulb]).expect("a bulb").after;
        let world = if layered { each_alone(&plain) } else { plain };
        let (estimate, map) = estimated(&world, 64, 5);
        let unobserved = bake(&world, &budget(64), 5, &Unobserved).expect("nobody cancels");
        assert!(*map == *unobserved, "the estimate has left a trace");
        assert_eq!(estimate.layers.len(), map.layers.len());
        let error = |found: &[Vec3], light: &[Vec3]| {
            area_mean(&world, |_| true, |i| (found[i] - light[i]).as_dvec3().powf(2.0)).sqrt()
        };
        let nothing = vec![Vec3::ZERO; map.len()];
        let layers = estimate.layers.iter().zip(&map.layers);
        let layers = layers.map(|(a, b)| (a.light.to_dense().indirect, b.light.to_dense().indirect));
        let whole = (estimate.light.indirect.clone(), map.light.indirect.clone());
        for (found, light) in std::iter::once(whole).chain(layers) {
            let (with, without) = (error(&found, &light), error(&nothing, &light));
            assert!(with < 0.5 * without, "off by {with}, by {without} without");
        }
        let weights = estimate.layer_weights(&world.scene);
        for slot in 0..if layered { map.len() } else { 0 } {
            let layers = estimate.layers.iter().zip(&weights);
            let sum: Vec3 = layers.map(|(l, w)| (l.light.at(slot).0 + l.light.at(slot).1) * *w).sum();
            assert!(sum.abs_diff_eq(estimate.total(slot), 1e-5 * (1.0 + sum.max_element())), "slot {slot}");
        }
    }
}
