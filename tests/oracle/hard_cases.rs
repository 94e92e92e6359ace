//! Cases that break careless engines: they must stay finite, converge and agree with path tracing.

use std::sync::Arc;

use glam::{DMat4, DVec3, Vec3};
use rebake_core::scene::{Material, Mesh, Object, Scene};
use rebake_core::{Budget, Edit, LightMap, Unobserved, World, WorldOptions, bake, refine, update};
use rebake_lab::path::{PathTraced, path_trace};

use super::scenes::{crate_at, open_scene_objects, room_objects, world};
use super::statistics::{Estimate, Family, area_mean, mean_total, replicate};

/// Independent runs of each case.
const RUNS: u64 = 6;
/// By how much means may be off beside their noise: elements stand for the surface between them.
const BIAS: f64 = 0.005;

fn budget(samples: u32) -> Budget {
    Budget { samples_per_element: samples, target_rmse: None }
}

fn baked(world: &World, samples: u32, seed: u64) -> Arc<LightMap> {
    bake(world, &budget(samples), seed, &Unobserved).expect("nobody cancels")
}

/// Mean of a map over that of path tracing on every third valid element.
fn ratio_to_path_tracing(world: &World, map: &LightMap, samples: u32, seed: u64) -> f64 {
    let usable = |&i: &u32| world.areas()[i as usize] > 0.0 && world.is_valid(i as usize);
    let slots: Vec<u32> = (0..world.slots() as u32).filter(usable).skip(seed as usize % 3).step_by(3).collect();
    let (traced, _) = path_trace(world, &slots, samples, 500 + seed, &Unobserved).expect("nobody cancels");
    let weighted = |f: &dyn Fn(usize, usize) -> Vec3| -> f64 {
        let part = |(k, &s): (usize, &u32)| f64::from(world.areas()[s as usize] * f(k, s as usize).element_sum());
        slots.iter().enumerate().map(part).sum()
    };
    weighted(&|_, s| map.total(s)) / weighted(&|k, _| traced[k].direct + traced[k].indirect)
}

fn assert_finite(name: &str, map: &LightMap) {
    let finite = |i: usize| {
        map.light.direct[i].is_finite() && map.light.indirect[i].is_finite() && map.light.variance[i].is_finite()
    };
    assert!((0..map.len()).all(finite), "{name}: a value is not finite");
}

fn insert(object: Object) -> Edit {
    let asset = Arc::new(Scene::from_objects(vec![object]));
    Edit::Insert { asset, name: "thing".into(), transform: DMat4::IDENTITY }
}

/// Mean of the light after an insert over that of path tracing.
fn inserted(name: &str, before: &World, object: Object) -> Estimate {
    let transition = before.apply(&[insert(object)]).unwrap_or_else(|e| panic!("{name}: {e}"));
    replicate(RUNS, |seed| {
        let old = baked(before, 32, 10 + seed);
        let map = update(&transition, &old, &budget(32), None, 20 + seed, &Unobserved).expect("nobody cancels");
        assert_finite(name, &map);
        ratio_to_path_tracing(&transition.after, &map, 128, seed)
    })
}

#[test]
fn large_dark_and_bright_objects_in_bright_rooms() {
    let size = 1.6;
    let low = Vec3::new(0.45, 0.05, 0.45);
    let cube = |albedo: f32| {
        let mesh = Mesh::cuboid(low, low + Vec3::splat(size));
        Object::new("cube", mesh, Material::diffuse(Vec3::splat(albedo)))
    };
    // The block would stick into the cube, the lamp is above it.
    let room = |albedo| world(room_objects(albedo).into_iter().filter(|o| o.name != "block").collect(), 0.2);
    let mut family = Family::of(RUNS);
    for (wall, object) in [(0.9, 0.0), (0.95, 0.0), (0.9, 0.8)] {
        let name = format!("cube of {object} in a room of {wall}");
        let ratio = inserted(&name, &room(wall), cube(object));
        family.compare(name, ratio, 1.0, BIAS);
    }
    family.assert_agrees();
}

