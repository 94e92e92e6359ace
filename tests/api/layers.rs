//! Layers: relighting without rays, and what clients see of layers through edits, undo and restarts.

use std::collections::BTreeSet;
use std::io::Cursor;

use exr::prelude::{ReadChannels, ReadLayers, read};
use glam::Vec3;
use rebake_core::delta::Frame;
use rebake_core::scene::{LoadLimits, load};
use rebake_core::{World, WorldOptions};
use serde_json::{Value, json};

use super::deltas::{Follower, open};
use super::durable::fast_directory;
use super::glb::{self, translation};
use super::server::{Server, next_event, path_of};

/// Uploads the room with two lamps and lets its bake end.
async fn two_lamps(server: &Server, query: &str) -> Value {
    let scene = server.post_glb(&format!("/v1/scenes?spacing=1&samples_per_element=4{query}"), two_lamps_glb()).await;
    let scene = scene.json(201);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    server.get(&path_of(&scene)).await.json(200)
}

fn two_lamps_glb() -> Vec<u8> {
    glb::room().point_light("lamp-2", [1.0, 2.5, 3.0], 10.0).bytes()
}

pub(super) fn relight(light: &str, intensity: f64) -> Value {
    json!({ "op": "relight", "lights": [{ "light": light, "intensity": intensity }],
        "budget": { "samples_per_element": 4 } })
}

/// Posts an edit and waits for its light; answers the job and the scene.
pub(super) async fn edited(server: &Server, scene: &Value, edit: &Value) -> (Value, Value) {
    let job = server.end_of(&server.edit(scene, edit).await).await;
    assert_eq!(job["state"], "succeeded", "{job}");
    (job, server.get(&path_of(scene)).await.json(200))
}

/// Values of the map, or of a layer.
pub(super) async fn values(server: &Server, scene: &Value, layer: &str) -> Vec<Vec3> {
    let query = if layer.is_empty() { String::new() } else { format!("&layer={layer}") };
    let answer = server.get(&format!("{}/lightmap?format=raw{query}", path_of(scene))).await;
    assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
    assert_eq!(answer.header("etag"), format!("\"{}\"", answer.header("x-rebake-version")));
    Frame::decode(&answer.body).unwrap().0.values
}

pub(super) fn bits(values: &[Vec3]) -> Vec<[u32; 3]> {
    values.iter().map(|value| value.to_array().map(f32::to_bits)).collect()
}

pub(super) fn layer_names(scene: &Value) -> Vec<&str> {
    let mut names: Vec<&str> =
        scene["layers"].as_array().unwrap().iter().map(|layer| layer["name"].as_str().unwrap()).collect();
    names.sort_unstable();
    names
}

fn layer_of<'a>(scene: &'a Value, light: &str) -> &'a Value {
    &scene["lights"].as_array().unwrap().iter().find(|l| l["name"] == light).unwrap()["layer"]
}

/// The sum of weight × layer is the map, up to rounding.
pub(super) async fn assert_adds_up(server: &Server, scene: &Value) {
    let map = values(server, scene, "").await;
    let (mut sum, mut size) = (vec![Vec3::ZERO; map.len()], vec![Vec3::ZERO; map.len()]);
    for layer in scene["layers"].as_array().unwrap() {
        let weight = Vec3::from([0, 1, 2].map(|k| layer["weight"][k].as_f64().unwrap() as f32));
        let its = values(server, scene, layer["name"].as_str().unwrap()).await;
        assert_eq!(its.len(), map.len());
        for (slot, value) in its.iter().enumerate() {
            sum[slot] += *value * weight;
            size[slot] += (*value * weight).abs();
        }
    }
    for (slot, value) in map.iter().enumerate() {
        let fits = (sum[slot] - *value).abs().cmple((size[slot] + value.abs()) * 1e-5).all();
        assert!(fits, "slot {slot}: {} instead of {value}", sum[slot]);
    }
}

