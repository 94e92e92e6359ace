//! Uploads of scenes.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use jiff::Timestamp;
use serde::Deserialize;
use tokio::sync::OwnedSemaphorePermit;
use utoipa::IntoParams;

use super::atlas::{self, LayoutName, atlas_problem};
use super::edit_parse::{check_name, check_strength, to_budget};
use super::edit_types::Budget;
use super::extract::{ApiQuery, read_upload, require_content_type};
use super::layers::{self, Wanted};
use super::problem::{ApiResult, Kind, Problem};
use super::scenes::scene_json;
use super::skies;
use super::types::{self, JobPriority};
use super::{Shared, etag, prepare, require_serving};
use crate::engine::{self, AtlasOptions, Density, LoadError, Scene, SurfaceError, World, WorldError};
use crate::jobs::budget::JobBudget;
use crate::jobs::queue::{Full, JobKind};
use crate::jobs::{JobSpec, new_record};
use crate::memory::{self, NoRoom};
use crate::mode::Mode;
use crate::state::App;
use crate::store::layers::LAYER_BYTES;
use crate::store::records::{SceneRecord, StoredOutside};
use crate::store::scenes::{NewScene, Reservation, SceneEntry, SceneState};
use crate::store::versions::{FIRST_RESERVE, Published};
use crate::unit::LightUnit;

/// Media types of an uploaded file.
pub(super) const GLB_TYPES: &[&str] =
    &["model/gltf-binary", "model/gltf+json", "application/zip", "application/octet-stream"];
/// Largest albedo that may be asked for: light halves in 700 bounces.
const LARGEST_ALBEDO: f32 = 0.999;

/// How to upload a scene.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct CreateQuery {
    /// Name for people.
    #[param(example = "living room")]
    name: Option<String>,
    /// Largest distance between neighbouring elements, metres; chosen from the scene's size where absent. On a few objects that
    /// are too large for it (a ground of a square kilometre) they lie farther apart, with a warning.
    #[param(example = 0.1)]
    spacing: Option<f32>,
    /// What the light map holds; `full` where absent.
    #[param(inline)]
    mode: Option<Mode>,
    /// Constant radiance from outside, `r,g,b`: adds a light named `environment`.
    #[param(example = "1,1,1")]
    pub(super) environment: Option<String>,
    /// A picture of the sky, uploaded as an asset: adds a light named `environment`.
    #[param(example = "d74981efa70a0c880b8d8c1985d075dbcbf679b99a5f9914e5aaf96b831a9e24")]
    pub(super) sky: Option<String>,
    /// By how much that picture is turned about +y, counter-clockwise seen from above, degrees; 0 where absent.
    #[param(example = 90.0)]
    pub(super) sky_rotation: Option<f32>,
    /// Factor on its radiance; 1 where absent.
    #[param(example = 1.0)]
    pub(super) sky_strength: Option<f32>,
    /// Whether a scene that has no light at all gets a plain sky, of radiance 1 from everywhere; `false` where absent.
    pub(super) default_sky: Option<bool>,
    /// Angle that the discs of directional lights of the file take up, degrees, below 180: the sun's is 0.53. 0 where
    /// absent, as glTF has it: hard shadows.
    #[param(example = 0.53)]
    pub(super) sun_angle: Option<f32>,
    /// What the intensities of the file's point and spot lights are: `candela` (glTF's; `candela` where absent), or `watt`,
    /// the power into all directions, as Blender writes in its lighting mode "Raw": 1 / 4π of it per steradian. Emissive
    /// surfaces and directional lights stay as they are.
    #[param(inline)]
    unit: Option<LightUnit>,
    /// Largest albedo that light meets, above 0 and up to 0.999: what is above, of the file, of inserted assets and of
    /// repaints, counts as this. 0.95 where absent.
    #[param(example = 0.99)]
    max_albedo: Option<f32>,
    /// How the light map is delivered. `vertices`, the default: by element, at the corners of a subdivided mesh. `atlas`:
    /// objects also have rectangles on pages of texels, which stay where they are through all edits.
    #[param(inline)]
    layout: Option<LayoutName>,
    /// Texels per metre of surface of the atlas; asks for one. One per spacing where absent.
    #[param(example = 20.0)]
    texels_per_metre: Option<f32>,
    /// Which lights have layers of their own in the light map, so that relighting them needs no rays: `shared` (none,
    /// the default; lights that are relit get one then), `each` (every light; at most 15), or a JSON object of layers
    /// with their lights (at most 15; the other lights share one more).
    #[param(example = "{\"ceiling\": [\"lamp-1\", \"lamp-2\"]}")]
    layers: Option<String>,
    /// Start a bake at once; `true` where absent.
    bake: Option<bool>,
    /// What the scene works towards, as JSON like the `budget` of an edit: the bake ends there, edits interrupt it, and what
    /// they leave behind is refined towards it. In place of the three below.
    #[param(example = "{\"target_rmse\": 0.01, \"max_seconds\": 60}")]
    target: Option<String>,
    /// The target: samples per element; 128 where nothing else is asked for.
    #[param(example = 128)]
    samples_per_element: Option<u32>,
    /// The target: seconds from the upload.
    max_seconds: Option<f64>,
    /// The target: stated error.
    target_rmse: Option<f32>,
    /// Tell what the scene would take, and keep nothing: 200, a ScenePlan; `false` where absent.
    dry_run: Option<bool>,
    /// Whose turn comes sooner, of the bake; `normal` where absent.
    #[param(inline)]
    priority: Option<JobPriority>,
}

