//! Scenes as glTF with their light map: what files had, as edits have left it.

use rebake_core::scene::{LoadLimits, Scene, load};
use serde_json::{Value, json};

use super::durable::start;
use super::glb::{Glb, translation};
use super::server::{Server, path_of};

/// A room whose cupboard stands below a group, beside a marker; named materials, one of which nothing uses otherwise.
fn house() -> Vec<u8> {
    let mut glb = Glb::default();
    glb.cuboid("room", [0.0, 0.0, 0.0], [4.0, 3.0, 4.0], 0.7, true)
        .cuboid("cupboard", [0.5, 0.02, 0.5], [1.5, 1.5, 1.0], 0.5, false)
        .quads("bulb", &[[[1.0, 2.9, 1.0], [2.0, 2.9, 1.0], [2.0, 2.9, 2.0], [1.0, 2.9, 2.0]]], 0.3, 5.0)
        .point_light("lamp", [2.0, 2.0, 2.0], 20.0)
        .camera("view", [2.0, 1.5, 3.5]);
    glb.bytes_with(|json| {
        for (material, name) in json["materials"].as_array_mut().unwrap().iter_mut().zip(["plaster", "oak", "glow"]) {
            material["name"] = name.into();
        }
        let nodes = json["nodes"].as_array_mut().unwrap();
        nodes[1]["extras"] = json!({ "id": "c-1" });
        nodes.push(json!({ "name": "furniture", "children": [1], "translation": [0.25, 0.0, 0.0] }));
        nodes.push(json!({ "name": "marker" }));
        json["scenes"][0]["nodes"] = json!([5, 0, 2, 3, 4, 6]);
    })
}

async fn file(server: &Server, scene: &Value, query: &str) -> Vec<u8> {
    let answer = server.get(&format!("{}/lightmap?format=glb&{query}", path_of(scene))).await;
    assert_eq!(answer.status, 200, "{query}: {}", String::from_utf8_lossy(&answer.body));
    answer.body
}

/// The JSON of a binary glTF.
fn document(file: &[u8]) -> Value {
    let length = u32::from_le_bytes(file[12..16].try_into().unwrap()) as usize;
    serde_json::from_slice(&file[20..20 + length]).unwrap()
}

fn read(file: &[u8]) -> Scene {
    load(file, &LoadLimits::default()).unwrap()
}

fn names(file: &[u8]) -> Vec<String> {
    let mut names: Vec<String> =
        document(file)["nodes"].as_array().unwrap().iter().map(|n| n["name"].as_str().unwrap().to_owned()).collect();
    names.sort();
    names
}

fn node<'j>(json: &'j Value, name: &str) -> &'j Value {
    json["nodes"].as_array().unwrap().iter().find(|node| node["name"] == name).expect(name)
}

fn material<'j>(json: &'j Value, name: &str) -> &'j Value {
    json["materials"].as_array().unwrap().iter().find(|material| material["name"] == name).expect(name)
}

fn place(scene: &Scene, name: &str) -> [f64; 3] {
    let object = scene.objects.iter().find(|object| object.name == name).expect(name);
    object.world_from_object.w_axis.truncate().to_array()
}

/// With and without a data directory, whose files are read anew after a restart.
#[tokio::test]
async fn files_come_back_as_edits_have_left_them() {
    let directory = tempfile::tempdir().unwrap();
    let mut server = start(directory.path()).await;
    let upload = "/v1/scenes?samples_per_element=2&spacing=0.5&texels_per_metre=6";
    let scene = server.post_glb(upload, house()).await.json(201);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    let asset = server.crate_asset().await;
    let all = ["bulb", "cupboard", "furniture", "lamp", "marker", "room", "view"];
    for query in ["layout=vertices", "layout=atlas&unlit=false"] {
        let file = file(&server, &scene, query).await;
        let (json, again) = (document(&file), read(&file));
        assert_eq!(names(&file), all);
        let below = json["nodes"][node(&json, "furniture")["children"][0].as_u64().unwrap() as usize].clone();
        assert_eq!((&below["name"], &below["extras"]["id"]), (&json!("cupboard"), &json!("c-1")));
        assert_eq!(place(&again, "cupboard"), [0.25, 0.0, 0.0]);
        assert_eq!((again.lights.len(), again.cameras.len()), (2, 1));
        assert_eq!(json["asset"]["extras"]["light_map"]["version"], scene_version(&server, &scene).await);
    }
    let edits = json!({ "budget": { "samples_per_element": 2 }, "edits": [
        { "op": "insert", "asset": asset, "name": "crate", "transform": translation(2.0, 0.01, 2.0) },
        { "op": "move", "object": "cupboard", "transform": translation(1.0, 0.0, 1.0) },
        { "op": "remove", "objects": ["bulb"] },
        { "op": "material", "object": "cupboard", "albedo": [0.1, 0.2, 0.3] },
        { "op": "move_light", "light": "lamp", "position": [1.0, 2.0, 1.0] },
    ] });
    server.end_of(&server.edit(&scene, &edits).await).await;
    let left = ["crate", "cupboard", "furniture", "lamp", "marker", "room", "view"];
    for is_restarted in [false, true] {
        if is_restarted {
            server.stop().await;
            server = start(directory.path()).await;
        }
        for query in ["layout=vertices", "layout=atlas&unlit=false"] {
            let file = file(&server, &scene, query).await;
            let (json, again) = (document(&file), read(&file));
            assert_eq!(names(&file), left);
            assert_eq!(
                (place(&again, "cupboard"), place(&again, "crate")),
                ([1.0, 0.0, 1.0], [2.0, 0.01_f32.into(), 2.0])
            );
            let factor = &material(&json, "oak")["pbrMetallicRoughness"]["baseColorFactor"];
            assert_eq!(factor.as_array().unwrap()[..3], [0.1_f32, 0.2, 0.3].map(|c| json!(c)));
            assert_eq!(node(&json, "lamp")["translation"], json!([1.0, 2.0, 1.0]));
            assert!(again.lights.iter().all(|light| light.name != "bulb"));
        }
    }
    server.stop().await;
}

async fn scene_version(server: &Server, scene: &Value) -> Value {
    server.get(&path_of(scene)).await.json(200)["version"].clone()
}

/// How it is shown is the client's choice.
#[tokio::test]
async fn materials_are_lit_as_is_asked_for() {
    let server = Server::start().await;
    let scene = server.post_glb("/v1/scenes?samples_per_element=1&spacing=0.5", house()).await.json(201);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    let is_unlit = |json: &Value| material(json, "plaster")["extensions"].get("KHR_materials_unlit").is_some();
    let shines = |json: &Value| material(json, "plaster").get("emissiveTexture").is_some();
    for (query, unlit, shining) in [
        ("layout=vertices", false, false),
        ("layout=vertices&unlit=true", true, false),
        ("layout=atlas", false, true),
        ("layout=atlas&unlit=false", false, false),
    ] {
        let json = document(&file(&server, &scene, query).await);
        assert_eq!((is_unlit(&json), shines(&json)), (unlit, shining), "{query}");
        let has_map = material(&json, "plaster")["extensions"].get("MOZ_lightmap").is_some();
        assert_eq!(has_map, query.contains("atlas"), "{query}");
        assert_eq!(material(&json, "glow")["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"], 5.0);
    }
    let refused = server.get(&format!("{}/lightmap?format=exr&unlit=true", path_of(&scene))).await;
    assert!(refused.problem(400, "invalid-query").contains("unlit"));
    server.stop().await;
}
