//! Deltas: whoever follows them has the light map, bit for bit.

use glam::Vec3;
use rebake_core::delta::{Decoder, Frame};
use reqwest::{Method, Response};
use serde_json::{Value, json};

use super::engine::Step;
use super::glb::translation;
use super::server::{Answer, Server, path_of, patiently};

/// A client that applies what it gets, snapshot by snapshot.
#[derive(Default)]
pub(crate) struct Follower {
    pub(crate) map: Vec<Vec3>,
    pub(crate) version: u64,
    decoder: Decoder,
    part: Vec<Frame>,
    frames: usize,
}

impl Follower {
    /// Takes bytes in; answers whether a snapshot was completed.
    pub(crate) fn take(&mut self, bytes: &[u8]) -> bool {
        self.decoder.push(bytes);
        let mut completed = false;
        while let Some((frame, _)) = self.decoder.next_frame().unwrap() {
            self.frames += 1;
            assert!(frame.base <= self.version || frame.flags.replace_all);
            let last = frame.flags.last;
            self.part.push(frame);
            if last {
                for frame in self.part.drain(..) {
                    frame.apply(&mut self.map).unwrap();
                    self.version = frame.new;
                }
                completed = true;
            }
        }
        completed
    }

    /// Reads a stream until the map is at `version`.
    pub(crate) async fn reach(&mut self, response: &mut Response, version: u64) {
        while self.version < version {
            let bytes = patiently(response.chunk()).await.unwrap().expect("the stream ended");
            self.take(&bytes);
        }
    }

    /// Drops what is not complete, as a lost connection does.
    fn disconnect(&mut self) {
        self.decoder = Decoder::new();
        self.part.clear();
    }

    pub(crate) fn bits(&self) -> Vec<[u32; 3]> {
        bits(&self.map)
    }
}

fn bits(map: &[Vec3]) -> Vec<[u32; 3]> {
    map.iter().map(|value| value.to_array().map(f32::to_bits)).collect()
}

/// What `format=raw` gives: version and values.
async fn raw(server: &Server, scene: &Value) -> (u64, Vec<[u32; 3]>) {
    let answer = server.get(&format!("{}/lightmap?format=raw", path_of(scene))).await;
    assert_eq!(answer.status, 200);
    let (frame, used) = Frame::decode(&answer.body).unwrap();
    assert!(frame.flags.last && frame.flags.replace_all && frame.base == 0 && used == answer.body.len());
    assert_eq!(answer.header("etag"), format!("\"{}\"", frame.new));
    let mut map = Vec::new();
    frame.apply(&mut map).unwrap();
    (frame.new, bits(&map))
}

pub(crate) async fn open(server: &Server, scene: &Value, query: &str) -> Response {
    let path = format!("{}/lightmap/deltas?{query}", path_of(scene));
    let response = server.request(Method::GET, &path).send().await.unwrap();
    assert_eq!(response.status(), 200);
    assert_eq!(response.headers()["content-type"], "application/vnd.rebake.delta");
    response
}

fn edits(asset: &str) -> [Value; 4] {
    [
        json!({ "op": "remove", "objects": ["cupboard"] }),
        json!({ "op": "insert", "asset": asset, "name": "a", "transform": translation(2.0, 0.01, 2.0) }),
        json!({ "op": "insert", "asset": asset, "name": "b", "transform": translation(1.0, 0.01, 2.0) }),
        json!({ "op": "move", "object": "a", "transform": translation(3.0, 0.01, 2.0) }),
    ]
}

#[tokio::test]
async fn a_follower_has_the_map_bit_for_bit_through_edits() {
    let (server, script) = Server::scripted().await;
    let asset = server.crate_asset().await;
    let scene = server.room("?mode=indirect").await;
    let mut follower = Follower::default();
    let mut stream = open(&server, &scene, "since=0&follow=true").await;
    // Before anything is published: as many zeros as there are elements.
    while !follower.take(&patiently(stream.chunk()).await.unwrap().unwrap()) {}
    assert_eq!((follower.version, follower.bits()), raw(&server, &scene).await);
    assert!(follower.map.iter().all(|value| *value == Vec3::ZERO) && !follower.map.is_empty());
    script.run(&[Step::Round, Step::Round, Step::Finish]);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    for edit in edits(&asset) {
        let job = server.edit(&scene, &edit).await;
        script.run(&[Step::Round, Step::Round, Step::Finish]);
        let job = server.end_of(&job).await;
        assert_eq!(job["state"], "succeeded");
        follower.reach(&mut stream, job["progress"]["version"].as_u64().unwrap()).await;
        let elements = server.get(&format!("{}/elements", path_of(&scene))).await;
        assert_eq!(elements.body.len(), 32 * follower.map.len(), "elements and map have the same length");
        assert_eq!((follower.version, follower.bits()), raw(&server, &scene).await);
    }
    server.stop().await;
}

