//! The light map: what is stored per element.

mod sparse;

use std::borrow::Cow;
use std::ops::{AddAssign, Mul};
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use crate::chunks::Chunks;

pub(crate) use sparse::AnyLight;
pub use sparse::{BLOCK_SLOTS, LightBlock, SparseLight, blocks_of};

/// So many layers are carried side by side, at most; of more, those that matter at a place.
pub const SIDE_BY_SIDE: usize = 16;

/// A map has at most so many layers. Where more lights are relit one by one, those that are left share a layer.
pub const MAX_LAYERS: usize = 1024;

/// So many groups of lights have layers of their own: the lights in none need one, too, and so does what is left of all
/// where they matter little.
pub const MAX_GROUPS: usize = MAX_LAYERS - 2;

/// Slots per task.
const CHUNK: usize = 4096;

/// Some of the light of a map or a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LightPart {
    /// Direct + indirect light.
    Full,
    /// Light that comes straight from lights.
    Direct,
    /// Light after at least one bounce.
    Indirect,
}

/// Light per element slot, and what is known of its error.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightValues<V = Vec3> {
    /// Light that comes straight from lights: irradiance / π = outgoing radiance / albedo, linear RGB.
    pub direct: Vec<V>,
    /// Light after at least one bounce, in the same unit.
    pub indirect: Vec<V>,
    /// Estimated variance of what the world states the error of ([`crate::Stated`]), mean over RGB; empty where it is not
    /// known, as of a single round.
    pub variance: Vec<f32>,
}

/// A light map: values per element slot. Slots without an element are zero.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightMap {
    /// All light together.
    pub light: LightValues,
    /// Direct and indirect light by the lights it stems from; empty until somebody relights a light or groups lights.
    pub layers: Vec<Arc<Layer>>,
}

/// The light of one light, or of a group, at reference strengths.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layer {
    /// Unique among the layers of a map: the name of its light or group.
    pub name: String,
    /// Its lights.
    pub lights: Vec<LayerLight>,
    /// Their light alone.
    pub light: SparseLight,
}

/// A layer without its values.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LayerHeader {
    /// As [`Layer::name`].
    pub name: String,
    /// As [`Layer::lights`].
    pub lights: Vec<LayerLight>,
}

/// A light of a layer.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerLight {
    /// Name of the light.
    pub name: String,
    /// Strength (color × intensity) that the layer holds its light at.
    pub reference: Vec3,
}

impl LayerHeader {
    /// Whether it is the layer of what is left of all others where they matter little: it has no lights of its own.
    pub fn is_rest(&self) -> bool {
        self.lights.is_empty()
    }
}

impl<V: Copy + Default> LightValues<V> {
    /// No light in `len` slots, without error.
    pub fn black(len: usize) -> LightValues<V> {
        let (direct, indirect) = (vec![V::default(); len], vec![V::default(); len]);
        LightValues { direct, indirect, variance: vec![0.0; len] }
    }

    /// Cuts it to `slots` slots, or gives it black ones at its end.
    pub(crate) fn resize(&mut self, slots: usize) {
        self.direct.resize(slots, V::default());
        self.indirect.resize(slots, V::default());
        self.variance.resize(slots, 0.0);
    }
}

impl<V> LightValues<V> {
    /// Slots, empty ones included.
    pub fn len(&self) -> usize {
        self.direct.len()
    }

    /// Whether there is no slot.
    pub fn is_empty(&self) -> bool {
        self.direct.is_empty()
    }
}

impl<V: Copy + Default + Send + Sync + AddAssign> LightValues<V> {
    /// No light in so many slots, in the memory that is there: fresh memory takes longer than most of what is done with
    /// it.
    pub(crate) fn blacken(&mut self, slots: usize) {
        for values in [&mut self.direct, &mut self.indirect] {
            (0..slots).into_par_iter().with_min_len(CHUNK).map(|_| V::default()).collect_into_vec(values);
        }
    }

