//! Probes as they travel.

use glam::DVec3;
use rebake_core::probes::Probe;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Probes of a scene.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub(in crate::api) struct Probes {
    /// Version of the light map.
    #[schema(example = 7)]
    pub(super) version: u64,
    /// All probes of the request are here. Where not, those that are not here have the light that they had at version
    /// `since`, up to their error.
    pub(super) complete: bool,
    /// Samples per probe.
    #[schema(example = 256)]
    pub(super) samples: u32,
    /// The grid, where one was asked for.
    pub(super) grid: Option<ProbeGrid>,
    /// By index.
    pub(super) probes: Vec<ProbeLight>,
}

/// A grid of probes: `index` = *i* + *nx* (*j* + *ny* *k*), its point is `origin` + `spacing` × (*i*, *j*, *k*).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub(in crate::api) struct ProbeGrid {
    /// The first point, world space, metres.
    #[schema(example = json!([0.5, 0.5, 0.5]))]
    pub(super) origin: [f64; 3],
    /// Metres between neighbours.
    #[schema(example = 1.0)]
    pub(super) spacing: f64,
    /// Points along x, y and z.
    #[schema(example = json!([4, 3, 4]))]
    pub(super) counts: [u32; 3],
}

/// The light around a point.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub(in crate::api) struct ProbeLight {
    /// Its place in the grid, or in the request.
    #[schema(example = 0)]
    index: u32,
    /// World space, metres.
    #[schema(example = json!([0.5, 1.5, 0.5]))]
    position: [f64; 3],
    /// Nine coefficients, linear RGB, of the incoming radiance over all directions (not convolved with a cosine) in
    /// real orthonormal spherical harmonics without the Condon-Shortley phase, world axes: 1, y, z, x, xy, yz, 3z²−1,
    /// xz, x²−y². What `SphericalHarmonics3` of three.js takes, in its order and signs. Times 1, 2/3 and 1/4 by band
    /// they are those of irradiance / π.
    coefficients: [[f32; 3]; 9],
    /// Standard error of each coefficient, mean over RGB, from the scatter of its samples; null where the light map
    /// states none, or is not up to date with the objects.
    error: Option<[f32; 9]>,
    /// Share of the directions in which no back of a single-sided surface or of a solid is seen: 1 in the open, 0
    /// inside of solids.
    #[schema(example = 1.0)]
    validity: f32,
    /// Version of the light map that it was computed from.
    #[schema(example = 7)]
    version: u64,
}

impl ProbeLight {
    pub(super) fn new(index: usize, position: DVec3, probe: &Probe, version: u64, is_known: bool) -> ProbeLight {
        ProbeLight {
            index: index as u32,
            position: position.to_array(),
            coefficients: probe.radiance.0.map(|c| c.to_array()),
            error: is_known.then_some(probe.error),
            validity: probe.validity,
            version,
        }
    }
}