/// Uploads a scene and starts its bake.
#[utoipa::path(
    post, path = "/v1/scenes", tag = "scenes", operation_id = "create_scene", params(CreateQuery),
    request_body(content = Vec<u8>, content_type = "model/gltf-binary", description = "A `.glb`, or a `.gltf` with its files as a zip archive"),
    responses(
        (status = 200, body = types::ScenePlan, description = "With `dry_run=true`: what the scene would take"),
        (status = 201, body = types::Scene, description = "The scene; its bake is `current_job`",
        headers(
            ("Location" = String, description = "Path of the scene"),
            ("ETag" = String, description = "The edits that were accepted so far, for `If-Match`")
        )))
)]
pub(super) async fn create(
    State(app): Shared,
    ApiQuery(query): ApiQuery<CreateQuery>,
    headers: HeaderMap,
    body: Body,
) -> ApiResult<Response> {
    require_serving(&app)?;
    require_content_type(&headers, GLB_TYPES)?;
    let is_dry_run = query.dry_run.unwrap_or(false);
    let options = Options::from_query(query, &app).map_err(in_query)?;
    if is_dry_run {
        return plan(&app, options, &headers, body).await;
    }
    let full = || Problem::new(Kind::TooManyScenes, format!("there are {} scenes", app.config.limits.scenes));
    let reservation = app.scenes.reserve(app.config.limits.scenes).ok_or_else(full)?;
    let (glb, _room) = read_upload(&app, &headers, body).await?;
    let permit = upload_permit(&app).await?;
    let upload = Upload { reservation, options: Arc::new(options), glb };
    let (scene, bake) = prepare::create(&app, upload, permit).await?;
    let location = format!("/v1/scenes/{}", scene.id);
    let (accepted, json) = scene_json(&app, &scene, bake).await?;
    let headers = [(header::LOCATION, location), (header::ETAG, etag(accepted))];
    Ok((StatusCode::CREATED, headers, json).into_response())
}

/// Builds a scene as an upload does, tells what it takes, and lets it go.
async fn plan(app: &Arc<App>, options: Options, headers: &HeaderMap, body: Body) -> ApiResult<Response> {
    let (glb, _room) = read_upload(app, headers, body).await?;
    let permit = upload_permit(app).await?;
    let its_app = app.clone();
    let build = move || {
        let _permit = permit;
        let world = build_world(&its_app, &glb, &options)?;
        let layers = layer_bytes(&world) as usize;
        let published = Published::black(world, options.mode);
        let world = &published.world;
        Ok::<_, Problem>(types::ScenePlan {
            spacing: world.spacing(),
            elements: world.element_count() as u64,
            triangles: world.triangle_count() as u64,
            objects: world.scene.objects.len() as u64,
            lights: world.lights().count() as u64,
            memory_bytes: (world.memory_bytes() + published.memory_bytes() + layers) as u64,
            warnings: world.scene.warnings.clone(),
            degenerate_triangles: world.scene.degenerate_triangles as u64,
        })
    };
    Ok(Json(app.compute.build(build).await??).into_response())
}

