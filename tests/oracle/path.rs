//! Path tracing with both strategies against light sampling alone and closed forms.

use glam::{DMat4, DVec3, Vec3};
use rebake_core::scene::{LightKind, Material, Mesh, Object, Scene};
use rebake_core::{Budget, Unobserved, World, WorldOptions, bake};
use rebake_lab::path::path_trace;

use super::scenes::room_objects;
use super::statistics::{Estimate, area_mean, assert_agrees, replicate};

/// A room with every kind of light: a quad, a smooth lamp of many triangles, a sheet that shines to both sides and
/// stands on the floor, a point, a sky behind a missing wall.
fn lit_room() -> World {
    let mut objects: Vec<Object> = room_objects(0.6).into_iter().filter(|o| o.name != "right").collect();
    let bulb = Object::new("bulb", Mesh::icosphere(0.15, 3), Material::emissive(Vec3::new(6.0, 5.0, 4.0)));
    objects.push(bulb.placed(DMat4::from_translation(DVec3::new(0.8, 1.2, 0.8))));
    let glowing = Material { albedo: Vec3::splat(0.3), ..Material::emissive(Vec3::new(1.0, 2.0, 3.0)) };
    let sheet = Mesh::quad(Vec3::new(1.8, 0.0, 1.2), Vec3::Z * 0.9, Vec3::Y * 0.7);
    objects.push(Object::new("sheet", sheet, glowing.double_sided()));
    let light = |name: &str, kind, intensity| rebake_core::scene::Light {
        name: name.into(),
        kind,
        color: Vec3::ONE,
        intensity,
    };
    let point = LightKind::Point { position: DVec3::new(2.4, 1.8, 2.4), range: None };
    let scene = Scene::from_objects(objects).with_light(light("point", point, 3.0)).with_light(light(
        "sky",
        LightKind::Environment,
        0.4,
    ));
    World::new(scene, &WorldOptions { spacing: Some(0.15), ..WorldOptions::default() }).expect("a test scene")
}

/// Mean of `value` over elements within `near` of a point, from path tracing.
fn traced(world: &World, seed: u64, near: (Vec3, f32), value: impl Fn(Vec3, Vec3) -> Vec3) -> f64 {
    let inside = |i: &u32| {
        world.areas()[*i as usize] > 0.0 && world.is_valid(*i as usize) && {
            world.positions()[*i as usize].distance(near.0) < near.1
        }
    };
    let slots: Vec<u32> = (0..world.slots() as u32).filter(inside).collect();
    let (values, _) = path_trace(world, &slots, 256, seed, &Unobserved).expect("nobody cancels");
    let (mut sum, mut area) = (0.0, 0.0);
    for (&slot, v) in slots.iter().zip(values) {
        let a = f64::from(world.areas()[slot as usize]);
        sum += a * f64::from(value(v.direct, v.indirect).element_sum()) / 3.0;
        area += a;
    }
    sum / area
}

/// The bake samples lights alone: what path tracing finds with both strategies has to be the same, everywhere and
/// where the cosine rays carry it, next to the sheet.
#[test]
fn both_strategies_agree_with_light_sampling_alone() {
    let world = lit_room();
    for (name, near) in [("the room", (Vec3::splat(1.5), 10.0)), ("next to the sheet", (Vec3::new(1.8, 0.2, 1.6), 0.5))]
    {
        let inside = |i: usize| world.positions()[i].distance(near.0) < near.1;
        let direct = replicate(8, |seed| traced(&world, seed, near, |d, _| d));
        let sampled = replicate(8, |seed| {
            let budget = Budget { samples_per_element: 256, target_rmse: None };
            let map = bake(&world, &budget, seed, &Unobserved).expect("nobody cancels");
            area_mean(&world, inside, |i| map.light.direct[i].as_dvec3())
        });
        let both = Estimate { mean: direct.mean, error: direct.error.hypot(sampled.error) };
        assert_agrees(&format!("direct light of {name}"), both, sampled.mean, 0.0);
    }
}

#[test]
fn variance_is_that_of_the_scatter() {
    let world = lit_room();
    let slots: Vec<u32> = (0..world.slots() as u32).filter(|&i| world.is_valid(i as usize)).step_by(7).collect();
    let runs: Vec<_> =
        (0..12).map(|seed| path_trace(&world, &slots, 64, seed, &Unobserved).expect("nobody cancels").0).collect();
    let (mut scatter, mut stated) = (0.0f64, 0.0f64);
    for k in 0..slots.len() {
        let values: Vec<f64> = runs.iter().map(|r| f64::from((r[k].direct + r[k].indirect).y)).collect();
        let mean = values.iter().sum::<f64>() / 12.0;
        scatter += values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 11.0;
        stated += runs.iter().map(|r| f64::from(r[k].total_variance.y)).sum::<f64>() / 12.0;
    }
    // Stratification within a batch is in both; some thousand elements and twelve runs tell a tenth.
    assert!((stated / scatter - 1.0).abs() < 0.15, "stated {stated:.3e}, scatter {scatter:.3e}");
}

/// Right below a large lamp cosine rays find all the light and area samples of it nearly none of it well.
#[test]
fn a_near_lamp_is_as_bright_as_it_should_be() {
    let lamp = Mesh::quad(Vec3::new(0.0, 0.02, 0.0), Vec3::X, Vec3::Z);
    let floor = Mesh::quad(Vec3::ZERO, Vec3::Z, Vec3::X);
    let objects = vec![
        Object::new("lamp", lamp, Material::emissive(Vec3::ONE)),
        Object::new("floor", floor, Material::diffuse(Vec3::splat(0.5))),
    ];
    let options = WorldOptions { spacing: Some(0.05), ..WorldOptions::default() };
    let world = World::new(Scene::from_objects(objects), &options).expect("two plates");
    // The sphere holds elements of the floor and none of the lamp.
    let sphere = (Vec3::new(0.5, -0.4, 0.5), 0.415);
    let found = replicate(8, |seed| traced(&world, seed, sphere, |d, _| d));
    // Of the hemisphere's projection the lamp leaves out less than (0.02 / 0.3)².
    assert_agrees("below a near lamp", found, 1.0, (0.02f64 / 0.3).powi(2));
    assert!(found.error < 2e-3, "noise of {}", found.error);
}
