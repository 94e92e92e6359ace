//! Scenes that tests make in code.

use glam::{DMat4, DVec3, Vec3};
use rebake_core::scene::{Material, Mesh, Object, Scene};
use rebake_core::{World, WorldOptions};

/// A world of objects at a spacing.
pub(super) fn world(objects: Vec<Object>, spacing: f32) -> World {
    let options = WorldOptions { spacing: Some(spacing), max_albedo: 1.0, ..WorldOptions::default() };
    World::new(Scene::from_objects(objects), &options).expect("a test scene")
}

/// A closed room of 3 × 2.4 × 3 m with one coloured wall, a lamp below the ceiling and a block on the floor.
pub(super) fn room_objects(albedo: f32) -> Vec<Object> {
    let (x, y, z) = (Vec3::X * 3.0, Vec3::Y * 2.4, Vec3::Z * 3.0);
    let white = Material::diffuse(Vec3::splat(albedo));
    let red = Material::diffuse(Vec3::new(albedo, 0.3 * albedo, 0.2 * albedo));
    let wall = |name: &str, corner: Vec3, u: Vec3, v: Vec3, material: Material| {
        Object::new(name, Mesh::quad(corner, u, v), material)
    };
    vec![
        wall("floor", Vec3::ZERO, z, x, white),
        wall("ceiling", y, x, z, white),
        wall("back", Vec3::ZERO, x, y, white),
        wall("front", z, y, x, white),
        wall("left", Vec3::ZERO, y, z, red),
        wall("right", x, z, y, white),
        Object::new("block", Mesh::cuboid(Vec3::new(0.4, 0.0, 0.5), Vec3::new(1.2, 0.9, 1.1)), white),
        Object::new(
            "lamp",
            Mesh::quad(Vec3::new(1.1, 2.3, 1.1), Vec3::X * 0.8, Vec3::Z * 0.8),
            Material::emissive(Vec3::new(10.0, 9.0, 8.0)),
        ),
    ]
}

/// A box of 0.6 m that stands at (x, z).
pub(super) fn crate_at(name: &str, x: f32, z: f32, albedo: Vec3) -> Object {
    let mesh = Mesh::cuboid(Vec3::new(-0.3, 0.0, -0.3), Vec3::new(0.3, 0.6, 0.3));
    let place = DMat4::from_translation(DVec3::new(f64::from(x), 0.0, f64::from(z)));
    Object::new(name, mesh, Material::diffuse(albedo)).placed(place)
}

/// A floor whose triangles are there twice, with a degenerate one, a wall and a lamp, and nothing around them.
pub(super) fn open_scene_objects() -> Vec<Object> {
    let mut floor = Mesh::quad(Vec3::ZERO, Vec3::Z * 2.0, Vec3::X * 2.0);
    let (triangles, materials) = (floor.triangles.clone(), floor.triangle_materials.clone());
    floor.triangles.extend(&triangles);
    floor.triangle_materials.extend(&materials);
    floor.triangles.push([0, 0, 1]);
    floor.triangle_materials.push(0);
    let white = Material::diffuse(Vec3::splat(0.8));
    let wall = Object::new("wall", Mesh::quad(Vec3::ZERO, Vec3::X * 2.0, Vec3::Y * 2.0), white);
    let lamp = Object::new(
        "lamp",
        Mesh::quad(Vec3::new(0.5, 1.8, 0.5), Vec3::X * 0.5, Vec3::Z * 0.5),
        Material::emissive(Vec3::splat(5.0)),
    );
    vec![Object::new("floor", floor, white), wall, lamp]
}
