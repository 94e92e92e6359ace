//! The API's description.

use serde_json::Value;

use super::server::Server;

/// `REBAKE_UPDATE=1 cargo test -p rebake-tests openapi` writes the file anew.
#[test]
fn the_document_on_disk_is_that_of_the_code() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../openapi/openapi.json");
    let mut document = serde_json::to_string_pretty(&rebake::api::document()).unwrap();
    document.push('\n');
    if std::env::var_os("REBAKE_UPDATE").is_some() {
        std::fs::write(path, &document).unwrap();
    }
    let on_disk = std::fs::read_to_string(path).unwrap_or_default();
    assert!(
        on_disk == document,
        "openapi/openapi.json is out of date: REBAKE_UPDATE=1 cargo test -p rebake-tests openapi"
    );
}

#[tokio::test]
async fn the_service_serves_it_and_every_reference_resolves() {
    let server = Server::start().await;
    let document = server.get("/openapi.json").await.json(200);
    server.stop().await;
    assert!(document["openapi"].as_str().unwrap().starts_with("3.1"));
    for path in
        ["/v1/scenes", "/v1/scenes/{scene}/edits", "/v1/scenes/{scene}/lightmap/deltas", "/v1/jobs/{job}/events"]
    {
        assert!(document["paths"][path].is_object(), "{path}");
    }
    let mut references = Vec::new();
    collect(&document, &mut references);
    assert!(references.len() > 20);
    for reference in references {
        let pointer = reference.strip_prefix('#').unwrap();
        assert!(document.pointer(pointer).is_some(), "{reference}");
    }
}

fn collect(value: &Value, references: &mut Vec<String>) {
    match value {
        Value::Object(fields) => {
            for (key, value) in fields {
                match value {
                    Value::String(text) if key == "$ref" => references.push(text.clone()),
                    value => collect(value, references),
                }
            }
        }
        Value::Array(list) => list.iter().for_each(|value| collect(value, references)),
        _ => {}
    }
}
