//! Edits: what is accepted, what is refused, and in what order things take effect.

use futures_util::future::join_all;
use serde_json::{Value, json};

use super::engine::Step;
use super::glb::translation;
use super::server::{Answer, Server, path_of};

#[tokio::test]
async fn every_kind_of_edit_is_accepted_and_lit() {
    let server = Server::start().await;
    let asset = server.crate_asset().await;
    let scene = server.baked_room("?samples_per_element=4").await;
    let lamp = json!({ "kind": "point", "position": [1, 2, 1], "color": [1, 1, 1], "intensity": 4 });
    let spot = json!({ "kind": "spot", "position": [1, 2, 1], "direction": [0, -2, 0], "color": [1, 1, 1], "intensity": 4, "range": 8 });
    let sun = json!({ "kind": "directional", "direction": [1, -1, 0], "color": [1, 1, 1], "intensity": 4 });
    let edits = [
        json!({ "op": "insert", "asset": asset, "name": "crate-1", "transform": translation(2.0, 0.01, 2.0) }),
        json!({ "op": "move", "object": "crate-1", "transform": translation(2.5, 0.01, 2.0),
            "focus": { "point": [2.5, 0, 2], "radius": 1.0 } }),
        json!({ "op": "material", "object": "crate-1", "albedo": [0.9, 0.1, 0.1], "focus": { "camera": "view" } }),
        json!({ "op": "relight", "lights": [{ "light": "lamp", "color": [1, 0.5, 0.5], "intensity": 30 }],
            "focus": { "camera": 0, "width": 640, "height": 480 } }),
        json!({ "op": "insert_light", "name": "lamp-2", "light": lamp,
            "focus": { "eye": [2, 1, 3], "target": [2, 1, 0], "fov_y": 1.2 },
            "tiles": { "mode": "incremental", "size": 64 } }),
        json!({ "op": "insert_light", "name": "spot", "light": spot }),
        json!({ "op": "insert_light", "name": "sun", "light": sun, "budget": { "max_seconds": 5 } }),
        json!({ "op": "insert_light", "name": "sky", "light": { "kind": "environment", "color": [1, 1, 1],
            "intensity": 1 } }),
        json!({ "op": "move_light", "light": "lamp-2", "position": [1, 2.5, 1], "tiles": { "samples": 2 } }),
        json!({ "op": "remove_light", "light": "lamp-2" }),
        json!({ "op": "remove", "objects": ["crate-1"], "budget": { "target_rmse": 10.0 } }),
        json!({ "edits": [
            { "op": "insert", "asset": asset, "name": "a", "transform": translation(2.0, 0.01, 2.0) },
            { "op": "move", "object": "a", "transform": translation(3.0, 0.01, 2.0),
              "budget": { "samples_per_element": 4 } },
        ] }),
    ];
    let mut version = scene["version"].as_u64().unwrap();
    for mut edit in edits {
        if edit.get("budget").is_none() {
            edit["budget"] = json!({ "samples_per_element": 4 });
        }
        let job = server.end_of(&server.edit(&scene, &edit).await).await;
        assert_eq!(job["state"], "succeeded", "{edit} {job}");
        assert_eq!(job["kind"], "edit");
        let now = job["progress"]["version"].as_u64().unwrap();
        assert!(now > version, "{edit}: geometry and light are published");
        version = now;
    }
    let scene = server.get(&path_of(&scene)).await.json(200);
    assert_eq!(scene["version"], version);
    assert_eq!(scene["unlit_edits"], 0);
    let names: Vec<&Value> = scene["objects"].as_array().unwrap().iter().map(|object| &object["name"]).collect();
    assert_eq!(names, ["room", "cupboard", "a"]);
    let spot = scene["lights"].as_array().unwrap().iter().find(|light| light["name"] == "spot").unwrap();
    let cone = [&spot["inner_cone_angle"], &spot["outer_cone_angle"]].map(|angle| angle.as_f64().unwrap() as f32);
    assert_eq!((cone, &spot["range"]), ([0.0, std::f32::consts::FRAC_PI_4], &json!(8.0)));
    server.stop().await;
}

