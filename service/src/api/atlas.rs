//! Atlases: where objects lie on pages of texels, and the pages.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use rebake_core::export::Precision;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::extract::{ApiPath, ApiQuery};
use super::lightmap::{self, Chosen};
use super::problem::{ApiResult, Kind, Problem};
use super::types::PartName;
use super::uploads::memory_problem;
use super::versioned::Versioned;
use super::{Shared, find_scene};
use super::{atlas_deltas, computed};
use crate::bands;
use crate::config::Limits;
use crate::engine::{self, Atlas, AtlasError, AtlasOptions, AtlasPicture, Canceled, World};
use crate::filter::Filter;
use crate::pictures::Watch;
use crate::state::App;
use crate::store::records::StoredAtlas;
use crate::store::scene::SceneEntry;
use crate::store::tiles::Selection;
use crate::store::versions::Published;
use crate::tiles::hashes;

/// Bytes per texel of a page while it is made and written.
pub(super) const BYTES_PER_TEXEL: u64 = 64;

/// How a light map is delivered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum LayoutName {
    /// By element.
    Vertices,
    /// By texel, too.
    Atlas,
}

/// The atlas that an upload asks for.
pub(super) fn asked_for(
    layout: Option<LayoutName>,
    texels_per_metre: Option<f32>,
    limits: &Limits,
) -> ApiResult<Option<AtlasOptions>> {
    let invalid = |reason: &str| Err(Problem::field(Kind::InvalidQuery, "texels_per_metre", reason));
    match (layout, texels_per_metre) {
        (_, Some(density)) if !(density.is_finite() && density > 0.0) => invalid("has to be a finite number above 0"),
        (Some(LayoutName::Vertices), Some(_)) => invalid("goes with layout=atlas"),
        (Some(LayoutName::Vertices) | None, None) => Ok(None),
        _ => Ok(Some(AtlasOptions { texels_per_metre, max_texels: limits.atlas_texels })),
    }
}

/// What the atlas of a new scene is made by, whose elements are `spacing` metres apart.
pub(super) fn stored(spacing: f32, asked: Option<AtlasOptions>) -> Option<StoredAtlas> {
    let AtlasOptions { texels_per_metre, max_texels } = asked?;
    Some(StoredAtlas { texels_per_metre: texels_per_metre.unwrap_or(spacing.recip()), max_texels })
}

/// Where the objects of a scene lie in its atlas.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct AtlasDocument {
    /// Version of the light map.
    #[schema(example = 7)]
    pub version: u64,
    /// Texels per metre of surface that were asked for; one per spacing of the elements where the upload did not say.
    #[schema(example = 20.0)]
    pub texels_per_metre: f32,
    /// The pages.
    pub pages: Vec<AtlasPage>,
    /// Objects with a surface, in the order of the scene.
    pub objects: Vec<AtlasObject>,
}

/// A page.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct AtlasPage {
    /// Texels across.
    #[schema(example = 1024)]
    pub width: u32,
    /// Texels down.
    #[schema(example = 1024)]
    pub height: u32,
}

/// Where an object lies. Coordinates on the page are texcoord × scale + offset, from 0 to 1, origin top left.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct AtlasObject {
    /// Its name.
    #[schema(example = "sofa")]
    pub object: String,
    /// Index of its page.
    #[schema(example = 0)]
    pub page: u32,
    /// Factor on its coordinates.
    #[schema(example = json!([0.12, 0.08]))]
    pub scale: [f64; 2],
    /// What is added.
    #[schema(example = json!([0.5, 0.25]))]
    pub offset: [f64; 2],
    /// Whose coordinates they are.
    pub texcoord: AtlasTexcoord,
    /// Texels per metre of its surface: fewer than asked for where it would be larger than a page.
    #[schema(example = 20.0)]
    pub texels_per_metre: f32,
    /// Where the back of its surface lies, where that has light of its own; by the same coordinates.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub back: Option<AtlasPlace>,
}

/// A place on a page.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct AtlasPlace {
    /// Index of the page.
    pub page: u32,
    /// Factor on coordinates.
    pub scale: [f64; 2],
    /// What is added.
    pub offset: [f64; 2],
}

