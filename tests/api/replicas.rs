//! Replicas of a service: they tell what it has published, while it is away too, and change nothing.

use std::fs;
use std::time::Instant;

use serde_json::{Value, json};

use super::cluster::{Broker, raw};
use super::glb::translation;
use super::server::{Answer, PATIENCE, Server, path_of, patiently};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn replicas_stay_while_their_service_is_away() {
    let Some(broker) = Broker::start() else { return };
    let data = tempfile::tempdir().unwrap();
    let serve = || {
        let (directory, cluster) = (data.path().to_owned(), broker.config(false));
        Server::with(move |config| (config.data_dir, config.cluster) = (Some(directory), Some(cluster)))
    };
    let server = serve().await;
    let scenes = [server.baked_room("?samples_per_element=8").await, server.baked_room("?samples_per_element=8").await];
    let [kept, deleted] = scenes.each_ref().map(path_of);
    let replica = Server::replica(broker.config(false)).await;
    for path in [&kept, &deleted] {
        wait_for(&replica, path, 200).await;
    }
    let version = at_rest(&server, &kept).await;
    let mut follower = replica.client.follow(scenes[0]["id"].as_str().unwrap());
    patiently(follower.reach(version)).await.unwrap();
    let light = raw(&server, &kept).await;
    server.stop().await;
    assert!(raw(&replica, &kept).await == light);

    let server = serve().await;
    wait_for(&server, &kept, 200).await;
    assert_eq!(server.delete(&deleted).await.status, 204);
    wait_for(&replica, &deleted, 404).await;
    let repaint = json!({ "op": "material", "object": "cupboard", "albedo": [0.2, 0.6, 0.3] });
    let scene = server.get(&kept).await.json(200);
    server.end_of(&server.edit(&scene, &repaint).await).await;
    let version = at_rest(&server, &kept).await;
    patiently(follower.reach(version)).await.unwrap();
    assert!(raw(&replica, &kept).await == raw(&server, &kept).await);
}

/// Waits until a path answers with this status.
async fn wait_for(server: &Server, path: &str, status: u16) -> Answer {
    let begun = Instant::now();
    loop {
        let answer = server.get(path).await;
        if answer.status == status {
            return answer;
        }
        assert!(begun.elapsed() < PATIENCE, "{path}: {}", answer.status);
        tokio::task::yield_now().await;
    }
}

/// A scene as JSON, without what is a server's own.
async fn told(server: &Server, path: &str) -> Value {
    let mut scene = wait_for(server, path, 200).await.json(200);
    for own in ["memory_bytes", "current_job", "unlit_edits"] {
        scene.as_object_mut().unwrap().remove(own);
    }
    scene
}

/// Waits until nothing is done for a scene any more, and answers its version.
async fn at_rest(server: &Server, path: &str) -> u64 {
    let begun = Instant::now();
    loop {
        let version = server.get(path).await.json(200)["version"].as_u64().unwrap();
        let jobs = server.get("/v1/jobs").await.json(200);
        let is_open = |job: &Value| job["finished_at"].is_null();
        let again = server.get(path).await.json(200);
        if !jobs["items"].as_array().unwrap().iter().any(is_open) && again["version"] == version {
            return version;
        }
        assert!(begun.elapsed() < PATIENCE, "{again}");
        tokio::task::yield_now().await;
    }
}

/// Waits until a replica tells of a scene what the service does.
async fn told_alike(server: &Server, replica: &Server, path: &str) {
    let begun = Instant::now();
    loop {
        let (ours, theirs) = (told(server, path).await, told(replica, path).await);
        if ours == theirs {
            return;
        }
        assert!(begun.elapsed() < PATIENCE, "{ours} {theirs}");
        tokio::task::yield_now().await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_replica_serves_what_is_published_and_takes_no_changes() {
    let Some(broker) = Broker::start() else { return };
    let server = broker.serve(false).await;
    let scene = server.baked_room("?samples_per_element=8&layers=each").await;
    let (path, id) = (path_of(&scene), scene["id"].as_str().unwrap());
    let replica = Server::replica(broker.config(false)).await;
    wait_for(&replica, &path, 200).await;
    let mut follower = replica.client.follow(id);
    follower.catch_up().await.unwrap();

    let asset = server.crate_asset().await;
    let insert = json!({ "op": "insert", "asset": asset, "name": "crate", "transform": translation(2.0, 0.01, 2.0) });
    for edit in [insert, json!({ "op": "relight", "lights": [{ "light": "lamp", "intensity": 7 }] })] {
        assert_eq!(server.end_of(&server.edit(&scene, &edit).await).await["state"], "succeeded");
    }
    let version = at_rest(&server, &path).await;
    patiently(follower.reach(version)).await.unwrap();
    let mut own = server.client.follow(id);
    own.catch_up().await.unwrap();
    assert_eq!((follower.version(), follower.map()), (own.version(), own.map()));
    assert_eq!(told(&replica, &path).await, told(&server, &path).await);
    for part in
        ["/lightmap?format=raw", "/lightmap?format=raw&part=error", "/elements", "/objects", "/lightmap?format=glb"]
    {
        let (ours, theirs) = (server.get(&format!("{path}{part}")).await, replica.get(&format!("{path}{part}")).await);
        assert_eq!(theirs.status, 200, "{part}");
        assert!(ours.body == theirs.body, "{part}");
    }
    let since = scene["version"].as_u64().unwrap();
    let between = format!("{path}/lightmap/deltas/{since}-{version}");
    let answer = replica.get(&between).await;
    assert!([200, 404, 410].contains(&answer.status.as_u16()), "{}", answer.status);

    let edit = json!({ "op": "remove", "objects": ["crate"] });
    replica.post_json(&format!("{path}/edits"), &edit).await.problem(403, "read-only");
    replica.delete(&path).await.problem(403, "read-only");
    let point = json!({ "points": [[2.0, 1.0, 2.0, 0.0, 1.0, 0.0]] });
    let light = replica.post_json(&format!("{path}/sample"), &point).await.json(200);
    assert_eq!(light, server.post_json(&format!("{path}/sample"), &point).await.json(200));

    // One of the same light keeps its files where the other one's are removed.
    let twin = path_of(&server.baked_room("?samples_per_element=8").await);
    let other = path_of(&server.baked_room("?samples_per_element=8").await);
    for path in [&twin, &other] {
        told_alike(&server, &replica, path).await;
    }
    assert!(raw(&server, &twin).await == raw(&server, &other).await);
    assert_eq!(server.delete(&other).await.status, 204);
    wait_for(&replica, &other, 404).await;

    // One that comes later has it all, too, and what is deleted is gone.
    let late = Server::replica(broker.config(false)).await;
    for path in [&path, &twin] {
        told_alike(&server, &late, path).await;
        assert_eq!(server.delete(path).await.status, 204);
        for replica in [&replica, &late] {
            wait_for(replica, path, 404).await;
        }
    }
    assert_eq!(fs::read_dir(broker.objects().join("scenes")).map_or(0, Iterator::count), 0);
}