#[tokio::test]
async fn a_client_that_was_away_catches_up_in_one_snapshot() {
    let (server, script) = Server::scripted().await;
    let asset = server.crate_asset().await;
    let scene = server.room("").await;
    script.run(&[Step::Round, Step::Finish]);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    let mut maps = Vec::new();
    for edit in edits(&asset) {
        let mut follower = Follower::default();
        follower.take(&server.get(&format!("{}/lightmap?format=raw", path_of(&scene))).await.body);
        maps.push(follower);
        let job = server.edit(&scene, &edit).await;
        script.run(&[Step::Round, Step::Finish]);
        server.end_of(&job).await;
    }
    let now = raw(&server, &scene).await;
    for mut follower in maps {
        let (version, frames) = (follower.version, follower.frames);
        let path = format!("{}/lightmap/deltas?since={version}", path_of(&scene));
        follower.take(&server.get(&path).await.body);
        assert_eq!((follower.version, follower.bits()), now, "from version {version}");
        assert_eq!(follower.frames, frames + 1, "one frame");
    }
    // Who is up to date gets nothing; a version of the future is a mistake.
    let path = format!("{}/lightmap/deltas", path_of(&scene));
    let none = server.get(&format!("{path}?since={}", now.0)).await;
    assert_eq!((none.status.as_u16(), none.body.len()), (200, 0));
    assert_eq!(none.header("x-rebake-version"), now.0.to_string());
    server.get(&format!("{path}?since={}", now.0 + 1)).await.problem(409, "version-ahead");
    server.get(&format!("{path}?since={}&follow=true", now.0 + 1)).await.problem(409, "version-ahead");
    server.get(&path).await.problem(400, "invalid-query");
    server.get(&format!("{path}?since=-1")).await.problem(400, "invalid-query");
    server.stop().await;
}

#[tokio::test]
async fn a_client_killed_in_the_middle_of_a_snapshot_goes_on_from_its_last_version() {
    // Frames of 16 values: every snapshot comes in many.
    let (server, script) = Server::scripted_with(|config| config.limits.frame_bytes = 16 * 12).await;
    let scene = server.room("").await;
    script.run(&[Step::Round, Step::Finish]);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    let mut follower = Follower::default();
    follower.take(&server.get(&format!("{}/lightmap/deltas?since=0", path_of(&scene))).await.body);
    assert!(follower.frames > 3 && follower.version == 1);
    let before = follower.bits();
    let edit = json!({ "op": "material", "object": "room", "albedo": [0.1, 0.2, 0.3] });
    let job = server.edit(&scene, &edit).await;
    script.run(&[Step::Round, Step::Finish]);
    server.end_of(&job).await;
    let delta = server.get(&format!("{}/lightmap/deltas?since=1", path_of(&scene))).await.body;
    for cut in [1, 39, 40, delta.len() / 3, delta.len() / 2, delta.len() - 1] {
        follower.take(&delta[..cut]);
        follower.disconnect();
        assert_eq!((follower.version, follower.bits()), (1, before.clone()), "a part of a snapshot is no version");
    }
    let mut stream = open(&server, &scene, "since=1&follow=true").await;
    let (version, map) = raw(&server, &scene).await;
    follower.reach(&mut stream, version).await;
    assert_eq!(follower.bits(), map);
    server.stop().await;
}

#[tokio::test]
async fn a_slow_client_holds_up_nothing_and_skips_versions() {
    let (server, script) = Server::scripted().await;
    let scene = server.post_glb("/v1/scenes?spacing=0.04&samples_per_element=4000", super::glb::room().bytes()).await;
    let scene = scene.json(201);
    let job = scene["current_job"].as_str().unwrap();
    // Opened, and not read: the connection's buffers fill up within a few snapshots.
    let mut stream = open(&server, &scene, "since=0&follow=true").await;
    const ROUNDS: u64 = 60;
    script.run(&[Step::Round; ROUNDS as usize]);
    server.until(job, |job| job["progress"]["version"] == ROUNDS).await;
    let mut follower = Follower::default();
    follower.reach(&mut stream, ROUNDS).await;
    assert!(follower.frames < ROUNDS as usize, "{} frames", follower.frames);
    assert_eq!((ROUNDS, follower.bits()), raw(&server, &scene).await);
    server.stop().await;
}

