//! Light from outside: pictures as assets, at upload and as an edit, over a restart.

use glam::Vec3;
use rebake_core::delta::Frame;
use rebake_core::export::write_picture_exr;
use serde_json::{Value, json};

use super::durable::{fast_directory, start};
use super::glb::{Glb, crate_asset};
use super::server::{Answer, Server, path_of};

/// A floor below the open sky; without any light.
fn floor() -> Vec<u8> {
    let mut glb = Glb::default();
    glb.quads("floor", &[[[0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [2.0, 0.0, 2.0], [2.0, 0.0, 0.0]]], 0.5, 0.0);
    glb.bytes()
}

/// Even radiance from everywhere above, red in the half about +x and green in the other.
fn two_halves() -> Vec<u8> {
    let pixel = |i: usize| match (i / 8, i % 8) {
        (0..2, 2..6) => Vec3::X,
        (0..2, _) => Vec3::Y,
        _ => Vec3::ZERO,
    };
    write_picture_exr(&(0..32).map(pixel).collect::<Vec<Vec3>>(), 8, &[]).unwrap()
}

/// A Radiance picture of one grey.
fn grey() -> Vec<u8> {
    let mut file = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n".to_vec();
    file.extend([128, 128, 128, 129].repeat(8));
    file
}

async fn post(server: &Server, kind: &str, file: Vec<u8>) -> Answer {
    let request = server.request(reqwest::Method::POST, "/v1/assets").header("content-type", kind).body(file);
    Answer::to(request).await
}

async fn picture(server: &Server, kind: &str, file: Vec<u8>) -> String {
    post(server, kind, file).await.json(201)["asset"].as_str().unwrap().to_owned()
}

/// Uploads the floor and bakes it.
async fn under(server: &Server, query: &str) -> Value {
    let scene = server.post_glb(&format!("/v1/scenes?spacing=0.5&{query}"), floor()).await.json(201);
    let job = scene["current_job"].as_str().expect("a bake").to_owned();
    assert_eq!(server.end_of(&job).await["state"], "succeeded");
    server.get(&path_of(&scene)).await.json(200)
}

/// Mean light of the floor.
async fn light(server: &Server, scene: &Value) -> Vec3 {
    let raw = server.get(&format!("{}/lightmap?format=raw", path_of(scene))).await.body;
    let values = Frame::decode(&raw).unwrap().0.values;
    assert!(!values.is_empty());
    values.iter().sum::<Vec3>() / values.len() as f32
}

fn is_about(light: Vec3, expected: [f32; 3]) -> bool {
    light.abs_diff_eq(Vec3::from(expected), 0.05)
}

#[tokio::test]
async fn skies_come_with_an_upload_and_by_edits_and_outlive_a_restart() {
    let directory = fast_directory();
    let server = start(directory.path()).await;
    let halves = post(&server, "image/x-exr", two_halves()).await.json(201);
    assert_eq!((&halves["triangles"], &halves["picture"]), (&json!(0), &json!([8, 4])));
    let halves = halves["asset"].as_str().unwrap().to_owned();
    assert_eq!(post(&server, "image/x-exr", two_halves()).await.json(200)["asset"], halves);
    let grey = picture(&server, "image/vnd.radiance", grey()).await;

    let scene = under(&server, &format!("sky={halves}&sky_rotation=90&sky_strength=2&samples_per_element=64")).await;
    let sky = &scene["lights"][0];
    assert_eq!(
        (&sky["name"], &sky["kind"], &sky["intensity"]),
        (&json!("environment"), &json!("environment"), &json!(2.0))
    );
    assert!((sky["rotation"].as_f64().unwrap() - 90.0).abs() < 1e-3, "{sky}");
    assert!(scene["warnings"].as_array().unwrap().is_empty(), "{}", scene["warnings"]);
    assert!(is_about(light(&server, &scene).await, [1.0, 1.0, 0.0]));
    let job = server.edit(&scene, &json!({ "op": "sky", "asset": grey, "strength": 0.5 })).await;
    assert_eq!(server.end_of(&job).await["state"], "succeeded");
    assert!(is_about(light(&server, &scene).await, [0.5; 3]));
    // What a scene has used stays.
    for asset in [&halves, &grey] {
        let told = server.delete(&format!("/v1/assets/{asset}")).await.problem(409, "asset-needed");
        assert!(told.contains(scene["id"].as_str().unwrap()), "{told}");
    }
    let before = server.get(&format!("{}/lightmap?format=raw", path_of(&scene))).await.body;
    server.stop().await;

    let server = start(directory.path()).await;
    let again = server.get(&path_of(&scene)).await.json(200);
    assert_eq!((&again["lights"][0]["intensity"], &again["error"]), (&json!(0.5), &Value::Null));
    assert_eq!(server.get(&format!("{}/lightmap?format=raw", path_of(&scene))).await.body, before);
    server.delete(&format!("/v1/assets/{halves}")).await.problem(409, "asset-needed");
    let job = server.edit(&scene, &json!({ "op": "sky", "radiance": [0.2, 0.4, 0.8] })).await;
    assert_eq!(server.end_of(&job).await["state"], "succeeded");
    assert!(is_about(light(&server, &scene).await, [0.2, 0.4, 0.8]));
    server.stop().await;
}

#[tokio::test]
async fn a_scene_without_light_says_so_and_gets_a_sky_where_it_asks() {
    let server = Server::start().await;
    let dark = under(&server, "samples_per_element=4").await;
    assert!(dark["warnings"][0].as_str().unwrap().contains("default_sky"), "{}", dark["warnings"]);
    assert!(light(&server, &dark).await == Vec3::ZERO);
    let lit = under(&server, "samples_per_element=4&default_sky=true").await;
    assert!(lit["warnings"][0].as_str().unwrap().contains("default sky"), "{}", lit["warnings"]);
    assert!(is_about(light(&server, &lit).await, [1.0; 3]));
    let other = under(&server, "samples_per_element=4&default_sky=true&environment=0.5,0.5,0.5").await;
    assert!(is_about(light(&server, &other).await, [0.5; 3]) && other["warnings"] == json!([]));
    server.stop().await;
}

#[tokio::test]
async fn what_is_wrong_with_a_sky_is_named() {
    let server = Server::start().await;
    let sky = picture(&server, "image/x-exr", two_halves()).await;
    let model = server.post_glb("/v1/assets", crate_asset()).await.json(201)["asset"].as_str().unwrap().to_owned();
    let scene = server.room("?bake=false").await;
    let edits = format!("{}/edits", path_of(&scene));
    for (edit, slug, field) in [
        (json!({ "op": "sky" }), "invalid-value", "asset"),
        (json!({ "op": "sky", "asset": sky, "radiance": [1, 1, 1] }), "invalid-value", "radiance"),
        (json!({ "op": "sky", "radiance": [1, -1, 1] }), "invalid-value", "radiance"),
        (json!({ "op": "sky", "radiance": [1e6, 1, 1], "strength": 1e6 }), "invalid-value", "radiance"),
        (json!({ "op": "sky", "asset": sky, "strength": -1 }), "invalid-value", "strength"),
        (json!({ "op": "sky", "asset": sky, "rotation": "north" }), "invalid-value", "rotation"),
        (json!({ "op": "sky", "asset": "abc" }), "unknown-asset", "asset"),
        (json!({ "op": "sky", "asset": model }), "invalid-value", "asset"),
        (json!({ "op": "sky", "asset": sky, "colour": 1 }), "invalid-value", "colour"),
        (
            json!({ "op": "insert", "asset": sky, "name": "a", "transform": super::glb::translation(0.0, 0.0, 0.0) }),
            "invalid-value",
            "asset",
        ),
    ] {
        let told = server.post_json(&edits, &edit).await.problem(422, slug);
        assert!(told.contains(field), "{edit}: {told}");
    }
    let list =
        json!({ "edits": [{ "op": "sky", "radiance": [1, 1, 1] }, { "op": "sky", "asset": sky, "strength": -1 }] });
    let told = server.post_json(&edits, &list).await.problem(422, "invalid-value");
    assert!(told.contains("edits[1].strength"), "{told}");
    for (query, status, slug, field) in [
        (format!("sky={sky}&environment=1,1,1"), 400, "invalid-query", "sky"),
        (format!("sky={sky}&sky_rotation=inf"), 400, "invalid-query", "sky_rotation"),
        (format!("sky={sky}&sky_strength=-1"), 400, "invalid-query", "sky_strength"),
        ("sky_strength=1".to_owned(), 400, "invalid-query", "sky_strength"),
        ("sun_angle=180".to_owned(), 400, "invalid-query", "sun_angle"),
        ("unit=lumen".to_owned(), 400, "invalid-query", "unit"),
        ("sky=abc".to_owned(), 422, "unknown-asset", "sky"),
        (format!("sky={model}"), 422, "invalid-value", "sky"),
    ] {
        let told = server.post_glb(&format!("/v1/scenes?{query}"), floor()).await.problem(status, slug);
        assert!(told.contains(field), "{query}: {told}");
    }
    for (kind, file, status, slug) in [
        ("image/x-exr", two_halves()[..200].to_vec(), 400, "malformed-file"),
        ("image/x-exr", floor(), 400, "malformed-file"),
        ("image/png", two_halves(), 415, "unsupported-media-type"),
    ] {
        post(&server, kind, file).await.problem(status, slug);
    }
    server.stop().await;
}

/// Watts are of the file that says so, and stay so over a restart; lux and radiance are what they are.
#[tokio::test]
async fn lamps_may_be_in_watts() {
    let directory = fast_directory();
    let server = start(directory.path()).await;
    let mut glb = Glb::default();
    glb.quads("panel", &[[[0.0, 3.0, 0.0], [2.0, 3.0, 0.0], [2.0, 3.0, 2.0], [0.0, 3.0, 2.0]]], 0.5, 2.0);
    glb.point_light("bulb", [1.0, 1.0, 1.0], 100.0);
    let mut scenes = Vec::new();
    for (query, intensity) in
        [("", 100.0), ("&unit=candela", 100.0), ("&unit=watt", 100.0 / (4.0 * std::f64::consts::PI))]
    {
        let path = format!("/v1/scenes?spacing=0.5&bake=false{query}");
        scenes.push((path_of(&server.post_glb(&path, glb.bytes()).await.json(201)), intensity));
    }
    let intensities = async |server: &Server, scene: &str| {
        let scene = server.get(scene).await.json(200);
        let of = |name: &str| {
            let lights = scene["lights"].as_array().unwrap().iter();
            lights
                .filter(|light| light["name"] == name)
                .map(|light| light["intensity"].as_f64().unwrap())
                .next()
                .unwrap()
        };
        [of("bulb"), of("panel")]
    };
    let check = async |server: &Server| {
        for (scene, intensity) in &scenes {
            let [bulb, panel] = intensities(server, scene).await;
            assert!((bulb - intensity).abs() < 1e-5 * intensity && panel == 2.0, "{bulb} and {panel}");
        }
    };
    check(&server).await;
    server.stop().await;
    check(&start(directory.path()).await).await;
}
