//! A data directory: what was acknowledged is there after a restart, and damage is told.

use std::path::{Path, PathBuf};

use glam::Vec3;
use rebake_core::delta::Frame;
use serde_json::{Value, json};

use super::engine::{Script, Step};
use super::glb::{room, translation};
use super::server::{Answer, Server, next_event, path_of};

/// A directory in memory where the system has such a place: processes that are killed lose nothing there either, and
/// forcing bytes to the disk costs nothing.
pub(crate) fn fast_directory() -> tempfile::TempDir {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() { tempfile::tempdir_in(memory).unwrap() } else { tempfile::tempdir().unwrap() }
}

pub(super) async fn start(directory: &Path) -> Server {
    Server::with(|config| config.data_dir = Some(directory.to_owned())).await
}

async fn scripted(directory: &Path) -> (Server, Script) {
    Server::scripted_with(|config| config.data_dir = Some(directory.to_owned())).await
}

pub(super) fn insert(asset: &str, name: &str) -> Value {
    json!({ "op": "insert", "asset": asset, "name": name, "transform": translation(2.0, 0.01, 2.0),
        "budget": { "samples_per_element": 4 } })
}

fn paint(albedo: f64) -> Value {
    json!({ "op": "material", "object": "room", "albedo": [albedo, albedo, albedo],
        "budget": { "samples_per_element": 4 } })
}

async fn raw(server: &Server, scene: &Value) -> Vec<u8> {
    let answer = server.get(&format!("{}/lightmap?format=raw", path_of(scene))).await;
    assert_eq!(answer.status, 200);
    answer.body
}

async fn delta(server: &Server, scene: &Value, since: u64) -> Answer {
    server.get(&format!("{}/lightmap/deltas?since={since}", path_of(scene))).await
}

pub(super) fn names(scene: &Value) -> Vec<&str> {
    scene["objects"].as_array().unwrap().iter().map(|object| object["name"].as_str().unwrap()).collect()
}

