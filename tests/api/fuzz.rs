//! Bytes that a seeded generator has damaged: edits at a running service, deltas at the decoder. glTF files are damaged
//! in the same way beside their reader in `core`. The same files are the seeds of `fuzz/`.

use std::path::Path;

use glam::Vec3;
use rebake_core::delta::{Decoder, Frame, FrameFlags};
use serde_json::{Value, json};

use super::glb::{crate_asset, room, translation};
use super::server::{Server, path_of};

/// A small generator: the test needs variety, not quality.
struct Dice(u64);

impl Dice {
    fn roll(&mut self, sides: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % sides
    }

    /// A few bytes changed, doubled, swapped for a piece of another file, or cut off.
    fn damage(&mut self, bytes: &[u8], other: &[u8]) -> Vec<u8> {
        let mut bytes = bytes.to_vec();
        for _ in 0..=self.roll(3) {
            let at = self.roll(bytes.len().max(1)).min(bytes.len());
            let end = (at + 1 + self.roll(8)).min(bytes.len());
            match self.roll(5) {
                0 => bytes.truncate(at),
                1 => bytes[at..end].fill(self.roll(256) as u8),
                2 => drop(bytes.splice(at..end, *b"1e999")),
                3 => drop(bytes.splice(at..at, bytes[at..end].to_vec())),
                _ => {
                    let from = self.roll(other.len());
                    let to = (from + 1 + self.roll(30)).min(other.len());
                    drop(bytes.splice(at..end, other[from..to].to_vec()));
                }
            }
        }
        bytes
    }
}

fn edits() -> Vec<Vec<u8>> {
    let at = translation(1.0, 0.0, 0.0);
    let lamp = json!({ "kind": "point", "position": [1, 2, 1], "color": [1, 1, 1], "intensity": 4, "range": 3 });
    let edits: [Value; 12] = [
        json!({ "op": "insert", "asset": "00", "name": "a", "transform": at }),
        json!({ "op": "remove", "objects": ["no*", "room"] }),
        json!({ "op": "move", "object": "cupboard", "transform": at, "focus": { "camera": "view" },
            "tiles": { "size": 64, "samples": 16, "mode": "continuous" } }),
        json!({ "op": "material", "object": "room", "albedo": [0.1, 0.2, 0.3], "budget": { "max_seconds": 0.01 } }),
        json!({ "op": "relight", "lights": [{ "light": "lamp", "color": [1, 0.5, 0.5], "intensity": 30 }] }),
        json!({ "op": "insert_light", "name": "l", "light": lamp, "priority": "low" }),
        json!({ "op": "move_light", "light": "lamp", "position": [1, 2.5, 1],
            "focus": { "point": [0, 0, 0], "radius": 1 } }),
        json!({ "edits": [{ "op": "remove_light", "light": "lamp" }, { "op": "remove", "objects": ["cupboard"] }] }),
        json!({ "op": "sky", "radiance": [1, 1, 2], "strength": 0.5 }),
        json!({ "edits": [{ "op": "hide", "objects": ["cup*"] }, { "op": "show", "objects": ["cupboard", "*"] }] }),
        json!({ "op": "material", "object": "cupboard", "material": "wood", "albedo": [0.1, 0.2, 0.3] }),
        json!({ "op": "undo" }),
    ];
    edits.iter().map(|edit| edit.to_string().into_bytes()).collect()
}

#[tokio::test]
async fn damaged_edits_are_answered_and_break_nothing() {
    let (server, script) = Server::scripted().await;
    // Whatever is accepted is done at once.
    drop(script);
    let scene = server.room("?bake=false").await;
    let path = format!("{}/edits", path_of(&scene));
    let (corpus, mut dice) = (edits(), Dice(1));
    for round in 0..1500 {
        let (body, other) = (&corpus[dice.roll(corpus.len())], &corpus[dice.roll(corpus.len())]);
        let damaged = dice.damage(body, other);
        let request = server.request(reqwest::Method::POST, &path).header("content-type", "application/json");
        let response = request.body(damaged.clone()).send().await.unwrap();
        let status = response.status().as_u16();
        let told = response.text().await.unwrap();
        let body = String::from_utf8_lossy(&damaged);
        assert!([202, 400, 409, 422, 429].contains(&status), "round {round}: {status} {told}\n{body}");
        let told: Value = serde_json::from_str(&told).unwrap();
        assert!(status == 202 || !told["detail"].as_str().unwrap().is_empty(), "{body}");
    }
    server.get(&path_of(&scene)).await.json(200);
    server.stop().await;
}

fn deltas() -> [Vec<u8>; 3] {
    let values: Vec<Vec3> = (0..40u8).map(|n| Vec3::splat(f32::from(n))).collect();
    let whole = Frame::whole(&values, 7);
    let part = Frame::from_changed(&values, |slot| slot % 3 == 0, 7, 9);
    let half = Frame { flags: FrameFlags { half: true, ..part.flags }, ..part.clone() }.halved();
    [whole.encode(), part.encode(), half.encode()]
}

/// `REBAKE_UPDATE=1 cargo test -p rebake-tests seeds` writes them anew.
#[test]
fn the_seeds_of_the_fuzz_targets_are_those_of_the_tests() {
    let directory = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/seeds");
    let named = |target: &'static str, end: &'static str, files: Vec<Vec<u8>>| {
        files.into_iter().enumerate().map(move |(n, bytes)| (target, format!("{n}.{end}"), bytes))
    };
    let files = named("gltf_upload", "glb", vec![room().bytes(), crate_asset()])
        .chain(named("edit_json", "json", edits()))
        .chain(named("delta_decode", "rbkd", deltas().to_vec()));
    for (target, name, bytes) in files {
        let path = directory.join(target).join(name);
        if std::env::var_os("REBAKE_UPDATE").is_some() {
            std::fs::create_dir_all(directory.join(target)).unwrap();
            std::fs::write(&path, &bytes).unwrap();
        }
        let is_same = std::fs::read(&path).is_ok_and(|on_disk| on_disk == bytes);
        assert!(is_same, "{} is out of date: REBAKE_UPDATE=1 cargo test -p rebake-tests seeds", path.display());
    }
}

#[test]
fn damaged_deltas_are_refused_or_read_and_never_more_than_that() {
    let corpus = deltas();
    let mut dice = Dice(1);
    for _ in 0..20_000 {
        let (bytes, other) = (&corpus[dice.roll(3)], &corpus[dice.roll(3)]);
        let damaged = dice.damage(bytes, other);
        let mut decoder = Decoder::new();
        // Pieces of any size: frames do not come as they were sent.
        for piece in damaged.chunks(1 + dice.roll(damaged.len().max(1))) {
            decoder.push(piece);
            while let Ok(Some((frame, used))) = decoder.next_frame() {
                assert!(used <= damaged.len());
                frame.validate().unwrap();
                let mut map = Vec::new();
                // The length of the map is bounded by what the test allows, whatever the frame says.
                let _ = frame.apply_within(&mut map, 1000);
                assert!(map.len() <= 1000);
            }
        }
    }
}
