//! Uploads of scenes.

use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use jiff::Timestamp;
use rebake_core::allowed::Allowed;
use tokio::sync::OwnedSemaphorePermit;

use super::checks::check_strength;
use super::extract::{ApiQuery, read_upload, require_content_type};
use super::keys::{Keyed, Turn};
use super::prepare::{Kept, Outline, build_world, layer_bytes};
use super::problem::{ApiResult, Kind, Problem};
use super::scenes::scene_json;
use super::upload_query::{CreateQuery, Options, in_query};
use super::{Shared, atlas, etag, prepare, require_serving, types};
use crate::engine::{self, LoadError, Scene, World};
use crate::jobs::queue::{Full, JobKind};
use crate::jobs::seeds::next_seed;
use crate::jobs::{JobSpec, new_record};
use crate::memory::NoRoom;
use crate::state::App;
use crate::store::records::SceneRecord;
use crate::store::scene::{NewScene, SceneEntry, SceneState};
use crate::store::scenes::Reservation;
use crate::store::versions::{FIRST_RESERVE, Published};

/// Media types of an uploaded file.
pub(super) const GLB_TYPES: &[&str] =
    &["model/gltf-binary", "model/gltf+json", "application/zip", "application/octet-stream"];

/// Uploads a scene and starts its bake.
#[utoipa::path(
    post, path = "/v1/scenes", tag = "scenes", operation_id = "create_scene",
    params(
        CreateQuery,
        ("Idempotency-Key" = Option<String>, Header, description = "Makes the request safe to repeat: the same key with the same file and query answers the same scene, as it is by then, and 410 where that was deleted. Not looked at with `dry_run=true`"),
    ),
    request_body(content(
        (Vec<u8> = "model/gltf-binary"), (Vec<u8> = "model/gltf+json"), (Vec<u8> = "application/zip"),
        (Vec<u8> = "application/octet-stream")
    ), description = "A `.glb`, a `.gltf` that holds its files, or one with them as a zip archive; of the last type any of these"),
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
    uri: Uri,
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
    let full = || {
        let text =
            format!("there are {} scenes, as many as the service takes (--max-scenes)", app.config.limits.scenes);
        Problem::new(Kind::TooManyScenes, text)
    };
    let turn = Turn::of(&app, &headers).await?;
    let reservation = app.scenes.reserve(app.config.limits.scenes);
    if reservation.is_none() && !turn.as_ref().is_some_and(Turn::is_known) {
        return Err(full());
    }
    let (glb, _room) = read_upload(&app, &headers, body).await?;
    let key = Keyed::new(&app, turn, format!("scene?{}", uri.query().unwrap_or_default()), &glb).await?;
    if let Some(known) = key.as_ref().map(Keyed::known).transpose()?.flatten() {
        drop(reservation);
        let gone = || Problem::new(Kind::SceneGone, "the scene of this Idempotency-Key was deleted");
        let scene = known.scene.and_then(|number| app.scenes.get(number)).ok_or_else(gone)?;
        return created(&app, &scene, known.job.map(|job| app.ids.job(job))).await;
    }
    let reservation = reservation.ok_or_else(full)?;
    let permit = upload_permit(&app).await?;
    let upload = Upload { reservation, options: Arc::new(options), glb, key };
    let (scene, bake) = prepare::create(&app, upload, permit).await?;
    created(&app, &scene, bake).await
}

/// The answer to an upload: the scene and where it is.
async fn created(app: &Arc<App>, scene: &Arc<SceneEntry>, bake: Option<String>) -> ApiResult<Response> {
    let location = format!("/v1/scenes/{}", scene.id);
    let (accepted, json) = scene_json(app, scene, bake).await?;
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
    Upload { reservation, options, glb, key }: &Upload,
    outline: &Outline,
    world: Option<World>,
) -> ApiResult<Kept> {
    let record = SceneRecord {
        name: options.name.clone(),
        mode: options.mode,
        spacing: outline.density.spacing,
        object_squares: Some(outline.density.object_squares).filter(|squares| squares.is_finite()),
        elements: options.elements,
        spread: options.spread.into(),
        environment: options.environment,
        outside: options.outside.clone(),
        unit: options.unit,
        max_albedo: options.max_albedo,
        atlas: atlas::stored(outline.density.spacing, options.atlas),
        groups: outline.groups.clone(),
        target: options.target,
        created_at: Timestamp::now(),
    };
    let new = NewScene {
        number: reservation.number,
        id: app.ids.scene(reservation.number),
        name: record.name.clone(),
        mode: record.mode,
        target: record.target,
        created_at: record.created_at,
        first_event: app.ids.first_event,
        reserved: FIRST_RESERVE,
        error: None,
        state: if world.is_none() { SceneState::Preparing } else { SceneState::Ready },
    };
    let layers = world.as_ref().map_or(0, layer_bytes);
    let world =
        world.unwrap_or_else(|| engine::warned(engine::empty_world(outline.density.spacing), &outline.warnings));
    let scene = Arc::new(SceneEntry::new(new, world, &app.config.limits));
    scene.expect_layers(layers);
    // Nobody else sees the scene yet.
    let mut head = scene.head.blocking_lock();
    let bake = match options.target.filter(|_| options.bake) {
        None => None,
        Some(budget) => {
            let spec = JobSpec::new(budget, next_seed(app.config.seed, &mut head.jobs), 0);
            let ticket = app.jobs.ticket(scene.number).map_err(full_problem)?;
            let bake = new_record(ticket.number, &scene, (JobKind::Bake, options.priority), spec);
            Some((ticket, bake))
        }
    };
    let skies: Vec<&str> = record.outside.sky.iter().map(|sky| sky.asset.as_str()).collect();
    let gone = |asset: &str| Problem::field(Kind::UnknownAsset, "sky", format!("the asset {asset:?} was deleted"));
    app.assets.need(scene.number, &skies).map_err(gone)?;
    let job = bake.as_ref().map(|(_, job)| job);
    let key = key.as_ref().map(|key| key.record(Some(scene.number), job.map(|job| job.job.number)));
    let created = app.store.scene_created(scene.number, &record, glb, job, key.as_ref());
    created.inspect_err(|_| app.assets.release(scene.number))?;
    scene.published().objects();
    app.scenes.insert(scene.clone());
    key.into_iter().for_each(|key| app.upload_keys.insert(key));
    let bake = bake.map(|(ticket, job)| app.ids.job(ticket.submit(&scene, &job, || ()).number));
    drop(head);
    Ok((scene, bake))
}

/// A file with how to light it.
pub(super) struct Upload {
    reservation: Reservation,
    pub(super) options: Arc<Options>,
    pub(super) glb: Bytes,
    key: Option<Keyed>,
}

/// Lights and emissive surfaces of a file are bounded as those of edits are.
pub(super) fn check_strengths(scene: &Scene) -> ApiResult<()> {
    for light in &scene.lights {
        let strength = (light.color * light.intensity).to_array();
        let checked = check_strength(Allowed::ASKED, Some(&strength), None, &format!("light {:?}", light.name));
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