#[test]
fn touching_cutting_and_coplanar_objects() {
    let room = world(room_objects(0.7), 0.15);
    let cube =
        |low: Vec3, size: Vec3| Object::new("cube", Mesh::cuboid(low, low + size), Material::diffuse(Vec3::splat(0.6)));
    let sheet = Object::new(
        "sheet",
        Mesh::quad(Vec3::new(1.5, 0.0, 1.5), Vec3::Z, Vec3::X),
        Material::diffuse(Vec3::splat(0.2)).double_sided(),
    );
    let mut family = Family::of(RUNS);
    for (name, object) in [
        ("on the floor and against a wall", cube(Vec3::new(2.4, 0.0, 1.0), Vec3::splat(0.6))),
        ("through a wall", cube(Vec3::new(2.6, 0.4, 1.0), Vec3::splat(0.7))),
        ("inside another object", cube(Vec3::new(0.6, 0.2, 0.7), Vec3::splat(0.2))),
        ("a sheet in the plane of the floor", sheet),
    ] {
        family.compare(name, inserted(name, &room, object), 1.0, BIAS);
    }
    family.assert_agrees();
}

#[test]
fn tiny_lamps_enclosed_lamps_and_no_light() {
    let unlit: Vec<Object> = room_objects(0.7).into_iter().filter(|o| o.name != "lamp").collect();
    let dark = world(unlit.clone(), 0.2);
    assert_eq!(mean_total(&dark, &baked(&dark, 16, 1)), 0.0);
    let square_millimetre = Object::new(
        "spark",
        Mesh::quad(Vec3::new(1.5, 1.2, 1.5), Vec3::X * 1e-3, Vec3::Z * 1e-3),
        Material::emissive(Vec3::splat(1e6)),
    );
    let mut family = Family::of(RUNS);
    let name = "a lamp of a square millimetre";
    family.compare(name, inserted(name, &dark, square_millimetre.clone()), 1.0, BIAS);
    // A lantern that is shut around the lamp: the room goes dark.
    let mut objects = unlit;
    objects.push(square_millimetre);
    let lit = world(objects, 0.2);
    let shut = Object::new(
        "lantern",
        Mesh::cuboid(Vec3::new(1.3, 1.0, 1.3), Vec3::new(1.7, 1.4, 1.7)),
        Material::diffuse(Vec3::splat(0.5)),
    );
    let transition = lit.apply(&[insert(shut)]).expect("a lantern");
    let outside = |i: usize| (transition.after.positions()[i] - Vec3::new(1.5, 1.2, 1.5)).abs().max_element() > 0.25;
    let left = replicate(RUNS, |seed| {
        let old = baked(&lit, 64, 10 + seed);
        let map = update(&transition, &old, &budget(64), None, 20 + seed, &Unobserved).expect("nobody cancels");
        area_mean(&transition.after, outside, |i| map.total(i).as_dvec3()) / mean_total(&lit, &old)
    });
    family.compare("a lantern that is shut around it: what is left", left, 0.0, BIAS);
    family.assert_agrees();
}

#[test]
fn scales_and_distances() {
    let plain = world(room_objects(0.7), 0.2);
    let mut family = Family::of(RUNS);
    for (scale, shift) in [(1e-3, 0.0), (1e-3, 1.0), (1e4, 0.0), (1.0, 1e4), (1e4, 1e6)] {
        let place = DMat4::from_translation(DVec3::splat(shift)) * DMat4::from_scale(DVec3::splat(scale));
        let objects: Vec<Object> = room_objects(0.7)
            .into_iter()
            .map(|o| {
                let place = place * o.world_from_object;
                o.placed(place)
            })
            .collect();
        let mut scene = Scene::from_objects(objects);
        scene.origin = DVec3::splat(shift) + DVec3::splat(1.5 * scale);
        let options = WorldOptions { spacing: Some(0.2 * scale as f32), ..WorldOptions::default() };
        let world = World::new(scene, &options).expect("a scaled room");
        // Seeds of their own: the same ones would hide what both have in common.
        let ratio = replicate(RUNS, |seed| {
            mean_total(&world, &baked(&world, 32, 10 + seed)) / mean_total(&plain, &baked(&plain, 32, 20 + seed))
        });
        family.compare(format!("scale {scale}, {shift} m away, over scale 1"), ratio, 1.0, BIAS);
    }
    family.assert_agrees();
}

