//! The description is valid, and says what the code takes.

use axum::extract::Query;
use axum::http::Uri;
use glam::{DVec3, Vec3};
use rebake_core::scene::{Light, LightKind, Material, Mesh, NodeSource, Object, Scene};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use super::super::{
    accuracy, atlas, atlas_deltas, deltas, edit_nodes, edit_parse, jobs, lightmap, objects, probes, render, sample,
    scenes, upload_query,
};
use super::document;

fn described() -> Value {
    serde_json::to_value(document()).unwrap()
}

/// Method, path and description of every operation.
fn operations(document: &Value) -> Vec<(String, Value)> {
    let paths = document["paths"].as_object().unwrap().values();
    let operations = paths.flat_map(|path| path.as_object().unwrap().values());
    operations.map(|operation| (operation["operationId"].as_str().unwrap().to_owned(), operation.clone())).collect()
}

/// The example of a media type and the values of its `examples`.
fn examples(content: &Value) -> Vec<Value> {
    let listed = content["examples"].as_object().into_iter().flat_map(|examples| examples.values());
    listed.map(|example| example["value"].clone()).chain(content.get("example").cloned()).collect()
}

fn reads<T: DeserializeOwned>(query: &str) -> Result<(), String> {
    let uri: Uri = format!("/?{query}").parse().map_err(|error| format!("{error}"))?;
    Query::<T>::try_from_uri(&uri).map(drop).map_err(|error| error.body_text())
}

/// Reads a query as the operation does.
fn read_query(operation: &str, query: &str) -> Result<(), String> {
    match operation {
        "create_scene" => reads::<upload_query::CreateQuery>(query),
        "list_scenes" | "list_assets" | "list_edits" | "list_objects" => reads::<scenes::ListQuery>(query),
        "list_jobs" => reads::<jobs::ListQuery>(query),
        "get_object" => reads::<objects::ObjectQuery>(query),
        "get_lightmap" => reads::<lightmap::LightmapQuery>(query),
        "get_deltas" => reads::<deltas::DeltaQuery>(&format!("since=0&{query}").replace("since=0&since", "since")),
        "get_atlas_deltas" => {
            reads::<atlas_deltas::TileQuery>(&format!("since=0&{query}").replace("since=0&since", "since"))
        }
        "get_atlas_delta_between" => reads::<atlas_deltas::TileBetweenQuery>(query),
        "get_atlas_page" => reads::<atlas::PageQuery>(query),
        "get_probes" => reads::<probes::ProbesQuery>(query),
        "get_error" => reads::<accuracy::ErrorQuery>(query),
        "render_scene" => reads::<render::RenderQuery>(query),
        _ => Err("this test does not know the operation".to_owned()),
    }
}

/// Reads a JSON body as the operation does.
fn read_body(operation: &str, body: &Value) -> Result<(), String> {
    let text = body.to_string();
    match operation {
        "create_edit" => {
            let named =
                edit_nodes::with_names(&text.into(), &scene_of_nodes()).map_err(|problem| problem.to_string())?;
            edit_parse::parse(&named, 8).map(drop).map_err(|problem| problem.to_string())
        }
        "patch_scene" => serde_json::from_str::<scenes::ScenePatch>(&text).map(drop).map_err(|error| error.to_string()),
        "sample_light" => {
            serde_json::from_str::<sample::SampleRequest>(&text).map(drop).map_err(|error| error.to_string())
        }
        "sample_probes" => {
            serde_json::from_str::<probes::ProbesRequest>(&text).map(drop).map_err(|error| error.to_string())
        }
        _ => Err("this test does not know the operation".to_owned()),
    }
}

/// One that has the nodes of the examples.
fn scene_of_nodes() -> Scene {
    let node = |index, id: &str| NodeSource { index, id: Some(id.into()) };
    let mesh = Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y);
    let mut object = Object::new("sofa", mesh, Material::diffuse(Vec3::ONE));
    object.node = Some(node(3, "sofa"));
    let kind = LightKind::Point { position: DVec3::ONE, range: None };
    let lamp = Light { name: "lamp".to_owned(), kind, color: Vec3::ONE, intensity: 1.0 };
    let mut scene = Scene::from_objects(vec![object]).with_light(lamp);
    scene.light_nodes.insert("lamp".to_owned(), node(4, "lamp-7f3a"));
    scene
}

