//! Edits: accepted at once, lit by a job.

use std::sync::Arc;

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use rebake_core::allowed::Allowed;
use serde_json::Value;

use super::edit_beside::{to_edit_budget, to_focus, to_tiles};
use super::edit_names::check_names;
use super::edit_nodes;
use super::edit_parse::{Parsed, parse, to_edits, used_assets};
use super::edit_types::{self, EditRequest};
use super::extract::{ApiPath, ETags, read_body, require_content_type};
use super::keys::{idempotency_key, reused};
use super::layers;
use super::problem::{ApiResult, Kind, Problem};
use super::types::{Job, to_event_data};
use super::uploads::{full_problem, memory_problem};
use super::{Shared, etag, find_scene, require_serving};
use crate::config::Config;
use crate::engine::{Edit, EditError, EditErrorKind, Focus, Importance, Scene, World};
use crate::jobs::queue::{JobKind, Priority};
use crate::jobs::seeds::next_seed;
use crate::jobs::{About, JobSpec, new_record};
use crate::memory;
use crate::state::App;
use crate::store::accepted::Head;
use crate::store::assets::Assets;
use crate::store::history::{self, History};
use crate::store::lighting::{Sequence, Unlit};
use crate::store::records::{Accepted, EditRecord, KeyRecord};
use crate::store::scene::SceneEntry;

/// Edits a scene. The edit is checked against the scene with all edits accepted before, takes effect as a unit or not
/// at all, and is lit by the job that is answered.
///
/// Canceling the job later cancels work on light, not the edit.
#[utoipa::path(
    post, path = "/v1/scenes/{scene}/edits", tag = "edits", operation_id = "create_edit",
    params(
        ("scene" = String, Path, description = "The scene's id"),
        ("Idempotency-Key" = Option<String>, Header, description = "Makes the request safe to repeat: the same key with the same body answers the same job"),
        ("If-Match" = Option<String>, Header, description = "Refuse unless the scene has accepted exactly the edits that its `ETag` told (`accepted_edits`): of clients that edit the same state at the same time one wins. Versions of the light map do not count here", example = "\"3\""),
    ),
    request_body(content = EditRequest, content_type = "application/json", examples(
        ("insert" = (value = json!({"op": "insert", "asset": "d74981efa70a0c880b8d8c1985d075dbcbf679b99a5f9914e5aaf96b831a9e24", "name": "chair-2", "transform": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.5, 0, 2, 1]}))),
        ("remove" = (value = json!({"op": "remove", "objects": ["sofa"]}))),
        ("move" = (value = json!({"op": "move", "object": "sofa", "transform": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.5, 0, 2, 1], "focus": {"point": [0.5, 0, 2], "radius": 1.5}}))),
        ("material" = (value = json!({"op": "material", "object": "sofa", "albedo": [0.6, 0.1, 0.1]}))),
        ("repaint" = (value = json!({"op": "material", "material": "wood", "albedo": [0.3, 0.2, 0.1]}))),
        ("by_node" = (value = json!({"edits": [{"op": "remove", "objects": [{"node": 3}]}, {"op": "move_light", "light": {"id": "lamp-7f3a"}, "position": [1, 2, 0]}]}))),
        ("hide" = (value = json!({"op": "hide", "objects": ["sofa"]}))),
        ("show" = (value = json!({"op": "show", "objects": ["sofa"]}))),
        ("undo" = (value = json!({"op": "undo"}))),
        ("relight" = (value = json!({"op": "relight", "lights": [{"light": "lamp", "color": [1, 0.9, 0.8], "intensity": 2.5}]}))),
        ("insert_light" = (value = json!({"op": "insert_light", "name": "lamp-2", "light": {"kind": "point", "position": [0, 2, 0], "color": [1, 1, 1], "intensity": 40}}))),
        ("sky" = (value = json!({"op": "sky", "asset": "d74981efa70a0c880b8d8c1985d075dbcbf679b99a5f9914e5aaf96b831a9e24", "rotation": 90, "strength": 1.5}))),
        ("group_lights" = (value = json!({"op": "group_lights", "name": "ceiling", "lights": ["lamp-1", "lamp-2"]}))),
        ("several" = (value = json!({"edits": [{"op": "remove", "objects": ["sofa"]}, {"op": "move_light", "light": "lamp", "position": [1, 2, 0]}], "budget": {"max_seconds": 2.5}})))
    )),
    responses((status = 202, body = Job, description = "Accepted; the job lights it",
        headers(
            ("Location" = String, description = "Path of the job"),
            ("ETag" = String, description = "The scene's, with this edit: its accepted edits so far")
        )))
)]
pub(super) async fn create(
    State(app): Shared,
    ApiPath(id): ApiPath<String>,
    headers: HeaderMap,
    body: Body,
) -> ApiResult<Response> {
    require_serving(&app)?;
    let scene = find_scene(&app, &id).await?;
    require_content_type(&headers, &["application/json"])?;
    let key = idempotency_key(&headers)?;
    let body = read_body(&app, &headers, body, app.config.limits.edit_bytes).await?;
    let body_hash = blake3::hash(&body);

    let mut head = scene.head.clone().lock_owned().await;
    if scene.is_deleted() {
        return Err(Problem::new(Kind::UnknownScene, format!("there is no scene {id:?}")));
    }
    if let Some(known) = key.as_ref().and_then(|key| head.keys.get(key)) {
        if known.body_hash != body_hash {
            return Err(reused());
        }
        let answer = match app.jobs.get(known.job) {
            Some((job, about)) => to_event_data(&Job::new(&app.ids, &job, &about)),
            None => known.answer.clone(),
        };
        return Ok(accepted(&app.ids.job(known.job), &answer));
    }
    if_match(&headers, head.sequence)?;
    let body = edit_nodes::with_names(&body, &head.world.scene)?;
    let request = read_request(&app, &head, &body)?;

    // On the pool to the end: once begun, an edit is accepted even where the client has gone away.
    let (its_app, its_scene) = (app.clone(), scene.clone());
    let job = app.compute.run(move || {
        let key = key.map(|key| (key, body_hash));
        accept(&its_app, &its_scene, &mut head, request, &body, key)
    });
    let (id, answer) = job.await??;
    Ok(accepted(&id, &answer))
}

