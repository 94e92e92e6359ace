//! Assets: listed, deleted, limited, and kept only where they were accepted.

use serde_json::{Value, json};

use super::durable::{fast_directory, insert, start};
use super::glb::{Glb, crate_asset, room, translation};
use super::server::{Server, path_of};

/// An asset of which there are as many as there are numbers.
fn numbered(n: usize) -> Vec<u8> {
    let mut glb = Glb::default();
    glb.cuboid(&format!("box {n}"), [0.0; 3], [0.1; 3], 0.5, true);
    glb.bytes()
}

async fn listed(server: &Server, query: &str) -> Value {
    server.get(&format!("/v1/assets{query}")).await.json(200)
}

fn count(page: &Value) -> usize {
    page["items"].as_array().unwrap().len()
}

#[tokio::test]
async fn assets_are_listed_in_pages_and_deleted_where_no_scene_needs_them() {
    let directory = fast_directory();
    let server = start(directory.path()).await;
    let mut ids = Vec::new();
    for n in 0..3 {
        let asset = server.post_glb("/v1/assets", numbered(n)).await.json(201);
        ids.push(asset["asset"].as_str().unwrap().to_owned());
    }
    let first = listed(&server, "?limit=2").await;
    let names = |page: &Value| -> Vec<String> {
        page["items"].as_array().unwrap().iter().map(|asset| asset["asset"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(names(&first), [ids[2].clone(), ids[1].clone()]);
    assert!(first["items"][0]["bytes"].as_u64().unwrap() as usize == numbered(2).len());
    assert!(first["items"][0]["triangles"] == 12 && first["items"][0]["memory_bytes"].as_u64().unwrap() > 100);
    let cursor = first["next_cursor"].as_str().unwrap();
    let second = listed(&server, &format!("?limit=2&cursor={cursor}")).await;
    assert!(names(&second) == [ids[0].clone()] && second["next_cursor"].is_null());
    server.get("/v1/assets?limit=0").await.problem(400, "invalid-query");

    let scene = server.room("?bake=false").await;
    let job = server.edit(&scene, &insert(&ids[0], "a")).await;
    server.end_of(&job).await;
    server.end_of(&server.edit(&scene, &json!({ "op": "remove", "objects": ["a"] })).await).await;
    // The history needs it, which is applied again after a restart.
    let path = format!("/v1/assets/{}", ids[0]);
    let told = server.delete(&path).await.problem(409, "asset-needed");
    assert!(told.contains(scene["id"].as_str().unwrap()), "{told}");
    assert_eq!(server.delete(&format!("/v1/assets/{}", ids[1])).await.status, 204);
    server.delete(&format!("/v1/assets/{}", ids[1])).await.problem(404, "asset-not-found");
    let gone = server.post_json(&format!("{}/edits", path_of(&scene)), &insert(&ids[1], "b")).await;
    gone.problem(422, "unknown-asset");
    server.stop().await;

    let server = start(directory.path()).await;
    assert_eq!(count(&listed(&server, "").await), 2);
    server.delete(&path).await.problem(409, "asset-needed");
    server.get(&path_of(&scene)).await.json(200);
    assert_eq!(server.delete(&path_of(&scene)).await.status, 204);
    assert_eq!(server.delete(&path).await.status, 204);
    assert_eq!(count(&listed(&server, "").await), 1);
    server.stop().await;
}

#[tokio::test]
async fn an_asset_that_is_refused_is_not_kept() {
    let directory = fast_directory();
    let limited = async |assets: usize| {
        Server::with(|config| {
            config.data_dir = Some(directory.path().to_owned());
            config.limits.assets = assets;
        })
        .await
    };
    let server = limited(1).await;
    let asset = server.crate_asset().await;
    let scene = server.room("?bake=false").await;
    server.end_of(&server.edit(&scene, &insert(&asset, "a")).await).await;
    for n in 0..3 {
        server.post_glb("/v1/assets", numbered(n)).await.problem(409, "too-many-assets");
    }
    server.crate_asset().await;
    server.stop().await;
    // What was acknowledged is there, whatever the limits are by now.
    let server = limited(0).await;
    assert_eq!(count(&listed(&server, "").await), 1);
    assert!(server.get(&path_of(&scene)).await.json(200)["error"].is_null());
    server.post_glb("/v1/assets", numbered(0)).await.problem(409, "too-many-assets");
    server.stop().await;
}

/// A limit is for what comes: what was acknowledged is there after a restart with lower ones, and so is what was
/// inserted.
#[tokio::test]
async fn lower_limits_lose_nothing_that_was_acknowledged() {
    let directory = fast_directory();
    let limited = async |limits: fn(&mut rebake::Config)| {
        Server::with(|config| {
            config.data_dir = Some(directory.path().to_owned());
            limits(config);
        })
        .await
    };
    let server = limited(|_| ()).await;
    let asset = server.crate_asset().await;
    let scene = server.baked_room("?samples_per_element=4").await;
    server.end_of(&server.edit(&scene, &insert(&asset, "a")).await).await;
    let before = server.get(&path_of(&scene)).await.json(200);
    server.stop().await;
    let server = limited(|config| {
        let limits = &mut config.limits;
        (limits.upload_bytes, limits.triangles, limits.elements, limits.subdivided_triangles) = (100, 1, 10, 10);
    })
    .await;
    let after = server.get(&path_of(&scene)).await.json(200);
    for field in ["error", "objects", "elements", "version"] {
        assert_eq!(after[field], before[field], "{field}");
    }
    assert_eq!(count(&listed(&server, "").await), 1);
    // They hold for what comes, not for edits of what is there.
    let paint = json!({ "op": "material", "object": "a", "albedo": [0.1, 0.1, 0.1] });
    server.end_of(&server.edit(&scene, &paint).await).await;
    let step = json!({ "op": "move", "object": "a", "transform": translation(1.0, 0.0, 1.0) });
    server.end_of(&server.edit(&scene, &step).await).await;
    let told = server.post_json(&format!("{}/edits", path_of(&scene)), &insert(&asset, "b")).await;
    told.problem(422, "edit-too-large");
    server.post_glb("/v1/assets", crate_asset()).await.problem(413, "payload-too-large");
    server.stop().await;
}

#[tokio::test]
async fn assets_take_of_the_memory_that_there_is() {
    let server = Server::with(|config| config.limits.memory_bytes = 40_000).await;
    server.post_glb("/v1/assets", crate_asset()).await.json(201);
    let mut refused = None;
    for n in 0..200 {
        let answer = server.post_glb("/v1/assets", numbered(n)).await;
        if answer.status != 201 {
            refused = Some(answer);
            break;
        }
    }
    let told = refused.expect("there is an end to it").problem(409, "no-memory");
    assert!(told.contains("would take about"), "{told}");
    let kept = count(&listed(&server, "?limit=200").await);
    assert!(kept > 1);
    let newest = listed(&server, "").await["items"][0]["asset"].as_str().unwrap().to_owned();
    assert_eq!(server.delete(&format!("/v1/assets/{newest}")).await.status, 204);
    server.post_glb("/v1/assets", numbered(500)).await.json(201);
    server.stop().await;
}

#[tokio::test]
async fn strengths_of_a_file_are_bounded_as_those_of_edits() {
    let server = Server::start().await;
    let told = server.post_glb("/v1/scenes?environment=1e10,0,0", room().bytes()).await;
    told.problem(400, "invalid-query");
    server.stop().await;
}
