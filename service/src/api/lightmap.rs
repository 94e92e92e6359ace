//! The whole light map as a file.

use std::borrow::Cow;
use std::sync::Arc;

use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use glam::Vec3;
use rebake_core::delta::{self, Frame};
use rebake_core::export::AtlasAbout;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::atlas::{BYTES_PER_TEXEL, atlas_of};
use super::coding::encode_body;
use super::computed;
use super::extract::{ApiPath, ApiQuery, Coding, first_named};
use super::layers;
use super::problem::{ApiResult, Kind, Problem};
use super::types::PartName;
use super::uploads::memory_problem;
use super::versioned::Versioned;
use super::{Shared, find_scene};
use crate::bands;
use crate::engine;
use crate::pictures::Watch;
use crate::state::App;
use crate::store::computed::ComputedPart;
use crate::store::scene::SceneEntry;
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

/// How a light map is laid out in glTF.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum GlbLayout {
    /// By element: the subdivided mesh.
    Vertices,
    /// By texel: objects as they are, with `TEXCOORD_1` on pages of the atlas.
    Atlas,
}

/// What to fetch.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct LightmapQuery {
    /// File format; by `Accept`, else `raw`, where absent.
    #[param(inline)]
    format: Option<Format>,
    /// Of `glb`: `vertices`, or `atlas`, objects with their own triangles, `TEXCOORD_1` on the pages of the atlas, and
    /// those as 8-bit sRGB pictures over the `gain` of `asset.extras.light_map`. As the scene was uploaded where absent.
    #[param(inline)]
    layout: Option<GlbLayout>,
    /// `full`, `direct` or `indirect`: that part of all light; the scene's mode where absent. The name of a layer
    /// (between double quotes where it is one of these words): its light at reference strengths. `all`: every layer,
    /// its direct and indirect light apart, in a picture with channels `<layer>.direct.R` and so on.
    #[param(example = "ceiling")]
    layer: Option<String>,
    /// Which part, of all light or of a layer; the scene's mode where absent.
    #[param(inline)]
    part: Option<PartName>,
    /// Of `part=ao`: what lies farther away hides nothing, metres; a fifth of the scene's radius where absent.
    #[param(example = 0.5)]
    ao_distance: Option<f32>,
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
        (status = 200, description = "The light map", headers(("ETag" = String, description = "The version"),
            ("X-Rebake-Ao-Distance" = f32, description = "Of `part=ao`: metres"),
            ("X-Rebake-Error" = f32, description = "Of `part=ao`: stated error, area-weighted RMSE")),
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
    let versioned = Versioned::of_light(&published, &headers, Some("accept, accept-encoding"))?;
    let format = query.format.unwrap_or_else(|| Format::accepted(&headers));
    let chosen = choose(&published, query.layer.as_deref(), query.part, query.ao_distance)?;
    check_all(&published, &chosen, format)?;
    if query.layout.is_some() && format != Format::Glb {
        return Err(Problem::field(Kind::InvalidQuery, "layout", "goes with format=glb"));
    }
    if versioned.is_known {
        return Ok(versioned.not_modified());
    }
    let chosen = computed::computed(&app, &scene, &published, chosen).await?;
    let mut about = versioned.about;
    if let Chosen::Computed(part) = &chosen {
        about.extend(computed::headers(part)?);
    }
    let coding = Coding::accepted(&headers);
    let default = if published.world.atlas().is_some() { GlbLayout::Atlas } else { GlbLayout::Vertices };
    if format == Format::Glb && query.layout.unwrap_or(default) == GlbLayout::Atlas {
        let body = atlas_glb(&app, &scene, published, chosen, coding).await?;
        return Ok((about, [(header::CONTENT_TYPE, format.content_type())], coding.headers(), body).into_response());
    }
    let encode = move || {
        let file = file(&published, format, &chosen)?;
        encode_body(coding, file).map_err(|error| error.to_string())
    };
    let body = app.compute.answer(encode).await?.map_err(Problem::internal)?;
    Ok((about, [(header::CONTENT_TYPE, format.content_type())], coding.headers(), body).into_response())
}

/// Objects with their places in the atlas, and its pages.
async fn atlas_glb(
    app: &Arc<App>,
    scene: &Arc<SceneEntry>,
    published: Arc<Published>,
    chosen: Chosen,
    coding: Coding,
) -> ApiResult<Bytes> {
    let atlas = atlas_of(app, scene, &published).await?;
    let texels: u64 = atlas.pages().iter().map(|page| u64::from(page.width) * u64::from(page.height)).sum();
    let (watch, its_app) = (Watch::default(), Arc::clone(app));
    let _guard = watch.guard();
    let turn = app.pictures.turns.clone().acquire_owned().await.map_err(Problem::internal)?;
    let work = move || {
        let _turn = turn;
        let promise = its_app.promise_memory(texels * BYTES_PER_TEXEL, 0);
        let _promise = promise.map_err(|full| memory_problem("file", full))?;
        let (values, _) = values(&published, &chosen).map_err(Problem::internal)?;
        let about = AtlasAbout { version: published.version, estimated_rmse: published.estimated_rmse };
        let file = engine::atlas_glb((&published.world, &atlas), &values, &about, &watch).map_err(Problem::internal)?;
        encode_body(coding, file).map_err(Problem::internal)
    };
    app.compute.draw(work).await?
}

