//! Which tiles of atlas pages changed since a version, once or for as long as the client listens, and between two.

use std::sync::Arc;

use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use rebake_core::delta::TILE_CONTENT_TYPE;
use serde::Deserialize;
use utoipa::IntoParams;

use super::atlas::{BYTES_PER_TEXEL, PagePrecision, atlas_of};
use super::between::{Immutable, find, read_versions};
use super::coding::encode_body;
use super::extract::{ApiPath, ApiQuery, Coding};
use super::filter::view;
use super::lightmap::{Chosen, choose};
use super::problem::{ApiResult, Kind, Problem};
use super::tile_stream;
use super::types::PartName;
use super::uploads::memory_problem;
use super::versioned::{ESTIMATED_RMSE, VERSION};
use super::{Shared, etag, find_scene};
use crate::engine::{Canceled, read_page};
use crate::filter::Filter;
use crate::pictures::Watch;
use crate::state::App;
use crate::store::deltas::KeptDelta;
use crate::store::scene::SceneEntry;
use crate::store::tiles::Selection;
use crate::store::versions::Published;
use crate::tiles::{Frames, hashes};

/// Deltas that are kept take this many bytes per texel of the pages: all of them at full precision, twice.
const KEPT_PER_TEXEL: u64 = 24;

/// What of the pages to fetch.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct TileQuery {
    /// The version of the pages that the client has, the lowest where they differ; 0 for none.
    #[param(example = 0)]
    since: u64,
    /// Keep the connection open and send every new version.
    follow: Option<bool>,
    /// As of `atlas/{page}`: a part of all light, or the name of a layer. The stream ends where the map loses the layer.
    #[param(example = "ceiling")]
    layer: Option<String>,
    /// Which part, of all light or of a layer; the scene's mode where absent.
    #[param(inline)]
    part: Option<PartName>,
    /// Whether noise is averaged away where it may be; `statistical` where absent.
    #[param(inline)]
    filter: Option<Filter>,
    /// How values travel; `half` where absent.
    #[param(inline)]
    precision: Option<PagePrecision>,
}

/// What of the pages to fetch, between two versions.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct TileBetweenQuery {
    /// As of `atlas/{page}`: a part of all light, or the name of a layer.
    #[param(example = "ceiling")]
    layer: Option<String>,
    /// Which part, of all light or of a layer; the scene's mode where absent.
    #[param(inline)]
    part: Option<PartName>,
    /// Whether noise is averaged away where it may be; `statistical` where absent.
    #[param(inline)]
    filter: Option<Filter>,
    /// How values travel; `half` where absent.
    #[param(inline)]
    precision: Option<PagePrecision>,
}

/// Tiles of the atlas's pages that changed from version `since` to now. Applied to pages that were loaded at that
/// version by `atlas/{page}` with the same `layer`, `part`, `filter` and `precision` they give the newest pages bit for
/// bit. Pages that were never fetched so before come whole. With `follow=true` the connection stays open and tiles
/// arrive as versions are published; a client that is slower than that skips versions, never changes. One that
/// reconnects with the version of the last frame it has applied with flag bit 0 loses nothing.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/atlas/deltas", tag = "light map", operation_id = "get_atlas_deltas",
    params(("scene" = String, Path, description = "The scene's id"), TileQuery),
    responses((status = 200, body = Vec<u8>, content_type = "application/vnd.rebake.tiles", description = "Frames of tiles; none where the client is up to date",
        headers(("ETag" = String, description = "Without `follow`: the version"),
            ("X-Rebake-Version" = String, description = "Without `follow`: version of the light map"),
            ("X-Rebake-Estimated-Rmse" = String, description = "Without `follow` and `layer`: stated error of what is delivered, where it is known"))))
)]
pub(super) async fn get(
    State(app): Shared,
    ApiPath(id): ApiPath<String>,
    ApiQuery(query): ApiQuery<TileQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let scene = find_scene(&app, &id).await?;
    let published = scene.published();
    let TileQuery { since, follow, layer, part, filter, precision } = query;
    let selection = select(&published, layer.as_deref(), part, (filter, precision))?;
    let version = published.version;
    if since > version {
        let text = format!("since: the light map is at version {version}, not {since}");
        return Err(Problem::new(Kind::VersionAhead, text));
    }
    let coding = Coding::accepted(&headers);
    if follow.unwrap_or(false) {
        // What is wrong with the atlas is told before the stream begins.
        atlas_of(&app, &scene, &published).await?;
        return tile_stream::follow(&app, &scene, selection, since, coding);
    }
    let delta = make(&app, &scene, published, &selection, since).await?;
    let value = |text: String| HeaderValue::from_str(&text).map_err(Problem::internal);
    let about = [(header::ETAG, value(etag(version))?), (VERSION.clone(), value(version.to_string())?)];
    let vary = [(header::VARY, "accept-encoding")];
    Ok((about, vary, answer(&app, delta, &selection, coding).await?).into_response())
}

