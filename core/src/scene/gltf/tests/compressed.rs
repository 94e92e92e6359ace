//! Compressed meshes, made by the encoders of the libraries that decode them, and damaged.

use draco_core::{
    DataType, DracoError, EncoderBuffer, EncoderOptions, FaceIndex, GeometryAttributeType, MeshEncoder, PointAttribute,
    PointIndex,
};
use meshoptimizer_rs::Workspace;
use meshoptimizer_rs::codec::{IndexEncoding, VertexEncoding, encode_index_buffer, encode_vertex_buffer};

use super::*;

/// The square's positions, normals and triangles by Draco, with ids 0 and 1.
fn draco_square() -> Result<Vec<u8>, DracoError> {
    let mut mesh = draco_core::Mesh::new();
    mesh.set_num_points(4);
    mesh.set_num_faces(2);
    for (face, corners) in [[0, 1, 2], [0, 2, 3]].into_iter().enumerate() {
        mesh.set_face(FaceIndex(face as u32), corners.map(PointIndex));
    }
    for (kind, bytes) in [(GeometryAttributeType::Position, 0..48), (GeometryAttributeType::Normal, 48..96)] {
        let mut attribute = PointAttribute::new();
        attribute.init(kind, 3, DataType::Float32, false, 4);
        attribute.buffer_mut().update(&square_data()[bytes], Some(0));
        mesh.add_attribute(attribute);
    }
    let mut encoder = MeshEncoder::new();
    encoder.set_mesh(mesh);
    let mut buffer = EncoderBuffer::new();
    encoder.encode(&EncoderOptions::new(), &mut buffer)?;
    Ok(buffer.data().to_vec())
}

fn with_draco(data: &[u8]) -> Vec<u8> {
    let mut bin = data.to_vec();
    bin.resize(bin.len().next_multiple_of(4), 0);
    let extension = "\"mode\": 4, \"extensions\": {\"KHR_draco_mesh_compression\": {\"bufferView\": 0, \
                     \"attributes\": {\"POSITION\": 0, \"NORMAL\": 1}}}";
    let start = SQUARE.find("  \"bufferViews\"").unwrap();
    let json = SQUARE[..start]
        .replace("\"mode\": 4", extension)
        .replace("\"bufferView\": 0, \"componentType\"", "\"componentType\"")
        .replace("\"bufferView\": 1, \"componentType\"", "\"componentType\"")
        .replace("\"bufferView\": 2, \"componentType\"", "\"componentType\"")
        .replace(
            "\"extensionsUsed\": [",
            "\"extensionsRequired\": [\"KHR_draco_mesh_compression\"], \"extensionsUsed\": [",
        );
    let json = format!(
        "{json}\"bufferViews\": [{{\"buffer\": 0, \"byteLength\": {}}}], \"buffers\": [{{\"byteLength\": {}}}]}}",
        data.len(),
        bin.len()
    );
    glb(&json, &bin)
}

/// Compressed positions and indices in buffer 0; buffer 1 is their fallback and has no data.
fn with_meshopt() -> Vec<u8> {
    meshopt_of("EXT_meshopt_compression", 0)
}

/// By an extension, with streams of a version.
fn meshopt_of(extension: &str, version: u8) -> Vec<u8> {
    let mut workspace = Workspace::default();
    let data = square_data();
    let encoding = VertexEncoding::new(version, 2).unwrap();
    let positions = encode_vertex_buffer(&data[..48], 4, 12, encoding, &mut workspace).unwrap();
    let indices = encode_index_buffer(&[0, 1, 2, 0, 2, 3], IndexEncoding::DEFAULT, &mut workspace).unwrap();
    let mut bin = positions.clone();
    bin.resize(bin.len().next_multiple_of(4), 0);
    let second = bin.len();
    bin.extend(&indices);
    bin.resize(bin.len().next_multiple_of(4), 0);
    let view = |start: usize, length: usize, from: usize, packed: usize, mode: &str, stride: usize, count: usize| {
        format!(
            "{{\"buffer\": 1, \"byteOffset\": {start}, \"byteLength\": {length}, \
             \"extensions\": {{\"{extension}\": \
             {{\"buffer\": 0, \"byteOffset\": {from}, \"byteLength\": {packed}, \"mode\": \"{mode}\", \
             \"byteStride\": {stride}, \"count\": {count}}}}}}}"
        )
    };
    let views = [
        view(0, 48, 0, positions.len(), "ATTRIBUTES", 12, 4),
        view(0, 48, 0, positions.len(), "ATTRIBUTES", 12, 4),
        view(48, 12, second, indices.len(), "TRIANGLES", 2, 6),
    ];
    let start = SQUARE.find("  \"bufferViews\"").unwrap();
    let json = format!(
        "{}\"bufferViews\": [{}], \"buffers\": [{{\"byteLength\": {}}}, {{\"byteLength\": 60, \
         \"extensions\": {{\"{extension}\": {{\"fallback\": true}}}}}}]}}",
        &SQUARE[..start],
        views.join(", "),
        bin.len()
    );
    glb(&json, &bin)
}

