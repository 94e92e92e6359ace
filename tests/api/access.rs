//! Who may do what, how much there may be, and what is told of it all.

use std::time::Duration;

use rebake::auth::Tokens;
use reqwest::Method;
use serde_json::json;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use super::engine::Step;
use super::glb::room;
use super::server::{Answer, Server, path_of, patiently};

const READ: &str = "0123456789abcdef-read";
pub(crate) const EDIT: &str = "0123456789abcdef-edit";
pub(crate) const ADMIN: &str = "0123456789abcdef-admin";

pub(crate) fn token_file() -> tempfile::NamedTempFile {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), format!("# test\n{READ} read\n{EDIT} read,edit\n{ADMIN} admin\n")).unwrap();
    file
}

async fn call(server: &Server, method: Method, path: &str, token: Option<&str>) -> Answer {
    let mut request = server.request(method.clone(), path);
    if let Some(token) = token {
        request = request.bearer_auth(token);
    }
    if method == Method::POST {
        request = request.header("content-type", "model/gltf-binary").body(room().bytes());
    }
    Answer::to(request).await
}

#[tokio::test]
async fn tokens_open_what_their_scopes_allow() {
    let file = token_file();
    let tokens = Tokens::read(file.path()).unwrap();
    let its_tokens = tokens.clone();
    let server = Server::with(|config| config.tokens = Some(its_tokens)).await;
    for path in ["/healthz", "/readyz", "/openapi.json"] {
        assert_eq!(call(&server, Method::GET, path, None).await.status, 200, "{path}");
    }
    for (token, challenge) in [(None, "Bearer realm=\"rebake\""), (Some("0123456789abcdef-none"), "invalid_token")] {
        for (method, path) in [(Method::GET, "/v1/scenes"), (Method::POST, "/v1/scenes"), (Method::GET, "/metrics")] {
            let refused = call(&server, method, path, token).await;
            refused.problem(401, "unauthorized");
            assert!(refused.header("www-authenticate").contains(challenge));
        }
    }
    assert_eq!(call(&server, Method::GET, "/v1/scenes", Some(READ)).await.status, 200);
    let refused = call(&server, Method::POST, "/v1/scenes", Some(READ)).await;
    refused.problem(403, "forbidden");
    assert!(refused.header("www-authenticate").contains("scope=\"edit\""));
    let scene = call(&server, Method::POST, "/v1/scenes?bake=false&spacing=1", Some(EDIT)).await.json(201);
    // What needs a token is not for caches that others share.
    let delta = call(&server, Method::GET, &format!("{}/lightmap/deltas/0-0", path_of(&scene)), Some(READ)).await;
    assert_eq!(delta.header("cache-control"), "private, max-age=31536000, immutable");
    call(&server, Method::DELETE, &path_of(&scene), Some(EDIT)).await.problem(403, "forbidden");
    let client = server.client.clone().with_token(ADMIN).unwrap();
    assert!(!format!("{client:?}").contains(ADMIN));
    client.delete_scene(scene["id"].as_str().unwrap()).await.unwrap();
    // Read again: what is gone is gone, what is broken changes nothing.
    std::fs::write(file.path(), format!("{EDIT} read\n")).unwrap();
    assert_eq!(tokens.reload().unwrap(), 1);
    call(&server, Method::GET, "/v1/scenes", Some(READ)).await.problem(401, "unauthorized");
    call(&server, Method::POST, "/v1/scenes", Some(EDIT)).await.problem(403, "forbidden");
    std::fs::write(file.path(), "broken").unwrap();
    tokens.reload().unwrap_err();
    assert_eq!(call(&server, Method::GET, "/v1/scenes", Some(EDIT)).await.status, 200);
    server.stop().await;
}

#[tokio::test]
async fn pages_of_other_origins_are_let_in_only_where_configured() {
    let ask = async |server: &Server, origin: &str| {
        let preflight = server
            .request(Method::OPTIONS, "/v1/scenes")
            .header("origin", origin)
            .header("access-control-request-method", "POST");
        let headers = preflight.send().await.unwrap().headers().clone();
        headers.get("access-control-allow-origin").map(|value| value.to_str().unwrap().to_owned())
    };
    let closed = Server::start().await;
    assert_eq!(ask(&closed, "http://studio.example").await, None);
    closed.stop().await;
    let file = token_file();
    let open = Server::with(|config| {
        config.cors_origins = vec!["http://studio.example".to_owned()];
        config.tokens = Some(Tokens::read(file.path()).unwrap());
    })
    .await;
    assert_eq!(ask(&open, "http://studio.example").await.as_deref(), Some("http://studio.example"));
    assert_eq!(ask(&open, "http://other.example").await, None);
    open.stop().await;
}

#[tokio::test]
async fn a_scene_that_would_not_fit_is_refused_before_it_is_built() {
    let server = Server::with(|config| config.limits.memory_bytes = 1 << 20).await;
    let small = server.room("?bake=false").await;
    assert!(small["memory_bytes"].as_u64().unwrap() < 1 << 20);
    server.post_glb("/v1/scenes?spacing=0.02", room().bytes()).await.problem(413, "scene-too-large");
    let mut refused = None;
    for _ in 0..50 {
        let answer = server.post_glb("/v1/scenes?spacing=0.5&bake=false", room().bytes()).await;
        if answer.status != 201 {
            refused = Some(answer);
            break;
        }
    }
    refused.expect("there is an end to it").problem(409, "no-memory");
    server.stop().await;
}

