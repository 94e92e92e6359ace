//! While no job waits, light maps are refined: published like any other version, and never in a job's way.

use rebake::client::EventStream;
use rebake::config::IdleRefine;
use serde_json::{Value, json};

use super::durable::fast_directory;
use super::engine::Step;
use super::server::{Server, next_event, path_of, patiently};

/// The next version that no job published.
async fn refined(events: &mut EventStream) -> Value {
    loop {
        let (kind, _, data) = next_event(events).await.expect("the scene is there");
        if kind == "snapshot" && data["job"].is_null() && data["estimated_rmse"].is_number() {
            return data;
        }
    }
}

async fn scene_events(server: &Server, scene: &Value) -> EventStream {
    server.client.scene_events(scene["id"].as_str().unwrap(), None).await.unwrap()
}

fn dim(samples: u32) -> Value {
    json!({ "op": "relight", "lights": [{ "light": "lamp", "intensity": 9 }],
        "budget": { "samples_per_element": samples } })
}

/// Waits until nothing is refined any more.
async fn until_good_enough(server: &Server) {
    let idle = async {
        loop {
            let text = String::from_utf8(server.get("/metrics").await.body).unwrap();
            if text.lines().any(|line| line == "rebake_refining 0") {
                return;
            }
        }
    };
    patiently(idle).await;
}

#[tokio::test]
async fn a_scene_is_refined_while_no_job_waits_and_a_job_starts_at_once() {
    let (server, script) = Server::scripted_with(|config| {
        config.idle_refine = Some(IdleRefine { error_share: 1e-9, samples: 16 });
    })
    .await;
    let scene = server.room("").await;
    let mut events = scene_events(&server, &scene).await;
    script.run(&[Step::Round, Step::Finish]);
    assert_eq!(server.end_of(scene["current_job"].as_str().unwrap()).await["state"], "succeeded");
    let mut stated = 0.25;
    // A spell ends where the error has halved; the next one begins by itself.
    for (version, steps) in [(2, &[Step::Round][..]), (3, &[Step::Finish, Step::Round])] {
        script.refine(steps);
        let snapshot = refined(&mut events).await;
        assert_eq!(snapshot["version"], version);
        let now = snapshot["estimated_rmse"].as_f64().unwrap();
        assert!(now < 0.6 * stated, "{now} after {stated}");
        stated = now;
    }
    // Refining waits for its script, and is in nobody's way.
    let job = server.edit(&scene, &dim(4)).await;
    server.until(&job, |job| job["state"] == "running").await;
    script.run(&[Step::Round, Step::Finish]);
    let job = server.end_of(&job).await;
    assert_eq!((&job["state"], &job["progress"]["version"]), (&json!("succeeded"), &json!(5)));
    // And goes on with what the job left.
    script.refine(&[Step::Round]);
    assert_eq!(refined(&mut events).await["version"], 6);
    // An engine that breaks down on a refinement harms nothing.
    script.refine(&[Step::Panic]);
    until_good_enough(&server).await;
    assert_eq!(server.get(&path_of(&scene)).await.json(200)["version"], 6);
    server.stop().await;
}

#[tokio::test]
async fn the_stated_error_falls_while_the_service_is_idle_and_what_was_gained_is_kept() {
    let directory = fast_directory();
    let start = async |idle_refine| {
        Server::with(|config| {
            config.idle_refine = idle_refine;
            config.data_dir = Some(directory.path().to_owned());
        })
        .await
    };
    let server = start(Some(IdleRefine { error_share: 1e-9, samples: 64 })).await;
    let scene = server.room("?samples_per_element=8").await;
    let mut events = scene_events(&server, &scene).await;
    let bake = server.end_of(scene["current_job"].as_str().unwrap()).await;
    let (version, baked) = (&bake["progress"]["version"], bake["progress"]["estimated_rmse"].as_f64().unwrap());
    let mut stated = baked;
    while stated > 0.5 * baked {
        let now = refined(&mut events).await["estimated_rmse"].as_f64().unwrap();
        assert!(now < stated, "{now} after {stated}");
        stated = now;
    }
    // There is an end to it: the scene is as good as so many samples make it.
    until_good_enough(&server).await;
    let path = format!("{}/lightmap", path_of(&scene));
    let refined = server.get(&path_of(&scene)).await.json(200);
    assert!(refined["estimated_rmse"].as_f64().unwrap() <= stated);
    let delta = server.get(&format!("{path}/deltas?since={version}")).await;
    assert_eq!(delta.header("x-rebake-version"), refined["version"].to_string());
    let raw = server.get(&format!("{path}?format=raw")).await.body;
    server.stop().await;

    let server = start(None).await;
    let again = server.get(&path_of(&scene)).await.json(200);
    assert_eq!(again["estimated_rmse"], refined["estimated_rmse"]);
    let (before, after) = (raw, server.get(&format!("{path}?format=raw")).await.body);
    let values = |bytes: &[u8]| rebake_core::delta::Frame::decode(bytes).unwrap().0.values;
    assert!(values(&before) == values(&after), "what was published is what was kept");
    assert_eq!(server.end_of(&server.edit(&scene, &dim(8)).await).await["state"], "succeeded");
    server.stop().await;
}