/// Runs of what takes a hundred edits each.
const LONG_RUNS: u64 = 8;

/// Fifty times a crate comes and goes; `after_pair` sees the map after each. Answers the world and map before and
/// after.
fn come_and_go(
    run: u64,
    mut after_pair: impl FnMut(u64, &World, Arc<LightMap>) -> Arc<LightMap>,
) -> (World, Arc<LightMap>, World, Arc<LightMap>) {
    let start = world(room_objects(0.7), 0.25);
    let before = baked(&start, 256, 1 + run);
    let (mut world, mut map) = (start.clone(), before.clone());
    let asset = Arc::new(Scene::from_objects(vec![crate_at("c", 0.0, 0.0, Vec3::splat(0.3))]));
    let transform = DMat4::from_translation(DVec3::new(2.2, 0.0, 1.9));
    for turn in 0..50 {
        let insert = Edit::Insert { asset: Arc::clone(&asset), name: "crate".into(), transform };
        for (k, edit) in [insert, Edit::Remove { objects: vec!["crate".into()] }].into_iter().enumerate() {
            let transition = world.apply(&[edit]).expect("an edit");
            let seed = 1000 * (1 + run) + 2 * turn + k as u64;
            map = update(&transition, &map, &budget(16), None, seed, &Unobserved).expect("nobody cancels");
            world = transition.after;
            if world.needs_rebuild() {
                let trees = world.rebuilt_trees();
                world = world.with_trees(trees).expect("nothing has changed since");
            }
        }
        map = after_pair(turn, &world, map);
        assert_finite("insert and remove", &map);
    }
    assert_eq!(world.element_count(), before.len(), "holes at the end are all that is left");
    (start, before, world, map)
}

#[test]
fn a_hundred_edits_by_themselves_drift_little() {
    let ratio = replicate(LONG_RUNS, |run| {
        let (start, before, world, map) = come_and_go(run, |_, _, map| map);
        assert_states_its_error((&start, &before), (&world, &map));
        mean_total(&world, &map) / mean_total(&start, &before)
    });
    let mut family = Family::of(LONG_RUNS);
    family.compare("the mean after 100 edits over that before", ratio, 1.0, DRIFT);
    family.assert_agrees();
}

/// Of the mean in a hundred edits that nothing refines.
const DRIFT: f64 = 0.01;

/// What is stated is what is there: against the map before all edits, whose own noise counts too.
fn assert_states_its_error((start, before): (&World, &LightMap), (world, map): (&World, &LightMap)) {
    let areas = f64::from(world.areas().iter().sum::<f32>());
    let squares = (0..before.len())
        .map(|i| f64::from(world.areas()[i]) * (map.total(i) - before.total(i)).as_dvec3().length_squared() / 3.0);
    let found = (squares.sum::<f64>() / areas).sqrt();
    let (own, stated) = (before.estimated_rmse(start.areas()), map.estimated_rmse(world.areas()));
    let expected = f64::from(own.hypot(stated));
    assert!(found < 1.5 * expected, "error {found}, stated {expected}");
}

/// With a little refinement after every pair, as in a service with idle time, the noise and the bias that each leaves
/// behind do not add up.
#[test]
fn refined_after_every_pair_a_hundred_edits_leave_no_trace() {
    let ratio = replicate(LONG_RUNS, |run| {
        let mut stated = Vec::new();
        let (start, before, world, map) = come_and_go(run, |turn, world, map| {
            let map = refine(world, &map, &budget(32), 1000 * (1 + run) + 500 + turn, &Unobserved);
            let map = map.expect("nobody cancels");
            stated.push(f64::from(map.estimated_rmse(world.areas())));
            map
        });
        let (first, last) = (stated[0], stated[stated.len() - 1]);
        assert!(last < 1.5 * first, "the stated error grew from {first} to {last}");
        assert_states_its_error((&start, &before), (&world, &map));
        mean_total(&world, &map) / mean_total(&start, &before)
    });
    let mut family = Family::of(LONG_RUNS);
    family.compare("the mean after 100 edits over that before", ratio, 1.0, BIAS);
    family.assert_agrees();
}

