//! Light at points of a client's choice.

use serde_json::{Value, json};

use super::engine::Step;
use super::server::{Server, path_of};

fn light(sample: &Value) -> f64 {
    sample["light"][0].as_f64().unwrap()
}

#[tokio::test]
async fn points_get_the_light_of_their_place() {
    let server = Server::start().await;
    let scene = server.baked_room("?samples_per_element=64").await;
    let path = format!("{}/sample", path_of(&scene));
    // On the floor below the lamp, in the air above it, and inside the cupboard.
    let points = json!([[2, 0, 2, 0, 1, 0], [2, 1, 2, 0, 3, 0], [1, 0.7, 0.75, 0, 1, 0]]);
    let answer = server.post_json(&path, &json!({ "points": points })).await;
    let told = answer.json(200);
    assert_eq!(answer.header("x-rebake-version"), scene["version"].to_string());
    assert_eq!((&told["version"], &told["part"]), (&scene["version"], &json!("full")));
    let samples = told["points"].as_array().unwrap();
    assert!(light(&samples[1]) > light(&samples[0]) && light(&samples[0]) > 0.0 && light(&samples[2]) == 0.0, "{told}");
    assert!(samples[..2].iter().all(|sample| sample["error"].as_f64().unwrap() > 0.0));
    // The same request has the same answer; parts add up within their errors.
    assert_eq!(server.post_json(&path, &json!({ "points": points })).await.json(200), told);
    let part = async |part: &str| {
        let body = json!({ "points": points, "part": part, "samples": 1024 });
        server.post_json(&path, &body).await.json(200)["points"].clone()
    };
    let (direct, indirect) = (part("direct").await, part("indirect").await);
    for k in 0..2 {
        // One lamp without size: 20 cd at 2 m and at 1 m.
        let lamp = 20.0 / [4.0, 1.0][k] / std::f64::consts::PI;
        assert!((light(&direct[k]) / lamp - 1.0).abs() < 1e-4, "{direct}");
        let error = |sample: &Value| sample["error"].as_f64().unwrap();
        let sigma = error(&samples[k]).hypot(error(&indirect[k])).hypot(error(&direct[k]));
        let difference = light(&samples[k]) - light(&direct[k]) - light(&indirect[k]);
        assert!(difference.abs() < 6.0 * sigma, "{difference} {sigma}");
    }
    server.stop().await;
}

#[tokio::test]
async fn an_error_that_is_not_known_is_null() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("").await;
    let path = format!("{}/sample", path_of(&scene));
    let error = async |part: &str| {
        let body = json!({ "points": [[2, 1, 2, 1, 0, 0]], "part": part, "samples": 4 });
        server.post_json(&path, &body).await.json(200)["points"][0]["error"].clone()
    };
    assert_eq!((error("full").await, error("direct").await.is_number()), (Value::Null, true));
    script.run(&[Step::Round, Step::Finish]);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    assert!(error("full").await.is_number());
    server.stop().await;
}

#[tokio::test]
async fn points_that_make_no_sense_are_refused() {
    let server = Server::with(|config| config.limits.sample_points = 3).await;
    let scene = server.room("?bake=false").await;
    let path = format!("{}/sample", path_of(&scene));
    let up = [0, 1, 0, 0, 1, 0];
    for (body, field) in [
        (json!({}), "points"),
        (json!({ "points": [] }), "points"),
        (json!({ "points": vec![up; 4] }), "points"),
        (json!({ "points": [up, [0, 1, 0]] }), "points[1]"),
        (json!({ "points": [[0, 1, 0, 0, 0, 0]] }), "points[0]"),
        (json!({ "points": [[0, 1e300, 0, 0, 1, 0]] }), "points[0]"),
        (json!({ "points": [[0, 1, 0, 0, "up", 0]] }), "points[0][4]"),
        (json!({ "points": [up], "samples": 1 }), "samples"),
        (json!({ "points": [up], "samples": 100_000_000 }), "samples"),
        (json!({ "points": [up], "part": "error" }), "part"),
        (json!({ "points": [up], "colour": 1 }), "colour"),
    ] {
        let answer = server.post_json(&path, &body).await;
        let detail = answer.problem(422, "invalid-value");
        assert_eq!(answer.json(422)["field"], field, "{body}: {detail}");
    }
    server.post_text(&path, "{\"points\": [[1e999]]}", &[]).await.problem(400, "invalid-json");
    server.post_text("/v1/scenes/s9-zzzzzz/sample", "{}", &[]).await.problem(404, "unknown-scene");
    server.stop().await;
}
