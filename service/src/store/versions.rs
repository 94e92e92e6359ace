//! Published light maps: immutable, shared, and versioned.
//!
//! Beside every value stands the version that last changed it, so the delta from any version is one pass over the
//! newest map, however old the client's map is: no history of maps is kept, and a client that slept for a hundred
//! versions gets one frame.

use std::borrow::Cow;
use std::sync::{Arc, OnceLock};

use glam::Vec3;
pub(crate) use rebake_core::LightPart;
use rebake_core::delta::{Frame, same_bits};

use super::layers::PublishedLayer;
use super::lighting::Effort;
pub(crate) use super::lineage::Lineage;
use super::records::{LightRecord, LightState, StoredResolution};
use crate::engine::{
    self, Canceled, LightMap, ObjectSummary, Observer, ResolutionError, VALUE_BYTES, World, layout_hash, objects,
};
use crate::mode::Mode;

/// Versions that are reserved for a scene at once. No version above the reserved ones is ever given, so after a crash
/// the next one is new even where the light of the last ones is lost.
pub(crate) const RESERVE: u64 = 1_000_000;

/// What a new scene reserves.
pub(crate) const FIRST_RESERVE: u64 = RESERVE;

/// What clients get of a light map, or of one of its layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Wanted {
    /// Some of its light.
    Light(LightPart),
    /// The standard error of each element, of the light that is the scene's mode.
    Error,
}

impl Wanted {
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Wanted::Light(LightPart::Full) => "full",
            Wanted::Light(LightPart::Direct) => "direct",
            Wanted::Light(LightPart::Indirect) => "indirect",
            Wanted::Error => "error",
        }
    }
}

/// Per slot: whether nothing is known of the light that it has. None where the light is that of the scene that is shown.
pub(crate) type Unknown = Option<Arc<[bool]>>;

