//! Preview pictures.

use axum::extract::State;
use axum::http::{HeaderName, header};
use axum::response::{IntoResponse, Response};
use glam::DVec3;
use rebake_core::render::{RenderOptions, Viewpoint};
use serde::Deserialize;
use utoipa::IntoParams;

use super::extract::{ApiPath, ApiQuery};
use super::filter::view;
use super::painter::{BOUNDARY, Painter, content_type};
use super::problem::{ApiResult, Kind, Problem};
use super::versioned::VERSION;
use super::{Shared, find_scene};
use crate::engine::World;
use crate::filter::Filter;
use crate::pictures::{
    DEFAULT_SAMPLES, MAX_SAMPLES, MAX_SIDE, MAX_TOTAL_SAMPLES, PictureFormat, PictureSpec, PictureView, ToneMap,
};

/// Headers that say how a picture was drawn.
static EXPOSURE: HeaderName = HeaderName::from_static("x-rebake-exposure");
static SCALE: HeaderName = HeaderName::from_static("x-rebake-scale");

/// What to draw, and how.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct RenderQuery {
    /// Index or name of a camera of the file; the first where neither this nor `eye` is given, an overview of the
    /// scene where it has none.
    camera: Option<String>,
    /// Where the camera stands, `x,y,z` in metres; with `target` instead of `camera`.
    #[param(example = "4,1.6,3")]
    eye: Option<String>,
    /// What it looks at, `x,y,z`.
    #[param(example = "0,1,0")]
    target: Option<String>,
    /// Upward, `x,y,z`; `0,1,0` where absent.
    up: Option<String>,
    /// Vertical field of view, radians; π/3 where absent.
    fov_y: Option<f32>,
    /// Pixels across; 640 where absent.
    #[param(maximum = 4096)]
    width: Option<u32>,
    /// Pixels down; 360 where absent.
    #[param(maximum = 4096)]
    height: Option<u32>,
    /// Samples per pixel; 4 where absent.
    #[param(maximum = 4096)]
    spp: Option<u32>,
    /// Seed of the random numbers: the same query on the same version gives the same bytes.
    seed: Option<u64>,
    /// What to show; `full` where absent.
    #[param(inline)]
    view: Option<PictureView>,
    /// `change`: against which version. Those before the last few edits are kept; 0 is darkness. The version before
    /// the last edit where absent.
    since: Option<u64>,
    /// File format; `png` where absent.
    #[param(inline)]
    format: Option<PictureFormat>,
    /// Exposure of a PNG in stops: values are multiplied by 2 to this power. By the mean of the picture where absent.
    exposure: Option<f32>,
    /// Tone map of a PNG; `agx` where absent.
    #[param(inline)]
    tone: Option<ToneMap>,
    /// `change`, `error`: what the ends of the colour scale stand for. By the picture where absent.
    scale: Option<f32>,
    /// Send a picture at once and better ones after it, with 1, 4, 16 samples per pixel and so on, as parts of a
    /// `multipart/x-mixed-replace` body; `false` where absent. The last part is what this call answers otherwise.
    progressive: Option<bool>,
    /// Whether the noise of the light map is averaged away where it may be; `statistical` where absent. Not with `view=change`,
    /// which shows what is stored.
    #[param(inline)]
    filter: Option<Filter>,
}

/// A picture of the scene as it is lit now: direct light by ray tracing, indirect light from the light map.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/render", tag = "light map", operation_id = "render_scene",
    params(("scene" = String, Path, description = "The scene's id"), RenderQuery),
    responses((status = 200, description = "The picture",
        headers(
            ("X-Rebake-Version" = String, description = "Version of the light map"),
            ("X-Rebake-Exposure" = f32, description = "Stops of a PNG of light"),
            ("X-Rebake-Scale" = f32, description = "Ends of the colour scale of a PNG of change or error"),
        ),
        content((Vec<u8> = "image/png"), (Vec<u8> = "image/x-exr"), (Vec<u8> = "multipart/x-mixed-replace"))))
)]
pub(super) async fn get(
    State(app): Shared,
    ApiPath(id): ApiPath<String>,
    ApiQuery(query): ApiQuery<RenderQuery>,
) -> ApiResult<Response> {
    let scene = find_scene(&app, &id).await?;
    let published = scene.published();
    let spec = to_spec(&query, &published.world)?;
    let before = match (spec.view, query.since) {
        (PictureView::Change, Some(0)) => None,
        (PictureView::Change, since) => {
            let found = app.pictures.baseline(scene.number, since);
            Some(found.ok_or_else(|| forgotten(since, &app.pictures.versions(scene.number)))?)
        }
        (_, Some(_)) => return Err(invalid("since", "goes with view=change only")),
        (_, None) => None,
    };
    let filter = match (spec.view, query.filter) {
        (PictureView::Change, Some(Filter::Statistical)) => {
            return Err(invalid("filter", "does not go with view=change"));
        }
        (PictureView::Change, _) => Filter::None,
        (_, filter) => filter.unwrap_or(Filter::Statistical),
    };
    let published = view(&app, &scene.filtered, published, filter).await?;
    let painter = Painter::new(app, published, before);
    let about = [(VERSION.clone(), painter.version().to_string()), (header::CACHE_CONTROL, "no-store".to_owned())];
    if query.progressive == Some(true) {
        let kind = format!("multipart/x-mixed-replace; boundary={BOUNDARY}");
        return Ok((about, [(header::CONTENT_TYPE, kind)], painter.parts(&spec)).into_response());
    }
    let drawn = painter.draw(spec).await?;
    let mut response = (about, [(header::CONTENT_TYPE, content_type(spec.format))], drawn.bytes).into_response();
    for (name, number) in [(&EXPOSURE, drawn.exposure), (&SCALE, drawn.scale)] {
        if let Some(number) = number {
            let value = header::HeaderValue::from_str(&number.to_string()).map_err(Problem::internal)?;
            response.headers_mut().insert(name.clone(), value);
        }
    }
    Ok(response)
}

