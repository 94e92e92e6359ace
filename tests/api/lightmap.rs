//! Whole light maps and elements.

use rebake_core::delta::Frame;
use reqwest::Method;

use super::server::{Answer, Server, path_of};

#[tokio::test]
async fn a_light_map_comes_in_three_formats() {
    let server = Server::start().await;
    let scene = server.baked_room("?samples_per_element=8").await;
    let path = format!("{}/lightmap", path_of(&scene));
    for (query, accept, kind, magic) in [
        ("?format=exr", "*/*", "image/x-exr", &[0x76, 0x2f, 0x31, 0x01][..]),
        ("?format=glb", "*/*", "model/gltf-binary", b"glTF"),
        ("?format=raw", "image/x-exr", "application/vnd.rebake.delta", b"RBKD"),
        ("", "*/*", "application/vnd.rebake.delta", b"RBKD"),
        ("", "image/x-exr, */*;q=0.1", "image/x-exr", &[0x76, 0x2f, 0x31, 0x01]),
        ("", "model/gltf-binary", "model/gltf-binary", b"glTF"),
    ] {
        let request = server.request(Method::GET, &format!("{path}{query}")).header("accept", accept);
        let answer = Answer::to(request).await;
        assert_eq!(answer.status, 200, "{query} {accept} {answer:?}");
        assert_eq!(answer.header("content-type"), kind);
        assert_eq!(answer.header("etag"), format!("\"{}\"", scene["version"]));
        assert!(answer.body.starts_with(magic), "{query} {accept}");
    }
    server.get(&format!("{path}?format=bmp")).await.problem(400, "invalid-query");
    server.get(&format!("{path}?layer=lamp")).await.problem(400, "invalid-query");
    server.get(&format!("{path}?colour=1")).await.problem(400, "invalid-query");
    server.stop().await;
}

#[tokio::test]
async fn layers_add_up() {
    let server = Server::start().await;
    let scene = server.baked_room("?mode=indirect&samples_per_element=8").await;
    let layer = async |layer: &str| {
        let body = server.get(&format!("{}/lightmap?format=raw{layer}", path_of(&scene))).await.body;
        Frame::decode(&body).unwrap().0.values
    };
    let (full, direct) = (layer("&layer=full").await, layer("&layer=direct").await);
    let (indirect, default) = (layer("&layer=indirect").await, layer("").await);
    assert_eq!(indirect, default);
    assert!(full.iter().zip(&direct).zip(&indirect).all(|((f, d), i)| *f == *d + *i));
    assert!(direct.iter().any(|value| value.x > 0.0) && indirect.iter().any(|value| value.x > 0.0));
    server.stop().await;
}

#[tokio::test]
async fn a_client_that_has_the_version_gets_304() {
    let server = Server::start().await;
    let scene = server.baked_room("?samples_per_element=4").await;
    for path in ["lightmap", "lightmap?format=exr", "elements"] {
        let path = format!("{}/{path}", path_of(&scene));
        let tag = server.get(&path).await.header("etag").to_owned();
        for (known, status) in
            [(tag.clone(), 304), (format!("W/{tag}"), 304), ("*".to_owned(), 304), ("\"999\"".to_owned(), 200)]
        {
            let request = server.request(Method::GET, &path).header("if-none-match", &known);
            let answer = Answer::to(request).await;
            assert_eq!(answer.status, status, "{path} {known}");
            assert_eq!(answer.header("etag"), tag);
            assert_eq!(answer.body.is_empty(), status == 304);
        }
    }
    server.stop().await;
}

#[tokio::test]
async fn compressed_bodies_are_the_same_bodies() {
    let server = Server::start().await;
    let scene = server.baked_room("?samples_per_element=4").await;
    for path in ["lightmap?format=raw", "elements"] {
        let path = format!("{}/{path}", path_of(&scene));
        let plain = server.get(&path).await.body;
        for coding in ["gzip", "zstd"] {
            let request = server.request(Method::GET, &path).header("accept-encoding", coding);
            let answer = Answer::to(request).await;
            assert_eq!(answer.header("content-encoding"), coding);
            let unpacked = match coding {
                "gzip" => {
                    let mut unpacked = Vec::new();
                    std::io::copy(&mut flate2::read::GzDecoder::new(&answer.body[..]), &mut unpacked).unwrap();
                    unpacked
                }
                _ => zstd::decode_all(&answer.body[..]).unwrap(),
            };
            assert!(unpacked == plain, "{path} {coding}");
        }
    }
    server.stop().await;
}

#[tokio::test]
async fn elements_lie_on_their_objects_in_world_space() {
    let server = Server::start().await;
    let scene = server.baked_room("?samples_per_element=4").await;
    let bytes = server.get(&format!("{}/elements", path_of(&scene))).await.body;
    assert_eq!(bytes.len() as u64, 32 * scene["elements"].as_u64().unwrap());
    let objects = scene["objects"].as_array().unwrap();
    let mut area = 0.0;
    for (slot, record) in bytes.chunks_exact(32).enumerate() {
        let float = |k: usize| f32::from_le_bytes(record[4 * k..4 * k + 4].try_into().unwrap());
        let object = &objects[u32::from_le_bytes(record[28..].try_into().unwrap()) as usize];
        let range = &object["elements"];
        let first = range["first"].as_u64().unwrap();
        assert!((first..first + range["count"].as_u64().unwrap()).contains(&(slot as u64)));
        for k in 0..3 {
            let bound = |end: &str| object["bounds"][end][k].as_f64().unwrap() as f32;
            assert!((bound("min") - 1e-3..=bound("max") + 1e-3).contains(&float(k)), "{slot}");
        }
        let normal = (float(3).powi(2) + float(4).powi(2) + float(5).powi(2)).sqrt();
        assert!((normal - 1.0).abs() < 1e-4);
        area += float(6);
    }
    let (room, cupboard) = (2.0 * (16.0 + 12.0 + 12.0), 2.0 * (1.48 + 0.5 + 0.74));
    assert!((area - (room + cupboard)).abs() < 0.1, "{area}");
    server.stop().await;
}
