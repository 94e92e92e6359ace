//! Documents with their data elsewhere: within the JSON, in an archive, in a folder.

use std::io::{Cursor, Write};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use zip::write::SimpleFileOptions;

use super::super::{load_path, packed, tests};
use super::*;

const BUFFERS: &str = "\"buffers\": [{\"byteLength\": 128}]";

fn with_uri(uri: &str) -> String {
    SQUARE.replace(BUFFERS, &format!("\"buffers\": [{{\"byteLength\": 128, \"uri\": \"{uri}\"}}]"))
}

fn archive(files: &[(&str, &[u8])]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, data) in files {
        zip.start_file(*name, SimpleFileOptions::default()).unwrap();
        zip.write_all(data).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

fn is_square(scene: &Scene) -> bool {
    scene.objects.len() == 1 && scene.objects[0].mesh.triangles == [[0, 1, 2], [0, 2, 3]]
}

#[test]
fn data_is_found_within_the_document_and_beside_it() {
    let data = square_data();
    let inline = with_uri(&format!("data:application/octet-stream;base64,{}", STANDARD.encode(&data)));
    let beside = with_uri("buffers/room%201.bin");
    assert!(is_square(&load(inline.as_bytes()).unwrap()));
    assert!(is_square(&load(format!("\u{feff} {inline}").as_bytes()).unwrap()));
    assert!(is_square(&load(&glb(&inline, &[])).unwrap()));
    let zips = [
        archive(&[("room.gltf", beside.as_bytes()), ("buffers/room 1.bin", &data)]),
        archive(&[("export/Room.GLTF", beside.as_bytes()), ("export/Buffers/Room 1.BIN", &data), ("a.txt", b"")]),
        archive(&[("room.glb", &edited(&[]))]),
    ];
    for zip in &zips {
        assert!(is_square(&load(zip).unwrap()));
    }
    let folder = std::env::temp_dir().join(format!("rebake-files-{}", std::process::id()));
    std::fs::create_dir_all(folder.join("buffers")).unwrap();
    std::fs::write(folder.join("room.gltf"), &beside).unwrap();
    std::fs::write(folder.join("buffers/room 1.bin"), &data).unwrap();
    let scene = load_path(&folder.join("room.gltf"), &LoadLimits::default());
    std::fs::remove_dir_all(&folder).unwrap();
    assert!(is_square(&scene.unwrap()));
}

/// A document goes with the files that it names, wherever they lie beside it; what stands alone goes as it is.
#[test]
fn documents_are_packed_with_their_files() {
    let data = square_data();
    let folder = std::env::temp_dir().join(format!("rebake-packed-{}", std::process::id()));
    let written = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, bytes).unwrap();
        path
    };
    written("a/buffers/room 1.bin", &data);
    written("b.bin", &data);
    let beside = written("a/room.gltf", format!("\u{feff} {}", with_uri("buffers/room%201.bin")).as_bytes());
    let above = written("a/c/room.gltf", with_uri("../../b.bin").as_bytes());
    let missing = written("missing.gltf", with_uri("nowhere.bin").as_bytes());
    let whole = written("whole.glb", &edited(&[]));
    let [beside, again, above, missing, whole] =
        [&beside, &beside, &above, &missing, &whole].map(|path| packed(path).unwrap());
    std::fs::remove_dir_all(&folder).unwrap();
    for archive in [&beside, &above] {
        assert!(archive.starts_with(b"PK") && is_square(&load(archive).unwrap()));
    }
    assert_eq!(beside, again);
    assert_eq!(missing, with_uri("nowhere.bin").into_bytes());
    assert_eq!(whole, edited(&[]));
    assert!(packed(&folder).is_err());
}

#[test]
fn data_within_the_document_is_read_as_browsers_read_it() {
    let code = STANDARD.encode(square_data());
    let (at, lines) = (code.len() / 2, |text: &str| text.replace('A', "\\nA "));
    let escaped = |text: &str| text.replace('+', "%2B").replace('/', "%2f").replace('=', "%3D");
    let all: String = square_data().iter().map(|byte| format!("%{byte:02X}")).collect();
    for uri in [
        format!("data:;base64,{code}"),
        format!("data:image/jpeg;charset=utf-8;base64,{code}"),
        format!("DATA:Application/Octet-Stream;BASE64, {code}"),
        format!(" data:application/gltf-buffer;base64,{}", lines(&code)),
        format!("data:;base64,{}", escaped(&code)),
        format!("data:;base64,{}", code.replace('+', "-").replace('/', "_").trim_end_matches('=')),
        format!("data:;base64,{}\\r\\n{}", &code[..at], &code[at..]),
        format!("data:application/octet-stream,{all}"),
    ] {
        let scene = load(with_uri(&uri).as_bytes()).unwrap_or_else(|error| panic!("{uri}: {error}"));
        assert!(is_square(&scene), "{uri}");
    }
}

#[test]
fn what_is_missing_or_too_much_is_told() {
    let (data, beside) = (square_data(), with_uri("room.bin"));
    let bomb = vec![0; 1 << 20];
    let limits = LoadLimits { max_unpacked_bytes: 1 << 16, ..LoadLimits::default() };
    let load = |bytes: &[u8]| super::super::load(bytes, &limits).map(|_| ()).unwrap_err();
    let cases = [
        (beside.clone().into_bytes(), "room.bin"),
        (with_uri("../../etc/room.bin").into_bytes(), "room.bin"),
        (archive(&[("room.gltf", beside.as_bytes())]), "room.bin"),
        (archive(&[("room.gltf", beside.as_bytes()), ("room.bin", &data[..100])]), "states 128 bytes"),
        (archive(&[("room.gltf", beside.as_bytes()), ("room.bin", &bomb)]), "unpacked"),
        (archive(&[("room.txt", b"")]), "neither"),
        (archive(&[("a.gltf", beside.as_bytes()), ("b.gltf", beside.as_bytes())]), "several"),
        (with_uri("data:application/octet-stream;base64,####").into_bytes(), "base64"),
        (with_uri("data:text/plain,hello").into_bytes(), "states 128 bytes, but there are 5"),
        (with_uri("data:application/octet-stream;base64").into_bytes(), "comma"),
        (b"PK\x03\x04 and no more".to_vec(), "not whole"),
    ];
    for (bytes, words) in cases {
        let error = load(&bytes);
        assert!(error.to_string().contains(words), "{words}: {error}");
    }
    assert!(matches!(load(&tests::glb(&with_uri("room.bin"), &data)), LoadError::Unsupported(_)));
}

#[test]
fn damaged_archives_do_not_panic() {
    let whole = archive(&[("room.gltf", with_uri("room.bin").as_bytes()), ("room.bin", &square_data())]);
    let mut random = fuzz::Random(5);
    let mut refused = 0;
    for _ in 0..2000 {
        let mut file = whole.clone();
        for _ in 0..=random.below(3) {
            let at = random.below(file.len());
            file[at] ^= 1 << random.below(8);
        }
        if random.below(8) == 0 {
            file.truncate(random.below(file.len()));
        }
        refused += usize::from(load(&file).is_err());
    }
    assert!(refused > 200, "{refused}");
}
