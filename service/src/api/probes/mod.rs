//! Probes: the light around points, as spherical harmonics.

mod ask;
mod types;

use std::sync::Arc;

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use rebake_core::probes::{Probe, ProbeOptions, probes_at};

pub(super) use self::ask::{Asked, ProbesQuery, ProbesRequest};
pub(super) use self::types::{ProbeGrid, ProbeLight, Probes};
use super::coding::encode_body;
use super::extract::{ApiPath, ApiQuery, Coding, read_json};
use super::problem::{ApiResult, Kind, Problem};
use super::versioned::Versioned;
use super::{Shared, find_scene};
use crate::pictures::Watch;
use crate::state::App;
use crate::store::probes::ProbeSet;
use crate::store::scene::SceneEntry;
use crate::store::versions::Published;

/// Probes of a scene: at the points of a grid over it, or at given points. Each is the incoming radiance around its
/// point, direct and indirect, as nine coefficients of spherical harmonics. The same request gives the same numbers
/// while the scene stays as it is. With `since` only those come whose light has changed beyond its error.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/probes", tag = "light map", operation_id = "get_probes",
    params(
        ("scene" = String, Path, description = "The scene's id"),
        ProbesQuery,
        ("If-None-Match" = Option<String>, Header, description = "The version that the client has"),
    ),
    responses(
        (status = 200, body = Probes, description = "Probe by probe", headers(("ETag" = String, description = "The version"),
            ("X-Rebake-Version" = String, description = "Version of the light map"))),
        (status = 304, description = "The client has this version"),
    )
)]
pub(super) async fn get(
    State(app): Shared,
    ApiPath(id): ApiPath<String>,
    ApiQuery(query): ApiQuery<ProbesQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let scene = find_scene(&app, &id).await?;
    let asked = query.check(&scene.published(), &app.config.limits)?;
    answer(&app, &scene, asked, &headers).await
}

/// Probes at points of the request's body: as many as a query has no room for.
#[utoipa::path(
    post, path = "/v1/scenes/{scene}/probes", tag = "light map", operation_id = "sample_probes",
    params(("scene" = String, Path, description = "The scene's id")),
    request_body(content = ProbesRequest, content_type = "application/json"),
    responses((status = 200, body = Probes, description = "Probe by probe", headers(("ETag" = String, description = "The version"),
        ("X-Rebake-Version" = String, description = "Version of the light map"))))
)]
pub(super) async fn create(
    State(app): Shared,
    ApiPath(id): ApiPath<String>,
    headers: HeaderMap,
    body: Body,
) -> ApiResult<Response> {
    let scene = find_scene(&app, &id).await?;
    let request: ProbesRequest = read_json(&app, &headers, body).await?;
    let asked = request.check(&scene.published(), &app.config.limits)?;
    answer(&app, &scene, asked, &headers).await
}

async fn answer(app: &Arc<App>, scene: &Arc<SceneEntry>, asked: Asked, headers: &HeaderMap) -> ApiResult<Response> {
    let watch = Watch::default();
    let _guard = watch.guard();
    // Of those who follow a set one after the other brings it up to date.
    let _set = match asked.since {
        Some(_) => Some(scene.probes.turn.lock().await),
        None => None,
    };
    let turn = app.pictures.turns.clone().acquire_owned().await.map_err(Problem::internal)?;
    let published = scene.published();
    if let Some(since) = asked.since.filter(|since| *since > published.version) {
        let text = format!("since: the light map is at version {}, not {since}", published.version);
        return Err(Problem::new(Kind::VersionAhead, text));
    }
    let versioned = Versioned::of_light(&published, headers, Some("accept-encoding"))?;
    if versioned.is_known {
        return Ok(versioned.not_modified());
    }
    let (coding, its_scene) = (Coding::accepted(headers), Arc::clone(scene));
    let options = ProbeOptions { samples: asked.samples, seed: app.config.seed };
    let work = move || -> ApiResult<Bytes> {
        let _turn = turn;
        let compute = || {
            let found = probes_at(&published.world, &published.map, &asked.points, &options, &watch);
            found.map_err(|_| Problem::new(Kind::ShuttingDown, "the probes were given up"))
        };
        let told = match asked.since {
            None => whole(&published, &asked, &compute()?),
            Some(since) => followed(&its_scene, &published, &asked, since, compute)?,
        };
        encode_body(coding, serde_json::to_vec(&told).map_err(Problem::internal)?).map_err(Problem::internal)
    };
    let body = app.compute.draw(work).await??;
    let kind = [(header::CONTENT_TYPE, "application/json")];
    Ok((versioned.about, kind, coding.headers(), body).into_response())
}

/// All probes, as they are now.
fn whole(published: &Published, asked: &Asked, probes: &[Probe]) -> Probes {
    let version = published.version;
    let light = |(index, probe): (usize, &Probe)| {
        ProbeLight::new(index, asked.points[index], probe, version, published.is_known())
    };
    let lights = probes.iter().enumerate().map(light).collect();
    Probes { version, complete: true, samples: asked.samples, grid: asked.grid, probes: lights }
}

/// Those of a set that changed since a version, or all where that is not known.
fn followed(
    scene: &SceneEntry,
    published: &Published,
    asked: &Asked,
    since: u64,
    compute: impl FnOnce() -> ApiResult<Vec<Probe>>,
) -> ApiResult<Probes> {
    let version = published.version;
    let kept = scene.probes.get(&asked.key());
    // Who asks for a set that begins here has none of it, whatever version it says.
    let begins = kept.is_none();
    let set: ProbeSet = match kept.filter(|set| set.version == version) {
        Some(set) => set,
        None => scene.probes.update(asked.key(), version, compute()?),
    };
    let complete = begins || since < set.first;
    let changed = set.probes.iter().enumerate().filter(|(_, (_, changed))| complete || *changed > since);
    let light = |(index, (probe, changed)): (usize, &(Probe, u64))| {
        ProbeLight::new(index, asked.points[index], probe, *changed, published.is_known())
    };
    let lights = changed.map(light).collect();
    Ok(Probes { version, complete, samples: asked.samples, grid: asked.grid, probes: lights })
}
