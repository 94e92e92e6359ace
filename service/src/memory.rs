//! How much memory scenes may take, and how much one will, before it is built.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rebake_core::edit::Cost;
use rebake_core::scene::Object;
use rebake_core::surface::object_area;

use crate::engine::{Density, Edit, Scene, Spread};
use crate::store::Store;
use crate::store::assets::Assets;
use crate::store::layers::LAYER_BYTES;
use crate::store::scene::SceneEntry;
use crate::store::scenes::Scenes;

/// Bytes of an element with its two triangles: geometry, trees, the light map and what is kept beside it.
const BYTES_PER_ELEMENT: f64 = 600.0;
/// Elements by light that are nowhere farther apart than a spacing, as a multiple of those at that spacing: at most.
const MORE_WITHIN: f64 = 1.6;
/// Where the machine does not tell.
const UNKNOWN_MACHINE: u64 = 8 << 30;

/// Bytes that a scene will take, from the areas of its objects (m²) and its vertices. Rather too much than too little.
pub(crate) fn estimate(density: Density, spread: Spread, areas: &[f64], vertices: usize) -> u64 {
    let more = if spread == Spread::ByLightWithin { MORE_WITHIN } else { 1.0 };
    to_bytes(more * density.elements(areas, vertices))
}

/// Bytes that what `edits` insert will take, at the size at which it is inserted.
pub(crate) fn estimate_inserts(edits: &[Edit], density: Density) -> u64 {
    let bytes = |edit: &Edit| {
        let Cost::Elements { asset, transform } = edit.cost() else { return 0 };
        let placed =
            |object: &Object| Object { world_from_object: *transform * object.world_from_object, ..object.clone() };
        // They become one object.
        let area: f64 = asset.objects.iter().map(|object| object_area(&placed(object))).sum();
        estimate(density, Spread::Uniform, &[area], vertices(asset))
    };
    edits.iter().map(bytes).fold(0, u64::saturating_add)
}

/// Bytes of an asset as it is held: geometry that objects share counts once.
pub(crate) fn of_asset(scene: &Scene) -> u64 {
    let mut meshes = std::collections::HashSet::new();
    let bytes = scene.objects.iter().map(|object| {
        let mesh = &object.mesh;
        let own = match meshes.insert(std::sync::Arc::as_ptr(mesh)) {
            true => {
                size_of_val(&*mesh.positions)
                    + size_of_val(&*mesh.normals)
                    + size_of_val(&*mesh.triangles)
                    + size_of_val(&*mesh.triangle_materials)
            }
            false => 0,
        };
        (own + size_of_val(object) + size_of_val(&*object.materials)) as u64
    });
    bytes.sum()
}

/// Bytes that layers of the light map will take, from the estimate of the scene they belong to.
pub(crate) fn estimate_layers(scene_bytes: u64, layers: usize) -> u64 {
    (scene_bytes as f64 / BYTES_PER_ELEMENT * LAYER_BYTES as f64 * layers as f64) as u64
}

/// Vertices of a scene, or its triangles where these are more.
pub(crate) fn vertices(scene: &Scene) -> usize {
    scene.objects.iter().map(|object| object.mesh.positions.len().max(object.mesh.triangles.len())).sum()
}

fn to_bytes(elements: f64) -> u64 {
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

impl Promise<'_> {
    /// Promises `more` bytes on top.
    fn add(&mut self, more: u64) {
        self.promised.fetch_add(more, Ordering::Relaxed);
        self.bytes += more;
    }
}

impl Drop for Promise<'_> {
    fn drop(&mut self) {
        self.promised.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

/// There is no memory for so much.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct NoRoom {
    /// What the scene would take.
    pub(crate) bytes: u64,
    /// What there is.
    pub(crate) free: u64,
    /// What all scenes together may take, where the scene alone is too much for that.
    pub(crate) limit: Option<u64>,
}

/// Memory that scenes and assets share.
pub(crate) struct Memory {
    limit: u64,
    /// Bytes of scenes that are being built.
    promised: AtomicU64,
    scenes: Arc<Scenes>,
    assets: Arc<Assets>,
    store: Arc<dyn Store>,
}

impl Memory {
    /// Room for `limit` bytes, taken by what these hold.
    pub(crate) fn new(limit: u64, scenes: Arc<Scenes>, assets: Arc<Assets>, store: Arc<dyn Store>) -> Memory {
        Memory { limit, promised: AtomicU64::new(0), scenes, assets, store }
    }

    /// Bytes that all scenes and assets take, with the files that are kept in memory and the edits that are accepted and
    /// not shown yet.
    pub(crate) fn in_use(&self) -> u64 {
        let of = |scene: &SceneEntry| {
            let published = scene.published();
            let world = (published.world.memory_bytes() as u64).max(scene.accepted().bytes);
            let light = published.memory_bytes() + scene.aside_bytes(&published) + scene.made_atlas.memory_bytes();
            world + light as u64 + scene.layers_to_come(&published)
        };
        self.scenes.all().iter().map(|scene| of(scene)).sum::<u64>()
            + self.assets.memory_bytes()
            + self.store.memory_bytes()
    }

    /// Promises `more` bytes for a scene that takes `present` already.
    pub(crate) fn promise(&self, more: u64, present: u64) -> Result<Promise<'_>, NoRoom> {
        let limit = self.limit;
        let bytes = present.saturating_add(more);
        if more > 0 && bytes > limit {
            return Err(NoRoom { bytes, free: limit.saturating_sub(self.in_use()), limit: Some(limit) });
        }
        let before = self.promised.fetch_add(more, Ordering::Relaxed);
        let promise = Promise { promised: &self.promised, bytes: more };
        let free = limit.saturating_sub(self.in_use() + before);
        // What takes nothing more always fits.
        if more > free { Err(NoRoom { bytes, free, limit: None }) } else { Ok(promise) }
    }

    /// Promises `more` bytes on top of what `promise` holds already.
    pub(crate) fn promise_more(&self, promise: &mut Promise<'_>, more: u64) -> Result<(), NoRoom> {
        // The new promise is dropped for the sum.
        let _more = self.promise(more, promise.bytes)?;
        promise.add(more);
        Ok(())
    }
}
