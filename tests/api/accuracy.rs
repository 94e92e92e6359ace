//! How accurate a light map is, as it is told when somebody asks.

use serde_json::{Value, json};

use super::durable::{fast_directory, start};
use super::engine::Step;
use super::glb::{self, translation};
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

#[tokio::test]
async fn both_errors_are_stated_while_light_is_computed() {
    let directory = fast_directory();
    let server = start(directory.path()).await;
    let upload = async |server: &Server, query: &str| {
        server.post_glb(&format!("/v1/scenes?spacing=1&{query}"), glb::room().bytes()).await.json(201)
    };
    let scene = upload(&server, "samples_per_element=8192").await;
    // Its noise may be told already.
    assert!(scene["light_error"]["resolution"].is_null(), "{scene}");
    let bake = server.end_of(scene["current_job"].as_str().unwrap()).await;
    let lit = server.get(&path_of(&scene)).await.json(200);
    let stated = &lit["light_error"];
    assert_eq!(stated["noise"], lit["estimated_rmse"]);
    assert_eq!(&bake["progress"]["light_error"], stated);
    assert_eq!(bake["warnings"], json!([]), "it had no target but samples");
    let [noise, resolution] = ["noise", "resolution"].map(|kind| stated[kind].as_f64().unwrap());
    assert!(noise > 0.0 && resolution > noise, "{stated}");
    // What is measured with many samples when it is asked for is about the same.
    let asked = server.get(&format!("{}/error", path_of(&scene))).await.json(200);
    let ratio = resolution / asked["error"]["resolution"].as_f64().unwrap();
    assert!((2.0 / 3.0..1.5).contains(&ratio), "{stated} {}", asked["error"]);
    for (object, asked) in lit["objects"].as_array().unwrap().iter().zip(asked["objects"].as_array().unwrap()) {
        assert_eq!(object["light_error"]["noise"], asked["error"]["noise"]);
    }
    assert!(lit["objects"][0]["light_error"]["resolution"].as_f64().is_some_and(|room| room > 0.0), "{lit}");
    let object = server.get(&format!("{}/objects/room?format=json", path_of(&scene))).await.json(200);
    assert_eq!(object["object"]["light_error"], lit["objects"][0]["light_error"]);
    server.stop().await;

    let server = start(directory.path()).await;
    let again = server.get(&path_of(&scene)).await.json(200);
    assert_eq!((&again["light_error"], &again["objects"]), (stated, &lit["objects"]));
    // One round of samples: of the new light nothing but a guess of its noise is known.
    let edit = json!({ "op": "remove", "objects": ["cupboard"], "budget": { "samples_per_element": 4 } });
    server.end_of(&server.edit(&scene, &edit).await).await;
    let edited = server.get(&path_of(&scene)).await.json(200);
    assert!(edited["light_error"]["resolution"].is_null(), "{edited}");
    // The same bake towards its own noise ends there, and tells that it is not all.
    let query = format!("samples_per_element=20000&target_rmse={}", 1.001 * noise);
    let job = server.end_of(upload(&server, &query).await["current_job"].as_str().unwrap()).await;
    assert_eq!(&job["progress"]["light_error"], stated, "{job}");
    let warning = job["warnings"][0].as_str().unwrap();
    assert!(warning.contains("error of resolution") && job["state"] == "succeeded", "{warning}");
    server.stop().await;
}

/// Inserts a crate into a room of its own; the edit's job, and the stated error after it over that before.
async fn crate_into_a_room(server: &Server, budget: Option<Value>) -> (Value, f64) {
    let path = "/v1/scenes?spacing=0.2&samples_per_element=32";
    let scene = server.post_glb(path, glb::room().bytes()).await.json(201);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    let stated =
        async || server.get(&path_of(&scene)).await.json(200)["light_error"]["noise"].as_f64().expect("it is known");
    let before = stated().await;
    let asset = server.crate_asset().await;
    let mut insert =
        json!({ "op": "insert", "asset": asset, "name": "crate", "transform": translation(2.0, 0.01, 2.0) });
    budget.into_iter().for_each(|budget| insert["budget"] = budget);
    let job = server.edit(&scene, &insert).await;
    let job = server.end_of(&job).await;
    assert_eq!(job["state"], "succeeded", "{job}");
    (job, stated().await / before)
}

#[tokio::test]
async fn an_edit_without_a_bound_ends_where_its_noise_is_not_seen() {
    let server = Server::start().await;
    let samples = |job: &Value| job["progress"]["samples_per_element"].as_u64().expect("a number");
    let rays = |job: &Value| job["progress"]["rays"].as_u64().expect("a number");
    let (explicit, _) = crate_into_a_room(&server, Some(json!({ "samples_per_element": 48 }))).await;
    assert_eq!(samples(&explicit), 48);
    for budget in [None, Some(json!({}))] {
        let (job, growth) = crate_into_a_room(&server, budget).await;
        assert!((8..48).contains(&samples(&job)), "{job}");
        assert!(3 * rays(&job) < 2 * rays(&explicit), "{job} {explicit}");
        assert!(growth < 1.05, "{growth}");
        assert_eq!(job["progress"]["fraction"], 1.0);
    }
    server.stop().await;
}
