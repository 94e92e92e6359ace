//! Every instruction set against brute force, and the properties that `Bvh` promises.

mod meshes;
mod robustness;

use self::meshes::{Random, soup};
use super::*;

/// One tree per instruction set of this CPU, over the same triangles.
fn trees(corners: &[[Vec3; 3]], quality: BuildQuality) -> Vec<Bvh> {
    let ids: Vec<u32> = (0..corners.len() as u32).collect();
    let build = |instruction_set| {
        let mut bvh = Bvh::build(corners, &ids, quality);
        bvh.instruction_set = instruction_set;
        bvh
    };
    InstructionSet::available().map(build).collect()
}

fn tree(corners: &[[Vec3; 3]]) -> Bvh {
    let ids: Vec<u32> = (0..corners.len() as u32).collect();
    Bvh::build(corners, &ids, BuildQuality::Good)
}

fn ray(origin: Vec3, direction: Vec3) -> Ray {
    Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY }
}

fn bits(hit: Option<Hit>) -> Option<[u32; 7]> {
    let bits = |hit: Hit| [hit.t, hit.u, hit.v, hit.normal.x, hit.normal.y, hit.normal.z].map(f32::to_bits);
    hit.map(|hit| {
        let [t, u, v, x, y, z] = bits(hit);
        [hit.triangle, t, u, v, x, y, z]
    })
}

/// Möller and Trumbore's test in f64, with the smallest of the barycentric weights: how clear the hit or the miss is.
fn reference(ray: &Ray, corners: &[Vec3; 3]) -> Option<(f64, f64)> {
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    let (origin, direction) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let (ab, ac) = (b - a, c - a);
    let p = direction.cross(ac);
    let determinant = ab.dot(p);
    let q = (origin - a).cross(ab);
    let (u, v, t) = ((origin - a).dot(p) / determinant, direction.dot(q) / determinant, ac.dot(q) / determinant);
    let clearance = u.min(v).min(1.0 - u - v);
    (t.is_finite() && clearance > -1e-4).then_some((t, clearance))
}

/// The distance of the closest clear hit, and of the closest that might count.
fn brute_force(ray: &Ray, corners: &[[Vec3; 3]], mask: Option<&TriangleMask>) -> (f64, f64) {
    let mut closest = (f64::INFINITY, f64::INFINITY);
    for (id, corners) in corners.iter().enumerate() {
        if mask.is_some_and(|mask| mask.get(id as u32)) {
            continue;
        }
        let Some((t, clearance)) = reference(ray, corners) else { continue };
        let (low, high) = (f64::from(ray.t_min), f64::from(ray.t_max));
        if t > low * (1.0 - 1e-4) && t < high * (1.0 + 1e-4) {
            closest.1 = closest.1.min(t);
        }
        if clearance > 1e-4 && t > low * (1.0 + 1e-4) && t < high * (1.0 - 1e-4) {
            closest.0 = closest.0.min(t);
        }
    }
    closest
}

fn check_against_brute_force(trees: &[Bvh], corners: &[[Vec3; 3]], ray: &Ray, mask: Option<&TriangleMask>) -> bool {
    let hit = trees[0].closest_hit(ray, mask);
    for tree in trees {
        assert_eq!(bits(tree.closest_hit(ray, mask)), bits(hit), "{:?} {ray:?}", tree.instruction_set);
        assert_eq!(tree.any_hit(ray, mask), hit.is_some(), "{:?} {ray:?}", tree.instruction_set);
    }
    let (surely, perhaps) = brute_force(ray, corners, mask);
    let t = hit.map_or(f64::INFINITY, |hit| f64::from(hit.t));
    assert!(t <= surely * (1.0 + 1e-3) && t >= perhaps * (1.0 - 1e-3), "{t} {surely} {perhaps} {ray:?}");
    if let Some(hit) = hit {
        let corners = corners[hit.triangle as usize];
        let found = corners[0] * (1.0 - hit.u - hit.v) + corners[1] * hit.u + corners[2] * hit.v;
        let size = corners[0].distance(corners[1]) + corners[0].distance(corners[2]);
        let along = ray.origin + ray.direction * hit.t;
        assert!(found.distance(along) <= 1e-2 * size + 1e-4 * along.distance(ray.origin), "{hit:?}");
        assert!((hit.normal.length() - 1.0).abs() < 1e-6);
        assert!(!mask.is_some_and(|mask| mask.get(hit.triangle)));
    }
    hit.is_some()
}