/// Whether the scene is still as the client knows it, where it says so (`If-Match`): by the edits that were accepted, however
/// far their light is.
pub(super) fn if_match(headers: &HeaderMap, accepted: Sequence) -> ApiResult<()> {
    let tags = ETags::from_header(headers, &header::IF_MATCH)?;
    if tags.is_none_or(|tags| tags.matches_strongly(&accepted.to_string())) {
        return Ok(());
    }
    let text = format!(
        "the scene has accepted {accepted} edits, so that its ETag is \"{accepted}\"; If-Match compares with that, not \
         with the light map's version"
    );
    Err(Problem::new(Kind::PreconditionFailed, text))
}

/// A request, checked as far as it can be without the engine.
struct Request {
    parsed: Parsed,
    edits: Vec<Edit>,
    priority: Priority,
    spec: JobSpec,
}

fn read_request(app: &App, head: &Head, body: &[u8]) -> ApiResult<Request> {
    let limits = &app.config.limits;
    let parsed = parse(body, limits.edits_per_request)?;
    check_names(&parsed)?;
    let edits = to_edits(&parsed, &app.assets, &head.history, Allowed::ASKED)?;
    let budget = to_edit_budget(parsed.budget, &app.config)?;
    let importance = read_importance(&parsed, &head.world, &app.config)?;
    let priority = parsed.priority;
    let dragged = parsed.moves().filter(|moves| moves.is_step).map_or_else(Vec::new, |moves| moves.things);
    let spec = JobSpec { importance, dragged, ..JobSpec::new(budget, 0, head.sequence) };
    Ok(Request { parsed, edits, priority, spec })
}

fn read_importance(parsed: &Parsed, world: &World, config: &Config) -> ApiResult<Importance> {
    let focus = parsed.focus.as_ref().map(|focus| to_focus(focus, world)).transpose()?;
    let tiles = parsed.tiles.as_ref().map(|tiles| to_tiles(tiles, config)).transpose()?;
    Ok(Importance { focus, tiles })
}

