//! An orderly end.

use std::time::Duration;

use reqwest::Method;
use serde_json::json;

use super::engine::Step;
use super::server::{Server, next_event, path_of, patiently};

#[tokio::test]
async fn a_stop_cancels_jobs_and_ends_streams_cleanly() {
    let (mut server, script) = Server::scripted().await;
    let scene = server.room("?samples_per_element=4000").await;
    let bake = scene["current_job"].as_str().unwrap();
    script.run(&[Step::Round]);
    server.until(bake, |job| job["progress"]["version"] == 1).await;
    let edit = server.edit(&scene, &json!({ "op": "remove", "objects": ["cupboard"] })).await;
    let mut of_bake = server.client.job_events(bake, None).await.unwrap();
    let mut of_edit = server.client.job_events(&edit, None).await.unwrap();
    let mut of_scene = server.client.scene_events(scene["id"].as_str().unwrap(), None).await.unwrap();
    let path = format!("{}/lightmap/deltas?since=0&follow=true", path_of(&scene));
    let mut deltas = server.request(Method::GET, &path).send().await.unwrap();
    patiently(deltas.chunk()).await.unwrap().unwrap();
    server.signal();
    for events in [&mut of_bake, &mut of_edit] {
        let mut last = None;
        while let Some((_, _, data)) = next_event(events).await {
            last = Some(data["state"].clone());
        }
        assert_eq!(last, Some(json!("canceled")));
    }
    while next_event(&mut of_scene).await.is_some() {}
    while patiently(deltas.chunk()).await.unwrap().is_some() {}
    server.stop().await;
}

#[tokio::test]
async fn a_stop_does_not_wait_for_ever() {
    let (server, _script) = Server::scripted_with(|config| config.timeouts.shutdown = Duration::from_millis(300)).await;
    let scene = server.room("?bake=false").await;
    // A stream that nobody reads, and an idle connection.
    let path = format!("{}/events", path_of(&scene));
    let _unread = server.request(Method::GET, &path).send().await.unwrap();
    server.stop().await;
}