#[test]
fn open_scenes_degenerate_and_duplicate_triangles() {
    let world = world(open_scene_objects(), 0.1);
    let ratio = replicate(RUNS, |seed| {
        let map = baked(&world, 32, 10 + seed);
        assert_finite("open scene", &map);
        ratio_to_path_tracing(&world, &map, 128, seed)
    });
    let mut family = Family::of(RUNS);
    family.compare("open scene", ratio, 1.0, BIAS);
    family.assert_agrees();
}

/// Every triangle split into four.
fn split(mesh: &Mesh) -> Mesh {
    let mut fine = Mesh { triangles: Vec::new(), triangle_materials: Vec::new(), ..mesh.clone() };
    for (&[a, b, c], &material) in mesh.triangles.iter().zip(&mesh.triangle_materials) {
        let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(p, q)| {
            fine.positions.push((mesh.positions[p as usize] + mesh.positions[q as usize]) / 2.0);
            fine.normals.extend(mesh.normals.get(p as usize).copied());
            fine.positions.len() as u32 - 1
        });
        fine.triangles.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        fine.triangle_materials.extend([material; 4]);
    }
    fine
}

/// A spacing far above that of the meshes asks for no more elements than they have, and for no less of their light.
#[test]
fn meshes_finer_than_the_spacing_are_lit_as_fine_as_they_are() {
    let fine = |object: Object| {
        let mesh = (0..5).fold((*object.mesh).clone(), |mesh, _| split(&mesh));
        Object { mesh: mesh.into(), ..object }
    };
    let world = world(room_objects(0.9).into_iter().map(fine).collect(), 10.0);
    let ratio = replicate(RUNS, |seed| ratio_to_path_tracing(&world, &baked(&world, 32, 10 + seed), 64, seed));
    let mut family = Family::of(RUNS);
    family.compare("meshes finer than the spacing", ratio, 1.0, BIAS);
    family.assert_agrees();
}

#[test]
fn light_through_a_slit() {
    // Two rooms, the wall between them has a slit of 2 cm over a height of 1 m.
    let white = Material::diffuse(Vec3::splat(0.8)).double_sided();
    let mut objects = room_objects(0.8);
    let wall = |name: &str, y: f32, height: f32, z: f32, depth: f32| {
        Object::new(name, Mesh::quad(Vec3::new(2.2, y, z), Vec3::Z * depth, Vec3::Y * height), white)
    };
    objects.push(wall("wall, near part", 0.0, 2.4, 0.0, 1.0));
    objects.push(wall("wall, far part", 0.0, 2.4, 1.02, 1.98));
    let world = world(objects, 0.1);
    let behind = |i: usize| world.positions()[i].x > 2.25;
    let slots: Vec<u32> = (0..world.slots() as u32).filter(|&i| behind(i as usize)).step_by(4).collect();
    let area: f64 = slots.iter().map(|&s| f64::from(world.areas()[s as usize])).sum();
    // What is behind the slit beside path tracing, over what is in front of it.
    let leak = replicate(RUNS, |seed| {
        let map = baked(&world, 32, 10 + seed);
        let (traced, _) = path_trace(&world, &slots, 256, 500 + seed, &Unobserved).expect("nobody cancels");
        let part = |(&s, t): (&u32, &PathTraced)| {
            f64::from(world.areas()[s as usize] * (map.total(s as usize) - t.direct - t.indirect).element_sum())
        };
        let more = slots.iter().zip(&traced).map(part).sum::<f64>() / (3.0 * area);
        more / area_mean(&world, |i| !behind(i), |i| map.total(i).as_dvec3())
    });
    // A map of vertices 10 cm apart cannot end light at a wall without thickness: what leaks is stated, and bounded.
    let mut family = Family::of(RUNS);
    family.compare("light that leaks past a slit", leak, 0.0, LEAK);
    family.assert_agrees();
}

/// Through walls without thickness at a spacing of 10 cm.
const LEAK: f64 = 0.08;
