//! Small departures from the specification that exporters make, and what is made of them.

use std::f32::consts::FRAC_PI_2;

use glam::Vec3;

use super::*;
use crate::scene::{LightKind, Scene};

/// What is replaced in the document, and words of the warning.
const MENDED: &[(&str, &str, &str)] = &[
    ("\"intensity\": 40", "\"intensity\": -40", "negative"),
    ("\"color\": [1, 0.5, 0.25]", "\"color\": [1, -0.5, 0.25]", "negative"),
    ("\"range\": 8", "\"range\": 0", "ranges"),
    ("\"outerConeAngle\": 0.5", "\"outerConeAngle\": 0.25", "hard edge"),
    ("\"outerConeAngle\": 0.5", "\"outerConeAngle\": 0.2", "hard edge"),
    ("\"outerConeAngle\": 0.5", "\"outerConeAngle\": 1.6", "90 degrees"),
    ("\"innerConeAngle\": 0.25", "\"innerConeAngle\": -1e-8", "inner cone"),
    ("[0.5, 0.25, 0.125, 1]", "[1.0000001, 0.25, 0.125, 1.0000001]", "just outside"),
    ("[0.5, 0.25, 0.125, 1]", "[-1e-7, 0.25, 0.125, 1]", "just outside"),
    ("[0.5, 0.25, 0.125, 1]", "[1, 0.25, 0.125, 1]", "closed room"),
    ("[{\"nodes\": [0, 1]}]", "[{}]", "scene is empty"),
    ("[{\"nodes\": [0, 1]}]", "[{\"nodes\": []}]", "scene is empty"),
    (
        "\"scene\": 0",
        "\"animations\": [{\"channels\": [{\"sampler\": 0, \"target\": {\"path\": \"pointer\"}}]}], \"scene\": 0",
        "animations",
    ),
    (
        "\"doubleSided\": true",
        "\"extensions\": {\"KHR_materials_transmission\": {\"transmissionFactor\": 1}}",
        "without bending",
    ),
    (
        "\"doubleSided\": true",
        "\"alphaMode\": \"BLEND\", \"pbrMetallicRoughness\": {\"baseColorFactor\": [1, 1, 1, 0]}",
        "no triangle",
    ),
    ("\"count\": 6", "\"count\": 5", "no whole triangle"),
    ("\"count\": 6", "\"count\": 2", "no whole triangle"),
    ("\"NORMAL\": 1}", "\"NORMAL\": 1, \"UV2\": 1}", "attributes that are not known"),
    (", \"spot\": {\"innerConeAngle\": 0.25, \"outerConeAngle\": 0.5}", "", "without a cone"),
    ("\"rotation\": [0.7071068, 0, 0, 0.7071068]", "\"scale\": [0, 0, 0]", "no direction"),
    ("\"byteOffset\": 0, \"byteLength\": 48", "\"byteOffset\": 0, \"byteLength\": 48, \"byteStride\": 0", "byteStride"),
    ("\"mode\": 4", "\"mode\": 1", "points and lines"),
    ("\"mode\": 4", "\"mode\": 1", "no triangle"),
    ("\"scale\": [2, 2, 2]", "\"scale\": [0, 0, 0]", "scale of zero"),
    ("\"nodes\": [0, 1]", "\"nodes\": [1]", "no triangle"),
    ("\"translation\": [1, 2, 3]", "\"extensions\": {\"KHR_node_visibility\": {\"visible\": false}}", "hidden"),
];

fn mended(replacements: &[(&str, &str)]) -> Scene {
    let mut replacements = replacements.to_vec();
    // Materials have either.
    if replacements.iter().any(|(_, to)| to.contains("pbrMetallicRoughness")) {
        replacements.push((
            "\"pbrMetallicRoughness\": {\"baseColorFactor\": [0.5, 0.25, 0.125, 1], \"metallicFactor\": 0},",
            "",
        ));
    }
    if replacements.iter().any(|(_, to)| to.contains("KHR_materials_transmission")) {
        replacements
            .push((",\n    \"extensions\": {\"KHR_materials_emissive_strength\": {\"emissiveStrength\": 3}}", ""));
    }
    load(&edited(&replacements)).unwrap_or_else(|error| panic!("{replacements:?}: {error}"))
}

#[test]
fn departures_are_mended_with_a_warning() {
    for (from, to, words) in MENDED {
        let scene = mended(&[(from, to)]);
        assert!(scene.warnings.iter().any(|text| text.contains(words)), "{to}: {:?}", scene.warnings);
        assert!(scene.lights.iter().all(|light| light.strength().min_element() >= 0.0), "{to}");
    }
}

