//! Preview pictures over HTTP.

use std::f32::consts::FRAC_1_PI;
use std::io::Cursor;
use std::time::Duration;

use reqwest::Method;
use serde_json::{Value, json};

use super::server::{Answer, PATIENCE, Server, path_of};

/// Linear RGB, row by row.
struct Pixels {
    size: (usize, usize),
    rgb: Vec<[f32; 3]>,
}

fn decode_exr(bytes: &[u8]) -> Pixels {
    use exr::prelude::{ReadChannels, ReadLayers, read};
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |size, _| Pixels { size: (size.0, size.1), rgb: vec![[0.0; 3]; size.0 * size.1] },
            |pixels: &mut Pixels, at, (r, g, b): (f32, f32, f32)| {
                let width = pixels.size.0;
                pixels.rgb[at.1 * width + at.0] = [r, g, b];
            },
        )
        .first_valid_layer()
        .all_attributes()
        .from_buffered(Cursor::new(bytes))
        .unwrap();
    image.layer_data.channel_data.pixels
}

async fn exr(server: &Server, scene: &Value, query: &str) -> Pixels {
    let answer = server.get(&format!("{}/render?format=exr&{query}", path_of(scene))).await;
    assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
    assert_eq!(answer.header("content-type"), "image/x-exr");
    decode_exr(&answer.body)
}

/// The room's floor behind the cupboard's far side, from one metre above: half a metre beside the point under the lamp.
const FLOOR: &str = "eye=2,1,2.5&target=2,0,2.5&up=1,0,0&fov_y=0.001&width=4&height=2&spp=1";

#[tokio::test]
async fn a_picture_shows_rays_for_direct_light_and_the_map_for_the_rest() {
    let server = Server::start().await;
    let scene = server.baked_room("?samples_per_element=8").await;
    let direct = exr(&server, &scene, &format!("{FLOOR}&view=direct")).await;
    assert_eq!(direct.size, (4, 2));
    // 20 cd at a height of 2 m, half a metre to the side, on an albedo of 0.7.
    let distance2 = 4.25f32;
    let expected = 0.7 * FRAC_1_PI * 20.0 * 2.0 / distance2.powf(1.5);
    for [r, g, b] in &direct.rgb {
        assert!((r / expected - 1.0).abs() < 2e-3 && r == g && g == b, "{r} {expected}");
    }
    let indirect = exr(&server, &scene, &format!("{FLOOR}&view=indirect")).await;
    let full = exr(&server, &scene, FLOOR).await;
    for ((full, direct), indirect) in full.rgb.iter().zip(&direct.rgb).zip(&indirect.rgb) {
        assert!(indirect[0] > 0.02 * direct[0]);
        assert!((full[0] - direct[0] - indirect[0]).abs() < 1e-6 * full[0], "{full:?} {direct:?} {indirect:?}");
    }
    server.stop().await;
}

#[tokio::test]
async fn pictures_say_how_they_were_made_and_repeat() {
    let server = Server::start().await;
    let scene = server.baked_room("?samples_per_element=4").await;
    let path = format!("{}/render", path_of(&scene));
    let first = server.get(&format!("{path}?width=64&height=48&spp=2")).await;
    assert_eq!((first.status.as_u16(), first.header("content-type")), (200, "image/png"));
    assert_eq!(first.header("x-rebake-version"), scene["version"].to_string());
    let stops: f32 = first.header("x-rebake-exposure").parse().unwrap();
    let png = image::load_from_memory(&first.body).unwrap().into_rgb8();
    assert_eq!(png.dimensions(), (64, 48));
    // The file has one camera: naming it, counting it and leaving it out are the same.
    for query in ["camera=view", "camera=0", "tone=agx", &format!("exposure={stops}"), "view=full&format=png"] {
        let same = server.get(&format!("{path}?width=64&height=48&spp=2&{query}")).await;
        assert!(same.body == first.body, "{query}");
    }
    for query in [
        "seed=1",
        "tone=neutral",
        "tone=linear",
        "exposure=-3",
        "view=error",
        "view=elements",
        "eye=2,1,1&target=2,1,3",
    ] {
        let other = server.get(&format!("{path}?width=64&height=48&spp=2&{query}")).await;
        assert_eq!(other.status, 200, "{query}");
        assert!(other.body != first.body, "{query}");
    }
    let error = server.get(&format!("{path}?view=error&width=32&height=32")).await;
    assert!(error.header("x-rebake-scale").parse::<f32>().unwrap() > 0.0);
    server.stop().await;
}