/// Whose coordinates an object has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum AtlasTexcoord {
    /// `TEXCOORD_1` of the file.
    File,
    /// Made by the service: the file has none that can be used. `lightmap?format=glb&layout=atlas` has them.
    Made,
}

impl AtlasDocument {
    /// Tells an atlas of a world.
    pub fn new(world: &World, atlas: &Atlas, version: u64) -> AtlasDocument {
        let pages = atlas.pages();
        let objects = world.scene.objects.iter().filter_map(|object| {
            let entry = atlas.entry(&object.name)?;
            let place = |rectangle: &rebake_core::atlas::Rectangle| {
                let (scale, offset) = entry.to_page(rectangle, pages[rectangle.page]);
                AtlasPlace { page: rectangle.page as u32, scale: scale.to_array(), offset: offset.to_array() }
            };
            let AtlasPlace { page, scale, offset } = place(&entry.front);
            let texcoord = match entry.coordinates() {
                rebake_core::atlas::Coordinates::File => AtlasTexcoord::File,
                rebake_core::atlas::Coordinates::Made => AtlasTexcoord::Made,
            };
            let (object, texels_per_metre) = (object.name.clone(), entry.texels_per_metre());
            let back = entry.back.as_ref().map(place);
            Some(AtlasObject { object, page, scale, offset, texcoord, texels_per_metre, back })
        });
        AtlasDocument {
            version,
            texels_per_metre: atlas.texels_per_metre(),
            objects: objects.collect(),
            pages: pages.iter().map(|page| AtlasPage { width: page.width, height: page.height }).collect(),
        }
    }
}

/// Where objects lie on the pages of the scene's atlas. Scenes that were uploaded with `layout=atlas` keep every
/// rectangle where it is while its object is there and has its size, across restarts too; of others an atlas is made
/// when it is first asked for, and again after a restart.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/atlas", tag = "light map", operation_id = "get_atlas",
    params(
        ("scene" = String, Path, description = "The scene's id"),
        ("If-None-Match" = Option<String>, Header, description = "The version that the client has"),
    ),
    responses(
        (status = 200, body = AtlasDocument, description = "Its pages and where objects lie", headers(("ETag" = String, description = "The version"),
            ("X-Rebake-Version" = String, description = "Version of the light map"))),
        (status = 304, description = "The client has this version"),
    )
)]
pub(super) async fn get(State(app): Shared, ApiPath(id): ApiPath<String>, headers: HeaderMap) -> ApiResult<Response> {
    let scene = find_scene(&app, &id).await?;
    let published = scene.published();
    let versioned = Versioned::of_light(&published, &headers, None)?;
    if versioned.is_known {
        return Ok(versioned.not_modified());
    }
    let atlas = atlas_of(&app, &scene, &published).await?;
    let document = AtlasDocument::new(&published.world, &atlas, published.version);
    Ok((versioned.about, Json(document)).into_response())
}

/// File formats of a page.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum PageFormat {
    /// OpenEXR: `R`, `G`, `B`, and `valid`, 1 where a texel was read from a surface and 0 where it is filled or empty.
    #[default]
    Exr,
    /// 8-bit sRGB with automatic exposure, to look at.
    Png,
    /// KTX2, linear RGBA float without compression: alpha is 1 where a texel was read from a surface. Parts of several bands
    /// are the layers of an array.
    Ktx2,
}

/// How exact the numbers of an OpenEXR or KTX2 page are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum PagePrecision {
    /// 16-bit float.
    #[default]
    Half,
    /// 32-bit float.
    Float,
}

