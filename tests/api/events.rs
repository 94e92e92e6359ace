//! Server-sent events and how to resume them.

use serde_json::json;

use super::engine::Step;
use super::server::{Server, next_event, path_of};

#[tokio::test]
async fn a_job_stream_begins_with_the_state_and_ends_with_the_job() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("").await;
    let job = scene["current_job"].as_str().unwrap();
    let mut events = server.client.job_events(job, None).await.unwrap();
    let (kind, _, first) = next_event(&mut events).await.unwrap();
    assert_eq!((kind.as_str(), &first["id"]), ("job", &json!(job)));
    script.run(&[Step::Round, Step::Finish]);
    let mut last = None;
    while let Some(event) = next_event(&mut events).await {
        last = Some(event);
    }
    let (kind, last_id, data) = last.unwrap();
    assert_eq!((kind.as_str(), &data["state"]), ("job", &json!("succeeded")));
    // Resumed after its last event there is nothing: 204 tells browsers not to come back.
    let request = server.request(reqwest::Method::GET, &format!("/v1/jobs/{job}/events"));
    let answer = request.header("last-event-id", last_id.to_string()).send().await.unwrap();
    assert_eq!(answer.status(), 204);
    server.stop().await;
}

#[tokio::test]
async fn a_resumed_stream_misses_nothing_and_repeats_nothing() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("").await;
    let id = scene["id"].as_str().unwrap();
    script.run(&[Step::Round, Step::Round, Step::Round, Step::Finish]);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    let mut all = Vec::new();
    let mut events = server.client.scene_events(id, Some("0")).await.unwrap();
    loop {
        let event = next_event(&mut events).await.unwrap();
        let ended = event.0 == "job" && event.2["state"] == "succeeded";
        all.push(event);
        if ended {
            break;
        }
    }
    let ids: Vec<u64> = all.iter().map(|event| event.1).collect();
    assert_eq!(ids, (1..=ids.len() as u64).collect::<Vec<_>>());
    assert_eq!(all.iter().filter(|event| event.0 == "snapshot").count(), 3);
    for cut in [1, ids.len() / 2, ids.len() - 1] {
        let mut events = server.client.scene_events(id, Some(&cut.to_string())).await.unwrap();
        for expected in &all[cut..] {
            assert_eq!(next_event(&mut events).await.as_ref(), Some(expected));
        }
    }
    server.stop().await;
}

#[tokio::test]
async fn who_was_away_too_long_gets_the_whole_state() {
    let (server, script) = Server::scripted_with(|config| config.limits.events = 4).await;
    let scene = server.room("?samples_per_element=400").await;
    let (id, job) = (scene["id"].as_str().unwrap(), scene["current_job"].as_str().unwrap());
    script.run(&[Step::Round; 10]);
    server.until(job, |job| job["progress"]["version"] == 10).await;
    for last in ["1", "123456789", "nonsense"] {
        let mut events = server.client.job_events(job, Some(last)).await.unwrap();
        let (kind, _, data) = next_event(&mut events).await.unwrap();
        assert_eq!((kind.as_str(), &data["progress"]["version"]), ("reset", &json!(10)));
        let mut events = server.client.scene_events(id, Some(last)).await.unwrap();
        let (kind, _, data) = next_event(&mut events).await.unwrap();
        assert_eq!((kind.as_str(), &data["version"]), ("reset", &json!(10)));
    }
    script.run(&[Step::Finish]);
    server.end_of(job).await;
    server.stop().await;
}

#[tokio::test]
async fn a_scene_stream_tells_of_edits_and_of_the_end() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("?bake=false").await;
    let mut events = server.client.scene_events(scene["id"].as_str().unwrap(), None).await.unwrap();
    assert_eq!(next_event(&mut events).await.unwrap().0, "scene_state");
    let edit = server.edit(&scene, &json!({ "op": "remove", "objects": ["cupboard"] })).await;
    script.run(&[Step::Round, Step::Finish]);
    let mut told = Vec::new();
    loop {
        let (kind, _, data) = next_event(&mut events).await.unwrap();
        if kind != "job" {
            told.push(format!("{kind} {}", data["version"]));
        } else if data["state"] == "succeeded" {
            assert_eq!(data["id"], edit);
            break;
        }
    }
    assert_eq!(told, ["scene 1", "snapshot 1", "snapshot 2"]);
    server.delete(&path_of(&scene)).await;
    let (kind, _, data) = next_event(&mut events).await.unwrap();
    assert_eq!((kind.as_str(), &data["what"]), ("scene", &json!("deleted")));
    assert!(next_event(&mut events).await.is_none());
    server.stop().await;
}

#[tokio::test]
async fn there_are_as_many_streams_as_may_be() {
    let (server, _script) = Server::scripted_with(|config| config.limits.streams = 1).await;
    let scene = server.room("").await;
    let path = format!("{}/events", path_of(&scene));
    let mut first = server.client.scene_events(scene["id"].as_str().unwrap(), None).await.unwrap();
    next_event(&mut first).await.unwrap();
    server.get(&path).await.problem(429, "too-many-streams");
    server.get(&format!("{}/lightmap/deltas?since=0", path_of(&scene))).await.problem(429, "too-many-streams");
    server.get("/v1/jobs/j99-zzzzzz/events").await.problem(404, "unknown-job");
    server.stop().await;
}
