//! `cargo run --release --example path_points -- FOLDER [PATHS]`: a furnished room and its path-traced light at some
//! thousand elements, for an independent renderer to compare with (tests/mitsuba).
//!
//! Writes `scene.glb` and `points.f32`: per element little-endian f32 position, normal, direct, indirect (irradiance /
//! π, RGB), variance of their sum (RGB), 15 numbers.
#![allow(clippy::print_stdout)]

use std::error::Error;
use std::path::PathBuf;

use glam::{DMat4, DVec3, Vec3};
use rebake_core::export::write_scene_glb;
use rebake_core::scene::{Material, Mesh, Object, Scene};
use rebake_core::{Unobserved, World, WorldOptions};
use rebake_lab::path::path_trace;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("the folder to write to is missing")?);
    let paths: u32 = arguments.next().map_or(Ok(1024), |text| text.parse())?;
    std::fs::create_dir_all(&folder)?;
    let scene = furnished_room();
    std::fs::write(folder.join("scene.glb"), write_scene_glb(&scene)?)?;
    let world = World::new(scene, &WorldOptions { spacing: Some(0.12), ..WorldOptions::default() })?;
    let usable = |&i: &u32| world.areas()[i as usize] > 0.0 && world.is_valid(i as usize);
    let slots: Vec<u32> = (0..world.slots() as u32).filter(usable).step_by(3).collect();
    let (traced, rays) = path_trace(&world, &slots, paths, 1, &Unobserved)?;
    let mut bytes = Vec::with_capacity(slots.len() * 60);
    for (&slot, value) in slots.iter().zip(&traced) {
        let slot = slot as usize;
        let position = (world.positions()[slot].as_dvec3() + world.scene.origin).as_vec3();
        for part in [position, world.normals()[slot], value.direct, value.indirect, value.total_variance] {
            bytes.extend(part.to_array().into_iter().flat_map(f32::to_le_bytes));
        }
    }
    std::fs::write(folder.join("points.f32"), bytes)?;
    println!("{} elements, {paths} paths each, {rays} rays", slots.len());
    Ok(())
}

/// A closed room of 4 × 2.6 × 4 m: a large lamp, a small one, one that hangs near a wall, a table, a box, a ball.
fn furnished_room() -> Scene {
    let diffuse = |r, g, b| Material::diffuse(Vec3::new(r, g, b));
    let cuboid =
        |name: &str, low: Vec3, size: Vec3, material| Object::new(name, Mesh::cuboid(low, low + size), material);
    let wood = diffuse(0.5, 0.35, 0.2);
    let mut objects = vec![
        Object::new("walls", Mesh::cuboid(Vec3::ZERO, Vec3::new(4.0, 2.6, 4.0)).inside_out(), diffuse(0.75, 0.72, 0.7)),
        Object::new(
            "large lamp",
            Mesh::quad(Vec3::new(1.0, 2.55, 1.0), Vec3::X * 1.5, Vec3::Z * 1.5),
            Material::emissive(Vec3::new(4.0, 3.6, 3.2)),
        ),
        Object::new(
            "small lamp",
            Mesh::quad(Vec3::new(3.2, 2.0, 3.2), Vec3::X * 0.05, Vec3::Z * 0.05),
            Material::emissive(Vec3::splat(400.0)),
        ),
        Object::new(
            "panel",
            Mesh::quad(Vec3::new(0.04, 0.5, 2.8), Vec3::Y * 0.8, Vec3::Z * 0.6),
            Material::emissive(Vec3::new(0.5, 0.8, 1.5)),
        ),
        cuboid("table top", Vec3::new(1.2, 0.7, 1.0), Vec3::new(1.4, 0.04, 0.8), wood),
        cuboid("box", Vec3::new(2.6, 0.0, 0.5), Vec3::new(0.7, 0.9, 0.7), diffuse(0.15, 0.45, 0.7)),
        Object::new("ball", Mesh::icosphere(0.35, 3), diffuse(0.8, 0.2, 0.15))
            .placed(DMat4::from_translation(DVec3::new(0.9, 0.5, 3.0))),
    ];
    for (k, (x, z)) in [(1.22, 1.02), (2.52, 1.02), (1.22, 1.72), (2.52, 1.72)].into_iter().enumerate() {
        objects.push(cuboid(&format!("leg {k}"), Vec3::new(x, 0.0, z), Vec3::new(0.06, 0.7, 0.06), wood));
    }
    Scene::from_objects(objects)
}
