//! What a scene works towards, and that edits go before it.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::engine::Step;
use super::server::{Answer, Server, next_event, path_of};

fn dim(intensity: f64) -> Value {
    json!({ "op": "relight", "lights": [{ "light": "lamp", "intensity": intensity }] })
}

async fn patch(server: &Server, scene: &Value, body: &Value) -> Answer {
    let request = server.request(reqwest::Method::PATCH, &path_of(scene)).header("content-type", "application/json");
    Answer::to(request.body(body.to_string())).await
}

async fn job(server: &Server, id: &str) -> Value {
    server.get(&format!("/v1/jobs/{id}")).await.json(200)
}

/// The next job of the scene that works towards its target by itself.
async fn refining(server: &Server, events: &mut rebake::client::EventStream) -> String {
    loop {
        let (kind, _, data) = next_event(events).await.expect("the scene is there");
        if kind == "job" && data["kind"] == "refine" && data["state"] == "running" {
            let id = data["id"].as_str().unwrap().to_owned();
            assert_eq!(job(server, &id).await["priority"], "low");
            return id;
        }
    }
}

#[tokio::test]
async fn an_edit_interrupts_a_bake_which_goes_on_behind_it() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("?samples_per_element=20").await;
    let bake = scene["current_job"].as_str().unwrap();
    script.run(&[Step::Round, Step::Round]);
    server.until(bake, |job| job["progress"]["version"] == 2).await;
    let edit = server.edit(&scene, &dim(9.0)).await;
    server.until(&edit, |job| job["state"] == "running").await;
    let waiting = job(&server, bake).await;
    assert_eq!((&waiting["state"], &waiting["progress"]["samples_per_element"]), (&json!("queued"), &json!(8)));
    assert_eq!(server.get(&path_of(&scene)).await.json(200)["current_job"], edit);
    script.run(&[Step::Round, Step::Finish]);
    assert_eq!(server.end_of(&edit).await["state"], "succeeded");
    // It is refined from what the edit has left, and counts the samples that it had.
    script.refine(&[Step::Round, Step::Round, Step::Round, Step::Finish]);
    let end = server.end_of(bake).await;
    let progress = &end["progress"];
    assert_eq!((&end["state"], &progress["samples_per_element"]), (&json!("succeeded"), &json!(20)));
    assert_eq!(server.get(&path_of(&scene)).await.json(200)["unlit_edits"], 0);
    server.stop().await;
}

/// Threads that wait for their part of an edit take up what waits behind it: none of that may wait for the edit.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn targets_and_edits_at_once_hold_nobody_up() {
    let server = Server::with(|config| config.threads = 2).await;
    let scene = server.room("?samples_per_element=1").await;
    let step = |k: i32| {
        let transform = super::glb::translation(0.002 * f64::from(k % 100), 0.0, 0.0);
        json!({ "op": "move", "object": "cupboard", "transform": transform, "budget": { "samples_per_element": 1 } })
    };
    let edits = async {
        for k in 0..400 {
            let answer = server.post_json(&format!("{}/edits", path_of(&scene)), &step(k)).await;
            assert!([202, 429].contains(&answer.status.as_u16()), "{}", answer.status);
        }
    };
    let targets = async {
        for k in 0..400 {
            let target = json!({ "target": { "samples_per_element": 1 + k % 2 } });
            assert_eq!(patch(&server, &scene, &target).await.status, 200);
        }
    };
    tokio::time::timeout(super::server::PATIENCE, async { tokio::join!(edits, targets) }).await.expect("answers");
    server.stop().await;
}

#[tokio::test]
async fn a_bake_without_a_map_starts_anew_with_the_edits() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("?samples_per_element=20").await;
    let bake = scene["current_job"].as_str().unwrap();
    server.until(bake, |job| job["state"] == "running").await;
    let first = server.edit(&scene, &dim(9.0)).await;
    server.until(&first, |job| job["state"] == "running").await;
    // The edit's own bake makes way for the next edit as soon as it has a map.
    let second = server.edit(&scene, &json!({ "op": "remove", "objects": ["cupboard"] })).await;
    script.run(&[Step::Round]);
    assert_eq!(server.end_of(&first).await["state"], "succeeded");
    script.run(&[Step::Round, Step::Finish]);
    assert_eq!(server.end_of(&second).await["state"], "succeeded");
    script.refine(&[Step::Round, Step::Finish]);
    let end = server.end_of(bake).await;
    assert_eq!((&end["state"], &end["progress"]["samples_per_element"]), (&json!("succeeded"), &json!(8)));
    server.stop().await;
}

