//! Closed surfaces that must not leak, and input that must not do harm.

use super::meshes::{self, Random, soup};
use super::{ray, tree, trees};
use crate::bvh::{BuildQuality, Bvh, Ray, TriangleMask};
use glam::Vec3;

/// Rays from inside a closed surface that contains `centre ± scale / 2`, aimed at its corners and edges.
fn leaks(surface: &[[Vec3; 3]], scale: f32, centre: Vec3, rays: usize) -> usize {
    let surface: Vec<_> = surface.iter().map(|triangle| triangle.map(|p| p * scale + centre)).collect();
    let mut trees = trees(&surface, BuildQuality::Good);
    let tree = trees.swap_remove(0);
    let mut random = Random(7);
    let escapes = |i: &usize| {
        let triangle = surface[(random.unit() * surface.len() as f32) as usize % surface.len()];
        let along = if i.is_multiple_of(3) { 0.0 } else { random.unit() };
        let target = triangle[i % 3].lerp(triangle[(i + 1) % 3], along);
        let origin = centre + random.in_cube() * (0.5 * scale);
        let ray = ray(origin, target - origin);
        let hit = tree.closest_hit(&ray, None);
        assert_eq!(hit.is_some(), tree.any_hit(&ray, None));
        // A hit far behind the surface aimed at is a leak as well.
        hit.is_none_or(|hit| (hit.t - 1.0).abs() > 1e-2)
    };
    (0..rays).filter(escapes).count()
}

#[test]
fn closed_surfaces_do_not_leak() {
    for surface in [meshes::room(0.1), meshes::sphere(0.1)] {
        for (scale, centre) in [(1.0, Vec3::ZERO), (1.0, Vec3::splat(500.0)), (1e-3, Vec3::ZERO), (1e4, Vec3::ZERO)] {
            assert_eq!(leaks(&surface, scale, centre, 100_000), 0, "scale {scale}, centre {centre}");
        }
    }
}

#[test]
fn axis_parallel_rays_in_the_planes_of_boxes() {
    // On grid lines every ray lies in the faces of unpadded boxes, along edges, through corners.
    let surface = meshes::room(0.25);
    for tree in trees(&surface, BuildQuality::Good) {
        for (i, j) in (0..64).map(|cell| (cell % 8, cell / 8)) {
            let (a, b) = (i as f32 * 0.25 - 1.0, j as f32 * 0.25 - 1.0);
            for (origin, axis) in
                [(Vec3::new(a, b, 0.0), Vec3::Z), (Vec3::new(b, 0.0, a), Vec3::Y), (Vec3::new(0.0, a, b), Vec3::X)]
            {
                for direction in [axis, -axis] {
                    let hit = tree.closest_hit(&ray(origin, direction), None);
                    // Rays inside a wall see it edge-on; the opposite wall still stops them.
                    assert!(hit.is_some_and(|hit| hit.t <= 1.0), "{origin} {direction} {hit:?}");
                }
            }
        }
    }
}

#[test]
fn an_empty_tree_is_never_hit() {
    let lost = [[Vec3::NAN; 3], [Vec3::ZERO, Vec3::X, Vec3::splat(f32::INFINITY)]];
    for tree in trees(&[], BuildQuality::Good).into_iter().chain(trees(&lost, BuildQuality::Fast)) {
        tree.validate().expect("a valid tree");
        assert_eq!((tree.triangle_count(), tree.surface_area_cost()), (0, 1.0));
        for direction in [Vec3::X, Vec3::NEG_Y, Vec3::ONE, Vec3::ZERO, Vec3::NAN, Vec3::INFINITY] {
            assert!(tree.closest_hit(&ray(Vec3::ZERO, direction), None).is_none());
            assert!(!tree.any_hit(&ray(Vec3::NAN, direction), None));
        }
    }
}

