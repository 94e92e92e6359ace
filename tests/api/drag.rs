//! Lights that are dragged: a frame at once, the exact light where they rest.

use serde_json::{Value, json};

use super::glb;
use super::server::{Server, next_event, path_of};

fn step(x: f64, samples: u32) -> Value {
    json!({ "op": "move_light", "light": "lamp-2", "position": [x, 2.0, 2.0], "drag": true,
            "budget": { "samples_per_element": samples } })
}

async fn scene(server: &Server) -> Value {
    let glb = glb::room().point_light("lamp-2", [1.0, 2.5, 3.0], 10.0).bytes();
    let scene = server.post_glb("/v1/scenes?spacing=0.3&samples_per_element=16", glb).await.json(201);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    server.get(&path_of(&scene)).await.json(200)
}

#[tokio::test]
async fn a_dragged_light_ends_where_it_rests_with_the_exact_light() {
    let server = Server::start().await;
    let scene = scene(&server).await;
    // More samples than the first job gets: the next step ends it.
    const MANY: u32 = 65_536;
    let mut jobs = Vec::new();
    for k in 0..6 {
        let samples = if k == 0 { MANY } else { 16 };
        jobs.push(server.edit(&scene, &step(1.0 + 0.2 * f64::from(k), samples)).await);
    }
    jobs.push(server.edit(&scene, &step(2.5, 64)).await);
    let last = jobs.len() - 1;
    for (k, job) in jobs.iter().enumerate() {
        let job = server.end_of(job).await;
        assert_eq!(job["state"], "succeeded", "{job}");
        let samples = job["progress"]["samples_per_element"].as_u64().unwrap_or(0);
        assert!(k == last || samples < u64::from(MANY) || !job["merged_into"].is_null(), "{job}");
    }
    let dragged = server.get(&path_of(&scene)).await.json(200);
    let lamp = dragged["lights"].as_array().unwrap().iter().find(|l| l["name"] == "lamp-2").unwrap().clone();
    assert_eq!((&lamp["layer"], &lamp["position"]), (&json!("lamp-2"), &json!([2.5, 2.0, 2.0])));
    // What is there at rest is an exact light map: it states its error.
    assert!(dragged["estimated_rmse"].as_f64().is_some_and(|rmse| rmse > 0.0), "{dragged}");
    // A step that comes later has its frame first: a version without a stated error.
    let id = scene["id"].as_str().unwrap();
    let mut events = server.client.scene_events(id, None).await.unwrap();
    let job = server.edit(&scene, &step(1.5, 16)).await;
    let mut snapshots = Vec::new();
    loop {
        let (kind, _, data) = next_event(&mut events).await.expect("the scene stays");
        match kind.as_str() {
            "snapshot" if data["job"] == job => snapshots.push(data),
            "job" if data["id"] == job && data["state"] == "succeeded" => break,
            _ => {}
        }
    }
    let first = snapshots.iter().find(|s| !s["samples_per_element"].is_null()).expect("a snapshot with light");
    assert_eq!((&first["samples_per_element"], first["estimated_rmse"].is_null()), (&json!(1), true), "{first}");
    assert!(snapshots.iter().any(|s| s["samples_per_element"] == 16 && s["estimated_rmse"].is_number()));
}
