//! What was asked of a scene: its history, undo and redo, objects that are hidden, materials by name.

use glam::Vec3;
use rebake_core::delta::Frame;
use serde_json::{Value, json};

use super::durable::{fast_directory, insert, names, start};
use super::engine::Step;
use super::glb::{self, translation};
use super::server::{Server, path_of};

const BUDGET: u32 = 4;

/// Bits of the light map as it is now, without holes at its end.
async fn bits(server: &Server, scene: &Value) -> Vec<[u32; 3]> {
    let body = server.get(&format!("{}/lightmap?format=raw", path_of(scene))).await.body;
    let mut values = Frame::decode(&body).unwrap().0.values;
    while values.last() == Some(&Vec3::ZERO) {
        values.pop();
    }
    values.into_iter().map(|value| value.to_array().map(f32::to_bits)).collect()
}

/// Posts an edit, and answers the map's bits and the scene once it is lit.
async fn edited(server: &Server, scene: &Value, mut edit: Value) -> (Vec<[u32; 3]>, Value) {
    edit["budget"] = json!({ "samples_per_element": BUDGET });
    let job = server.end_of(&server.edit(scene, &edit).await).await;
    assert_eq!(job["state"], "succeeded", "{edit} {job}");
    (bits(server, scene).await, server.get(&path_of(scene)).await.json(200))
}

async fn history(server: &Server, scene: &Value, query: &str) -> Value {
    server.get(&format!("{}/edits{query}", path_of(scene))).await.json(200)
}

/// Sequence numbers of what is undone.
fn undone(history: &Value) -> Vec<u64> {
    let items = history["items"].as_array().unwrap().iter();
    items.filter(|item| item["undone"] == true).map(|item| item["sequence"].as_u64().unwrap()).collect()
}

/// The objects of a scene, without the errors of their light.
fn objects(scene: &Value) -> Vec<Value> {
    let mut objects = scene["objects"].as_array().unwrap().clone();
    objects.iter_mut().for_each(|object| drop(object.as_object_mut().unwrap().remove("light_error")));
    objects
}

#[tokio::test]
async fn edits_are_taken_back_and_made_again_bit_for_bit() {
    let directory = fast_directory();
    let server = start(directory.path()).await;
    let asset = server.crate_asset().await;
    let scene = server.baked_room("?samples_per_element=4").await;
    let undo = || json!({ "op": "undo" });
    let path = format!("{}/edits", path_of(&scene));
    assert_eq!(server.post_json(&path, &undo()).await.json(409)["field"], "op");
    let before = bits(&server, &scene).await;
    let (with_crate, _) = edited(&server, &scene, insert(&asset, "a")).await;
    let (painted, _) =
        edited(&server, &scene, json!({ "op": "material", "object": "room", "albedo": [0.1, 0.5, 0.1] })).await;
    assert!(before != with_crate && with_crate != painted);
    let (now, _) = edited(&server, &scene, undo()).await;
    assert!(now == with_crate, "the light before the edit");
    let (now, told) = edited(&server, &scene, json!({ "edits": [undo()] })).await;
    assert!(now == before && names(&told) == ["room", "cupboard"]);
    assert!(told["objects"] == scene["objects"] && told["lights"] == scene["lights"]);
    server.post_json(&path, &undo()).await.problem(409, "nothing-to-undo");
    let (now, told) = edited(&server, &scene, json!({ "op": "redo" })).await;
    assert!(now == with_crate && names(&told) == ["room", "cupboard", "a"]);

    let whole = history(&server, &scene, "").await;
    assert_eq!((undone(&whole), &whole["undo"], &whole["redo"]), (vec![2], &json!(1), &json!(2)));
    let ops: Vec<&Value> = whole["items"].as_array().unwrap().iter().map(|item| &item["request"]["op"]).collect();
    assert_eq!(ops, [&json!("insert"), &json!("material"), &json!("undo"), &Value::Null, &json!("redo")]);
    assert_eq!(whole["items"][0]["request"]["asset"], asset);
    let turns: Vec<[&Value; 2]> =
        whole["items"].as_array().unwrap().iter().map(|item| [&item["undoes"], &item["redoes"]]).collect();
    assert_eq!(turns[2..], [[&json!(2), &Value::Null], [&json!(1), &Value::Null], [&Value::Null, &json!(1)]]);
    // Jobs, newest first: the bake is the last.
    let jobs = server.get(&format!("/v1/jobs?scene={}", scene["id"].as_str().unwrap())).await.json(200);
    for (item, job) in whole["items"].as_array().unwrap().iter().rev().zip(jobs["items"].as_array().unwrap()) {
        assert_eq!((&item["job"], &item["accepted_at"]), (&job["id"], &job["created_at"]));
    }

    // A restart goes through all of it again.
    server.stop().await;
    let server = start(directory.path()).await;
    assert_eq!(history(&server, &scene, "").await, whole);
    let (now, _) = edited(&server, &scene, json!({ "op": "redo" })).await;
    assert_eq!(history(&server, &scene, "").await["redo"], Value::Null);
    assert_eq!(now.len(), painted.len());
    // A new edit ends what can be made again.
    edited(&server, &scene, undo()).await;
    let (_, told) = edited(&server, &scene, json!({ "op": "remove", "objects": ["a"] })).await;
    assert_eq!(names(&told), ["room", "cupboard"]);
    server.post_json(&path, &json!({ "op": "redo" })).await.problem(409, "nothing-to-undo");
    server.stop().await;
    let server = start(directory.path()).await;
    assert_eq!(names(&server.get(&path_of(&scene)).await.json(200)), ["room", "cupboard"]);
    let (_, told) = edited(&server, &scene, undo()).await;
    assert_eq!(names(&told), ["room", "cupboard", "a"]);
    server.stop().await;
}