#[tokio::test]
async fn the_first_relight_splits_a_light_off_and_the_next_ones_need_no_ray() {
    let server = Server::start().await;
    let scene = two_lamps(&server, "").await;
    assert_eq!((&scene["layers"], layer_of(&scene, "lamp")), (&json!([]), &Value::Null));
    let (job, split) = edited(&server, &scene, &relight("lamp", 40.0)).await;
    assert!(job["progress"]["rays"].as_u64().unwrap() > 0);
    assert_eq!(layer_names(&split), ["lamp", "shared"]);
    assert_eq!((layer_of(&split, "lamp"), layer_of(&split, "lamp-2")), (&json!("lamp"), &json!("shared")));
    let lamp = split["layers"].as_array().unwrap().iter().find(|layer| layer["name"] == "lamp").unwrap();
    assert_eq!(lamp["weight"], json!([40.0, 40.0, 40.0]));
    assert_eq!(lamp["lights"], json!([{ "name": "lamp", "reference": [1.0, 1.0, 1.0] }]));
    let per_element = lamp["memory_bytes"].as_f64().unwrap() / split["elements"].as_f64().unwrap();
    assert!((28.0..29.0).contains(&per_element), "{per_element}");
    assert!(split["memory_bytes"].as_u64() > scene["memory_bytes"].as_u64());
    assert_adds_up(&server, &split).await;
    for strength in [10.0, 0.0, 25.0] {
        let job = server.edit(&scene, &relight("lamp", strength)).await;
        let mut events = server.client.job_events(&job, Some("0")).await.unwrap();
        let (mut snapshots, mut last) = (0, Value::Null);
        while let Some((kind, _, data)) = next_event(&mut events).await {
            // The first version only tells the light's new strength: it has no round of its own.
            snapshots += usize::from(kind == "snapshot" && data["samples_per_element"].is_u64());
            last = if kind == "job" { data } else { last };
        }
        assert_eq!((&last["state"], snapshots), (&json!("succeeded"), 1), "{last}");
        assert_eq!(last["progress"]["rays"], 0);
        let now = server.get(&path_of(&scene)).await.json(200);
        assert_eq!(now["version"], last["progress"]["version"]);
        assert_adds_up(&server, &now).await;
    }
    server.stop().await;
}

#[tokio::test]
async fn a_relight_taken_back_gives_the_earlier_map_and_keeps_the_layers() {
    let server = Server::start().await;
    let scene = two_lamps(&server, "&mode=indirect").await;
    let before = values(&server, &scene, "").await;
    edited(&server, &scene, &relight("lamp", 40.0)).await;
    let (_, back) = edited(&server, &scene, &relight("lamp", 20.0)).await;
    // A map without layers is delivered without negative noise; what one with layers is the sum of keeps it.
    let mut after = values(&server, &scene, "").await;
    let uploaded = load(&two_lamps_glb(), &LoadLimits::default()).unwrap();
    let world = World::new(uploaded, &WorldOptions { spacing: Some(1.0), ..WorldOptions::default() }).unwrap();
    world.without_negative(&mut after);
    assert_eq!(bits(&after), bits(&before));
    assert_eq!(layer_names(&back), ["lamp", "shared"]);
    assert_adds_up(&server, &back).await;
    let (job, after) = edited(&server, &scene, &relight("lamp", 30.0)).await;
    assert_eq!(job["progress"]["rays"], 0);
    assert_adds_up(&server, &after).await;
    server.stop().await;
}

