//! Jobs: order, fairness, cancel, failure, retention.

use futures_util::future::join_all;
use serde_json::{Value, json};

use super::engine::Step;
use super::server::{Server, path_of};

fn paint(albedo: f64) -> Value {
    json!({ "op": "material", "object": "room", "albedo": [albedo, albedo, albedo] })
}

/// Another change, which no paint makes superfluous.
fn dim(intensity: f64) -> Value {
    json!({ "op": "relight", "lights": [{ "light": "lamp", "intensity": intensity }] })
}

fn move_cupboard(x: f64) -> Value {
    json!({ "op": "move", "object": "cupboard", "transform": super::glb::translation(x, 0.0, 0.0) })
}

fn id(job: &Value) -> &str {
    job["id"].as_str().unwrap()
}

#[tokio::test]
async fn one_job_of_a_scene_at_a_time_and_the_rest_wait_in_order() {
    let (server, script) = Server::scripted().await;
    let (scene, hold) = server.held_room(&script).await;
    let edits = [server.edit(&scene, &paint(0.1)).await, server.edit(&scene, &dim(9.0)).await];
    let states = async || {
        let jobs = server.get(&format!("/v1/jobs?scene={}", id(&scene))).await.json(200);
        let jobs = jobs["items"].as_array().unwrap().clone();
        jobs.iter()
            .take(3)
            .map(|job| format!("{} {}", job["id"].as_str().unwrap(), job["state"].as_str().unwrap()))
            .collect::<Vec<_>>()
    };
    let line = |job: &str, state: &str| format!("{job} {state}");
    assert_eq!(states().await, [line(&edits[1], "queued"), line(&edits[0], "queued"), line(&hold, "running")]);
    script.run(&[Step::Round, Step::Finish]);
    server.until(&edits[0], |job| job["state"] == "running").await;
    assert_eq!(states().await, [line(&edits[1], "queued"), line(&edits[0], "running"), line(&hold, "succeeded")]);
    let queued = server.get("/v1/jobs?state=queued").await.json(200);
    assert_eq!(queued["items"].as_array().unwrap().len(), 1);
    script.run(&[Step::Finish, Step::Finish]);
    assert_eq!(server.end_of(&edits[1]).await["state"], "succeeded");
    server.get("/v1/jobs?state=asleep").await.problem(400, "invalid-query");
    server.stop().await;
}

#[tokio::test]
async fn progress_never_falls_and_versions_rise() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("?samples_per_element=20").await;
    let job = scene["current_job"].as_str().unwrap();
    script.run(&[Step::Round; 5]);
    script.run(&[Step::Finish]);
    let mut events = server.client.job_events(job, Some("0")).await.unwrap();
    let (mut fraction, mut version) = (0.0, 0);
    while let Some((kind, _, data)) = super::server::next_event(&mut events).await {
        if kind == "job" {
            let now = data["progress"]["fraction"].as_f64().unwrap();
            assert!((fraction..=1.0).contains(&now), "{fraction} {now}");
            fraction = now;
        } else {
            assert_eq!(kind, "snapshot");
            let now = data["version"].as_u64().unwrap();
            assert_eq!(now, version + 1);
            assert_eq!(data["job"], job);
            version = now;
        }
    }
    assert_eq!((fraction, version), (1.0, 5));
    server.stop().await;
}

#[tokio::test]
async fn a_canceled_queued_edit_stays_and_is_lit_by_the_next_job() {
    let (server, script) = Server::scripted().await;
    let (scene, hold) = server.held_room(&script).await;
    let first = server.edit(&scene, &json!({ "op": "remove", "objects": ["cupboard"] })).await;
    let canceled = server.delete(&format!("/v1/jobs/{first}")).await.json(200);
    assert_eq!(canceled["state"], "canceled");
    server.delete(&format!("/v1/jobs/{first}")).await.problem(409, "job-ended");
    let mut events = server.client.scene_events(id(&scene), None).await.unwrap();
    script.run(&[Step::Round, Step::Finish]);
    server.end_of(&hold).await;
    // No job of this scene is left: its geometry is shown all the same, with old light.
    loop {
        let (kind, _, data) = super::server::next_event(&mut events).await.unwrap();
        // That of the edit before may come as well.
        if kind == "scene" && server.get(&path_of(&scene)).await.json(200)["published_edits"] == 2 {
            assert_eq!(data["what"], "edited");
            break;
        }
    }
    let now = server.get(&path_of(&scene)).await.json(200);
    assert_eq!(now["objects"].as_array().unwrap().len(), 1);
    assert_eq!(now["unlit_edits"], 1);
    assert_eq!(now["estimated_rmse"], json!(null), "the light is that of another scene");
    let rest = server.edit(&scene, &json!({ "edits": [] })).await;
    script.run(&[Step::Round, Step::Finish]);
    assert_eq!(server.end_of(&rest).await["state"], "succeeded");
    let now = server.get(&path_of(&scene)).await.json(200);
    assert_eq!((&now["unlit_edits"], now["estimated_rmse"].is_number()), (&json!(0), true));
    server.stop().await;
}

