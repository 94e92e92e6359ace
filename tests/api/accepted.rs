//! What a scene tells of edits that are accepted and not published yet.

use serde_json::{Value, json};

use super::engine::Step;
use super::glb::translation;
use super::server::{Server, path_of};

/// What a client reads is what its `If-Match` stands for, also while light and geometry are behind.
#[tokio::test]
async fn a_scene_is_told_as_its_accepted_edits_leave_it() {
    let (server, script) = Server::scripted().await;
    let asset = server.crate_asset().await;
    let (scene, hold) = server.held_room(&script).await;
    server.until(&hold, |job| job["progress"]["version"].is_u64()).await;
    let path = path_of(&scene);
    let before = server.get(&path).await.json(200);
    let lamp = json!({ "kind": "point", "position": [1, 2, 1], "color": [1, 1, 1], "intensity": 4 });
    let edits = json!({ "edits": [
        { "op": "insert", "asset": asset, "name": "crate", "transform": translation(2.0, 0.01, 2.0) },
        { "op": "remove", "objects": ["cupboard"] },
        { "op": "insert_light", "name": "lamp-2", "light": lamp },
    ] });
    let job = server.edit(&scene, &edits).await;
    let answer = server.get(&path).await;
    let now = answer.json(200);
    assert_eq!(answer.header("etag"), "\"2\"");
    assert_eq!((&now["accepted_edits"], &now["published_edits"]), (&json!(2), &json!(1)));
    assert_eq!((&now["version"], &now["elements_version"]), (&before["version"], &before["elements_version"]));
    let names = |list: &Value| -> Vec<String> {
        list.as_array().unwrap().iter().map(|one| one["name"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(
        (names(&now["objects"]), names(&now["lights"])),
        (vec!["room".to_owned(), "crate".to_owned()], vec!["lamp".to_owned(), "lamp-2".to_owned()],)
    );
    // Elements are those of the version: the room has its own, the crate none yet, beyond all that there are.
    assert_eq!(now["objects"][0]["elements"], before["objects"][0]["elements"]);
    assert_eq!((&now["objects"][1]["index"], &now["objects"][1]["elements"]["count"]), (&json!(2), &json!(0)));
    let mut listed = Vec::new();
    let mut page = server.get(&format!("{path}/objects?limit=1")).await.json(200);
    loop {
        assert_eq!(page["accepted_edits"], 2);
        listed.extend(names(&page["items"]));
        let Some(cursor) = page["next_cursor"].as_str() else { break };
        page = server.get(&format!("{path}/objects?limit=1&cursor={cursor}")).await.json(200);
    }
    assert_eq!(listed, ["room", "crate"]);
    script.run(&[Step::Finish, Step::Round, Step::Finish]);
    assert_eq!(server.end_of(&job).await["state"], "succeeded");
    let after = server.get(&path).await.json(200);
    assert_eq!((&after["accepted_edits"], &after["published_edits"]), (&json!(2), &json!(2)));
    assert_eq!(after["objects"][1]["index"], 1);
    assert!(after["objects"][1]["elements"]["count"].as_u64() > Some(0));
    server.stop().await;
}
