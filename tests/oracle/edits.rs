//! Every edit kind against a full bake of the edited scene.

use std::sync::Arc;

use glam::{DMat4, DVec3, Vec3};
use rebake_core::scene::{LightKind, Material, Mesh, Object, Scene};
use rebake_core::{Budget, Edit, LightMap, Relight, Unobserved, World, bake, update};

use super::scenes::{crate_at, room_objects, world};
use super::statistics::{area_mean, assert_agrees, replicate};

const REPLICATES: u64 = 8;

fn budget(samples: u32) -> Budget {
    Budget { samples_per_element: samples, target_rmse: None }
}

/// Bias that an update may have against a bake, over everything and within 0.8 m of the edit, where
/// the rooms of these tests have an element every 15 cm only.
const BIAS: [f64; 2] = [3e-3, 15e-3];

/// Compares the update with a bake of the edited world: over everything, over the object, near it, and channel by
/// channel, direct and indirect apart.
pub(super) fn check(name: &str, before: &World, edits: &[Edit], near: Vec3) {
    check_within(BIAS, name, before, edits, near);
}

fn check_within(bias: [f64; 2], name: &str, before: &World, edits: &[Edit], near: Vec3) {
    let transition = before.apply(edits).unwrap_or_else(|e| panic!("{name}: {e}"));
    let after = &transition.after;
    let baked: Vec<Arc<LightMap>> =
        (0..4).map(|seed| bake(after, &budget(256), 900 + seed, &Unobserved).expect("nobody cancels")).collect();
    let updated: Vec<Arc<LightMap>> = (0..REPLICATES)
        .map(|seed| {
            let old = bake(before, &budget(64), 50 + seed, &Unobserved).expect("nobody cancels");
            update(&transition, &old, &budget(16), None, seed, &Unobserved).expect("nobody cancels")
        })
        .collect();
    type Pick = (&'static str, fn(&LightMap, usize) -> Vec3);
    let parts: [Pick; 2] = [("direct", |m, i| m.light.direct[i]), ("indirect", |m, i| m.light.indirect[i])];
    let close = |i: usize| after.positions()[i].distance(near) < 0.8;
    for (part, value) in parts {
        for (region, inside) in [("everywhere", false), ("near the edit", true)] {
            let bias = bias[usize::from(inside)];
            let mean = |map: &LightMap| area_mean(after, |i| !inside || close(i), |i| value(map, i).as_dvec3());
            let truth = baked.iter().map(|m| mean(m)).sum::<f64>() / baked.len() as f64;
            if truth < 1e-3 {
                continue;
            }
            let estimate = replicate(REPLICATES, |seed| mean(&updated[seed as usize]));
            // The bakes' own error, from their scatter, counts too.
            let scatter = replicate(baked.len() as u64, |i| mean(&baked[i as usize])).error;
            assert_agrees(&format!("{name}, {part} {region}"), estimate, truth, bias * truth + 5.0 * scatter);
        }
    }
}

fn room() -> World {
    world(room_objects(0.7), 0.15)
}

fn room_with_crate() -> World {
    let mut objects = room_objects(0.7);
    objects.push(crate_at("crate", 2.2, 1.9, Vec3::new(0.2, 0.5, 0.7)));
    world(objects, 0.15)
}

fn place(x: f64, z: f64) -> DMat4 {
    DMat4::from_translation(DVec3::new(x, 0.0, z))
}

#[test]
fn insert() {
    let asset = Arc::new(Scene::from_objects(vec![crate_at("c", 0.0, 0.0, Vec3::new(0.2, 0.5, 0.7))]));
    let edit = Edit::Insert { asset, name: "crate".into(), transform: place(2.2, 1.9) };
    check("insert", &room(), &[edit], Vec3::new(2.2, 0.3, 1.9));
}

#[test]
fn insert_a_sheet_and_a_lamp() {
    let sheet = Material::diffuse(Vec3::splat(0.6)).double_sided();
    let screen = Object::new("screen", Mesh::quad(Vec3::new(-0.5, 0.3, 0.0), Vec3::X, Vec3::Y), sheet);
    let edit = |object: Object, name: &str| Edit::Insert {
        asset: Arc::new(Scene::from_objects(vec![object])),
        name: name.into(),
        transform: place(1.9, 2.0),
    };
    check("insert a sheet", &room(), &[edit(screen, "screen")], Vec3::new(1.9, 0.8, 2.0));
    let bulb = Material { emission: Vec3::splat(4.0), ..Material::diffuse(Vec3::splat(0.5)) };
    let cube = Object::new("cube", Mesh::cuboid(Vec3::new(-0.1, 0.5, -0.1), Vec3::new(0.1, 0.7, 0.1)), bulb);
    check("insert a lamp", &room(), &[edit(cube, "bulb")], Vec3::new(1.9, 0.5, 2.0));
}

#[test]
fn remove() {
    let edit = Edit::Remove { objects: vec!["crate".into()] };
    check("remove", &room_with_crate(), &[edit], Vec3::new(2.2, 0.3, 1.9));
}

#[test]
fn move_and_turn() {
    let edit = Edit::Move { object: "crate".into(), transform: place(2.0, 0.9) * DMat4::from_rotation_y(0.5) };
    check("move", &room_with_crate(), &[edit], Vec3::new(2.0, 0.3, 0.9));
    let edit = Edit::Move {
        object: "crate".into(),
        transform: place(2.2, 1.9) * DMat4::from_scale(DVec3::new(0.5, 2.0, 0.5)),
    };
    check("scale", &room_with_crate(), &[edit], Vec3::new(2.2, 0.6, 1.9));
}

#[test]
fn repaint() {
    let edit = |object: &str, albedo| Edit::Material { object: object.into(), albedo };
    check("repaint a wall", &room(), &[edit("left", Vec3::splat(0.7))], Vec3::new(0.2, 1.0, 1.5));
    check("blacken a wall", &room(), &[edit("right", Vec3::ZERO)], Vec3::new(2.8, 1.0, 1.5));
}

#[test]
fn relight_and_lights_that_come_go_and_move() {
    let relight = Edit::Relight {
        lights: vec![Relight { light: "lamp".into(), color: Some(Vec3::new(0.2, 0.5, 1.0)), intensity: Some(5.0) }],
    };
    check("relight", &room(), &[relight], Vec3::new(1.5, 0.2, 1.5));
    let point = |x| LightKind::Point { position: DVec3::new(x, 1.5, 2.0), range: None };
    let insert = Edit::InsertLight { name: "bulb".into(), kind: point(2.0), color: Vec3::ONE, intensity: 3.0 };
    check("insert a light", &room(), std::slice::from_ref(&insert), Vec3::new(2.0, 0.3, 2.0));
    let lit = room().apply(&[insert]).expect("a light").after;
    let moved = Edit::MoveLight {
        light: "bulb".into(),
        position: Some(DVec3::new(0.8, 1.4, 2.3)),
        direction: None,
        own_layer: false,
    };
    check("move a light", &lit, &[moved], Vec3::new(0.8, 0.3, 2.3));
    check("remove a light", &lit, &[Edit::RemoveLight { light: "bulb".into() }], Vec3::new(2.0, 0.3, 2.0));
    let sky = Edit::InsertLight { name: "sky".into(), kind: LightKind::Environment, color: Vec3::ONE, intensity: 0.5 };
    let open = world(room_objects(0.7).into_iter().filter(|o| o.name != "right").collect(), 0.15);
    check("a sky", &open, std::slice::from_ref(&sky), Vec3::new(2.8, 0.3, 1.5));
    let under_sky = open.apply(&[sky]).expect("a sky").after;
    let asset = Arc::new(Scene::from_objects(vec![crate_at("c", 0.0, 0.0, Vec3::splat(0.4))]));
    let edit = Edit::Insert { asset, name: "crate".into(), transform: place(2.5, 1.9) };
    check("insert under a sky", &under_sky, &[edit], Vec3::new(2.5, 0.3, 1.9));
}

/// Elements between which direct light changes much are too few to look its change up; a bake does not look it up either.
#[test]
fn a_light_close_to_coarse_surfaces() {
    let coarse = world(room_objects(0.7), 0.5);
    let point = |height| LightKind::Point { position: DVec3::new(0.8, height, 0.8), range: None };
    let insert = Edit::InsertLight { name: "bulb".into(), kind: point(1.05), color: Vec3::ONE, intensity: 0.8 };
    let near = Vec3::new(0.8, 0.9, 0.8);
    let bias = [3e-3; 2];
    check_within(bias, "a light close to coarse surfaces", &coarse, std::slice::from_ref(&insert), near);
    let lit = coarse.apply(&[insert]).expect("a light").after;
    let moved = Edit::MoveLight {
        light: "bulb".into(),
        position: Some(DVec3::new(0.8, 1.2, 0.8)),
        direction: None,
        own_layer: false,
    };
    check_within(bias, "a light that moves close to them", &lit, &[moved], near);
}

#[test]
fn several_edits_in_one_request() {
    let asset = Arc::new(Scene::from_objects(vec![crate_at("c", 0.0, 0.0, Vec3::splat(0.8))]));
    let edits = [
        Edit::Remove { objects: vec!["block".into()] },
        Edit::Insert { asset, name: "other".into(), transform: place(0.8, 2.3) },
        Edit::Move { object: "crate".into(), transform: place(2.1, 0.8) },
        Edit::Material { object: "crate".into(), albedo: Vec3::new(0.7, 0.2, 0.2) },
        Edit::Material { object: "back".into(), albedo: Vec3::new(0.2, 0.6, 0.3) },
        Edit::Relight { lights: vec![Relight { light: "lamp".into(), color: None, intensity: Some(14.0) }] },
    ];
    check("six edits", &room_with_crate(), &edits, Vec3::new(1.5, 0.3, 1.5));
}

#[test]
fn objects_without_triangles_can_be_edited() {
    let mut objects = room_objects(0.7);
    objects.push(Object::new("glass", Mesh::default(), Material::diffuse(Vec3::ZERO)));
    let before = world(objects, 0.3);
    let old = bake(&before, &budget(16), 1, &Unobserved).expect("nobody cancels");
    let glass = before.objects().find(|o| o.name == "glass").expect("it is an object");
    assert!(glass.element_count == 0 && glass.bounds.0.is_finite() && glass.bounds.1.is_finite());
    let step = Edit::Move { object: "glass".into(), transform: DMat4::from_translation(DVec3::X) };
    let moved = before.apply(&[step]).expect("it moves");
    let removed = moved.after.apply(&[Edit::Remove { objects: vec!["glass".into()] }]).expect("it goes");
    for transition in [&moved, &removed] {
        let new = update(transition, &old, &budget(16), None, 2, &Unobserved).expect("nobody cancels");
        assert_eq!(new.light.direct, old.light.direct);
        assert_eq!(new.light.indirect, old.light.indirect);
    }
}

#[test]
fn lights_that_all_change_alike_need_no_ray() {
    struct Rays(std::sync::atomic::AtomicU64);
    impl rebake_core::Observer for Rays {
        fn snapshot(&self, _: &Arc<LightMap>, _: rebake_core::Snapshot, progress: &rebake_core::Progress) {
            self.0.store(progress.rays, std::sync::atomic::Ordering::Relaxed);
        }
    }
    let before = world(room_objects(0.7), 0.3);
    let old = bake(&before, &budget(16), 1, &Unobserved).expect("nobody cancels");
    let lamp = before.lights().next().expect("a lamp").light.clone();
    let color = Some(lamp.color * Vec3::new(0.5, 2.0, 0.0));
    let dim = Edit::Relight { lights: vec![Relight { light: lamp.name, color, intensity: None }] };
    let transition = before.apply(&[dim]).expect("a relight");
    let rays = Rays(std::sync::atomic::AtomicU64::new(1));
    let new = update(&transition, &old, &budget(16), None, 2, &rays).expect("nobody cancels");
    assert_eq!(rays.0.into_inner(), 0);
    for i in 0..old.len() {
        assert_eq!(new.light.direct[i], old.light.direct[i] * Vec3::new(0.5, 2.0, 0.0));
        assert_eq!(new.light.indirect[i], old.light.indirect[i] * Vec3::new(0.5, 2.0, 0.0));
    }
}
