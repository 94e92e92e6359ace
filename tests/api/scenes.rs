//! Upload, look, list, delete.

use serde_json::{Value, json};

use super::glb;
use super::server::{Server, path_of};

#[tokio::test]
async fn an_uploaded_scene_tells_what_is_in_it() {
    let server = Server::start().await;
    let answer = server.post_glb("/v1/scenes?name=my%20room&spacing=1&environment=0.5,0,1", glb::room().bytes()).await;
    let scene = answer.json(201);
    assert_eq!(answer.header("location"), path_of(&scene));
    assert_eq!(scene["name"], "my room");
    assert_eq!(scene["mode"], "full");
    assert_eq!(scene["spacing"], 1.0);
    let names: Vec<_> = scene["objects"].as_array().unwrap().iter().map(|o| o["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["room", "cupboard"]);
    let room = &scene["objects"][0];
    assert_eq!(room["bounds"], json!({ "min": [0.0, 0.0, 0.0], "max": [4.0, 3.0, 4.0] }));
    assert!((room["albedo"][0].as_f64().unwrap() - 0.7).abs() < 1e-6);
    let cupboard = &scene["objects"][1];
    assert_eq!(cupboard["elements"]["first"], room["elements"]["count"]);
    let total = room["elements"]["count"].as_u64().unwrap() + cupboard["elements"]["count"].as_u64().unwrap();
    assert_eq!(scene["elements"], total);
    assert_eq!(scene["live_elements"], total);
    assert!(scene["memory_bytes"].as_u64().unwrap() > 0 && scene["triangles"].as_u64().unwrap() > 0);
    assert_eq!(scene["lights"][0]["name"], "lamp");
    assert_eq!(scene["lights"][0]["kind"], "point");
    assert_eq!(scene["lights"][0]["position"], json!([2.0, 2.0, 2.0]));
    assert_eq!(scene["lights"][1]["name"], "environment");
    assert_eq!(scene["lights"][1]["color"], json!([0.5, 0.0, 1.0]));
    assert_eq!(scene["cameras"][0]["name"], "view");
    assert_eq!(scene["cameras"][0]["target"], json!([2.0, 1.5, 2.5]));
    let job = server.end_of(scene["current_job"].as_str().unwrap()).await;
    assert_eq!(job["kind"], "bake");
    assert_eq!(job["state"], "succeeded");
    assert_eq!(job["progress"]["fraction"], 1.0);
    let after = server.get(&path_of(&scene)).await;
    assert_eq!(after.header("etag"), "\"0\"", "no edit was accepted");
    let after = after.json(200);
    assert_eq!(after["version"], job["progress"]["version"]);
    assert_eq!(after["current_job"], json!(null));
    assert!(after["estimated_rmse"].as_f64().unwrap() > 0.0);
    server.stop().await;
}

#[tokio::test]
async fn without_a_bake_the_map_stays_black_and_the_first_edit_bakes() {
    let server = Server::start().await;
    let scene = server.room("?bake=false&mode=indirect").await;
    assert_eq!(scene["version"], 0);
    assert_eq!(scene["mode"], "indirect");
    assert_eq!(scene["current_job"], json!(null));
    assert_eq!(scene["estimated_rmse"], json!(null));
    let job = server.edit(&scene, &json!({ "op": "remove", "objects": ["cupboard"] })).await;
    assert_eq!(server.end_of(&job).await["state"], "succeeded");
    let after = server.get(&path_of(&scene)).await.json(200);
    assert!(after["version"].as_u64().unwrap() >= 2);
    assert_eq!(after["objects"].as_array().unwrap().len(), 1);
    server.stop().await;
}

#[tokio::test]
async fn scenes_are_listed_in_pages_newest_first() {
    let server = Server::start().await;
    let mut ids = Vec::new();
    for _ in 0..5 {
        ids.push(server.room("?bake=false").await["id"].clone());
    }
    ids.reverse();
    let (mut seen, mut pages, mut path) = (Vec::new(), 0, "/v1/scenes?limit=2".to_owned());
    loop {
        let page = server.get(&path).await.json(200);
        seen.extend(page["items"].as_array().unwrap().iter().map(|scene| scene["id"].clone()));
        pages += 1;
        let Some(cursor) = page["next_cursor"].as_str() else { break };
        path = format!("/v1/scenes?limit=2&cursor={cursor}");
    }
    assert_eq!((seen, pages), (ids, 3));
    server.get("/v1/scenes?limit=0").await.problem(400, "invalid-query");
    server.get("/v1/scenes?limit=100000").await.problem(400, "invalid-query");
    server.get("/v1/scenes?cursor=x").await.problem(400, "invalid-query");
    server.stop().await;
}

#[tokio::test]
async fn a_deleted_scene_is_gone_with_its_jobs() {
    let (server, _script) = Server::scripted().await;
    let scene = server.room("").await;
    let bake = scene["current_job"].as_str().unwrap();
    let edit = server.edit(&scene, &json!({ "op": "remove", "objects": ["cupboard"] })).await;
    server.until(&edit, |job| job["state"] == "running").await;
    assert_eq!(server.delete(&path_of(&scene)).await.status, 204);
    server.delete(&path_of(&scene)).await.problem(404, "unknown-scene");
    server.get(&path_of(&scene)).await.problem(404, "unknown-scene");
    assert_eq!(server.end_of(&edit).await["state"], "canceled");
    assert_eq!(server.end_of(bake).await["state"], "canceled");
    assert_eq!(server.get("/v1/scenes").await.json(200)["items"], json!([]));
    server.stop().await;
}

#[tokio::test]
async fn there_are_as_many_scenes_as_may_be() {
    let server = Server::with(|config| config.limits.scenes = 2).await;
    let first = server.room("?bake=false").await;
    server.room("?bake=false").await;
    let refused = server.post_glb("/v1/scenes", glb::room().bytes()).await;
    refused.problem(409, "too-many-scenes");
    server.delete(&path_of(&first)).await;
    server.room("?bake=false").await;
    server.stop().await;
}

#[tokio::test]
async fn assets_have_the_hash_of_their_bytes() {
    let server = Server::with(|config| config.limits.assets = 1).await;
    let first = server.post_glb("/v1/assets", glb::crate_asset()).await;
    let again = server.post_glb("/v1/assets", glb::crate_asset()).await;
    assert_eq!(first.json(201)["asset"], again.json(200)["asset"]);
    assert_eq!(first.json(201)["triangles"], 12);
    server.post_glb("/v1/assets", glb::room().bytes()).await.problem(409, "too-many-assets");
    server.stop().await;
}

#[tokio::test]
async fn a_time_budget_ends_a_bake() {
    let server = Server::start().await;
    let scene = server.post_glb("/v1/scenes?spacing=0.2&max_seconds=1", glb::room().bytes()).await.json(201);
    let job = server.end_of(scene["current_job"].as_str().unwrap()).await;
    assert_eq!(job["state"], "succeeded");
    // The first round has no measure; on a machine that is busy with other tests it may take a while.
    let samples = job["progress"]["samples_per_element"].as_u64().unwrap();
    assert!(job["progress"]["elapsed_ms"].as_u64().unwrap() < 1500 || samples <= 8, "{job}");
    server.stop().await;
}

#[tokio::test]
async fn a_scene_whose_last_light_goes_says_that_it_is_dark() {
    let server = Server::start().await;
    let scene = server.room("?bake=false").await;
    let dark = async || {
        let now = server.get(&path_of(&scene)).await.json(200);
        let warnings = now["warnings"].as_array().unwrap().clone();
        warnings.iter().filter(|warning| warning.as_str().unwrap().contains("has no light")).count()
    };
    assert_eq!(dark().await, 0);
    for (edit, expected) in [
        (json!({ "op": "relight", "lights": [{ "light": "lamp", "intensity": 0 }] }), 1),
        (json!({ "op": "relight", "lights": [{ "light": "lamp", "intensity": 2 }] }), 0),
        (json!({ "op": "remove_light", "light": "lamp" }), 1),
        (json!({ "op": "undo" }), 0),
    ] {
        server.edit(&scene, &edit).await;
        assert_eq!(dark().await, expected, "{edit}");
    }
    server.stop().await;
}

/// Where names are not what a program knows things by: the node of the file, and the `extras.id` of it.
#[tokio::test]
async fn edits_name_objects_and_lights_by_their_nodes() {
    let server = Server::start().await;
    let file = glb::room().bytes_with(|document| {
        // A second cupboard of the same name.
        let nodes = document["nodes"].as_array_mut().unwrap();
        for node in nodes.iter_mut() {
            node["extras"] = json!({ "id": format!("id-{}", node["name"].as_str().unwrap()) });
        }
        let mut twin = nodes.iter().find(|node| node["name"] == "cupboard").unwrap().clone();
        twin["extras"] = json!({ "id": "id-room" });
        nodes.push(twin);
        let index = nodes.len() - 1;
        document["scenes"][0]["nodes"].as_array_mut().unwrap().push(index.into());
    });
    let scene = server.post_glb("/v1/scenes?spacing=1&samples_per_element=4", file).await.json(201);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    let now = async || server.get(&path_of(&scene)).await.json(200);
    let named = |list: &Value, name: &str| list.as_array().unwrap().iter().find(|one| one["name"] == name).cloned();
    let node = |name: &str| named(&scene["objects"], name).unwrap()["node"].clone();
    let lamp = named(&scene["lights"], "lamp").unwrap()["node"].clone();
    let edits = json!({ "edits": [
        { "op": "material", "object": { "node": node("cupboard-2") }, "albedo": [0.25, 0.25, 0.25] },
        { "op": "relight", "lights": [{ "light": { "node": lamp }, "intensity": 3 }] },
        { "op": "move_light", "light": { "id": "id-lamp" }, "position": [1, 1, 1] },
    ], "budget": { "samples_per_element": 4 } });
    server.edit(&scene, &edits).await;
    let told = now().await;
    assert_eq!(named(&told["objects"], "cupboard-2").unwrap()["albedo"], json!([0.25, 0.25, 0.25]));
    assert_eq!(
        named(&told["objects"], "cupboard").unwrap()["albedo"],
        named(&scene["objects"], "cupboard").unwrap()["albedo"]
    );
    let lamp = named(&told["lights"], "lamp").unwrap();
    assert_eq!((&lamp["intensity"], &lamp["position"]), (&json!(3.0), &json!([1.0, 1.0, 1.0])));
    // History has names.
    let history = server.get(&format!("{}/edits", path_of(&scene))).await.json(200);
    assert!(history.to_string().contains("\"object\":\"cupboard-2\""), "{history}");
    server.edit(&scene, &json!({ "op": "remove", "objects": [{ "id": "id-cupboard" }] })).await;
    assert!(named(&now().await["objects"], "cupboard").is_none());
    let path = format!("{}/edits", path_of(&scene));
    for (edit, slug, field) in [
        (json!({ "op": "remove", "objects": ["cupboard-2", { "node": 99 }] }), "unknown-object", "objects[1]"),
        (json!({ "op": "hide", "objects": [{ "id": "id-room" }] }), "invalid-value", "objects[0]"),
        (json!({ "op": "hide", "objects": [{ "node": 1, "id": "x" }] }), "invalid-value", "objects[0]"),
        (json!({ "op": "remove_light", "light": { "node": 0 } }), "unknown-light", "light"),
        (json!({ "op": "remove", "objects": [{ "id": "nobody" }] }), "unknown-object", "objects[0]"),
        (
            json!({ "op": "remove", "objects": vec![json!({ "node": node("cupboard-2") }); 4097] }),
            "invalid-value",
            "objects[4096]",
        ),
        (
            json!({ "edits": [{ "op": "relight", "lights": [{ "light": { "id": 7 } }] }] }),
            "invalid-value",
            "edits[0].lights[0].light",
        ),
    ] {
        let answer = server.post_json(&path, &edit).await;
        answer.problem(422, slug);
        assert_eq!(answer.json(422)["field"], field, "{edit}");
    }
    server.stop().await;
}

#[tokio::test]
async fn lights_tell_their_nodes() {
    let server = Server::start().await;
    let file = glb::room().bytes_with(|document| {
        for node in document["nodes"].as_array_mut().unwrap() {
            if node["name"] == "lamp" {
                node["extras"] = json!({ "id": "c04e" });
            }
        }
    });
    let index = glb::room().document()["nodes"].as_array().unwrap().iter().position(|node| node["name"] == "lamp");
    let scene = server.post_glb("/v1/scenes?spacing=1&bake=false", file).await.json(201);
    let lamp = scene["lights"].as_array().unwrap().iter().find(|light| light["name"] == "lamp").unwrap();
    assert_eq!((&lamp["node"], &lamp["id"]), (&json!(index), &json!("c04e")));
    let sun = json!({ "kind": "directional", "direction": [0, -1, 0], "color": [1, 1, 1], "intensity": 1 });
    server.edit(&scene, &json!({ "op": "insert_light", "name": "sun", "light": sun })).await;
    let scene = server.get(&path_of(&scene)).await.json(200);
    let sun = scene["lights"].as_array().unwrap().iter().find(|light| light["name"] == "sun").unwrap();
    assert!(sun.get("node").is_none() && sun.get("id").is_none(), "{sun}");
    server.stop().await;
}
