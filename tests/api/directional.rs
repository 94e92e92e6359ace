//! From where the light of elements comes, as a part.

use std::f32::consts::PI;

use glam::Vec3;
use rebake_core::delta::Frame;
use serde_json::{Value, json};

use super::glb;
use super::server::{Server, path_of};

/// Values of y, z and x, per element.
async fn bands(server: &Server, scene: &Value) -> Vec<[Vec3; 3]> {
    let answer = server.get(&format!("{}/lightmap?format=raw&part=directional", path_of(scene))).await;
    assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
    assert!(answer.header("x-rebake-estimated-rmse").parse::<f32>().unwrap() >= 0.0);
    let values = Frame::decode(&answer.body).unwrap().0.values;
    let count = values.len() / 3;
    (0..count).map(|slot| [values[slot], values[count + slot], values[2 * count + slot]]).collect()
}

/// Positions and normals of elements.
async fn places(server: &Server, scene: &Value) -> Vec<(Vec3, Vec3)> {
    let bytes = server.get(&format!("{}/elements", path_of(scene))).await.body;
    let number = |record: &[u8], k: usize| f32::from_le_bytes(record[4 * k..4 * k + 4].try_into().unwrap());
    let vector = |record: &[u8], k: usize| Vec3::from_array([0, 1, 2].map(|i| number(record, k + i)));
    bytes.chunks_exact(32).map(|record| (vector(record, 0), vector(record, 3))).collect()
}

/// Before any light is baked only that of the lamp is there, 20 cd at (2, 2, 2), exactly, where no surface is nearer
/// than two spacings, whose light is not looked up. It follows edits of the light.
#[tokio::test]
async fn it_points_to_the_lamp_and_follows_edits() {
    let server = Server::start().await;
    let upload = "/v1/scenes?bake=false&directional=true&spacing=0.25";
    let scene = server.post_glb(upload, glb::room().bytes()).await.json(201);
    let (found, places) = (bands(&server, &scene).await, places(&server, &scene).await);
    assert_eq!(found.len(), places.len());
    let inner = |p: Vec3| p.y < 0.01 && (0.7..3.3).contains(&p.x) && (1.7..3.3).contains(&p.z);
    let floor: Vec<_> = found.iter().zip(&places).filter(|(_, (position, _))| inner(*position)).collect();
    assert!(floor.len() > 10, "{}", floor.len());
    for ([y, z, x], (position, _)) in floor {
        let (direction, w) = (Vec3::new(x.x, y.x, z.x), Vec3::splat(2.0) - *position);
        let expected = w.normalize() * (20.0 / w.length_squared() * (3.0 / (4.0 * PI)).sqrt());
        assert!((direction - expected).length() < 1e-3 * expected.length(), "{position}: {direction} {expected}");
    }
    let off = json!({ "op": "relight", "lights": [{ "light": "lamp", "intensity": 0 }],
        "budget": { "samples_per_element": 4 } });
    server.end_of(&server.edit(&scene, &off).await).await;
    let dark = bands(&server, &scene).await;
    assert!(dark.iter().flatten().all(|c| c.length() < 1e-3), "the lamp is off");
    server.stop().await;
}

#[tokio::test]
async fn pictures_have_a_channel_for_each() {
    let server = Server::start().await;
    let scene = server.baked_room("?samples_per_element=4").await;
    for path in ["lightmap?format=exr&part=directional", "atlas/0?part=directional&precision=float"] {
        let answer = server.get(&format!("{}/{path}", path_of(&scene))).await;
        assert_eq!((answer.status.as_u16(), answer.header("content-type")), (200, "image/x-exr"), "{path}");
        let head = String::from_utf8_lossy(&answer.body[..1000]).into_owned();
        assert!(["y.R", "z.G", "x.B", "directional"].iter().all(|name| head.contains(name)), "{path}: {head}");
    }
    for (query, field) in [
        ("lightmap?part=directional&format=glb", "format"),
        ("lightmap?part=directional&layer=full", "layer"),
        ("atlas/0?part=directional&format=png", "format"),
        ("lightmap/deltas?since=0&part=directional", "part"),
    ] {
        let answer = server.get(&format!("{}/{query}", path_of(&scene))).await;
        let detail = answer.problem(400, "invalid-query");
        assert_eq!(answer.json(400)["field"], field, "{query}: {detail}");
    }
    server.stop().await;
}
