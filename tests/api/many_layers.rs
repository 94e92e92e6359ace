//! More layers than are carried side by side: each where it matters, and what is left of them as one of its own.

use rebake_core::delta::Frame;
use serde_json::{Value, json};

use super::deltas::{Follower, open};
use super::durable::fast_directory;
use super::glb::{self, translation};
use super::layers::{assert_adds_up, bits, edited, layer_names, relight, values};
use super::server::{Server, path_of};

/// Lamps of the room beside its own.
const LAMPS: usize = 19;

async fn many_lamps(server: &Server) -> Value {
    let mut room = glb::room();
    for i in 0..LAMPS {
        let (x, z) = (0.4 + 0.8 * (i % 5) as f32, 0.4 + 0.8 * (i / 5) as f32);
        room.point_light(&format!("l{i}"), [x, 0.3, z], 0.5 + i as f32 / 8.0);
    }
    let upload = "/v1/scenes?spacing=0.5&samples_per_element=4&layers=each";
    let scene = server.post_glb(upload, room.bytes()).await.json(201);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    server.get(&path_of(&scene)).await.json(200)
}

#[tokio::test]
async fn they_are_relit_followed_and_survive_a_restart() {
    let directory = fast_directory();
    let start = async || Server::with(|config| config.data_dir = Some(directory.path().to_owned())).await;
    let server = start().await;
    let scene = many_lamps(&server).await;
    let names = layer_names(&scene);
    assert_eq!(names.len(), LAMPS + 2, "{names:?}");
    let rest = &scene["layers"][0];
    assert_eq!(
        (&rest["name"], &rest["lights"], &rest["weight"]),
        (&json!("rest"), &json!([]), &json!([1.0, 1.0, 1.0]))
    );
    assert_adds_up(&server, &scene).await;

    let asset = server.crate_asset().await;
    let insert = json!({ "op": "insert", "asset": asset, "name": "a", "transform": translation(2.0, 0.01, 2.0),
        "budget": { "samples_per_element": 4 } });
    let mut stream = open(&server, &scene, "since=0&follow=true&layer=l7").await;
    let (mut follower, mut away) = (Follower::default(), Follower::default());
    for edit in [
        relight("l7", 9.0),
        insert,
        relight("l3", 0.0),
        relight("l3", 2.0),
        json!({ "op": "remove_light", "light": "l5" }),
    ] {
        let since = away.version;
        let (job, now) = edited(&server, &scene, &edit).await;
        if edit["op"] == "relight" {
            assert_eq!(job["progress"]["rays"], 0);
        }
        assert_adds_up(&server, &now).await;
        let version = job["progress"]["version"].as_u64().unwrap();
        follower.reach(&mut stream, version).await;
        let expected = bits(&values(&server, &scene, "l7").await);
        assert_eq!(follower.bits(), expected, "{edit}");
        let frames = server.get(&format!("{}/lightmap/deltas?since={since}&layer=l7", path_of(&scene))).await.body;
        if edit["op"] == "relight" && since > 0 {
            assert!(Frame::decode(&frames).unwrap().0.values.is_empty(), "{edit}");
        }
        away.take(&frames);
        assert_eq!((away.bits(), away.version), (expected, version));
    }
    // What is filtered adds up, too, and what is taken back is as it was.
    let before = bits(&values(&server, &scene, "").await);
    let (_, dark) = edited(&server, &scene, &relight("l9", 0.0)).await;
    assert_ne!(bits(&values(&server, &scene, "").await), before);
    assert!(dark["light_error"]["noise"].as_f64().unwrap() > 0.0);
    edited(&server, &scene, &json!({ "op": "undo" })).await;
    assert_eq!(bits(&values(&server, &scene, "").await), before);
    let now = server.get(&path_of(&scene)).await.json(200);
    let last = bits(&values(&server, &scene, "l7").await);
    drop(stream);
    server.stop().await;

    let server = start().await;
    let after = server.get(&path_of(&scene)).await.json(200);
    assert_eq!((&after["layers"], &after["lights"]), (&now["layers"], &now["lights"]));
    assert_eq!((bits(&values(&server, &scene, "").await), bits(&values(&server, &scene, "l7").await)), (before, last));
    let (job, lit) = edited(&server, &scene, &relight("l7", 1.0)).await;
    assert_eq!(job["progress"]["rays"], 0);
    assert_adds_up(&server, &lit).await;
    server.stop().await;
}

#[tokio::test]
async fn lights_are_grouped_by_an_edit() {
    let server = Server::start().await;
    let mut room = glb::room();
    (0..LAMPS).for_each(|i| _ = room.point_light(&format!("l{i}"), [0.2 + 0.2 * i as f32, 0.3, 2.0], 1.0));
    let upload = "/v1/scenes?spacing=1&samples_per_element=4";
    let scene = server.post_glb(upload, room.bytes()).await.json(201);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    let group = |i: usize| json!({ "op": "group_lights", "name": format!("l{i}"), "lights": [format!("l{i}")] });
    let edits: Vec<Value> = (0..LAMPS).map(group).collect();
    let (_, grouped) =
        edited(&server, &scene, &json!({ "edits": edits, "budget": { "samples_per_element": 4 } })).await;
    assert_eq!(grouped["layers"].as_array().unwrap().len(), LAMPS + 2, "{}", grouped["layers"]);
    assert_adds_up(&server, &grouped).await;
    let (job, lit) = edited(&server, &scene, &relight("l4", 7.0)).await;
    assert_eq!(job["progress"]["rays"], 0);
    assert_adds_up(&server, &lit).await;
    server.stop().await;
}
