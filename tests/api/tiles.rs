//! Tile after tile: what clients ask for, what they see, and what a newer edit does to it.

use serde_json::{Value, json};

use super::glb::translation;
use super::server::{Server, next_event, path_of};

/// More samples than a job gets in the time of a test.
const MANY: u32 = 65_536;

fn edit(asset: &str, name: &str, x: f64, tiles: &Value, samples: u32) -> Value {
    json!({ "op": "insert", "asset": asset, "name": name, "transform": translation(x, 0.01, 2.0),
            "focus": { "point": [x, 0, 2], "radius": 1.5 }, "tiles": tiles,
            "budget": { "samples_per_element": samples } })
}

#[tokio::test]
async fn every_tile_is_published_when_it_is_done() {
    let server = Server::start().await;
    let asset = server.crate_asset().await;
    let scene = server.baked_room("?samples_per_element=16").await;
    let mut shown = Vec::new();
    for (k, tiles) in [
        json!({ "size": 16, "samples": 4, "mode": "incremental" }),
        json!({ "size": 16, "samples": 4, "mode": "continuous" }),
        json!({ "size": 16, "samples": 4, "mode": "global" }),
        json!({}),
    ]
    .iter()
    .enumerate()
    {
        let mut events = server.client.scene_events(scene["id"].as_str().unwrap(), None).await.unwrap();
        let job = server.edit(&scene, &edit(&asset, &format!("crate-{k}"), 1.6 + 0.2 * k as f64, tiles, 12)).await;
        let mut samples = Vec::new();
        let ended = loop {
            let (kind, _, data) = next_event(&mut events).await.expect("the scene stays");
            match kind.as_str() {
                "snapshot" if data["job"] == job => samples.extend(data["samples_per_element"].as_u64()),
                "job" if data["id"] == job && data["finished_at"].is_string() => break data,
                _ => {}
            }
        };
        assert_eq!(ended["state"], "succeeded", "{ended}");
        let remove =
            json!({ "op": "remove", "objects": [format!("crate-{k}")], "budget": { "samples_per_element": 4 } });
        server.end_of(&server.edit(&scene, &remove).await).await;
        shown.push((samples.iter().filter(|n| **n == 0).count(), samples.last().copied()));
    }
    // (versions before the rest follows, samples at the end)
    let [incremental, continuous, global, whole] = shown[..] else { panic!("{shown:?}") };
    assert_eq!((incremental.1, continuous.1, global.1, whole.1), (Some(4), Some(12), Some(12), Some(12)), "{shown:?}");
    assert!(incremental.0 > 3 && continuous.0 > 3, "{shown:?}");
    assert_eq!(global.0, 1, "one round of four samples: {shown:?}");
    assert!((1..incremental.0).contains(&whole.0), "larger tiles are fewer: {shown:?}");
    server.stop().await;
}

/// An edit that goes tile by tile makes room for a newer one: it ends with a complete map, not with all its samples.
#[tokio::test]
async fn a_newer_edit_begins_at_its_own_place() {
    let server = Server::start().await;
    let asset = server.crate_asset().await;
    let scene = server.baked_room("?samples_per_element=16").await;
    let tiles = json!({ "size": 16, "samples": 4096 });
    let first = server.edit(&scene, &edit(&asset, "a", 1.5, &tiles, MANY)).await;
    // Its first tile is under way: alone it would take until long after the test.
    server.until(&first, |job| job["progress"]["pass"].is_string()).await;
    let second = server.edit(&scene, &edit(&asset, "b", 3.0, &json!({ "samples": 4 }), 16)).await;
    let ended = server.end_of(&first).await;
    assert_eq!(ended["state"], "succeeded", "{ended}");
    let samples = ended["progress"]["samples_per_element"].as_u64().unwrap();
    assert!((1..u64::from(MANY)).contains(&samples), "{ended}");
    assert_eq!(server.end_of(&second).await["state"], "succeeded");
    let lit = server.get(&path_of(&scene)).await.json(200);
    assert_eq!(lit["unlit_edits"], 0);
    assert!(lit["estimated_rmse"].is_number(), "{lit}");
    server.stop().await;
}

#[tokio::test]
async fn an_edit_without_tiles_keeps_its_samples() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("").await;
    use super::engine::Step::{Finish, Round};
    script.run(&[Round, Finish]);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    let paint = |albedo: f64, tiles: Option<Value>| {
        let mut edit = json!({ "op": "material", "object": "cupboard", "albedo": [albedo, albedo, albedo] });
        tiles.into_iter().for_each(|tiles| edit["tiles"] = tiles);
        edit
    };
    let relight = json!({ "op": "relight", "lights": [{ "light": "lamp", "intensity": 3 }] });
    let plain = server.edit(&scene, &paint(0.3, None)).await;
    script.run(&[Round]);
    server.until(&plain, |job| job["progress"]["samples_per_element"] == 4).await;
    let behind = server.edit(&scene, &relight).await;
    script.run(&[Round]);
    server.until(&plain, |job| job["progress"]["samples_per_element"] == 8).await;
    script.run(&[Finish, Round, Finish]);
    assert_eq!(server.end_of(&plain).await["state"], "succeeded");
    assert_eq!(server.end_of(&behind).await["state"], "succeeded");

    // With tiles it ends by itself as soon as its map is complete.
    let tiled = server.edit(&scene, &paint(0.8, Some(json!({})))).await;
    script.run(&[Round]);
    server.until(&tiled, |job| job["progress"]["samples_per_element"] == 4).await;
    let behind =
        server.edit(&scene, &json!({ "op": "relight", "lights": [{ "light": "lamp", "intensity": 5 }] })).await;
    assert_eq!(server.end_of(&tiled).await["state"], "succeeded");
    script.run(&[Round, Finish]);
    assert_eq!(server.end_of(&behind).await["state"], "succeeded");
    server.stop().await;
}
