//! A table of files that break the specification, the limits or what is supported, with the words of the answer.

use glam::Vec3;

use super::*;

/// What is replaced in the document, and words that the answer must have.
const MALFORMED: &[(&str, &str, &str)] = &[
    // The document as a whole.
    ("\"version\": \"2.0\"", "\"version\": \"1.0\"", "glTF 2.0"),
    ("\"version\": \"2.0\"", "\"version\": \"2.0\", \"minVersion\": \"2.9\"", "minVersion"),
    ("\"asset\"", "\"assets\"", "asset"),
    ("\"scene\": 0,", "\"scene\": 0", "JSON"),
    ("\"scene\": 0,", "\"scene\": 9,", "scene"),
    ("[{\"nodes\": [0, 1]}]", "[{\"nodes\": [0, 17]}]", "nodes"),
    ("\"count\": 4", "\"count\": -4", "JSON"),
    ("\"count\": 4", "\"count\": 4.5", "JSON"),
    // Buffers and views.
    ("\"buffers\": [{\"byteLength\": 128}]", "\"buffers\": [{\"byteLength\": 129}]", "129"),
    ("\"buffers\": [{\"byteLength\": 128}]", "\"buffers\": [{\"byteLength\": 128}, {\"byteLength\": 4}]", "buffer 1"),
    ("\"buffers\": [{\"byteLength\": 128}]", "\"buffers\": []", "buffer"),
    ("\"byteOffset\": 48, \"byteLength\": 48", "\"byteOffset\": 48, \"byteLength\": 480", "NORMAL: buffer view 1"),
    ("\"byteOffset\": 48", "\"byteOffset\": 18446744073709551615", "buffer view 1"),
    ("\"buffer\": 0, \"byteOffset\": 0", "\"buffer\": 5, \"byteOffset\": 0", "buffer"),
    ("\"byteOffset\": 0, \"byteLength\": 48", "\"byteOffset\": 0, \"byteLength\": 48, \"byteStride\": 8", "stride"),
    ("\"byteOffset\": 0, \"byteLength\": 48", "\"byteOffset\": 0, \"byteLength\": 48, \"byteStride\": 14", "aligned"),
    (
        "\"byteOffset\": 0, \"byteLength\": 48",
        "\"byteOffset\": 0, \"byteLength\": 48, \"byteStride\": 16",
        "reach to byte 60",
    ),
    ("\"byteOffset\": 48", "\"byteOffset\": 50", "aligned"),
    // Accessors.
    ("\"count\": 6", "\"count\": 7", "reach to byte 14"),
    ("\"count\": 6", "\"count\": 0", "no values"),
    (
        "\"bufferView\": 1, \"componentType\": 5126, \"count\": 4",
        "\"bufferView\": 1, \"componentType\": 5126, \"count\": 3",
        "4 positions but 3 normals",
    ),
    ("\"bufferView\": 1, \"componentType\": 5126", "\"bufferView\": 1, \"componentType\": 5127", "componentType"),
    (
        "\"bufferView\": 1, \"componentType\": 5126",
        "\"bufferView\": 1, \"componentType\": 5125",
        "integers for coordinates",
    ),
    ("\"type\": \"SCALAR\"", "\"type\": \"VEC2\"", "indices: its accessor has type Vec2"),
    ("\"type\": \"SCALAR\"", "\"type\": \"SCALER\"", "type"),
    ("\"componentType\": 5123, \"count\": 6", "\"componentType\": 5126, \"count\": 3", "unsigned integers"),
    (
        "\"bufferView\": 2, \"componentType\": 5123, \"count\": 6",
        "\"bufferView\": 1, \"componentType\": 5121, \"count\": 48",
        "index 128 is out of range",
    ),
    (
        "\"bufferView\": 2, \"componentType\": 5123, \"count\": 6",
        "\"bufferView\": 0, \"componentType\": 5123, \"count\": 9",
        "mesh 0 \"Square\", primitive 0: index 16256 is out of range, there are 4 vertices",
    ),
    ("\"bufferView\": 0, \"componentType\"", "\"bufferView\": 77, \"componentType\"", "bufferView"),
    ("\"count\": 6,", "\"count\": 6, \"byteOffset\": 18446744073709551615,", "aligned"),
    ("\"count\": 6,", "\"count\": 6, \"byteOffset\": 18446744073709551512,", "reach to byte"),
    (
        "\"count\": 6,",
        "\"count\": 6, \"sparse\": {\"count\": 1, \"indices\": {\"bufferView\": 4, \"componentType\": 5125}, \
         \"values\": {\"bufferView\": 9}},",
        "sparse",
    ),
    (
        "\"count\": 6,",
        "\"count\": 6, \"sparse\": {\"count\": 7, \"indices\": {\"bufferView\": 4, \"componentType\": 5125}, \
         \"values\": {\"bufferView\": 0}},",
        "7 of them for 6",
    ),
    (
        "\"count\": 6,",
        "\"count\": 6, \"sparse\": {\"count\": 1, \"indices\": {\"bufferView\": 0, \"byteOffset\": 12, \
         \"componentType\": 5125}, \"values\": {\"bufferView\": 0}},",
        "index 1065353216 is out of range",
    ),
    // Meshes.
    ("\"POSITION\": 0", "\"POSITION\": 99", "POSITION is accessor 99, there are 3"),
    ("\"POSITION\": 0, ", "", "POSITION"),
    ("\"NORMAL\": 1", "\"NORMAL\": 99", "NORMAL"),
    ("\"indices\": 2", "\"indices\": 3", "indices"),
    ("\"material\": 0", "\"material\": 1", "material"),
    ("\"mode\": 4", "\"mode\": 9", "mode"),
    ("\"mesh\": 0", "\"mesh\": 4", "mesh"),
    // Nodes.
    ("\"children\": [2, 3]", "\"children\": [2, 30]", "child"),
    ("\"children\": [2, 3]", "\"children\": [2, 2]", "node 2: is a child of node 1 and again of node 1"),
    ("\"children\": [2, 3]", "\"children\": [1]", "own ancestors"),
    ("\"name\": \"Camera\",", "\"name\": \"Camera\", \"children\": [1],", "own ancestors"),
    ("[{\"nodes\": [0, 1]}]", "[{\"nodes\": [0, 1, 2]}]", "node 2 \"Camera\": is in the hierarchy more than once"),
    ("\"scale\": [2, 2, 2]", "\"scale\": [2, 1e39, 2]", "node 0 \"Wall\""),
    ("\"scale\": [2, 2, 2]", "\"scale\": [2, 2e38, 2]", "spans"),
    ("\"scale\": [2, 2, 2]", "\"scale\": [2, 2]", "JSON"),
    ("\"rotation\": [0.7071068, 0, 0, 0.7071068]", "\"rotation\": [0, 0, 0, 0]", "unit quaternion"),
    ("\"rotation\": [0.7071068, 0, 0, 0.7071068]", "\"matrix\": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,2]", "last row"),
    ("\"rotation\": [0.7071068, 0, 0, 0.7071068]", "\"matrix\": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,1e39,1]", "not finite"),
    // Materials, lights, cameras.
    ("[0.5, 0.25, 0.125, 1]", "[1.5, 0.25, 0.125, 1]", "material 0 \"Paint\": its baseColorFactor"),
    ("[0.5, 0.25, 0.125, 1]", "[0.5, -0.25, 0.125, 1]", "within 0 and 1"),
    ("[0.5, 0.25, 0.125, 1]", "[0.5, 1e39, 0.125, 1]", "baseColorFactor"),
    ("\"emissiveFactor\": [1, 0.5, 0]", "\"emissiveFactor\": [1, -0.5, 0]", "emissiveFactor"),
    ("\"emissiveStrength\": 3", "\"emissiveStrength\": -3", "emissiveStrength"),
    ("\"emissiveFactor\": [1, 0.5, 0]", "\"emissiveFactor\": [3e38, 0.5, 0]", "emission is not finite"),
    ("\"doubleSided\": true", "\"alphaMode\": \"GLASS\"", "alphaMode"),
    ("\"doubleSided\": true", "\"emissiveTexture\": {\"index\": 0}", "emissiveTexture"),
    ("\"intensity\": 40", "\"intensity\": 1e39", "intensity"),
    ("\"outerConeAngle\": 0.5", "\"outerConeAngle\": -1", "cone angles"),
    ("\"type\": \"spot\"", "\"type\": \"laser\"", "type"),
    ("{\"light\": 0}", "{\"light\": 1}", "light"),
    ("\"yfov\": 0.75", "\"yfov\": 4", "yfov"),
    ("\"camera\": 0", "\"camera\": 3", "camera"),
];