#[tokio::test]
async fn refused_edits_name_the_field_and_change_nothing() {
    let server = Server::start().await;
    let scene = server.room("?bake=false").await;
    let asset = server.crate_asset().await;
    let at = translation(0.0, 0.0, 0.0);
    let insert = |name: &str| json!({ "op": "insert", "asset": asset, "name": name, "transform": at });
    let light = |light: Value| json!({ "op": "insert_light", "name": "x", "light": light });
    let remove = json!({ "op": "remove", "objects": ["cupboard"] });
    let with = |key: &str, value: Value| {
        let mut edit = remove.clone();
        edit[key] = value;
        edit
    };
    let cases = [
        (json!({ "op": "paint" }), 422, "invalid-value", "op"),
        (json!({}), 422, "invalid-value", "op"),
        (json!({ "op": 3 }), 422, "invalid-value", "op"),
        (json!({ "op": "remove" }), 422, "invalid-value", "objects"),
        (json!({ "op": "remove", "objects": [] }), 422, "invalid-value", "objects"),
        (json!({ "op": "remove", "objects": [1] }), 422, "invalid-value", "objects[0]"),
        (json!({ "op": "remove", "objects": ["cupboard"], "x": 1 }), 422, "invalid-value", "x"),
        (json!({ "op": "remove", "objects": ["cupboard", "sofa"] }), 422, "unknown-object", "objects[1]"),
        (
            json!({ "edits": [insert("a"), { "op": "remove", "objects": ["b"] }] }),
            422,
            "unknown-object",
            "edits[1].objects[0]",
        ),
        (json!({ "edits": [insert("a"), insert("a")] }), 409, "name-taken", "edits[1].name"),
        (json!({ "edits": 3 }), 422, "invalid-value", "edits"),
        (json!({ "edits": [3] }), 422, "invalid-value", "edits[0]"),
        (json!({ "edits": [], "op": "remove" }), 422, "invalid-value", "op"),
        (insert("room"), 409, "name-taken", "name"),
        (insert(""), 422, "invalid-value", "name"),
        (insert("a\nb"), 422, "invalid-value", "name"),
        (json!({ "op": "insert", "asset": "00", "name": "a", "transform": at }), 422, "unknown-asset", "asset"),
        (
            json!({ "op": "insert", "asset": asset, "name": "a", "transform": [1, 2] }),
            422,
            "invalid-value",
            "transform",
        ),
        (json!({ "op": "move", "object": "sofa", "transform": at }), 422, "unknown-object", "object"),
        (
            json!({ "op": "move", "object": "cupboard", "transform": [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0] }),
            422,
            "invalid-value",
            "transform",
        ),
        (
            json!({ "op": "move", "object": "cupboard", "transform": translation(1e308, 0.0, 0.0) }),
            422,
            "invalid-value",
            "transform",
        ),
        (
            json!({ "op": "move", "object": "cupboard", "transform": translation(0.0, -1.1e8, 0.0) }),
            422,
            "invalid-value",
            "transform",
        ),
        (
            json!({ "edits": [{ "op": "insert", "asset": asset, "name": "a",
                "transform": [1e308, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] }] }),
            422,
            "invalid-value",
            "edits[0].transform",
        ),
        (
            light(json!({ "kind": "point", "position": [0, 1e308, 0], "color": [1, 1, 1], "intensity": 1 })),
            422,
            "invalid-value",
            "light.position",
        ),
        (json!({ "op": "move_light", "light": "lamp", "position": [1.1e8, 0, 0] }), 422, "invalid-value", "position"),
        (json!({ "op": "material", "object": "cupboard", "albedo": [0, 0, 1.5] }), 422, "invalid-value", "albedo"),
        (json!({ "op": "material", "object": "cupboard", "albedo": [0, 0, 1e39] }), 422, "invalid-value", "albedo"),
        (json!({ "op": "material", "object": "cupboard", "albedo": "red" }), 422, "invalid-value", "albedo"),
        (
            json!({ "op": "relight", "lights": [{ "light": "sun", "intensity": 1 }] }),
            422,
            "unknown-light",
            "lights[0].light",
        ),
        (
            json!({ "op": "relight", "lights": [{ "light": "lamp", "intensity": -1 }] }),
            422,
            "invalid-value",
            "lights[0].intensity",
        ),
        (json!({ "op": "relight", "lights": [{ "light": "lamp" }] }), 422, "invalid-value", "lights[0].intensity"),
        (json!({ "op": "relight", "lights": [] }), 422, "invalid-value", "lights"),
        (light(json!({ "kind": "laser" })), 422, "invalid-value", "light.kind"),
        (light(json!(3)), 422, "invalid-value", "light"),
        (light(json!({ "kind": "point", "color": [1, 1, 1], "intensity": 1 })), 422, "invalid-value", "light.position"),
        (
            light(json!({ "kind": "directional", "direction": [0, 0, 0], "color": [1, 1, 1], "intensity": 1 })),
            422,
            "invalid-value",
            "light.direction",
        ),
        (
            light(json!({ "kind": "environment", "color": [1, -1, 1], "intensity": 1 })),
            422,
            "invalid-value",
            "light.color",
        ),
        (json!({ "op": "remove_light", "light": "sun" }), 422, "unknown-light", "light"),
        (json!({ "op": "move_light", "light": "lamp" }), 422, "invalid-value", "position"),
        (with("budget", json!({ "samples_per_element": 0 })), 422, "invalid-value", "budget.samples_per_element"),
        (with("budget", json!({ "max_seconds": -1 })), 422, "invalid-value", "budget.max_seconds"),
        (with("budget", json!({ "target_rmse": 0 })), 422, "invalid-value", "budget.target_rmse"),
        (with("budget", json!({ "hours": 1 })), 422, "invalid-value", "budget.hours"),
        (with("focus", json!({})), 422, "invalid-value", "focus"),
        (with("focus", json!({ "camera": "nobody" })), 422, "unknown-camera", "focus.camera"),
        (with("focus", json!({ "camera": 7 })), 422, "unknown-camera", "focus.camera"),
        (with("focus", json!({ "point": [0, 0, 0] })), 422, "invalid-value", "focus.radius"),
        (with("focus", json!({ "eye": [0, 0, 0], "target": [0, 0, 0] })), 422, "invalid-value", "focus.target"),
        (with("focus", json!({ "eye": [0, 0, 0], "point": [0, 0, 0], "radius": 1 })), 422, "invalid-value", "focus"),
        (with("tiles", json!({ "size": 15 })), 422, "invalid-value", "tiles.size"),
        (with("tiles", json!({ "size": 1048577 })), 422, "invalid-value", "tiles.size"),
        (with("tiles", json!({ "size": -1 })), 422, "invalid-value", "tiles.size"),
        (with("tiles", json!({ "samples": 0 })), 422, "invalid-value", "tiles.samples"),
        (with("tiles", json!({ "samples": 4000000000u32 })), 422, "invalid-value", "tiles.samples"),
        (with("tiles", json!({ "mode": "spiral" })), 422, "invalid-value", "tiles.mode"),
        (with("tiles", json!({ "order": "screen" })), 422, "invalid-value", "tiles.order"),
        (with("tiles", json!(64)), 422, "invalid-value", "tiles"),
    ];
    let path = format!("{}/edits", path_of(&scene));
    for (edit, status, slug, field) in cases {
        let answer = server.post_json(&path, &edit).await;
        assert_eq!(answer.status, status, "{edit} {}", String::from_utf8_lossy(&answer.body));
        let detail = answer.problem(status, slug);
        assert_eq!(answer.json(status)["field"], field, "{edit}: {detail}");
        assert!(detail.starts_with(&format!("{field}: ")), "{edit}: {detail}");
    }
    assert_eq!(server.get("/v1/jobs").await.json(200)["items"], json!([]));
    assert_eq!(server.get(&path_of(&scene)).await.json(200)["objects"].as_array().unwrap().len(), 2);
    server.stop().await;
}

