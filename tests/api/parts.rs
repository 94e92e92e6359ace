//! Parts of a light map: direct and indirect light, and the standard error of each element.

use glam::Vec3;
use rebake_core::delta::Frame;
use reqwest::Method;
use serde_json::{Value, json};

use super::deltas::Follower;
use super::engine::Step;
use super::glb::translation;
use super::server::{Answer, Server, path_of};

/// Values of a part of the map as it is now.
async fn part(server: &Server, scene: &Value, query: &str) -> Vec<Vec3> {
    let answer = server.get(&format!("{}/lightmap?format=raw&{query}", path_of(scene))).await;
    assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
    Frame::decode(&answer.body).unwrap().0.values
}

/// Area of each element, m².
pub(crate) async fn areas(server: &Server, scene: &Value) -> Vec<f32> {
    let bytes = server.get(&format!("{}/elements", path_of(scene))).await.body;
    bytes.chunks_exact(32).map(|record| f32::from_le_bytes(record[24..28].try_into().unwrap())).collect()
}

/// Area-weighted root of the mean square.
fn rms(errors: &[Vec3], areas: &[f32]) -> f64 {
    let sum = errors.iter().zip(areas).map(|(error, area)| f64::from(error.x).powi(2) * f64::from(*area));
    (sum.sum::<f64>() / areas.iter().map(|area| f64::from(*area)).sum::<f64>()).sqrt()
}

fn is_near(a: f64, b: &Value) -> bool {
    (a / b.as_f64().unwrap() - 1.0).abs() < 1e-4
}

#[tokio::test]
async fn errors_of_elements_add_up_to_the_stated_one() {
    let server = Server::start().await;
    // One round, and several.
    for samples in [1, 16] {
        let scene = server.baked_room(&format!("?samples_per_element={samples}")).await;
        let (errors, areas) = (part(&server, &scene, "part=error").await, areas(&server, &scene).await);
        assert_eq!(errors.len(), areas.len());
        assert!(errors.iter().all(|error| error.is_finite() && *error == Vec3::splat(error.x)));
        assert!(errors.iter().filter(|error| error.x > 0.0).count() * 10 > errors.len() * 9);
        let stated = rms(&errors, &areas);
        assert!(is_near(stated, &scene["estimated_rmse"]), "{stated} {}", scene["estimated_rmse"]);
        let deltas = server.get(&format!("{}/lightmap/deltas?since=0&part=error", path_of(&scene))).await;
        assert_eq!(Frame::decode(&deltas.body).unwrap().0.values, errors);
        for (format, kind) in [("exr", "image/x-exr"), ("glb", "model/gltf-binary")] {
            let answer = server.get(&format!("{}/lightmap?format={format}&part=error", path_of(&scene))).await;
            assert_eq!((answer.status.as_u16(), answer.header("content-type")), (200, kind));
        }
    }
    server.stop().await;
}

#[tokio::test]
async fn parts_are_those_of_the_map() {
    let server = Server::start().await;
    let scene = server.baked_room("?mode=indirect&samples_per_element=4").await;
    let part = async |query: &str| part(&server, &scene, query).await;
    let (full, direct, indirect) = (part("part=full").await, part("part=direct").await, part("part=indirect").await);
    assert_eq!(indirect, part("").await);
    assert_eq!(direct, part("layer=direct").await);
    assert!(full.iter().zip(&direct).zip(&indirect).all(|((f, d), i)| *f == *d + *i) && direct != indirect);
    let path = format!("{}/lightmap", path_of(&scene));
    for query in ["part=nothing", "part=", "layer=full&part=error", "layer=all&part=direct&format=exr"] {
        server.get(&format!("{path}?{query}")).await.problem(400, "invalid-query");
    }
    server.get(&format!("{path}/deltas?since=0&part=half")).await.problem(400, "invalid-query");
    server.stop().await;
}