#[tokio::test]
async fn layers_survive_a_restart() {
    let directory = fast_directory();
    let start = async || Server::with(|config| config.data_dir = Some(directory.path().to_owned())).await;
    let server = start().await;
    let scene = two_lamps(&server, "").await;
    edited(&server, &scene, &relight("lamp", 40.0)).await;
    let group =
        json!({ "op": "group_lights", "name": "warm", "lights": ["lamp-2"], "budget": { "samples_per_element": 4 } });
    let (_, before) = edited(&server, &scene, &group).await;
    assert_eq!(layer_names(&before), ["lamp", "warm"]);
    let upload = format!("/v1/scenes?bake=false&spacing=1&layers={}", r#"{"all lamps":["lamp","lamp-2"]}"#);
    let unbaked = server.post_glb(&upload, two_lamps_glb()).await.json(201);
    let (map, lamp) = (values(&server, &scene, "").await, values(&server, &scene, "lamp").await);
    server.stop().await;

    let server = start().await;
    let after = server.get(&path_of(&scene)).await.json(200);
    assert_eq!((&after["layers"], &after["lights"]), (&before["layers"], &before["lights"]));
    assert_eq!(bits(&values(&server, &scene, "").await), bits(&map));
    assert_eq!(bits(&values(&server, &scene, "lamp").await), bits(&lamp));
    assert_adds_up(&server, &after).await;
    let (job, _) = edited(&server, &scene, &relight("lamp", 5.0)).await;
    assert_eq!(job["progress"]["rays"], 0);
    // What the upload asked for counts when it is baked.
    let (_, baked) = edited(
        &server,
        &unbaked,
        &json!({ "op": "remove", "objects": ["cupboard"], "budget": { "samples_per_element": 4 } }),
    )
    .await;
    assert_eq!(layer_names(&baked), ["all lamps"]);
    server.stop().await;
}

#[tokio::test]
async fn who_follows_a_layer_has_it_bit_for_bit() {
    let server = Server::start().await;
    let asset = server.crate_asset().await;
    let scene = two_lamps(&server, "&layers=each").await;
    let (mut follower, mut whole) = (Follower::default(), Follower::default());
    let mut stream = open(&server, &scene, "since=0&follow=true&layer=lamp-2").await;
    let paint = |albedo: f64| {
        json!({ "op": "material", "object": "room", "albedo": [albedo, albedo, albedo],
            "budget": { "samples_per_element": 4 } })
    };
    let insert = json!({ "op": "insert", "asset": asset, "name": "a", "transform": translation(2.0, 0.01, 2.0),
        "budget": { "samples_per_element": 4 } });
    let later = [paint(0.3), relight("lamp-2", 3.0), insert, relight("lamp", 1.0), paint(0.6)];
    for (i, edit) in later.iter().enumerate() {
        let since = whole.version;
        let (job, now) = edited(&server, &scene, edit).await;
        let version = job["progress"]["version"].as_u64().unwrap();
        follower.reach(&mut stream, version).await;
        let expected = bits(&values(&server, &scene, "lamp-2").await);
        assert_eq!(follower.bits(), expected, "edit {i}");
        // Who was away catches up in one frame, with nothing in it where only strengths changed.
        let frames = server.get(&format!("{}/lightmap/deltas?since={since}&layer=lamp-2", path_of(&scene))).await.body;
        if edit["op"] == "relight" {
            assert!(Frame::decode(&frames).unwrap().0.values.is_empty());
        }
        whole.take(&frames);
        assert_eq!((whole.bits(), whole.version), (expected, version));
        assert_adds_up(&server, &now).await;
    }
    // The layer goes with its light, and the stream with the layer.
    edited(&server, &scene, &json!({ "op": "remove_light", "light": "lamp-2" })).await;
    while let Some(bytes) = super::server::patiently(stream.chunk()).await.unwrap() {
        follower.take(&bytes);
    }
    let gone = server.get(&format!("{}/lightmap/deltas?since=1&layer=lamp-2", path_of(&scene))).await;
    assert!(gone.problem(400, "invalid-query").contains("\"lamp\""));
    server.stop().await;
}

#[tokio::test]
async fn a_layer_comes_in_every_format_and_all_of_them_in_one_picture() {
    let server = Server::start().await;
    let scene = two_lamps(&server, "&layers=each").await;
    let path = format!("{}/lightmap", path_of(&scene));
    for (format, magic) in [("exr", &[0x76, 0x2f, 0x31, 0x01][..]), ("glb", b"glTF"), ("raw", b"RBKD")] {
        let answer = server.get(&format!("{path}?format={format}&layer=lamp&part=direct")).await;
        assert_eq!(answer.status, 200);
        assert!(answer.body.starts_with(magic), "{format}");
    }
    let (full, direct) = (values(&server, &scene, "lamp").await, values(&server, &scene, "lamp&part=direct").await);
    let indirect = values(&server, &scene, "%22lamp%22&part=indirect").await;
    assert!(full.iter().zip(&direct).zip(&indirect).all(|((f, d), i)| *f == *d + *i));
    let file = server.get(&format!("{path}?format=exr&layer=all")).await.body;
    let image = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer().all_attributes();
    let picture = image.from_buffered(Cursor::new(file)).unwrap().layer_data;
    let names: BTreeSet<String> = picture.channel_data.list.iter().map(|channel| channel.name.to_string()).collect();
    let expected: BTreeSet<String> = ["lamp", "lamp-2"]
        .iter()
        .flat_map(|layer| ["direct", "indirect"].map(|part| format!("{layer}.{part}")))
        .flat_map(|name| ["R", "G", "B"].map(|channel| format!("{name}.{channel}")))
        .collect();
    assert_eq!(names, expected);
    for query in ["layer=sun", "layer=direct&part=full", "layer=all", "layer=all&format=glb", "layer=lamp&part=all"] {
        let detail = server.get(&format!("{path}?format=raw&{query}")).await.problem(400, "invalid-query");
        let known = query != "layer=sun" || detail.starts_with("layer: ") && detail.contains("\"lamp\", \"lamp-2\"");
        assert!(known, "{detail}");
    }
    let one = server.baked_room("?samples_per_element=4").await;
    let none = server.get(&format!("{}/lightmap?format=exr&layer=all", path_of(&one))).await;
    assert!(none.problem(400, "invalid-query").starts_with("layer: "));
    server.stop().await;
}

#[tokio::test]
async fn uploads_and_edits_that_ask_for_impossible_layers_are_refused() {
    let server = Server::start().await;
    let mut many = glb::room();
    for i in 0..1022 {
        many.point_light(&format!("l{i}"), [1.0 + 0.001 * i as f32, 2.0, 2.0], 1.0);
    }
    let refused = server.post_glb("/v1/scenes?spacing=1&layers=each", many.bytes()).await;
    let detail = refused.problem(400, "invalid-query");
    assert!(detail.starts_with("layers: ") && detail.contains("1023 lights") && detail.contains("1022"), "{detail}");
    let post =
        async |layers: &str| server.post_glb(&format!("/v1/scenes?spacing=1&layers={layers}"), two_lamps_glb()).await;
    assert!(post(r#"{"a":["sun"]}"#).await.problem(422, "unknown-light").starts_with("layers: "));
    for layers in ["all", r#"{"a":["lamp"],"b":["lamp"]}"#, r#"{"a":[]}"#, "[]", ""] {
        assert!(post(layers).await.problem(400, "invalid-query").starts_with("layers: "), "{layers}");
    }

    let scene = two_lamps(&server, "").await;
    let bright = json!({ "light": "lamp", "color": [1e6, 0, 0], "intensity": 1e6 });
    for (edit, slug, field) in [
        (json!({ "op": "group_lights", "name": "a", "lights": [] }), "invalid-value", "lights"),
        (json!({ "op": "group_lights", "name": "a" }), "invalid-value", "lights"),
        (json!({ "op": "group_lights", "name": "", "lights": ["lamp"] }), "invalid-value", "name"),
        (json!({ "op": "group_lights", "name": "shared", "lights": ["lamp"] }), "invalid-value", "name"),
        (json!({ "op": "group_lights", "name": 3, "lights": ["lamp"] }), "invalid-value", "name"),
        (json!({ "op": "group_lights", "name": "a", "lights": ["lamp", "sun"] }), "unknown-light", "lights[1]"),
        (json!({ "op": "group_lights", "group": "a", "lights": ["lamp"] }), "invalid-value", "group"),
        (json!({ "edits": [relight("lamp", 1e10)] }), "invalid-value", "edits[0].lights[0].intensity"),
        (
            json!({ "edits": [{ "op": "relight", "lights": [bright] }] }),
            "invalid-value",
            "edits[0].lights[0].intensity",
        ),
        (
            json!({ "op": "relight", "lights": [{ "light": "lamp", "color": [1e8, 0, 0] }] }),
            "invalid-value",
            "lights[0].color",
        ),
        (
            json!({ "op": "relight", "lights": [{ "light": "lamp", "color": [-1, 0, 0] }] }),
            "invalid-value",
            "lights[0].color",
        ),
    ] {
        let answer = server.post_json(&format!("{}/edits", path_of(&scene)), &edit).await;
        answer.problem(422, slug);
        assert_eq!(answer.json(422)["field"], field, "{edit}");
    }
    let (_, grouped) =
        edited(&server, &scene, &json!({ "op": "group_lights", "name": "both", "lights": ["lamp", "lamp-2"] })).await;
    assert_eq!(layer_names(&grouped), ["both"]);
    let both = json!({ "op": "relight", "lights": [{ "light": "lamp", "intensity": 10 },
        { "light": "lamp-2", "intensity": 5 }] });
    let (job, dimmed) = edited(&server, &scene, &both).await;
    assert_eq!(job["progress"]["rays"], 0, "both by the same factor");
    assert_adds_up(&server, &dimmed).await;
    server.stop().await;
}

#[tokio::test]
async fn layers_that_do_not_fit_are_refused_and_those_there_are_go_on() {
    // Enough for the scene as it is estimated, not for two layers more.
    const TIGHT: u64 = 190_000;
    let server = Server::with(|config| config.limits.memory_bytes = TIGHT).await;
    let refused = server.post_glb("/v1/scenes?spacing=1&bake=false&layers=each", two_lamps_glb()).await;
    assert!(refused.problem(413, "scene-too-large").contains("layers"));
    let scene = two_lamps(&server, "").await;
    server.stop().await;
    // As many scenes as fit, then layers as long as they do.
    let limit = TIGHT + 25 * scene["memory_bytes"].as_u64().unwrap();
    let server = Server::with(|config| config.limits.memory_bytes = limit).await;
    let mut scenes = Vec::new();
    loop {
        let answer = server.post_glb("/v1/scenes?spacing=1&samples_per_element=1", two_lamps_glb()).await;
        if answer.status != 201 {
            answer.problem(409, "no-memory");
            break;
        }
        let scene = answer.json(201);
        server.end_of(scene["current_job"].as_str().unwrap()).await;
        scenes.push(scene);
    }
    let (mut relit, mut refused) = (None, None);
    for scene in &scenes {
        let answer = server.post_json(&format!("{}/edits", path_of(scene)), &relight("lamp", 40.0)).await;
        if answer.status != 202 {
            refused = Some(answer);
            break;
        }
        server.end_of(answer.json(202)["id"].as_str().unwrap()).await;
        relit = Some(scene);
    }
    assert!(refused.expect("memory is used up").problem(409, "no-memory").contains("layers"));
    let (job, _) = edited(&server, relit.expect("there was some memory"), &relight("lamp", 10.0)).await;
    assert_eq!(job["progress"]["rays"], 0);
    server.stop().await;
}
