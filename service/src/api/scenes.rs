//! Scenes: look, delete.

use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use rebake_core::allowed::Allowed;
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};

use super::checks::check_name;
use super::edit_beside::{eye_target_up, to_budget};
use super::edit_types::Budget;
use super::edits::if_match;
use super::extract::{ApiPath, ApiQuery, read_json};
use super::layers;
use super::paging::Page;
use super::problem::{ApiResult, Kind, Problem};
use super::types::{self, finite};
use super::{Shared, etag, find_any_scene, find_scene, objects, require_serving};
use crate::engine::{self, LightMap, World};
use crate::jobs::budget::JobBudget;
use crate::jobs::tell_scene;
use crate::state::App;
use crate::store::StoreError;
use crate::store::records::SceneChange;
use crate::store::scene::{SceneEntry, SceneState};

/// Which page of a list.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ListQuery {
    /// Entries per page.
    #[param(example = 50, minimum = 1)]
    pub(super) limit: Option<usize>,
    /// `next_cursor` of the page before.
    pub(super) cursor: Option<String>,
}

/// All scenes, newest first.
#[utoipa::path(
    get, path = "/v1/scenes", tag = "scenes", operation_id = "list_scenes", params(ListQuery),
    responses((status = 200, body = types::ScenePage, description = "A page of scenes"))
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
    responses((status = 200, body = types::Scene, description = "The scene, with the objects and lights that its accepted edits lead to",
        headers(("ETag" = String, description = "The edits that were accepted so far (`accepted_edits`), for `If-Match`"))))
)]
pub(super) async fn get(State(app): Shared, ApiPath(id): ApiPath<String>) -> ApiResult<Response> {
    let scene = find_any_scene(&app, &id)?;
    let (accepted, json) = scene_json(&app, &scene, None).await?;
    Ok(([(header::ETAG, etag(accepted))], json).into_response())
}

/// What of a scene is to change; what is absent stays.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ScenePatch {
    /// Name for people.
    #[schema(example = "living room")]
    name: Option<String>,
    /// What the scene works towards: its jobs go on towards it, or begin to.
    target: Option<Budget>,
}

/// Changes a scene's name or its target. Light that is less than the target asks for is refined, behind edits that wait.
#[utoipa::path(
    patch, path = "/v1/scenes/{scene}", tag = "scenes", operation_id = "patch_scene",
    params(
        ("scene" = String, Path, description = "The scene's id"),
        ("If-Match" = Option<String>, Header, description = "Refuse unless the scene has accepted exactly the edits that its `ETag` told (`accepted_edits`)", example = "\"3\""),
    ),
    request_body(content = ScenePatch, content_type = "application/json"),
    responses((status = 200, body = types::Scene, description = "The scene as it is now",
        headers(("ETag" = String, description = "The edits that were accepted so far (`accepted_edits`), for `If-Match`"))))
)]
pub(super) async fn patch(
    State(app): Shared,
    ApiPath(id): ApiPath<String>,
    headers: HeaderMap,
    body: Body,
) -> ApiResult<Response> {
    require_serving(&app)?;
    let scene = find_scene(&app, &id).await?;
    let ScenePatch { name, target } = read_json(&app, &headers, body).await?;
    if let Some(name) = &name {
        check_name(Allowed::ASKED, name, "name")?;
    }
    let samples = app.config.defaults.bake_samples;
    let target = target.map(|target| to_budget(Some(target), "target", samples, &app.config)).transpose()?;
    let head = scene.head.clone().lock_owned().await;
    if scene.is_deleted() {
        return Err(Problem::new(Kind::UnknownScene, format!("there is no scene {id:?}")));
    }
    if_match(&headers, head.sequence)?;
    let (its_app, its_scene) = (app.clone(), scene.clone());
    let change = move || {
        let change = SceneChange { name: name.as_deref(), target: target.as_ref() };
        its_app.store.scene_changed(its_scene.number, &change)?;
        name.into_iter().for_each(|name| its_scene.set_name(name));
        target.into_iter().for_each(|target| its_app.jobs.set_target(&its_scene, &head, target));
        Ok::<_, StoreError>(())
    };
    app.compute.run(change).await??;
    let (accepted, json) = scene_json(&app, &scene, None).await?;
    Ok(([(header::ETAG, etag(accepted))], json).into_response())
}

/// Deletes a scene, cancels its jobs and ends its streams.
#[utoipa::path(
    delete, path = "/v1/scenes/{scene}", tag = "scenes", operation_id = "delete_scene",
    params(
        ("scene" = String, Path, description = "The scene's id"),
        ("If-Match" = Option<String>, Header, description = "Refuse unless the scene has accepted exactly the edits that its `ETag` told (`accepted_edits`)", example = "\"3\""),
    ),
    responses((status = 204, description = "Deleted"))
)]
pub(super) async fn delete(
    State(app): Shared,
    ApiPath(id): ApiPath<String>,
    headers: HeaderMap,
) -> ApiResult<StatusCode> {
    let scene = find_any_scene(&app, &id)?;
    // No edit is accepted in between: it would queue a job for a scene that is gone.
    let head = scene.head.lock().await;
    if_match(&headers, head.sequence)?;
    let (its_app, number) = (app.clone(), scene.number);
    app.compute.run(move || its_app.store.scene_deleted(number)).await??;
    if app.scenes.remove(scene.number).is_none() {
        return Err(Problem::new(Kind::UnknownScene, format!("there is no scene {id:?}")));
    }
    app.assets.release(scene.number);
    app.jobs.cancel_scene(&scene);
    app.pictures.forget(scene.number);
    tell_scene(&scene, types::SceneChange::Deleted, &scene.published());
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
        name: scene.name(),
        state: scene.state().into(),
        mode: scene.mode,
        spacing: published.world.spacing(),
        version: published.version,
        elements: published.world.slots() as u64,
        object_count: published.world.scene.objects.len() as u64,
        current_job: current_job(app, scene),
        error: scene.error(),
        created_at: scene.created_at,
    }
}

