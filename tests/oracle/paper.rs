//! Lu et al. as published, against bakes of the edited scene where it converges, and where it does not.

use std::sync::Arc;

use glam::{DMat4, DVec3, Vec3};
use rebake_core::scene::{Material, Mesh, Object, Scene};
use rebake_core::{Budget, Edit, LightMap, Relight, Transition, Unobserved, World, bake, update};
use rebake_lab::paper::{Equation, PaperError, PaperOptions, paper_update};
use rebake_lab::path::path_trace;

use super::scenes::{crate_at, room_objects, world};
use super::statistics::{area_mean, assert_agrees, replicate};

fn baked(world: &World, samples: u32, seed: u64) -> Arc<LightMap> {
    let budget = Budget { samples_per_element: samples, target_rmse: None };
    bake(world, &budget, seed, &Unobserved).expect("nobody cancels")
}

fn published(transition: &Transition, map: &LightMap, options: &PaperOptions, seed: u64) -> LightMap {
    paper_update(transition, map, options, seed, &Unobserved).expect("objects only").map
}

/// N and M large enough that what they cut off is below what the tests can see.
const CONVERGED: PaperOptions =
    PaperOptions { samples: 16, iterations: 4, path_length: 8, equation: Equation::Indirect };

fn insertion(object: Object, x: f64, z: f64) -> Edit {
    let asset = Arc::new(Scene::from_objects(vec![object]));
    Edit::Insert { asset, name: "crate".into(), transform: DMat4::from_translation(DVec3::new(x, 0.0, z)) }
}

/// Means of direct and indirect light over everything and near the edit, against bakes.
fn check(name: &str, before: &World, edit: Edit, near: Vec3, options: &PaperOptions) {
    let transition = before.apply(&[edit]).unwrap_or_else(|e| panic!("{name}: {e}"));
    let after = &transition.after;
    let truth: Vec<_> = (0..4).map(|seed| baked(after, 128, 900 + seed)).collect();
    let found: Vec<LightMap> =
        (0..6).map(|seed| published(&transition, &baked(before, 48, 50 + seed), options, seed)).collect();
    type Part = (&'static str, fn(&LightMap, usize) -> Vec3);
    let apart: [Part; 2] = [("direct", |m, i| m.light.direct[i]), ("indirect", |m, i| m.light.indirect[i])];
    let together: [Part; 1] = [("all light", |m, i| m.total(i))];
    let parts: &[Part] = if options.equation == Equation::Full { &together } else { &apart };
    for (part, value) in parts {
        for (region, reach, bias) in [("everywhere", f32::MAX, 4e-3), ("near the edit", 0.8, 15e-3)] {
            let inside = |i: usize| after.positions()[i].distance(near) < reach;
            let mean = |map: &LightMap| area_mean(after, inside, |i| value(map, i).as_dvec3());
            let exact = replicate(truth.len() as u64, |k| mean(&truth[k as usize]));
            let estimate = replicate(found.len() as u64, |k| mean(&found[k as usize]));
            // Elements stand 20 cm apart: a map of them has a bias, near the object more (as for the update).
            let allowed = bias * exact.mean + 5.0 * exact.error;
            assert_agrees(&format!("{name}, {part} {region}"), estimate, exact.mean, allowed);
        }
    }
}

fn room(albedo: f32) -> World {
    world(room_objects(albedo), 0.2)
}

fn room_with_crate() -> World {
    let mut objects = room_objects(0.6);
    objects.push(crate_at("crate", 2.2, 1.9, Vec3::new(0.2, 0.5, 0.7)));
    world(objects, 0.2)
}

#[test]
fn insertion_agrees_with_a_bake_where_it_converges() {
    let near = Vec3::new(2.2, 0.3, 1.9);
    let edit = || insertion(crate_at("c", 0.0, 0.0, Vec3::new(0.2, 0.5, 0.7)), 2.2, 1.9);
    check("insert by (4)", &room(0.6), edit(), near, &CONVERGED);
    check("insert by (3)", &room(0.6), edit(), near, &PaperOptions { equation: Equation::Full, ..CONVERGED });
}

/// An object that sees itself and shines: the walk on the object and its own light.
#[test]
fn a_concave_object_with_a_lamp_agrees_with_a_bake() {
    let mut open_box = Object::new(
        "open box",
        Mesh::cuboid(Vec3::new(-0.3, 0.0, -0.3), Vec3::new(0.3, 0.6, 0.3)),
        Material::diffuse(Vec3::splat(0.8)).double_sided(),
    );
    let mesh = Arc::make_mut(&mut open_box.mesh);
    // Without its top.
    let top = |t: &[u32; 3]| t.iter().all(|&i| mesh.positions[i as usize].y > 0.5);
    let keep: Vec<bool> = mesh.triangles.iter().map(|t| !top(t)).collect();
    let mut flags = keep.iter();
    mesh.triangles.retain(|_| *flags.next().expect("a flag each"));
    mesh.triangle_materials.truncate(mesh.triangles.len());
    let bulb = Object::new(
        "bulb",
        Mesh::cuboid(Vec3::new(-0.1, 0.1, -0.1), Vec3::new(0.1, 0.3, 0.1)),
        Material { emission: Vec3::splat(3.0), ..Material::diffuse(Vec3::splat(0.5)) },
    );
    let asset = Arc::new(Scene::from_objects(vec![open_box, bulb]));
    let transform = DMat4::from_translation(DVec3::new(2.2, 0.0, 1.9));
    let edit = Edit::Insert { asset, name: "lantern".into(), transform };
    // The lamp is small and seen by few rays: more samples than elsewhere.
    let options = PaperOptions { samples: 48, ..CONVERGED };
    check("insert a lantern", &room(0.6), edit, Vec3::new(2.2, 0.3, 1.9), &options);
}

#[test]
fn removal_agrees_with_a_bake() {
    let near = Vec3::new(2.2, 0.3, 1.9);
    let edit = || Edit::Remove { objects: vec!["crate".into()] };
    check("remove by (4)", &room_with_crate(), edit(), near, &CONVERGED);
    check("remove by (3)", &room_with_crate(), edit(), near, &PaperOptions { equation: Equation::Full, ..CONVERGED });
}

#[test]
fn moves_and_repaints_are_a_removal_and_an_insertion() {
    let transform = DMat4::from_translation(DVec3::new(2.0, 0.0, 0.9));
    let edit = Edit::Move { object: "crate".into(), transform };
    check("move", &room_with_crate(), edit, Vec3::new(2.0, 0.3, 0.9), &CONVERGED);
    let edit = Edit::Material { object: "crate".into(), albedo: Vec3::new(0.8, 0.1, 0.1) };
    check("repaint", &room_with_crate(), edit, Vec3::new(2.2, 0.3, 1.9), &CONVERGED);
}

#[test]
fn edits_of_lights_are_refused() {
    let before = world(room_objects(0.6), 0.4);
    let relight = Relight { light: "lamp".into(), color: None, intensity: Some(2.0) };
    let transition = before.apply(&[Edit::Relight { lights: vec![relight] }]).expect("a light");
    let map = LightMap::black(before.slots());
    let answer = paper_update(&transition, &map, &PaperOptions::default(), 1, &Unobserved);
    assert_eq!(answer.err(), Some(PaperError::Lights));
}

#[test]
fn results_do_not_depend_on_threads() {
    let before = world(room_objects(0.6), 0.3);
    let map = baked(&before, 16, 1);
    let transition = before.apply(&[insertion(crate_at("c", 0.0, 0.0, Vec3::splat(0.5)), 2.2, 1.9)]).expect("a crate");
    let options = PaperOptions { samples: 4, ..PaperOptions::default() };
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| published(&transition, &map, &options, 7))
    };
    assert!(run(1) == run(3));
}

