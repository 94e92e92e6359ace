//! Scenes: upload, look, delete.

use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use glam::Vec3;
use jiff::Timestamp;
use serde::Deserialize;
use tokio::sync::OwnedSemaphorePermit;
use utoipa::IntoParams;

use super::edit_parse::{check_name, eye_target_up, to_budget};
use super::edit_types::Budget;
use super::extract::{ApiPath, ApiQuery, read_body, require_content_type};
use super::paging::Page;
use super::problem::{ApiResult, Kind, Problem};
use super::types::{self, SceneMode, finite};
use super::{Shared, etag, find_any_scene, require_serving};
use crate::engine::{self, LoadError, SurfaceError, World, WorldError};
use crate::jobs::queue::{Full, JobKind, Priority};
use crate::jobs::{JobSpec, new_record};
use crate::memory;
use crate::state::App;
use crate::store::records::SceneRecord;
use crate::store::scenes::{NewScene, Reservation, SceneEntry};
use crate::store::versions::{FIRST_RESERVE, Published};

/// Media types of an uploaded file.
pub(super) const GLB_TYPES: &[&str] = &["model/gltf-binary", "application/octet-stream"];

/// How to upload a scene.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct CreateQuery {
    /// Name for people.
    #[param(example = "living room")]
    name: Option<String>,
    /// Largest distance between neighbouring elements, metres; chosen from the scene's size where absent.
    #[param(example = 0.1)]
    spacing: Option<f32>,
    /// What the light map holds; `full` where absent.
    #[param(inline)]
    mode: Option<SceneMode>,
    /// Constant radiance from outside, `r,g,b`: adds a light named `environment`.
    #[param(example = "1,1,1")]
    environment: Option<String>,
    /// Start a bake at once; `true` where absent.
    bake: Option<bool>,
    /// Budget of the bake: samples per element.
    #[param(example = 128)]
    samples_per_element: Option<u32>,
    /// Budget of the bake: seconds.
    max_seconds: Option<f64>,
    /// Budget of the bake: stated error.
    target_rmse: Option<f32>,
}

/// Uploads a scene and starts its bake.
#[utoipa::path(
    post, path = "/v1/scenes", tag = "scenes", operation_id = "create_scene", params(CreateQuery),
    request_body(content = Vec<u8>, content_type = "model/gltf-binary", description = "A `.glb` with everything embedded"),
    responses((status = 201, body = types::Scene, description = "The scene; its bake is `current_job`",
        headers(("Location" = String, description = "Path of the scene"))))
)]
pub(super) async fn create(
    State(app): Shared,
    ApiQuery(query): ApiQuery<CreateQuery>,
    headers: HeaderMap,
    body: Body,
) -> ApiResult<Response> {
    require_serving(&app)?;
    require_content_type(&headers, GLB_TYPES)?;
    let options = Options::from_query(query, &app).map_err(in_query)?;
    let full = || Problem::new(Kind::TooManyScenes, format!("there are {} scenes", app.config.limits.scenes));
    let reservation = app.scenes.reserve(app.config.limits.scenes).ok_or_else(full)?;
    let permit = upload_permit(&app).await?;
    let glb = read_body(&app, &headers, body, app.config.limits.upload_bytes).await?;
    let its_app = app.clone();
    let build = move || {
        let _permit = permit;
        create_scene(&its_app, &reservation, options, &glb)
    };
    let (scene, bake) = app.compute.build(build).await??;
    let location = format!("/v1/scenes/{}", scene.id);
    let mut body = scene_json(&app, &scene).await?;
    // Also where it is done by now.
    body.current_job = bake;
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], Json(body)).into_response())
}