/// A scene with all that is in it after the edits that were accepted, as JSON. Thousands of objects take their time: they are told and
/// written on the pool. `bake`: the job that was queued with the scene, told also where it is done by now. The number of
/// accepted edits comes with it.
pub(super) async fn scene_json(
    app: &Arc<App>,
    scene: &Arc<SceneEntry>,
    bake: Option<String>,
) -> ApiResult<(u64, Response)> {
    let (its_app, its_scene) = (app.clone(), scene.clone());
    let write = move || {
        let mut told = tell(&its_app, &its_scene);
        told.current_job = bake.or(told.current_job);
        serde_json::to_vec(&told).map(|json| (told.accepted_edits, json))
    };
    let (accepted, json) = app.compute.answer(write).await?.map_err(Problem::internal)?;
    Ok((accepted, ([(header::CONTENT_TYPE, "application/json")], json).into_response()))
}

fn tell(app: &App, scene: &SceneEntry) -> types::Scene {
    // In this order: what is shown was accepted before.
    let (published, shown) = scene.shown();
    let (published, accepted) = (&*published, scene.accepted());
    let (world, state) = (&published.world, scene.state());
    types::Scene {
        id: scene.id.clone(),
        name: scene.name(),
        state: state.into(),
        mode: scene.mode,
        spacing: world.spacing(),
        sizing: matches!(state, SceneState::Ready).then(|| world.spread().into()),
        texels_per_metre: world.atlas().map(|atlas| atlas.texels_per_metre()),
        version: published.version,
        elements_version: published.elements_version,
        elements: world.slots() as u64,
        live_elements: world.element_count() as u64,
        triangles: world.triangle_count() as u64,
        memory_bytes: (world.memory_bytes() + published.memory_bytes() + scene.aside_bytes(published)) as u64,
        estimated_rmse: published.stated_rmse().and_then(finite),
        light_error: published.stated().into(),
        target: scene.target().map(to_target),
        accepted_edits: accepted.sequence,
        published_edits: shown,
        unlit_edits: scene.unlit() as u64,
        objects: objects::tell(published, shown, &accepted),
        lights: accepted.world.lights().map(|info| light(&info, &accepted.world, &published.map)).collect(),
        layers: published.layers.iter().map(layers::describe).collect(),
        cameras: world.scene.cameras.iter().zip(0..).map(camera).collect(),
        warnings: match state {
            SceneState::Ready => accepted.world.warnings(),
            SceneState::Preparing | SceneState::Damaged => world.scene.warnings.clone(),
        },
        degenerate_triangles: world.scene.degenerate_triangles as u64,
        current_job: current_job(app, scene),
        error: scene.error(),
        created_at: scene.created_at,
    }
}

fn to_target(target: JobBudget) -> Budget {
    let JobBudget { samples_per_element, max_seconds, target_rmse, .. } = target;
    Budget { samples_per_element: Some(samples_per_element), max_seconds, target_rmse }
}

fn light(info: &rebake_core::LightInfo<'_>, world: &World, map: &LightMap) -> types::Light {
    use rebake_core::scene::LightKind;
    let light = info.light;
    let node = engine::node_of(&world.scene, light);
    let mut told = types::Light {
        name: light.name.clone(),
        node: node.map(|node| node.index),
        id: node.and_then(|node| node.id.as_deref()).map(str::to_owned),
        kind: info.kind.to_owned(),
        color: light.color.to_array(),
        intensity: light.intensity,
        layer: map.layer_of(&light.name).map(|layer| layer.name.clone()),
        object: None,
        position: None,
        direction: None,
        range: None,
        inner_cone_angle: None,
        outer_cone_angle: None,
        angle: None,
        rotation: None,
    };
    match &light.kind {
        LightKind::Emissive { object, .. } => told.object = Some(object.clone()),
        LightKind::Point { position, range } => (told.position, told.range) = (Some(position.to_array()), *range),
        LightKind::Spot { position, direction, inner_cone_angle, outer_cone_angle, range } => {
            (told.position, told.range) = (Some(position.to_array()), *range);
            told.direction = Some(direction.to_array());
            (told.inner_cone_angle, told.outer_cone_angle) = (Some(*inner_cone_angle), Some(*outer_cone_angle));
        }
        LightKind::Directional { direction, angle } => {
            (told.direction, told.angle) = (Some(direction.to_array()), Some(*angle));
        }
        LightKind::Sky { rotation, .. } => told.rotation = Some(rotation.to_degrees()),
        LightKind::Environment => {}
    }
    told
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
