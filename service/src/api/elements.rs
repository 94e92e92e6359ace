//! What the entries of a light map stand for.

use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};

use super::coding::encode_body;
use super::extract::{ApiPath, Coding};
use super::problem::{ApiResult, Problem};
use super::versioned::Versioned;
use super::{Shared, find_scene};
use crate::engine;

/// Position, normal, area and object of every element: 32 bytes each, little-endian `f32` position x y z, normal
/// x y z, area, `u32` object index. Holes that removed objects left have area 0 and index 4294967295.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/elements", tag = "light map", operation_id = "get_elements",
    params(
        ("scene" = String, Path, description = "The scene's id"),
        ("If-None-Match" = Option<String>, Header, description = "The `ETag` that the client has"),
    ),
    responses(
        (status = 200, body = Vec<u8>, content_type = "application/octet-stream", description = "The elements",
            headers(("ETag" = String, description = "`elements_version` of the scene"),
                ("X-Rebake-Version" = String, description = "Version of the light map these elements go with"))),
        (status = 304, description = "The client has them"),
    )
)]
pub(super) async fn get(State(app): Shared, ApiPath(id): ApiPath<String>, headers: HeaderMap) -> ApiResult<Response> {
    let published = find_scene(&app, &id).await?.published();
    let versioned = Versioned::of_elements(&published, &headers, Some("accept-encoding"))?;
    if versioned.is_known {
        return Ok(versioned.not_modified());
    }
    let coding = Coding::accepted(&headers);
    let encode = move || encode_body(coding, engine::element_records(&published.world));
    let bytes = app.compute.run(encode).await?.map_err(Problem::internal)?;
    let kind = [(header::CONTENT_TYPE, "application/octet-stream")];
    Ok((versioned.about, kind, coding.headers(), bytes).into_response())
}