/// Tiles of the atlas's pages that changed from one version to another; from version 0 they are all that is on them, and
/// between equal versions there are none. The answer never changes, so that caches may keep it for good. It is made while
/// `to` is the scene's present version; one from another version than 0 is kept for a while after. Where it is not kept
/// any more (410), ask for the one to the present version.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/atlas/deltas/{from}-{to}", tag = "light map", operation_id = "get_atlas_delta_between",
    params(
        ("scene" = String, Path, description = "The scene's id"),
        ("from" = u64, Path, description = "The version of the pages that the client has; 0 for none", example = 3),
        ("to" = u64, Path, description = "The version that it wants", example = 7),
        TileBetweenQuery,
        ("If-None-Match" = Option<String>, Header, description = "The `ETag` that the client has"),
    ),
    responses(
        (status = 200, body = Vec<u8>, content_type = "application/vnd.rebake.tiles", description = "The frames of one snapshot, or none",
            headers(
                ("Cache-Control" = String, description = "A year, `immutable`; `private` where the service asks for tokens"),
                ("ETag" = String, description = "Both versions, and the coding"),
                ("X-Rebake-Version" = String, description = "`to`"),
                ("X-Rebake-Estimated-Rmse" = String, description = "Without `layer`: stated error of what is delivered; absent where nothing is known of it, and between equal versions"),
            )),
        (status = 304, description = "The client has it"),
    )
)]
pub(super) async fn get_between(
    State(app): Shared,
    ApiPath((id, versions)): ApiPath<(String, String)>,
    ApiQuery(query): ApiQuery<TileBetweenQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let scene = find_scene(&app, &id).await?;
    let (from, to) = read_versions(&versions)?;
    let published = scene.published();
    let selection = select(&published, query.layer.as_deref(), query.part, (query.filter, query.precision))?;
    let found = find(&published, (from, to), || scene.tiles.deltas.find(&(selection.clone(), from, to)))?;
    let Immutable { about, coding, is_known } = Immutable::new(&app, &headers, &versions, to)?;
    if is_known {
        return Ok((StatusCode::NOT_MODIFIED, about).into_response());
    }
    let delta = match found {
        Some(kept) => kept,
        None => make(&app, &scene, published, &selection, from).await?,
    };
    Ok((about, answer(&app, delta, &selection, coding).await?).into_response())
}

/// Frames as they leave, with what headers tell of them.
async fn answer(
    app: &Arc<App>,
    delta: KeptDelta,
    selection: &Selection,
    coding: Coding,
) -> ApiResult<impl IntoResponse + use<>> {
    let stated = delta.stated.filter(|_| selection.layer.is_none());
    let stated = stated.map(|stated| [(ESTIMATED_RMSE.clone(), stated.to_string())]);
    app.metrics.delta_bytes.inc_by(delta.frame.len() as u64);
    let body = app.compute.answer(move || encode_body(coding, delta.frame)).await?.map_err(Problem::internal)?;
    Ok((stated, [(header::CONTENT_TYPE, TILE_CONTENT_TYPE)], coding.headers(), body))
}

