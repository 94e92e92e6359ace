//! Nobody is kept out by others, and nobody is let in under a foreign name.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, mpsc};
use std::time::Duration;

use rebake::auth::Tokens;
use rebake::faults::{Faults, WriteStep};
use reqwest::Method;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use super::access::{EDIT, token_file};
use super::durable::{fast_directory, start};
use super::glb::room;
use super::server::{Answer, Server, path_of, patiently};

/// Longer than a test waits.
const NEVER: Duration = Duration::from_secs(600);

fn address(server: &Server) -> &str {
    server.base.trim_start_matches("http://")
}

async fn connect(server: &Server, text: &str) -> TcpStream {
    let mut stream = TcpStream::connect(address(server)).await.unwrap();
    stream.write_all(text.as_bytes()).await.unwrap();
    stream
}

async fn to_end(mut stream: TcpStream) -> String {
    let mut answer = Vec::new();
    // The end may come as a reset.
    let _ = patiently(stream.read_to_end(&mut answer)).await;
    String::from_utf8_lossy(&answer).into_owned()
}

#[tokio::test]
async fn silent_connections_keep_nobody_out() {
    let server = Server::with(|config| {
        config.limits.connections = 8;
        config.timeouts.header = NEVER;
    })
    .await;
    let mut silent = Vec::new();
    for text in ["", "P", "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", "GET /healthz HTTP/1.1\r\nhost:"].repeat(4) {
        silent.push(connect(&server, text).await);
    }
    let asks = || connect(&server, "GET /healthz HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n");
    assert!(to_end(asks().await).await.contains("200 OK"));
    assert!(to_end(asks().await).await.contains("200 OK"));
    drop(silent);
    server.stop().await;
}

#[tokio::test]
async fn time_outs_cover_the_time_before_the_first_byte() {
    let server = Server::with(|config| config.timeouts.header = Duration::from_millis(100)).await;
    for text in ["", "P", "PRI * HTTP/2"] {
        assert_eq!(to_end(connect(&server, text).await).await, "");
    }
    server.stop().await;
}

#[tokio::test]
async fn idle_uploads_hold_no_place_and_are_let_go() {
    let server = Server::with(|config| {
        config.limits.concurrent_uploads = 1;
        config.timeouts.body = NEVER;
        config.timeouts.body_idle = NEVER;
    })
    .await;
    let head = "POST /v1/scenes HTTP/1.1\r\nhost: localhost\r\ncontent-type: model/gltf-binary\r\n";
    let mut idle = Vec::new();
    for path in ["scenes", "assets"] {
        let head = head.replace("scenes", path);
        idle.push(connect(&server, &format!("{head}content-length: 100000000\r\n\r\nglTF")).await);
    }
    server.room("?bake=false").await;
    server.crate_asset().await;
    drop(idle);
    server.stop().await;

    let server = Server::with(|config| config.timeouts.body_idle = Duration::from_millis(100)).await;
    let answer = to_end(connect(&server, &format!("{head}content-length: 100\r\nconnection: close\r\n\r\nglTF")).await);
    assert!(answer.await.contains("nothing of the body arrived"));
    server.stop().await;
}

#[tokio::test]
async fn what_has_arrived_of_an_upload_counts_as_memory() {
    let server = Server::with(|config| config.limits.memory_bytes = 1 << 20).await;
    let answer = server.post_glb("/v1/scenes", vec![0; 2 << 20]).await;
    answer.problem(413, "scene-too-large");
    server.room("?bake=false").await;
    server.stop().await;
}

#[tokio::test]
async fn a_refusal_is_heard_by_who_sends_first_and_reads_then() {
    let server = Server::start().await;
    let head = "POST /v1/scenes?nothing=1 HTTP/1.1\r\nhost: localhost\r\ncontent-type: model/gltf-binary\r\n";
    for close in ["connection: close\r\n", ""] {
        let body = vec![7; 3_000_000];
        let head = format!("{head}{close}content-length: {}\r\n\r\n", body.len());
        let mut stream = connect(&server, &head).await;
        // All of it, before a byte is read.
        patiently(stream.write_all(&body)).await.unwrap();
        if close.is_empty() {
            // The connection is as good as new.
            let next = b"GET /healthz HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n";
            stream.write_all(next).await.unwrap();
        }
        let answer = to_end(stream).await;
        assert!(answer.starts_with("HTTP/1.1 400") && answer.contains("/problems/invalid-query"), "{answer}");
        assert_eq!(answer.contains("200 OK"), close.is_empty(), "{answer}");
    }
    server.stop().await;
    // Not without end.
    let server = Server::with(|config| config.limits.drain_bytes = 1000).await;
    let mut stream = connect(&server, &format!("{head}content-length: 100000000\r\n\r\n")).await;
    let endless = async { while stream.write_all(&[7; 100_000]).await.is_ok() {} };
    patiently(endless).await;
    server.stop().await;
}

#[tokio::test]
async fn without_tokens_only_own_names_are_answered() {
    let ask = async |server: &Server, host: &str, token: Option<&str>| {
        let mut request = server.request(Method::GET, "/v1/scenes").header("host", host);
        if let Some(token) = token {
            request = request.bearer_auth(token);
        }
        Answer::to(request).await
    };
    let server = Server::with(|config| config.host_names = vec!["bake.studio".to_owned()]).await;
    for host in ["evil.example", "127.0.0.1.evil.example:80", "10.1.2.3"] {
        let told = ask(&server, host, None).await.problem(421, "foreign-host");
        assert!(told.contains("--host-name"), "{told}");
    }
    for host in ["localhost", "localhost:1234", "127.0.0.1", "[::1]:80", "bake.studio"] {
        ask(&server, host, None).await.json(200);
    }
    let absolute = "GET http://evil.example/v1/scenes HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n";
    assert!(to_end(connect(&server, absolute).await).await.contains("421"));
    server.stop().await;
    let file = token_file();
    let server = Server::with(|config| config.tokens = Some(Tokens::read(file.path()).unwrap())).await;
    ask(&server, "evil.example", None).await.problem(401, "unauthorized");
    ask(&server, "evil.example", Some(EDIT)).await.json(200);
    server.stop().await;
}

#[tokio::test]
async fn health_is_answered_while_scenes_are_brought_back() {
    let directory = fast_directory();
    let server = start(directory.path()).await;
    let scene = server.room("?bake=false").await;
    server.stop().await;

    let (go, wait) = mpsc::channel::<()>();
    let (begun, wait) = (AtomicUsize::new(0), Mutex::new(wait));
    // The first transaction begins the life, the second one is the scene's.
    let faults = Faults::new(move |step| {
        if step == WriteStep::Begin && begun.fetch_add(1, Ordering::SeqCst) == 1 {
            let _ = wait.lock().unwrap().recv();
        }
        Ok(())
    });
    let server = Server::with(|config| {
        config.data_dir = Some(directory.path().to_owned());
        config.faults = faults;
        config.timeouts.restore = Duration::ZERO;
    })
    .await;
    server.get("/healthz").await.json(200);
    let ready = server.get("/readyz").await;
    let told = ready.problem(503, "restoring");
    assert!(told.contains("0 scenes are back") && ready.header("retry-after") == "1", "{told}");
    let refused = server.get(&path_of(&scene)).await;
    refused.problem(503, "restoring");
    server.post_glb("/v1/scenes", room().bytes()).await.problem(503, "restoring");
    go.send(()).unwrap();
    patiently(async { while server.get("/readyz").await.status != 200 {} }).await;
    server.get(&path_of(&scene)).await.json(200);
    server.stop().await;
}
