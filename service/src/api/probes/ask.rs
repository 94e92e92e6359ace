//! Which probes a request asks for.

use glam::DVec3;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::super::problem::{ApiResult, Kind, Problem};
use super::super::sample::check_position;
use super::ProbeGrid;
use crate::config::Limits;
use crate::store::probes::SetKey;
use crate::store::versions::Published;

/// Samples per probe where a request does not say.
const DEFAULT_SAMPLES: u32 = 256;

/// Which probes to fetch: a grid by `spacing`, or `points`.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(in crate::api) struct ProbesQuery {
    /// Of a grid: metres between neighbours. It lies in the middle of the box, half a spacing or less off its sides.
    #[param(example = 0.5)]
    spacing: Option<f64>,
    /// Of a grid: its box, least and greatest corner, `x,y,z,x,y,z`, world space; that of the scene's objects where
    /// absent, which edits may change.
    #[param(example = "0,0,0,4,3,4")]
    bounds: Option<String>,
    /// Points of their own, `x,y,z`, world space, metres, with a semicolon between them.
    #[param(example = "1,1.5,2;3,1.5,2")]
    points: Option<String>,
    /// Samples per probe; 256 where absent.
    #[param(example = 256, minimum = 2)]
    samples: Option<u32>,
    /// A version that this same request was answered with `since`: only probes whose light has changed since then by
    /// more than its error come. 0 begins: all come. All come, too, where the service does not remember: it keeps four
    /// such requests per scene, while it runs (`complete` tells).
    #[param(example = 0)]
    since: Option<u64>,
}

/// Probes at points of their own.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(in crate::api) struct ProbesRequest {
    /// Position x y z of each, world space, metres.
    #[schema(example = json!([[1.0, 1.5, 2.0]]))]
    points: Vec<[f64; 3]>,
    /// Samples per probe; 256 where absent.
    #[schema(example = 256, minimum = 2)]
    samples: Option<u32>,
    /// A version that this same request was answered with `since`: only probes whose light has changed since then by
    /// more than its error come. 0 begins.
    #[schema(example = 0)]
    since: Option<u64>,
}

/// A request, checked.
pub(in crate::api) struct Asked {
    pub(super) points: Vec<DVec3>,
    pub(super) grid: Option<ProbeGrid>,
    pub(super) samples: u32,
    pub(super) since: Option<u64>,
}

impl ProbesQuery {
    pub(super) fn check(&self, published: &Published, limits: &Limits) -> ApiResult<Asked> {
        let invalid = |field: &str, reason: String| Err(Problem::field(Kind::InvalidQuery, field, reason));
        let (points, grid) = match (self.spacing, &self.points) {
            (Some(spacing), None) => {
                let grid = self.grid(spacing, published, limits)?;
                (grid.points(), Some(grid))
            }
            (None, Some(_)) if self.bounds.is_some() => return invalid("bounds", "goes with `spacing`".to_owned()),
            (None, Some(text)) => (parse_points(text, published, limits)?, None),
            (Some(_), Some(_)) => return invalid("points", "goes without `spacing`: give one of them".to_owned()),
            (None, None) => return invalid("spacing", "is missing: give it, or `points`".to_owned()),
        };
        let samples = check_samples(self.samples, points.len(), limits);
        let samples = samples.map_err(|problem| problem.with_kind(Kind::InvalidQuery))?;
        Ok(Asked { points, grid, samples, since: self.since })
    }

    fn grid(&self, spacing: f64, published: &Published, limits: &Limits) -> ApiResult<ProbeGrid> {
        let invalid = |field: &str, reason: String| Problem::field(Kind::InvalidQuery, field, reason);
        if !(spacing.is_finite() && spacing > 0.0) {
            return Err(invalid("spacing", "has to be a finite number of metres above 0".to_owned()));
        }
        let (low, high) = match &self.bounds {
            Some(text) => parse_bounds(text, published)?,
            None => bounds_of(published).ok_or_else(|| {
                invalid("bounds", "is missing: the scene has no objects whose bounds could be taken".to_owned())
            })?,
        };
        let counts = ((high - low) / spacing).ceil().max(DVec3::ONE);
        if counts.x * counts.y * counts.z > limits.probes as f64 {
            let [x, y, z] = counts.to_array();
            let reason = format!("makes {x} × {y} × {z} probes: more than {}", limits.probes);
            return Err(invalid("spacing", reason));
        }
        let origin = (low + high) / 2.0 - (counts - 1.0) * spacing / 2.0;
        Ok(ProbeGrid { origin: origin.to_array(), spacing, counts: counts.as_uvec3().to_array() })
    }
}

