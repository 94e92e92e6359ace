//! How accurate a light map is: its noise, and the error of its resolution, measured when it is asked for.

use axum::Json;
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use rebake_core::resolution::{MeanSquare, ResolutionError, ResolutionOptions, noise_of_objects, resolution_error};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::extract::{ApiPath, ApiQuery};
use super::problem::{ApiResult, Kind, Problem};
use super::sample::SamplePart;
use super::types::{LightError, finite};
use super::versioned::VERSION;
use super::{Shared, find_scene};
use crate::config::Limits;
use crate::pictures::Watch;
use crate::store::versions::Published;

/// Where a request does not say.
const DEFAULT_POINTS: u32 = 4096;
const DEFAULT_SAMPLES: u32 = 64;

/// Most points of one request.
const MOST_POINTS: u64 = 1 << 16;

/// How well to measure.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ErrorQuery {
    /// Points on the surfaces where what is read is held against exact samples; 4096 where absent. Points × samples are at
    /// most 8,388,608.
    #[param(example = 4096, minimum = 32, maximum = 65_536)]
    points: Option<u32>,
    /// Samples at each; 64 where absent.
    #[param(example = 64, minimum = 2)]
    samples: Option<u32>,
}

/// How accurate a light map is.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub(super) struct ErrorReport {
    /// Version of the light map.
    version: u64,
    /// Which light is meant: the scene's mode.
    part: SamplePart,
    /// Over all surfaces.
    error: LightError,
    /// Points that resolution was measured at; those inside of solids do not count.
    #[schema(example = 3952)]
    points: u32,
    /// Object by object, in the order of the scene; hidden ones have no light.
    objects: Vec<ObjectError>,
}

/// How accurate the light of an object is.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub(super) struct ObjectError {
    /// Its name.
    #[schema(example = "sofa")]
    object: String,
    /// Over its surface.
    error: LightError,
    /// Points on it.
    #[schema(example = 214)]
    points: u32,
}

/// How far off the light map is, by chance and by its resolution, which is measured for this: some exact samples at
/// points of the surfaces are held against what is read there between elements. The same request gives the same numbers
/// while the scene stays as it is.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/error", tag = "light map", operation_id = "get_error",
    params(("scene" = String, Path, description = "The scene's id"), ErrorQuery),
    responses((status = 200, body = ErrorReport, description = "Of the whole and of each object",
        headers(("X-Rebake-Version" = String, description = "Version of the light map"))))
)]
pub(super) async fn get(
    State(app): Shared,
    ApiPath(id): ApiPath<String>,
    ApiQuery(query): ApiQuery<ErrorQuery>,
) -> ApiResult<Response> {
    let scene = find_scene(&app, &id).await?;
    let options = options(&query, &app.config.limits, app.config.seed)?;
    let published = scene.published();
    let watch = Watch::default();
    let _guard = watch.guard();
    let turn = app.pictures.turns.clone().acquire_owned().await.map_err(Problem::internal)?;
    let work = move || {
        let _turn = turn;
        report(&published, &options, &watch)
    };
    let given_up = || Problem::new(Kind::ShuttingDown, "the measurement was given up");
    let report = app.compute.draw(work).await?.ok_or_else(given_up)?;
    Ok(([(VERSION.clone(), report.version.to_string())], Json(report)).into_response())
}

fn options(query: &ErrorQuery, limits: &Limits, seed: u64) -> ApiResult<ResolutionOptions> {
    let bounded = |field: &str, value: Option<u32>, default: u32, least: u32, most: u64| {
        let value = value.unwrap_or(u64::from(default).min(most) as u32);
        let invalid = || Problem::field(Kind::InvalidQuery, field, format!("has to be {least} to {most}, not {value}"));
        (value >= least && u64::from(value) <= most).then_some(value).ok_or_else(invalid)
    };
    let points = bounded("points", query.points, DEFAULT_POINTS, 32, MOST_POINTS)?;
    let most = u64::from(limits.samples_per_element).min(limits.samples / u64::from(points));
    let samples = bounded("samples", query.samples, DEFAULT_SAMPLES, 2, most)?;
    Ok(ResolutionOptions { points, samples, seed })
}

/// None where it is not wanted any more.
fn report(published: &Published, options: &ResolutionOptions, watch: &Watch) -> Option<ErrorReport> {
    let Published { world, map, version, .. } = published;
    let measured = match published.is_known() {
        true => resolution_error(world, map, options, watch).ok()?,
        false => None,
    };
    let names = world.scene.objects.iter().map(|object| object.name.clone());
    let noise = if published.is_known() { noise_of_objects(world, map) } else { vec![None; names.len()] };
    let ResolutionError { all, objects, .. } = measured.unwrap_or_default();
    let objects = objects.into_iter().chain(std::iter::repeat(MeanSquare::default()));
    let objects = names.zip(noise).zip(objects).map(|((object, noise), resolution)| ObjectError {
        object,
        error: LightError { noise, resolution: resolution.rmse() },
        points: resolution.points,
    });
    let noise = published.stated_rmse().and_then(finite);
    Some(ErrorReport {
        version: *version,
        part: published.mode().into(),
        error: LightError { noise, resolution: all.rmse() },
        points: all.points,
        objects: objects.collect(),
    })
}