#[tokio::test]
async fn compressed_streams_arrive_frame_by_frame() {
    for coding in ["gzip", "zstd"] {
        let (server, script) = Server::scripted().await;
        let scene = server.room("").await;
        let path = format!("{}/lightmap/deltas?since=0&follow=true", path_of(&scene));
        let request = server.request(Method::GET, &path).header("accept-encoding", coding);
        let mut stream = request.send().await.unwrap();
        assert_eq!(stream.headers()["content-encoding"], coding);
        let (mut compressed, mut version) = (Vec::new(), 0);
        for _ in 0..3 {
            script.run(&[Step::Round]);
            version += 1;
            let mut follower = Follower::default();
            while follower.version < version {
                compressed.extend(patiently(stream.chunk()).await.unwrap().expect("the stream ended"));
                follower = Follower::default();
                follower.take(&unpack(coding, &compressed));
            }
            assert_eq!((version, follower.bits()), raw(&server, &scene).await);
        }
        script.run(&[Step::Finish]);
        server.end_of(scene["current_job"].as_str().unwrap()).await;
        server.delete(&path_of(&scene)).await;
        while let Some(bytes) = patiently(stream.chunk()).await.unwrap() {
            compressed.extend(bytes);
        }
        let mut plain = Vec::new();
        let end = match coding {
            "gzip" => std::io::copy(&mut flate2::read::GzDecoder::new(&compressed[..]), &mut plain),
            _ => zstd::stream::copy_decode(&compressed[..], &mut plain).map(|()| 0),
        };
        end.expect("a deleted scene ends the stream properly");
        server.stop().await;
    }
}

/// As much as can be read of a stream that goes on.
pub(super) fn unpack(coding: &str, compressed: &[u8]) -> Vec<u8> {
    use std::io::Read;
    let mut reader: Box<dyn Read> = match coding {
        "gzip" => Box::new(flate2::read::GzDecoder::new(compressed)),
        _ => Box::new(zstd::stream::read::Decoder::new(compressed).unwrap()),
    };
    let (mut plain, mut buffer) = (Vec::new(), [0; 4096]);
    while let Ok(read @ 1..) = reader.read(&mut buffer) {
        plain.extend_from_slice(&buffer[..read]);
    }
    plain
}

#[tokio::test]
async fn half_precision_halves_the_values() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("").await;
    script.run(&[Step::Round, Step::Finish]);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    let path = format!("{}/lightmap/deltas?since=0", path_of(&scene));
    let full = server.get(&path).await.body;
    let half = server.get(&format!("{path}&precision=half")).await.body;
    let ((full, _), (half, _)) = (Frame::decode(&full).unwrap(), Frame::decode(&half).unwrap());
    assert!(half.flags.half && half == full.halved());
    server.get(&format!("{path}&precision=double")).await.problem(400, "invalid-query");
    server.stop().await;
}

#[tokio::test]
async fn many_clients_of_several_scenes_lose_nothing() {
    let server = Server::start().await;
    let asset = server.crate_asset().await;
    let scenes = [server.room("?samples_per_element=4").await, server.room("?samples_per_element=4").await];
    let followers = scenes.iter().flat_map(|scene| [scene; 5]).map(async |scene| {
        let mut follower = Follower::default();
        let mut stream = open(&server, scene, "since=0&follow=true").await;
        // Two crates come in one edit each: the map is at its end when the last job has published.
        let edits = edits(&asset);
        while follower.version == 0 {
            follower.take(&patiently(stream.chunk()).await.unwrap().unwrap());
        }
        (follower, stream, edits.len())
    });
    let followers = futures_util::future::join_all(followers).await;
    let work = scenes.iter().map(async |scene| {
        let mut last = 0;
        for mut edit in edits(&asset) {
            edit["budget"] = json!({ "samples_per_element": 4 });
            let job = server.end_of(&server.edit(scene, &edit).await).await;
            assert_eq!(job["state"], "succeeded", "{job}");
            last = job["progress"]["version"].as_u64().unwrap();
        }
        last
    });
    let versions = futures_util::future::join_all(work).await;
    for (n, (mut follower, mut stream, _)) in followers.into_iter().enumerate() {
        follower.reach(&mut stream, versions[n / 5]).await;
        assert_eq!((follower.version, follower.bits()), raw(&server, &scenes[n / 5]).await);
    }
    let _: Answer = server.get("/healthz").await;
    server.stop().await;
}