#[tokio::test]
async fn a_real_bake_of_an_hour_holds_no_edit_up_and_a_new_target_ends_it() {
    let server = Server::start().await;
    let answer =
        server.post_glb(r#"/v1/scenes?spacing=0.3&target={"samples_per_element":60000}"#, super::glb::room().bytes());
    let scene = answer.await.json(201);
    assert_eq!(scene["target"], json!({ "samples_per_element": 60000 }));
    let bake = scene["current_job"].as_str().unwrap();
    server.until(bake, |job| job["progress"]["samples_per_element"].as_u64() > Some(0)).await;
    for intensity in [9.0, 8.0] {
        let mut edit = dim(intensity);
        edit["budget"] = json!({ "samples_per_element": 4 });
        let posted = Instant::now();
        let edit = server.edit(&scene, &edit).await;
        server.until(&edit, |job| job["state"] != "queued").await;
        let started = posted.elapsed();
        assert!(started < Duration::from_secs(5), "{started:?}");
        assert_eq!(server.end_of(&edit).await["state"], "succeeded");
        assert!(job(&server, bake).await["finished_at"].is_null());
    }
    let now = patch(&server, &scene, &json!({ "target": { "samples_per_element": 4 } })).await.json(200);
    assert_eq!(now["target"], json!({ "samples_per_element": 4 }));
    assert_eq!(server.end_of(bake).await["state"], "succeeded");
    server.stop().await;
}

#[tokio::test]
async fn a_canceled_bake_is_taken_up_again_after_the_next_edit() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("?samples_per_element=20").await;
    let bake = scene["current_job"].as_str().unwrap();
    script.run(&[Step::Round]);
    server.until(bake, |job| job["progress"]["version"] == 1).await;
    server.delete(&format!("/v1/jobs/{bake}")).await.json(202);
    assert_eq!(server.end_of(bake).await["state"], "canceled");
    let mut events = server.client.scene_events(scene["id"].as_str().unwrap(), None).await.unwrap();
    let edit = server.edit(&scene, &dim(9.0)).await;
    script.run(&[Step::Round, Step::Finish]);
    assert_eq!(server.end_of(&edit).await["state"], "succeeded");
    let refine = refining(&server, &mut events).await;
    script.refine(&[Step::Round, Step::Finish]);
    let end = server.end_of(&refine).await;
    assert_eq!((&end["state"], &end["progress"]["samples_per_element"]), (&json!("succeeded"), &json!(8)));
    server.stop().await;
}

#[tokio::test]
async fn a_name_and_a_target_can_be_changed_and_are_kept() {
    let directory = tempfile::tempdir().unwrap();
    let start = async || Server::scripted_with(|config| config.data_dir = Some(directory.path().to_owned())).await;
    let (server, script) = start().await;
    script.run(&[Step::Round, Step::Finish]);
    let scene = server.baked_room("?name=first").await;
    assert_eq!(scene["target"], json!({ "samples_per_element": 128 }));
    for (body, field) in [
        (json!({ "target": { "samples_per_element": 0 } }), "target.samples_per_element"),
        (json!({ "target": { "target_rmse": -1 } }), "target.target_rmse"),
        (json!({ "name": "" }), "name"),
        (json!({ "spacing": 1 }), "spacing"),
    ] {
        let detail = patch(&server, &scene, &body).await.problem(422, "invalid-value");
        assert!(detail.contains(field), "{detail}");
    }
    // The name alone changes no light.
    let now = patch(&server, &scene, &json!({ "name": "second" })).await.json(200);
    assert_eq!((&now["name"], &now["target"], &now["current_job"]), (&json!("second"), &scene["target"], &json!(null)));
    let mut events = server.client.scene_events(scene["id"].as_str().unwrap(), None).await.unwrap();
    // A target that is reached already asks for nothing, another one does.
    let reached = patch(&server, &scene, &json!({ "target": { "samples_per_element": 4 } })).await.json(200);
    assert_eq!(reached["current_job"], json!(null));
    let target = json!({ "samples_per_element": 64, "target_rmse": 0.0009765625 });
    patch(&server, &scene, &json!({ "target": target })).await.json(200);
    let refine = refining(&server, &mut events).await;
    script.refine(&[Step::Round, Step::Finish]);
    let end = server.end_of(&refine).await;
    assert_eq!((&end["state"], &end["progress"]["samples_per_element"]), (&json!("succeeded"), &json!(8)));
    server.stop().await;
    let (server, _script) = start().await;
    let again = server.get(&path_of(&scene)).await.json(200);
    assert_eq!((&again["name"], &again["target"]), (&json!("second"), &target));
    server.stop().await;
}

#[tokio::test]
async fn the_target_of_an_upload_is_checked() {
    let server = Server::start().await;
    let glb = || super::glb::room().bytes();
    for query in ["target=4", "target={\"seconds\":1}", "target={}&target_rmse=1", "target={\"max_seconds\":-1}"] {
        let detail = server.post_glb(&format!("/v1/scenes?{query}"), glb()).await.problem(400, "invalid-query");
        assert!(detail.contains("target"), "{detail}");
    }
    assert_eq!(server.room("?bake=false").await["target"], json!(null), "it works towards nothing");
    server.stop().await;
}

