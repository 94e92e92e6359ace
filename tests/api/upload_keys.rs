//! Uploads that are sent again with their key.

use futures_util::future::join_all;
use reqwest::Method;
use serde_json::{Value, json};

use super::durable::fast_directory;
use super::glb;
use super::server::{Answer, Server, path_of};

async fn post(server: &Server, path: &str, file: Vec<u8>, key: &str) -> Answer {
    let request = server.request(Method::POST, path).header("content-type", "model/gltf-binary");
    Answer::to(request.header("idempotency-key", key).body(file)).await
}

async fn scenes(server: &Server) -> usize {
    server.get("/v1/scenes").await.json(200)["items"].as_array().unwrap().len()
}

const PATH: &str = "/v1/scenes?spacing=1&samples_per_element=4";

#[tokio::test]
async fn an_upload_with_a_key_makes_one_scene() {
    let server = Server::with(|config| config.limits.scenes = 2).await;
    let room = || glb::room().bytes();
    let first = post(&server, PATH, room(), "k1").await;
    let scene = first.json(201);
    let bake = scene["current_job"].as_str().unwrap();
    server.end_of(bake).await;
    let again = post(&server, PATH, room(), "k1").await;
    assert_eq!((&again.json(201)["id"], &again.json(201)["current_job"]), (&scene["id"], &json!(bake)));
    assert_eq!((again.header("location"), again.header("etag")), (first.header("location"), "\"0\""));
    assert!(again.json(201)["version"].as_u64() > Some(0), "as it is by then");
    // Another file, or another way to take it, is another upload.
    let other = glb::room().bytes_with(|document| document["nodes"][0]["name"] = json!("hall"));
    post(&server, PATH, other.clone(), "k1").await.problem(422, "idempotency-key-reused");
    post(&server, "/v1/scenes?spacing=1", room(), "k1").await.problem(422, "idempotency-key-reused");
    post(&server, "/v1/assets", room(), "k1").await.problem(422, "idempotency-key-reused");
    post(&server, PATH, room(), &"x".repeat(300)).await.problem(400, "bad-request");
    // A refused upload leaves no trace: its key is free. Nor does a dry run.
    post(&server, PATH, b"glTF".to_vec(), "k2").await.problem(400, "malformed-file");
    post(&server, &format!("{PATH}&dry_run=true"), room(), "k2").await.json(200);
    // Ten at once are one scene.
    let answers = join_all((0..10).map(|_| post(&server, PATH, other.clone(), "k2"))).await;
    assert!(answers.iter().all(|answer| answer.json(201)["id"] == answers[0].json(201)["id"]));
    assert_eq!(scenes(&server).await, 2);
    // Where there is no room for another scene, this is none.
    assert_eq!(post(&server, PATH, room(), "k1").await.json(201)["id"], scene["id"]);
    post(&server, PATH, room(), "k3").await.problem(409, "too-many-scenes");
    // One that was deleted does not come back.
    server.delete(&path_of(&scene)).await;
    post(&server, PATH, room(), "k1").await.problem(410, "scene-gone");
    assert_ne!(post(&server, PATH, room(), "k3").await.json(201)["id"], scene["id"]);
    server.stop().await;
}

#[tokio::test]
async fn a_key_of_an_asset_goes_with_its_file() {
    let server = Server::with(|config| config.limits.idempotency_keys = 2).await;
    let id = |answer: Answer, status| answer.json(status)["asset"].clone();
    let first: Value = id(post(&server, "/v1/assets", glb::crate_asset(), "k1").await, 201);
    assert_eq!(id(post(&server, "/v1/assets", glb::crate_asset(), "k1").await, 200), first);
    post(&server, "/v1/assets", glb::room().bytes(), "k1").await.problem(422, "idempotency-key-reused");
    for key in ["k2", "k3"] {
        post(&server, "/v1/assets", glb::room().bytes(), key).await;
    }
    // The oldest key was forgotten when the third came.
    post(&server, "/v1/assets", glb::room().bytes(), "k1").await.json(200);
    server.stop().await;
}

#[tokio::test]
async fn keys_of_uploads_survive_a_restart() {
    let directory = fast_directory();
    let start = || {
        Server::with(|config| {
            config.data_dir = Some(directory.path().to_owned());
            config.limits.idempotency_keys = 2;
        })
    };
    let server = start().await;
    let scene = post(&server, PATH, glb::room().bytes(), "k1").await.json(201);
    let gone = post(&server, PATH, glb::room().bytes(), "k2").await.json(201);
    server.delete(&path_of(&gone)).await;
    server.stop().await;
    let server = start().await;
    let again = post(&server, PATH, glb::room().bytes(), "k1").await.json(201);
    assert_eq!((&again["id"], &again["current_job"]), (&scene["id"], &scene["current_job"]));
    post(&server, PATH, glb::crate_asset(), "k1").await.problem(422, "idempotency-key-reused");
    post(&server, PATH, glb::room().bytes(), "k2").await.problem(410, "scene-gone");
    assert_ne!(post(&server, PATH, glb::room().bytes(), "k3").await.json(201)["id"], scene["id"]);
    server.stop().await;
    // The third has pushed the first out, on the disk as well.
    let server = start().await;
    assert_ne!(post(&server, PATH, glb::room().bytes(), "k1").await.json(201)["id"], scene["id"]);
    server.stop().await;
}
