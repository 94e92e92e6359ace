//! What is read, and how.

use glam::{DVec3, Vec3};

use super::*;
use crate::scene::LightKind;

fn load_edited(replacements: &[(&str, &str)]) -> Scene {
    load(&edited(replacements)).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn objects_lights_and_cameras_are_read() {
    let scene = load_edited(&[]);
    assert_eq!((scene.objects.len(), scene.lights.len(), scene.cameras.len()), (1, 2, 1));
    assert_eq!(scene.warnings, Vec::<String>::new());
    let wall = &scene.objects[0];
    assert_eq!((wall.name.as_str(), wall.mesh.triangles.as_slice()), ("Wall", [[0, 1, 2], [0, 2, 3]].as_slice()));
    assert_eq!(wall.world_from_object.transform_point3(DVec3::ONE), DVec3::new(3.0, 4.0, 5.0));
    let paint = wall.materials[0];
    assert_eq!((paint.albedo, paint.double_sided), (Vec3::new(0.5, 0.25, 0.125), true));
    assert_eq!(paint.emission, Vec3::new(3.0, 1.5, 0.0));
    let glow = &scene.lights[0];
    assert_eq!((glow.name.as_str(), glow.color, glow.intensity), ("Wall", Vec3::new(1.0, 0.5, 0.0), 3.0));
    assert_eq!(glow.kind, LightKind::Emissive { object: "Wall".into(), material: 0 });
}

/// The rig turns by a quarter about x: what points to −z then points to +y, and +y to +z.
#[test]
fn punctual_lights_and_cameras_follow_their_nodes() {
    let scene = load_edited(&[]);
    let lamp = &scene.lights[1];
    let LightKind::Spot { position, direction, inner_cone_angle, outer_cone_angle, range } = lamp.kind else {
        panic!("{lamp:?}");
    };
    assert!(position.distance(DVec3::Z) < 1e-6 && direction.distance(Vec3::Y) < 1e-6, "{lamp:?}");
    assert_eq!((inner_cone_angle, outer_cone_angle, range), (0.25, 0.5, Some(8.0)));
    assert_eq!((lamp.name.as_str(), lamp.strength()), ("Lamp", Vec3::new(40.0, 20.0, 10.0)));
    let camera = &scene.cameras[0];
    let forward = camera.world_from_camera.transform_vector3(DVec3::NEG_Z);
    assert!(forward.distance(DVec3::Y) < 1e-6 && camera.fov_y == 0.75);
}

#[test]
fn strips_fans_and_other_indices_give_the_same_square() {
    let square = |scene: &Scene| {
        let mesh = &scene.objects[0].mesh;
        let corner = |i: u32| mesh.positions[i as usize];
        let normal = |&[a, b, c]: &[u32; 3]| (corner(b) - corner(a)).cross(corner(c) - corner(a));
        // Both triangles face +z and have half the square's area.
        mesh.triangles.len() == 2 && mesh.triangles.iter().all(|t| normal(t) == Vec3::Z)
    };
    let indices = "\"bufferView\": 2, \"componentType\": 5123, \"count\": 6";
    assert!(square(&load_edited(&[])));
    // 0 1 2 0 2 3 as a fan: its second and third triangle have no area.
    let fan = load_edited(&[("\"mode\": 4", "\"mode\": 6")]);
    assert!(square(&fan) && fan.degenerate_triangles == 2, "{fan:?}");
    // Without indices: a fan over the four vertices.
    assert!(square(&load_edited(&[("\"mode\": 4", "\"mode\": 6"), ("\"indices\": 2, ", "")])));
    let strip = load_edited(&[("\"mode\": 4", "\"mode\": 5"), ("\"count\": 6", "\"count\": 3")]);
    assert_eq!(strip.objects[0].mesh.triangles, [[0, 1, 2]]);
    let bytes = load_edited(&[(indices, "\"bufferView\": 3, \"componentType\": 5121, \"count\": 3")]);
    assert_eq!(bytes.objects[0].mesh.triangles, [[0, 1, 2]]);
}

/// The order of corners alternates along a strip.
#[test]
fn strips_keep_their_orientation() {
    let mut bin = square_data();
    for (slot, index) in [0_u16, 1, 3, 2, 2, 2].into_iter().enumerate() {
        bin[96 + slot * 2..][..2].copy_from_slice(&index.to_le_bytes());
    }
    let json = SQUARE.replace("\"mode\": 4", "\"mode\": 5").replace("\"count\": 6", "\"count\": 4");
    let scene = load(&glb(&json, &bin)).unwrap();
    assert_eq!(scene.objects[0].mesh.triangles, [[0, 1, 3], [1, 2, 3]]);
}

#[test]
fn sparse_and_quantised_positions_are_read() {
    let sparse = "\"count\": 4, \"sparse\": {\"count\": 1, \"indices\": {\"bufferView\": 4, \"componentType\": 5125}, \
                  \"values\": {\"bufferView\": 4, \"byteOffset\": 4}}, \"type\": \"VEC3\", \"min\"";
    let scene = load_edited(&[("\"count\": 4, \"type\": \"VEC3\", \"min\"", sparse)]);
    assert_eq!(scene.objects[0].mesh.positions[2], Vec3::new(3.0, 3.0, 0.0));
    // Signed bytes in steps of four, normalised: 1.0 is 127.
    let mut bin = square_data();
    for (slot, corner) in [[0, 0, 0], [127, 0, 0], [127, 127, 0], [0, 127, 0_u8]].into_iter().enumerate() {
        bin[slot * 4..][..3].copy_from_slice(&corner);
    }
    let json = SQUARE
        .replace(
            "\"byteLength\": 48},\n    {\"buffer\": 0, \"byteOffset\": 48",
            "\"byteLength\": 16, \"byteStride\": 4},\n    {\"buffer\": 0, \"byteOffset\": 48",
        )
        .replace(
            "\"bufferView\": 0, \"componentType\": 5126",
            "\"bufferView\": 0, \"normalized\": true, \"componentType\": 5120",
        )
        .replace(
            "\"extensionsUsed\": [",
            "\"extensionsRequired\": [\"KHR_mesh_quantization\"], \"extensionsUsed\": [\"KHR_mesh_quantization\", ",
        );
    let scene = load(&glb(&json, &bin)).unwrap();
    assert_eq!(scene.objects[0].mesh.positions[2], Vec3::new(1.0, 1.0, 0.0));
}

#[test]
fn absent_normals_and_bounds_are_no_fault() {
    let scene = load_edited(&[
        ("\"POSITION\": 0, \"NORMAL\": 1", "\"POSITION\": 0"),
        (", \"min\": [0, 0, 0], \"max\": [1, 1, 0]", ""),
    ]);
    assert!(scene.objects[0].mesh.normals.is_empty());
}

#[test]
fn names_are_made_unique_with_a_warning() {
    let twins = [
        ("\"name\": \"Rig\"", "\"name\": \"Wall\", \"mesh\": 0"),
        ("\"name\": \"Camera\"", "\"mesh\": 0"),
        ("\"name\": \"Lamp\"", "\"name\": \"environment\""),
    ];
    let scene = load_edited(&twins);
    let names: Vec<&str> = scene.objects.iter().map(|object| object.name.as_str()).collect();
    // The third has no name of its own, but its mesh has.
    assert_eq!(names, ["Wall", "Wall-2", "Square"]);
    let lights: Vec<&str> = scene.lights.iter().map(|light| light.name.as_str()).collect();
    assert_eq!(lights, ["Wall", "Wall-2", "Square", "environment-2"]);
    assert_eq!(scene.warnings.len(), 2, "{:?}", scene.warnings);
}

#[test]
fn what_is_ignored_is_said() {
    let scene = load_edited(&[
        ("\"metallicFactor\": 0", "\"metallicFactor\": 1"),
        ("\"extensionsUsed\": [", "\"extensionsUsed\": [\"KHR_materials_clearcoat\", \"VENDOR_x\", "),
        (
            "\"type\": \"perspective\", \"perspective\": {\"yfov\": 0.75, \"znear\": 0.1}",
            "\"type\": \"orthographic\", \"orthographic\": {\"xmag\": 1, \"ymag\": 1, \"zfar\": 9, \"znear\": 0.1}",
        ),
    ]);
    let all = scene.warnings.join("\n");
    for words in ["KHR_materials_clearcoat", "VENDOR_x", "metallic", "orthographic"] {
        assert!(all.contains(words), "{words}: {all}");
    }
    assert!(scene.cameras.is_empty());
}

/// Scene space is the world's where that is near, and centred where it is not.
#[test]
fn origin_follows_scenes_that_are_far_away() {
    assert_eq!(load_edited(&[]).origin, DVec3::ZERO);
    let scene = load_edited(&[("\"translation\": [1, 2, 3]", "\"translation\": [16777216, 0, -5000.1]")]);
    let centre = DVec3::new(16_777_217.0, 1.0, -5000.1);
    assert!((scene.origin - centre).abs().max_element() < 1.0, "{}", scene.origin);
    assert_eq!(scene.origin, (scene.origin * 8.0).round() / 8.0);
}

#[test]
fn degenerate_triangles_are_dropped_and_counted() {
    let mut bin = square_data();
    // Second triangle: corners 0 2 2.
    bin[106..108].copy_from_slice(&2_u16.to_le_bytes());
    let scene = load(&glb(SQUARE, &bin)).unwrap();
    assert_eq!((scene.objects[0].mesh.triangles.len(), scene.degenerate_triangles), (1, 1));
}

/// A mesh shown twice, and two primitives over one vertex list, are each stored once.
#[test]
fn shared_data_is_shared() {
    let primitive = "{\"attributes\": {\"POSITION\": 0, \"NORMAL\": 1}, \"indices\": 2, \"material\": 0, \"mode\": 4}";
    let twice = format!("{primitive}, {}", primitive.replace("\"material\": 0, ", ""));
    let scene = load_edited(&[(primitive, &twice), ("\"name\": \"Rig\"", "\"name\": \"Other\", \"mesh\": 0")]);
    assert!(std::sync::Arc::ptr_eq(&scene.objects[0].mesh, &scene.objects[1].mesh));
    let mesh = &scene.objects[0].mesh;
    assert_eq!((mesh.positions.len(), mesh.triangles.len(), mesh.triangle_materials[2]), (4, 4, 1));
    // The specification's default is white.
    assert_eq!(scene.objects[0].materials[1].albedo, Vec3::ONE);
}