/// Area and orientation, whatever the order of triangles and vertices.
fn is_square(scene: &Scene) -> bool {
    let mesh = &scene.objects[0].mesh;
    let corner = |i: u32| mesh.positions[i as usize];
    let area = |&[a, b, c]: &[u32; 3]| (corner(b) - corner(a)).cross(corner(c) - corner(a)) * 0.5;
    let area: glam::Vec3 = mesh.triangles.iter().map(area).sum();
    mesh.triangles.len() == 2 && area.distance(glam::Vec3::Z) < 1e-2
}

#[test]
fn compressed_meshes_are_those_that_were_compressed() {
    let draco = load(&with_draco(&draco_square().unwrap())).unwrap_or_else(|error| panic!("{error}"));
    assert!(is_square(&draco), "{draco:?}");
    assert!(draco.objects[0].mesh.normals.iter().all(|normal| normal.z > 0.99), "{draco:?}");
    for file in [with_meshopt(), meshopt_of("KHR_meshopt_compression", 0), meshopt_of("KHR_meshopt_compression", 1)] {
        let meshopt = load(&file).unwrap_or_else(|error| panic!("{error}"));
        assert!(is_square(&meshopt), "{meshopt:?}");
    }
}

#[test]
fn compressed_meshes_keep_to_the_limits() {
    for (file, limits) in [
        (with_draco(&draco_square().unwrap()), LoadLimits { max_triangles: 1, ..LoadLimits::default() }),
        (with_draco(&draco_square().unwrap()), LoadLimits { max_vertices: 3, ..LoadLimits::default() }),
        (with_meshopt(), LoadLimits { max_unpacked_bytes: 50, ..LoadLimits::default() }),
    ] {
        let result = super::super::load(&file, &limits).map(|_| ());
        assert!(matches!(result, Err(LoadError::TooLarge(_))), "{result:?}");
    }
}

/// What was decompressed before is not there to be decompressed again.
#[test]
fn compressed_meshes_share_what_may_be_unpacked() {
    let once = with_draco(&draco_square().unwrap());
    let length = u32::from_le_bytes(once[12..16].try_into().unwrap()) as usize;
    let json = std::str::from_utf8(&once[20..20 + length]).unwrap();
    let start = json.find("{\"attributes\": {\"POSITION\": 0").unwrap();
    let end = json.find("\n  ]}],\n  \"accessors\"").unwrap();
    let primitive = &json[start..end];
    let of = |count: usize| {
        let json = json.replace(primitive, &vec![primitive; count].join(", "));
        glb(&json, &once[28 + length..])
    };
    let limits = LoadLimits { max_unpacked_bytes: 1000, ..LoadLimits::default() };
    let unpacked = |count| super::super::load(&of(count), &limits).map(|scene| scene.objects[0].mesh.triangles.len());
    assert_eq!(unpacked(3).unwrap(), 6);
    assert!(matches!(unpacked(9), Err(LoadError::TooLarge(_))), "{:?}", unpacked(9));
    // Four vertices with normals, and two triangles.
    let with = |max_read_bytes| super::super::load(&once, &LoadLimits { max_read_bytes, ..LoadLimits::default() });
    assert!(with(120).is_ok() && matches!(with(119), Err(LoadError::TooLarge(_))), "{:?}", with(119));
}

/// Any answer is right, a panic is not.
#[test]
fn damaged_data_does_not_panic() {
    let mut random = fuzz::Random(9);
    for whole in [with_draco(&draco_square().unwrap()), with_meshopt()] {
        // Damage behind the JSON only.
        let start = 28 + u32::from_le_bytes(whole[12..16].try_into().unwrap()) as usize;
        let mut refused = 0;
        for _ in 0..10_000 {
            let mut file = whole.clone();
            for _ in 0..=random.below(4) {
                let at = start + random.below(file.len() - start);
                file[at] =
                    if random.below(2) == 0 { random.below(256) as u8 } else { file[at] ^ (1 << random.below(8)) };
            }
            refused += usize::from(load(&file).is_err());
        }
        assert!(refused > 500, "{refused}");
    }
}

/// The cases of the workshop, where they are at hand.
#[test]
fn files_of_exporters_are_read() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/cases");
    let Ok(cases) = std::fs::read_dir(&folder) else {
        eprintln!("skipped: {} is missing", folder.display());
        return;
    };
    let mut read = 0;
    for path in cases.flatten().map(|case| case.path().join("scene.glb")) {
        let Ok(bytes) = std::fs::read(&path) else { continue };
        let scene = load(&bytes).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        assert!(scene.objects.iter().any(|object| !object.mesh.triangles.is_empty()), "{}", path.display());
        read += 1;
    }
    assert!(read > 40, "{read}");
}