/// Applies the edits to the head, keeps the request and queues the job: its id and the answer. On an error nothing has
/// changed.
fn accept(
    app: &Arc<App>,
    scene: &Arc<SceneEntry>,
    head: &mut Head,
    request: Request,
    body: &Bytes,
    key: Option<(String, blake3::Hash)>,
) -> ApiResult<(String, Arc<str>)> {
    let Request { parsed, edits, priority, mut spec } = request;
    let ticket = app.jobs.ticket(scene.number).map_err(full_problem)?;
    let limits = &app.config.limits;
    if scene.unlit() >= limits.queued_per_scene + limits.unlit_edits {
        let text = "too many edits of this scene are not lit yet";
        return Err(Problem::new(Kind::QueueFull, text).retry_after(1));
    }
    head.world.check_places(&edits).map_err(|error| edit_problem(error, parsed.is_list))?;
    let room = app.memory.promise(memory::estimate_inserts(&edits, head.world.density()), scene.accepted().bytes);
    let _promise = room.map_err(|full| memory_problem("edited scene", full))?;
    let transition = match edits.is_empty() {
        true => None,
        false => Some(head.world.apply(&edits).map_err(|error| edit_problem(error, parsed.is_list))?),
    };
    let mut room_of_layers = None;
    if let Some(transition) = &transition {
        room_of_layers = Some(layers::room_for(app, scene, &transition.after, &edits)?);
        app.pictures.remember(scene.number, scene.published());
    }
    let mut jobs = head.jobs;
    spec.seed = next_seed(app.config.seed, &mut jobs);
    spec.sequence = head.sequence + u64::from(transition.is_some());
    let sequence = spec.sequence;
    let record = new_record(ticket.number, scene, (JobKind::Edit, priority), spec);
    let job = Job::new(
        &app.ids,
        &record.job,
        &About { scene: scene.id.clone(), sequence, target_rmse: record.spec.budget.target_rmse },
    );
    let answer = to_event_data(&job);
    let key = key.map(|(key, body_hash)| KeyRecord { key, body_hash, job: ticket.number, answer: answer.clone() });
    let accepted_at = record.job.created_at;
    let edit = transition.is_some().then_some(EditRecord { sequence, body, accepted_at });
    let gone = |asset| Problem::new(Kind::UnknownAsset, format!("the asset {asset:?} was deleted"));
    let needed = app.assets.need(scene.number, &used_assets(&parsed)).map_err(gone)?;
    let kept = app.store.accepted(&Accepted { scene: scene.number, edit, job: &record, key: key.as_ref(), jobs });
    kept.inspect_err(|_| app.assets.unneed(scene.number, &needed))?;
    let unlit = transition.map(|transition| {
        let (job, accepted_at) = (Some(ticket.number), Some(accepted_at));
        let moves = parsed.moves();
        let body = Arc::from(&**body);
        let accepted = history::Accepted { body, job, accepted_at, moves, turn: None, is_undone: false };
        head.history.accept(accepted, parsed.way(), (&head.world.scene, &transition.after.scene));
        head.world = transition.after.clone();
        head.sequence = sequence;
        scene.set_accepted(head);
        room_of_layers.iter().for_each(|room| scene.expect_layers(room.expected));
        Unlit { sequence, transition: Arc::new(transition), edits: edits.into() }
    });
    head.jobs = jobs;
    ticket.submit(scene, &record, || unlit.into_iter().for_each(|unlit| scene.accept(unlit)));
    key.into_iter().for_each(|key| head.keys.insert(key));
    Ok((job.id, answer))
}

fn edit_problem(error: EditError, is_list: bool) -> Problem {
    let field = match error.field.strip_prefix("edits[0].") {
        Some(field) if !is_list => field.to_owned(),
        _ => error.field,
    };
    let names_light = field.ends_with("light") || field.contains("lights[");
    let kind = match error.kind {
        EditErrorKind::NotFound if names_light => Kind::UnknownLight,
        EditErrorKind::NotFound if field.ends_with("material") => Kind::UnknownMaterial,
        EditErrorKind::NotFound => Kind::UnknownObject,
        EditErrorKind::Conflict => Kind::NameTaken,
        EditErrorKind::Invalid => Kind::InvalidValue,
        EditErrorKind::TooLarge => Kind::EditTooLarge,
    };
    Problem::field(kind, field, error.reason)
}

/// Reads the body of an edit request against `world` as the service does, without one: for fuzzing.
///
/// # Errors
/// What is wrong with it, for people.
pub fn read_edits(
    body: &[u8],
    assets: impl IntoIterator<Item = (String, Scene)>,
    world: &World,
) -> Result<Vec<Edit>, String> {
    let told = |problem: Problem| problem.to_string();
    let held = Assets::new(usize::MAX, usize::MAX);
    for (id, scene) in assets {
        held.insert(id, scene, 0);
    }
    let config = Config::default();
    let body = edit_nodes::with_names(&Bytes::copy_from_slice(body), &world.scene).map_err(told)?;
    let parsed = parse(&body, config.limits.edits_per_request).map_err(told)?;
    to_edit_budget(parsed.budget, &config).map_err(told)?;
    read_importance(&parsed, world, &config).map_err(told)?;
    to_edits(&parsed, &held, &History::new(0), Allowed::ASKED).map_err(told)
}

/// Reads a focus as an edit carries it, for a scene with these cameras.
///
/// # Errors
/// What is wrong with it, for people.
pub fn read_focus(focus: &Value, world: &World) -> Result<Focus, String> {
    let focus: edit_types::Focus =
        serde_path_to_error::deserialize(focus).map_err(|error| format!("focus: {error}"))?;
    to_focus(&focus, world).map_err(|problem| problem.to_string())
}

fn accepted(job: &str, answer: &Arc<str>) -> Response {
    let headers =
        [(header::CONTENT_TYPE, "application/json".to_owned()), (header::LOCATION, format!("/v1/jobs/{job}"))];
    // An answer that an earlier build has kept tells no edits.
    let told = serde_json::from_str::<Job>(answer).ok();
    let tag = told.map(|job| [(header::ETAG, etag(job.accepted_edits))]);
    (StatusCode::ACCEPTED, headers, tag, answer.to_string()).into_response()
}
