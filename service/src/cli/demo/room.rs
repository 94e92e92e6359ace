//! The demo's room, made in code: closed, 5 × 2.8 × 4 m, two lamps, a table, a sofa, a cupboard, a ball, and a chair
//! to put into it.

use glam::{DMat3, DMat4, DQuat, DVec3, Vec3};
use rebake_core::scene::{Camera, Material, Mesh, Object, Scene};

/// Width, height, depth in metres. The room's floor is y = 0, its corner the origin.
const SIZE: Vec3 = Vec3::new(5.0, 2.8, 4.0);

/// Spacing that gives about 60,000 elements.
pub(super) const SPACING: f32 = 0.075;
/// Name of the light that the demo turns down.
pub(super) const LAMP: &str = "ceiling-lamp";
/// Its intensity at upload: radiance of its strongest colour.
pub(super) const LAMP_INTENSITY: f32 = 14.0;
/// Name of the object that the demo takes out.
pub(super) const SOFA: &str = "sofa";

/// The furnished room.
pub(super) fn room() -> Scene {
    let (x, y, z) = (Vec3::X * SIZE.x, Vec3::Y * SIZE.y, Vec3::Z * SIZE.z);
    let white = Vec3::splat(0.75);
    // The ceiling lamp hangs 2 cm below the ceiling and shines down; the other sits on the right wall.
    let ceiling_lamp = Mesh::quad(Vec3::new(1.9, SIZE.y - 0.02, 1.6), Vec3::X * 1.2, Vec3::Z * 0.7);
    let wall_lamp = Mesh::quad(Vec3::new(SIZE.x - 0.02, 1.5, 2.9), Vec3::Z * 0.4, Vec3::Y * 0.3);
    let ball = object("ball", Mesh::icosphere(0.22, 3), Vec3::new(0.78, 0.62, 0.18));
    let mut scene = Scene::from_objects(vec![
        // Each wall turns its front, the side that u × v points to, into the room.
        object("floor", Mesh::quad(Vec3::ZERO, z, x), Vec3::new(0.55, 0.42, 0.30)),
        object("ceiling", Mesh::quad(y, x, z), Vec3::splat(0.82)),
        object("wall-back", Mesh::quad(Vec3::ZERO, x, y), white),
        object("wall-front", Mesh::quad(z, y, x), white),
        object("wall-left", Mesh::quad(Vec3::ZERO, y, z), Vec3::new(0.68, 0.22, 0.16)),
        object("wall-right", Mesh::quad(x, z, y), Vec3::new(0.22, 0.45, 0.60)),
        object("table", table(), Vec3::new(0.45, 0.30, 0.18)),
        object(SOFA, sofa(), Vec3::new(0.30, 0.42, 0.34)),
        object("cupboard", cuboid(Vec3::new(0.02, 0.0, 1.3), Vec3::new(0.55, 1.9, 1.4)), Vec3::new(0.66, 0.58, 0.46)),
        ball.placed(DMat4::from_translation(DVec3::new(1.15, 0.22, 3.3))),
        Object::new(LAMP, ceiling_lamp, Material::emissive(Vec3::new(1.0, 0.88, 0.72) * LAMP_INTENSITY)),
        Object::new("wall-lamp", wall_lamp, Material::emissive(Vec3::new(0.75, 0.86, 1.0) * 10.0)),
    ]);
    scene.cameras.push(camera());
    scene
}

/// A chair of 45 × 90 × 45 cm that stands on its origin.
pub(super) fn chair() -> Scene {
    let mut mesh = cuboid(Vec3::new(-0.225, 0.43, -0.225), Vec3::new(0.45, 0.04, 0.45));
    join(&mut mesh, &cuboid(Vec3::new(-0.225, 0.47, -0.225), Vec3::new(0.45, 0.43, 0.04)));
    for (x, z) in [(-0.22, -0.22), (0.18, -0.22), (-0.22, 0.18), (0.18, 0.18)] {
        join(&mut mesh, &cuboid(Vec3::new(x, 0.0, z), Vec3::new(0.04, 0.43, 0.04)));
    }
    Scene::from_objects(vec![object("chair", mesh, Vec3::new(0.62, 0.18, 0.12))])
}

/// Where the demo puts the chair: beside the table, facing it.
pub(super) fn chair_place() -> DMat4 {
    DMat4::from_rotation_translation(DQuat::from_rotation_y(-1.9), DVec3::new(3.55, 0.0, 2.1))
}

