//! Lights that are dragged: a frame at once, the exact light where they rest.

use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use rebake::engine::{Budget, Canceled, CoreEngine, Engine, LightMap, Observer, Update, World};
use serde_json::{Value, json};

use super::glb;
use super::server::{Server, next_event, path_of};

fn step(x: f64, samples: u32) -> Value {
    json!({ "op": "move_light", "light": "lamp-2", "position": [x, 2.0, 2.0], "drag": true,
            "budget": { "samples_per_element": samples } })
}

async fn scene(server: &Server) -> Value {
    let glb = glb::room().point_light("lamp-2", [1.0, 2.5, 3.0], 10.0).bytes();
    let scene = server.post_glb("/v1/scenes?spacing=0.3&samples_per_element=16", glb).await.json(201);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    server.get(&path_of(&scene)).await.json(200)
}

#[tokio::test]
async fn a_dragged_light_ends_where_it_rests_with_the_exact_light() {
    let server = Server::start().await;
    let scene = scene(&server).await;
    // More samples than the first job gets: the next step ends it.
    const MANY: u32 = 65_536;
    let mut jobs = Vec::new();
    for k in 0..6 {
        let samples = if k == 0 { MANY } else { 16 };
        jobs.push(server.edit(&scene, &step(1.0 + 0.2 * f64::from(k), samples)).await);
    }
    jobs.push(server.edit(&scene, &step(2.5, 64)).await);
    let last = jobs.len() - 1;
    for (k, job) in jobs.iter().enumerate() {
        let job = server.end_of(job).await;
        assert_eq!(job["state"], "succeeded", "{job}");
        let samples = job["progress"]["samples_per_element"].as_u64().unwrap_or(0);
        assert!(k == last || samples < u64::from(MANY) || !job["merged_into"].is_null(), "{job}");
    }
    let dragged = server.get(&path_of(&scene)).await.json(200);
    let lamp = dragged["lights"].as_array().unwrap().iter().find(|l| l["name"] == "lamp-2").unwrap().clone();
    assert_eq!((&lamp["layer"], &lamp["position"]), (&json!("lamp-2"), &json!([2.5, 2.0, 2.0])));
    // What is there at rest is an exact light map: it states its error.
    assert!(dragged["estimated_rmse"].as_f64().is_some_and(|rmse| rmse > 0.0), "{dragged}");
    // A step that comes later has its frame first: a version without a stated error.
    let id = scene["id"].as_str().unwrap();
    let mut events = server.client.scene_events(id, None).await.unwrap();
    let job = server.edit(&scene, &step(1.5, 16)).await;
    let mut snapshots = Vec::new();
    loop {
        let (kind, _, data) = next_event(&mut events).await.expect("the scene stays");
        match kind.as_str() {
            "snapshot" if data["job"] == job => snapshots.push(data),
            "job" if data["id"] == job && data["state"] == "succeeded" => break,
            _ => {}
        }
    }
    let first = snapshots.iter().find(|s| !s["samples_per_element"].is_null()).expect("a snapshot with light");
    assert_eq!((&first["samples_per_element"], first["estimated_rmse"].is_null()), (&json!(1), true), "{first}");
    assert!(snapshots.iter().any(|s| s["samples_per_element"] == 16 && s["estimated_rmse"].is_number()));
}

/// The real engine, whose updates stand still while it is held. It looks at what updates start from.
#[derive(Debug, Default)]
struct Held {
    state: Mutex<State>,
    let_go: Condvar,
}

#[derive(Debug, Default)]
struct State {
    is_held: bool,
    /// What was computed last.
    last: Option<Arc<LightMap>>,
    /// Updates, and those that started from something else.
    updates: (u32, u32),
}

impl Held {
    fn hold(&self, is_held: bool) {
        self.state.lock().unwrap().is_held = is_held;
        self.let_go.notify_all();
    }

    fn made(&self, map: Arc<LightMap>) -> Arc<LightMap> {
        self.state.lock().unwrap().last = Some(map.clone());
        map
    }
}

impl Engine for Held {
    fn bake(&self, world: &World, budget: &Budget, seed: u64, o: &dyn Observer) -> Result<Arc<LightMap>, Canceled> {
        CoreEngine.bake(world, budget, seed, o).map(|map| self.made(map))
    }

    fn update(&self, work: &Update<'_>, observer: &dyn Observer) -> Result<Arc<LightMap>, Canceled> {
        let mut state = self.state.lock().unwrap();
        state.updates.0 += 1;
        state.updates.1 += u32::from(state.last.as_deref() != Some(work.map));
        while state.is_held {
            if observer.canceled() {
                return Err(Canceled);
            }
            (state, _) = self.let_go.wait_timeout(state, Duration::from_millis(5)).unwrap();
        }
        drop(state);
        CoreEngine.update(work, observer).map(|map| self.made(map))
    }
}