#[tokio::test]
async fn bodies_that_are_no_edits_are_refused() {
    let server = Server::with(|config| {
        config.limits.edit_bytes = 4096;
        config.limits.edits_per_request = 3;
    });
    let server = server.await;
    let scene = server.room("?bake=false").await;
    let path = format!("{}/edits", path_of(&scene));
    for body in ["", "{", "[]", "null", "{\"op\": \"remove\"", "\u{0}", "{\"op\":1e999}"] {
        server.post_text(&path, body, &[]).await.problem(400, "invalid-json");
    }
    server
        .post_text(&path, &format!("{{\"op\": \"{}\"}}", "x".repeat(5000)), &[])
        .await
        .problem(413, "payload-too-large");
    let nested = format!("{{\"op\":{}{}}}", "[".repeat(1500), "]".repeat(1500));
    server.post_text(&path, &nested, &[]).await.problem(400, "invalid-json");
    let text = server.request(reqwest::Method::POST, &path).header("content-type", "text/plain").body("{}");
    Answer::to(text).await.problem(415, "unsupported-media-type");
    let many = json!({ "edits": [{}, {}, {}, {}] });
    server.post_json(&path, &many).await.problem(422, "invalid-value");
    server.post_text("/v1/scenes/s9-zzzzzz/edits", "{}", &[]).await.problem(404, "unknown-scene");
    server.stop().await;
}