fn table() -> Mesh {
    let mut mesh = cuboid(Vec3::new(1.7, 0.71, 1.5), Vec3::new(1.4, 0.04, 0.9));
    for (x, z) in [(1.74, 1.54), (3.0, 1.54), (1.74, 2.3), (3.0, 2.3)] {
        join(&mut mesh, &cuboid(Vec3::new(x, 0.0, z), Vec3::new(0.06, 0.71, 0.06)));
    }
    mesh
}

/// Seat, back and arms with a finger's width between them: boxes that do not share faces.
fn sofa() -> Mesh {
    let mut mesh = cuboid(Vec3::new(1.85, 0.0, 0.40), Vec3::new(1.70, 0.42, 0.62));
    join(&mut mesh, &cuboid(Vec3::new(1.62, 0.0, 0.14), Vec3::new(2.16, 0.85, 0.24)));
    join(&mut mesh, &cuboid(Vec3::new(1.62, 0.0, 0.40), Vec3::new(0.21, 0.60, 0.62)));
    join(&mut mesh, &cuboid(Vec3::new(3.57, 0.0, 0.40), Vec3::new(0.21, 0.60, 0.62)));
    mesh
}

/// From the corner beside the right-hand lamp across the room.
fn camera() -> Camera {
    let (eye, target) = (DVec3::new(4.7, 1.7, 3.75), DVec3::new(1.8, 0.8, 1.2));
    let backward = (eye - target).normalize();
    let right = DVec3::Y.cross(backward).normalize();
    let rotation = DMat3::from_cols(right, backward.cross(right), backward);
    Camera {
        name: "camera".to_owned(),
        world_from_camera: DMat4::from_mat3_translation(rotation, eye),
        fov_y: 60f32.to_radians(),
    }
}

fn object(name: &str, mesh: Mesh, albedo: Vec3) -> Object {
    Object::new(name, mesh, Material::diffuse(albedo))
}

/// A box from its lowest corner.
fn cuboid(low: Vec3, size: Vec3) -> Mesh {
    Mesh::cuboid(low, low + size)
}

/// Adds the triangles of `more`, which has normals as `mesh` has.
fn join(mesh: &mut Mesh, more: &Mesh) {
    let offset = mesh.positions.len() as u32;
    mesh.positions.extend_from_slice(&more.positions);
    mesh.normals.extend_from_slice(&more.normals);
    mesh.triangles.extend(more.triangles.iter().map(|triangle| triangle.map(|i| i + offset)));
    mesh.triangle_materials.extend_from_slice(&more.triangle_materials);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Signed volume: positive where the triangles face outward.
    fn volume(mesh: &Mesh) -> f32 {
        let corner = |i: u32| mesh.positions[i as usize];
        mesh.triangles.iter().map(|t| corner(t[0]).dot(corner(t[1]).cross(corner(t[2]))) / 6.0).sum()
    }

    #[test]
    fn the_walls_face_inward_and_close_the_room() {
        let mut walls = Mesh::default();
        for wall in room().objects.iter().take(6) {
            join(&mut walls, &wall.mesh);
        }
        assert!((volume(&walls) + SIZE.x * SIZE.y * SIZE.z).abs() < 1e-3, "{}", volume(&walls));
    }

    #[test]
    fn furniture_faces_outward_and_stands_on_the_floor() {
        let (room, chair) = (room(), chair());
        for object in room.objects[6..10].iter().chain(&chair.objects) {
            assert!(volume(&object.mesh) > 0.01, "{}", object.name);
            let place = object.world_from_object;
            let heights = object.mesh.positions.iter().map(|p| place.transform_point3(p.as_dvec3()).y);
            assert!(heights.fold(f64::MAX, f64::min).abs() < 0.005, "{}", object.name);
        }
    }

    #[test]
    fn lamps_shine_into_the_room() {
        let room = room();
        for light in &room.lights {
            let mesh = &room.objects.iter().find(|object| object.name == light.name).unwrap().mesh;
            let [a, b, c] = mesh.triangles[0].map(|i| mesh.positions[i as usize]);
            let inward = SIZE * 0.5 - a;
            assert!((b - a).cross(c - a).dot(inward) > 0.0, "{}", light.name);
        }
    }
}