/// What of a page to fetch.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct PageQuery {
    /// File format; `exr` where absent.
    #[param(inline)]
    format: Option<PageFormat>,
    /// Of `exr` and `ktx2`; `half` where absent.
    #[param(inline)]
    precision: Option<PagePrecision>,
    /// `full`, `direct` or `indirect`: that part of all light; the scene's mode where absent. The name of a layer
    /// (between double quotes where it is one of these words): its light at reference strengths.
    #[param(example = "ceiling")]
    layer: Option<String>,
    /// Which part, of all light or of a layer; the scene's mode where absent. An error is that of the elements, interpolated:
    /// no less than that of the light between them.
    #[param(inline)]
    part: Option<PartName>,
    /// Whether noise is averaged away where it may be; `statistical` where absent.
    #[param(inline)]
    filter: Option<Filter>,
    /// Of `part=ao`: what lies farther away hides nothing, metres; a fifth of the scene's radius where absent.
    #[param(example = 0.5)]
    ao_distance: Option<f32>,
}

/// A page of the scene's atlas: irradiance / π, linear RGB, read from the elements at the centres of texels and filled
/// at least four texels past the edges of surfaces.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/atlas/{page}", tag = "light map", operation_id = "get_atlas_page",
    params(
        ("scene" = String, Path, description = "The scene's id"),
        ("page" = u32, Path, description = "Index of the page"),
        PageQuery,
        ("If-None-Match" = Option<String>, Header, description = "The version that the client has"),
    ),
    responses(
        (status = 200, description = "The page", headers(("ETag" = String, description = "The version"),
            ("X-Rebake-Version" = String, description = "Version of the light map"),
            ("X-Rebake-Exposure" = f32, description = "Stops of a PNG"),
            ("X-Rebake-Ao-Distance" = f32, description = "Of `part=ao`: metres"),
            ("X-Rebake-Estimated-Rmse" = f32, description = "Stated error of what is delivered, where it is known")),
            content((Vec<u8> = "image/x-exr"), (Vec<u8> = "image/png"), (Vec<u8> = "image/ktx2"))),
        (status = 304, description = "The client has this version"),
    )
)]
pub(super) async fn get_page(
    State(app): Shared,
    ApiPath((id, page)): ApiPath<(String, String)>,
    ApiQuery(query): ApiQuery<PageQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let scene = find_scene(&app, &id).await?;
    let published = scene.published();
    let mut versioned = Versioned::of_light(&published, &headers, None)?;
    let format = query.format.unwrap_or_default();
    if format == PageFormat::Png && query.precision.is_some() {
        return Err(Problem::field(Kind::InvalidQuery, "precision", "goes with format=exr and format=ktx2 only"));
    }
    let chosen = lightmap::choose(&published, query.layer.as_deref(), query.part, query.ao_distance)?;
    if matches!(chosen, Chosen::All) {
        return Err(Problem::field(Kind::InvalidQuery, "layer", "pages hold one layer each: `all` is not offered"));
    }
    if matches!(chosen, Chosen::Wanted(computed::Wanted::Directional)) && format == PageFormat::Png {
        return Err(Problem::field(Kind::InvalidQuery, "format", "has to be exr or ktx2 for part=directional"));
    }
    // What its deltas are told from.
    let followed = atlas_deltas::selection_of(&chosen, query.filter, query.precision);
    let followed = followed.filter(|_| format != PageFormat::Png);
    let atlas = atlas_of(&app, &scene, &published).await?;
    let pages = atlas.pages();
    let index = page.parse::<usize>().ok().filter(|index| *index < pages.len()).ok_or_else(|| {
        Problem::new(Kind::NotFound, format!("the atlas has {} pages, and no page {page:?}", pages.len()))
    })?;
    if versioned.is_known {
        return Ok(versioned.not_modified());
    }
    let published = lightmap::light_view(&app, &scene, published, &chosen, (query.filter, Filter::Statistical)).await?;
    let chosen = computed::computed(&app, &scene, &published, chosen).await?;
    match &chosen {
        Chosen::Computed(part) => versioned.about.extend(computed::headers(part)?),
        Chosen::Map(wanted) => versioned.state_error(&published, *wanted)?,
        _ => {}
    }
    let about = versioned.about;
    let bytes = u64::from(pages[index].width) * u64::from(pages[index].height) * BYTES_PER_TEXEL;
    let precision = match query.precision.unwrap_or_default() {
        PagePrecision::Half => Precision::Half,
        PagePrecision::Float => Precision::Float,
    };
    let (picture, kind) = match format {
        PageFormat::Png => (AtlasPicture::Png, "image/png"),
        PageFormat::Exr => (AtlasPicture::Exr(precision), "image/x-exr"),
        PageFormat::Ktx2 => (AtlasPicture::Ktx2(precision), "image/ktx2"),
    };
    let watch = Watch::default();
    let (_guard, its_app) = (watch.guard(), Arc::clone(&app));
    let turn = app.pictures.turns.clone().acquire_owned().await.map_err(Problem::internal)?;
    let page = PageWork { scene: Arc::clone(&scene), published, atlas, index, chosen, followed, picture, watch };
    let work = move || {
        let _turn = turn;
        let _promise = its_app.memory.promise(bytes, 0).map_err(|full| memory_problem("page", full))?;
        page.draw()
    };
    let (file, exposure) = app.compute.draw(work).await??;
    let mut response = (about, [(header::CONTENT_TYPE, kind)], file).into_response();
    if let Some(stops) = exposure {
        let value = header::HeaderValue::from_str(&stops.to_string()).map_err(Problem::internal)?;
        response.headers_mut().insert("x-rebake-exposure", value);
    }
    Ok(response)
}