#[test]
fn malformed_documents_are_refused_with_the_place() {
    assert!(load(&edited(&[])).is_ok());
    let mut wrong = Vec::new();
    for (from, to, words) in MALFORMED {
        let result = load(&edited(&[(from, to)])).map(|scene| scene.warnings);
        if !matches!(&result, Err(LoadError::Malformed(text)) if text.contains(words)) {
            wrong.push(format!("{from} -> {to}: {result:?}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn broken_containers_are_refused() {
    let file = edited(&[]);
    let patched = |at: usize, bytes: &[u8]| {
        let mut file = file.clone();
        file[at..at + bytes.len()].copy_from_slice(bytes);
        file
    };
    let cases = [
        (Vec::new(), "starts with the letters"),
        (b"solid cube".to_vec(), "starts with the letters"),
        (b"glTF".to_vec(), "ends within its header"),
        (b"{\"asset\": {}}".to_vec(), "version"),
        (b"PK".to_vec(), "archive"),
        (b"PK\x05\x06\0\0\0\0\0\0\x01\0".to_vec(), "archive"),
        (patched(4, &[1]), "container version 1"),
        (patched(8, &u32::MAX.to_le_bytes()), "header states a length"),
        (patched(8, &4_u32.to_le_bytes()), "header states a length"),
        (patched(8, &15_u32.to_le_bytes()), "header of the first chunk"),
        (patched(12, &u32::MAX.to_le_bytes()), "first chunk states"),
        (patched(16, b"BIN\0"), "not the JSON chunk"),
        (patched(20, &[0xff]), "JSON"),
        (file[..file.len() - 1].to_vec(), "header states a length"),
    ];
    for (bytes, words) in cases {
        let text = load(&bytes).expect_err(words).to_string();
        assert!(text.contains(words), "{words}: {text}");
    }
}

#[test]
fn numbers_in_the_data_must_be_finite() {
    for (at, value, words) in [(4, f32::NAN, "POSITION: value 0"), (16, f32::INFINITY, "POSITION: value 1")] {
        let mut bin = square_data();
        bin[at..at + 4].copy_from_slice(&value.to_le_bytes());
        let error = load(&glb(SQUARE, &bin)).unwrap_err();
        assert!(matches!(&error, LoadError::Malformed(text) if text.contains(words)), "{error}");
    }
}

#[test]
fn what_cannot_be_baked_is_told_apart_from_what_is_broken() {
    let used = "\"extensionsUsed\": [";
    let required = |name: &str| format!("\"extensionsRequired\": [\"{name}\"], {used}");
    let uri = |uri: &str| format!("\"buffers\": [{{\"byteLength\": 128, \"uri\": \"{uri}\"}}]");
    let buffers = "\"buffers\": [{\"byteLength\": 128}]";
    let cases = [
        (used, required("KHR_gaussian_splatting"), "KHR_gaussian_splatting"),
        (used, required("VENDOR_x"), "VENDOR_x"),
        (buffers, uri("room.bin"), "room.bin"),
        (buffers, uri("http://localhost/room.bin"), "http://localhost"),
    ];
    for (from, to, words) in cases {
        match load(&edited(&[(from, &to)])) {
            Err(LoadError::Unsupported(text)) => assert!(text.contains(words), "{to}: {text}"),
            other => panic!("{to}: {other:?}"),
        }
    }
}

#[test]
fn limits_are_kept_before_memory_is_spent() {
    let sparse = "\"sparse\": {\"count\": 1, \"indices\": {\"bufferView\": 4, \"componentType\": 5125}, \
        \"values\": {\"bufferView\": 0}}";
    let endless = format!("{{\"componentType\": 5126, \"count\": 1000000000000, {sparse},");
    let huge = edited(&[("{\"bufferView\": 0, \"componentType\": 5126, \"count\": 4,", &endless)]);
    let file = edited(&[]);
    let limits = LoadLimits::default();
    let cases = [
        (&huge, limits.clone(), "vertices"),
        (&file, LoadLimits { max_bytes: 100, ..limits.clone() }, "bytes"),
        (&file, LoadLimits { max_nodes: 3, ..limits.clone() }, "nodes"),
        (&file, LoadLimits { max_depth: 1, ..limits.clone() }, "levels"),
        (&file, LoadLimits { max_objects: 0, ..limits.clone() }, "objects"),
        (&file, LoadLimits { max_lights: 1, ..limits.clone() }, "lights"),
        (&file, LoadLimits { max_triangles: 1, ..limits.clone() }, "triangles"),
        (&file, LoadLimits { max_materials: 1, ..limits.clone() }, "extensionsUsed"),
        (&file, LoadLimits { max_vertices: 3, ..limits }, "vertices"),
    ];
    for (file, limits, words) in cases {
        match super::super::load(file, &limits) {
            Err(LoadError::TooLarge(text)) => assert!(text.contains(words), "{words}: {text}"),
            other => panic!("{words}: {other:?}"),
        }
    }
}

/// Small views that are read again and again, and values that take no bytes of the file: neither a vertex, a triangle
/// nor an object need come of them, so they are counted as they are read.
#[test]
fn values_are_counted_as_often_as_they_are_read() {
    let primitive = "{\"attributes\": {\"POSITION\": 0, \"NORMAL\": 1}, \"indices\": 2, \"material\": 0, \"mode\": 4}";
    let indices = "{\"bufferView\": 2, \"componentType\": 5123, \"count\": 6, \"type\": \"SCALAR\"}";
    let zeros = "{\"componentType\": 5125, \"count\": 999, \"type\": \"SCALAR\"}";
    let one = "\"sparse\": {\"count\": 1, \"indices\": {\"bufferView\": 2, \"componentType\": 5123}, \"values\": {\"bufferView\": 4}}";
    let sparse = zeros.replace("\"type\"", &format!("{one}, \"type\""));
    let scales = format!("{indices}, {{\"componentType\": 5126, \"count\": 99, \"type\": \"VEC3\"}}");
    let instances = "\"extensions\": {\"EXT_mesh_gpu_instancing\": {\"attributes\": {\"SCALE\": 3}}}";
    let (vertices, triangles) = (4 * (12 + 12), 6 * 4);
    for (file, bytes) in [
        (edited(&[]), vertices + triangles),
        (edited(&[(primitive, &[primitive; 10].join(", "))]), vertices + 10 * triangles),
        (edited(&[(indices, zeros)]), vertices + 999 * 4),
        (edited(&[(indices, &sparse)]), vertices + 999 * 4 + 4 + 4),
        (edited(&[(indices, &scales), ("\"scale\": [2, 2, 2]", instances)]), vertices + triangles + 99 * (12 + 128)),
    ] {
        let with = |max_read_bytes| super::super::load(&file, &LoadLimits { max_read_bytes, ..LoadLimits::default() });
        assert!(with(bytes).is_ok(), "{bytes}: {:?}", with(bytes));
        let refused = with(bytes - 1);
        assert!(
            matches!(&refused, Err(LoadError::TooLarge(text)) if text.contains("accessors")),
            "{bytes}: {refused:?}"
        );
    }
}

/// A few bytes of a file are gigabytes of zeros: only so many are made.
#[test]
fn zeros_that_the_file_does_not_hold_are_bounded() {
    let positions = "{\"bufferView\": 0, \"componentType\": 5126, \"count\": 4,";
    let sparse = "{\"componentType\": 5126, \"count\": 4, \"sparse\": {\"count\": 1, \"indices\": {\"bufferView\": 4, \
        \"componentType\": 5125}, \"values\": {\"bufferView\": 4, \"byteOffset\": 4}},";
    let scene = load(&edited(&[(positions, sparse)])).unwrap();
    assert_eq!(scene.objects[0].mesh.positions, [Vec3::ZERO, Vec3::ZERO, Vec3::new(3.0, 3.0, 0.0), Vec3::ZERO]);
    let with = |max_zero_bytes, from: &str, to: &str| {
        let limits = LoadLimits { max_zero_bytes, ..LoadLimits::default() };
        super::super::load(&edited(&[(from, to)]), &limits).map(|_| ())
    };
    assert!(with(48, positions, sparse).is_ok());
    let many = "{\"componentType\": 5126, \"count\": 50000000,";
    for refused in [with(47, positions, sparse), with(LoadLimits::default().max_zero_bytes, positions, many)] {
        assert!(
            matches!(&refused, Err(LoadError::TooLarge(text)) if text.contains("POSITION: in accessors without")),
            "{refused:?}"
        );
    }
}

/// Two bytes of JSON are hundreds in memory: they are counted first.
#[test]
fn empty_entries_are_counted_before_they_are_read() {
    let many = format!("\"materials\": [{}{{", "{}, ".repeat(200_000));
    for (from, to, words) in [
        ("\"materials\": [{", many.as_str(), "materials"),
        ("\"scene\": 0", &format!("\"extras\": [{}0], \"scene\": 0", "[],".repeat(9_000_000)), "objects and lists"),
    ] {
        let result = load(&edited(&[(from, to)])).map(|_| ());
        assert!(matches!(&result, Err(LoadError::TooLarge(text)) if text.contains(words)), "{result:?}");
    }
}

/// A chain of nodes as long as the limit on nodes allows neither overflows the stack nor takes long.
#[test]
fn deep_hierarchies_are_refused() {
    let depth = 200_000;
    let chain: Vec<String> = (4..4 + depth).map(|index| format!("{{\"children\": [{}]}}", index + 1)).collect();
    let lamp = "{\"KHR_lights_punctual\": {\"light\": 0}}}";
    let nodes = format!("{lamp}, {}, {{}}", chain.join(", "));
    let file = edited(&[(lamp, &nodes), ("[{\"nodes\": [0, 1]}]", "[{\"nodes\": [0, 1, 4]}]")]);
    assert!(matches!(load(&file), Err(LoadError::TooLarge(_))));
}
