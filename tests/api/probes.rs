//! Probes: the light around points.

use std::f64::consts::PI;

use serde_json::{Value, json};

use super::engine::Step;
use super::glb::translation;
use super::server::{Server, path_of};

fn coefficient(probe: &Value, k: usize) -> f64 {
    probe["coefficients"][k][0].as_f64().unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

fn list(told: &Value) -> &Vec<Value> {
    told["probes"].as_array().unwrap()
}

#[tokio::test]
async fn points_and_grids_have_probes() {
    let server = Server::start().await;
    let scene = server.baked_room("?samples_per_element=16").await;
    let path = format!("{}/probes", path_of(&scene));
    // In the air below the lamp, and inside the cupboard.
    let body = json!({ "points": [[2, 1, 2], [1, 0.7, 0.75]], "samples": 512 });
    let answer = server.post_json(&path, &body).await;
    let told = answer.json(200);
    assert_eq!(answer.header("x-rebake-version"), scene["version"].to_string());
    assert_eq!((&told["version"], &told["complete"], &told["grid"]), (&scene["version"], &json!(true), &Value::Null));
    let [air, solid] = &list(&told)[..] else { panic!("{told}") };
    assert_eq!((number(&air["validity"]), number(&solid["validity"])), (1.0, 0.0));
    assert_eq!(solid["coefficients"], json!(vec![[0.0; 3]; 9]));
    // One lamp without size, 20 cd at 1 m above: most of the light, and nearly all that comes from one side.
    let lamp = 20.0 * (3.0 / (4.0 * PI)).sqrt();
    assert!(coefficient(air, 0) > 20.0 / (4.0 * PI).sqrt(), "{air}");
    assert!((coefficient(air, 1) / lamp - 1.0).abs() < 0.2, "{air}");
    assert!(air["error"].as_array().unwrap().iter().all(|error| number(error) > 0.0 && number(error) < 0.2), "{air}");
    assert_eq!(
        (&air["version"], &air["index"], &air["position"]),
        (&told["version"], &json!(0), &json!([2.0, 1.0, 2.0]))
    );
    // The same request has the same answer, the query the same as the body.
    assert_eq!(server.post_json(&path, &body).await.json(200), told);
    assert_eq!(server.get(&format!("{path}?points=2,1,2;1,0.7,0.75&samples=512")).await.json(200), told);

    let answer = server.get(&format!("{path}?spacing=1.5&bounds=0,0,0,4,3,1&samples=16")).await;
    let told = answer.json(200);
    assert_eq!(told["grid"], json!({ "origin": [0.5, 0.75, 0.5], "spacing": 1.5, "counts": [3, 2, 1] }));
    let places: Vec<&Value> = list(&told).iter().map(|probe| &probe["position"]).collect();
    assert_eq!((places[1], places[3], places.len()), (&json!([2.0, 0.75, 0.5]), &json!([0.5, 2.25, 0.5]), 6));
    // Without bounds those of the scene; what the client has is not sent again.
    let tag = answer.header("etag").to_owned();
    let request = server.request(reqwest::Method::GET, &format!("{path}?spacing=1.5&samples=16"));
    let again = request.header("if-none-match", tag).send().await.unwrap();
    assert_eq!(again.status(), 304);
    let whole = server.get(&format!("{path}?spacing=1.5&samples=16")).await.json(200);
    let counts = whole["grid"]["counts"].as_array().unwrap();
    assert_eq!(counts.iter().map(number).product::<f64>(), list(&whole).len() as f64);
    assert!(list(&whole).iter().any(|probe| number(&probe["validity"]) == 1.0));
    server.stop().await;
}

/// An edit changes the probes near it, and those alone are told again; whoever applies what is told has what the
/// service tells.
#[tokio::test]
async fn after_an_edit_those_that_changed_come() {
    let server = Server::start().await;
    let asset = server.crate_asset().await;
    let scene = server.baked_room("?samples_per_element=64").await;
    let path = format!("{}/probes?spacing=0.8&bounds=0,0,0,4,2.6,4&samples=64", path_of(&scene));
    let told = async |since: u64| server.get(&format!("{path}&since={since}")).await.json(200);
    let first = told(0).await;
    let version = first["version"].as_u64().unwrap();
    assert_eq!((&first["complete"], list(&first).len()), (&json!(true), 100));
    assert_eq!(list(&told(version).await).len(), 0, "nothing has changed");
    // Off the lamp, in a corner.
    let insert = json!({ "op": "insert", "asset": asset, "name": "crate", "transform": translation(3.2, 0.01, 3.2) });
    server.end_of(&server.edit(&scene, &insert).await).await;
    let second = told(version).await;
    let now = second["version"].as_u64().unwrap();
    let changed: Vec<u64> = list(&second).iter().map(|probe| probe["index"].as_u64().unwrap()).collect();
    assert_eq!(second["complete"], false);
    assert!(now > version && !changed.is_empty() && changed.len() < 100, "{changed:?}");
    assert!(list(&second).iter().all(|probe| probe["version"] == now));
    // Nearest to the crate: the last of the lowest layer.
    let nearest = 4 + 5 * 4 * 4;
    assert!(changed.contains(&nearest), "{changed:?}");
    let mut held = list(&first).clone();
    for probe in list(&second) {
        held[probe["index"].as_u64().unwrap() as usize] = probe.clone();
    }
    let all = told(0).await;
    assert_eq!((&all["complete"], list(&all)), (&json!(true), &held), "deltas add up to the set");
    assert!(list(&told(now).await).is_empty());
    // Without `since` nothing is remembered and all is computed anew: within the errors of what was held.
    let fresh = server.get(&path).await.json(200);
    for (fresh, held) in list(&fresh).iter().zip(&held) {
        for k in 0..9 {
            let off = (coefficient(fresh, k) - coefficient(held, k)).abs();
            assert!(off <= number(&fresh["error"][k]) * 1.0001, "{fresh} {held}");
        }
    }
    server.get(&format!("{path}&since={}", now + 1)).await.problem(409, "version-ahead");
    // Another request is another set.
    let other = server.get(&format!("{path}&samples=32&since={now}").replace("&samples=64", "")).await.json(200);
    assert_eq!((&other["complete"], list(&other).len()), (&json!(true), 100));
    server.stop().await;
}

/// What is hidden neither hides light nor has a place in the grid.
#[tokio::test]
async fn hidden_objects_are_not_there() {
    let server = Server::start().await;
    let scene = server.baked_room("?samples_per_element=4").await;
    let path = format!("{}/probes", path_of(&scene));
    let inside = json!({ "points": [[1, 0.7, 0.75]], "samples": 64 });
    let hide = json!({ "op": "hide", "objects": ["cupboard"], "budget": { "samples_per_element": 4 } });
    server.end_of(&server.edit(&scene, &hide).await).await;
    let told = server.post_json(&path, &inside).await.json(200);
    assert_eq!(number(&told["probes"][0]["validity"]), 1.0, "{told}");
    assert!(coefficient(&told["probes"][0], 0) > 0.0);
    let hide = json!({ "op": "hide", "objects": ["room"], "budget": { "samples_per_element": 4 } });
    server.end_of(&server.edit(&scene, &hide).await).await;
    let answer = server.get(&format!("{path}?spacing=1")).await;
    answer.problem(400, "invalid-query");
    assert_eq!(answer.json(400)["field"], "bounds");
    server.stop().await;
}

#[tokio::test]
async fn an_error_that_is_not_known_is_null() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("").await;
    let path = format!("{}/probes?points=2,1,2&samples=4", path_of(&scene));
    assert_eq!(server.get(&path).await.json(200)["probes"][0]["error"], Value::Null);
    script.run(&[Step::Round, Step::Finish]);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    assert!(server.get(&path).await.json(200)["probes"][0]["error"].is_array());
    server.stop().await;
}