/// Builds a scene, keeps it with its bake, and lets everybody see both; answers the scene and the bake's id.
fn create_scene(
    app: &Arc<App>,
    reservation: &Reservation,
    options: Options,
    glb: &Bytes,
) -> ApiResult<(Arc<SceneEntry>, Option<String>)> {
    let world = build_world(app, glb, options.spacing, options.environment)?;
    let record = SceneRecord {
        name: options.name,
        mode: options.mode.into(),
        spacing: world.spacing(),
        environment: options.environment.map(|radiance| radiance.to_array()),
        created_at: Timestamp::now(),
    };
    let new = NewScene {
        number: reservation.number,
        id: app.ids.scene(reservation.number),
        name: record.name.clone(),
        mode: record.mode,
        created_at: record.created_at,
        first_event: app.first_event,
        reserved: FIRST_RESERVE,
        error: None,
        is_damaged: false,
    };
    let scene = Arc::new(SceneEntry::new(new, world, &app.config.limits));
    // Nobody else sees the scene yet.
    let mut head = scene.head.blocking_lock();
    let bake = match options.bake {
        None => None,
        Some(budget) => {
            let (kind, priority) = (JobKind::Bake, Priority::Normal);
            let seed = next_seed(&mut head.jobs);
            let spec = JobSpec { kind, priority, budget, focus: None, seed, sequence: 0 };
            let ticket = app.ticket(scene.number).map_err(full_problem)?;
            let job = new_record(ticket.number, &scene, &spec);
            Some((ticket, job))
        }
    };
    app.store.scene_created(scene.number, &record, glb, bake.as_ref().map(|(_, job)| job))?;
    scene.published().objects();
    app.scenes.insert(scene.clone());
    let bake = bake.map(|(ticket, job)| app.ids.job(ticket.submit(&scene, &job, || ()).number));
    drop(head);
    Ok((scene, bake))
}

/// A query, checked.
struct Options {
    name: String,
    spacing: Option<f32>,
    mode: SceneMode,
    environment: Option<Vec3>,
    bake: Option<crate::jobs::observer::JobBudget>,
}

impl Options {
    fn from_query(query: CreateQuery, app: &App) -> ApiResult<Options> {
        let name = query.name.unwrap_or_else(|| "scene".to_owned());
        check_name(&name, "name", app.config.limits.name_chars)?;
        if query.spacing.is_some_and(|spacing| !(spacing.is_finite() && spacing > 0.0)) {
            return Err(Problem::field(Kind::InvalidQuery, "spacing", "has to be above 0"));
        }
        let budget = Budget {
            samples_per_element: query.samples_per_element,
            max_seconds: query.max_seconds,
            target_rmse: query.target_rmse,
        };
        let budget = to_budget(Some(budget), "", app.config.defaults.bake_samples, &app.config)?;
        Ok(Options {
            name,
            spacing: query.spacing,
            mode: query.mode.unwrap_or_default(),
            environment: query.environment.as_deref().map(parse_environment).transpose()?,
            bake: query.bake.unwrap_or(true).then_some(budget),
        })
    }
}

/// Faults in the query are told as such, whatever checked them.
fn in_query(problem: Problem) -> Problem {
    problem.with_kind(Kind::InvalidQuery)
}

fn parse_environment(text: &str) -> ApiResult<Vec3> {
    let numbers: Option<Vec<f32>> =
        text.split(',').map(|number| number.trim().parse().ok().filter(|x: &f32| x.is_finite() && *x >= 0.0)).collect();
    match numbers.as_deref() {
        Some([r, g, b]) => Ok(Vec3::new(*r, *g, *b)),
        _ => Err(Problem::field(Kind::InvalidQuery, "environment", "has to be r,g,b, each finite and at least 0")),
    }
}