#[tokio::test]
async fn a_running_job_stops_and_the_map_stays_consistent() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("").await;
    let bake = scene["current_job"].as_str().unwrap();
    script.run(&[Step::Round]);
    server.until(bake, |job| job["progress"]["version"] == 1).await;
    let asked = server.delete(&format!("/v1/jobs/{bake}")).await;
    assert!(asked.status == 202 || asked.status == 409, "{asked:?}");
    assert_eq!(server.end_of(bake).await["state"], "canceled");
    assert_eq!(server.get(&path_of(&scene)).await.json(200)["version"], 1);
    // The one round was enough: an edit goes on from there. Canceled before its first round, it is not lit.
    let edit = server.edit(&scene, &json!({ "op": "remove", "objects": ["cupboard"] })).await;
    server.until(&edit, |job| job["state"] == "running").await;
    server.delete(&format!("/v1/jobs/{edit}")).await.json(202);
    assert_eq!(server.end_of(&edit).await["state"], "canceled");
    let now = server.get(&path_of(&scene)).await.json(200);
    assert_eq!((&now["version"], &now["unlit_edits"]), (&json!(2), &json!(1)), "carried over, not lit");
    // The next job lights both.
    let next = server.edit(&scene, &paint(0.3)).await;
    script.run(&[Step::Round, Step::Finish, Step::Round, Step::Finish]);
    assert_eq!(server.end_of(&next).await["state"], "succeeded");
    assert_eq!(server.get(&path_of(&scene)).await.json(200)["unlit_edits"], 0);
    server.stop().await;
}

#[tokio::test]
async fn an_urgent_upload_goes_before_others() {
    let (server, script) = Server::scripted_with(|config| config.job_slots = 1).await;
    let first = server.room("").await;
    server.until(first["current_job"].as_str().unwrap(), |job| job["state"] == "running").await;
    let (usual, urgent) = (server.room("").await, server.room("?priority=high").await);
    let (usual, urgent) = (usual["current_job"].as_str().unwrap(), urgent["current_job"].as_str().unwrap());
    script.run(&[Step::Round, Step::Finish]);
    assert_eq!(server.until(urgent, |job| job["state"] == "running").await["priority"], "high");
    assert_eq!(server.get(&format!("/v1/jobs/{usual}")).await.json(200)["state"], "queued");
    server.post_glb("/v1/scenes?priority=now", super::glb::room().bytes()).await.problem(400, "invalid-query");
    server.stop().await;
}

#[tokio::test]
async fn a_panicking_job_fails_and_the_service_lives_on() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("").await;
    script.run(&[Step::Round, Step::Panic]);
    let job = server.end_of(scene["current_job"].as_str().unwrap()).await;
    assert_eq!(job["state"], "failed");
    assert!(job["error"].as_str().unwrap().contains("scripted panic"), "{job}");
    // The next job of the scene bakes afresh.
    let edit = server.edit(&scene, &paint(0.3)).await;
    script.run(&[Step::Round, Step::Finish]);
    assert_eq!(server.end_of(&edit).await["state"], "succeeded");
    assert_eq!(server.get(&path_of(&scene)).await.json(200)["unlit_edits"], 0);
    server.get("/healthz").await.json(200);
    server.stop().await;
}

