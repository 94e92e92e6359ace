//! The Grafana dashboard asks for nothing that the service does not tell.

use std::collections::BTreeSet;

use serde_json::Value;

use super::server::Server;

/// Names of our metrics in a query.
fn names(query: &str) -> impl Iterator<Item = &str> {
    query.split(|c: char| !(c.is_ascii_alphanumeric() || c == '_')).filter(|word| word.starts_with("rebake_"))
}

#[tokio::test]
async fn every_metric_of_the_dashboard_exists() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docker/grafana/rebake.json");
    let dashboard: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let targets = dashboard["panels"].as_array().unwrap().iter().flat_map(|panel| panel["targets"].as_array().unwrap());
    let queries: Vec<&str> = targets.map(|target| target["expr"].as_str().unwrap()).collect();
    let asked: BTreeSet<&str> = queries.iter().flat_map(|query| names(query)).collect();
    assert!(queries.len() >= 15 && queries.iter().all(|query| names(query).next().is_some()), "{queries:?}");

    let server = Server::start().await;
    server.baked_room("?samples_per_element=4").await;
    server.get("/v1/scenes").await.json(200);
    let text = String::from_utf8(server.get("/metrics").await.body).unwrap();
    server.stop().await;
    let told: BTreeSet<&str> = text.lines().filter_map(|line| line.split(['{', ' ']).next()).collect();
    let missing: Vec<_> = asked.difference(&told).collect();
    assert!(missing.is_empty(), "{missing:?}\n{text}");
}