fn build_world(app: &App, glb: &Bytes, spacing: Option<f32>, environment: Option<Vec3>) -> ApiResult<World> {
    let mut scene = engine::load(glb, &app.config.limits).map_err(load_problem)?;
    if let Some(radiance) = environment
        && !engine::add_environment(&mut scene, radiance)
    {
        let reason = "the file has a light named \"environment\" already";
        return Err(Problem::field(Kind::NameTaken, "environment", reason));
    }
    let bytes = memory::estimate(&scene, spacing);
    let limit = app.config.limits.memory_bytes;
    let _promise = app.promise_memory(bytes).map_err(|free| {
        let text = format!("the scene would take about {} MiB", bytes >> 20);
        match bytes > limit {
            true => Problem::new(Kind::SceneTooLarge, format!("{text}, the service has {} MiB", limit >> 20)),
            false => Problem::new(Kind::NoMemory, format!("{text}, {} MiB are free", free >> 20)),
        }
    })?;
    engine::build(scene, spacing, &app.config.limits).map_err(|error| match error {
        WorldError::TooLarge { .. } | WorldError::Surface { source: SurfaceError::TooManyElements { .. }, .. } => {
            Problem::new(Kind::SceneTooLarge, error.to_string())
        }
        error => Problem::new(Kind::UnsupportedFile, error.to_string()),
    })
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

/// A place among the uploads. Nothing of the body is read before it is there.
pub(super) async fn upload_permit(app: &App) -> ApiResult<OwnedSemaphorePermit> {
    let wait = tokio::time::timeout(app.config.timeouts.upload_slot, app.uploads.clone().acquire_owned()).await;
    let busy = || Problem::new(Kind::TooManyUploads, "too many uploads are under way").retry_after(5);
    wait.ok().and_then(Result::ok).ok_or_else(busy)
}

/// The seed of a scene's next job. It depends on nothing but how many jobs the scene had, so the same scene and the
/// same edits give the same light map, bit for bit, whatever else the service does.
pub(crate) fn next_seed(jobs: &mut u64) -> u64 {
    *jobs += 1;
    // SplitMix64: neighbouring counters, unrelated seeds.
    let mut z = jobs.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// Which page of a list.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ListQuery {
    /// Entries per page.
    #[param(example = 50, minimum = 1)]
    limit: Option<usize>,
    /// `next_cursor` of the page before.
    cursor: Option<String>,
}

/// All scenes, newest first.
#[utoipa::path(
    get, path = "/v1/scenes", tag = "scenes", operation_id = "list_scenes", params(ListQuery),
    responses((status = 200, body = types::ScenePage))
)]
pub(super) async fn list(
    State(app): Shared,
    ApiQuery(query): ApiQuery<ListQuery>,
) -> ApiResult<Json<types::ScenePage>> {
    let page = Page::new(&app.config, query.limit, query.cursor.as_deref())?;
    let scenes = app.scenes.older_than(page.before, page.limit + 1);
    let (scenes, next_cursor) = page.cut(scenes, |scene| scene.number);
    let items = scenes.iter().map(|scene| summary(&app, scene)).collect();
    Ok(Json(types::ScenePage { items, next_cursor }))
}

/// One scene: objects, lights, version, current job.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}", tag = "scenes", operation_id = "get_scene",
    params(("scene" = String, Path, description = "The scene's id")),
    responses((status = 200, body = types::Scene,
        headers(("ETag" = String, description = "Version of the light map"))))
)]
pub(super) async fn get(State(app): Shared, ApiPath(id): ApiPath<String>) -> ApiResult<Response> {
    let scene = find_any_scene(&app, &id)?;
    let body = scene_json(&app, &scene).await?;
    Ok(([(header::ETAG, etag(body.version))], Json(body)).into_response())
}

/// Deletes a scene, cancels its jobs and ends its streams.
#[utoipa::path(
    delete, path = "/v1/scenes/{scene}", tag = "scenes", operation_id = "delete_scene",
    params(("scene" = String, Path, description = "The scene's id")),
    responses((status = 204, description = "Deleted"))
)]
pub(super) async fn delete(State(app): Shared, ApiPath(id): ApiPath<String>) -> ApiResult<StatusCode> {
    let scene = find_any_scene(&app, &id)?;
    // No edit is accepted in between: it would queue a job for a scene that is gone.
    let _head = scene.head.lock().await;
    let (its_app, number) = (app.clone(), scene.number);
    app.compute.run(move || its_app.store.scene_deleted(number)).await??;
    if app.scenes.remove(scene.number).is_none() {
        return Err(Problem::new(Kind::UnknownScene, format!("there is no scene {id:?}")));
    }
    app.cancel_scene(&scene);
    app.pictures.forget(scene.number);
    let published = scene.published();
    let event = types::SceneEvent {
        scene: scene.id.clone(),
        what: types::SceneChange::Deleted,
        version: published.version,
        elements_version: published.elements_version,
    };
    scene.events.push("scene", types::to_event_data(&event));
    scene.mark_deleted();
    scene.events.close();
    Ok(StatusCode::NO_CONTENT)
}