fn invalid(field: &str, reason: impl std::fmt::Display) -> Problem {
    Problem::field(Kind::InvalidQuery, field, reason)
}

fn forgotten(since: Option<u64>, kept: &[u64]) -> Problem {
    let reason = match (since, kept) {
        (_, []) => "no edit has been made yet that a change could be shown against; 0 stands for darkness".to_owned(),
        (None, _) => "say against which version".to_owned(),
        (Some(version), kept) => format!("version {version} is not kept; 0 and {kept:?} are"),
    };
    Problem::field(Kind::VersionForgotten, "since", reason)
}

fn to_spec(query: &RenderQuery, world: &World) -> ApiResult<PictureSpec> {
    let side = |field: &str, value: Option<u32>, default: u32| match value.unwrap_or(default) {
        side @ 1..=MAX_SIDE => Ok(side),
        side => Err(invalid(field, format!("has to be 1 to {MAX_SIDE}, not {side}"))),
    };
    let (width, height) = (side("width", query.width, 640)?, side("height", query.height, 360)?);
    let samples = match query.spp.unwrap_or(DEFAULT_SAMPLES) {
        samples @ 1..=MAX_SAMPLES => samples,
        samples => return Err(invalid("spp", format!("has to be 1 to {MAX_SAMPLES}, not {samples}"))),
    };
    let total = u64::from(width) * u64::from(height) * u64::from(samples);
    if total > MAX_TOTAL_SAMPLES {
        let most = MAX_TOTAL_SAMPLES / (u64::from(width) * u64::from(height));
        return Err(invalid("spp", format!("has to be at most {most} at {width} × {height}, not {samples}")));
    }
    let finite = |field: &str, value: Option<f32>, is_possible: &dyn Fn(f32) -> bool, reason: &str| match value {
        Some(value) if !(value.is_finite() && is_possible(value)) => Err(invalid(field, reason)),
        value => Ok(value),
    };
    Ok(PictureSpec {
        view: query.view.unwrap_or_default(),
        viewpoint: viewpoint(query, world)?,
        options: RenderOptions {
            width: width as usize,
            height: height as usize,
            samples,
            seed: query.seed.unwrap_or(0),
        },
        format: query.format.unwrap_or_default(),
        exposure: finite("exposure", query.exposure, &|stops| stops.abs() <= 64.0, "has to be -64 to 64 stops")?,
        tone: query.tone.unwrap_or_default(),
        scale: finite("scale", query.scale, &|scale| scale > 0.0, "has to be finite and above 0")?,
    })
}

fn viewpoint(query: &RenderQuery, world: &World) -> ApiResult<Viewpoint> {
    let free = [("eye", query.eye.is_some()), ("target", query.target.is_some()), ("up", query.up.is_some())];
    let free = free.into_iter().chain([("fov_y", query.fov_y.is_some())]).find(|(_, given)| *given);
    let cameras = &world.scene.cameras;
    match (&query.camera, free) {
        (Some(_), Some((field, _))) => Err(invalid(field, "goes with `eye` and `target`, not with `camera`")),
        (Some(name), None) => {
            let by_index = || name.parse::<usize>().ok().and_then(|index| cameras.get(index));
            let camera = cameras.iter().find(|camera| camera.name == *name).or_else(by_index);
            let reason = || format!("the scene has {} cameras, and none of the name or index {name:?}", cameras.len());
            let camera = camera.ok_or_else(|| Problem::field(Kind::InvalidQuery, "camera", reason()))?;
            Ok(Viewpoint::of_camera(camera))
        }
        (None, None) => Ok(cameras.first().map_or_else(|| Viewpoint::overview(world), Viewpoint::of_camera)),
        (None, Some(_)) => {
            let required = |field: &str, value: &Option<String>| match value {
                Some(text) => point(field, text),
                None => Err(invalid(field, "is missing: `eye` and `target` go together")),
            };
            let (eye, target) = (required("eye", &query.eye)?, required("target", &query.target)?);
            let up = query.up.as_deref().map_or(Ok(DVec3::Y), |text| point("up", text))?;
            let fov_y = query.fov_y.unwrap_or(std::f32::consts::FRAC_PI_3);
            Viewpoint::new(eye, target, up, fov_y).map_err(|error| invalid(error.field, error.reason))
        }
    }
}

fn point(field: &str, text: &str) -> ApiResult<DVec3> {
    let numbers: Option<Vec<f64>> =
        text.split(',').map(|number| number.trim().parse().ok().filter(|x: &f64| x.is_finite())).collect();
    match numbers.as_deref() {
        Some([x, y, z]) => Ok(DVec3::new(*x, *y, *z)),
        _ => Err(invalid(field, "has to be x,y,z, each finite")),
    }
}