#[tokio::test]
async fn no_light_starts_from_an_estimate() {
    let engine = Arc::new(Held::default());
    let server = Server::with(|config| config.engine = engine.clone()).await;
    let scene = scene(&server).await;
    let asset = server.crate_asset().await;
    assert_eq!(server.end_of(&server.edit(&scene, &step(1.2, 16)).await).await["state"], "succeeded");
    let exact = server.get(&path_of(&scene)).await.json(200);
    assert!(exact["estimated_rmse"].is_number(), "{exact}");

    // The next steps end a step that has its estimate; an insert does not.
    engine.hold(true);
    let steps = [step(1.6, 16), step(2.0, 16), step(2.4, 16)];
    let mut jobs = Vec::new();
    for step in &steps {
        let job = server.edit(&scene, step).await;
        server.until(&job, |job| job["progress"]["samples_per_element"] == 1).await;
        assert!(server.get(&path_of(&scene)).await.json(200)["estimated_rmse"].is_null());
        jobs.push(job);
    }
    for job in &jobs[..2] {
        assert_eq!(server.end_of(job).await["state"], "succeeded");
    }
    let at = glb::translation(1.0, 0.01, 2.0);
    let insert = json!({ "op": "insert", "asset": asset, "name": "crate", "transform": at });
    let insert = server.edit(&scene, &insert).await;
    let last = server.get(&format!("/v1/jobs/{}", jobs[2])).await.json(200);
    assert_eq!(last["state"], "running", "{last}");
    // Canceled with nothing but an estimate: the insert lights it first.
    server.delete(&format!("/v1/jobs/{}", jobs[2])).await;
    assert_eq!(server.end_of(&jobs[2]).await["state"], "canceled");
    engine.hold(false);
    assert_eq!(server.end_of(&insert).await["state"], "succeeded");

    let lit = server.get(&path_of(&scene)).await.json(200);
    assert!(lit["estimated_rmse"].is_number(), "{lit}");
    // The first step, three that were held, and one of all that was left with the insert.
    assert_eq!(engine.state.lock().unwrap().updates, (5, 0));
}

/// A step of an object's drag makes way for the next one as soon as it has light to show; undo takes them back as one.
#[tokio::test]
async fn a_dragged_object_shows_every_step_and_goes_back_at_once() {
    const MANY: u32 = 65_536;
    let server = Server::start().await;
    let scene = scene(&server).await;
    let step = |x: f64, samples: u32| {
        json!({ "op": "move", "object": "cupboard", "transform": glb::translation(x, 0.0, 0.0), "drag": true,
                "budget": { "samples_per_element": samples } })
    };
    let mut jobs = Vec::new();
    for k in 1..=3 {
        let job = server.edit(&scene, &step(0.2 * f64::from(k), MANY)).await;
        server.until(&job, |job| job["progress"]["samples_per_element"].as_u64() > Some(0)).await;
        jobs.push(job);
    }
    let rest = server.edit(&scene, &step(1.0, 16)).await;
    for job in &jobs {
        let job = server.end_of(job).await;
        let samples = job["progress"]["samples_per_element"].as_u64().unwrap();
        assert!(job["state"] == "succeeded" && samples < u64::from(MANY), "{job}");
    }
    assert_eq!(server.end_of(&rest).await["state"], "succeeded");
    let path = path_of(&scene);
    let cupboard = async || {
        let now = server.get(&path).await.json(200);
        let objects = now["objects"].as_array().unwrap();
        let found = objects.iter().find(|object| object["name"] == "cupboard").unwrap();
        (
            found["transform"][12].as_f64().unwrap(),
            now["accepted_edits"].as_u64().unwrap(),
            now["estimated_rmse"].clone(),
        )
    };
    let (x, accepted, stated) = cupboard().await;
    assert!((x, accepted) == (1.0, 4) && stated.is_number(), "{x} {accepted} {stated}");
    for (turn, to) in [("undo", 0.0), ("redo", 1.0), ("undo", 0.0)] {
        let (_, before, _) = cupboard().await;
        server.end_of(&server.edit(&scene, &json!({ "op": turn, "drag": true })).await).await;
        let (x, accepted, _) = cupboard().await;
        assert_eq!((x, accepted), (to, before + 1), "{turn}");
    }
    let history = server.get(&format!("{path}/edits")).await.json(200);
    let undone = history["items"].as_array().unwrap().iter().filter(|entry| entry["undone"] == true).count();
    assert_eq!((undone, &history["undo"], &history["redo"]), (4, &json!(null), &json!(1)));
    server.stop().await;
}