fn current_job(app: &App, scene: &SceneEntry) -> Option<String> {
    app.jobs.with_queue(|queue| queue.current(scene.number)).map(|number| app.ids.job(number))
}

pub(super) fn summary(app: &App, scene: &SceneEntry) -> types::SceneSummary {
    let published = scene.published();
    types::SceneSummary {
        id: scene.id.clone(),
        name: scene.name.clone(),
        mode: scene.mode.into(),
        spacing: published.world.spacing(),
        version: published.version,
        elements: published.world.slots() as u64,
        object_count: published.world.scene.objects.len() as u64,
        current_job: current_job(app, scene),
        error: scene.error(),
        created_at: scene.created_at,
    }
}

/// A scene with all that is in it, of one version.
pub(super) async fn scene_json(app: &Arc<App>, scene: &Arc<SceneEntry>) -> ApiResult<types::Scene> {
    let published = scene.published();
    if !published.knows_objects() {
        let published = published.clone();
        app.compute.run(move || published.objects().len()).await?;
    }
    Ok(of_published(app, scene, &published))
}

fn of_published(app: &App, scene: &SceneEntry, published: &Published) -> types::Scene {
    let world = &published.world;
    types::Scene {
        id: scene.id.clone(),
        name: scene.name.clone(),
        mode: scene.mode.into(),
        spacing: world.spacing(),
        version: published.version,
        elements_version: published.elements_version,
        elements: world.slots() as u64,
        live_elements: world.element_count() as u64,
        triangles: world.triangle_count() as u64,
        memory_bytes: (world.memory_bytes() + published.memory_bytes() + scene.earlier.memory_bytes()) as u64,
        estimated_rmse: published.estimated_rmse.and_then(finite),
        unlit_edits: scene.unlit() as u64,
        objects: published.objects().iter().map(types::Object::new).collect(),
        lights: world.lights().map(|info| light(&info)).collect(),
        cameras: world.scene.cameras.iter().zip(0..).map(camera).collect(),
        warnings: world.scene.warnings.clone(),
        degenerate_triangles: world.scene.degenerate_triangles as u64,
        current_job: current_job(app, scene),
        error: scene.error(),
        created_at: scene.created_at,
    }
}

fn light(info: &rebake_core::LightInfo<'_>) -> types::Light {
    use rebake_core::scene::LightKind;
    let light = info.light;
    let (object, position, direction) = match &light.kind {
        LightKind::Emissive { object, .. } => (Some(object.clone()), None, None),
        LightKind::Point { position, .. } => (None, Some(*position), None),
        LightKind::Spot { position, direction, .. } => (None, Some(*position), Some(*direction)),
        LightKind::Directional { direction } => (None, None, Some(*direction)),
        LightKind::Environment => (None, None, None),
    };
    types::Light {
        name: light.name.clone(),
        kind: info.kind.to_owned(),
        color: light.color.to_array(),
        intensity: light.intensity,
        layer: None,
        object,
        position: position.map(|p| p.to_array()),
        direction: direction.map(|d| d.to_array()),
    }
}

fn camera((camera, index): (&rebake_core::scene::Camera, u32)) -> types::Camera {
    let (eye, target, up) = eye_target_up(camera);
    types::Camera {
        index,
        name: camera.name.clone(),
        eye: eye.to_array(),
        target: target.to_array(),
        up: up.to_array(),
        fov_y: camera.fov_y,
    }
}