#[test]
fn duplicates_are_all_there() {
    let triangle = [Vec3::new(-1.0, -1.0, 3.0), Vec3::new(2.0, -1.0, 3.0), Vec3::new(-1.0, 2.0, 3.0)];
    let tree = tree(&[triangle; 10_000]);
    tree.validate().expect("a valid tree");
    assert_eq!(tree.triangle_count(), 10_000);
    let mut mask = TriangleMask::default();
    (0..9_999).for_each(|id| mask.set(id, true));
    let ray = ray(Vec3::ZERO, Vec3::Z);
    assert_eq!(tree.closest_hit(&ray, None).map(|hit| hit.triangle), Some(0));
    assert_eq!(tree.closest_hit(&ray, Some(&mask)).map(|hit| hit.triangle), Some(9_999));
    mask.set(9_999, true);
    assert!(!tree.any_hit(&ray, Some(&mask)));
}

#[test]
fn degenerate_triangles_do_no_harm() {
    let mut random = Random(8);
    let mut corners = soup(&mut random, 200, 0.3);
    for triangle in &mut corners[..100] {
        triangle[2] = triangle[0].lerp(triangle[1], 0.5);
    }
    corners[100..120].iter_mut().for_each(|triangle| *triangle = [triangle[0]; 3]);
    let tree = tree(&corners);
    tree.validate().expect("a valid tree");
    for i in 0..20_000 {
        let origin = random.in_cube() * 2.0;
        let target = corners[i % 120][0].lerp(corners[i % 120][1], random.unit());
        let ray = ray(origin, target - origin);
        let Some(hit) = tree.closest_hit(&ray, None) else { continue };
        let finite =
            hit.t.is_finite() && hit.normal.is_finite() && hit.u >= 0.0 && hit.v >= 0.0 && hit.u + hit.v < 1.000_001;
        assert!(finite && (hit.normal.length() - 1.0).abs() < 1e-5, "{hit:?}");
        assert!(!(100..120).contains(&hit.triangle));
    }
}

#[test]
fn sizes_may_differ_by_any_factor() {
    let mut random = Random(9);
    let sizes = [1e-12, 1e-6, 1e-3, 1.0, 1e4, 1e18, 1e38];
    let sized = |&size: &f32| {
        soup(&mut random, 300, 1.0).into_iter().map(move |triangle| triangle.map(|p| p * size)).collect::<Vec<_>>()
    };
    let mut corners: Vec<_> = sizes.iter().flat_map(sized).collect();
    for _ in 0..3 {
        let tree = tree(&corners);
        tree.validate().expect("a valid tree");
        assert!(!tree.surface_area_cost().is_nan());
        for _ in 0..300 {
            let ray = Ray { t_min: 1e-3, ..ray(random.in_cube(), random.in_cube()) };
            if let Some(hit) = tree.closest_hit(&ray, None) {
                assert!(hit.t.is_finite() && (hit.normal.length() - 1.0).abs() < 1e-5, "{hit:?}");
            }
        }
        corners.truncate(corners.len() - 600);
    }
}

#[test]
fn all_scales_hit_alike() {
    let mut random = Random(10);
    let corners = soup(&mut random, 400, 0.3);
    // Powers of two scale without rounding: the hits are the same bit by bit.
    let scaled = |scale: f32| tree(&corners.iter().map(|triangle| triangle.map(|p| p * scale)).collect::<Vec<_>>());
    let (small, large) = (scaled(2f32.powi(-10)), scaled(2f32.powi(13)));
    for _ in 0..5000 {
        let (origin, direction) = (random.in_cube(), random.in_cube());
        let hit = |tree: &Bvh, scale: f32| tree.closest_hit(&ray(origin * scale, direction * scale), None);
        let [a, b] = [hit(&small, 2f32.powi(-10)), hit(&large, 2f32.powi(13))];
        assert_eq!(a.map(|hit| (hit.t, hit.triangle)), b.map(|hit| (hit.t, hit.triangle)));
    }
}
