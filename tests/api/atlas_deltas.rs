//! Deltas of atlases: tiles that lead from pages to later ones, bit for bit.

use glam::Vec3;
use rebake_core::delta::{DeltaError, TileFrame, TilePage};
use reqwest::{Method, Response};
use serde_json::{Value, json};

use super::atlas::Page;
use super::durable::insert;
use super::engine::Step;
use super::glb::translation;
use super::server::{Answer, Server, path_of, patiently};

/// A client that applies what it gets, snapshot by snapshot.
#[derive(Clone, Default)]
struct Client {
    pages: Vec<TilePage>,
    version: u64,
    waiting: Vec<u8>,
    part: Vec<TileFrame>,
    tiles: usize,
    frames: usize,
}

impl Client {
    /// One that has loaded all pages as files.
    async fn loaded(server: &Server, scene: &Value, query: &str) -> Client {
        let told = server.get(&format!("{}/atlas", path_of(scene))).await.json(200);
        let mut client = Client { version: told["version"].as_u64().unwrap(), ..Client::default() };
        for index in 0..told["pages"].as_array().unwrap().len() {
            let answer = server.get(&format!("{}/atlas/{index}?{query}", path_of(scene))).await;
            assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
            assert_eq!(answer.header("x-rebake-version"), client.version.to_string());
            let Page { width, values, valid } = Page::of(&answer.body);
            client.pages.push(TilePage { size: [width as u32, (values.len() / width) as u32], values, valid });
        }
        client
    }

    fn take(&mut self, bytes: &[u8]) {
        self.waiting.extend_from_slice(bytes);
        loop {
            match TileFrame::decode(&self.waiting) {
                Ok((frame, used)) => {
                    self.waiting.drain(..used);
                    self.push(frame);
                }
                Err(DeltaError::Incomplete { .. }) => return,
                Err(error) => panic!("{error}"),
            }
        }
    }

    fn push(&mut self, frame: TileFrame) {
        assert!(frame.base == self.version || frame.flags.replace_all || !self.part.is_empty());
        (self.frames, self.tiles) = (self.frames + 1, self.tiles + frame.tiles.len());
        let last = frame.flags.last;
        self.part.push(frame);
        if last {
            for frame in self.part.drain(..) {
                frame.apply(&mut self.pages).unwrap();
                self.version = frame.new;
            }
        }
    }

    /// Asks for what is new, once.
    async fn catch_up(&mut self, server: &Server, scene: &Value, query: &str) -> Answer {
        let path = format!("{}/atlas/deltas?since={}&{query}", path_of(scene), self.version);
        let answer = server.get(&path).await;
        assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
        assert_eq!(answer.header("content-type"), "application/vnd.rebake.tiles");
        self.take(&answer.body);
        assert_eq!(answer.header("etag"), format!("\"{}\"", self.version));
        answer
    }

    async fn reach(&mut self, stream: &mut Response, version: u64) {
        while self.version < version {
            let bytes = patiently(stream.chunk()).await.unwrap().expect("the stream ended");
            self.take(&bytes);
        }
    }

    /// Drops what is not complete, as a lost connection does.
    fn disconnect(&mut self) {
        self.waiting.clear();
        self.part.clear();
    }

    fn assert_is(&self, other: &Client, what: &str) {
        assert_eq!(self.version, other.version, "{what}");
        assert!(self.pages == other.pages, "{what}: the pages differ");
    }
}

async fn open(server: &Server, scene: &Value, query: &str) -> Response {
    let path = format!("{}/atlas/deltas?follow=true&{query}", path_of(scene));
    let response = server.request(Method::GET, &path).send().await.unwrap();
    assert_eq!(response.status(), 200);
    assert_eq!(response.headers()["content-type"], "application/vnd.rebake.tiles");
    response
}

fn edits(asset: &str) -> Vec<Value> {
    let budget = json!({ "samples_per_element": 2 });
    let edits = [
        json!({ "op": "insert", "asset": asset, "name": "a", "transform": translation(2.0, 0.01, 2.0) }),
        json!({ "op": "move", "object": "a", "transform": translation(3.0, 0.01, 2.0) }),
        json!({ "op": "relight", "lights": [{ "light": "lamp", "color": [1, 0.5, 0.5], "intensity": 30 }] }),
        json!({ "op": "remove", "objects": ["a", "cupboard"] }),
        json!({ "op": "undo" }),
    ];
    let with_budget = |mut edit: Value| {
        edit["budget"] = budget.clone();
        edit
    };
    edits.into_iter().map(with_budget).collect()
}