#[tokio::test]
async fn probes_that_make_no_sense_are_refused() {
    let server = Server::with(|config| config.limits.probes = 3).await;
    let scene = server.room("?bake=false").await;
    let path = format!("{}/probes", path_of(&scene));
    for (query, field) in [
        ("", "spacing"),
        ("spacing=0", "spacing"),
        ("spacing=inf", "spacing"),
        ("spacing=1e-300", "spacing"),
        ("spacing=1", "spacing"),
        ("spacing=1&points=0,0,0", "points"),
        ("points=", "points[0]"),
        ("points=0,1,2;0,1", "points[1]"),
        ("points=0,1,1e300", "points[0]"),
        ("points=0,1,nan", "points[0]"),
        ("points=nan,0,0", "points[0]"),
        ("points=0,0,0;0,0,0;0,0,0;0,0,0", "points"),
        ("points=0,0,0&bounds=0,0,0,1,1,1", "bounds"),
        ("spacing=9&bounds=0,0,0,1,1", "bounds"),
        ("spacing=9&bounds=2,0,0,1,1,1", "bounds"),
        ("spacing=9&bounds=0,0,0,1,1,1e99", "bounds"),
        ("points=0,0,0&samples=1", "samples"),
        ("points=0,0,0&samples=100000000", "samples"),
        ("points=0,0,0&since=-1", "since"),
    ] {
        let answer = server.get(&format!("{path}?{query}")).await;
        let detail = answer.problem(400, "invalid-query");
        assert_eq!(answer.json(400)["field"], field, "{query}: {detail}");
    }
    server.get(&format!("{path}?points=0,0,0&color=1")).await.problem(400, "invalid-query");
    for (body, field) in [
        (json!({}), "points"),
        (json!({ "points": [] }), "points"),
        (json!({ "points": vec![[0, 0, 0]; 4] }), "points"),
        (json!({ "points": [[0, 1]] }), "points[0]"),
        (json!({ "points": [[0, 1, 1e300]] }), "points[0]"),
        (json!({ "points": [[0, 1, 1]], "samples": 0 }), "samples"),
        (json!({ "points": [[0, 1, 1]], "spacing": 1 }), "spacing"),
    ] {
        let answer = server.post_json(&path, &body).await;
        let detail = answer.problem(422, "invalid-value");
        assert_eq!(answer.json(422)["field"], field, "{body}: {detail}");
    }
    server.get("/v1/scenes/s9-zzzzzz/probes?spacing=1").await.problem(404, "unknown-scene");
    server.stop().await;
}
