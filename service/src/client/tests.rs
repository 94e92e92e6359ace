//! The event parser, and the client against a scripted server: what comes over the wire is written out byte by byte.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use glam::Vec3;
use rebake_core::delta::Frame;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};

use super::types::{JobState, NewScene};
use super::*;

/// A server that answers each connection with the next of the given bytes and then closes it. Keeps the heads of the
/// requests it got.
async fn scripted(answers: Vec<Vec<u8>>) -> (Client, Arc<Mutex<Vec<String>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let client = Client::new(&format!("http://{}", listener.local_addr().unwrap())).unwrap();
    let requests = Arc::new(Mutex::new(Vec::new()));
    let seen = Arc::clone(&requests);
    tokio::spawn(async move {
        let mut answers = VecDeque::from(answers);
        while let Ok((mut stream, _)) = listener.accept().await {
            let head = read_head(&mut stream).await;
            seen.lock().unwrap().push(head);
            let Some(answer) = answers.pop_front() else { return };
            let _ = stream.write_all(&answer).await;
            let _ = stream.shutdown().await;
        }
    });
    (client, requests)
}

async fn read_head(stream: &mut TcpStream) -> String {
    let mut head = Vec::new();
    while !head.ends_with(b"\r\n\r\n") {
        match stream.read_u8().await {
            Ok(byte) => head.push(byte),
            Err(_) => break,
        }
    }
    String::from_utf8(head).unwrap()
}

/// An answer whose end is the end of the connection.
fn streamed(content_type: &str, body: &[u8]) -> Vec<u8> {
    let mut bytes =
        format!("HTTP/1.1 200 OK\r\ncontent-type: {content_type}\r\nconnection: close\r\n\r\n").into_bytes();
    bytes.extend_from_slice(body);
    bytes
}

/// A chunked answer that breaks off without its last chunk.
fn broken_off(body: &[u8]) -> Vec<u8> {
    let mut bytes = b"HTTP/1.1 200 OK\r\ntransfer-encoding: chunked\r\n\r\n".to_vec();
    bytes.extend(format!("{:x}\r\n", body.len()).bytes());
    bytes.extend_from_slice(body);
    bytes.extend_from_slice(b"\r\n");
    bytes
}

fn answer(status: &str, body: &str) -> Vec<u8> {
    format!("HTTP/1.1 {status}\r\ncontent-length: {}\r\nconnection: close\r\n\r\n{body}", body.len()).into_bytes()
}

fn quick() -> Retry {
    Retry { max_attempts: Some(3), first_wait: Duration::from_millis(1), longest_wait: Duration::from_millis(5) }
}

/// Maps of versions 1, 2, 3: they grow, and hold NaN and −0.
fn versions() -> [Vec<Vec3>; 3] {
    let one: Vec<Vec3> = (0..20).map(|i| Vec3::new(i as f32, f32::NAN, -0.0)).collect();
    let mut two = one.clone();
    two[3] = Vec3::ONE;
    two[17].z = 0.0;
    let mut three = two.clone();
    three[4] = Vec3::splat(f32::INFINITY);
    three.extend([Vec3::X; 5]);
    [one, two, three]
}

fn bits(map: &[Vec3]) -> Vec<[u32; 3]> {
    map.iter().map(|v| v.to_array().map(f32::to_bits)).collect()
}

fn encoded(frames: &[Frame]) -> Vec<u8> {
    frames.iter().flat_map(Frame::encode).collect()
}