#[tokio::test]
async fn tiles_lead_from_the_first_pages_to_the_last_bit_for_bit() {
    let server = Server::start().await;
    let asset = server.crate_asset().await;
    let scene = server.baked_room("?samples_per_element=2&texels_per_metre=12").await;
    let queries = ["", "precision=float", "part=direct&filter=none&precision=float", "part=error", "layer=indirect"];
    // One that asks after every edit, one that was away meanwhile, and one that goes through a cache.
    let mut clients = Vec::new();
    for query in queries {
        let first = Client::loaded(&server, &scene, query).await;
        clients.push([first.clone(), first.clone(), first]);
    }
    for edit in edits(&asset) {
        let job = server.end_of(&server.edit(&scene, &edit).await).await;
        assert_eq!(job["state"], "succeeded", "{job}");
        for (query, [near, _, cached]) in queries.iter().zip(&mut clients) {
            let now = Client::loaded(&server, &scene, query).await;
            let answer = near.catch_up(&server, &scene, query).await;
            near.assert_is(&now, &format!("{edit} {query}"));
            assert!(answer.headers.contains_key("x-rebake-estimated-rmse"), "{query}");
            let path = format!("{}/atlas/deltas/{}-{}?{query}", path_of(&scene), cached.version, now.version);
            cached.take(&server.get(&path).await.body);
            cached.assert_is(&now, &format!("{edit} {query}, cached"));
        }
    }
    for (query, [near, away, _]) in queries.iter().zip(&mut clients) {
        away.catch_up(&server, &scene, query).await;
        away.assert_is(near, query);
        assert!(near.tiles > 0 && away.tiles <= near.tiles, "{query}");
        let none = away.catch_up(&server, &scene, query).await;
        assert!(none.body.is_empty(), "who is up to date gets nothing");
        let mut new = Client::default();
        new.catch_up(&server, &scene, query).await;
        new.assert_is(near, &format!("{query}, from nothing"));
    }
    server.stop().await;
}

/// Light of a lamp in one room changes nothing in the other.
#[tokio::test]
async fn only_tiles_that_changed_are_sent() {
    let server = Server::start().await;
    let mut glb = super::glb::room();
    glb.cuboid("other", [10.0, 0.0, 0.0], [14.0, 3.0, 4.0], 0.7, true).point_light("far", [12.0, 2.0, 2.0], 20.0);
    let query = "spacing=0.5&samples_per_element=2&texels_per_metre=16";
    let scene = server.post_glb(&format!("/v1/scenes?{query}"), glb.bytes()).await.json(201);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    let mut client = Client::loaded(&server, &scene, "filter=none").await;
    let whole = server.get(&format!("{}/atlas/deltas?since=0&filter=none", path_of(&scene))).await.body.len();
    let edit = json!({ "op": "relight", "lights": [{ "light": "far", "intensity": 5 }],
        "budget": { "samples_per_element": 2 } });
    server.end_of(&server.edit(&scene, &edit).await).await;
    let answer = client.catch_up(&server, &scene, "filter=none").await;
    client.assert_is(&Client::loaded(&server, &scene, "filter=none").await, "relit");
    assert!(!answer.body.is_empty() && answer.body.len() * 10 < whole * 7, "{} of {whole} bytes", answer.body.len());
    // Nobody fetched these pages before: they come whole.
    let all = server.get(&format!("{}/atlas/deltas?since=1&filter=none&precision=float", path_of(&scene))).await;
    assert!(all.body.len() > whole);
    server.stop().await;
}

#[tokio::test]
async fn a_follower_goes_on_after_a_lost_connection() {
    // Frames of one tile: every snapshot comes in many.
    let (server, script) = Server::scripted_with(|config| config.limits.frame_bytes = 1).await;
    let asset = server.crate_asset().await;
    let scene = server.room("?texels_per_metre=20").await;
    let query = "precision=float";
    let (mut client, mut stream) = (Client::default(), open(&server, &scene, "since=0&precision=float").await);
    script.run(&[Step::Round, Step::Round, Step::Finish]);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    client.reach(&mut stream, 2).await;
    client.assert_is(&Client::loaded(&server, &scene, query).await, "baked");
    assert!(client.frames > 10, "{}", client.frames);
    drop(stream);
    let before = client.clone();
    let job = server.edit(&scene, &insert(&asset, "a")).await;
    script.run(&[Step::Round, Step::Finish]);
    let version = server.end_of(&job).await["progress"]["version"].as_u64().unwrap();
    let path = format!("{}/atlas/deltas?since={}&{query}", path_of(&scene), client.version);
    let delta = server.get(&path).await.body;
    for cut in [1, 39, 40, delta.len() / 3, delta.len() - 1] {
        client.take(&delta[..cut]);
        client.disconnect();
        client.assert_is(&before, "a part of a snapshot is no version");
    }
    let mut stream = open(&server, &scene, &format!("since={}&{query}", client.version)).await;
    client.reach(&mut stream, version).await;
    client.assert_is(&Client::loaded(&server, &scene, query).await, "resumed");
    // A deleted scene ends the stream properly.
    server.delete(&path_of(&scene)).await;
    while let Some(bytes) = patiently(stream.chunk()).await.unwrap() {
        client.take(&bytes);
    }
    server.stop().await;
}

