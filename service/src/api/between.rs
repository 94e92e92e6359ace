//! What changed between two versions, for caches: it never changes.

use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use rebake_core::delta;

use super::coding::encode_body;
use super::extract::{ApiPath, Coding, ETags};
use super::problem::{ApiResult, Kind, Problem};
use super::versioned::{ESTIMATED_RMSE, VERSION};
use super::{Shared, find_scene};
use crate::state::App;
use crate::store::deltas::KeptDelta;
use crate::store::scene::SceneEntry;
use crate::store::versions::Published;

/// Deltas that are kept take this many times the bytes of the map's values.
const KEPT_MAPS: usize = 4;

/// What changed from one version to another, as one frame of full precision; from version 0 it is the whole map, and
/// between equal versions it is empty. The answer never changes, so that caches may keep it for good. It is made while
/// `to` is the scene's present version; one from another version than 0 is kept for a while after. Where it is not kept
/// any more (410), ask for the one to the present version.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/lightmap/deltas/{from}-{to}", tag = "light map", operation_id = "get_delta_between",
    params(
        ("scene" = String, Path, description = "The scene's id"),
        ("from" = u64, Path, description = "The version that the client has; 0 for nothing", example = 3),
        ("to" = u64, Path, description = "The version that it wants", example = 7),
        ("If-None-Match" = Option<String>, Header, description = "The `ETag` that the client has"),
    ),
    responses(
        (status = 200, body = Vec<u8>, content_type = "application/vnd.rebake.delta", description = "One frame, or none",
            headers(
                ("Cache-Control" = String, description = "A year, `immutable`; `private` where the service asks for tokens"),
                ("ETag" = String, description = "Both versions, and the coding"),
                ("X-Rebake-Version" = String, description = "`to`"),
                ("X-Rebake-Estimated-Rmse" = String, description = "Stated error of the light map at `to`; absent where nothing is known of it, and between equal versions"),
            )),
        (status = 304, description = "The client has it"),
    )
)]
pub(super) async fn get(
    State(app): Shared,
    ApiPath((id, versions)): ApiPath<(String, String)>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let scene = find_scene(&app, &id).await?;
    let (from, to) = read_versions(&versions)?;
    let published = scene.published();
    let found = find(&published, (from, to), || scene.deltas.find(&(from, to)))?;
    let Immutable { about, coding, is_known } = Immutable::new(&app, &headers, &versions, to)?;
    if is_known {
        return Ok((StatusCode::NOT_MODIFIED, about).into_response());
    }
    let encode = move || {
        let KeptDelta { frame, stated } = found.unwrap_or_else(|| make(&scene, &published, from));
        encode_body(coding, frame).map(|body| (body, stated))
    };
    let (body, stated) = app.compute.answer(encode).await?.map_err(Problem::internal)?;
    let stated = stated.map(|stated| [(ESTIMATED_RMSE.clone(), stated.to_string())]);
    app.metrics.delta_bytes.inc_by(body.len() as u64);
    Ok((about, stated, [(header::CONTENT_TYPE, delta::CONTENT_TYPE)], coding.headers(), body).into_response())
}

/// How what leads from one version to another is answered: caches may keep it for good.
pub(super) struct Immutable {
    pub(super) about: [(HeaderName, String); 4],
    pub(super) coding: Coding,
    /// The client has it.
    pub(super) is_known: bool,
}

impl Immutable {
    /// `versions`: as they stand in the path, up to `to`.
    pub(super) fn new(app: &App, headers: &HeaderMap, versions: &str, to: u64) -> ApiResult<Immutable> {
        let coding = Coding::accepted(headers);
        // A strong tag is one of bytes: each coding has its own.
        let tag = coding.header_value().map_or_else(|| versions.to_owned(), |coding| format!("{versions}-{coding}"));
        // What needs a token is nothing for a cache that others share.
        let caches = if app.config.tokens.is_some() { "private" } else { "public" };
        let about = [
            (header::ETAG, format!("\"{tag}\"")),
            (header::CACHE_CONTROL, format!("{caches}, max-age=31536000, immutable")),
            (VERSION.clone(), to.to_string()),
            (header::VARY, "accept-encoding".to_owned()),
        ];
        let tags = ETags::from_header(headers, &header::IF_NONE_MATCH)?;
        Ok(Immutable { about, coding, is_known: tags.is_some_and(|tags| tags.matches_weakly(&tag)) })
    }
}

/// A delta that is known already: empty between equal versions, else what `kept` finds; none where it is to be made from
/// the present version.
pub(super) fn find(
    published: &Published,
    (from, to): (u64, u64),
    kept: impl FnOnce() -> Option<KeptDelta>,
) -> ApiResult<Option<KeptDelta>> {
    let present = published.version;
    if to > present {
        let text = format!("{from}-{to}: the light map is at version {present}, not yet at {to}");
        return Err(Problem::new(Kind::UnknownVersion, text));
    }
    let forgotten = || {
        let text = format!("{from}-{to}: not kept any more; the light map is at version {present}");
        Problem::new(Kind::VersionForgotten, text)
    };
    if !(published.knows(from) && published.knows(to)) {
        // Lost in a crash: no client had it, or it starts over.
        return Err(forgotten());
    }
    if from == to {
        return Ok(Some(KeptDelta { frame: Bytes::new(), stated: None }));
    }
    if to == present {
        return Ok(None);
    }
    kept().map(Some).ok_or_else(forgotten)
}

fn make(scene: &SceneEntry, published: &Published, from: u64) -> KeptDelta {
    let make = || KeptDelta { frame: published.delta(from).encode().into(), stated: published.stated_rmse() };
    // Whole maps would push out what changes between them, and who has nothing asks for the newest as well.
    if from == 0 {
        return make();
    }
    let most_bytes = KEPT_MAPS * size_of_val(published.values());
    scene.deltas.find_or_make((from, published.version), most_bytes, make)
}

/// One spelling of each pair: caches take another for something else.
pub(super) fn read_versions(text: &str) -> ApiResult<(u64, u64)> {
    let parsed = text.split_once('-').and_then(|(from, to)| Some((from.parse::<u64>().ok()?, to.parse::<u64>().ok()?)));
    let parsed = parsed.filter(|(from, to)| from <= to && format!("{from}-{to}") == text);
    let text = || format!("{text:?} is not {{from}}-{{to}}, two versions of which the first is not above the second");
    parsed.ok_or_else(|| Problem::new(Kind::BadRequest, text()))
}