#[test]
fn every_example_is_accepted_by_what_it_is_an_example_of() {
    let document = described();
    let (mut bodies, mut queries) = (0, 0);
    for (id, operation) in operations(&document) {
        let contents = operation["requestBody"]["content"].as_object().into_iter().flatten();
        for body in contents.filter(|(kind, _)| *kind == "application/json").flat_map(|(_, content)| examples(content))
        {
            read_body(&id, &body).unwrap_or_else(|reason| panic!("{id}: {body}: {reason}"));
            let schema = &operation["requestBody"]["content"]["application/json"]["schema"];
            fits(&document, schema, &body).unwrap_or_else(|reason| panic!("{id}: {body}: {reason}"));
            bodies += 1;
        }
        for parameter in operation["parameters"].as_array().into_iter().flatten() {
            let Some(example) = parameter.get("example") else { continue };
            fits(&document, &parameter["schema"], example).unwrap_or_else(|reason| panic!("{id}: {example}: {reason}"));
            if parameter["in"] != "query" {
                continue;
            }
            let text = example.as_str().map_or_else(|| example.to_string(), str::to_owned);
            let encoded: String = text.bytes().map(|byte| format!("%{byte:02X}")).collect();
            let query = format!("{}={encoded}", parameter["name"].as_str().unwrap());
            read_query(&id, &query).unwrap_or_else(|reason| panic!("{id}: {query}: {reason}"));
            queries += 1;
        }
    }
    assert!(bodies > 10 && queries > 10, "{bodies} bodies, {queries} parameters");
}

#[test]
fn every_example_of_a_field_fits_its_schema() {
    let document = described();
    let mut count = 0;
    for (name, schema) in document["components"]["schemas"].as_object().unwrap() {
        for (field, schema) in schema["properties"].as_object().into_iter().flatten() {
            let Some(example) = schema.get("example") else { continue };
            fits(&document, schema, example).unwrap_or_else(|reason| panic!("{name}.{field}: {example}: {reason}"));
            count += 1;
        }
    }
    assert!(count > 50, "{count} examples");
}

/// As much of JSON Schema as the description uses.
fn fits(document: &Value, schema: &Value, value: &Value) -> Result<(), String> {
    if let Some(reference) = schema["$ref"].as_str() {
        let target = document.pointer(reference.trim_start_matches('#')).ok_or_else(|| format!("no {reference}"))?;
        return fits(document, target, value);
    }
    if let Some(choices) = schema["oneOf"].as_array() {
        let results: Vec<_> = choices.iter().map(|choice| fits(document, choice, value)).collect();
        return match results.iter().filter(|result| result.is_ok()).count() {
            1 => Ok(()),
            count => Err(format!("{count} of its kinds fit: {results:?}")),
        };
    }
    let types: Vec<&str> = match &schema["type"] {
        Value::String(one) => vec![one],
        Value::Array(several) => several.iter().filter_map(Value::as_str).collect(),
        _ => Vec::new(),
    };
    if !types.is_empty() && !types.iter().any(|kind| is_a(value, kind)) {
        return Err(format!("{value} is none of {types:?}"));
    }
    if schema["enum"].as_array().is_some_and(|words| !words.contains(value)) {
        return Err(format!("{value} is none of {}", schema["enum"]));
    }
    let bound = |name: &str| schema[name].as_f64().zip(value.as_f64());
    if bound("minimum").is_some_and(|(least, x)| x < least) || bound("maximum").is_some_and(|(most, x)| x > most) {
        return Err(format!("{value} is out of bounds"));
    }
    for item in value.as_array().into_iter().flatten() {
        fits(document, &schema["items"], item)?;
    }
    let Some(fields) = value.as_object() else { return Ok(()) };
    let required = schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str);
    if let Some(missing) = required.into_iter().find(|name| !fields.contains_key(*name)) {
        return Err(format!("{missing} is missing"));
    }
    for (name, field) in fields {
        match schema["properties"].get(name) {
            Some(schema) => fits(document, schema, field)?,
            None if schema["additionalProperties"] == false => return Err(format!("{name} is not known")),
            None => {}
        }
    }
    Ok(())
}

