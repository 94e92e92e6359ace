//! The whole light map as a file.

use std::borrow::Cow;
use std::sync::Arc;

use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use glam::Vec3;
use rebake_core::delta::{self, Frame};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::coding::encode_body;
use super::computed;
use super::extract::{ApiPath, ApiQuery, Coding, first_named};
use super::filter::view;
use super::glb::{self, GlbLayout};
use super::layers;
use super::problem::{ApiResult, Kind, Problem};
use super::types::PartName;
use super::versioned::Versioned;
use super::{Shared, find_scene};
use crate::bands;
use crate::engine;
use crate::filter::Filter;
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
    /// The scene as glTF, with its light map.
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
    /// Of `glb`, which has the hierarchy, names, materials, textures, lights and cameras of the files as edits have
    /// left them. `vertices`: subdivided meshes, the light map times vertex colours as float `COLOR_0`; where that
    /// changes it, as `_LIGHT` too. `atlas`: the meshes as they are, `TEXCOORD_1` on the pages of the
    /// atlas, and those as `MOZ_lightmap` of the materials: 8-bit sRGB pictures over the `gain` of
    /// `asset.extras.light_map`. As the scene was uploaded where absent; by vertices then surfaces alone, with vertices in
    /// the order of the elements.
    #[param(inline)]
    layout: Option<GlbLayout>,
    /// Of `glb`: viewers without lights show it. By vertices materials are `KHR_materials_unlit` and `COLOR_0` at most 1; by texels those that
    /// do not shine by themselves have the light map times their mean albedo as their emission, which readers of
    /// `MOZ_lightmap` do not want. Where absent: `false` by vertices, `true` by texels.
    unlit: Option<bool>,
    /// `full`, `direct` or `indirect`: that part of all light; the scene's mode where absent. The name of a layer
    /// (between double quotes where it is one of these words): its light at reference strengths. `all`: every layer,
    /// its direct and indirect light apart, in a picture with channels `<layer>.direct.R` and so on.
    #[param(example = "ceiling")]
    layer: Option<String>,
    /// Which part, of all light or of a layer; the scene's mode where absent.
    #[param(inline)]
    part: Option<PartName>,
    /// Whether noise is averaged away where it may be; `statistical` for `glb` and `none` for others where absent.
    #[param(inline)]
    filter: Option<Filter>,
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
            ("X-Rebake-Version" = String, description = "Version of the light map"),
            ("X-Rebake-Ao-Distance" = f32, description = "Of `part=ao`: metres"),
            ("X-Rebake-Estimated-Rmse" = f32, description = "Stated error of what is delivered, where it is known")),
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
    let mut versioned = Versioned::of_light(&published, &headers, Some("accept, accept-encoding"))?;
    let format = query.format.unwrap_or_else(|| Format::accepted(&headers));
    let chosen = choose(&published, query.layer.as_deref(), query.part, query.ao_distance)?;
    check_all(&published, &chosen, format)?;
    if query.layout.is_some() && format != Format::Glb {
        return Err(Problem::field(Kind::InvalidQuery, "layout", "goes with format=glb"));
    }
    if query.unlit.is_some() && format != Format::Glb {
        return Err(Problem::field(Kind::InvalidQuery, "unlit", "goes with format=glb"));
    }
    if versioned.is_known {
        return Ok(versioned.not_modified());
    }
    let default = if format == Format::Glb { Filter::Statistical } else { Filter::None };
    let published = light_view(&app, &scene, published, &chosen, (query.filter, default)).await?;
    let chosen = computed::computed(&app, &scene, &published, chosen).await?;
    match &chosen {
        Chosen::Computed(part) => versioned.about.extend(computed::headers(part)?),
        Chosen::Map(wanted) => versioned.state_error(&published, *wanted)?,
        _ => {}
    }
    let about = versioned.about;
    let coding = Coding::accepted(&headers);
    if format == Format::Glb {
        let wish = glb::Wish { layout: query.layout, unlit: query.unlit };
        let body = glb::glb(&app, &scene, published, (chosen, wish), coding).await?;
        return Ok((about, [(header::CONTENT_TYPE, format.content_type())], coding.headers(), body).into_response());
    }
    let encode = move || {
        let file = file(&published, format == Format::Exr, &chosen)?;
        encode_body(coding, file).map_err(|error| error.to_string())
    };
    let body = app.compute.answer(encode).await?.map_err(Problem::internal)?;
    Ok((about, [(header::CONTENT_TYPE, format.content_type())], coding.headers(), body).into_response())
}

/// The version that light is taken of, filtered as a client asks for it or else by `default`; of what is no light, the
/// one that is stored.
pub(super) async fn light_view(
    app: &Arc<App>,
    scene: &SceneEntry,
    published: Arc<Published>,
    chosen: &Chosen,
    (asked, default): (Option<Filter>, Filter),
) -> ApiResult<Arc<Published>> {
    let filter = match (chosen, asked) {
        (Chosen::Wanted(_), Some(Filter::Statistical)) => {
            return Err(Problem::field(Kind::InvalidQuery, "filter", "goes with parts of light"));
        }
        (Chosen::Wanted(_), _) => Filter::None,
        (_, asked) => asked.unwrap_or(default),
    };
    view(app, &scene.filtered, published, filter).await
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
    if published.is_filtered {
        about.push(("lightMapFilter", "statistical".to_owned()));
    }
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

/// As a picture, or in the delta format.
fn file(published: &Published, is_picture: bool, chosen: &Chosen) -> Result<Vec<u8>, String> {
    if matches!(chosen, Chosen::All) {
        let (version, layers) = (published.version.to_string(), layers::to_json(published));
        let about = [("lightMapVersion", version.as_str()), ("lightMapLayers", &layers)];
        return engine::layers_exr(&published.map.layers, &about);
    }
    if let Chosen::Computed(part) = chosen
        && part.bands.len() > 1
    {
        return bands::file(part, published.version, is_picture);
    }
    let (values, about) = values(published, chosen)?;
    let about: Vec<(&str, &str)> = about.iter().map(|(name, text)| (*name, text.as_str())).collect();
    match is_picture {
        true => engine::lightmap_exr(&values, &about),
        false => Ok(Frame::whole(&values, published.version).encode()),
    }
}

/// glTF holds finite numbers only.
pub(super) fn finite(values: &[Vec3]) -> Cow<'_, [Vec3]> {
    match values.iter().all(|value| value.is_finite()) {
        true => values.into(),
        false => values.iter().map(|value| value.min(Vec3::MAX)).collect(),
    }
}