#[tokio::test]
async fn streams_are_compressed_as_those_of_elements_are() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("?layout=atlas").await;
    script.run(&[Step::Round, Step::Finish]);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    let now = Client::loaded(&server, &scene, "").await;
    for coding in ["gzip", "zstd"] {
        for follow in ["false", "true"] {
            let path = format!("{}/atlas/deltas?since=0&follow={follow}", path_of(&scene));
            let request = server.request(Method::GET, &path).header("accept-encoding", coding);
            let mut stream = request.send().await.unwrap();
            assert_eq!(
                (&stream.headers()["content-encoding"], &stream.headers()["vary"]),
                (&coding.parse().unwrap(), &"accept-encoding".parse().unwrap())
            );
            let (mut compressed, mut client) = (Vec::new(), Client::default());
            while client.version < now.version {
                compressed.extend(patiently(stream.chunk()).await.unwrap().expect("the stream ended"));
                client = Client::default();
                client.take(&super::deltas::unpack(coding, &compressed));
            }
            client.assert_is(&now, coding);
        }
    }
    server.stop().await;
}

#[tokio::test]
async fn new_pages_are_told() {
    let server = Server::start().await;
    let mut asset = super::glb::Glb::default();
    asset.cuboid("crate", [0.0, 0.0, 0.0], [1.5, 1.5, 1.5], 0.4, false);
    let asset = server.post_glb("/v1/assets", asset.bytes()).await.json(201)["asset"].as_str().unwrap().to_owned();
    let scene = server.baked_room("?samples_per_element=1&texels_per_metre=12").await;
    let mut client = Client::loaded(&server, &scene, "").await;
    let first = client.pages.len();
    for name in 0..100 {
        let mut edit = insert(&asset, &name.to_string());
        edit["budget"]["samples_per_element"] = json!(1);
        server.end_of(&server.edit(&scene, &edit).await).await;
        let told = server.get(&format!("{}/atlas", path_of(&scene))).await.json(200);
        if told["pages"].as_array().unwrap().len() > first {
            break;
        }
    }
    client.catch_up(&server, &scene, "").await;
    assert!(client.pages.len() > first, "{first}");
    client.assert_is(&Client::loaded(&server, &scene, "").await, "grown");
    server.stop().await;
}

/// Of scenes without an atlas of their own, whose layer goes.
#[tokio::test]
async fn layers_are_followed_until_they_are_gone() {
    let server = Server::start().await;
    let asset = server.crate_asset().await;
    let scene = server.baked_room("?samples_per_element=2&layers=each").await;
    let query = "layer=lamp";
    let mut client = Client::loaded(&server, &scene, query).await;
    let mut stream = open(&server, &scene, &format!("since={}&{query}", client.version)).await;
    let job = server.end_of(&server.edit(&scene, &insert(&asset, "a")).await).await;
    client.reach(&mut stream, job["progress"]["version"].as_u64().unwrap()).await;
    client.assert_is(&Client::loaded(&server, &scene, query).await, "inserted");
    let mut remove = json!({ "op": "remove_light", "light": "lamp" });
    remove["budget"] = json!({ "samples_per_element": 2 });
    server.end_of(&server.edit(&scene, &remove).await).await;
    while let Some(bytes) = patiently(stream.chunk()).await.unwrap() {
        client.take(&bytes);
    }
    let gone = server.get(&format!("{}/atlas/deltas?since=1&{query}", path_of(&scene))).await;
    assert!(gone.problem(400, "invalid-query").starts_with("layer: "));
    server.stop().await;
}