#[tokio::test]
async fn the_history_comes_in_pages_oldest_first() {
    let (server, script) = Server::scripted().await;
    drop(script);
    let scene = server.room("?bake=false").await;
    assert_eq!(history(&server, &scene, "").await["items"], json!([]));
    for k in 1..=5 {
        let paint = json!({ "op": "material", "object": "room", "albedo": [0.1 * f64::from(k), 0.5, 0.5] });
        server.edit(&scene, &paint).await;
    }
    // What changes nothing is no edit.
    server.edit(&scene, &json!({ "edits": [] })).await;
    let (mut cursor, mut seen) = (String::new(), Vec::new());
    loop {
        let page = history(&server, &scene, &format!("?limit=2{cursor}")).await;
        seen.extend(page["items"].as_array().unwrap().iter().map(|item| item["sequence"].as_u64().unwrap()));
        match page["next_cursor"].as_str() {
            Some(next) => cursor = format!("&cursor={next}"),
            None => break,
        }
    }
    assert_eq!(seen, [1, 2, 3, 4, 5]);
    let path = format!("{}/edits", path_of(&scene));
    for query in ["?limit=0", "?limit=x", "?cursor=7", "?order=up"] {
        server.get(&format!("{path}{query}")).await.problem(400, "invalid-query");
    }
    server.get("/v1/scenes/s9-zzzzzz/edits").await.problem(404, "unknown-scene");
    server.stop().await;
}

#[tokio::test]
async fn turns_stand_alone_and_no_more_are_kept_than_may_be() {
    let (server, script) = Server::scripted_with(|config| config.limits.undo_steps = 2).await;
    drop(script);
    let scene = server.room("?bake=false").await;
    let path = format!("{}/edits", path_of(&scene));
    let hide = json!({ "op": "hide", "objects": ["cupboard"] });
    for _ in 0..3 {
        server.edit(&scene, &hide).await;
    }
    let mixed = json!({ "edits": [hide, { "op": "undo" }] });
    assert_eq!(server.post_json(&path, &mixed).await.json(422)["field"], "edits[1].op");
    let odd = json!({ "op": "undo", "steps": 2 });
    assert_eq!(server.post_json(&path, &odd).await.json(422)["field"], "steps");
    for _ in 0..2 {
        server.edit(&scene, &json!({ "op": "undo" })).await;
    }
    server.post_json(&path, &json!({ "op": "undo" })).await.problem(409, "nothing-to-undo");
    server.stop().await;
}

/// Edits that wait behind each other, undo among them, are lit together.
#[tokio::test]
async fn an_edit_that_is_taken_back_while_it_waits_is_not_lit() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("").await;
    script.run(&[Step::Round, Step::Finish]);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    let before = bits(&server, &scene).await;
    let step = json!({ "op": "move", "object": "cupboard", "transform": translation(1.0, 0.0, 1.0) });
    let running = server.edit(&scene, &step).await;
    server.until(&running, |job| job["state"] == "running").await;
    server.edit(&scene, &json!({ "op": "material", "object": "room", "albedo": [0.1, 0.1, 0.1] })).await;
    server.edit(&scene, &json!({ "op": "undo" })).await;
    let last = server.edit(&scene, &json!({ "op": "undo" })).await;
    script.run(&[Step::Round, Step::Finish]);
    assert_eq!(server.end_of(&last).await["state"], "succeeded");
    let now = server.get(&path_of(&scene)).await.json(200);
    assert_eq!((objects(&now), &now["unlit_edits"]), (objects(&scene), &json!(0)));
    assert!(bits(&server, &scene).await == before);
    server.stop().await;
}