/// Errors of light: irradiance / π, mean over RGB. None: not known.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Stated {
    /// Of chance.
    pub(crate) noise: Option<f32>,
    /// Of the distance between elements.
    pub(crate) resolution: Option<f32>,
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
    /// Error of the light as it was computed: area-weighted RMSE, where it is known. Light that was carried over keeps the
    /// old one, which says nothing of the scene that is shown.
    pub(crate) estimated_rmse: Option<f32>,
    /// Its error of resolution as far as it was measured; of light that was carried over nothing is known.
    pub(crate) resolution: Option<Arc<ResolutionError>>,
    /// Stated error of each object, in the order of the world; worked out when a client first asks.
    noise_of_objects: OnceLock<Vec<Option<f32>>>,
    /// Of light that was carried over: elements that came, or moved, after it was computed.
    unknown: Unknown,
    mode: Mode,
    /// What is delivered in the scene's mode.
    delivered: Vec<Vec3>,
    /// The layers of the map, in its order.
    pub(crate) layers: Vec<PublishedLayer>,
    /// Per slot: the version that last changed its value.
    pub(crate) changed: Arc<[u64]>,
    lineage: Arc<Lineage>,
    /// Its noise is averaged away where it may be.
    pub(crate) is_filtered: bool,
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
            resolution: None,
            noise_of_objects: OnceLock::new(),
            unknown: None,
            mode,
            delivered: vec![Vec3::ZERO; slots],
            layers: Vec::new(),
            changed: vec![0; slots].into(),
            lineage: Arc::default(),
            is_filtered: false,
        }
    }

    /// Version 1, behind the empty version 0 of a scene that was being prepared: no light.
    pub(crate) fn laid_out(world: World, mode: Mode) -> Published {
        let black = Published::black(world, mode);
        Published { version: 1, elements_version: 1, changed: vec![1; black.map.len()].into(), ..black }
    }

    /// What was saved, in a new life. `reserved`: no version above it was ever given.
    pub(crate) fn restored(world: World, mode: Mode, light: LightRecord, unknown: Unknown, reserved: u64) -> Published {
        let LightRecord { about: state, map, changed, .. } = light;
        let LightState { mut version, elements_version, estimated_rmse, resolution, mut lineage, weights, .. } = state;
        if reserved > version {
            // Clients may have versions that are lost. Where their version is not a part of what led to the new one,
            // they get everything.
            lineage.lose(version, reserved + 1);
            version = reserved + 1;
        }
        let weights: Vec<Vec3> = weights.iter().map(|bits| Vec3::from(bits.map(f32::from_bits))).collect();
        let objects_of_world = world.scene.objects.len();
        Published {
            version,
            elements_version,
            delivered: world.delivered(&map, mode.part()),
            world,
            objects: Arc::default(),
            estimated_rmse,
            resolution: resolution.and_then(|kept| kept.of_objects(objects_of_world)).map(Arc::new),
            noise_of_objects: OnceLock::new(),
            unknown,
            mode,
            layers: PublishedLayer::first(&map, &weights, version),
            changed,
            lineage: Arc::new(lineage),
            map,
            is_filtered: false,
        }
    }

    /// No light after a life whose light is lost or fits no more: clients get everything.
    pub(crate) fn lost(world: World, mode: Mode, reserved: u64) -> Published {
        let black = Published::black(world, mode);
        let version = reserved + 1;
        let mut lineage = Lineage::default();
        lineage.lose(0, version);
        let changed = vec![version; black.map.len()].into();
        Published { version, elements_version: version, changed, lineage: Arc::new(lineage), ..black }
    }

    /// What is to be saved beside the maps.
    pub(crate) fn state(&self, shown: u64, right_for: Option<u64>) -> LightState {
        LightState {
            version: self.version,
            elements_version: self.elements_version,
            shown,
            right_for,
            estimated_rmse: self.estimated_rmse,
            resolution: self.resolution.as_deref().map(StoredResolution::new),
            lineage: (*self.lineage).clone(),
            layout: layout_hash(&self.world),
            layout_version: engine::LAYOUT_VERSION,
            effort: Effort::default(),
            is_coarse: false,
            weights: self.layers.iter().map(|layer| layer.weight.to_array().map(f32::to_bits)).collect(),
        }
    }

    /// The version after this one. `world` is given where it changed, `weights` are those of the map's layers, `unknown`
    /// tells elements whose light is none of theirs, where it was carried over. Nothing is known of its error of resolution.
    pub(crate) fn next(
        &self,
        world: Option<World>,
        map: Arc<LightMap>,
        weights: &[Vec3],
        estimated_rmse: Option<f32>,
        unknown: Unknown,
    ) -> Published {
        let version = self.version + 1;
        let elements_version = if world.is_some() { version } else { self.elements_version };
        let (world, objects) = match world {
            Some(world) => (world, Arc::default()),
            None => (self.world.clone(), self.objects.clone()),
        };
        assert_eq!(map.len(), world.slots(), "a light map has one value per slot");
        assert!(map.len() >= self.map.len(), "slots are never taken away");
        assert_eq!(map.layers.len(), weights.len(), "every layer has a weight");
        let mut next = Published {
            layers: PublishedLayer::next(&self.layers, &map, weights, self.mode.part(), version),
            version,
            elements_version,
            delivered: world.delivered(&map, self.mode.part()),
            world,
            map,
            objects,
            estimated_rmse,
            resolution: None,
            noise_of_objects: OnceLock::new(),
            unknown,
            mode: self.mode,
            changed: Arc::default(),
            lineage: self.lineage.clone(),
            is_filtered: false,
        };
        next.changed = self.changed_to(&next);
        next
    }

    /// This version, of which so much is known.
    pub(crate) fn with_resolution(self, resolution: Option<Arc<ResolutionError>>) -> Published {
        Published { resolution, ..self }
    }

    /// Per slot of a later version: the version that last changed its value.
    fn changed_to(&self, next: &Published) -> Arc<[u64]> {
        let (old, new) = (self.values(), next.values());
        let since = |slot: usize| match old.get(slot) {
            Some(value) if same_bits(*value, new[slot]) => self.changed[slot],
            _ => next.version,
        };
        (0..new.len()).map(since).collect()
    }

    /// This version with its noise averaged away where it may be. What changed is told from `last`, the filtered form of
    /// an earlier version, on.
    pub(crate) fn filtered(&self, last: Option<&Published>, observer: &dyn Observer) -> Result<Published, Canceled> {
        let map = match self.estimated_rmse {
            Some(_) => Arc::new(engine::filter(&self.world, &self.map, |slot| self.is_known_at(slot), observer)?),
            None => self.map.clone(),
        };
        let (version, part, weights) = (self.version, self.mode.part(), self.weights());
        let oldest = last.map_or(version, |last| last.lineage.oldest());
        let layers = last.map_or(&[][..], |last| &last.layers);
        let mut next = Published {
            version,
            elements_version: self.elements_version,
            layers: PublishedLayer::next(layers, &map, &weights, part, version),
            delivered: self.world.delivered(&map, part),
            world: self.world.clone(),
            objects: self.objects.clone(),
            estimated_rmse: self.estimated_rmse.map(|_| map.estimated_rmse(self.world.areas())),
            resolution: self.resolution.clone(),
            noise_of_objects: OnceLock::new(),
            unknown: self.unknown.clone(),
            mode: self.mode,
            changed: vec![version; map.len()].into(),
            lineage: Arc::new(self.lineage.since(oldest)),
            is_filtered: true,
            map,
        };
        if let Some(last) = last {
            next.changed = last.changed_to(&next);
        }
        Ok(next)
    }

    /// The objects of the world. The first call takes a moment in large scenes.
    pub(crate) fn objects(&self) -> &[ObjectSummary] {
        self.objects.get_or_init(|| objects(&self.world).collect())
    }

    /// One value per slot, in the scene's mode.
    pub(crate) fn values(&self) -> &[Vec3] {
        &self.delivered
    }

    /// What the layers count in the map.
    pub(crate) fn weights(&self) -> Vec<Vec3> {
        self.layers.iter().map(|layer| layer.weight).collect()
    }

    /// The part of all light that the scene is about.
    pub(crate) fn mode(&self) -> LightPart {
        self.mode.part()
    }

    /// Elements whose light is none of theirs.
    pub(crate) fn unknown(&self) -> &Unknown {
        &self.unknown
    }

    /// One value per slot of what a client wants of the map.
    pub(crate) fn deliver(&self, wanted: Wanted) -> Cow<'_, [Vec3]> {
        match wanted {
            Wanted::Light(part) if part == self.mode.part() => self.values().into(),
            Wanted::Light(part) => self.world.delivered(&self.map, part).into(),
            Wanted::Error => self.errors(&self.map.light.variance).into(),
        }
    }

    /// One value per slot of what a client wants of a layer at reference strengths; none where the map has no such layer.
    pub(crate) fn deliver_layer(&self, name: &str, wanted: Wanted) -> Option<Cow<'_, [Vec3]>> {
        let layer = self.layer(name)?;
        Some(match wanted {
            Wanted::Light(part) => layer.values(part),
            Wanted::Error => self.errors(&layer.layer.light.variance()).into(),
        })
    }

    /// Its stated error: none of light that was carried over to another scene.
    pub(crate) fn stated_rmse(&self) -> Option<f32> {
        self.estimated_rmse.filter(|_| self.unknown.is_none())
    }

    /// Whether the light is right for what is shown, and states its error.
    pub(crate) fn is_known(&self) -> bool {
        self.stated_rmse().is_some()
    }

    /// What is stated of the light: its noise, and its error of resolution as far as it was measured.
    pub(crate) fn stated(&self) -> Stated {
        let resolution = self.resolution.as_ref().and_then(|error| error.all.rmse());
        self.stated_where_known(self.estimated_rmse, resolution)
    }

    /// What is stated of the light of each object, in the order of the world.
    pub(crate) fn stated_of_objects(&self) -> impl Iterator<Item = Stated> + '_ {
        let noise = self.noise_of_objects.get_or_init(|| engine::noise_of_objects(&self.world, &self.map));
        let of = |object: usize| self.resolution.as_ref().and_then(|error| error.objects.get(object)?.rmse());
        noise.iter().enumerate().map(move |(object, noise)| self.stated_where_known(*noise, of(object)))
    }

    fn stated_where_known(&self, noise: Option<f32>, resolution: Option<f32>) -> Stated {
        match self.is_known() {
            true => Stated { noise, resolution },
            false => Stated::default(),
        }
    }

    /// Infinite where nothing is known: an estimate, or an element that was inserted after the light was computed.
    fn errors(&self, variance: &[f32]) -> Vec<Vec3> {
        self.world.standard_errors(variance, |slot| self.estimated_rmse.is_some() && self.is_known_at(slot))
    }

    /// Whether an element did not come after its light was computed.
    fn is_known_at(&self, slot: usize) -> bool {
        self.unknown.as_ref().is_none_or(|unknown| !unknown[slot])
    }

    /// The layer of that name.
    pub(crate) fn layer(&self, name: &str) -> Option<&PublishedLayer> {
        self.layers.iter().find(|layer| layer.layer.name == name)
    }

    /// What a client lacks that has a layer's values at version `since`; none where the map has no such layer.
    pub(crate) fn layer_delta(&self, name: &str, since: u64) -> Option<Frame> {
        Some(self.layer(name)?.delta(self.mode.part(), since, self.version))
    }

    /// Whether what changed since a version can be told.
    pub(crate) fn knows(&self, version: u64) -> bool {
        self.lineage.knows(version)
    }

    /// What a client at version `since` lacks; everything where that is 0 or nothing is known of that version.
    pub(crate) fn delta(&self, since: u64) -> Frame {
        if since == 0 || !self.lineage.knows(since) {
            return Frame::whole(self.values(), self.version);
        }
        Frame::from_changed(self.values(), |slot| self.changed[slot] > since, since, self.version)
    }

    /// Bytes of the map and what is kept beside it.
    pub(crate) fn memory_bytes(&self) -> usize {
        let per_slot = VALUE_BYTES + size_of::<u64>() + size_of::<Vec3>();
        self.map.len() * per_slot + self.layer_bytes()
    }

    /// Bytes of the layers.
    pub(crate) fn layer_bytes(&self) -> usize {
        self.layers.iter().map(PublishedLayer::memory_bytes).sum()
    }
}