/// Keeps a scene with its bake, and lets everybody see both; answers the scene and the bake's id. Without a world it is
/// being prepared, and its bake waits for that.
pub(super) fn keep(
    app: &Arc<App>,
    Upload { reservation, options, glb }: &Upload,
    about: &About,
    world: Option<World>,
) -> ApiResult<(Arc<SceneEntry>, Option<String>)> {
    let record = SceneRecord {
        name: options.name.clone(),
        mode: options.mode,
        spacing: about.density.spacing,
        object_squares: Some(about.density.object_squares).filter(|squares| squares.is_finite()),
        environment: options.environment,
        outside: options.outside.clone(),
        unit: options.unit,
        max_albedo: options.max_albedo,
        atlas: atlas::stored(about.density.spacing, options.atlas),
        groups: about.groups.clone(),
        target: options.target,
        created_at: Timestamp::now(),
    };
    let is_preparing = world.is_none();
    let new = NewScene {
        number: reservation.number,
        id: app.ids.scene(reservation.number),
        name: record.name.clone(),
        mode: record.mode,
        target: record.target,
        created_at: record.created_at,
        first_event: app.first_event,
        reserved: FIRST_RESERVE,
        error: None,
        state: if is_preparing { SceneState::Preparing } else { SceneState::Ready },
    };
    let layers = world.as_ref().map_or(0, layer_bytes);
    let world = world.unwrap_or_else(|| engine::warned(engine::empty_world(about.density.spacing), &about.warnings));
    let scene = Arc::new(SceneEntry::new(new, world, &app.config.limits));
    scene.expect_layers(layers);
    // Nobody else sees the scene yet.
    let mut head = scene.head.blocking_lock();
    let bake = match options.target.filter(|_| options.bake) {
        None => None,
        Some(budget) => {
            let spec = JobSpec::new(budget, next_seed(app.config.seed, &mut head.jobs), 0);
            let ticket = app.ticket(scene.number).map_err(full_problem)?;
            let mut bake = new_record(ticket.number, &scene, (JobKind::Bake, options.priority), spec);
            bake.job.waits_for_scene = is_preparing;
            Some((ticket, bake))
        }
    };
    let skies: Vec<&str> = record.outside.sky.iter().map(|sky| sky.asset.as_str()).collect();
    let gone = |asset: &str| Problem::field(Kind::UnknownAsset, "sky", format!("the asset {asset:?} was deleted"));
    app.assets.need(scene.number, &skies).map_err(gone)?;
    let created = app.store.scene_created(scene.number, &record, glb, bake.as_ref().map(|(_, job)| job));
    created.inspect_err(|_| app.assets.release(scene.number))?;
    scene.published().objects();
    app.scenes.insert(scene.clone());
    let bake = bake.map(|(ticket, job)| app.ids.job(ticket.submit(&scene, &job, || ()).number));
    drop(head);
    Ok((scene, bake))
}

/// Bytes that the layers of a scene take which its upload asks for.
pub(super) fn layer_bytes(world: &World) -> u64 {
    (layers::count(&world.scene, &world.scene.groups) * LAYER_BYTES * world.slots()) as u64
}

/// A file with how to light it.
pub(super) struct Upload {
    reservation: Reservation,
    pub(super) options: Arc<Options>,
    pub(super) glb: Bytes,
}

/// What is known of a scene before it is built.
pub(super) struct About {
    pub(super) density: Density,
    groups: BTreeMap<String, String>,
    warnings: Vec<String>,
}

/// A query, checked.
pub(super) struct Options {
    name: String,
    spacing: Option<f32>,
    mode: Mode,
    environment: Option<[f32; 3]>,
    outside: StoredOutside,
    unit: LightUnit,
    max_albedo: Option<f32>,
    atlas: Option<AtlasOptions>,
    layers: Wanted,
    bake: bool,
    target: Option<JobBudget>,
    priority: JobPriority,
}