#[tokio::test]
async fn hidden_objects_stay_in_the_list_and_come_back() {
    let directory = fast_directory();
    let server = start(directory.path()).await;
    let scene = server.baked_room("?samples_per_element=4").await;
    let before = bits(&server, &scene).await;
    let (dark, told) = edited(&server, &scene, json!({ "op": "hide", "objects": ["cup*"] })).await;
    assert_eq!(names(&told), ["room", "cupboard"]);
    let cupboard = &told["objects"][1];
    assert_eq!((&cupboard["hidden"], &cupboard["elements"]["count"]), (&json!(true), &json!(0)));
    assert_eq!(cupboard["albedo"], scene["objects"][1]["albedo"]);
    assert_ne!(dark, before);
    let elements = server.get(&format!("{}/elements", path_of(&scene))).await.body;
    let is_of_room = |record: &[u8]| [0, u32::MAX].contains(&u32::from_le_bytes(record[28..].try_into().unwrap()));
    assert!(elements.chunks_exact(32).all(is_of_room));
    let path = format!("{}/edits", path_of(&scene));
    let show = |name: &str| json!({ "op": "show", "objects": [name] });
    assert_eq!(server.post_json(&path, &show("sofa")).await.json(422)["field"], "objects[0]");
    assert_eq!(server.post_json(&path, &json!({ "op": "hide", "objects": [] })).await.json(422)["field"], "objects");
    // Hidden through a restart, shown after it.
    server.stop().await;
    let server = start(directory.path()).await;
    assert_eq!(server.get(&path_of(&scene)).await.json(200)["objects"], told["objects"]);
    let (_, back) = edited(&server, &scene, show("cupboard")).await;
    assert_eq!(objects(&back), objects(&scene));
    assert_eq!(bits(&server, &scene).await.len(), before.len());
    server.stop().await;
}

#[tokio::test]
async fn hiding_and_showing_gives_the_same_light_bit_for_bit() {
    let server = Server::start().await;
    let scene = server.baked_room("?samples_per_element=4").await;
    let before = bits(&server, &scene).await;
    for _ in 0..2 {
        edited(&server, &scene, json!({ "op": "hide", "objects": ["cupboard"] })).await;
        let (now, _) = edited(&server, &scene, json!({ "op": "show", "objects": ["*"] })).await;
        assert!(now == before);
    }
    server.stop().await;
}

#[tokio::test]
async fn materials_are_painted_by_name() {
    let server = Server::start().await;
    let named = glb::room().bytes_with(|document| {
        document["materials"][0]["name"] = json!("plaster");
        document["materials"][1]["name"] = json!("wood");
        document["nodes"][1]["extras"] = json!({ "id": "a81f", "more": [1] });
        document["nodes"][0]["extras"] = json!({ "id": 7 });
    });
    let scene = server.post_glb("/v1/scenes?spacing=1&samples_per_element=4", named).await.json(201);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    let of = |scene: &Value, field: &str| [0, 1].map(|k| scene["objects"][k][field].clone());
    assert_eq!((of(&scene, "node"), of(&scene, "id")), ([json!(0), json!(1)], [json!("7"), json!("a81f")]));
    let reds = |scene: &Value| [0, 1].map(|k| (scene["objects"][k]["albedo"][0].as_f64().unwrap() * 100.0).round());
    assert_eq!(reds(&scene), [70.0, 50.0]);
    let paint = |edit: Value| {
        let mut edit = edit;
        edit["op"] = json!("material");
        edit["albedo"] = json!([0.2, 0.1, 0.1]);
        edit
    };
    let (_, told) = edited(&server, &scene, paint(json!({ "material": "wood" }))).await;
    assert_eq!(reds(&told), [70.0, 20.0]);
    let (_, told) = edited(&server, &scene, paint(json!({ "material": "plaster", "object": "room" }))).await;
    assert_eq!(reds(&told), [20.0, 20.0]);
    let path = format!("{}/edits", path_of(&scene));
    for (edit, slug, field) in [
        (json!({ "material": "gold" }), "unknown-material", "material"),
        (json!({ "material": "wood", "object": "room" }), "unknown-material", "material"),
        (json!({ "material": "wood", "object": "sofa" }), "unknown-object", "object"),
        (json!({ "material": "" }), "invalid-value", "material"),
        (json!({}), "invalid-value", "object"),
    ] {
        let answer = server.post_json(&path, &paint(edit)).await;
        answer.problem(422, slug);
        assert_eq!(answer.json(422)["field"], field);
    }
    let (_, told) = edited(&server, &scene, json!({ "op": "undo" })).await;
    assert_eq!(reds(&told), [70.0, 20.0]);
    server.stop().await;
}
