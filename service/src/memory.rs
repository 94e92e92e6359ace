//! How much memory scenes may take, and how much one will, before it is built.

use std::sync::atomic::{AtomicU64, Ordering};

use rebake_core::surface::{DEFAULT_ELEMENTS, default_spacing, object_area};

use crate::engine::Scene;
use crate::state::App;

/// Elements per square of one spacing: it is the diagonals that must not exceed the spacing, so there are two to three.
const ELEMENTS_PER_SQUARE: f64 = 3.0;
/// Bytes of an element with its two triangles: geometry, trees, the light map and what is kept beside it.
const BYTES_PER_ELEMENT: f64 = 600.0;
/// Where the machine does not tell.
const UNKNOWN_MACHINE: u64 = 8 << 30;

/// Bytes that a scene will take, from its area and its vertices. Rather too much than too little.
pub(crate) fn estimate(scene: &Scene, spacing: Option<f32>) -> u64 {
    let area: f64 = scene.objects.iter().map(object_area).sum();
    let vertices: usize =
        scene.objects.iter().map(|object| object.mesh.positions.len().max(object.mesh.triangles.len())).sum();
    let spacing = f64::from(spacing.unwrap_or_else(|| default_spacing(area, DEFAULT_ELEMENTS)));
    let elements = vertices as f64 + ELEMENTS_PER_SQUARE * area / (spacing * spacing);
    // `as` saturates: what is beyond all bounds does not fit.
    (elements * BYTES_PER_ELEMENT) as u64
}

/// Three quarters of what the machine, or the container, has.
pub(crate) fn default_limit() -> u64 {
    let container = read_number("/sys/fs/cgroup/memory.max");
    let machine = std::fs::read_to_string("/proc/meminfo").ok().and_then(|text| {
        let line = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
        line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()
    });
    let bytes = machine.map(|kib| kib * 1024).into_iter().chain(container).min().unwrap_or(UNKNOWN_MACHINE);
    bytes / 4 * 3
}

fn read_number(path: &str) -> Option<u64> {
    std::fs::read_to_string(path).ok()?.trim().parse().ok()
}

/// Memory promised to a scene that is being built.
pub(crate) struct Promise<'a> {
    promised: &'a AtomicU64,
    bytes: u64,
}

impl Drop for Promise<'_> {
    fn drop(&mut self) {
        self.promised.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

impl App {
    /// Bytes that all scenes take.
    pub(crate) fn memory_in_use(&self) -> u64 {
        let of = |scene: &crate::store::scenes::SceneEntry| {
            let published = scene.published();
            (published.world.memory_bytes() + published.memory_bytes() + scene.earlier.memory_bytes()) as u64
        };
        self.scenes.all().iter().map(|scene| of(scene)).sum()
    }

    /// Promises `bytes` for a scene; the bytes that are free where that is too much.
    pub(crate) fn promise_memory(&self, bytes: u64) -> Result<Promise<'_>, u64> {
        let before = self.promised_memory.fetch_add(bytes, Ordering::Relaxed);
        let promise = Promise { promised: &self.promised_memory, bytes };
        let free = self.config.limits.memory_bytes.saturating_sub(self.memory_in_use() + before);
        if bytes > free { Err(free) } else { Ok(promise) }
    }
}
