//! Light at points of a client's choice.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Response};
use glam::{DVec3, Vec3};
use rebake_core::allowed::Allowed;
use rebake_core::points::{PointOptions, light_at};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::extract::{ApiPath, read_json};
use super::problem::{ApiResult, Kind, Problem};
use super::versioned::VERSION;
use super::{Shared, find_scene};
use crate::config::Limits;
use crate::pictures::Watch;
use crate::store::versions::{LightPart, Published};

/// Samples per point where a request does not say.
const DEFAULT_SAMPLES: u32 = 256;

/// Points to sample.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SampleRequest {
    /// Position x y z (world space, metres) and normal x y z (of any length but zero) of each. Points × samples are at
    /// most 8,388,608.
    #[schema(min_items = 1, max_items = 4096, example = json!([[1.0, 0.5, 2.0, 0.0, 1.0, 0.0]]))]
    points: Vec<[f64; 6]>,
    /// Samples per point; 256 where absent.
    #[schema(example = 256, minimum = 2)]
    samples: Option<u32>,
    /// `full`, `direct` or `indirect`; the scene's mode where absent.
    part: Option<SamplePart>,
}

/// Which light is sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum SamplePart {
    /// Direct + indirect light.
    Full,
    /// Light straight from lights.
    Direct,
    /// Light after at least one bounce.
    Indirect,
}

/// Light at points.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub(super) struct Samples {
    /// Version of the light map that indirect light was gathered from.
    version: u64,
    /// Which light it is.
    part: SamplePart,
    /// In the order of the request.
    points: Vec<Sample>,
}

/// Light at one point.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, ToSchema)]
pub(super) struct Sample {
    /// irradiance / π on the side of the normal, linear RGB.
    #[schema(example = json!([0.4, 0.38, 0.35]))]
    light: [f32; 3],
    /// Its standard error, mean over RGB, from the scatter of its samples; null where the light map that was gathered
    /// from states none, or is not up to date with the objects.
    #[schema(example = 0.004)]
    error: Option<f32>,
}

impl From<LightPart> for SamplePart {
    fn from(part: LightPart) -> SamplePart {
        match part {
            LightPart::Full => SamplePart::Full,
            LightPart::Direct => SamplePart::Direct,
            LightPart::Indirect => SamplePart::Indirect,
        }
    }
}

impl From<SamplePart> for LightPart {
    fn from(part: SamplePart) -> LightPart {
        match part {
            SamplePart::Full => LightPart::Full,
            SamplePart::Direct => LightPart::Direct,
            SamplePart::Indirect => LightPart::Indirect,
        }
    }
}

/// Light that a small surface would get at points of any place: on surfaces, between elements, or in the air. Direct light
/// comes from rays to the lights, indirect light from one gather over the light map. The same request gives the same
/// numbers while the scene stays as it is.
#[utoipa::path(
    post, path = "/v1/scenes/{scene}/sample", tag = "light map", operation_id = "sample_light",
    params(("scene" = String, Path, description = "The scene's id")),
    request_body(content = SampleRequest, content_type = "application/json"),
    responses((status = 200, body = Samples, description = "Point by point",
        headers(("X-Rebake-Version" = String, description = "Version of the light map"))))
)]
pub(super) async fn create(
    State(app): Shared,
    ApiPath(id): ApiPath<String>,
    headers: HeaderMap,
    body: Body,
) -> ApiResult<Response> {
    let scene = find_scene(&app, &id).await?;
    let request: SampleRequest = read_json(&app, &headers, body).await?;
    let published = scene.published();
    let points = check_points(&request.points, &published, &app.config.limits)?;
    let samples = check_samples(&request, &app.config.limits)?;
    let part = request.part.map_or(published.mode(), LightPart::from);
    let options = PointOptions { part, samples, seed: app.config.seed };
    let watch = Watch::default();
    let _guard = watch.guard();
    let turn = app.pictures.turns.clone().acquire_owned().await.map_err(Problem::internal)?;
    let work = move || {
        let _turn = turn;
        let found = light_at(&published.world, &published.map, &points, &options, &watch).ok()?;
        let is_known = part == LightPart::Direct || published.is_known();
        let sample = |light: rebake_core::points::PointLight| Sample {
            light: light.light.to_array(),
            error: is_known.then_some(light.error),
        };
        let points = found.into_iter().map(sample).collect();
        Some(Samples { version: published.version, part: part.into(), points })
    };
    let given_up = || Problem::new(Kind::ShuttingDown, "the samples were given up");
    let samples = app.compute.draw(work).await?.ok_or_else(given_up)?;
    Ok(([(VERSION.clone(), samples.version.to_string())], Json(samples)).into_response())
}

fn check_points(points: &[[f64; 6]], published: &Published, limits: &Limits) -> ApiResult<Vec<(DVec3, Vec3)>> {
    let invalid = |field: String, reason: String| Problem::field(Kind::InvalidValue, field, reason);
    if points.is_empty() || points.len() > limits.sample_points {
        let reason = format!("has to hold 1 to {} points, not {}", limits.sample_points, points.len());
        return Err(invalid("points".to_owned(), reason));
    }
    let each = |(k, numbers): (usize, &[f64; 6])| {
        let [x, y, z, nx, ny, nz] = *numbers;
        let (point, n) = (DVec3::new(x, y, z), DVec3::new(nx, ny, nz));
        check_position(point, published, &format!("points[{k}]"))?;
        let n = n.try_normalize().filter(|n| n.is_finite());
        let zero = || invalid(format!("points[{k}]"), "its normal has to be finite and not zero".to_owned());
        Ok((point, n.ok_or_else(zero)?.as_vec3()))
    };
    points.iter().enumerate().map(each).collect()
}

/// Whether a position is one that numbers can tell, near enough to the scene.
pub(super) fn check_position(point: DVec3, published: &Published, field: &str) -> ApiResult<()> {
    let far = |reason: String| Problem::field(Kind::InvalidValue, field, format!("its position {reason}"));
    Allowed::ASKED.check_place(point, published.world.scene.origin).map_err(far)
}

fn check_samples(request: &SampleRequest, limits: &Limits) -> ApiResult<u32> {
    let samples = request.samples.unwrap_or(DEFAULT_SAMPLES);
    let most = limits.samples_per_element.min((limits.samples / request.points.len() as u64) as u32);
    if !(2..=most).contains(&samples) {
        let reason = format!("has to be 2 to {most} at {} points, not {samples}", request.points.len());
        return Err(Problem::field(Kind::InvalidValue, "samples", reason));
    }
    Ok(samples)
}