#[tokio::test]
async fn a_change_is_shown_against_the_version_before_the_edit() {
    let server = Server::start().await;
    let scene = server.baked_room("?samples_per_element=16").await;
    let path = format!("{}/render", path_of(&scene));
    server.get(&format!("{path}?view=change")).await.problem(410, "version-forgotten");
    let job = server.edit(&scene, &json!({"op": "remove", "objects": ["cupboard"]})).await;
    assert_eq!(server.end_of(&job).await["state"], "succeeded");
    // The floor where the cupboard stood, 2 cm above it, was in the dark.
    let there = "eye=1,1.8,0.75&target=1,0,0.75&up=1,0,0&fov_y=0.01&width=2&height=2&spp=4";
    let change = exr(&server, &scene, &format!("{there}&view=change")).await;
    assert!(change.rgb.iter().all(|rgb| rgb[0] > 0.1), "{:?}", change.rgb);
    // Against darkness it is the light map itself, mean over RGB.
    let (all, map) = (
        exr(&server, &scene, &format!("{there}&view=change&since=0")).await,
        exr(&server, &scene, &format!("{there}&view=lightmap&filter=none")).await,
    );
    let close = |a: f32, b: f32| (a - b).abs() < 0.02 * b;
    assert!(all.rgb.iter().zip(&map.rgb).all(|(a, b)| close(a[0], (b[0] + b[1] + b[2]) / 3.0)));
    let version = &scene["version"];
    let same = exr(&server, &scene, &format!("{there}&view=change&since={version}")).await;
    assert!(same.rgb == change.rgb);
    let detail = server.get(&format!("{path}?view=change&since=99999")).await.problem(410, "version-forgotten");
    assert!(detail.contains(&version.to_string()), "{detail}");
    server.stop().await;
}

#[tokio::test]
async fn a_progressive_picture_gets_better_and_ends_as_the_one_that_is_waited_for() {
    let server = Server::start().await;
    let scene = server.baked_room("?samples_per_element=4").await;
    let id = scene["id"].as_str().unwrap();
    let client = &server.client;
    for (spp, expected) in [("16", vec!["1", "4", "16"]), ("6", vec!["1", "4", "6"]), ("1", vec!["1"])] {
        let size = [("width", "96".to_owned()), ("height", "64".to_owned()), ("spp", spp.to_owned())];
        let whole = client.render(id, &size).await.unwrap().bytes().await.unwrap();
        let mut parts = client.render_progressively(id, &size).await.unwrap();
        let head = parts.response().headers();
        assert!(head["content-type"].to_str().unwrap().starts_with("multipart/x-mixed-replace; boundary="));
        assert_eq!(head["x-rebake-version"].to_str().unwrap(), scene["version"].to_string());
        let mut found = Vec::new();
        while let Some(part) = parts.next().await.unwrap() {
            assert_eq!(part.header("content-type"), Some("image/png"));
            assert!(part.header("x-rebake-exposure").is_some());
            found.push(part);
        }
        let samples: Vec<&str> = found.iter().map(|part| part.header("x-rebake-samples").unwrap()).collect();
        assert_eq!(samples, expected);
        assert!(found.last().unwrap().bytes == whole, "the last of {spp} samples");
        assert!(found.len() == 1 || found[0].bytes != whole);
    }
    server.stop().await;
}

#[tokio::test]
async fn what_is_wrong_is_named() {
    let server = Server::start().await;
    let scene = server.room("?bake=false").await;
    let path = format!("{}/render", path_of(&scene));
    for (query, field) in [
        ("camera=nowhere", "camera"),
        ("camera=1", "camera"),
        ("camera=0&eye=1,2,3", "eye"),
        ("camera=0&fov_y=1", "fov_y"),
        ("eye=1,2,3", "target"),
        ("target=1,2,3", "eye"),
        ("fov_y=1", "eye"),
        ("eye=1,2&target=1,2,3", "eye"),
        ("eye=1,2,nan&target=1,2,3", "eye"),
        ("eye=1,2,3&target=1,2,3", "target"),
        ("eye=1,2,3&target=1,0,3", "up"),
        ("eye=1,2,3&target=1,2,4&fov_y=4", "fov_y"),
        ("width=0", "width"),
        ("width=-1", "width"),
        ("height=4097", "height"),
        ("spp=0", "spp"),
        ("spp=5000", "spp"),
        ("width=4096&height=4096&spp=64", "spp"),
        ("exposure=inf", "exposure"),
        ("scale=0", "scale"),
        ("since=1", "since"),
    ] {
        let detail = server.get(&format!("{path}?{query}")).await.problem(400, "invalid-query");
        assert!(detail.starts_with(&format!("{field}: ")), "{query}: {detail}");
    }
    for query in ["view=x", "format=bmp", "tone=filmic", "colour=1"] {
        server.get(&format!("{path}?{query}")).await.problem(400, "invalid-query");
    }
    server.get("/v1/scenes/s9-none/render").await.problem(404, "unknown-scene");
    // No light yet: black but there.
    let answer = server.get(&format!("{path}?width=8&height=8&view=indirect")).await;
    assert_eq!(answer.status, 200);
    server.stop().await;
}

#[tokio::test]
async fn a_client_that_leaves_takes_its_picture_with_it() {
    let server = Server::start().await;
    let scene = server.baked_room("?samples_per_element=4").await;
    let path = format!("{}/render", path_of(&scene));
    // Minutes of work, more of it than is drawn at the same time: if one stayed, the last request would wait for it.
    let large = format!("{path}?width=4096&height=4096&spp=16");
    let leaving = (0..3).map(|_| server.request(Method::GET, &large).timeout(Duration::from_millis(300)).send());
    for left in futures_util::future::join_all(leaving).await {
        assert!(left.unwrap_err().is_timeout());
    }
    // Nor does one that has seen the first of many.
    let progressive = server.request(Method::GET, &format!("{large}&progressive=true")).send().await.unwrap();
    drop(progressive);
    let small = server.request(Method::GET, &format!("{path}?width=8&height=8")).timeout(PATIENCE);
    assert_eq!(Answer::to(small).await.status, 200);
    server.stop().await;
}