#[tokio::test]
async fn seconds_count_from_when_an_edit_was_accepted() {
    let (server, script) = Server::scripted_with(|config| config.job_slots = 1).await;
    let other = server.room("?bake=false").await;
    let (scene, hold) = server.held_room(&script).await;
    let mut edit = dim(9.0);
    edit["budget"] = json!({ "max_seconds": 0.2 });
    let edit = server.edit(&other, &edit).await;
    // It waits until its time is up.
    let accepted = Instant::now();
    while accepted.elapsed() < Duration::from_millis(250) {
        assert_eq!(job(&server, &edit).await["state"], "queued");
    }
    script.run(&[Step::Finish]);
    server.end_of(&hold).await;
    // Its time is up when its turn comes: one round, and no more.
    script.run(&[Step::Round, Step::Round]);
    let end = server.end_of(&edit).await;
    assert_eq!((&end["state"], &end["progress"]["samples_per_element"]), (&json!("succeeded"), &json!(4)));
    assert_eq!(server.get(&path_of(&scene)).await.status, 200);
    server.stop().await;
}

#[tokio::test]
async fn work_towards_a_target_takes_turns_with_other_scenes() {
    let (server, script) = Server::scripted_with(|config| {
        config.job_slots = 1;
        config.timeouts.share = Duration::ZERO;
    })
    .await;
    let long = server.room("").await;
    let long = long["current_job"].as_str().unwrap();
    script.run(&[Step::Round]);
    server.until(long, |job| job["progress"]["version"] == 1).await;
    let other = server.room("").await;
    let other = other["current_job"].as_str().unwrap();
    server.until(other, |job| job["state"] == "running").await;
    let waiting = job(&server, long).await;
    assert_eq!((&waiting["state"], &waiting["progress"]["version"]), (&json!("queued"), &json!(1)));
    script.run(&[Step::Round]);
    server.until(long, |job| job["state"] == "running").await;
    // Both go on from where they were.
    script.refine(&[Step::Finish, Step::Finish]);
    for job in [long, other] {
        let end = server.end_of(job).await;
        assert_eq!((&end["state"], &end["progress"]["version"]), (&json!("succeeded"), &json!(1)), "{end}");
    }
    server.stop().await;
}

#[tokio::test]
async fn a_dry_run_tells_what_the_upload_takes_and_keeps_nothing() {
    let server = Server::start().await;
    let glb = || super::glb::room().bytes();
    for layers in ["", "&layers=each"] {
        let query = format!("/v1/scenes?spacing=0.4&bake=false{layers}");
        let plan = server.post_glb(&format!("{query}&dry_run=true"), glb()).await.json(200);
        assert_eq!(server.get("/v1/scenes").await.json(200)["items"], json!([]), "nothing is kept");
        let scene = server.post_glb(&query, glb()).await.json(201);
        for (told, is) in [
            ("spacing", "spacing"),
            ("elements", "live_elements"),
            ("triangles", "triangles"),
            ("warnings", "warnings"),
            ("degenerate_triangles", "degenerate_triangles"),
        ] {
            assert_eq!(plan[told], scene[is], "{told}");
        }
        assert_eq!(plan["objects"], 2);
        let (told, held) = (plan["memory_bytes"].as_u64().unwrap(), scene["memory_bytes"].as_u64().unwrap());
        assert!(told >= held && (told == held) == layers.is_empty(), "{told} {held}");
        server.delete(&path_of(&scene)).await;
    }
    let refused = server.post_glb("/v1/scenes?dry_run=true", b"no glTF".to_vec()).await;
    refused.problem(400, "malformed-file");
    server.stop().await;
}

#[tokio::test]
async fn a_canceled_edit_is_taken_up_by_a_new_target_or_an_empty_edit() {
    let (server, script) = Server::scripted().await;
    for takes_up in ["target", "edit"] {
        let (scene, hold) = server.held_room(&script).await;
        let edit = server.edit(&scene, &json!({ "op": "remove", "objects": ["cupboard"] })).await;
        server.delete(&format!("/v1/jobs/{edit}")).await.json(200);
        script.run(&[Step::Round, Step::Finish]);
        server.end_of(&hold).await;
        let mut events = server.client.scene_events(scene["id"].as_str().unwrap(), None).await.unwrap();
        let job = match takes_up {
            "target" => {
                patch(&server, &scene, &json!({ "target": { "samples_per_element": 4 } })).await.json(200);
                refining(&server, &mut events).await
            }
            _ => server.edit(&scene, &json!({ "edits": [] })).await,
        };
        script.run(&[Step::Round, Step::Finish]);
        assert_eq!(server.end_of(&job).await["state"], "succeeded", "{takes_up}");
        let now = server.get(&path_of(&scene)).await.json(200);
        assert_eq!((&now["unlit_edits"], &now["published_edits"]), (&json!(0), &json!(2)), "{takes_up}");
    }
    server.stop().await;
}
