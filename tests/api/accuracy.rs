//! How accurate a light map is, as it is told when somebody asks.

use serde_json::{Value, json};

use super::engine::Step;
use super::glb;
use super::server::{Server, path_of};

#[tokio::test]
async fn noise_falls_with_samples_and_the_error_of_resolution_with_the_spacing() {
    let server = Server::start().await;
    let told = async |spacing: f64, samples: u32| {
        let path = format!("/v1/scenes?samples_per_element={samples}&spacing={spacing}");
        let scene = server.post_glb(&path, glb::room().bytes()).await.json(201);
        server.end_of(scene["current_job"].as_str().unwrap()).await;
        let scene = server.get(&path_of(&scene)).await.json(200);
        let path = format!("{}/error", path_of(&scene));
        let answer = server.get(&path).await;
        assert_eq!(answer.header("x-rebake-version"), scene["version"].to_string());
        let told = answer.json(200);
        assert_eq!((&told["version"], &told["part"]), (&scene["version"], &json!("full")));
        assert_eq!(told["error"]["noise"], scene["estimated_rmse"]);
        let objects: Vec<&Value> = scene["objects"].as_array().unwrap().iter().map(|object| &object["name"]).collect();
        let measured = told["objects"].as_array().unwrap();
        assert_eq!(measured.iter().map(|object| &object["object"]).collect::<Vec<_>>(), objects);
        let points: u64 = measured.iter().map(|object| object["points"].as_u64().unwrap()).sum();
        assert_eq!(told["points"].as_u64().unwrap(), points);
        assert!(measured[0]["error"]["noise"].as_f64().unwrap() > 0.0, "{told}");
        // The same request has the same answer.
        assert_eq!(server.get(&path).await.json(200), told);
        ["noise", "resolution"].map(|kind| told["error"][kind].as_f64().unwrap())
    };
    let [coarse, noisy, fine] = [told(1.0, 64).await, told(1.0, 8).await, told(0.4, 64).await];
    assert!(noisy[0] > 1.5 * coarse[0], "{noisy:?} {coarse:?}");
    assert!((noisy[1] / coarse[1] - 1.0).abs() < 0.3, "noise is no resolution: {noisy:?} {coarse:?}");
    assert!(fine[1] < 0.7 * coarse[1], "{fine:?} {coarse:?}");
    server.stop().await;
}

#[tokio::test]
async fn what_is_not_known_is_null_and_what_cannot_be_is_refused() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("").await;
    let path = format!("{}/error", path_of(&scene));
    let told = server.get(&path).await.json(200);
    assert_eq!(told["error"], json!({ "noise": null, "resolution": null }));
    assert!(told["objects"].as_array().unwrap().iter().all(|object| object["error"] == told["error"]), "{told}");
    for (query, field) in [("points=31", "points"), ("points=1e3", "points"), ("samples=1", "samples"), ("x=1", "x")] {
        let told = server.get(&format!("{path}?{query}")).await.problem(400, "invalid-query");
        assert!(told.contains(field), "{told}");
    }
    script.run(&[Step::Round, Step::Finish]);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    server.stop().await;
}