/// A page that is to be drawn.
struct PageWork {
    scene: Arc<SceneEntry>,
    published: Arc<Published>,
    atlas: Arc<Atlas>,
    index: usize,
    chosen: Chosen,
    /// What its deltas are told from, where it has any.
    followed: Option<Selection>,
    picture: AtlasPicture,
    watch: Watch,
}

impl PageWork {
    /// The file, and the stops of its exposure where it is a PNG.
    fn draw(&self) -> ApiResult<(Vec<u8>, Option<f32>)> {
        let PageWork { published, atlas, index, chosen, picture, watch, .. } = self;
        let file = match *picture {
            AtlasPicture::Exr(precision) => Some((precision, false)),
            AtlasPicture::Ktx2(precision) => Some((precision, true)),
            AtlasPicture::Png => None,
        };
        if let (Chosen::Computed(part), Some(file)) = (chosen, file) {
            let page = bands::page((&published.world, atlas), *index, part, published.version, file, watch);
            return page.map(|file| (file, None)).map_err(Problem::internal);
        }
        let (values, about) = lightmap::values(published, chosen).map_err(Problem::internal)?;
        let about: Vec<(&str, &str)> = about.iter().map(|(name, text)| (*name, text.as_str())).collect();
        let page = engine::read_page(&published.world, atlas, *index, &values, watch);
        let page = page.map_err(|Canceled| Problem::internal("nobody waits for it"))?;
        if let Some(followed) = &self.followed {
            let (size, hashes) = hashes(&page, followed.half);
            self.scene.tiles.see(followed, *index, published.version, size, hashes);
        }
        engine::atlas_page(page, *picture, &about).map_err(Problem::internal)
    }
}

/// The atlas of a version of a scene.
pub(super) async fn atlas_of(
    app: &Arc<App>,
    scene: &Arc<SceneEntry>,
    published: &Arc<Published>,
) -> ApiResult<Arc<Atlas>> {
    if let Some(own) = published.world.atlas() {
        return Ok(Arc::clone(own));
    }
    let _turn = scene.made_atlas.turn.lock().await;
    let (its_scene, its_published) = (Arc::clone(scene), Arc::clone(published));
    let max_texels = app.config.limits.atlas_texels;
    let made = app.compute.draw(move || its_scene.made_atlas.of(&its_published, max_texels)).await?;
    made.map_err(|error| atlas_problem(&error))
}

/// Why a scene has no atlas.
pub(super) fn atlas_problem(error: &AtlasError) -> Problem {
    match error {
        AtlasError::Density(density) => {
            let reason = format!("has to be a finite number above 0, not {density}");
            Problem::field(Kind::InvalidQuery, "texels_per_metre", reason)
        }
        AtlasError::TooLarge { .. } | AtlasError::Pieces { .. } => Problem::new(Kind::SceneTooLarge, error.to_string()),
    }
}
