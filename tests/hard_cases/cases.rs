//! The cases: a world and edits, the last of which is measured.

use std::sync::Arc;

use glam::{DMat4, DVec3, Vec3};
use rebake_core::scene::{Material, Mesh, Object, Scene};
use rebake_core::{Edit, World, WorldOptions};

use super::scenes::{crate_at, open_scene_objects, room_objects, world};

/// A world and edits, each a request of its own.
pub(super) struct HardCase {
    pub(super) name: String,
    pub(super) before: World,
    pub(super) edits: Vec<Vec<Edit>>,
}

/// All cases.
pub(super) fn all() -> Vec<HardCase> {
    let mut cases = bright_rooms();
    cases.extend(contacts());
    cases.extend(lamps());
    cases.extend(scales());
    cases.extend(meshes());
    cases.push(hundred_edits());
    cases
}

fn insert(object: Object) -> Vec<Edit> {
    let asset = Arc::new(Scene::from_objects(vec![object]));
    vec![Edit::Insert { asset, name: "thing".into(), transform: DMat4::IDENTITY }]
}

fn remove(name: &str) -> Vec<Edit> {
    vec![Edit::Remove { objects: vec![name.into()] }]
}

fn case(name: impl Into<String>, before: World, edit: Vec<Edit>) -> HardCase {
    HardCase { name: name.into(), before, edits: vec![edit] }
}

fn cube(low: Vec3, size: Vec3, albedo: f32) -> Object {
    Object::new("cube", Mesh::cuboid(low, low + size), Material::diffuse(Vec3::splat(albedo)))
}

/// The room without its block.
fn empty_room(albedo: f32) -> Vec<Object> {
    room_objects(albedo).into_iter().filter(|object| object.name != "block").collect()
}

fn dark_room() -> Vec<Object> {
    room_objects(0.7).into_iter().filter(|object| object.name != "lamp").collect()
}

fn bright_rooms() -> Vec<HardCase> {
    let mut cases = Vec::new();
    for (wall, thing) in [(0.9, 0.0), (0.9, 0.8), (0.95, 0.0), (0.99, 0.0), (0.99, 0.99)] {
        let room = world(empty_room(wall), 0.15);
        let object = cube(Vec3::new(0.45, 0.05, 0.45), Vec3::splat(1.6), thing);
        cases.push(case(format!("+ cube of {thing} in a room of {wall}"), room, insert(object)));
    }
    let filled = |wall: f32| {
        let mut objects = empty_room(wall);
        objects.push(cube(Vec3::new(0.45, 0.05, 0.45), Vec3::splat(1.6), 0.0));
        world(objects, 0.15)
    };
    cases.push(case("- cube of 0 in a room of 0.95", filled(0.95), remove("cube")));
    // A shell around all but the lamp, with its light coming in by the gap on top.
    let shell = Mesh::cuboid(Vec3::new(0.2, 0.02, 0.2), Vec3::new(2.8, 2.2, 2.8));
    let shell = Object::new("shell", shell, Material::diffuse(Vec3::splat(0.5)).double_sided());
    cases.push(case("+ shell around nearly everything", world(room_objects(0.7), 0.15), insert(shell)));
    cases
}

fn contacts() -> Vec<HardCase> {
    let room = || world(room_objects(0.7), 0.1);
    let sheet = Mesh::quad(Vec3::new(1.5, 0.0, 1.5), Vec3::Z, Vec3::X);
    let sheet = Object::new("sheet", sheet, Material::diffuse(Vec3::splat(0.2)).double_sided());
    // Thin and large: most elements of the room lie in the sphere around it.
    let frame = Mesh::cuboid(Vec3::new(0.1, 1.2, 0.1), Vec3::new(2.9, 1.23, 0.25));
    let frame = Object::new("shelf", frame, Material::diffuse(Vec3::splat(0.4)));
    vec![
        case(
            "+ cube on the floor against a wall",
            room(),
            insert(cube(Vec3::new(2.4, 0.0, 1.0), Vec3::splat(0.6), 0.6)),
        ),
        case("+ cube through a wall", room(), insert(cube(Vec3::new(2.6, 0.4, 1.0), Vec3::splat(0.7), 0.6))),
        case("+ cube over half of another", room(), insert(cube(Vec3::new(0.8, 0.3, 0.7), Vec3::splat(0.7), 0.6))),
        case("+ cube inside another", room(), insert(cube(Vec3::new(0.6, 0.2, 0.7), Vec3::splat(0.2), 0.6))),
        case("+ sheet in the plane of the floor", room(), insert(sheet)),
        case("+ thin shelf across the room", room(), insert(frame)),
    ]
}