#[tokio::test]
async fn an_insert_that_would_not_fit_is_refused_before_it_is_built() {
    let server = Server::with(|config| config.limits.memory_bytes = 1 << 20).await;
    let asset = server.crate_asset().await;
    let scene = server.room("?bake=false").await;
    let path = format!("{}/edits", path_of(&scene));
    let insert = |name: String, size: f64| {
        let transform = [size, 0.0, 0.0, 0.0, 0.0, size, 0.0, 0.0, 0.0, 0.0, size, 0.0, 1.0, 0.01, 1.0, 1.0];
        json!({ "op": "insert", "asset": asset, "name": name, "transform": transform })
    };
    let told = server.post_json(&path, &insert("hall".to_owned(), 500.0)).await.problem(413, "scene-too-large");
    assert!(told.contains("the edited scene would take about"), "{told}");
    let mut refused = None;
    for n in 0..200 {
        let answer = server.post_json(&path, &insert(format!("crate {n}"), 4.0)).await;
        if answer.status != 202 {
            refused = Some(answer);
            break;
        }
        server.end_of(answer.json(202)["id"].as_str().unwrap()).await;
    }
    let refused = refused.expect("there is an end to it");
    assert!(
        ["/problems/no-memory", "/problems/scene-too-large"]
            .iter()
            .any(|kind| refused.json(refused.status.as_u16())["type"] == *kind),
        "{refused:?}"
    );
    // What takes nothing more is accepted all the same.
    server.edit(&scene, &json!({ "op": "remove", "objects": ["cupboard"] })).await;
    server.stop().await;
}

#[tokio::test]
async fn a_client_that_takes_nothing_in_is_let_go() {
    let (server, script) = Server::scripted_with(|config| {
        config.timeouts.write = Duration::from_millis(200);
        config.limits.streams = 1;
    })
    .await;
    let scene = server.post_glb("/v1/scenes?spacing=0.04&samples_per_element=4000", room().bytes()).await.json(201);
    let address = server.base.trim_start_matches("http://").to_owned();
    let mut stalled = TcpStream::connect(&address).await.unwrap();
    let path = format!("{}/lightmap/deltas?since=0&follow=true", path_of(&scene));
    stalled.write_all(format!("GET {path} HTTP/1.1\r\nhost: localhost\r\n\r\n").as_bytes()).await.unwrap();
    stalled.read_u8().await.unwrap();
    let other = format!("{}/lightmap/deltas?since=0", path_of(&scene));
    server.get(&other).await.problem(429, "too-many-streams");
    // Snapshots until the connection's buffers are full, and then until the service has had enough.
    let free = async {
        loop {
            script.run(&[Step::Round]);
            if server.get(&other).await.status == 200 {
                return;
            }
        }
    };
    patiently(free).await;
    server.stop().await;
}

#[tokio::test]
async fn metrics_tell_what_happens() {
    let server = Server::start().await;
    let scene = server.baked_room("?samples_per_element=4").await;
    server.get("/v1/scenes/nothing").await;
    server.post_json(&format!("{}/edits", path_of(&scene)), &json!({ "op": "nothing" })).await;
    let open = server.request(Method::GET, "/metrics").header("accept", "application/openmetrics-text; version=1.0.0");
    let open = Answer::to(open).await;
    assert!(open.status == 200 && open.header("content-type").starts_with("application/openmetrics-text"));
    let answer = server.get("/metrics").await;
    assert!(answer.status == 200 && answer.header("content-type").starts_with("text/plain; version=0.0.4"));
    let text = String::from_utf8(answer.body).unwrap();
    let id = scene["id"].as_str().unwrap();
    for line in [
        "rebake_jobs{state=\"succeeded\"} 1".to_owned(),
        "rebake_jobs{state=\"queued\"} 0".to_owned(),
        "rebake_jobs_ended_total{kind=\"bake\",state=\"succeeded\"} 1".to_owned(),
        "rebake_http_requests_total{method=\"GET\",route=\"/v1/scenes/{scene}\",status=\"404\"} 1".to_owned(),
        "rebake_http_requests_total{method=\"POST\",route=\"/v1/scenes/{scene}/edits\",status=\"422\"} 1".to_owned(),
        "rebake_scenes 1".to_owned(),
        "rebake_streams 0".to_owned(),
        format!("rebake_scene_version{{scene=\"{id}\"}} {}", scene["version"]),
        "# EOF".to_owned(),
    ] {
        assert!(text.lines().any(|found| found == line), "{line}\n{text}");
    }
    let rays = text.lines().find_map(|line| line.strip_prefix("rebake_rays_total ")).unwrap();
    assert!(rays.parse::<u64>().unwrap() > 1000);
    // Every ray belongs to a phase; in the first version all elements are new.
    let sum = |name: &str| -> f64 {
        let values = text.lines().filter_map(|line| line.strip_prefix(name)?.split_once(' '));
        values.map(|(_, value)| value.parse::<f64>().unwrap()).sum()
    };
    assert_eq!(sum("rebake_phase_rays_total{"), rays.parse::<f64>().unwrap());
    assert!(sum("rebake_phase_seconds_total{") > 0.0 && sum("rebake_elements_changed_total") > 10.0);
    assert_eq!(sum("rebake_job_wait_seconds_count"), 1.0);
    server.stop().await;
}