impl Options {
    fn from_query(query: CreateQuery, app: &App) -> ApiResult<Options> {
        let outside = skies::asked_for(&query)?;
        let atlas = atlas::asked_for(query.layout, query.texels_per_metre, &app.config.limits)?;
        let (bake, has_target) = (query.bake.unwrap_or(true), query.target.is_some());
        let target = read_target(&query, app)?;
        let name = query.name.unwrap_or_else(|| "scene".to_owned());
        check_name(&name, "name", app.config.limits.name_chars)?;
        if query.spacing.is_some_and(|spacing| !(spacing.is_finite() && spacing > 0.0)) {
            return Err(Problem::field(Kind::InvalidQuery, "spacing", "has to be above 0"));
        }
        if query.max_albedo.is_some_and(|albedo| !(albedo > 0.0 && albedo <= LARGEST_ALBEDO)) {
            let reason = format!("has to be above 0 and at most {LARGEST_ALBEDO}");
            return Err(Problem::field(Kind::InvalidQuery, "max_albedo", reason));
        }
        let environment = query.environment.as_deref().map(parse_environment).transpose()?;
        Ok(Options {
            name,
            spacing: query.spacing,
            mode: query.mode.unwrap_or_default(),
            environment,
            outside,
            unit: query.unit.unwrap_or_default(),
            max_albedo: query.max_albedo,
            atlas,
            layers: query
                .layers
                .map_or(Ok(Wanted::Shared), |text| Wanted::parse(&text, app.config.limits.name_chars))?,
            bake,
            target: (bake || has_target).then_some(target),
            priority: query.priority.unwrap_or_default(),
        })
    }
}

/// What the scene is to work towards, however the query says so.
fn read_target(query: &CreateQuery, app: &App) -> ApiResult<JobBudget> {
    let apart = Budget {
        samples_per_element: query.samples_per_element,
        max_seconds: query.max_seconds,
        target_rmse: query.target_rmse,
    };
    let default_samples = app.config.defaults.bake_samples;
    let Some(text) = &query.target else { return to_budget(Some(apart), "", default_samples, &app.config) };
    if apart.samples_per_element.is_some() || apart.max_seconds.is_some() || apart.target_rmse.is_some() {
        let reason = "comes alone: samples_per_element, max_seconds and target_rmse belong in it";
        return Err(Problem::field(Kind::InvalidQuery, "target", reason));
    }
    let budget = serde_json::from_str::<Budget>(text);
    let budget =
        budget.map_err(|error| Problem::field(Kind::InvalidQuery, "target", format!("has to be JSON: {error}")))?;
    to_budget(Some(budget), "target", default_samples, &app.config)
}

/// Faults in the query are told as such, whatever checked them.
fn in_query(problem: Problem) -> Problem {
    problem.with_kind(Kind::InvalidQuery)
}

fn parse_environment(text: &str) -> ApiResult<[f32; 3]> {
    let numbers: Option<Vec<f32>> =
        text.split(',').map(|number| number.trim().parse().ok().filter(|x: &f32| x.is_finite() && *x >= 0.0)).collect();
    match numbers.as_deref() {
        Some([r, g, b]) => {
            check_strength(Some(&[*r, *g, *b]), None, "environment").map_err(in_query)?;
            Ok([*r, *g, *b])
        }
        _ => Err(Problem::field(Kind::InvalidQuery, "environment", "has to be r,g,b, each finite and at least 0")),
    }
}

fn build_world(app: &App, glb: &Bytes, options: &Options) -> ApiResult<World> {
    let (scene, density) = read_scene(app, glb, options)?;
    lay_out(app, scene, density, options)
}

impl About {
    pub(super) fn of(scene: &Scene, density: Density) -> About {
        About { density, groups: scene.groups.clone(), warnings: scene.warnings.clone() }
    }
}

/// What a file holds, with what is asked for beside it, and how far its elements will lie apart.
pub(super) fn read_scene(app: &App, glb: &Bytes, options: &Options) -> ApiResult<(Scene, Density)> {
    let limits = &app.config.limits;
    let mut scene = engine::load(glb, limits, options.max_albedo).map_err(load_problem)?;
    options.unit.convert(&mut scene);
    let outside = skies::outside(options.environment, &options.outside, &app.assets)?;
    if !outside.add_to(&mut scene) {
        let reason = "the file has a light named \"environment\" already";
        return Err(Problem::field(Kind::NameTaken, "environment", reason));
    }
    check_strengths(&scene)?;
    scene.groups = options.layers.groups(&scene)?;
    let wanted = options.spacing.map_or_else(|| Density::chosen(&scene), Density::even);
    // Where nothing that is large gives way, building says what is too much.
    let density = wanted.within(&scene, limits.elements).unwrap_or(wanted);
    Ok((scene, density))
}