#[tokio::test]
async fn a_follower_resumes_bit_for_bit_after_a_connection_lost_in_the_middle_of_a_frame() {
    let [one, two, three] = versions();
    let first = encoded(&Frame::whole(&one, 1).split(8));
    let second = encoded(&Frame::between(&one, &two, 1, 2).split(1));
    let third = encoded(&[Frame::between(&two, &three, 2, 3)]);
    // Version 1 arrives; of version 2 the first of two frames and half of the next. Then version 2 whole, and a cut in
    // the header of version 3. Then all that is missing.
    let cut = second.len() / 2 + 13;
    let (client, requests) = scripted(vec![
        broken_off(&[&first[..], &second[..cut]].concat()),
        streamed("application/vnd.rebake.delta", &[&second[..], &third[..17]].concat()),
        streamed("application/vnd.rebake.delta", &third),
    ])
    .await;
    let mut follower = client.follow("s/1").with_retry(quick());

    let update = follower.next().await.unwrap();
    assert_eq!((update.from, update.version, update.changed, update.replaced), (0, 1, 20, true));
    assert_eq!(update.bytes, first.len());
    assert_eq!(bits(follower.map()), bits(&one));

    let update = follower.next().await.unwrap();
    assert_eq!((update.from, update.version, update.changed), (1, 2, 2));
    assert_eq!(bits(follower.map()), bits(&two));

    let update = follower.next().await.unwrap();
    assert_eq!((update.version, update.changed), (3, 6));
    assert_eq!(bits(follower.map()), bits(&three));

    let lines: Vec<String> = requests.lock().unwrap().iter().map(|r| r.lines().next().unwrap().to_owned()).collect();
    let line = |since: u64| format!("GET /v1/scenes/s%2F1/lightmap/deltas?since={since}&follow=true HTTP/1.1");
    assert_eq!(lines, [line(0), line(1), line(2)]);
}

#[tokio::test]
async fn half_a_snapshot_changes_nothing() {
    let [one, two, _] = versions();
    let mut parts = Frame::between(&one, &two, 1, 2).split(1);
    parts.truncate(1);
    let (client, _) = scripted(vec![streamed("x", &encoded(&parts)); 9]).await;
    let mut follower = DeltaFollower::resume(client, "s", one.clone(), 1).with_retry(quick());
    assert!(matches!(follower.next().await, Err(ClientError::Lost { attempts: 3, .. })));
    assert_eq!(bits(follower.map()), bits(&one));
    assert_eq!(follower.version(), 1);
}

#[tokio::test]
async fn damage_and_gaps_are_repaired_by_a_new_connection() {
    let [one, two, three] = versions();
    let good = encoded(&[Frame::between(&one, &three, 1, 3)]);
    let mut damaged = good.clone();
    *damaged.last_mut().unwrap() ^= 1;
    let gap = encoded(&[Frame::between(&two, &three, 2, 3)]);
    let (client, _) = scripted([damaged, gap, good].map(|body| streamed("x", &body)).to_vec()).await;
    let mut follower = DeltaFollower::resume(client, "s", one, 1).with_retry(quick());
    follower.reach(3).await.unwrap();
    assert_eq!(bits(follower.map()), bits(&three));
}

#[tokio::test]
async fn catching_up_reads_all_versions_there_are_and_returns() {
    let [one, two, three] = versions();
    let frames = [
        Frame::whole(&one, 1),
        Frame::between(&one, &two, 1, 2),
        // Sent twice, as after a hiccup: no harm.
        Frame::between(&one, &two, 1, 2),
        Frame::between(&one, &three, 1, 3),
    ];
    let (client, requests) = scripted(vec![streamed("x", &encoded(&frames))]).await;
    let mut follower = client.follow("s");
    follower.catch_up().await.unwrap();
    assert_eq!((follower.version(), bits(follower.map())), (3, bits(&three)));
    assert!(!requests.lock().unwrap()[0].contains("follow"));
}

#[tokio::test]
async fn a_scene_that_is_gone_ends_the_follower_at_once() {
    let problem =
        r#"{"type":"https://rebake/problems/not-found","title":"Not found","status":404,"detail":"no scene x"}"#;
    let (client, requests) = scripted(vec![answer("404 Not Found", problem)]).await;
    let error = client.follow("x").with_retry(quick()).next().await.unwrap_err();
    assert_eq!(error.to_string(), "Not found (404): no scene x");
    assert_eq!(requests.lock().unwrap().len(), 1);
}