/// The bytes of `…/deltas/{from}-{to}`, with what caches read.
async fn between(server: &Server, scene: &Value, versions: &str) -> Answer {
    server.get(&format!("{}/lightmap/deltas/{versions}", path_of(scene))).await
}

#[tokio::test]
async fn a_delta_between_two_versions_is_for_good() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("").await;
    let mut maps = vec![Follower::default()];
    let stated = |version: u64| (1.0 / (4 * version) as f32).to_string();
    for version in 1..=3_u64 {
        script.run(&[Step::Round]);
        server.client.follow(scene["id"].as_str().unwrap()).reach(version).await.unwrap();
        let mut now = Follower::default();
        now.take(&server.get(&format!("{}/lightmap?format=raw", path_of(&scene))).await.body);
        for from in 0..version {
            let mut follower = Follower::default();
            follower.map.clone_from(&maps[from as usize].map);
            follower.version = from;
            let answer = between(&server, &scene, &format!("{from}-{version}")).await;
            assert_eq!(answer.status, 200);
            assert!(follower.take(&answer.body));
            assert_eq!((follower.version, follower.bits()), (version, now.bits()), "{from}-{version}");
            assert_eq!(answer.header("cache-control"), "public, max-age=31536000, immutable");
            assert_eq!(answer.header("etag"), format!("\"{from}-{version}\""));
            assert_eq!(answer.header("x-rebake-version"), version.to_string());
            assert_eq!(answer.header("x-rebake-estimated-rmse"), stated(version));
        }
        maps.push(now);
    }
    // What was asked for once stays as it was.
    let mut follower = Follower { map: maps[1].map.clone(), version: 1, ..Follower::default() };
    let kept = between(&server, &scene, "1-2").await;
    assert_eq!(kept.header("x-rebake-estimated-rmse"), stated(2));
    follower.take(&kept.body);
    let newest = server.get(&format!("{}/lightmap/deltas?since=1", path_of(&scene))).await;
    assert_eq!(newest.header("x-rebake-estimated-rmse"), stated(3));
    assert_eq!((follower.version, follower.bits()), (2, maps[2].bits()));
    let nothing = between(&server, &scene, "2-2").await;
    assert_eq!((nothing.status.as_u16(), nothing.body.len()), (200, 0));
    server.stop().await;
}

#[tokio::test]
async fn a_delta_that_is_not_there_is_a_problem_that_no_cache_keeps() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("").await;
    script.run(&[Step::Round, Step::Round, Step::Round]);
    server.client.follow(scene["id"].as_str().unwrap()).reach(3).await.unwrap();
    for (versions, status, kind) in [
        ("2-4", 404, "unknown-version"),
        ("4-4", 404, "unknown-version"),
        ("1-2", 410, "version-forgotten"),
        ("2-1", 400, "bad-request"),
        ("01-2", 400, "bad-request"),
        ("+1-2", 400, "bad-request"),
        ("1-", 400, "bad-request"),
        ("x-2", 400, "bad-request"),
        ("1-2-3", 400, "bad-request"),
        ("1-99999999999999999999", 400, "bad-request"),
    ] {
        let answer = between(&server, &scene, versions).await;
        answer.problem(status, kind);
        assert_eq!(answer.header("cache-control"), "no-store", "{versions}");
    }
    server.stop().await;
}

#[tokio::test]
async fn each_coding_of_a_delta_has_a_tag_of_its_own() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("").await;
    script.run(&[Step::Round]);
    server.client.follow(scene["id"].as_str().unwrap()).reach(1).await.unwrap();
    let plain = between(&server, &scene, "0-1").await;
    let mut tags = vec![plain.header("etag").to_owned()];
    let path = format!("{}/lightmap/deltas/0-1", path_of(&scene));
    for coding in ["gzip", "zstd"] {
        let ask = |name: &str, value: &str| {
            server.request(Method::GET, &path).header("accept-encoding", coding).header(name, value)
        };
        let answer = Answer::to(ask("accept", "*/*")).await;
        assert_eq!((answer.header("content-encoding"), answer.header("vary")), (coding, "accept-encoding"));
        assert!(unpack(coding, &answer.body) == plain.body);
        tags.push(answer.header("etag").to_owned());
        let known = Answer::to(ask("if-none-match", answer.header("etag"))).await;
        assert_eq!(known.status, 304);
        assert_eq!(known.header("etag"), answer.header("etag"));
        let other = Answer::to(ask("if-none-match", plain.header("etag"))).await;
        assert_eq!(other.status, 200, "those bytes are others");
    }
    tags.dedup();
    assert_eq!(tags.len(), 3, "{tags:?}");
    server.stop().await;
}
