//! Direct light between facing plates against the closed-form form factor.

use std::f64::consts::PI;

use glam::Vec3;
use rebake_core::scene::{Light, LightKind, Material, Mesh, Object, Scene};
use rebake_core::{Budget, Unobserved, World, WorldOptions, bake};
use rebake_lab::path::path_trace;

use super::scenes::world;
use super::statistics::{area_mean, assert_agrees, replicate};

/// Form factor of two directly opposed equal squares of side `a` at distance `c` (Howell, configuration C-11).
fn parallel_squares(a: f64, c: f64) -> f64 {
    let x = a / c;
    let r = (1.0 + x * x).sqrt();
    2.0 / (PI * x * x)
        * (((1.0 + x * x).powi(2) / (1.0 + 2.0 * x * x)).sqrt().ln() + 2.0 * x * r * (x / r).atan()
            - 2.0 * x * x.atan())
}

#[test]
fn two_facing_plates() {
    for distance in [0.1f32, 0.5, 1.0, 3.0] {
        let lamp = Object::new(
            "lamp",
            Mesh::quad(Vec3::new(0.0, distance, 0.0), Vec3::X, Vec3::Z),
            Material::emissive(Vec3::ONE),
        );
        let plate = Object::new("plate", Mesh::quad(Vec3::ZERO, Vec3::Z, Vec3::X), Material::diffuse(Vec3::splat(0.5)));
        let world = world(vec![lamp, plate], 0.02);
        let plate = world.objects().find(|o| o.name == "plate").expect("the plate");
        let range = plate.first_element as usize..(plate.first_element + plate.element_count) as usize;
        let estimate = replicate(8, |seed| {
            let budget = Budget { samples_per_element: 8, target_rmse: None };
            let map = bake(&world, &budget, seed, &Unobserved).expect("nobody cancels");
            area_mean(&world, |i| range.contains(&i), |i| map.light.direct[i].as_dvec3())
        });
        let truth = parallel_squares(1.0, f64::from(distance));
        // The mean over the plate is a sum over elements 2 cm apart: an error of the second order of that over the
        // distance at which light varies.
        let quadrature = truth * (0.02f64 / f64::from(distance)).powi(2) * 0.25;
        assert_agrees(&format!("plates at {distance} m"), estimate, truth, quadrature + 1e-4 * truth);
    }
}

/// Point, spot and parallel light and a constant sky on an open plane: exact values.
#[test]
fn punctual_lights_and_sky_on_a_plane() {
    let plane = Object::new(
        "plane",
        Mesh::quad(Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0),
        Material::diffuse(Vec3::splat(0.5)),
    );
    let light = |name: &str, kind, intensity| Light { name: name.into(), kind, color: Vec3::ONE, intensity };
    let height = 2.0f64;
    let position = glam::DVec3::new(0.0, height, 0.0);
    type Exact = Box<dyn Fn(Vec3) -> f64>;
    let cases: Vec<(&str, LightKind, f32, Exact)> = vec![
        (
            "point",
            LightKind::Point { position, range: None },
            5.0,
            Box::new(move |p| {
                let r2 = f64::from(p.length_squared()) + height * height;
                5.0 * height / r2.powf(1.5) / PI
            }),
        ),
        (
            "sun",
            LightKind::Directional { direction: Vec3::new(0.6, -0.8, 0.0), angle: 0.0 },
            3.0,
            Box::new(|_| 3.0 * 0.8 / PI),
        ),
        ("sky", LightKind::Environment, 0.7, Box::new(|_| 0.7)),
        (
            "spot",
            LightKind::Spot {
                position,
                direction: Vec3::NEG_Y,
                inner_cone_angle: 0.6,
                outer_cone_angle: 0.9,
                range: None,
            },
            5.0,
            Box::new(move |p| {
                let r2 = f64::from(p.length_squared()) + height * height;
                let cos = height / r2.sqrt();
                let t = ((cos - 0.9f64.cos()) / (0.6f64.cos() - 0.9f64.cos())).clamp(0.0, 1.0);
                5.0 * t * t * height / r2.powf(1.5) / PI
            }),
        ),
    ];
    for (name, kind, intensity, exact) in cases {
        let scene = Scene::from_objects(vec![plane.clone()]).with_light(light(name, kind, intensity));
        let options = WorldOptions { spacing: Some(0.5), ..WorldOptions::default() };
        let world = World::new(scene, &options).expect("a plane");
        let slots: Vec<u32> = (0..world.slots() as u32).filter(|&i| world.normals()[i as usize].y > 0.5).collect();
        let (traced, _) = path_trace(&world, &slots, 32, 1, &Unobserved).expect("nobody cancels");
        for (&slot, value) in slots.iter().zip(traced) {
            let truth = exact(world.positions()[slot as usize]);
            let found = f64::from(value.direct.x);
            assert!((found - truth).abs() <= 2e-5 * truth + 1e-7, "{name} at slot {slot}: {found} against {truth}");
            assert_eq!(value.indirect, Vec3::ZERO, "{name}: an open plane sees nothing that reflects");
        }
    }
}
