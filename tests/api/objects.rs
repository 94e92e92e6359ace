//! Objects one by one: their meshes, elements and light are those of the scene.

use glam::{DMat4, DVec3, Vec3};
use rebake_core::delta::Frame;
use rebake_core::scene::{LoadLimits, load};
use reqwest::Method;
use serde_json::{Value, json};

use super::engine::Step;
use super::glb::{room, translation};
use super::server::{Answer, Server, path_of};

/// Every byte that could mean something in a path, and more, as `%XX`.
fn encoded(name: &str) -> String {
    let byte = |byte: u8| match byte.is_ascii_alphanumeric() {
        true => char::from(byte).to_string(),
        false => format!("%{byte:02X}"),
    };
    name.bytes().map(byte).collect()
}

async fn object(server: &Server, scene: &Value, name: &str, query: &str) -> Answer {
    server.get(&format!("{}/objects/{}{query}", path_of(scene), encoded(name))).await
}

fn f32s(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks_exact(4).map(|chunk| f32::from_le_bytes(chunk.try_into().unwrap())).collect()
}

/// The values of `lightmap?format=raw`.
async fn light(server: &Server, scene: &Value, query: &str) -> Vec<Vec3> {
    let answer = server.get(&format!("{}/lightmap?format=raw{query}", path_of(scene))).await;
    let mut map = Vec::new();
    Frame::decode(&answer.body).unwrap().0.apply(&mut map).unwrap();
    map
}

#[tokio::test]
async fn the_list_has_what_the_scene_tells_page_by_page() {
    let server = Server::start().await;
    let scene = server.room("?bake=false").await;
    let path = format!("{}/objects", path_of(&scene));
    let (mut found, mut cursor) = (Vec::new(), String::new());
    loop {
        let page = server.get(&format!("{path}?limit=1{cursor}")).await.json(200);
        assert_eq!((&page["version"], &page["elements_version"]), (&scene["version"], &scene["elements_version"]));
        let items = page["items"].as_array().unwrap();
        assert_eq!(items.len(), 1);
        found.push(items[0].clone());
        let Some(next) = page["next_cursor"].as_str() else { break };
        cursor = format!("&cursor={next}");
    }
    assert!(found.len() > 1);
    assert_eq!(Value::from(found), scene["objects"]);
    server.get(&format!("{path}?cursor=x")).await.problem(400, "invalid-query");
    server.get("/v1/scenes/s0/objects").await.problem(404, "unknown-scene");
    server.stop().await;
}

#[tokio::test]
async fn its_elements_and_their_light_are_those_of_the_scene() {
    let (server, script) = Server::scripted().await;
    script.run(&[Step::Round, Step::Finish]);
    let scene = server.baked_room("").await;
    let all = server.get(&format!("{}/elements", path_of(&scene))).await.body;
    let (map, errors) = (light(&server, &scene, "").await, light(&server, &scene, "&part=error").await);
    for told in scene["objects"].as_array().unwrap() {
        let name = told["name"].as_str().unwrap();
        let answer = object(&server, &scene, name, "?format=elements").await;
        assert_eq!((answer.status.as_u16(), answer.header("content-type")), (200, "application/octet-stream"));
        assert_eq!(answer.header("x-rebake-version"), scene["version"].to_string());
        let range = |key: &str| told["elements"][key].as_u64().unwrap() as usize;
        let (first, count) = (range("first"), range("count"));
        assert_eq!(answer.body.len(), 48 * count);
        for (record, slot) in answer.body.chunks_exact(48).zip(first..) {
            assert_eq!(record[..32], all[32 * slot..32 * slot + 32]);
            let [r, g, b] = map[slot].to_array();
            assert_eq!(f32s(&record[32..]), [r, g, b, errors[slot].x]);
        }
        // The same means as of the records.
        let detail = object(&server, &scene, name, "?format=json").await.json(200);
        assert_eq!(detail["object"], *told);
        let sums = answer.body.chunks_exact(48).map(f32s).fold([0.0; 4], |[area, r, g, b], record| {
            let weight = f64::from(record[6]);
            let [red, green, blue] = [7, 8, 9].map(|k| weight * f64::from(record[k + 1]));
            [area + weight, r + red, g + green, b + blue]
        });
        assert!((detail["area"].as_f64().unwrap() - sums[0]).abs() < 1e-6 * sums[0]);
        for channel in 0..3 {
            let mean = detail["light"][channel].as_f64().unwrap();
            assert!((mean - sums[channel + 1] / sums[0]).abs() <= 1e-5 * mean.abs(), "{mean}");
        }
    }
    server.stop().await;
}

