//! Uploads: any bytes give a scene or an error.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rebake_core::scene::{LoadLimits, Original, load};
use rebake_core::{World, WorldOptions};

fuzz_target!(|data: &[u8]| {
    // Small, so that each try is quick.
    let limits = LoadLimits {
        max_bytes: 1 << 20,
        max_unpacked_bytes: 1 << 22,
        max_nodes: 1000,
        max_objects: 100,
        max_lights: 100,
        max_triangles: 2000,
        max_vertices: 10_000,
        max_texture_pixels: 1 << 16,
        max_total_texture_pixels: 1 << 18,
        ..LoadLimits::default()
    };
    if let Ok(scene) = load(data, &limits) {
        // It can be opened again, to be written back.
        Original::open(data, &limits).expect("an original");
        let most = WorldOptions { max_elements: 5000, max_triangles: 10_000, ..WorldOptions::default() };
        let options = WorldOptions { spacing: Some(1.0), ..most };
        let _ = World::new(scene, &options);
    }
});
