//! Scenes: look, delete.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use utoipa::IntoParams;

use super::edit_parse::eye_target_up;
use super::extract::{ApiPath, ApiQuery};
use super::layers;
use super::paging::Page;
use super::problem::{ApiResult, Kind, Problem};
use super::types::{self, finite};
use super::{Shared, etag, find_any_scene};
use crate::engine::LightMap;
use crate::state::App;
use crate::store::scenes::SceneEntry;
use crate::store::versions::Published;

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
    let (version, json) = scene_json(&app, &scene, None).await?;
    Ok(([(header::ETAG, etag(version))], json).into_response())
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
    app.assets.release(scene.number);
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

/// A scene with all that is in it, of one version, as JSON. Thousands of objects take their time: they are told and
/// written on the pool. `bake`: the job that was queued with the scene, told also where it is done by now.
pub(super) async fn scene_json(
    app: &Arc<App>,
    scene: &Arc<SceneEntry>,
    bake: Option<String>,
) -> ApiResult<(u64, Response)> {
    let (its_app, its_scene) = (app.clone(), scene.clone());
    let write = move || {
        let mut told = of_published(&its_app, &its_scene, &its_scene.published());
        told.current_job = bake.or(told.current_job);
        serde_json::to_vec(&told).map(|json| (told.version, json))
    };
    let (version, json) = app.compute.answer(write).await?.map_err(Problem::internal)?;
    Ok((version, ([(header::CONTENT_TYPE, "application/json")], json).into_response()))
}

fn of_published(app: &App, scene: &SceneEntry, published: &Published) -> types::Scene {
    let world = &published.world;
    types::Scene {
        id: scene.id.clone(),
        name: scene.name.clone(),
        mode: scene.mode,
        spacing: world.spacing(),
        version: published.version,
        elements_version: published.elements_version,
        elements: world.slots() as u64,
        live_elements: world.element_count() as u64,
        triangles: world.triangle_count() as u64,
        memory_bytes: (world.memory_bytes()
            + published.memory_bytes()
            + scene.drag.memory_bytes()
            + scene.earlier.memory_bytes(&published.map)) as u64,
        estimated_rmse: published.estimated_rmse.and_then(finite),
        unlit_edits: scene.unlit() as u64,
        objects: published.objects().iter().map(types::Object::new).collect(),
        lights: world.lights().map(|info| light(&info, &published.map)).collect(),
        layers: published.layers.iter().map(layers::describe).collect(),
        cameras: world.scene.cameras.iter().zip(0..).map(camera).collect(),
        warnings: world.scene.warnings.clone(),
        degenerate_triangles: world.scene.degenerate_triangles as u64,
        current_job: current_job(app, scene),
        error: scene.error(),
        created_at: scene.created_at,
    }
}

fn light(info: &rebake_core::LightInfo<'_>, map: &LightMap) -> types::Light {
    use rebake_core::scene::LightKind;
    let light = info.light;
    let (mut angle, mut rotation) = (None, None);
    let (object, position, direction) = match &light.kind {
        LightKind::Emissive { object, .. } => (Some(object.clone()), None, None),
        LightKind::Point { position, .. } => (None, Some(*position), None),
        LightKind::Spot { position, direction, .. } => (None, Some(*position), Some(*direction)),
        LightKind::Directional { direction, angle: its_angle } => {
            angle = Some(*its_angle);
            (None, None, Some(*direction))
        }
        LightKind::Sky { rotation: turned, .. } => {
            rotation = Some(turned.to_degrees());
            (None, None, None)
        }
        LightKind::Environment => (None, None, None),
    };
    types::Light {
        name: light.name.clone(),
        kind: info.kind.to_owned(),
        color: light.color.to_array(),
        intensity: light.intensity,
        layer: map.layer_of(&light.name).map(|layer| layer.name.clone()),
        object,
        position: position.map(|p| p.to_array()),
        direction: direction.map(|d| d.to_array()),
        angle,
        rotation,
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