#[tokio::test]
async fn queued_edits_are_checked_against_each_other() {
    let (server, script) = Server::scripted().await;
    let (scene, _hold) = server.held_room(&script).await;
    let asset = server.crate_asset().await;
    let insert = json!({ "op": "insert", "asset": asset, "name": "a", "transform": translation(2.0, 0.01, 2.0) });
    let path = format!("{}/edits", path_of(&scene));
    // Another edit is being lit: nothing of this is published yet.
    server.edit(&scene, &insert).await;
    server.post_json(&path, &insert).await.problem(409, "name-taken");
    server.edit(&scene, &json!({ "op": "move", "object": "a", "transform": translation(3.0, 0.01, 2.0) })).await;
    let last = server.edit(&scene, &json!({ "op": "remove", "objects": ["a"] })).await;
    server.post_json(&path, &json!({ "op": "remove", "objects": ["a"] })).await.problem(422, "unknown-object");
    let now = server.get(&path_of(&scene)).await.json(200);
    assert_eq!(now["unlit_edits"], 4);
    assert_eq!(now["objects"].as_array().unwrap().len(), 2);
    script.run(&[Step::Round, Step::Finish].repeat(4));
    assert_eq!(server.end_of(&last).await["state"], "succeeded");
    assert_eq!(server.get(&path_of(&scene)).await.json(200)["unlit_edits"], 0);
    server.stop().await;
}

#[tokio::test]
async fn an_idempotency_key_makes_one_job() {
    let (server, _script) = Server::scripted_with(|config| config.limits.idempotency_keys = 2).await;
    let scene = server.room("").await;
    let path = format!("{}/edits", path_of(&scene));
    let body = json!({ "op": "remove", "objects": ["cupboard"] }).to_string();
    let key = |key: &'static str| [("idempotency-key", key)];
    let first = server.post_text(&path, &body, &key("k1")).await.json(202);
    let again = server.post_text(&path, &body, &key("k1")).await;
    assert_eq!(again.json(202)["id"], first["id"]);
    assert_eq!(again.header("location"), format!("/v1/jobs/{}", first["id"].as_str().unwrap()));
    let other = json!({ "op": "material", "object": "room", "albedo": [0, 0, 0] }).to_string();
    server.post_text(&path, &other, &key("k1")).await.problem(422, "idempotency-key-reused");
    // A refused request leaves no trace: its key is free.
    server.post_text(&path, &body, &key("k2")).await.problem(422, "unknown-object");
    server.post_text(&path, &other, &key("k2")).await.json(202);
    server.post_text(&path, &body, &[("idempotency-key", &"x".repeat(300))]).await.problem(400, "bad-request");
    // Ten at once are one job.
    let paint = json!({ "op": "material", "object": "room", "albedo": [0.1, 0.1, 0.1] }).to_string();
    let headers = key("k3");
    let posts = (0..10).map(|_| server.post_text(&path, &paint, &headers));
    let answers = join_all(posts).await;
    let ids: std::collections::HashSet<String> =
        answers.iter().map(|answer| answer.json(202)["id"].to_string()).collect();
    assert_eq!(ids.len(), 1);
    // The oldest key was forgotten when the third came.
    server.post_text(&path, &body, &key("k1")).await.problem(422, "unknown-object");
    server.stop().await;
}