    /// Black in some slots.
    pub(crate) fn without(mut self, slots: &[bool]) -> LightValues<V> {
        for slot in slots.iter().enumerate().filter(|(_, out)| **out).map(|(slot, _)| slot) {
            (self.direct[slot], self.indirect[slot]) = (V::default(), V::default());
        }
        self
    }

    /// Adds light times a weight; it is all there is where it is the first.
    pub(crate) fn add_weighted(&mut self, light: &LightValues<V>, weight: f32, is_first: bool)
    where
        V: Mul<f32, Output = V>,
    {
        if is_first {
            self.blacken(light.direct.len());
        }
        for (sum, light) in [(&mut self.direct, &light.direct), (&mut self.indirect, &light.indirect)] {
            sum.par_iter_mut().zip(light).with_min_len(CHUNK).for_each(|(sum, light)| *sum += *light * weight);
        }
    }

    /// Adds indirect light.
    pub(crate) fn add_indirect(&mut self, light: &[V]) {
        self.indirect.par_iter_mut().zip(light).with_min_len(CHUNK).for_each(|(i, b)| *i += *b);
    }
}

impl LightValues {
    /// Some of the light, per slot; what is stored is not copied.
    pub fn part(&self, part: LightPart) -> Cow<'_, [Vec3]> {
        match part {
            LightPart::Full => self.direct.iter().zip(&self.indirect).map(|(d, i)| *d + *i).collect(),
            LightPart::Direct => Cow::Borrowed(&self.direct),
            LightPart::Indirect => Cow::Borrowed(&self.indirect),
        }
    }
}

impl From<LightValues> for LightMap {
    /// A map without layers.
    fn from(light: LightValues) -> LightMap {
        LightMap { light, layers: Vec::new() }
    }
}

impl LightMap {
    /// A map of `len` slots without light.
    pub fn black(len: usize) -> LightMap {
        LightValues::black(len).into()
    }

    /// What the map is the sum of, at least one: its layers, or all light together where it has none.
    pub(crate) fn parts(&self) -> Vec<AnyLight<'_>> {
        match self.layers.is_empty() {
            true => vec![AnyLight::Dense(&self.light)],
            false => self.layers.iter().map(|layer| AnyLight::Sparse(&layer.light)).collect(),
        }
    }

    /// This map with `slots` slots: cut, or with holes at its end.
    pub fn resized(&self, slots: usize) -> LightMap {
        let mut map = self.clone();
        map.light.resize(slots);
        for layer in map.layers.iter_mut().filter(|layer| layer.light.len() != slots) {
            let light = layer.light.resized(slots);
            *layer = Arc::new(Layer { name: layer.name.clone(), lights: layer.lights.clone(), light });
        }
        map
    }

    /// What is left of all layers where they matter little: there where a map has more of them than are carried side by
    /// side, and then the first.
    pub fn rest(&self) -> Option<&Arc<Layer>> {
        self.layers.first().filter(|layer| layer.lights.is_empty())
    }

    /// Slots, empty ones included.
    pub fn len(&self) -> usize {
        self.light.len()
    }

    /// Whether there is no slot.
    pub fn is_empty(&self) -> bool {
        self.light.is_empty()
    }

    /// Direct + indirect of one slot.
    pub fn total(&self, element: usize) -> Vec3 {
        self.light.direct[element] + self.light.indirect[element]
    }

    /// Area-weighted root of the mean variance: the stated error.
    pub fn estimated_rmse(&self, areas: &Chunks<f32>) -> f32 {
        let (mut sum, mut area) = (0.0f64, 0.0f64);
        for (v, a) in self.light.variance.iter().zip(areas.iter()) {
            sum += f64::from(*v) * f64::from(*a);
            area += f64::from(*a);
        }
        if area > 0.0 { (sum / area).sqrt() as f32 } else { 0.0 }
    }
}