#[tokio::test]
async fn an_edit_carries_its_headers() {
    let job = r#"{"id":"j1","scene":"s","kind":"edit","state":"queued","progress":{"fraction":0.0,"more":1},"new":2}"#;
    let (client, requests) = scripted(vec![answer("202 Accepted", job)]).await;
    let options = EditOptions { idempotency_key: Some("k-1".to_owned()), if_match: Some(7) };
    let job = client.edit("s", &serde_json::json!({"op": "remove", "objects": ["sofa"]}), &options).await.unwrap();
    assert_eq!((job.id.as_str(), job.state), ("j1", JobState::Queued));
    let head = requests.lock().unwrap()[0].to_lowercase();
    assert!(head.starts_with("post /v1/scenes/s/edits http/1.1\r\n"), "{head}");
    assert!(head.contains("idempotency-key: k-1\r\n") && head.contains("if-match: \"7\"\r\n"), "{head}");
}

#[tokio::test]
async fn waiting_for_a_job_reports_every_state_and_ends_with_it() {
    let job = |state: &str| answer("200 OK", &format!(r#"{{"id":"j","scene":"s","kind":"bake","state":"{state}"}}"#));
    let events = streamed("text/event-stream", b"id: 4\ndata: {}\n\n");
    let (client, _) = scripted(vec![job("queued"), events, job("running"), job("failed")]).await;
    let mut seen = Vec::new();
    let ended = client.wait_for_job("j", |job| seen.push(job.state)).await.unwrap();
    assert_eq!(ended.state, JobState::Failed);
    assert_eq!(seen, [JobState::Queued, JobState::Running, JobState::Failed]);
}

#[tokio::test]
async fn a_service_that_is_not_there_is_named() {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    drop(listener);
    let error = Client::new(&format!("http://{address}")).unwrap().scene("s").await.unwrap_err();
    assert_eq!(error.to_string(), format!("cannot connect to http://{address} (is `rebake serve` running?)"));
}

#[test]
fn addresses_that_cannot_work_are_refused() {
    for server in ["https://host", "ftp://host", "localhost:1", "", "http://"] {
        assert!(matches!(Client::new(server), Err(ClientError::Server { .. })), "{server}");
    }
    let client = Client::new("http://host:1/prefix").unwrap();
    let url = client.request(Method::GET, &["v1", "jobs", "../x"], &[]).unwrap().build().unwrap().url().to_string();
    assert_eq!(url, "http://host:1/prefix/v1/jobs/..%2Fx");
}

#[test]
fn only_what_was_chosen_is_asked_for() {
    assert!(NewScene::default().query().is_empty());
    let new = NewScene { environment: Some([0.5, 1.0, 2.0]), spacing: Some(0.1), ..NewScene::default() };
    assert_eq!(new.query(), [("spacing", "0.1".to_owned()), ("environment", "0.5,1,2".to_owned())]);
}

#[test]
fn events_are_read_as_the_specification_says() {
    let stream = "\u{feff}: comment\nid: 1\nevent: progress\ndata: {\"a\":1}\n\n\
                  data: two\r\ndata:lines\r\n\r\nid\ndata\n\nevent: unused\n\ndata:  x: y\rretry: 5\r\rdata: not ended";
    let event = |id: Option<&str>, event: &str, data: &str| Event {
        id: id.map(str::to_owned),
        event: event.to_owned(),
        data: data.to_owned(),
    };
    let expected = [
        event(Some("1"), "progress", "{\"a\":1}"),
        event(Some("1"), "message", "two\nlines"),
        event(Some(""), "message", ""),
        event(Some(""), "message", " x: y"),
    ];
    for piece in [1, 2, 3, 7, 1000] {
        let mut parser = SseParser::new();
        for piece in stream.as_bytes().chunks(piece) {
            parser.push(piece).unwrap();
        }
        let events: Vec<Event> = std::iter::from_fn(|| parser.next_event()).collect();
        assert_eq!(events, expected, "in pieces of {piece}");
    }
}

#[test]
fn an_event_without_end_is_refused() {
    let mut parser = SseParser::new();
    let line = [b'x'; 4096];
    assert!((0..1000).any(|_| parser.push(&line).is_err()));
}
