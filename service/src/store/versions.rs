//! Published light maps: immutable, shared, and versioned.
//!
//! Beside every value stands the version that last changed it, so the delta from any version is one pass over the
//! newest map, however old the client's map is: no history of maps is kept, and a client that slept for a hundred
//! versions gets one frame.

use std::sync::{Arc, OnceLock};

use glam::Vec3;
use rebake_core::delta::{Frame, same_bits};

use crate::engine::{LightMap, ObjectSummary, World, objects};

/// What the published values are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mode {
    /// Direct + indirect light.
    Full,
    /// Indirect light; the direct part is the client's.
    Indirect,
}

/// One part of a light map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Layer {
    Full,
    Direct,
    Indirect,
}

impl Layer {
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Layer::Full => "full",
            Layer::Direct => "direct",
            Layer::Indirect => "indirect",
        }
    }
}

impl Mode {
    pub(crate) fn layer(self) -> Layer {
        match self {
            Mode::Full => Layer::Full,
            Mode::Indirect => Layer::Indirect,
        }
    }
}

/// A light map with the world it belongs to. Everything that a client sees of one version comes from one of these.
pub(crate) struct Published {
    /// Grows by one with every publication.
    pub(crate) version: u64,
    /// Version at which the elements last changed.
    pub(crate) elements_version: u64,
    pub(crate) world: World,
    pub(crate) map: Arc<LightMap>,
    /// Of `world`; worked out when a client first asks, and kept as long as the world.
    objects: Arc<OnceLock<Vec<ObjectSummary>>>,
    /// Stated error: area-weighted RMSE, where it is known. Light that was carried over keeps the old one.
    pub(crate) estimated_rmse: Option<f32>,
    mode: Mode,
    /// Direct + indirect, where that is what is published.
    totals: Option<Vec<Vec3>>,
    /// Per slot: the version that last changed its value.
    changed: Vec<u64>,
}

impl Published {
    /// Version 0: no light.
    pub(crate) fn black(world: World, mode: Mode) -> Published {
        let slots = world.slots();
        Published {
            version: 0,
            elements_version: 0,
            world,
            map: Arc::new(LightMap::black(slots)),
            objects: Arc::default(),
            estimated_rmse: None,
            mode,
            totals: (mode == Mode::Full).then(|| vec![Vec3::ZERO; slots]),
            changed: vec![0; slots],
        }
    }

    /// The version after this one. `world` is given where it changed.
    pub(crate) fn next(&self, world: Option<World>, map: Arc<LightMap>, estimated_rmse: Option<f32>) -> Published {
        let version = self.version + 1;
        let elements_version = if world.is_some() { version } else { self.elements_version };
        let (world, objects) = match world {
            Some(world) => (world, Arc::default()),
            None => (self.world.clone(), self.objects.clone()),
        };
        assert_eq!(map.len(), world.slots(), "a light map has one value per slot");
        assert!(map.len() >= self.map.len(), "slots are never taken away");
        let totals = match self.mode {
            Mode::Full => Some(totals(&map)),
            Mode::Indirect => None,
        };
        let mut next = Published {
            version,
            elements_version,
            world,
            map,
            objects,
            estimated_rmse,
            mode: self.mode,
            totals,
            changed: Vec::new(),
        };
        let (old, new) = (self.values(), next.values());
        let since = |slot: usize| match old.get(slot) {
            Some(value) if same_bits(*value, new[slot]) => self.changed[slot],
            _ => version,
        };
        next.changed = (0..new.len()).map(since).collect();
        next
    }

    /// The objects of the world. The first call takes a moment in large scenes.
    pub(crate) fn objects(&self) -> &[ObjectSummary] {
        self.objects.get_or_init(|| objects(&self.world).collect())
    }

    /// Whether [`Published::objects`] answers at once.
    pub(crate) fn knows_objects(&self) -> bool {
        self.objects.get().is_some()
    }

    /// One value per slot, in the scene's mode.
    pub(crate) fn values(&self) -> &[Vec3] {
        self.totals.as_deref().unwrap_or(&self.map.indirect)
    }

    /// One value per slot of a layer.
    pub(crate) fn layer(&self, layer: Layer) -> std::borrow::Cow<'_, [Vec3]> {
        if layer == self.mode.layer() {
            return self.values().into();
        }
        match layer {
            Layer::Full => totals(&self.map).into(),
            Layer::Direct => self.map.direct.as_slice().into(),
            Layer::Indirect => self.map.indirect.as_slice().into(),
        }
    }

    /// What a client at version `since` lacks; everything where that is 0.
    pub(crate) fn delta(&self, since: u64) -> Frame {
        if since == 0 {
            return Frame::whole(self.values(), self.version);
        }
        Frame::from_changed(self.values(), |slot| self.changed[slot] > since, since, self.version)
    }

    /// Bytes of the map and what is kept beside it.
    pub(crate) fn memory_bytes(&self) -> usize {
        let vec3 = size_of::<Vec3>();
        let per_slot = 2 * vec3 + size_of::<f32>() + size_of::<u64>() + if self.totals.is_some() { vec3 } else { 0 };
        self.map.len() * per_slot
    }
}

fn totals(map: &LightMap) -> Vec<Vec3> {
    map.direct.iter().zip(&map.indirect).map(|(direct, indirect)| *direct + *indirect).collect()
}
