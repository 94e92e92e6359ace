//! What was asked of a scene.

use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use super::edit_types::EditRequest;
use super::extract::{ApiPath, ApiQuery};
use super::paging::Onward;
use super::problem::ApiResult;
use super::scenes::ListQuery;
use super::{Shared, find_scene};
use crate::state::App;
use crate::store::history::{Accepted, Turn, Way};
use crate::store::lighting::Sequence;

/// An accepted edit request.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub(super) struct HistoryEntry {
    /// Its place among the scene's edit requests, from 1.
    #[schema(example = 3)]
    sequence: u64,
    /// As it was sent.
    #[schema(value_type = EditRequest)]
    request: Value,
    /// The job that lit it, even where it is forgotten by now; none in what an earlier build has kept.
    #[schema(example = "j4-k3f9qz")]
    job: Option<String>,
    /// When it was accepted; none in what an earlier build has kept.
    #[schema(value_type = Option<String>, format = DateTime, example = "2026-11-23T09:00:00Z")]
    accepted_at: Option<Timestamp>,
    /// It was taken back, and does not count.
    undone: bool,
    /// The request that it takes back.
    #[serde(skip_serializing_if = "Option::is_none")]
    undoes: Option<u64>,
    /// The request that it makes count again.
    #[serde(skip_serializing_if = "Option::is_none")]
    redoes: Option<u64>,
}

/// One page of a scene's history.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub(super) struct HistoryPage {
    /// Newest last.
    items: Vec<HistoryEntry>,
    /// The request that `undo` would take back.
    undo: Option<u64>,
    /// The request that `redo` would make again.
    redo: Option<u64>,
    /// Asks for the next page; absent on the last.
    next_cursor: Option<String>,
}

/// The edit requests of a scene since its upload, newest last.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/edits", tag = "edits", operation_id = "list_edits",
    params(("scene" = String, Path, description = "The scene's id"), ListQuery),
    responses((status = 200, body = HistoryPage, description = "A page of edit requests"))
)]
pub(super) async fn list(
    State(app): Shared,
    ApiPath(id): ApiPath<String>,
    ApiQuery(query): ApiQuery<ListQuery>,
) -> ApiResult<Json<HistoryPage>> {
    let scene = find_scene(&app, &id).await?;
    let page = Onward::new(&app.config, query.limit, query.cursor.as_deref())?;
    let head = scene.head.lock().await;
    let (found, next_cursor) = page.cut(head.history.after(page.after, page.limit + 1), |(sequence, _)| *sequence);
    let about = |turn| head.history.plan(Way { turn, drag: false }).map(|(sequence, _)| sequence);
    let (undo, redo) = (about(Turn::Undo), about(Turn::Redo));
    drop(head);
    let items = found.into_iter().map(|(sequence, accepted)| entry(&app, sequence, &accepted)).collect();
    Ok(Json(HistoryPage { items, undo, redo, next_cursor }))
}

fn entry(app: &App, sequence: Sequence, accepted: &Accepted) -> HistoryEntry {
    let of = |wanted: Turn| accepted.turn.filter(|(turn, _)| *turn == wanted).map(|(_, sequence)| sequence);
    HistoryEntry {
        sequence,
        // It was read when it was accepted.
        request: serde_json::from_slice(&accepted.body).unwrap_or_default(),
        job: accepted.job.map(|number| app.ids.job(number)),
        accepted_at: accepted.accepted_at,
        undone: accepted.is_undone,
        undoes: of(Turn::Undo),
        redoes: of(Turn::Redo),
    }
}