#[test]
fn all_paths_agree_with_brute_force() {
    for (count, quality) in [
        (1, BuildQuality::Fast),
        (7, BuildQuality::Good),
        (9, BuildQuality::Fast),
        (300, BuildQuality::Fast),
        (1000, BuildQuality::Good),
    ] {
        let mut random = Random(count as u64);
        let corners = soup(&mut random, count, 0.3);
        let trees = trees(&corners, quality);
        trees[0].validate().expect("a valid tree");
        let mut mask = TriangleMask::default();
        (0..count as u32).filter(|id| id % 3 == 0).for_each(|id| mask.set(id, true));
        let mut hits = 0;
        for i in 0..1500 {
            let mut ray = ray(random.in_cube() * 1.5, random.in_cube());
            if i % 2 == 0 {
                (ray.t_min, ray.t_max) = (0.1, 0.3 + random.unit());
            }
            hits += u32::from(check_against_brute_force(&trees, &corners, &ray, None));
            check_against_brute_force(&trees, &corners, &ray, Some(&mask));
        }
        assert!(hits > 0 || count < 10);
    }
}

#[test]
fn the_range_of_t_is_half_open() {
    let corners = [[Vec3::new(-1.0, -1.0, 2.0), Vec3::new(3.0, -1.0, 2.0), Vec3::new(-1.0, 3.0, 2.0)]];
    for tree in trees(&corners, BuildQuality::Fast) {
        let hits = |t_min, t_max| tree.any_hit(&Ray { t_min, t_max, ..ray(Vec3::ZERO, Vec3::Z) }, None);
        assert!(hits(2.0, 2.5) && hits(0.0, 2.0f32.next_up()) && hits(0.0, f32::INFINITY));
        assert!(
            !hits(0.0, 2.0)
                && !hits(2.0f32.next_up(), 9.0)
                && !hits(0.0, 0.0)
                && !hits(f32::NAN, 9.0)
                && !hits(0.0, f32::NAN)
        );
        let hit = tree.closest_hit(&ray(Vec3::ZERO, Vec3::Z), None).expect("a hit");
        assert_eq!((hit.t, hit.u, hit.v, hit.triangle, hit.normal), (2.0, 0.25, 0.25, 0, Vec3::Z));
        // From behind: the normal is the winding's, not the ray's.
        let behind = tree.closest_hit(&ray(Vec3::Z * 4.0, Vec3::NEG_Z * 2.0), None).expect("a hit");
        assert_eq!((behind.t, behind.normal), (1.0, Vec3::Z));
    }
}

#[test]
fn equal_distances_go_to_the_smallest_id() {
    let mut random = Random(5);
    let corners = soup(&mut random, 500, 0.3);
    let doubled: Vec<_> = corners.iter().chain(&corners).copied().collect();
    let ids: Vec<u32> = (0..1000).map(|i| (i * 7919) % 1009).collect();
    let lesser = |id: u32| {
        let place = ids.iter().position(|&other| other == id).expect("an id");
        ids[place % 500].min(ids[place % 500 + 500])
    };
    let tree = Bvh::build(&doubled, &ids, BuildQuality::Good);
    for _ in 0..5000 {
        if let Some(hit) = tree.closest_hit(&ray(random.in_cube(), random.in_cube()), None) {
            assert_eq!(hit.triangle, lesser(hit.triangle));
        }
    }
}

#[test]
fn hits_do_not_depend_on_the_tree() {
    let mut random = Random(6);
    let mut corners = meshes::room(0.1);
    corners.extend(soup(&mut random, 500, 0.2));
    let (good, ids) = (tree(&corners), (0..corners.len() as u32).rev().collect::<Vec<_>>());
    let reversed: Vec<_> = corners.iter().rev().copied().collect();
    let fast = Bvh::build(&reversed, &ids, BuildQuality::Fast);
    for i in 0..20_000 {
        // Half of the rays aim at corners, where as many as six triangles compete.
        let origin = random.in_cube() * 0.9;
        let target = corners[(random.unit() * corners.len() as f32) as usize % corners.len()][i % 3];
        let ray = ray(origin, if i % 2 == 0 { target - origin } else { random.in_cube() });
        assert_eq!(bits(good.closest_hit(&ray, None)), bits(fast.closest_hit(&ray, None)));
    }
}

#[test]
fn threads_do_not_change_the_tree() {
    let corners = meshes::room(0.02);
    let ids: Vec<u32> = (0..corners.len() as u32).collect();
    let build = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| Bvh::build(&corners, &ids, BuildQuality::Good))
    };
    let (one, two) = (build(1), build(2));
    assert_eq!(one.nodes.len(), two.nodes.len());
    assert!(one.nodes.iter().zip(&two.nodes).all(|(a, b)| a.planes == b.planes && a.children == b.children));
    assert!(one.blocks.iter().zip(&two.blocks).all(|(a, b)| a.ids == b.ids));
}

#[test]
fn flat_walls_make_a_good_tree() {
    // obvhs' Morton code wraps at the faces of the scene's box: unrepaired, the tree of a closed room is several times
    // dearer.
    let corners = meshes::room(0.02);
    let tree = tree(&corners);
    tree.validate().expect("a valid tree");
    let cost = tree.surface_area_cost();
    assert!(cost < 16.0, "{} triangles: {cost}", corners.len());
    let bytes = tree.memory_bytes() as f32 / corners.len() as f32;
    assert!(bytes < 75.0, "{bytes} bytes per triangle");
}