/// What a query asks for, as of `atlas/{page}`.
fn select(
    published: &Published,
    layer: Option<&str>,
    part: Option<PartName>,
    (filter, precision): (Option<Filter>, Option<PagePrecision>),
) -> ApiResult<Selection> {
    if part.is_some_and(|part| part.of_light().is_none()) {
        let reason = "is no light: deltas have none of it, atlas/{page} has";
        return Err(Problem::field(Kind::InvalidQuery, "part", reason));
    }
    let chosen = choose(published, layer, part, None)?;
    selection_of(&chosen, filter, precision)
        .ok_or_else(|| Problem::field(Kind::InvalidQuery, "layer", "pages hold one layer each: `all` is not offered"))
}

/// What pages of light are read for; none of what is no light, or several layers.
pub(super) fn selection_of(
    chosen: &Chosen,
    filter: Option<Filter>,
    precision: Option<PagePrecision>,
) -> Option<Selection> {
    let (layer, wanted) = match chosen {
        Chosen::Map(wanted) => (None, *wanted),
        Chosen::Layer(name, wanted) => (Some(name.clone()), *wanted),
        Chosen::All | Chosen::Wanted(_) | Chosen::Computed(_) => return None,
    };
    let half = precision.unwrap_or_default() == PagePrecision::Half;
    Some(Selection { layer, wanted, filter: filter.unwrap_or(Filter::Statistical), half })
}

/// What leads from version `since` of the pages to the one that is given. Off the async threads; given up when the client
/// goes away.
pub(super) async fn make(
    app: &Arc<App>,
    scene: &Arc<SceneEntry>,
    published: Arc<Published>,
    selection: &Selection,
    since: u64,
) -> ApiResult<KeptDelta> {
    let version = published.version;
    if since > 0 && since == version {
        return Ok(KeptDelta { frame: Bytes::new(), stated: published.stated_rmse() });
    }
    let atlas = atlas_of(app, scene, &published).await?;
    let key = (selection.clone(), since, version);
    let _asked = scene.tiles.turn.lock().await;
    if let Some(kept) = scene.tiles.deltas.find(&key) {
        return Ok(kept);
    }
    let published = view(app, &scene.filtered, published, selection.filter).await?;
    let (watch, its_app, its_scene) = (Watch::default(), Arc::clone(app), Arc::clone(scene));
    let _guard = watch.guard();
    let turn = app.pictures.turns.clone().acquire_owned().await.map_err(Problem::internal)?;
    let selection = selection.clone();
    let work = move || {
        let _turn = turn;
        let sizes: Vec<[u32; 2]> = atlas.pages().iter().map(|page| [page.width, page.height]).collect();
        let texels: u64 = sizes.iter().map(|[width, height]| u64::from(*width) * u64::from(*height)).sum();
        let _promise =
            its_app.memory.promise(texels * BYTES_PER_TEXEL, 0).map_err(|full| memory_problem("pages", full))?;
        let values = match &selection.layer {
            None => published.deliver(selection.wanted),
            Some(name) => published.deliver_layer(name, selection.wanted).ok_or_else(|| gone(name))?,
        };
        let mut frames = Frames::new(sizes, (since, version), selection.half, its_app.config.limits.frame_bytes);
        for index in 0..atlas.pages().len() {
            let given_up = |Canceled| Problem::new(Kind::ShuttingDown, "the pages were given up");
            let page = read_page(&published.world, &atlas, index, &values, &watch).map_err(given_up)?;
            let (size, hashes) = hashes(&page, selection.half);
            frames.add(index, &page, &its_scene.tiles.see(&selection, index, version, size, hashes));
        }
        let delta = KeptDelta { frame: frames.finish().into(), stated: published.stated_rmse() };
        // All pages would push out what changes on them, and who has nothing asks for the newest as well.
        if since > 0 {
            let most_bytes = (texels * KEPT_PER_TEXEL) as usize;
            its_scene.tiles.deltas.find_or_make((selection, since, version), most_bytes, || delta.clone());
        }
        Ok(delta)
    };
    app.compute.draw(work).await?
}

fn gone(layer: &str) -> Problem {
    Problem::field(Kind::InvalidQuery, "layer", format!("the light map has lost its layer {layer:?}"))
}
