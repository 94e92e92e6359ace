//! A building of rooms that are all alike, with a lamp in each, and doors between neighbours.

use glam::Vec3;
use rebake_core::Edit;
use rebake_core::scene::{Material, Mesh, Object, Scene};

/// Sides of a room, m; storeys have no gap between them but that of floor and ceiling.
const ROOM: Vec3 = Vec3::new(4.0, 3.0, 4.0);

/// Half the thickness of walls, m.
const WALL: f32 = 0.05;

/// Width and height of doors, m.
const DOOR: [f32; 2] = [1.0, 2.1];

/// How many rooms side by side, behind one another, and on top of one another.
pub(super) type Rooms = [usize; 3];

/// Name of the lamp of a room; its light has the same.
pub(super) fn lamp(room: Rooms) -> String {
    let [x, z, y] = room;
    format!("lamp {x} {z} {y}")
}

/// Every room of a building.
pub(super) fn rooms([across, deep, storeys]: Rooms) -> impl Iterator<Item = Rooms> {
    let floor = move |y| (0..deep).flat_map(move |z| (0..across).map(move |x| [x, z, y]));
    (0..storeys).flat_map(floor)
}

/// Lowest corner of a room.
pub(super) fn corner([x, z, y]: Rooms) -> Vec3 {
    ROOM * Vec3::new(x as f32, y as f32, z as f32)
}

/// The building. Lamps of even rooms are warm, the others cold.
pub(super) fn building(size: Rooms) -> Scene {
    let [across, deep, storeys] = size;
    let mut objects: Vec<Object> = rooms(size).flat_map(room).collect();
    for storey in 0..storeys {
        for line in 0..=across {
            for k in 0..deep {
                let has_door = line > 0 && line < across;
                objects.extend(wall([line, k, storey], Vec3::X, Vec3::Z, has_door));
            }
        }
        for line in 0..=deep {
            for k in 0..across {
                let has_door = line > 0 && line < deep;
                objects.extend(wall([k, line, storey], Vec3::Z, Vec3::X, has_door));
            }
        }
    }
    Scene::from_objects(objects)
}

fn white() -> Material {
    Material::diffuse(Vec3::splat(0.7))
}

/// What stands in a room, and what is above and below it.
fn room(room: Rooms) -> Vec<Object> {
    let ([x, z, y], low) = (room, corner(room));
    let at = |x: f32, y: f32, z: f32| low + Vec3::new(x, y, z);
    let light = if (x + z + y).is_multiple_of(2) { Vec3::new(9.0, 7.0, 4.0) } else { Vec3::new(4.0, 6.0, 9.0) };
    let lamp_mesh = Mesh::quad(at(1.75, 2.6, 1.75), Vec3::X * 0.5, Vec3::Z * 0.5);
    let brown = Material::diffuse(Vec3::new(0.5, 0.35, 0.2));
    vec![
        Object::new(format!("floor {x} {z} {y}"), Mesh::quad(low, Vec3::Z * ROOM.z, Vec3::X * ROOM.x), white()),
        Object::new(
            format!("ceiling {x} {z} {y}"),
            Mesh::quad(at(0.0, 2.8, 0.0), Vec3::X * ROOM.x, Vec3::Z * ROOM.z),
            white(),
        ),
        Object::new(format!("table {x} {z} {y}"), Mesh::cuboid(at(0.6, 0.0, 0.7), at(1.4, 0.7, 1.3)), brown),
        Object::new(lamp(room), lamp_mesh, Material::emissive(light)),
    ]
}

/// A wall at a line of the grid, from its corner along one direction and thick along another.
fn wall(place: Rooms, thick: Vec3, along: Vec3, has_door: bool) -> Vec<Object> {
    let [x, z, y] = place;
    let low = corner(place);
    let piece = |name: &str, from: f32, to: f32, bottom: f32| {
        let [a, b] = [low + along * from + Vec3::Y * bottom, low + along * to + Vec3::Y * ROOM.y];
        let name = format!("{name} {x} {z} {y} along {}", if along == Vec3::X { "x" } else { "z" });
        Object::new(name, Mesh::cuboid(a - thick * WALL, b + thick * WALL), white())
    };
    let (middle, [width, height]) = (ROOM.x / 2.0, DOOR);
    let upright = |name: &str, from: f32, to: f32| piece(name, from, to, 0.0);
    if !has_door {
        return vec![upright("wall", 0.0, ROOM.x)];
    }
    vec![
        upright("wall before", 0.0, middle - width / 2.0),
        upright("wall behind", middle + width / 2.0, ROOM.x),
        piece("lintel", middle - width / 2.0, middle + width / 2.0, height),
    ]
}

/// A layer for every lamp.
pub(super) fn each_lamp(scene: &Scene) -> Vec<Edit> {
    let group = |name: &String| Edit::GroupLights { group: Some(name.clone()), lights: vec![name.clone()] };
    scene.lights.iter().map(|light| group(&light.name)).collect()
}
