//! Skins and morph targets.

use glam::{DVec3, Vec3};

use super::*;

/// The square as a skin of two joints: node 1 (turned by a quarter about x) and node 2 below it. Joints and weights are
/// added to the data: the first two vertices follow joint 0, the others joint 1.
fn skinned(edits: &[(&str, &str)]) -> Vec<u8> {
    let mut bin = square_data();
    let joints = [[0_u8, 0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0]];
    bin.extend(joints.iter().flatten());
    bin.extend([[255_u8, 0, 0, 0]; 4].iter().flatten());
    let mut json = SQUARE
        .replace("\"meshes\"", "\"skins\": [{\"joints\": [1, 2]}], \"meshes\"")
        .replace("\"NORMAL\": 1}", "\"NORMAL\": 1, \"JOINTS_0\": 3, \"WEIGHTS_0\": 4}")
        .replace("\"name\": \"Wall\", \"mesh\": 0,", "\"name\": \"Wall\", \"mesh\": 0, \"skin\": 0,")
        .replace(
            "\"name\": \"Camera\", \"camera\": 0",
            "\"name\": \"Camera\", \"camera\": 0, \"translation\": [0, 0, 10]",
        )
        .replace(
            "\"type\": \"SCALAR\"}",
            "\"type\": \"SCALAR\"}, {\"bufferView\": 5, \"componentType\": 5121, \"count\": 4, \"type\": \"VEC4\"}, \
             {\"bufferView\": 5, \"byteOffset\": 16, \"normalized\": true, \"componentType\": 5121, \"count\": 4, \
             \"type\": \"VEC4\"}",
        )
        .replace("\"byteLength\": 16}", "\"byteLength\": 16}, {\"buffer\": 0, \"byteOffset\": 128, \"byteLength\": 32}")
        .replace("[{\"byteLength\": 128}]", "[{\"byteLength\": 160}]");
    for (from, to) in edits {
        assert!(json.contains(from), "{from}");
        json = json.replace(from, to);
    }
    glb(&json, &bin)
}

/// Joints put the vertices where they are, wherever the node stands.
#[test]
fn skinned_meshes_stand_where_their_joints_put_them() {
    for edits in [&[][..], &[("\"scale\": [2, 2, 2]", "\"scale\": [100, 100, 7]")]] {
        let scene = load(&skinned(edits)).unwrap();
        let object = &scene.objects[0];
        // A quarter about x takes y to z and z to −y; the second joint lies 10 further along its z.
        let right = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, -10.0, 1.0], [0.0, -10.0, 1.0]];
        for (position, right) in object.mesh.positions.iter().zip(right) {
            let world = object.world_from_object.transform_point3(position.as_dvec3());
            assert!(world.distance(DVec3::from_array(right)) < 1e-4, "{world} {right:?}");
        }
        let normal =
            glam::DMat3::from_mat4(object.world_from_object).inverse().transpose() * object.mesh.normals[2].as_dvec3();
        assert!(normal.normalize().distance(DVec3::NEG_Y) < 1e-4, "{normal}");
    }
}

#[test]
fn bad_skins_are_refused_or_ignored() {
    for (from, to, words) in [
        ("{\"joints\": [1, 2]}", "{\"joints\": [1]}", "joint 1 is out of range"),
        ("{\"joints\": [1, 2]}", "{\"joints\": [1, 2], \"inverseBindMatrices\": 0}", "Vec3"),
        ("{\"joints\": [1, 2]}", "{\"joints\": [1, 20]}", "joints"),
    ] {
        let error = load(&skinned(&[(from, to)])).unwrap_err();
        assert!(matches!(&error, LoadError::Malformed(text) if text.contains(words)), "{error}");
    }
    let outside = load(&skinned(&[("\"nodes\": [0, 1]", "\"nodes\": [0]")])).unwrap();
    assert!(outside.warnings.iter().any(|text| text.contains("outside the scene")), "{:?}", outside.warnings);
    assert_eq!(outside.objects[0].mesh.positions[2], Vec3::new(1.0, 1.0, 0.0));
}

/// The node's weights come before the mesh's; without any, nothing moves.
#[test]
fn morph_targets_move_by_their_weights() {
    let targets = "\"mode\": 4, \"targets\": [{\"POSITION\": 1}, {\"POSITION\": 0, \"NORMAL\": 0}]";
    let of_mesh = "\"weights\": [0.5, 0], \"primitives\"";
    let of_node = "\"name\": \"Wall\", \"weights\": [0, 2],";
    let third = |edits: &[(&str, &str)]| load(&edited(edits)).unwrap().objects[0].mesh.positions[2];
    assert_eq!(third(&[("\"mode\": 4", targets)]), Vec3::new(1.0, 1.0, 0.0));
    assert_eq!(third(&[("\"mode\": 4", targets), ("\"primitives\"", of_mesh)]), Vec3::new(1.0, 1.0, 0.5));
    let both = [("\"mode\": 4", targets), ("\"primitives\"", of_mesh), ("\"name\": \"Wall\",", of_node)];
    assert_eq!(third(&both), Vec3::new(3.0, 3.0, 0.0));
    let few =
        [("\"mode\": 4", targets.replace("\"POSITION\": 1", "\"POSITION\": 2")), ("\"primitives\"", of_mesh.into())];
    assert!(load(&edited(&few.each_ref().map(|(from, to)| (*from, to.as_str())))).is_err());
}