/// Its elements and trees: seconds for large scenes.
pub(super) fn lay_out(app: &App, scene: Scene, density: Density, options: &Options) -> ApiResult<World> {
    let limits = &app.config.limits;
    let bytes = memory::estimate(&scene, density);
    let of_layers = memory::estimate_layers(bytes, layers::count(&scene, &scene.groups));
    let what = if of_layers > 0 { "scene with its layers" } else { "scene" };
    let _promise = app.promise_memory(bytes.saturating_add(of_layers), 0).map_err(|full| memory_problem(what, full))?;
    let (stated, max_albedo) = (options.mode.stated(), options.max_albedo);
    let world_options = engine::world_options(density, stated, max_albedo, options.atlas, limits);
    app.config.engine.build(scene, &world_options).map_err(|error| match error {
        WorldError::Atlas(error) => atlas_problem(&error),
        WorldError::TooLarge { .. } | WorldError::Surface { source: SurfaceError::TooManyElements { .. }, .. } => {
            Problem::new(Kind::SceneTooLarge, error.to_string())
        }
        error => Problem::new(Kind::UnsupportedFile, error.to_string()),
    })
}

/// Lights and emissive surfaces of a file are bounded as those of edits are.
pub(super) fn check_strengths(scene: &Scene) -> ApiResult<()> {
    for light in &scene.lights {
        let strength = (light.color * light.intensity).to_array();
        let checked = check_strength(Some(&strength), None, &format!("light {:?}", light.name));
        checked.map_err(|problem| problem.with_kind(Kind::UnsupportedFile))?;
    }
    Ok(())
}

/// What does not fit is told with what it would take.
pub(super) fn memory_problem(what: &str, full: NoRoom) -> Problem {
    let NoRoom { bytes, free, limit } = full;
    let text = format!("the {what} would take about {} MiB", bytes >> 20);
    match limit {
        Some(limit) => Problem::new(Kind::SceneTooLarge, format!("{text}, the service has {} MiB", limit >> 20)),
        None => Problem::new(Kind::NoMemory, format!("{text}, {} MiB are free", free >> 20)),
    }
}

pub(super) fn load_problem(error: LoadError) -> Problem {
    match error {
        LoadError::Malformed(text) => Problem::new(Kind::MalformedFile, text),
        LoadError::Unsupported(text) => Problem::new(Kind::UnsupportedFile, text),
        LoadError::TooLarge(text) => Problem::new(Kind::SceneTooLarge, text),
    }
}

pub(super) fn full_problem(full: Full) -> Problem {
    match full {
        Full::Closed => Problem::new(Kind::ShuttingDown, full.to_string()).retry_after(5),
        Full::Scene(_) | Full::Service(_) => Problem::new(Kind::QueueFull, full.to_string()).retry_after(1),
    }
}

/// A place among those that are built.
pub(super) async fn upload_permit(app: &App) -> ApiResult<OwnedSemaphorePermit> {
    let wait = tokio::time::timeout(app.config.timeouts.upload_slot, app.uploads.clone().acquire_owned()).await;
    let busy = || Problem::new(Kind::TooManyUploads, "too many uploads are under way").retry_after(5);
    wait.ok().and_then(Result::ok).ok_or_else(busy)
}

/// The seed of a scene's next job. It depends on nothing but the service's own seed and how many jobs the scene had, so
/// the same scene and the same edits give the same light map, bit for bit, whatever else the service does.
pub(crate) fn next_seed(service: u64, jobs: &mut u64) -> u64 {
    *jobs += 1;
    mixed(jobs.wrapping_mul(0x9E37_79B9_7F4A_7C15)) ^ mixed(service)
}

/// SplitMix64's: neighbouring numbers, unrelated seeds. 0 stays 0.
pub(crate) fn mixed(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_of_jobs_differ_by_job_and_by_service() {
        let of = |service| {
            let mut jobs = 0;
            [next_seed(service, &mut jobs), next_seed(service, &mut jobs)]
        };
        // Light maps that were made so far can be made again.
        assert_eq!(of(0), [0xe220_a839_7b1d_cdaf, 0x6e78_9e6a_a1b9_65f4]);
        assert!(of(1).iter().all(|seed| !of(0).contains(seed) && !of(2).contains(seed)));
        assert_eq!(of(7), of(7));
    }
}