fn lamps() -> Vec<HardCase> {
    let spark = Object::new(
        "spark",
        Mesh::quad(Vec3::new(1.5, 1.2, 1.5), Vec3::X * 1e-3, Vec3::Z * 1e-3),
        Material::emissive(Vec3::splat(1e6)),
    );
    let lit_by_spark = || {
        let mut objects = dark_room();
        objects.push(spark.clone());
        world(objects, 0.15)
    };
    let mut two_lamps = room_objects(0.7);
    two_lamps.push(spark.clone());
    let two_lamps = world(two_lamps, 0.15);
    let lantern =
        |low: Vec3, high: Vec3| Object::new("lantern", Mesh::cuboid(low, high), Material::diffuse(Vec3::splat(0.5)));
    let panel = Object::new(
        "panel",
        Mesh::quad(Vec3::new(0.5, 2.0, 0.5), Vec3::X * 1.5, Vec3::Z * 1.5),
        Material::emissive(Vec3::splat(4.0)),
    );
    let white = Material::diffuse(Vec3::splat(0.8)).double_sided();
    let wall = |name: &str, z: f32, depth: f32| {
        Object::new(name, Mesh::quad(Vec3::new(2.2, 0.0, z), Vec3::Z * depth, Vec3::Y * 2.4), white)
    };
    let mut slit = room_objects(0.8);
    slit.extend([wall("wall, near part", 0.0, 1.0), wall("wall, far part", 1.02, 1.98)]);
    vec![
        case("+ lamp of a square millimetre, no light before", world(dark_room(), 0.15), insert(spark.clone())),
        case("- the only lamp", world(room_objects(0.7), 0.15), remove("lamp")),
        case("+ lamp larger than the one there", world(room_objects(0.7), 0.15), insert(panel)),
        case(
            "+ box 5 cm below a lamp of a square millimetre",
            lit_by_spark(),
            insert(lantern(Vec3::new(1.3, 0.9, 1.3), Vec3::new(1.7, 1.15, 1.7))),
        ),
        case(
            "+ box around the brighter of two lamps",
            two_lamps,
            insert(cube(Vec3::new(1.4, 1.1, 1.4), Vec3::splat(0.2), 0.5)),
        ),
        case(
            "+ crate beside a slit of 2 cm",
            world(slit, 0.1),
            insert(cube(Vec3::new(1.6, 0.0, 1.6), Vec3::splat(0.5), 0.3)),
        ),
    ]
}

fn scales() -> Vec<HardCase> {
    [(1e-3, 0.0), (1e4, 0.0), (1.0, 1e4), (1e4, 1e6)]
        .into_iter()
        .map(|(scale, shift)| {
            let place = DMat4::from_translation(DVec3::splat(shift)) * DMat4::from_scale(DVec3::splat(scale));
            let placed = |object: Object| {
                let place = place * object.world_from_object;
                object.placed(place)
            };
            let mut scene = Scene::from_objects(room_objects(0.7).into_iter().map(placed).collect());
            scene.origin = DVec3::splat(shift) + DVec3::splat(1.5 * scale);
            let options =
                WorldOptions { spacing: Some(0.15 * scale as f32), max_albedo: 1.0, ..WorldOptions::default() };
            let before = World::new(scene, &options).expect("a scaled room");
            let thing = crate_at("crate", 2.2, 1.9, Vec3::splat(0.3));
            let asset = Arc::new(Scene::from_objects(vec![thing]));
            let edit = vec![Edit::Insert { asset, name: "thing".into(), transform: place }];
            case(format!("+ crate, scale {scale:e}, {shift:e} m away"), before, edit)
        })
        .collect()
}

fn meshes() -> Vec<HardCase> {
    let open = world(open_scene_objects(), 0.1);
    let sphere = |level| {
        Object::new("sphere", Mesh::icosphere(0.4, level), Material::diffuse(Vec3::splat(0.5)))
            .placed(DMat4::from_translation(DVec3::new(2.1, 0.5, 2.0)))
    };
    vec![
        case(
            "+ cube in an open scene, doubled triangles",
            open,
            insert(cube(Vec3::new(0.9, 0.0, 0.9), Vec3::splat(0.5), 0.4)),
        ),
        case("+ sphere of 327,680 triangles", world(room_objects(0.7), 0.15), insert(sphere(7))),
        case("+ sphere of 1,310,720 triangles", world(room_objects(0.7), 0.15), insert(sphere(8))),
    ]
}

/// Fifty times a crate comes and goes; the last time it goes is measured.
fn hundred_edits() -> HardCase {
    let asset = Arc::new(Scene::from_objects(vec![crate_at("c", 0.0, 0.0, Vec3::splat(0.3))]));
    let transform = DMat4::from_translation(DVec3::new(2.2, 0.0, 1.9));
    let come = Edit::Insert { asset, name: "crate".into(), transform };
    let pair = [vec![come], remove("crate")];
    let edits = (0..50).flat_map(|_| pair.clone()).collect();
    HardCase { name: "- crate, for the fiftieth time".into(), before: world(room_objects(0.7), 0.15), edits }
}
