//! Light with less noise, for clients that ask for it.

use glam::Vec3;
use rebake_core::delta::Frame;
use serde_json::{Value, json};

use super::deltas::{Follower, open};
use super::parts::areas;
use super::server::{Answer, Server, path_of};

async fn light(server: &Server, scene: &Value, query: &str) -> (Answer, Vec<Vec3>) {
    let answer = server.get(&format!("{}/lightmap?format=raw&{query}", path_of(scene))).await;
    assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
    let values = Frame::decode(&answer.body).unwrap().0.values;
    (answer, values)
}

fn mean(values: &[Vec3], areas: &[f32], of: impl Fn(Vec3) -> f64) -> f64 {
    let sum: f64 = values.iter().zip(areas).map(|(value, area)| of(*value) * f64::from(*area)).sum();
    sum / areas.iter().map(|area| f64::from(*area)).sum::<f64>()
}

/// A room of a few thousand elements.
async fn fine_room(server: &Server) -> Value {
    let glb = super::glb::room().bytes();
    let scene = server.post_glb("/v1/scenes?spacing=0.12&samples_per_element=16", glb).await.json(201);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    server.get(&path_of(&scene)).await.json(200)
}

#[tokio::test]
async fn the_mean_stays_and_the_error_is_that_of_what_is_delivered() {
    let server = Server::start().await;
    let scene = fine_room(&server).await;
    let (_, stored) = light(&server, &scene, "filter=none").await;
    assert_eq!(light(&server, &scene, "").await.1, stored, "raw values are those that are stored");
    let (answer, filtered) = light(&server, &scene, "filter=statistical").await;
    let areas = areas(&server, &scene).await;
    let [before, after] = [&stored, &filtered].map(|values| mean(values, &areas, |v| f64::from(v.element_sum())));
    assert!((after / before - 1.0).abs() < 1e-4, "{before} {after}");
    let stated: f64 = answer.header("x-rebake-estimated-rmse").parse().unwrap();
    let as_stored = scene["estimated_rmse"].as_f64().unwrap();
    assert!(stated < 0.7 * as_stored, "{stated} of {as_stored}");
    let errors = light(&server, &scene, "filter=statistical&part=error").await.1;
    let rms = mean(&errors, &areas, |error| f64::from(error.x).powi(2)).sqrt();
    assert!((rms / stated - 1.0).abs() < 1e-3, "{rms} {stated}");
    let [direct, indirect] = ["direct", "indirect"].map(|part| format!("filter=statistical&part={part}"));
    let (direct, indirect) = (light(&server, &scene, &direct).await.1, light(&server, &scene, &indirect).await.1);
    let sums: Vec<Vec3> = direct.iter().zip(&indirect).map(|(a, b)| *a + *b).collect();
    assert_eq!(sums, filtered);
    server.stop().await;
}

#[tokio::test]
async fn what_people_look_at_is_filtered_where_nobody_says_otherwise() {
    let server = Server::start().await;
    let scene = fine_room(&server).await;
    for path in
        ["lightmap?format=glb&layout=vertices", "atlas/0?precision=float", "render?width=40&height=30&format=exr"]
    {
        let get = |filter: &str| format!("{}/{path}{filter}", path_of(&scene));
        let default = server.get(&get("")).await.body;
        assert!(default == server.get(&get("&filter=statistical")).await.body, "{path}");
        assert!(default != server.get(&get("&filter=none")).await.body, "{path}");
    }
    let refused = |query: &str| format!("{}/{query}", path_of(&scene));
    for query in [
        "lightmap?filter=bilateral",
        "lightmap/deltas?since=0&filter=",
        "atlas/0?filter=1",
        "lightmap?part=ao&filter=statistical",
    ] {
        server.get(&refused(query)).await.problem(400, "invalid-query");
    }
    let change = server.get(&refused("render?view=change&since=0&filter=statistical")).await;
    assert!(change.problem(400, "invalid-query").contains("filter"));
    server.stop().await;
}

#[tokio::test]
async fn deltas_of_filtered_light_add_up_to_it() {
    let server = Server::start().await;
    let scene = fine_room(&server).await;
    let mut follower = Follower::default();
    let mut stream = open(&server, &scene, "since=0&follow=true&filter=statistical").await;
    for edit in [
        json!({ "op": "material", "object": "cupboard", "albedo": [0.1, 0.5, 0.1] }),
        json!({ "op": "remove", "objects": ["cupboard"] }),
        json!({ "op": "relight", "lights": [{ "light": "lamp", "intensity": 3 }] }),
    ] {
        let version = server.get(&path_of(&scene)).await.json(200)["version"].as_u64().unwrap();
        follower.reach(&mut stream, version).await;
        assert_eq!(follower.map, light(&server, &scene, "filter=statistical").await.1);
        let job = server.edit(&scene, &edit).await;
        server.end_of(&job).await;
        // One that was away gets what changed.
        let delta =
            server.get(&format!("{}/lightmap/deltas?since={version}&filter=statistical", path_of(&scene))).await;
        let mut returned = Follower::default();
        (returned.map, returned.version) = (follower.map.clone(), version);
        assert!(returned.take(&delta.body));
        assert_eq!(returned.map, light(&server, &scene, "filter=statistical").await.1);
        let version = returned.version;
        let rest = server.get(&format!("{}/lightmap/deltas?since={version}&filter=statistical", path_of(&scene))).await;
        assert!(rest.body.is_empty(), "who is up to date gets nothing");
    }
    server.stop().await;
}

#[tokio::test]
async fn layers_are_filtered_with_the_weights_of_their_sum() {
    let server = Server::start().await;
    let scene = fine_room(&server).await;
    let relight = json!({ "op": "relight", "lights": [{ "light": "lamp", "intensity": 5 }] });
    server.end_of(&server.edit(&scene, &relight).await).await;
    let scene = server.get(&path_of(&scene)).await.json(200);
    let whole = light(&server, &scene, "filter=statistical").await.1;
    let mut sum = vec![Vec3::ZERO; whole.len()];
    for layer in scene["layers"].as_array().unwrap() {
        let name = layer["name"].as_str().unwrap();
        let weight: Vec<f32> = layer["weight"].as_array().unwrap().iter().map(|w| w.as_f64().unwrap() as f32).collect();
        let values = light(&server, &scene, &format!("filter=statistical&layer={name}")).await.1;
        sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += value * Vec3::from_slice(&weight));
    }
    for (sum, whole) in sum.iter().zip(&whole) {
        assert!((*sum - *whole).abs().max_element() <= 1e-4 * (1.0 + whole.max_element()), "{sum} {whole}");
    }
    server.stop().await;
}
