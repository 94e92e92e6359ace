//! The light map: what is stored per element.

use glam::Vec3;

/// Values per element slot: outgoing radiance / albedo = irradiance / π, linear RGB. Slots without an element are zero.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightMap {
    /// Light that comes straight from lights.
    pub direct: Vec<Vec3>,
    /// Light after at least one bounce.
    pub indirect: Vec<Vec3>,
    /// Estimated variance of direct + indirect, mean over RGB.
    pub variance: Vec<f32>,
}

impl LightMap {
    /// A map of `len` slots without light.
    pub fn black(len: usize) -> LightMap {
        LightMap { direct: vec![Vec3::ZERO; len], indirect: vec![Vec3::ZERO; len], variance: vec![0.0; len] }
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
    pub fn estimated_rmse(&self, areas: &[f32]) -> f32 {
        let (mut sum, mut area) = (0.0f64, 0.0f64);
        for (v, a) in self.variance.iter().zip(areas) {
            sum += f64::from(*v) * f64::from(*a);
            area += f64::from(*a);
        }
        if area > 0.0 { (sum / area).sqrt() as f32 } else { 0.0 }
    }
}
