//! What clients ask for and do not take in holds up nobody else.

use std::time::Duration;

use h2::client::{ResponseFuture, SendRequest};
use tokio::net::TcpStream;

use super::glb::room;
use super::server::{Server, path_of, patiently};

/// Longer than a test waits.
const NEVER: Duration = Duration::from_secs(600);

/// A connection of HTTP/2 whose streams take nothing in.
async fn without_window(server: &Server) -> SendRequest<&'static [u8]> {
    let address = server.base.trim_start_matches("http://");
    let stream = TcpStream::connect(address).await.unwrap();
    let (send, connection) = h2::client::Builder::new().initial_window_size(0).handshake(stream).await.unwrap();
    tokio::spawn(connection);
    send
}

async fn ask(send: &mut SendRequest<&'static [u8]>, server: &Server, path: &str) -> ResponseFuture {
    let request = http::Request::get(format!("{}{path}", server.base)).body(()).unwrap();
    *send = patiently(send.clone().ready()).await.unwrap();
    send.send_request(request, true).unwrap().0
}

/// Where a file of some 500 kB is.
async fn large_file(server: &Server) -> String {
    let scene = server.post_glb("/v1/scenes?spacing=0.1&samples_per_element=2", room().bytes()).await.json(201);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    format!("{}/lightmap?format=glb", path_of(&scene))
}

#[tokio::test]
async fn answers_that_nobody_takes_in_have_an_end() {
    // Room for one answer.
    let full = Server::with(|config| {
        config.limits.answer_bytes = 1;
        config.timeouts.answer_stall = NEVER;
        config.timeouts.answer_room = Duration::ZERO;
    })
    .await;
    let path = large_file(&full).await;
    let mut silent = without_window(&full).await;
    let held = patiently(ask(&mut silent, &full, &path).await).await.unwrap();
    assert_eq!(held.status(), 200);
    full.get(&path).await.problem(429, "too-many-answers");
    // What is short needs none.
    assert_eq!(full.get("/v1/scenes").await.status, 200);
    drop((held, silent));
    full.stop().await;
}

#[tokio::test]
async fn one_connection_takes_few_answers_at_a_time_and_stalled_ones_give_way() {
    let server = Server::with(|config| {
        config.limits.answer_bytes = 1;
        config.timeouts.answer_stall = Duration::ZERO;
        config.timeouts.answer_room = NEVER;
    })
    .await;
    let path = large_file(&server).await;
    let whole = server.get(&path).await.body;
    let mut silent = without_window(&server).await;
    let mut held = Vec::new();
    for _ in 0..4 {
        held.push(patiently(ask(&mut silent, &server, &path).await).await.unwrap());
    }
    let mut fifth = ask(&mut silent, &server, &path).await;
    // Everybody else is served while they lie.
    for _ in 0..4 {
        assert!(server.get(&path).await.body == whole);
    }
    let unanswered = tokio::time::timeout(Duration::ZERO, &mut fifth).await;
    assert!(unanswered.is_err(), "the fifth waits for its turn");
    drop(held);
    assert_eq!(patiently(fifth).await.unwrap().status(), 200, "and has it once others are gone");
    drop(silent);
    server.stop().await;
}
