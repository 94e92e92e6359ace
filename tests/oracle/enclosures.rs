//! Closed enclosures with closed-form light.

use glam::{DMat4, Vec3};
use rebake_core::scene::{Material, Mesh, Object};
use rebake_core::{Budget, Unobserved, bake};
use rebake_lab::path::path_trace;

use super::scenes::world;
use super::statistics::{area_mean, assert_agrees, mean_total, replicate};

fn budget(samples: u32) -> Budget {
    Budget { samples_per_element: samples, target_rmse: None }
}

/// A closed box that emits 1 and reflects ρ everywhere: L = 1 + ρ + ρ² + … = 1 / (1 − ρ) = irradiance / π.
#[test]
fn furnace() {
    for albedo in [0.5, 0.7, 0.9, 0.95, 0.99] {
        let material = Material { emission: Vec3::ONE, ..Material::diffuse(Vec3::splat(albedo)) };
        let room = Object::new("furnace", Mesh::cuboid(Vec3::ZERO, Vec3::new(2.0, 1.5, 1.0)).inside_out(), material);
        let world = world(vec![room], 0.3);
        let truth = 1.0 / (1.0 - f64::from(albedo));
        let total = replicate(8, |seed| {
            let map = bake(&world, &budget(32), seed, &Unobserved).expect("nobody cancels");
            mean_total(&world, &map)
        });
        assert_agrees(&format!("baked furnace of albedo {albedo}"), total, truth, 0.0);
        if albedo <= 0.9 {
            let slots: Vec<u32> = (0..world.slots() as u32).step_by(5).collect();
            let traced = replicate(8, |seed| {
                let (values, _) = path_trace(&world, &slots, 256, seed, &Unobserved).expect("nobody cancels");
                let sum: Vec3 = values.iter().map(|v| v.direct + v.indirect).sum();
                f64::from(sum.element_sum()) / 3.0 / slots.len() as f64
            });
            assert_agrees(&format!("path-traced furnace of albedo {albedo}"), traced, truth, 0.0);
        }
    }
}

/// A sphere in a sphere that emits 1: the form factors are ratios of areas, and symmetry makes light constant on each.
#[test]
fn sphere_in_a_sphere() {
    let (outer_albedo, inner_albedo) = (0.6f64, 0.8f64);
    let emitting = Material { emission: Vec3::ONE, ..Material::diffuse(Vec3::splat(outer_albedo as f32)) };
    let outer = Object::new("outer", Mesh::icosphere(2.0, 4).inside_out(), emitting);
    let inner = Object::new("inner", Mesh::icosphere(0.8, 3), Material::diffuse(Vec3::splat(inner_albedo as f32)))
        .placed(DMat4::IDENTITY);
    let world = world(vec![outer, inner], 1.0);
    let area = |index| world.objects().nth(index).map(|o| (o.first_element as usize, o.element_count as usize));
    let (first, count) = area(1).expect("two objects");
    let is_inner = |i: usize| i >= first && i < first + count;
    let area_of = |inner: bool| {
        let areas = world.areas().iter().enumerate().filter(|(i, _)| is_inner(*i) == inner);
        areas.map(|(_, a)| f64::from(*a)).sum::<f64>()
    };
    let f_oi = area_of(true) / area_of(false);
    // B_o = 1 + ρ_o M_o, B_i = ρ_i M_i, M_i = B_o, M_o = F_oi B_i + (1 − F_oi) B_o.
    let m_outer_per_b = f_oi * inner_albedo + (1.0 - f_oi);
    let b_outer = 1.0 / (1.0 - outer_albedo * m_outer_per_b);
    for (which, truth) in [(true, b_outer), (false, m_outer_per_b * b_outer)] {
        let estimate = replicate(8, |seed| {
            let map = bake(&world, &budget(16), seed, &Unobserved).expect("nobody cancels");
            area_mean(&world, |i| is_inner(i) == which, |i| map.total(i).as_dvec3())
        });
        // The spheres have flat faces: light is constant only up to their sagitta, (edge / radius)² / 8 = 0.1 %.
        assert_agrees(if which { "inner sphere" } else { "outer sphere" }, estimate, truth, 1e-3 * truth);
    }
}