#[tokio::test]
async fn its_mesh_is_that_of_the_file_in_its_present_place() {
    let (server, script) = Server::scripted().await;
    script.run(&[Step::Round, Step::Finish]);
    let scene = server.baked_room("").await;
    let file = load(&room().bytes(), &LoadLimits::default()).unwrap();
    let of_file = file.objects.iter().find(|object| object.name == "cupboard").unwrap();
    let edit = json!({ "edits": [
        { "op": "move", "object": "cupboard", "transform": translation(0.5, 0.0, -0.25) },
        { "op": "material", "object": "cupboard", "albedo": [0.25, 0.5, 0.75] },
    ] });
    let job = server.edit(&scene, &edit).await;
    script.run(&[Step::Round, Step::Finish]);
    server.end_of(&job).await;
    let answer = object(&server, &scene, "cupboard", "").await;
    assert_eq!((answer.status.as_u16(), answer.header("content-type")), (200, "model/gltf-binary"));
    let read = load(&answer.body, &LoadLimits::default()).unwrap();
    let [mesh] = &read.objects[..] else { panic!("{} objects in its scene 0", read.objects.len()) };
    assert_eq!((&mesh.name, &mesh.mesh.positions), (&of_file.name, &of_file.mesh.positions));
    assert_eq!(mesh.mesh.triangles, of_file.mesh.triangles);
    assert_eq!(mesh.world_from_object, DMat4::from_translation(DVec3::new(0.5, 0.0, -0.25)));
    assert_eq!(mesh.materials[0].albedo, Vec3::new(0.25, 0.5, 0.75));
    // The light of its elements stands in the file as it is in the map.
    let map = light(&server, &scene, "").await;
    let told = server.get(&path_of(&scene)).await.json(200);
    let told = told["objects"].as_array().unwrap().iter().find(|object| object["name"] == "cupboard").unwrap().clone();
    let first = told["elements"]["first"].as_u64().unwrap() as usize;
    let count = told["elements"]["count"].as_u64().unwrap() as usize;
    let values = map[first..first + count].iter().flat_map(|value| value.to_array());
    let bytes: Vec<u8> = values.flat_map(f32::to_le_bytes).collect();
    assert!(!bytes.is_empty() && answer.body.windows(bytes.len()).any(|window| window == bytes));
    let extras = format!("\"first_element\":{first}");
    assert!(answer.body.windows(extras.len()).any(|window| window == extras.as_bytes()));
    let detail = object(&server, &scene, "cupboard", "?format=json").await.json(200);
    assert_eq!(detail["materials"][0]["albedo"], json!([0.25, 0.5, 0.75]));
    assert_eq!(detail["mesh"]["triangles"], of_file.mesh.triangles.len());
    server.stop().await;
}

#[tokio::test]
async fn any_name_can_be_asked_for_and_what_is_not_there_is_told() {
    let server = Server::start().await;
    let names = ["a/b", "Stühle & Tische", "50 %2F #1?", "房间", "..."];
    let file = room().bytes_with(|document| {
        // Under more than one name: a node for each, of the same mesh.
        for (name, id) in names.iter().zip(0..) {
            let nodes = document["nodes"].as_array_mut().unwrap();
            nodes.push(json!({ "name": name, "mesh": 0, "extras": { "id": format!("id-{id}") } }));
            let index = nodes.len() - 1;
            document["scenes"][0]["nodes"].as_array_mut().unwrap().push(index.into());
        }
    });
    let scene = server.post_glb("/v1/scenes?spacing=1&bake=false", file).await.json(201);
    for (name, id) in names.iter().zip(0..) {
        let detail = object(&server, &scene, name, "?format=json").await.json(200);
        assert_eq!((&detail["object"]["name"], &detail["object"]["id"]), (&json!(name), &json!(format!("id-{id}"))));
    }
    for name in ["b", "a", "A/b", "a/b/", "%"] {
        object(&server, &scene, name, "").await.problem(404, "object-not-found");
    }
    server.get(&format!("{}/objects/%FF", path_of(&scene))).await.problem(400, "bad-request");
    server.stop().await;
}

#[tokio::test]
async fn the_format_is_chosen_by_query_or_header_and_is_not_sent_twice() {
    let server = Server::start().await;
    let scene = server.room("?bake=false").await;
    let path = format!("{}/objects/cupboard", path_of(&scene));
    let ask = async |name: &str, value: &str| Answer::to(server.request(Method::GET, &path).header(name, value)).await;
    for (accept, kind) in [
        ("*/*", "model/gltf-binary"),
        ("text/html, application/json;q=0.9", "application/json"),
        ("application/octet-stream", "application/octet-stream"),
    ] {
        let answer = ask("accept", accept).await;
        assert_eq!((answer.header("content-type"), answer.header("vary")), (kind, "accept, accept-encoding"));
    }
    let answer = ask("accept-encoding", "gzip").await;
    assert_eq!(answer.header("content-encoding"), "gzip");
    let known = ask("if-none-match", answer.header("etag")).await;
    assert_eq!((known.status.as_u16(), known.body.len()), (304, 0));
    server.get(&format!("{path}?format=obj")).await.problem(400, "invalid-query");
    // Hidden: it is told, and has no elements.
    let hide = json!({ "op": "hide", "objects": ["cupboard"], "budget": { "samples_per_element": 4 } });
    server.end_of(&server.edit(&scene, &hide).await).await;
    let detail = server.get(&format!("{path}?format=json")).await.json(200);
    assert_eq!((&detail["object"]["hidden"], &detail["light"]), (&json!(true), &Value::Null));
    assert_eq!(server.get(&format!("{path}?format=elements")).await.body.len(), 0);
    assert_eq!(load(&server.get(&path).await.body, &LoadLimits::default()).unwrap().objects.len(), 1);
    server.stop().await;
}
