//! Uploads that are answered before their scenes are built.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use rebake::Config;
use rebake::engine::{Engine, Scene, World, WorldError, WorldOptions};
use serde_json::json;

use super::glb;
use super::server::{Server, next_event, path_of};

/// Builds a scene when the test says so, or fails at it.
#[derive(Debug)]
struct Gate(Mutex<Receiver<Option<WorldError>>>);

impl Engine for Gate {
    fn build(&self, scene: Scene, options: &WorldOptions) -> Result<World, WorldError> {
        match self.0.lock().unwrap().recv() {
            Ok(None) => World::new(scene, options),
            Ok(Some(error)) => Err(error),
            // The test is over.
            Err(_) => Err(WorldError::Spacing("is none".to_owned())),
        }
    }
}

async fn gated(change: impl FnOnce(&mut Config)) -> (Server, Sender<Option<WorldError>>) {
    let (open, gate) = channel();
    let server = Server::with(|config| {
        config.engine = Arc::new(Gate(Mutex::new(gate)));
        config.timeouts.upload_answer = Duration::ZERO;
        change(config);
    });
    (server.await, open)
}

#[tokio::test]
async fn an_upload_is_answered_before_its_scene_is_built() {
    let (server, open) = gated(|_| ()).await;
    let scene = server.post_glb("/v1/scenes?samples_per_element=4&layers=each", glb::room().bytes()).await.json(201);
    assert_eq!((&scene["state"], &scene["version"], &scene["elements"]), (&json!("preparing"), &json!(0), &json!(0)));
    assert!(scene["spacing"].as_f64().unwrap() > 0.0);
    let bake = scene["current_job"].as_str().unwrap();
    assert_eq!(server.get(&format!("/v1/jobs/{bake}")).await.json(200)["state"], "queued");
    assert_eq!(server.get("/v1/scenes").await.json(200)["items"][0]["state"], "preparing");
    let mut events = server.client.scene_events(scene["id"].as_str().unwrap(), None).await.unwrap();
    let (kind, _, data) = next_event(&mut events).await.unwrap();
    assert_eq!((kind.as_str(), &data["state"]), ("scene_state", &json!("preparing")));
    // What needs the scene waits for it.
    let edit = json!({ "op": "remove", "objects": ["cupboard"] });
    let elements = format!("{}/elements", path_of(&scene));
    let (edit, elements, ()) = tokio::join!(server.edit(&scene, &edit), server.get(&elements), async {
        open.send(None).unwrap();
    });
    assert!(!elements.body.is_empty());
    loop {
        let (kind, _, data) = next_event(&mut events).await.expect("the scene is there");
        if kind == "scene" {
            assert_eq!(
                (&data["what"], &data["version"], &data["elements_version"]),
                (&json!("edited"), &json!(1), &json!(1))
            );
            break;
        }
    }
    drop(events);
    for job in [bake, &edit] {
        assert_eq!(server.end_of(job).await["state"], "succeeded");
    }
    let after = server.get(&path_of(&scene)).await.json(200);
    assert_eq!((&after["state"], &after["spacing"]), (&json!("ready"), &scene["spacing"]));
    assert_eq!(after["objects"].as_array().unwrap().len(), 1);
    server.stop().await;
}

#[tokio::test]
async fn requests_do_not_wait_for_ever() {
    let (server, open) = gated(|config| config.timeouts.preparing = Duration::ZERO).await;
    let scene = server.post_glb("/v1/scenes", glb::room().bytes()).await.json(201);
    let answer = server.get(&format!("{}/lightmap", path_of(&scene))).await;
    answer.problem(503, "scene-preparing");
    assert_eq!(answer.header("retry-after"), "5");
    drop(open);
    server.stop().await;
}

#[tokio::test]
async fn a_scene_that_cannot_be_built_says_why() {
    let (server, open) = gated(|_| ()).await;
    let scene = server.post_glb("/v1/scenes", glb::room().bytes()).await.json(201);
    let mut events = server.client.scene_events(scene["id"].as_str().unwrap(), None).await.unwrap();
    open.send(Some(WorldError::TooLarge { what: "elements", limit: 7, spacing: 0.5 })).unwrap();
    let job = server.end_of(scene["current_job"].as_str().unwrap()).await;
    assert_eq!(job["state"], "failed");
    let reason = "the scene has more than 7 elements at a spacing of 0.5 m";
    assert_eq!(job["error"], reason);
    let after = server.get(&path_of(&scene)).await.json(200);
    assert_eq!((&after["state"], &after["error"]), (&json!("damaged"), &json!(reason)));
    assert_eq!(server.get(&format!("{}/elements", path_of(&scene))).await.problem(500, "scene-damaged"), reason);
    loop {
        let (kind, _, data) = next_event(&mut events).await.expect("who listens is told");
        if kind == "scene" {
            assert_eq!(data["what"], "damaged");
            break;
        }
    }
    drop(events);
    server.delete(&path_of(&scene)).await;
    assert_eq!(server.get("/v1/scenes").await.json(200)["items"], json!([]));
    server.stop().await;
}

#[tokio::test]
async fn one_that_is_built_too_late_is_gone() {
    let (server, open) = gated(|_| ()).await;
    let scene = server.post_glb("/v1/scenes", glb::room().bytes()).await.json(201);
    let waiting = format!("{}/elements", path_of(&scene));
    let (elements, ()) = tokio::join!(server.get(&waiting), async {
        server.delete(&path_of(&scene)).await;
    });
    elements.problem(404, "unknown-scene");
    open.send(None).unwrap();
    assert_eq!(server.end_of(scene["current_job"].as_str().unwrap()).await["state"], "canceled");
    assert_eq!(server.get("/v1/scenes").await.json(200)["items"], json!([]));
    server.stop().await;
}

#[tokio::test]
async fn a_restart_prepares_what_was_acknowledged() {
    let directory = tempfile::tempdir().unwrap();
    let (server, open) = gated(|config| config.data_dir = Some(directory.path().to_owned())).await;
    let scene = server.post_glb("/v1/scenes?samples_per_element=4", glb::room().bytes()).await.json(201);
    server.stop().await;
    let again = Server::with(|config| config.data_dir = Some(directory.path().to_owned())).await;
    let after = again.get(&path_of(&scene)).await.json(200);
    assert_eq!((&after["state"], &after["spacing"]), (&json!("ready"), &scene["spacing"]));
    assert!(after["elements"].as_u64().unwrap() > 0);
    assert_eq!(again.end_of(scene["current_job"].as_str().unwrap()).await["state"], "succeeded");
    again.stop().await;
    drop(open);
}
