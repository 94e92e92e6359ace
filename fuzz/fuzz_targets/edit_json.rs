//! Edit requests: any bytes are refused, or edits that a room takes or refuses.
#![no_main]

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use rebake::engine::{Scene, World};
use rebake_core::WorldOptions;
use rebake_core::scene::LoadLimits;

fn load(glb: &[u8]) -> Scene {
    rebake_core::scene::load(glb, &LoadLimits::default()).expect("a seed is a scene")
}

static ROOM: LazyLock<World> = LazyLock::new(|| {
    let limits = WorldOptions { max_elements: 5000, max_triangles: 10_000, ..WorldOptions::default() };
    let options = WorldOptions { spacing: Some(1.0), ..limits };
    World::new(load(include_bytes!("../seeds/gltf_upload/0.glb")), &options).expect("the room can be built")
});
static CRATE: LazyLock<Scene> = LazyLock::new(|| load(include_bytes!("../seeds/gltf_upload/1.glb")));

fuzz_target!(|data: &[u8]| {
    if let Ok(edits) = rebake::api::read_edits(data, [("00".to_owned(), CRATE.clone())], &ROOM) {
        let _ = ROOM.apply(&edits);
    }
});