#[tokio::test]
async fn if_match_names_the_accepted_edits_whatever_the_light_does() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("").await;
    let tag = async || server.get(&path_of(&scene)).await.header("etag").to_owned();
    let path = format!("{}/edits", path_of(&scene));
    let paint = json!({ "op": "material", "object": "room", "albedo": [0.1, 0.1, 0.1] }).to_string();
    assert_eq!(tag().await, "\"0\"");
    script.run(&[Step::Round; 3]);
    server.client.follow(scene["id"].as_str().unwrap()).reach(3).await.unwrap();
    assert_eq!(tag().await, "\"0\"", "versions of the light map do not count");
    for wrong in ["\"3\"", "\"1\"", "W/\"0\"", "\"00\""] {
        let answer = server.post_text(&path, &paint, &[("if-match", wrong)]).await;
        let detail = answer.problem(412, "precondition-failed");
        assert!(detail.contains("accepted 0 edits") && detail.contains("not with the light map's version"), "{detail}");
    }
    for bad in ["0", "\"0", ""] {
        server.post_text(&path, &paint, &[("if-match", bad)]).await.problem(400, "bad-request");
    }
    let answer = server.post_text(&path, &paint, &[("if-match", "\"0\""), ("idempotency-key", "k")]).await;
    assert_eq!((&answer.json(202)["accepted_edits"], answer.header("etag")), (&json!(1), "\"1\""));
    assert_eq!(tag().await, "\"1\"");
    // What changes nothing is no new state, and neither is a request that came before.
    for right in ["\"1\"", "*", "\"7\", \"1\""] {
        let answer = server.post_text(&path, &json!({ "edits": [] }).to_string(), &[("if-match", right)]).await;
        assert_eq!((&answer.json(202)["accepted_edits"], answer.header("etag")), (&json!(1), "\"1\""));
    }
    let again = server.post_text(&path, &paint, &[("if-match", "\"0\""), ("idempotency-key", "k")]).await;
    assert_eq!((&again.json(202)["id"], again.header("etag")), (&answer.json(202)["id"], "\"1\""));
    assert_eq!(server.get(&path_of(&scene)).await.json(200)["accepted_edits"], 1);
    // Who changes or deletes the scene itself may say how it knows it, too.
    let changed = async |method: reqwest::Method, tag: &str| {
        let request = server.request(method, &path_of(&scene)).header("content-type", "application/json");
        Answer::to(request.header("if-match", tag).body(r#"{"name":"b"}"#)).await
    };
    changed(reqwest::Method::PATCH, "\"0\"").await.problem(412, "precondition-failed");
    assert_eq!(changed(reqwest::Method::PATCH, "\"1\"").await.json(200)["name"], "b");
    changed(reqwest::Method::DELETE, "\"0\"").await.problem(412, "precondition-failed");
    assert_eq!(changed(reqwest::Method::DELETE, "\"1\"").await.status, 204);
    server.stop().await;
}

#[tokio::test]
async fn of_parallel_edits_of_one_state_one_wins() {
    let (server, _script) = Server::scripted().await;
    let scene = server.room("").await;
    let path = format!("{}/edits", path_of(&scene));
    for state in 0..3 {
        let tag = format!("\"{state}\"");
        let paint = |shade: u32| {
            json!({ "op": "material", "object": "room", "albedo": [0.1, 0.1, f64::from(shade) / 10.0] }).to_string()
        };
        let bodies: Vec<String> = (0..8).map(paint).collect();
        let headers = [("if-match", tag.as_str())];
        let answers = join_all(bodies.iter().map(|body| server.post_text(&path, body, &headers))).await;
        let (won, lost): (Vec<_>, Vec<_>) = answers.iter().partition(|answer| answer.status == 202);
        assert_eq!((won.len(), lost.len()), (1, 7));
        assert_eq!(won[0].header("etag"), format!("\"{}\"", state + 1));
        lost.iter().for_each(|answer| drop(answer.problem(412, "precondition-failed")));
    }
    server.stop().await;
}

/// The raw light map of a scene, without the versions in its frame's header.
async fn values(server: &Server, scene: &Value) -> Vec<u8> {
    let raw = server.get(&format!("{}/lightmap?format=raw", path_of(scene))).await;
    assert_eq!(raw.status, 200);
    const HEADER: usize = 40;
    raw.body[HEADER..].to_vec()
}

#[tokio::test]
async fn taking_an_edit_back_gives_the_map_from_before_it() {
    let server = Server::start().await;
    let asset = server.crate_asset().await;
    let scene = server.baked_room("?samples_per_element=4").await;
    let bits = values(&server, &scene).await;
    let budget = json!({ "samples_per_element": 4 });
    let there = json!({ "op": "insert", "asset": asset, "name": "crate-1", "transform": translation(2.0, 0.01, 2.0),
        "budget": budget });
    let back = json!({ "op": "remove", "objects": ["crate-1"], "budget": budget });
    for _ in 0..2 {
        server.end_of(&server.edit(&scene, &there).await).await;
        assert_ne!(values(&server, &scene).await, bits);
        let job = server.end_of(&server.edit(&scene, &back).await).await;
        assert_eq!(job["state"], "succeeded", "{job}");
        let now = values(&server, &scene).await;
        // The slots of what was removed stay as a hole at the end.
        let (runs, values) = now.split_at(8);
        let (old_runs, old_values) = bits.split_at(8);
        assert_eq!(runs[..4], old_runs[..4]);
        assert_eq!(values[..old_values.len()], *old_values);
        assert!(values[old_values.len()..].iter().all(|byte| *byte == 0));
    }
    server.stop().await;
}

/// A mebibyte of patterns, or one of that length, is told at once: looking for it would take minutes.
#[tokio::test]
async fn names_are_few_and_short_enough_to_look_for() {
    let server = Server::start().await;
    let scene = server.room("?bake=false").await;
    let path = format!("{}/edits", path_of(&scene));
    for (objects, field) in [
        (json!(["cupboard", "*a".repeat(1 << 18) + "b"]), "objects[1]"),
        (json!(vec!["*"; 1 << 16]), "objects"),
        (json!(vec!["*"; 65]), "objects"),
        (json!(vec!["cupboard"; 4097]), "objects"),
    ] {
        for op in ["remove", "hide", "show"] {
            let answer = server.post_json(&path, &json!({ "op": op, "objects": objects })).await;
            assert!(answer.problem(422, "invalid-value").starts_with(&format!("{field}: ")), "{op}");
        }
    }
    // What is allowed takes no time, however it is put together.
    let slow = "*a".repeat(127) + "*b";
    let started = std::time::Instant::now();
    let refused = server.post_json(&path, &json!({ "op": "hide", "objects": vec![slow; 64] })).await;
    refused.problem(422, "unknown-object");
    assert!(started.elapsed() < std::time::Duration::from_secs(5), "{:?}", started.elapsed());
    let hide = json!({ "op": "hide", "objects": ["c*", "*o*"], "budget": { "samples_per_element": 4 } });
    server.edit(&scene, &hide).await;
    server.stop().await;
}