#[test]
fn what_is_mended_is_right() {
    let lamp = |to: &str| {
        let scene = mended(&[("\"outerConeAngle\": 0.5", to)]);
        let LightKind::Spot { inner_cone_angle, outer_cone_angle, .. } = scene.lights[1].kind else { panic!() };
        (inner_cone_angle, outer_cone_angle)
    };
    assert_eq!(lamp("\"outerConeAngle\": 0.25"), (0.25, 0.25));
    assert_eq!(lamp("\"outerConeAngle\": 0.125"), (0.125, 0.125));
    assert_eq!(lamp("\"outerConeAngle\": 3"), (0.25, FRAC_PI_2));
    assert_eq!(mended(&[("\"intensity\": 40", "\"intensity\": -40")]).lights[1].strength(), Vec3::ZERO);
    let white = mended(&[("[0.5, 0.25, 0.125, 1]", "[1, 0.25, 0.125, 1]")]);
    assert_eq!(white.objects[0].materials[0].albedo, Vec3::new(1.0, 0.25, 0.125));
    let opaque = mended(&[("\"doubleSided\": true", "\"alphaMode\": \"BLEND\"")]);
    assert_eq!(opaque.objects[0].mesh.triangles.len(), 2);
    // The whole branch is hidden, its lights too.
    let hidden = "\"name\": \"Rig\", \"extensions\": {\"KHR_node_visibility\": {\"visible\": false}}";
    let lights: Vec<String> = mended(&[("\"name\": \"Rig\"", hidden)]).lights.into_iter().map(|l| l.name).collect();
    assert_eq!(lights, ["Wall"]);
    // Of a light under an object the object is known.
    let nested = mended(&[("\"name\": \"Rig\"", "\"name\": \"Rig\", \"mesh\": 0")]);
    assert_eq!(nested.light_parents.iter().collect::<Vec<_>>(), [(&"Lamp".to_owned(), &"Rig".to_owned())]);
}

#[test]
fn normals_that_are_no_numbers_count_as_absent() {
    let mut bin = square_data();
    bin[60..64].copy_from_slice(&f32::NAN.to_le_bytes());
    let scene = load(&glb(SQUARE, &bin)).unwrap();
    assert_eq!(scene.objects[0].mesh.normals[1], Vec3::ZERO);
    assert!(scene.warnings.iter().any(|text| text.contains("normals")), "{:?}", scene.warnings);
}

#[test]
fn what_is_almost_right_is_read_as_it_was_meant() {
    // Numbers of vertices that make no whole triangle.
    let five = mended(&[("\"count\": 6", "\"count\": 5")]);
    assert_eq!(five.objects[0].mesh.triangles, [[0, 1, 2]]);
    // A stride of 0 is the size of a value; a last row is 0 0 0 1 but for rounding.
    let stride = ("\"byteOffset\": 0, \"byteLength\": 48", "\"byteOffset\": 0, \"byteLength\": 48, \"byteStride\": 0");
    let matrix = "\"matrix\": [2,0,0,1e-8, 0,2,0,0, 0,0,2,0, 1,2,3,1.0000001]";
    let square = mended(&[stride, ("\"translation\": [1, 2, 3], \"scale\": [2, 2, 2]", matrix)]);
    assert_eq!(square.objects[0].mesh.triangles.len(), 2);
    assert_eq!(square.objects[0].world_from_object, mended(&[]).objects[0].world_from_object);
    // What shines in no direction is left out, and no name is lost by it.
    let flat = mended(&[("\"rotation\": [0.7071068, 0, 0, 0.7071068]", "\"scale\": [0, 0, 0]")]);
    assert_eq!(flat.lights.len(), 1);
    let cone = mended(&[(", \"spot\": {\"innerConeAngle\": 0.25, \"outerConeAngle\": 0.5}", "")]);
    let LightKind::Spot { inner_cone_angle, outer_cone_angle, .. } = cone.lights[1].kind else { panic!() };
    assert_eq!((inner_cone_angle, outer_cone_angle), (0.0, std::f32::consts::FRAC_PI_4));
}

/// Eight bits of 51 are a fifth, whether the file says so or not.
#[test]
fn integer_colours_are_fractions() {
    let mut bin = square_data();
    bin.extend([51, 102, 255, 255].repeat(4));
    let colors = "\"type\": \"SCALAR\"}, {\"bufferView\": 5, \"componentType\": 5121, \"count\": 4, \"type\": \"VEC4\"";
    for (normalized, is_mended) in [("}", true), (", \"normalized\": true}", false)] {
        let json = SQUARE
            .replace("\"NORMAL\": 1}", "\"NORMAL\": 1, \"COLOR_0\": 3}")
            .replace("\"type\": \"SCALAR\"}", &format!("{colors}{normalized}"))
            .replace(
                "\"byteLength\": 16}",
                "\"byteLength\": 16}, {\"buffer\": 0, \"byteOffset\": 128, \"byteLength\": 16}",
            )
            .replace("[{\"byteLength\": 128}]", "[{\"byteLength\": 144}]");
        let scene = load(&glb(&json, &bin)).unwrap();
        assert_eq!(scene.objects[0].mesh.colors, [glam::Vec4::new(0.2, 0.4, 1.0, 1.0); 4]);
        assert_eq!(scene.warnings.iter().any(|text| text.contains("integers")), is_mended, "{:?}", scene.warnings);
    }
}

/// Three walls for one node: at the square's first three corners, in the node's space.
#[test]
fn instances_are_objects() {
    let attributes =
        "\"extensions\": {\"EXT_mesh_gpu_instancing\": {\"attributes\": {\"TRANSLATION\": 0}}}, \"mesh\": 0";
    let scene = mended(&[("\"mesh\": 0", attributes)]);
    let names: Vec<&str> = scene.objects.iter().map(|object| object.name.as_str()).collect();
    assert_eq!(names, ["Wall", "Wall-2", "Wall-3", "Wall-4"]);
    assert_eq!(scene.warnings, Vec::<String>::new());
    let place = scene.objects[2].world_from_object.transform_point3(glam::DVec3::ZERO);
    assert_eq!(place, glam::DVec3::new(3.0, 4.0, 3.0));
    assert!(std::sync::Arc::ptr_eq(&scene.objects[0].mesh, &scene.objects[3].mesh));
}