#[tokio::test]
async fn scenes_run_side_by_side_and_take_turns() {
    let (server, script) = Server::scripted_with(|config| config.job_slots = 2).await;
    let scenes = join_all((0..3).map(|_| server.room(""))).await;
    script.run(&[Step::Round, Step::Finish].repeat(3));
    join_all(scenes.iter().map(|scene| server.end_of(scene["current_job"].as_str().unwrap()))).await;
    let edits = join_all(scenes.iter().map(|scene| {
        let server = &server;
        async move { server.edit(scene, &paint(0.1)).await }
    }))
    .await;
    let second = server.edit(&scenes[0], &dim(9.0)).await;
    server.until(&edits[0], |_| true).await;
    let running = server.get("/v1/jobs?state=running").await.json(200);
    assert_eq!(running["items"].as_array().unwrap().len(), 2);
    script.run(&[Step::Round, Step::Finish].repeat(4));
    let ends = join_all(edits.iter().map(|edit| server.end_of(edit))).await;
    assert!(ends.iter().all(|job| job["state"] == "succeeded"));
    // The third scene's first edit began before the first scene's second one.
    let started = |job: &Value| job["started_at"].as_str().map(str::to_owned);
    let second = server.end_of(&second).await;
    assert!(started(&second) >= ends.iter().map(started).max().unwrap());
    server.stop().await;
}

#[tokio::test]
async fn queues_and_memory_of_jobs_are_bounded() {
    let (server, script) = Server::scripted_with(|config| {
        config.limits.queued_per_scene = 2;
        config.limits.finished_jobs = 2;
    })
    .await;
    let (scene, hold) = server.held_room(&script).await;
    server.edit(&scene, &paint(0.1)).await;
    let last = server.edit(&scene, &dim(9.0)).await;
    let refused = server.post_json(&format!("{}/edits", path_of(&scene)), &paint(0.3)).await;
    refused.problem(429, "queue-full");
    assert_eq!(refused.header("retry-after"), "1");
    script.run(&[Step::Round, Step::Finish].repeat(3));
    server.end_of(&last).await;
    server.get(&format!("/v1/jobs/{hold}")).await.problem(404, "unknown-job");
    let jobs = server.get("/v1/jobs?limit=1").await.json(200);
    assert_eq!(jobs["items"][0]["id"], last);
    let rest = server.get(&format!("/v1/jobs?cursor={}", jobs["next_cursor"].as_str().unwrap())).await.json(200);
    assert_eq!(rest["items"].as_array().unwrap().len(), 1);
    assert_eq!(rest["next_cursor"], json!(null));
    server.stop().await;
}

#[tokio::test]
async fn the_same_calls_give_the_same_bits() {
    let mut maps = Vec::new();
    for other_scene_first in [false, true] {
        let server = Server::start().await;
        if other_scene_first {
            server.room("?bake=false").await;
        }
        let scene = server.baked_room("?samples_per_element=8").await;
        let mut edit = json!({ "op": "remove", "objects": ["cupboard"] });
        edit["budget"] = json!({ "samples_per_element": 8 });
        server.end_of(&server.edit(&scene, &edit).await).await;
        maps.push(server.get(&format!("{}/lightmap?format=raw", path_of(&scene))).await.body);
        server.stop().await;
    }
    assert!(maps[0] == maps[1]);
}

#[tokio::test]
async fn moves_that_queue_up_are_lit_as_one() {
    let (server, script) = Server::scripted().await;
    let (scene, _hold) = server.held_room(&script).await;
    let mut moves = Vec::new();
    for x in 1..=5 {
        moves.push(server.edit(&scene, &move_cupboard(0.1 * f64::from(x))).await);
    }
    let dimmed = server.edit(&scene, &dim(3.0)).await;
    let last = moves.pop().unwrap();
    script.run(&[Step::Round, Step::Finish]);
    server.until(&last, |job| job["state"] == "running").await;
    for job in &moves {
        let job = server.get(&format!("/v1/jobs/{job}")).await.json(200);
        assert_eq!((&job["state"], &job["merged_into"]), (&json!("queued"), &json!(last)), "{job}");
    }
    // One run of the engine for all five, and another one for the lamp.
    script.run(&[Step::Round, Step::Finish]);
    for job in &moves {
        let job = server.end_of(job).await;
        assert_eq!((&job["state"], &job["merged_into"]), (&json!("succeeded"), &json!(last)), "{job}");
    }
    assert_eq!(server.end_of(&last).await["merged_into"], json!(null));
    script.run(&[Step::Round, Step::Finish]);
    assert_eq!(server.end_of(&dimmed).await["state"], "succeeded");
    let now = server.get(&path_of(&scene)).await.json(200);
    assert_eq!(now["unlit_edits"], 0);
    let x = now["objects"][1]["bounds"]["min"][0].as_f64().unwrap();
    assert!((x - 1.0).abs() < 1e-5, "the last move counts: {x}");
    server.stop().await;
}