#[tokio::test]
async fn layers_have_errors_of_their_own() {
    let server = Server::start().await;
    let scene = server.baked_room("?layers=each&samples_per_element=4").await;
    let (whole, layer) =
        (part(&server, &scene, "part=error").await, part(&server, &scene, "layer=lamp&part=error").await);
    // The only lamp: its layer is the map at unit strength.
    let weight = scene["layers"][0]["weight"][0].as_f64().unwrap() as f32;
    let fits = |(whole, layer): (&Vec3, &Vec3)| (whole.x - weight * layer.x).abs() <= 1e-4 * whole.x;
    assert!(whole.iter().zip(&layer).all(fits) && layer.iter().any(|error| error.x > 0.0));
    let deltas = server.get(&format!("{}/lightmap/deltas?since=0&layer=lamp&part=error", path_of(&scene))).await;
    assert_eq!(Frame::decode(&deltas.body).unwrap().0.values, layer);
    server.stop().await;
}

/// Errors per element: how many are unknown, and whether the rest is known and above zero.
async fn unknown(server: &Server, scene: &Value) -> (Vec<usize>, bool) {
    let errors = part(server, scene, "part=error").await;
    let is_unknown = |slot: &usize| errors[*slot] == Vec3::INFINITY;
    let rest = (0..errors.len()).filter(|slot| !is_unknown(slot)).all(|slot| errors[slot].x > 0.0);
    ((0..errors.len()).filter(is_unknown).collect(), rest)
}

#[tokio::test]
async fn what_is_not_known_is_never_exact() {
    let (server, script) = Server::scripted().await;
    let asset = server.crate_asset().await;
    let scene = server.room("").await;
    let elements = scene["elements"].as_u64().unwrap() as usize;
    // Before the first round nothing is known of anything.
    assert_eq!(unknown(&server, &scene).await, ((0..elements).collect(), true));
    script.run(&[Step::Round, Step::Finish]);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    assert_eq!(unknown(&server, &scene).await, (Vec::new(), true));
    // What an edit brings is shown before it is lit.
    let insert = json!({ "op": "insert", "asset": asset, "name": "a", "transform": translation(2.0, 0.01, 2.0) });
    let job = server.edit(&scene, &insert).await;
    server.client.follow(scene["id"].as_str().unwrap()).reach(2).await.unwrap();
    let shown = server.get(&path_of(&scene)).await.json(200);
    let range = |scene: &Value, index: usize| {
        let range = &scene["objects"][index]["elements"];
        let first = range["first"].as_u64().unwrap() as usize;
        (first..first + range["count"].as_u64().unwrap() as usize).collect::<Vec<_>>()
    };
    assert_eq!(unknown(&server, &scene).await, (range(&shown, 2), true));
    // glTF has no infinity, and followers get the same as everybody.
    let glb = server.get(&format!("{}/lightmap?format=glb&part=error", path_of(&scene))).await;
    assert!(glb.status == 200 && glb.body.windows(4).any(|bytes| bytes == f32::MAX.to_le_bytes()));
    let path = format!("{}/lightmap/deltas?since=0&follow=true&part=error", path_of(&scene));
    let mut stream = server.request(Method::GET, &path).send().await.unwrap();
    let mut follower = Follower::default();
    follower.reach(&mut stream, 2).await;
    assert_eq!(follower.map, part(&server, &scene, "part=error").await);
    script.run(&[Step::Round]);
    follower.reach(&mut stream, 3).await;
    assert!(follower.map.iter().all(|error| error.is_finite()));
    assert_eq!(unknown(&server, &scene).await, (Vec::new(), true));
    script.run(&[Step::Finish]);
    server.end_of(&job).await;
    // What moves has light of another place.
    let moved = json!({ "op": "move", "object": "cupboard", "transform": translation(0.5, 0.0, 0.5) });
    server.edit(&scene, &moved).await;
    server.client.follow(scene["id"].as_str().unwrap()).reach(4).await.unwrap();
    assert_eq!(unknown(&server, &scene).await, (range(&shown, 1), true));
    let head = Answer::to(server.request(Method::GET, &path.replace("true", "false"))).await;
    assert_eq!(head.header("etag"), "\"4\"");
    server.stop().await;
}
