//! The whole light map as a file.

use std::borrow::Cow;

use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use glam::Vec3;
use rebake_core::delta::{self, Frame};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::coding::encode_body;
use super::elements::VERSION;
use super::extract::{ApiPath, ApiQuery, Coding, ETags, first_named};
use super::layers;
use super::problem::{ApiResult, Kind, Problem};
use super::types::PartName;
use super::{Shared, etag, find_scene};
use crate::engine;
use crate::store::versions::{Published, Wanted};

/// File formats of a light map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum Format {
    /// OpenEXR picture, 32-bit float.
    Exr,
    /// The subdivided mesh, the light map as float `COLOR_0`.
    Glb,
    /// Delta format, from version 0.
    Raw,
}

impl Format {
    fn content_type(self) -> &'static str {
        match self {
            Format::Exr => "image/x-exr",
            Format::Glb => "model/gltf-binary",
            Format::Raw => delta::CONTENT_TYPE,
        }
    }

    /// The first format that the client names; `raw` where it names none.
    fn accepted(headers: &HeaderMap) -> Format {
        let formats = [Format::Exr, Format::Glb, Format::Raw];
        first_named(headers, formats, Format::content_type).unwrap_or(Format::Raw)
    }
}

/// What to fetch.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct LightmapQuery {
    /// File format; by `Accept`, else `raw`, where absent.
    #[param(inline)]
    format: Option<Format>,
    /// `full`, `direct` or `indirect`: that part of all light; the scene's mode where absent. The name of a layer
    /// (between double quotes where it is one of these words): its light at reference strengths. `all`: every layer,
    /// its direct and indirect light apart, in a picture with channels `<layer>.direct.R` and so on.
    #[param(example = "ceiling")]
    layer: Option<String>,
    /// Which part, of all light or of a layer; the scene's mode where absent.
    #[param(inline)]
    part: Option<PartName>,
}

/// The whole light map.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/lightmap", tag = "light map", operation_id = "get_lightmap",
    params(
        ("scene" = String, Path, description = "The scene's id"),
        LightmapQuery,
        ("If-None-Match" = Option<String>, Header, description = "The version that the client has"),
    ),
    responses(
        (status = 200, description = "The light map", headers(("ETag" = String, description = "The version")),
            content((Vec<u8> = "application/vnd.rebake.delta"), (Vec<u8> = "image/x-exr"), (Vec<u8> = "model/gltf-binary"))),
        (status = 304, description = "The client has this version"),
    )
)]
pub(super) async fn get(
    State(app): Shared,
    ApiPath(id): ApiPath<String>,
    ApiQuery(query): ApiQuery<LightmapQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let scene = find_scene(&app, &id).await?;
    let published = scene.published();
    let known = ETags::from_header(&headers, &header::IF_NONE_MATCH)?;
    let version = published.version.to_string();
    let about = [
        (header::ETAG, etag(published.version)),
        (VERSION.clone(), version.clone()),
        (header::VARY, "accept, accept-encoding".to_owned()),
    ];
    let format = query.format.unwrap_or_else(|| Format::accepted(&headers));
    let chosen = choose(&published, &query, format)?;
    if known.is_some_and(|tags| tags.matches_weakly(&version)) {
        return Ok((StatusCode::NOT_MODIFIED, about).into_response());
    }
    let coding = Coding::accepted(&headers);
    let encode = move || {
        let file = file(&published, format, &chosen)?;
        encode_body(coding, file).map_err(|error| error.to_string())
    };
    let body = app.compute.answer(encode).await?.map_err(Problem::internal)?;
    Ok((about, [(header::CONTENT_TYPE, format.content_type())], coding.headers(), body).into_response())
}

/// The whole map's part, a layer's, or all layers.
enum Chosen {
    Map(Wanted),
    Layer(String, Wanted),
    All,
}

fn choose(published: &Published, query: &LightmapQuery, format: Format) -> ApiResult<Chosen> {
    let invalid = |field: &str, reason: &str| Err(Problem::field(Kind::InvalidQuery, field, reason));
    let part = query.part.map(Wanted::from);
    let mode = Wanted::Light(published.mode());
    match query.layer.as_deref().map(|text| layers::choose(published, text)).transpose()? {
        None => Ok(Chosen::Map(part.unwrap_or(mode))),
        Some(layers::Chosen::Layer(name)) => Ok(Chosen::Layer(name, part.unwrap_or(mode))),
        Some(_) if part.is_some() => invalid("part", "says the same as this `layer`, or otherwise: give one of them"),
        Some(layers::Chosen::Part(part)) => Ok(Chosen::Map(Wanted::Light(part))),
        Some(layers::Chosen::All) if format != Format::Exr => invalid("layer", "`all` has to come with `format=exr`"),
        Some(layers::Chosen::All) if published.layers.is_empty() => {
            invalid("layer", "the light map has no layers before a light is relit or lights are grouped")
        }
        Some(layers::Chosen::All) => Ok(Chosen::All),
    }
}

fn file(published: &Published, format: Format, chosen: &Chosen) -> Result<Vec<u8>, String> {
    let version = published.version.to_string();
    let mut about = vec![("lightMapVersion", version.as_str())];
    let (values, weight);
    match chosen {
        Chosen::All => {
            let layers = layers::to_json(published);
            return engine::layers_exr(&published.map.layers, &[about[0], ("lightMapLayers", &layers)]);
        }
        Chosen::Map(wanted) => {
            values = published.deliver(*wanted);
            about.push(("lightMapLayer", wanted.as_str()));
        }
        Chosen::Layer(name, wanted) => {
            values = published.deliver_layer(name, *wanted).ok_or("the layer is gone")?;
            let layer = published.layer(name).ok_or("the layer is gone")?;
            weight = layer.weight.to_array().map(|w| w.to_string()).join(" ");
            about.extend([
                ("lightMapLayer", name.as_str()),
                ("lightMapPart", wanted.as_str()),
                ("lightMapWeight", &weight),
            ]);
        }
    }
    match format {
        Format::Exr => engine::lightmap_exr(&values, &about),
        Format::Glb => engine::lightmap_glb(&published.world, &finite(&values)),
        Format::Raw => Ok(Frame::whole(&values, published.version).encode()),
    }
}

/// glTF holds finite numbers only.
fn finite(values: &[Vec3]) -> Cow<'_, [Vec3]> {
    match values.iter().all(|value| value.is_finite()) {
        true => values.into(),
        false => values.iter().map(|value| value.min(Vec3::MAX)).collect(),
    }
}