impl ProbesRequest {
    pub(super) fn check(&self, published: &Published, limits: &Limits) -> ApiResult<Asked> {
        let points = self.points.iter().map(|point| DVec3::from_array(*point)).collect();
        let points = check_points(points, published, limits)?;
        let samples = check_samples(self.samples, points.len(), limits)?;
        Ok(Asked { points, grid: None, samples, since: self.since })
    }
}

impl Asked {
    /// What tells it from others, whatever version is asked for.
    pub(super) fn key(&self) -> SetKey {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&self.samples.to_le_bytes());
        for point in &self.points {
            point.to_array().iter().for_each(|number| {
                hasher.update(&number.to_le_bytes());
            });
        }
        hasher.finalize().into()
    }
}

impl ProbeGrid {
    fn points(&self) -> Vec<DVec3> {
        let [nx, ny, nz] = self.counts;
        let origin = DVec3::from_array(self.origin);
        let rows = (0..nz).flat_map(|k| (0..ny).map(move |j| (j, k)));
        let points = rows.flat_map(|(j, k)| (0..nx).map(move |i| glam::UVec3::new(i, j, k)));
        points.map(|place| origin + place.as_dvec3() * self.spacing).collect()
    }
}

/// The box of the objects that are shown; none where there are none.
fn bounds_of(published: &Published) -> Option<(DVec3, DVec3)> {
    let shown = published.objects().iter().filter(|object| !object.is_hidden && object.elements > 0);
    shown.map(|object| object.bounds).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

fn parse_bounds(text: &str, published: &Published) -> ApiResult<(DVec3, DVec3)> {
    let invalid = || {
        let reason = "has to be x,y,z,x,y,z: the least corner and the greatest, finite";
        Problem::field(Kind::InvalidQuery, "bounds", reason)
    };
    let numbers = parse_numbers::<6>(text).ok_or_else(invalid)?;
    let [low, high] = [&numbers[..3], &numbers[3..]].map(DVec3::from_slice);
    for corner in [low, high] {
        check_position(corner, published, "bounds").map_err(|problem| problem.with_kind(Kind::InvalidQuery))?;
    }
    if low.cmple(high).all() { Ok((low, high)) } else { Err(invalid()) }
}

fn parse_points(text: &str, published: &Published, limits: &Limits) -> ApiResult<Vec<DVec3>> {
    let one = |(k, text): (usize, &str)| {
        let invalid = || Problem::field(Kind::InvalidQuery, format!("points[{k}]"), "has to be x,y,z");
        parse_numbers::<3>(text).map(DVec3::from_array).ok_or_else(invalid)
    };
    let points = text.split(';').enumerate().map(one).collect::<ApiResult<Vec<DVec3>>>()?;
    check_points(points, published, limits).map_err(|problem| problem.with_kind(Kind::InvalidQuery))
}

fn parse_numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    numbers?.try_into().ok()
}

fn check_points(points: Vec<DVec3>, published: &Published, limits: &Limits) -> ApiResult<Vec<DVec3>> {
    if points.is_empty() || points.len() > limits.probes {
        let reason = format!("has to hold 1 to {} points, not {}", limits.probes, points.len());
        return Err(Problem::field(Kind::InvalidValue, "points", reason));
    }
    for (k, point) in points.iter().enumerate() {
        check_position(*point, published, &format!("points[{k}]"))?;
    }
    Ok(points)
}

fn check_samples(samples: Option<u32>, probes: usize, limits: &Limits) -> ApiResult<u32> {
    let most = limits.samples_per_element.min((limits.samples / probes.max(1) as u64) as u32);
    let samples = samples.unwrap_or_else(|| DEFAULT_SAMPLES.min(most));
    if !(2..=most).contains(&samples) {
        let reason = format!("has to be 2 to {most} at {probes} probes, not {samples}");
        return Err(Problem::field(Kind::InvalidValue, "samples", reason));
    }
    Ok(samples)
}