/// Copies a data directory as it is: what a power loss would leave.
fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy(&entry.path(), &target);
        } else {
            std::fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// The files of uploads and light maps, the largest last.
fn blobs(directory: &Path) -> Vec<PathBuf> {
    let directories = std::fs::read_dir(directory.join("blobs")).unwrap();
    let files = directories.flat_map(|directory| std::fs::read_dir(directory.unwrap().path()).unwrap());
    let mut files: Vec<PathBuf> = files.map(|file| file.unwrap().path()).collect();
    files.sort_by_key(|file| std::fs::metadata(file).unwrap().len());
    files
}

#[tokio::test]
async fn a_restart_brings_everything_back() {
    let directory = tempfile::tempdir().unwrap();
    let server = start(directory.path()).await;
    let asset = server.crate_asset().await;
    let scene = server.baked_room("?samples_per_element=4&name=hall").await;
    let edits = format!("{}/edits", path_of(&scene));
    let key = [("idempotency-key", "k-1")];
    let first = server.post_text(&edits, &insert(&asset, "a").to_string(), &key).await.json(202);
    server.end_of(first["id"].as_str().unwrap()).await;
    server.end_of(&server.edit(&scene, &json!({ "op": "remove", "objects": ["cupboard"] })).await).await;
    let before = server.get(&path_of(&scene)).await.json(200);
    let (map, jobs) = (raw(&server, &scene).await, server.get("/v1/jobs").await.json(200));
    let elements = server.get(&format!("{}/elements", path_of(&scene))).await.body;
    server.stop().await;

    let server = start(directory.path()).await;
    let mut after = server.get(&path_of(&scene)).await.json(200);
    // The trees are built anew, and may take more or less room.
    after["memory_bytes"] = before["memory_bytes"].clone();
    assert_eq!(after, before, "an orderly end loses no version");
    assert!(raw(&server, &scene).await == map);
    assert!(server.get(&format!("{}/elements", path_of(&scene))).await.body == elements);
    let restored = server.get("/v1/jobs").await.json(200);
    for (restored, job) in restored["items"].as_array().unwrap().iter().zip(jobs["items"].as_array().unwrap()) {
        for field in ["id", "scene", "state", "kind", "created_at", "finished_at"] {
            assert_eq!(restored[field], job[field]);
        }
    }
    let version = before["version"].as_u64().unwrap();
    assert_eq!(delta(&server, &scene, version).await.body.len(), 0, "a client goes on where it was");
    // The same key is the same request; the asset is known; new ids and versions go on.
    let again = server.post_text(&edits, &insert(&asset, "a").to_string(), &key).await.json(202);
    assert_eq!(again["id"], first["id"]);
    server.post_text(&edits, &paint(0.1).to_string(), &key).await.problem(422, "idempotency-key-reused");
    let next = server.edit(&scene, &insert(&asset, "b")).await;
    assert!(jobs["items"].as_array().unwrap().iter().all(|job| job["id"] != next.as_str()));
    let next = server.end_of(&next).await;
    assert!(next["progress"]["version"].as_u64().unwrap() > version, "{next}");
    let scene = server.get(&path_of(&scene)).await.json(200);
    assert_eq!(names(&scene), ["room", "a", "b"]);
    assert_ne!(server.room("?bake=false").await["id"], scene["id"]);
    server.stop().await;
}

#[tokio::test]
async fn jobs_that_wait_or_run_go_on_after_a_restart() {
    let directory = tempfile::tempdir().unwrap();
    let (server, script) = scripted(directory.path()).await;
    let scene = server.room("?samples_per_element=4000").await;
    let bake = scene["current_job"].as_str().unwrap().to_owned();
    script.run(&[Step::Round, Step::Round]);
    server.until(&bake, |job| job["progress"]["version"] == 2).await;
    let edit = server.edit(&scene, &json!({ "op": "remove", "objects": ["cupboard"] })).await;
    // It runs in the bake's place, which goes on behind it.
    server.client.follow(scene["id"].as_str().unwrap()).reach(3).await.unwrap();
    let canceled = server.edit(&scene, &paint(0.5)).await;
    server.delete(&format!("/v1/jobs/{canceled}")).await.json(200);
    let map = raw(&server, &scene).await;
    server.stop().await;

    let (server, script) = scripted(directory.path()).await;
    assert!(raw(&server, &scene).await == map, "the last consistent map is there at once");
    for job in [&bake, &edit] {
        let job = server.get(&format!("/v1/jobs/{job}")).await.json(200);
        assert!(job["state"] == "running" || job["state"] == "queued", "{job}");
    }
    assert_eq!(server.get(&format!("/v1/jobs/{canceled}")).await.json(200)["state"], "canceled");
    // An id of an event of the earlier life is answered with the whole state.
    let mut events = server.client.job_events(&bake, Some("2")).await.unwrap();
    assert_eq!(next_event(&mut events).await.unwrap().0, "reset");
    script.run(&[Step::Round, Step::Finish]);
    assert_eq!(server.end_of(&edit).await["state"], "succeeded");
    script.refine(&[Step::Round, Step::Finish]);
    let baked = server.end_of(&bake).await;
    assert_eq!((&baked["state"], &baked["progress"]["samples_per_element"]), (&"succeeded".into(), &12.into()));
    let now = server.get(&path_of(&scene)).await.json(200);
    assert_eq!(names(&now), ["room"]);
    server.stop().await;
}

#[tokio::test]
async fn a_job_keeps_its_seed_across_a_restart() {
    let directory = tempfile::tempdir().unwrap();
    let with = |seed: u64| {
        let directory = directory.path().to_owned();
        Server::scripted_with(move |config| (config.seed, config.data_dir) = (seed, Some(directory)))
    };
    let (server, script) = with(7).await;
    let scene = server.room("?samples_per_element=4000").await;
    let bake = scene["current_job"].as_str().unwrap().to_owned();
    script.run(&[Step::Round]);
    server.until(&bake, |job| job["progress"]["version"] == 1).await;
    server.stop().await;
    let (server, script) = with(8).await;
    script.run(&[Step::Round, Step::Round, Step::Finish]);
    server.end_of(&bake).await;
    let restarted = light(&server, &scene).await;
    server.stop().await;

    assert!(restarted == light_of_seed(7).await, "the job has the seed that it was accepted with");
    assert!(restarted != light_of_seed(8).await);
}

/// A bake of two rounds by a service of this seed.
async fn light_of_seed(seed: u64) -> Vec<Vec3> {
    let (server, script) = Server::scripted_with(|config| config.seed = seed).await;
    script.run(&[Step::Round, Step::Round, Step::Finish]);
    let scene = server.baked_room("?samples_per_element=4000").await;
    let light = light(&server, &scene).await;
    server.stop().await;
    light
}

async fn light(server: &Server, scene: &Value) -> Vec<Vec3> {
    let mut follower = server.client.follow(scene["id"].as_str().unwrap());
    follower.catch_up().await.unwrap();
    follower.into_map().0
}

#[tokio::test]
async fn versions_that_a_crash_lost_are_replaced_as_a_whole() {
    let directory = tempfile::tempdir().unwrap();
    let lost = tempfile::tempdir().unwrap();
    let (server, script) = scripted(directory.path()).await;
    let scene = server.room("?samples_per_element=4000").await;
    let bake = scene["current_job"].as_str().unwrap().to_owned();
    script.run(&[Step::Round, Step::Finish]);
    server.end_of(&bake).await;
    let saved = raw(&server, &scene).await;
    // What is on the disk now is what the crash leaves; a client sees more.
    let edit = server.edit(&scene, &paint(0.2)).await;
    server.until(&edit, |job| job["state"] == "running").await;
    server.client.follow(scene["id"].as_str().unwrap()).reach(2).await.unwrap();
    copy(directory.path(), lost.path());
    script.run(&[Step::Round, Step::Round, Step::Round]);
    server.until(&edit, |job| job["progress"]["version"] == 5).await;
    let mut follower = server.client.follow(scene["id"].as_str().unwrap());
    follower.catch_up().await.unwrap();
    let (map, version) = follower.into_map();
    assert_eq!(version, 5);

    let (restarted, script) = scripted(lost.path()).await;
    let now = restarted.get(&path_of(&scene)).await.json(200);
    assert!(now["version"].as_u64().unwrap() > version, "no version is given twice");
    // Versions 2 to 5 are lost, 1 is known.
    for since in 2..=5 {
        let answer = delta(&restarted, &scene, since).await.body;
        assert!(Frame::decode(&answer).unwrap().0.flags.replace_all, "since {since}");
    }
    let (known, _) = Frame::decode(&delta(&restarted, &scene, 1).await.body).unwrap();
    assert!(!known.flags.replace_all);
    let mut from_saved = Vec::new();
    Frame::decode(&saved).unwrap().0.apply(&mut from_saved).unwrap();
    known.apply(&mut from_saved).unwrap();
    let follower = rebake::client::DeltaFollower::resume;
    let mut behind = follower(restarted.client.clone(), scene["id"].as_str().unwrap(), map, version);
    behind.catch_up().await.unwrap();
    assert_eq!(behind.map(), from_saved);
    script.run(&[Step::Round, Step::Finish]);
    assert_eq!(restarted.end_of(&edit).await["state"], "succeeded");
    restarted.stop().await;
    server.stop().await;
}

/// Versions are others after a crash, but random numbers do not go by them.
#[tokio::test]
async fn light_goes_on_alike_after_a_crash() {
    let [directory, crashed] = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let server = start(directory.path()).await;
    let scene = server.baked_room("?samples_per_element=4").await;
    copy(directory.path(), crashed.path());
    let further = async |server: &Server| {
        let body = json!({ "target": { "samples_per_element": 24 } }).to_string();
        let request =
            server.request(reqwest::Method::PATCH, &path_of(&scene)).header("content-type", "application/json");
        let told = Answer::to(request.body(body)).await.json(200);
        let job = server.end_of(told["current_job"].as_str().unwrap()).await;
        assert_eq!((&job["kind"], &job["progress"]["samples_per_element"]), (&"refine".into(), &24.into()));
        light(server, &scene).await
    };
    let before = light(&server, &scene).await;
    let went_on = further(&server).await;
    assert!(went_on != before);
    server.stop().await;
    let restarted = start(crashed.path()).await;
    let now = restarted.get(&path_of(&scene)).await.json(200);
    assert!(now["version"].as_u64().unwrap() > scene["version"].as_u64().unwrap() + 1000, "{now}");
    assert!(further(&restarted).await == went_on);
    restarted.stop().await;
}

/// What edits are lit from is kept with the light: undo has the light from before, and moves go on from where they began.
#[tokio::test]
async fn undo_and_moves_have_the_same_light_after_a_crash() {
    let [directory, crashed] = [fast_directory(), fast_directory()];
    let server = start(directory.path()).await;
    let asset = server.crate_asset().await;
    let scene = server.baked_room("?samples_per_element=4").await;
    let edit = async |server: &Server, mut edit: Value| {
        edit["budget"] = json!({ "samples_per_element": 4 });
        let job = server.end_of(&server.edit(&scene, &edit).await).await;
        assert_eq!(job["state"], "succeeded", "{job}");
        (light(server, &scene).await, job["progress"]["rays"].as_u64().unwrap())
    };
    let step = |x: f64| json!({ "op": "move", "object": "a", "transform": translation(x, 0.01, 2.0) });
    let mut before = Vec::new();
    for step in [insert(&asset, "a"), step(2.1), step(2.2), paint(0.4)] {
        before.push(edit(&server, step).await.0);
    }
    copy(directory.path(), crashed.path());
    // A move goes on from where the moves began; behind it the light of the last states is that from before.
    let further = async |server: &Server| {
        let (moved, rays) = edit(server, step(2.3)).await;
        assert!(rays > 0 && moved != before[3]);
        let mut lights = vec![moved];
        for before in [&before[3], &before[2]] {
            let (light, rays) = edit(server, json!({ "op": "undo" })).await;
            assert!(light == *before && rays == 0, "{rays}");
            lights.push(light);
        }
        lights
    };
    let went_on = further(&server).await;
    server.stop().await;
    let restarted = start(crashed.path()).await;
    assert!(further(&restarted).await == went_on);
    restarted.stop().await;
}

#[tokio::test]
async fn a_paused_job_waits_and_goes_on_also_after_a_restart() {
    let directory = tempfile::tempdir().unwrap();
    let (server, script) = scripted(directory.path()).await;
    let scene = server.room("?samples_per_element=4000").await;
    let bake = scene["current_job"].as_str().unwrap().to_owned();
    script.run(&[Step::Round]);
    server.until(&bake, |job| job["progress"]["version"] == 1).await;
    server.post_text(&format!("/v1/jobs/{bake}/pause"), "", &[]).await.json(202);
    server.until(&bake, |job| job["state"] == "paused").await;
    server.stop().await;
    let (server, script) = scripted(directory.path()).await;
    assert_eq!(server.get(&format!("/v1/jobs/{bake}")).await.json(200)["state"], "paused");
    server.post_text(&format!("/v1/jobs/{bake}/resume"), "", &[]).await.json(200);
    script.run(&[Step::Round, Step::Round, Step::Finish]);
    assert_eq!(server.end_of(&bake).await["state"], "succeeded");
    server.post_text(&format!("/v1/jobs/{bake}/pause"), "", &[]).await.problem(409, "job-ended");
    server.stop().await;
}

#[tokio::test]
async fn a_job_that_was_paused_while_it_waited_is_paused_after_a_restart() {
    let directory = tempfile::tempdir().unwrap();
    let (server, _script) = scripted(directory.path()).await;
    let scene = server.room("?bake=false").await;
    let running = server.edit(&scene, &json!({ "op": "remove", "objects": ["cupboard"] })).await;
    server.until(&running, |job| job["state"] == "running").await;
    let paused = server.edit(&scene, &paint(0.5)).await;
    let told = server.post_text(&format!("/v1/jobs/{paused}/pause"), "", &[]).await.json(200);
    assert_eq!((&told["state"], &told["pause_requested"]), (&json!("paused"), &json!(true)));
    server.stop().await;

    let (server, script) = scripted(directory.path()).await;
    assert_eq!(server.get(&format!("/v1/jobs/{paused}")).await.json(200), told);
    script.run(&[Step::Round, Step::Finish]);
    assert_eq!(server.end_of(&running).await["state"], "succeeded");
    assert_eq!(server.get(&format!("/v1/jobs/{paused}")).await.json(200)["state"], "paused");
    server.post_text(&format!("/v1/jobs/{paused}/resume"), "", &[]).await.json(200);
    script.run(&[Step::Round, Step::Finish]);
    assert_eq!(server.end_of(&paused).await["state"], "succeeded");
    server.stop().await;
}

#[tokio::test]
async fn a_damaged_upload_costs_its_scene_alone() {
    let directory = tempfile::tempdir().unwrap();
    let server = start(directory.path()).await;
    let mut larger = room();
    larger.cuboid("wardrobe", [2.0, 0.02, 2.0], [2.5, 2.0, 2.5], 0.5, false);
    let whole = server.baked_room("?samples_per_element=4").await;
    let damaged = server.post_glb("/v1/scenes?bake=false&spacing=1", larger.bytes()).await.json(201);
    server.stop().await;
    let hash = larger.bytes();
    let file = blobs(directory.path()).into_iter().find(|file| std::fs::read(file).unwrap() == hash).unwrap();
    std::fs::write(&file, &hash[..hash.len() / 2]).unwrap();

    let server = start(directory.path()).await;
    assert_eq!(server.get(&path_of(&whole)).await.json(200)["error"], json!(null));
    let told = server.get(&path_of(&damaged)).await.json(200);
    assert!(told["error"].as_str().unwrap().contains("truncated"), "{told}");
    server.get(&format!("{}/lightmap", path_of(&damaged))).await.problem(500, "scene-damaged");
    server.post_json(&format!("{}/edits", path_of(&damaged)), &paint(0.1)).await.problem(500, "scene-damaged");
    assert_eq!(server.get("/v1/scenes").await.json(200)["items"].as_array().unwrap().len(), 2);
    server.end_of(&server.edit(&whole, &paint(0.3)).await).await;
    assert_eq!(server.delete(&path_of(&damaged)).await.status, 204);
    server.stop().await;
    let server = start(directory.path()).await;
    assert_eq!(server.get("/v1/scenes").await.json(200)["items"].as_array().unwrap().len(), 1);
    server.stop().await;
}

#[tokio::test]
async fn a_damaged_light_map_is_baked_afresh() {
    let directory = tempfile::tempdir().unwrap();
    let server = start(directory.path()).await;
    let scene = server.baked_room("?samples_per_element=4").await;
    let version = scene["version"].as_u64().unwrap();
    server.stop().await;
    let upload = room().bytes();
    for file in blobs(directory.path()) {
        let mut bytes = std::fs::read(&file).unwrap();
        if bytes != upload {
            let middle = bytes.len() / 2;
            bytes[middle] ^= 1;
            std::fs::write(&file, bytes).unwrap();
        }
    }
    let server = start(directory.path()).await;
    let (frame, _) = Frame::decode(&delta(&server, &scene, version).await.body).unwrap();
    assert!(frame.flags.replace_all && frame.new > version, "never a wrong map");
    let jobs = server.get("/v1/jobs").await.json(200);
    assert_eq!(server.end_of(jobs["items"][0]["id"].as_str().unwrap()).await["state"], "succeeded");
    assert_eq!(server.get(&path_of(&scene)).await.json(200)["error"], json!(null), "it is whole again");
    server.stop().await;
}

#[tokio::test]
async fn one_process_at_a_time_has_the_directory() {
    let directory = tempfile::tempdir().unwrap();
    let server = start(directory.path()).await;
    server.get("/v1/scenes").await.json(200);
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let config = rebake::Config { data_dir: Some(directory.path().to_owned()), ..rebake::Config::default() };
    let refused = rebake::run(listener, config, std::future::pending()).await.unwrap_err();
    assert!(refused.to_string().contains("another process"), "{refused}");
    server.stop().await;
    std::fs::write(directory.path().join("rebake.db"), b"this is no database, it only has its name").unwrap();
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let config = rebake::Config { data_dir: Some(directory.path().to_owned()), ..rebake::Config::default() };
    let refused = rebake::run(listener, config, std::future::pending()).await.unwrap_err();
    assert!(refused.to_string().contains("the database is damaged"), "{refused}");
}