#[tokio::test]
async fn a_delta_between_two_versions_is_for_good() {
    let (server, script) = Server::scripted().await;
    let scene = server.room("?texels_per_metre=8").await;
    let between = async |versions: &str| server.get(&format!("{}/atlas/deltas/{versions}", path_of(&scene))).await;
    let mut then = vec![Client::default()];
    for version in 1..=3_u64 {
        script.run(&[Step::Round]);
        server.client.follow(scene["id"].as_str().unwrap()).reach(version).await.unwrap();
        let now = Client::loaded(&server, &scene, "").await;
        for from in 0..version {
            let mut client = then[from as usize].clone();
            let answer = between(&format!("{from}-{version}")).await;
            client.take(&answer.body);
            client.assert_is(&now, &format!("{from}-{version}"));
            assert_eq!(answer.header("cache-control"), "public, max-age=31536000, immutable");
            assert_eq!(answer.header("etag"), format!("\"{from}-{version}\""));
            assert_eq!(answer.header("x-rebake-version"), version.to_string());
        }
        then.push(now);
    }
    let mut client = then[1].clone();
    client.take(&between("1-2").await.body);
    client.assert_is(&then[2], "what was asked for once stays as it was");
    assert!(between("2-2").await.body.is_empty());
    let path = format!("{}/atlas/deltas/1-2", path_of(&scene));
    let known = server.request(Method::GET, &path).header("if-none-match", "\"1-2\"").send().await.unwrap();
    assert_eq!(known.status(), 304);
    for (versions, status, kind) in [
        ("2-4", 404, "unknown-version"),
        ("1-2?precision=float", 410, "version-forgotten"),
        ("0-2", 410, "version-forgotten"),
        ("2-1", 400, "bad-request"),
        ("01-2", 400, "bad-request"),
        ("1-", 400, "bad-request"),
        ("1-99999999999999999999", 400, "bad-request"),
    ] {
        let answer = between(versions).await;
        answer.problem(status, kind);
        assert_eq!(answer.header("cache-control"), "no-store", "{versions}");
    }
    server.stop().await;
}

#[tokio::test]
async fn what_has_no_answer_is_refused_by_name() {
    let server = Server::start().await;
    let scene = server.post_glb("/v1/scenes?bake=false&layout=atlas", super::glb::room().bytes()).await.json(201);
    let version = server.get(&format!("{}/atlas", path_of(&scene))).await.json(200)["version"].as_u64().unwrap();
    let path = format!("{}/atlas/deltas", path_of(&scene));
    for (field, query) in [
        ("since", "since=-1"),
        ("since", "since=1.5"),
        ("since", "since=99999999999999999999"),
        ("since", ""),
        ("follow", "since=0&follow=maybe"),
        ("part", "since=0&part=ao"),
        ("part", "since=0&part=directional"),
        ("part", "since=0&part=nothing"),
        ("part", "since=0&part=direct&layer=full"),
        ("layer", "since=0&layer=all"),
        ("layer", "since=0&layer=sun"),
        ("filter", "since=0&filter=median"),
        ("precision", "since=0&precision=full"),
        ("format", "since=0&format=exr"),
        ("page", "since=0&page=0"),
    ] {
        for follow in ["", "&follow=true"] {
            let follow = if query.contains("follow") { "" } else { follow };
            let detail = server.get(&format!("{path}?{query}{follow}")).await.problem(400, "invalid-query");
            assert!(detail.contains(field), "{query}: {detail}");
        }
    }
    for query in ["part=ao", "layer=all", "since=1", "precision=full", "filter=x"] {
        let answer = server.get(&format!("{path}/0-{version}?{query}")).await;
        let detail = answer.problem(400, "invalid-query");
        assert!(detail.contains(query.split('=').next().unwrap()), "{query}: {detail}");
    }
    for follow in ["", "&follow=true"] {
        server.get(&format!("{path}?since={}{follow}", version + 1)).await.problem(409, "version-ahead");
    }
    server.get("/v1/scenes/s9-nothing/atlas/deltas?since=0").await.problem(404, "unknown-scene");
    // Before any light: pages of zeros, of which some texels are valid.
    let mut client = Client::default();
    client.catch_up(&server, &scene, "").await;
    client.assert_is(&Client::loaded(&server, &scene, "").await, "unlit");
    let texels = || client.pages.iter().flat_map(|page| page.values.iter().zip(&page.valid));
    assert!(texels().all(|(value, _)| *value == Vec3::ZERO) && texels().any(|(_, valid)| *valid));
    server.stop().await;
}