/// The whole map's part, a layer's, or all layers.
pub(super) enum Chosen {
    Map(Wanted),
    Layer(String, Wanted),
    All,
    /// What is no light, before it is computed …
    Wanted(computed::Wanted),
    /// … and after.
    Computed(Arc<ComputedPart>),
}

/// What the query parameters `layer`, `part` and `ao_distance` say.
pub(super) fn choose(
    published: &Published,
    layer: Option<&str>,
    part: Option<PartName>,
    ao_distance: Option<f32>,
) -> ApiResult<Chosen> {
    let invalid = |field: &str, reason: &str| Err(Problem::field(Kind::InvalidQuery, field, reason));
    let has_ao = part == Some(PartName::Ao);
    computed::check_distance(ao_distance, has_ao)?;
    let part = match part.map(PartName::of_light) {
        Some(None) if layer.is_some() => return invalid("layer", "goes with parts of light"),
        Some(None) if has_ao => return Ok(Chosen::Wanted(computed::Wanted::Occlusion(ao_distance))),
        Some(None) => return Ok(Chosen::Wanted(computed::Wanted::Directional)),
        Some(part) => part,
        None => None,
    };
    let mode = Wanted::Light(published.mode());
    match layer.map(|text| layers::choose(published, text)).transpose()? {
        None => Ok(Chosen::Map(part.unwrap_or(mode))),
        Some(layers::Chosen::Layer(name)) => Ok(Chosen::Layer(name, part.unwrap_or(mode))),
        Some(_) if part.is_some() => invalid("part", "says the same as this `layer`, or otherwise: give one of them"),
        Some(layers::Chosen::Part(part)) => Ok(Chosen::Map(Wanted::Light(part))),
        Some(layers::Chosen::All) => Ok(Chosen::All),
    }
}

fn check_all(published: &Published, chosen: &Chosen, format: Format) -> ApiResult<()> {
    let invalid = |reason: &str| Err(Problem::field(Kind::InvalidQuery, "layer", reason));
    match chosen {
        Chosen::All if format != Format::Exr => invalid("`all` has to come with `format=exr`"),
        Chosen::All if published.layers.is_empty() => {
            invalid("the light map has no layers before a light is relit or lights are grouped")
        }
        Chosen::Wanted(computed::Wanted::Directional) if format == Format::Glb => {
            let reason = "glb has one colour per vertex: part=directional comes as exr or raw";
            Err(Problem::field(Kind::InvalidQuery, "format", reason))
        }
        _ => Ok(()),
    }
}

/// What is sent, with a name and a text for each thing that a file says of itself.
type Described<'a> = (Cow<'a, [Vec3]>, Vec<(&'static str, String)>);

/// One value per slot of what was chosen, and what it is; an error where that is all layers, or one that is gone.
pub(super) fn values<'a>(published: &'a Published, chosen: &'a Chosen) -> Result<Described<'a>, String> {
    let mut about = vec![("lightMapVersion", published.version.to_string())];
    let values = match chosen {
        Chosen::All => return Err("several layers have no single values".to_owned()),
        Chosen::Wanted(_) => return Err("the part is not computed yet".to_owned()),
        Chosen::Computed(part) => {
            about.extend(part.about.iter().cloned());
            let [(_, values)] = &part.bands[..] else { return Err("several bands have no single values".to_owned()) };
            values.into()
        }
        Chosen::Map(wanted) => {
            about.push(("lightMapLayer", wanted.as_str().to_owned()));
            published.deliver(*wanted)
        }
        Chosen::Layer(name, wanted) => {
            let layer = published.layer(name).ok_or("the layer is gone")?;
            let weight = layer.weight.to_array().map(|w| w.to_string()).join(" ");
            let part = wanted.as_str().to_owned();
            about.extend([("lightMapLayer", name.clone()), ("lightMapPart", part), ("lightMapWeight", weight)]);
            published.deliver_layer(name, *wanted).ok_or("the layer is gone")?
        }
    };
    Ok((values, about))
}

fn file(published: &Published, format: Format, chosen: &Chosen) -> Result<Vec<u8>, String> {
    if matches!(chosen, Chosen::All) {
        let (version, layers) = (published.version.to_string(), layers::to_json(published));
        let about = [("lightMapVersion", version.as_str()), ("lightMapLayers", &layers)];
        return engine::layers_exr(&published.map.layers, &about);
    }
    if let Chosen::Computed(part) = chosen
        && part.bands.len() > 1
    {
        return bands::file(part, published.version, format == Format::Exr);
    }
    let (values, about) = values(published, chosen)?;
    let about: Vec<(&str, &str)> = about.iter().map(|(name, text)| (*name, text.as_str())).collect();
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
