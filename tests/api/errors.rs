//! Whatever comes in, what goes out is a problem document, and the service lives on.

use std::time::Duration;

use reqwest::{Method, StatusCode};
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use super::glb::{crate_asset, pack, room};
use super::server::{Answer, Server, patiently};

#[tokio::test]
async fn paths_methods_and_calls_to_come() {
    let server = Server::start().await;
    server.get("/nothing").await.problem(404, "not-found");
    server.get("/v1/nothing").await.problem(404, "not-found");
    server.get("/v1/scenes/%FF").await.problem(400, "bad-request");
    server.get("/v1/scenes/s01-abcdef").await.problem(404, "unknown-scene");
    server.get("/v1/jobs/x").await.problem(404, "unknown-job");
    let put = Answer::to(server.request(Method::PUT, "/v1/scenes")).await;
    put.problem(405, "method-not-allowed");
    assert!(put.header("allow").contains("POST"), "{put:?}");
    assert_eq!(server.get("/healthz").await.json(200)["status"], "ok");
    assert_eq!(server.get("/readyz").await.json(200)["status"], "ok");
    let told = server.get("/problems/queue-full").await;
    assert!(told.status == 200 && String::from_utf8(told.body).unwrap().contains("429"));
    server.get("/problems/nothing").await.problem(404, "not-found");
    let request = server.request(Method::GET, "/healthz").header("x-request-id", "abc-1");
    assert_eq!(request.send().await.unwrap().headers()["x-request-id"], "abc-1");
    assert!(!server.get("/healthz").await.header("x-request-id").is_empty());
    server.stop().await;
}

#[tokio::test]
async fn uploads_with_bad_queries_and_headers() {
    let server = Server::start().await;
    for (query, field) in [
        ("spacing=0", "spacing"),
        ("spacing=-1", "spacing"),
        ("spacing=nan", "spacing"),
        ("spacing=wide", "spacing"),
        ("mode=half", "mode"),
        ("environment=1,2", "environment"),
        ("environment=1,2,-3", "environment"),
        ("environment=1,2,inf", "environment"),
        ("bake=maybe", "bake"),
        ("name=", "name"),
        ("name=a%00b", "name"),
        ("samples_per_element=0", "samples_per_element"),
        ("max_seconds=-1", "max_seconds"),
        ("target_rmse=nan", "target_rmse"),
        ("max_albedo=1", "max_albedo"),
        ("colour=red", "colour"),
        ("spacing=1&spacing=2", "spacing"),
    ] {
        let answer = server.post_glb(&format!("/v1/scenes?{query}"), room().bytes()).await;
        let detail = answer.problem(400, "invalid-query");
        assert!(detail.contains(field), "{query}: {detail}");
    }
    for kind in ["text/plain", "application/json", ""] {
        let mut request = server.request(Method::POST, "/v1/scenes").body(room().bytes());
        if !kind.is_empty() {
            request = request.header("content-type", kind);
        }
        Answer::to(request).await.problem(415, "unsupported-media-type");
    }
    let octets = server.request(Method::POST, "/v1/scenes?bake=false").body(room().bytes());
    let octets = octets.header("content-type", "application/octet-stream; charset=binary");
    Answer::to(octets).await.json(201);
    server.stop().await;
}

/// Fifty and more broken files, each with what is wrong with it.
fn broken() -> Vec<(String, Vec<u8>)> {
    let whole = room().bytes();
    let mut files = vec![
        ("empty".to_owned(), Vec::new()),
        ("text".to_owned(), b"hello".to_vec()),
        ("another format".to_owned(), b"glTF\x01\x00\x00\x00\x0c\x00\x00\x00".to_vec()),
        ("no bin chunk".to_owned(), pack(&room().document(), &[])),
        ("json is a list".to_owned(), pack(&json!([]), &[])),
    ];
    for part in [1, 4, 11, 12, 19, 20, 100, whole.len() / 2, whole.len() - 1] {
        files.push((format!("cut at {part}"), whole[..part].to_vec()));
    }
    for (place, byte) in [(0, b'X'), (4, 9), (8, 0), (12, 255), (15, 255), (16, 0), (20, b'}')] {
        let mut file = whole.clone();
        file[place] = byte;
        files.push((format!("byte {place} is {byte}"), file));
    }
    let changes: Vec<(&str, Value)> = vec![
        ("/asset/version", json!("9.0")),
        ("/buffers/0/byteLength", json!(1_000_000_000)),
        ("/buffers/0/byteLength", json!(-1)),
        ("/buffers/0/uri", json!("file:///etc/passwd")),
        ("/buffers/0/uri", json!("http://127.0.0.1:1/x.bin")),
        ("/bufferViews/0/byteOffset", json!(999_999_999u64)),
        ("/bufferViews/0/byteLength", json!(4_294_967_295u64)),
        ("/bufferViews/0/buffer", json!(3)),
        ("/bufferViews/0/byteStride", json!(1)),
        ("/accessors/0/bufferView", json!(77)),
        ("/accessors/0/count", json!(1_000_000_000u64)),
        ("/accessors/0/count", json!(18_446_744_073_709_551_615u64)),
        ("/accessors/0/byteOffset", json!(3)),
        ("/accessors/0/componentType", json!(5120)),
        ("/accessors/0/componentType", json!(1)),
        ("/accessors/0/type", json!("MAT9")),
        ("/accessors/1/componentType", json!(5126)),
        ("/accessors/1/count", json!(7_000_000)),
        ("/meshes/0/primitives/0/attributes/POSITION", json!(55)),
        ("/meshes/0/primitives/0/attributes", json!({})),
        ("/meshes/0/primitives/0/indices", json!(99)),
        ("/meshes/0/primitives/0/indices", json!(0)),
        ("/meshes/0/primitives/0/material", json!(99)),
        ("/meshes/0/primitives", json!(3)),
        ("/nodes/0/mesh", json!(9)),
        ("/nodes/0/children", json!([0])),
        ("/nodes/0/children", json!([99])),
        ("/nodes/0/matrix", json!([1, 2, 3])),
        ("/nodes/0/scale", json!([1e300, 1, 1])),
        ("/nodes/0/translation", json!([1e300, 0, 0])),
        ("/scenes/0/nodes", json!([5, 6, 7])),
        ("/scene", json!(4)),
        ("/materials/0/pbrMetallicRoughness/baseColorFactor", json!([1, 1])),
        ("/extensionsRequired", json!(["KHR_gaussian_splatting"])),
        ("/extensionsRequired", json!(["EXT_unheard_of"])),
        ("/extensions/KHR_lights_punctual/lights/0/type", json!("laser")),
        ("/nodes/2/extensions/KHR_lights_punctual/light", json!(9)),
    ];
    for (pointer, value) in changes {
        let (parent, key) = pointer.rsplit_once('/').unwrap();
        let file = room().bytes_with(|document| match document.pointer_mut(parent).unwrap() {
            Value::Array(list) => list[key.parse::<usize>().unwrap()] = value.clone(),
            parent => parent[key] = value.clone(),
        });
        files.push((format!("{pointer} = {value}"), file));
    }
    files
}

