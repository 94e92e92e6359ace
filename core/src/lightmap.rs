//! The light map: what is stored per element.

use std::sync::Arc;

use glam::Vec3;

use crate::chunks::Chunks;

/// A map has at most so many layers. Where more lights are relit one by one, those that are left share a layer.
pub const MAX_LAYERS: usize = 16;

/// So many groups of lights have layers of their own: the lights in none need one, too.
pub const MAX_GROUPS: usize = MAX_LAYERS - 1;

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

/// Values per element slot: outgoing radiance / albedo = irradiance / π, linear RGB. Slots without an element are zero.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightMap {
    /// Light that comes straight from lights.
    pub direct: Vec<Vec3>,
    /// Light after at least one bounce.
    pub indirect: Vec<Vec3>,
    /// Estimated variance of what the world states the error of ([`crate::Stated`]), mean over RGB.
    pub variance: Vec<f32>,
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
    /// Straight from its lights, irradiance / π per slot.
    pub direct: Vec<Vec3>,
    /// After at least one bounce.
    pub indirect: Vec<Vec3>,
    /// Estimated variance of what the world states the error of ([`crate::Stated`]), mean over RGB.
    pub variance: Vec<f32>,
}

/// A light of a layer.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerLight {
    /// Name of the light.
    pub name: String,
    /// Strength (color × intensity) that the layer holds its light at.
    pub reference: Vec3,
}

impl LightMap {
    /// A map of `len` slots without light.
    pub fn black(len: usize) -> LightMap {
        LightMap {
            direct: vec![Vec3::ZERO; len],
            indirect: vec![Vec3::ZERO; len],
            variance: vec![0.0; len],
            layers: Vec::new(),
        }
    }

    /// This map with `slots` slots: cut, or with holes at its end.
    pub fn resized(&self, slots: usize) -> LightMap {
        let mut map = self.clone();
        map.direct.resize(slots, Vec3::ZERO);
        map.indirect.resize(slots, Vec3::ZERO);
        map.variance.resize(slots, 0.0);
        for layer in &mut map.layers {
            let layer = Arc::make_mut(layer);
            layer.direct.resize(slots, Vec3::ZERO);
            layer.indirect.resize(slots, Vec3::ZERO);
            layer.variance.resize(slots, 0.0);
        }
        map
    }

    /// Slots, empty ones included.
    pub fn len(&self) -> usize {
        self.direct.len()
    }

    /// Whether there is no slot.
    pub fn is_empty(&self) -> bool {
        self.direct.is_empty()
    }

    /// Direct + indirect of one slot.
    pub fn total(&self, element: usize) -> Vec3 {
        self.direct[element] + self.indirect[element]
    }

    /// Area-weighted root of the mean variance: the stated error.
    pub fn estimated_rmse(&self, areas: &Chunks<f32>) -> f32 {
        let (mut sum, mut area) = (0.0f64, 0.0f64);
        for (v, a) in self.variance.iter().zip(areas.iter()) {
            sum += f64::from(*v) * f64::from(*a);
            area += f64::from(*a);
        }
        if area > 0.0 { (sum / area).sqrt() as f32 } else { 0.0 }
    }
}