#[tokio::test]
async fn what_comes_and_goes_while_it_waits_needs_no_light() {
    let (server, script) = Server::scripted().await;
    let asset = server.crate_asset().await;
    let (scene, _hold) = server.held_room(&script).await;
    let at = super::glb::translation(2.0, 0.01, 2.0);
    let insert = json!({ "op": "insert", "asset": asset, "name": "a", "transform": at });
    let insert = server.edit(&scene, &insert).await;
    let remove = server.edit(&scene, &json!({ "op": "remove", "objects": ["a"] })).await;
    script.run(&[Step::Round, Step::Finish]);
    // No step of the engine is needed for these.
    for job in [&insert, &remove] {
        assert_eq!(server.end_of(job).await["state"], "succeeded");
    }
    let now = server.get(&path_of(&scene)).await.json(200);
    assert_eq!(now["objects"].as_array().unwrap().len(), 2);
    assert_eq!(now["unlit_edits"], 0);
    // The slots it had are a hole, and the map is as long as they are.
    let raw = server.get(&format!("{}/lightmap?format=raw", path_of(&scene))).await.body;
    let (frame, _) = rebake_core::delta::Frame::decode(&raw).unwrap();
    assert_eq!(frame.values.len() as u64, now["elements"].as_u64().unwrap());
    server.stop().await;
}

#[tokio::test]
async fn a_canceled_job_lets_go_of_those_merged_into_it() {
    let (server, script) = Server::scripted().await;
    let (scene, _hold) = server.held_room(&script).await;
    let first = server.edit(&scene, &move_cupboard(0.1)).await;
    let second = server.edit(&scene, &move_cupboard(0.2)).await;
    script.run(&[Step::Round, Step::Finish]);
    server.until(&second, |job| job["state"] == "running").await;
    server.delete(&format!("/v1/jobs/{second}")).await.json(202);
    assert_eq!(server.end_of(&second).await["state"], "canceled");
    script.run(&[Step::Round, Step::Finish, Step::Round, Step::Finish]);
    let first = server.end_of(&first).await;
    assert_eq!((&first["state"], &first["merged_into"]), (&json!("succeeded"), &json!(null)), "{first}");
    server.stop().await;
}

#[tokio::test]
async fn a_high_priority_goes_first() {
    let (server, script) = Server::scripted_with(|config| config.job_slots = 1).await;
    let scenes = join_all((0..3).map(|_| server.room("?bake=false"))).await;
    let hold = server.edit(&scenes[0], &paint(0.1)).await;
    server.until(&hold, |job| job["state"] == "running").await;
    let normal = server.edit(&scenes[1], &paint(0.1)).await;
    let mut urgent = paint(0.1);
    urgent["priority"] = json!("high");
    let urgent = server.edit(&scenes[2], &urgent).await;
    script.run(&[Step::Round, Step::Finish].repeat(3));
    let (normal, urgent) = (server.end_of(&normal).await, server.end_of(&urgent).await);
    assert!(urgent["started_at"].as_str() < normal["started_at"].as_str());
    assert_eq!(urgent["priority"], "high");
    let mut wrong = paint(0.1);
    wrong["priority"] = json!("urgent");
    let refused = server.post_json(&format!("{}/edits", path_of(&scenes[0])), &wrong).await;
    assert!(refused.problem(422, "invalid-value").contains("priority"));
    server.stop().await;
}

#[tokio::test]
async fn progress_moves_within_a_pass_and_tells_when_it_ends() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("?samples_per_element=8").await;
    let bake = scene["current_job"].as_str().unwrap();
    script.run(&[Step::Half]);
    let job = server.until(bake, |job| job["progress"]["fraction"].as_f64() > Some(0.21)).await;
    // Half of the first loop of the gather, which the engine says begins after 2 of 5 parts of the first of two rounds.
    assert!((job["progress"]["fraction"].as_f64().unwrap() - 0.275).abs() < 1e-6, "{job}");
    assert!(job["progress"]["remaining_ms"].is_number(), "{job}");
    script.run(&[Step::Round, Step::Finish]);
    assert_eq!(server.end_of(bake).await["state"], "succeeded");
    server.stop().await;
}