#[tokio::test]
async fn malformed_uploads_are_refused_with_a_reason() {
    let server = Server::start().await;
    let files = broken();
    assert!(files.len() >= 50, "{}", files.len());
    let mut accepted = Vec::new();
    for (name, file) in files {
        for path in ["/v1/scenes?bake=false&spacing=1", "/v1/assets"] {
            let answer = server.post_glb(path, file.clone()).await;
            if ![400, 413, 422].contains(&answer.status.as_u16()) {
                accepted.push(format!("{name} at {path}: {}", answer.status));
                continue;
            }
            assert!(!answer.json(answer.status.as_u16())["detail"].as_str().unwrap().is_empty(), "{name}");
        }
    }
    assert_eq!(accepted, [""; 0]);
    assert_eq!(server.get("/v1/scenes").await.json(200)["items"], json!([]));
    server.room("").await;
    server.stop().await;
}

#[tokio::test]
async fn what_is_too_large_is_refused() {
    let server = Server::with(|config| {
        config.limits.upload_bytes = 100_000;
        config.limits.triangles = 24;
        config.limits.elements = 1000;
    });
    let server = server.await;
    let big = server.post_glb("/v1/scenes", vec![0; 100_001]).await;
    assert!(big.problem(413, "payload-too-large").contains("100000"));
    // Without a length the limit holds all the same.
    let chunks = futures_util::stream::iter((0..20).map(|_| Ok::<_, std::io::Error>(vec![0u8; 10_000])));
    let body = reqwest::Body::wrap_stream(chunks);
    let request = server.request(Method::POST, "/v1/scenes").header("content-type", "model/gltf-binary").body(body);
    Answer::to(request).await.problem(413, "payload-too-large");
    let mut three = room();
    three.cuboid("third", [2.0, 0.1, 2.0], [2.5, 0.5, 2.5], 0.5, false);
    server.post_glb("/v1/scenes", three.bytes()).await.problem(413, "scene-too-large");
    server.post_glb("/v1/scenes?spacing=0.01", room().bytes()).await.problem(413, "scene-too-large");
    server.post_glb("/v1/assets", crate_asset()).await.json(201);
    server.stop().await;
}

#[tokio::test]
async fn slow_and_broken_clients_are_let_go() {
    let server = Server::with(|config| {
        config.timeouts.header = Duration::from_millis(200);
        config.timeouts.body = Duration::from_millis(200);
    });
    let server = server.await;
    let address = server.base.trim_start_matches("http://").to_owned();
    let talk = async |text: &str| {
        let mut stream = TcpStream::connect(&address).await.unwrap();
        stream.write_all(text.as_bytes()).await.unwrap();
        let mut answer = Vec::new();
        // Either an answer and the end, or the end at once.
        let _ = patiently(stream.read_to_end(&mut answer)).await;
        String::from_utf8_lossy(&answer).into_owned()
    };
    let head = "POST /v1/scenes HTTP/1.1\r\nhost: localhost\r\ncontent-type: model/gltf-binary\r\n";
    assert!(talk(&format!("{head}content-length: 100\r\nconnection: close\r\n\r\nglTF")).await.contains("408"));
    assert!(!talk("GET /healthz HTTP/1.1\r\nhost:").await.contains("200"));
    assert!(talk("NONSENSE\r\n\r\n").await.contains("400"));
    assert!(talk(&format!("{head}content-length: -5\r\n\r\n")).await.contains("400"));
    assert_eq!(server.get("/healthz").await.status, StatusCode::OK);
    server.stop().await;
}
