//! Ambient occlusion as a part.

use glam::Vec3;
use rebake_core::delta::Frame;
use serde_json::{Value, json};

use super::server::{Answer, Server, path_of};

async fn ao(server: &Server, scene: &Value, query: &str) -> (Vec<Vec3>, Answer) {
    let answer = server.get(&format!("{}/lightmap?format=raw&part=ao{query}", path_of(scene))).await;
    assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
    (Frame::decode(&answer.body).unwrap().0.values, answer)
}

fn mean(values: &[Vec3]) -> f32 {
    values.iter().map(|value| value.x).sum::<f32>() / values.len() as f32
}

#[tokio::test]
async fn ambient_occlusion_is_a_part_of_files_and_pages() {
    let server = Server::start().await;
    // It needs no light.
    let scene = server.room("?bake=false").await;
    let (near, answer) = ao(&server, &scene, "&ao_distance=0.3").await;
    assert_eq!(near.len() as u64, scene["elements"].as_u64().unwrap());
    assert!(near.iter().all(|value| *value == Vec3::splat(value.x) && (0.0..=1.0).contains(&value.x)));
    assert_eq!(answer.header("x-rebake-ao-distance"), "0.3");
    let stated: f32 = answer.header("x-rebake-estimated-rmse").parse().unwrap();
    assert!(stated > 0.0 && stated < 0.07, "{stated}");
    let (far, _) = ao(&server, &scene, "&ao_distance=9").await;
    assert!(mean(&near) > 0.3 && mean(&far) < 0.001, "a closed room: {} {}", mean(&near), mean(&far));
    assert_eq!(ao(&server, &scene, "&ao_distance=0.3").await.0, near, "the same rays");
    let (_, default) = ao(&server, &scene, "").await;
    assert!(default.header("x-rebake-ao-distance").parse::<f32>().unwrap() > 0.3);
    for (format, kind) in
        [("exr", "image/x-exr"), ("glb", "model/gltf-binary"), ("glb&layout=atlas", "model/gltf-binary")]
    {
        let answer = server.get(&format!("{}/lightmap?format={format}&part=ao", path_of(&scene))).await;
        assert_eq!((answer.status.as_u16(), answer.header("content-type")), (200, kind), "{format}");
    }
    let page = server.get(&format!("{}/atlas/0?part=ao&ao_distance=0.3", path_of(&scene))).await;
    assert_eq!((page.status.as_u16(), page.header("content-type")), (200, "image/x-exr"));
    assert_eq!(page.header("x-rebake-estimated-rmse").parse::<f32>().unwrap(), stated);
    let text = String::from_utf8_lossy(&page.body);
    assert!(text.contains("ambientOcclusionDistance"), "pages say what they are");
    server.stop().await;
}

#[tokio::test]
async fn it_follows_the_objects() {
    let server = Server::start().await;
    let scene = server.baked_room("?samples_per_element=4").await;
    let room = &scene["objects"][0];
    assert_eq!(room["name"], "room");
    let number = |field: &str| room["elements"][field].as_u64().unwrap() as usize;
    let own = number("first")..number("first") + number("count");
    let (before, _) = ao(&server, &scene, "&ao_distance=0.8").await;
    let hide = json!({ "op": "hide", "objects": ["cupboard"], "budget": { "samples_per_element": 4 } });
    server.end_of(&server.edit(&scene, &hide).await).await;
    let (after, _) = ao(&server, &scene, "&ao_distance=0.8").await;
    let (before, after) = (mean(&before[own.clone()]), mean(&after[own]));
    assert!(after > before + 0.002, "{before} {after}");
    server.stop().await;
}

#[tokio::test]
async fn requests_that_make_no_sense_are_refused() {
    let server = Server::start().await;
    let scene = server.room("?bake=false").await;
    for (query, field) in [
        ("lightmap?part=ao&ao_distance=0", "ao_distance"),
        ("lightmap?part=ao&ao_distance=nan", "ao_distance"),
        ("lightmap?part=ao&ao_distance=far", "ao_distance"),
        ("lightmap?part=error&ao_distance=1", "ao_distance"),
        ("lightmap?part=ao&layer=full", "layer"),
        ("atlas/0?part=ao&ao_distance=-1", "ao_distance"),
        ("atlas/0?ao_distance=1", "ao_distance"),
        ("lightmap/deltas?since=0&part=ao", "part"),
    ] {
        let answer = server.get(&format!("{}/{query}", path_of(&scene))).await;
        let detail = answer.problem(400, "invalid-query");
        assert_eq!(answer.json(400)["field"], field, "{query}: {detail}");
    }
    server.stop().await;
}