fn is_a(value: &Value, kind: &str) -> bool {
    match kind {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "number" => value.is_number(),
        "integer" => value.is_u64() || value.is_i64(),
        "boolean" => value.is_boolean(),
        "null" => value.is_null(),
        _ => false,
    }
}

#[test]
fn edits_and_lights_are_told_apart_by_their_tags() {
    let document = described();
    let schemas = &document["components"]["schemas"];
    for (union, tag) in [("SingleEdit", "op"), ("NewLight", "kind")] {
        let discriminator = &schemas[union]["discriminator"];
        assert_eq!(discriminator["propertyName"], tag);
        let mapping = discriminator["mapping"].as_object().unwrap();
        assert_eq!(mapping.len(), schemas[union]["oneOf"].as_array().unwrap().len());
        for (word, reference) in mapping {
            let schema = document.pointer(reference.as_str().unwrap().trim_start_matches('#')).unwrap();
            assert_eq!(schema["properties"][tag]["enum"], json!([word]));
            assert_eq!((&schema["required"][0], &schema["additionalProperties"]), (&json!(tag), &json!(false)));
        }
    }
    let request = &schemas["EditRequest"];
    let undo = json!({ "op": "undo", "budget": null, "priority": "high" });
    fits(&document, request, &undo).unwrap();
    edit_parse::parse(undo.to_string().as_bytes(), 8).unwrap();
    for odd in [json!({ "op": "undo", "object": "sofa" }), json!({ "op": "jump" }), json!({ "objects": ["sofa"] })] {
        assert!(fits(&document, request, &odd).is_err(), "{odd}");
        assert!(edit_parse::parse(odd.to_string().as_bytes(), 8).is_err(), "{odd}");
    }
}

/// A derived schema takes a type named as one of its own words for any object.
#[test]
fn lists_say_what_they_hold() {
    let document = described();
    for (list, item) in [("Scene", "objects"), ("ObjectPage", "items"), ("JobPage", "items"), ("EditList", "edits")] {
        let items = &document["components"]["schemas"][list]["properties"][item]["items"];
        assert!(items["$ref"].is_string(), "{list}.{item}: {items}");
    }
    assert_eq!(document["components"]["schemas"]["SceneObject"]["properties"]["index"]["type"], "integer");
}

#[test]
fn every_operation_says_who_may_call_it_and_what_it_answers() {
    let document = described();
    assert!(document["servers"][0]["url"].is_string());
    let tags: Vec<&Value> = document["tags"].as_array().unwrap().iter().map(|tag| &tag["name"]).collect();
    let mut ids = std::collections::BTreeSet::new();
    for (id, operation) in operations(&document) {
        assert!(ids.insert(id.clone()), "{id} comes twice");
        assert!(operation["security"].is_array() && tags.contains(&&operation["tags"][0]), "{id}");
        let told = operation["responses"].to_string();
        let waits = told.contains("`scene-damaged`") && id != "scene_events";
        assert_eq!(told.contains("`scene-preparing`"), waits, "{id}");
        for (status, response) in operation["responses"].as_object().unwrap() {
            assert!(response["description"].as_str().is_some_and(|text| !text.is_empty()), "{id}: {status}");
            for (kind, content) in response["content"].as_object().into_iter().flatten() {
                let is_bytes = !kind.contains("json") && !kind.contains("text");
                assert_eq!(content["schema"]["format"] == "binary", is_bytes, "{id}: {kind}");
            }
        }
    }
    assert!(ids.len() > 25);
}
