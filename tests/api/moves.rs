//! Objects that are moved step by step: no step leaves its noise in the next.

use serde_json::{Value, json};

use super::glb::{self, translation};
use super::server::{Server, path_of};

async fn raw(server: &Server, scene: &Value) -> Vec<u8> {
    server.get(&format!("{}/lightmap?format=raw", path_of(scene))).await.body
}

#[tokio::test]
async fn many_moves_of_an_object_leave_the_noise_of_one() {
    let server = Server::start().await;
    let upload = server.post_glb("/v1/scenes?spacing=0.2&samples_per_element=64", glb::room().bytes());
    let scene = upload.await.json(201);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    let asset = server.crate_asset().await;
    let insert = json!({ "op": "insert", "asset": asset, "name": "crate", "transform": translation(1.0, 0.01, 2.0) });
    server.end_of(&server.edit(&scene, &insert).await).await;
    let mut stated = Vec::new();
    let mut maps = Vec::new();
    for k in 0..12 {
        let at = translation(1.2 + 0.05 * f64::from(k), 0.01, 2.0);
        let step = json!({ "op": "move", "object": "crate", "transform": at, "budget": { "samples_per_element": 8 } });
        let job = server.end_of(&server.edit(&scene, &step).await).await;
        assert_eq!(job["state"], "succeeded", "{job}");
        stated.push(server.get(&path_of(&scene)).await.json(200)["estimated_rmse"].as_f64().unwrap());
        maps.push(raw(&server, &scene).await);
    }
    // Twelve updates one on top of the other would have three times the noise of one.
    assert!(stated[11] < 1.2 * stated[0], "{stated:?}");
    // A step back is still what was there before it.
    let back = json!({ "op": "move", "object": "crate", "transform": translation(1.7, 0.01, 2.0) });
    server.end_of(&server.edit(&scene, &back).await).await;
    let restored = raw(&server, &scene).await;
    assert!(values(&restored) == values(&maps[10]), "taken back, a step leaves no trace");
}

/// The values of a raw map: one frame after the other, whatever its version.
fn values(raw: &[u8]) -> Vec<[u32; 3]> {
    let mut values = Vec::new();
    let mut decoder = rebake_core::delta::Decoder::new();
    decoder.push(raw);
    while let Some((frame, _)) = decoder.next_frame().unwrap() {
        frame.apply(&mut values).unwrap();
    }
    values.iter().map(|value: &glam::Vec3| value.to_array().map(f32::to_bits)).collect()
}