/// A black cube of 64 % of the walls' area in a room of albedo 0.8: the spectral radius of `T_S* 𝒪` is 2.65, with M = 3
/// 1.6. Every further iteration makes the map worse; equation (1) converges.
#[test]
fn large_black_objects_in_bright_rooms_make_it_diverge() {
    let walls = Mesh::cuboid(Vec3::ZERO, Vec3::splat(2.0)).inside_out();
    let mut objects = vec![Object::new("walls", walls, Material::diffuse(Vec3::splat(0.8)))];
    // Lamps above the gaps between the cube and the walls.
    for (k, (x, z)) in [(1.85, 0.95), (0.05, 0.95), (0.95, 1.85), (0.95, 0.05)].into_iter().enumerate() {
        let lamp = Mesh::quad(Vec3::new(x, 1.95, z), Vec3::X * 0.1, Vec3::Z * 0.1);
        objects.push(Object::new(format!("lamp {k}"), lamp, Material::emissive(Vec3::splat(50.0))));
    }
    let before = world(objects, 0.1);
    let base = baked(&before, 256, 1);
    let cube = Mesh::cuboid(Vec3::new(-0.8, 0.2, -0.8), Vec3::new(0.8, 1.8, 0.8));
    let edit = insertion(Object::new("cube", cube, Material::diffuse(Vec3::ZERO)), 1.0, 1.0);
    let transition = before.apply(&[edit]).expect("a cube");
    let after = &transition.after;
    let rows: Vec<u32> = (0..before.slots() as u32).filter(|&i| after.is_valid(i as usize)).step_by(5).collect();
    let (truth, _) = path_trace(after, &rows, 256, 3, &Unobserved).expect("nobody cancels");
    let error = |map: &LightMap| {
        let (mut sum, mut size) = (0.0, 0.0);
        for (&slot, t) in rows.iter().zip(&truth) {
            let area = f64::from(after.areas()[slot as usize]);
            sum += area * f64::from((map.light.indirect[slot as usize] - t.indirect).length_squared());
            size += area * f64::from(t.indirect.length_squared());
        }
        (sum / size).sqrt()
    };
    let at = |iterations| {
        let options = PaperOptions { samples: 32, iterations, ..PaperOptions::default() };
        error(&published(&transition, &base, &options, 1))
    };
    let errors = [at(4), at(8), at(16)];
    let budget = Budget { samples_per_element: 64, target_rmse: None };
    let ours = error(&update(&transition, &base, &budget, None, 1, &Unobserved).expect("nobody cancels"));
    let untouched = error(&transition.carry_over(&base));
    assert!(errors[0] > 1.0 && errors[1] > 3.0 * errors[0] && errors[2] > 9.0 * errors[1], "{errors:?}");
    // Light is left in gaps of two elements' width alone, where any map of elements is coarse.
    assert!(ours < 0.15 * untouched, "{ours}, published {errors:?}, the old map {untouched}");
}
