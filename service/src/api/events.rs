//! Server-sent events with ids that rise by one, and `Last-Event-ID` to resume.
//!
//! A stream begins with the present state, as a `job` or `scene_state` event that bears the id of the newest event. A
//! client that comes back within the remembered events gets exactly what it missed; one that comes later gets a
//! `reset` event with the whole state first.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::Arc;

use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, StatusCode};
use axum::response::sse::{self, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use futures_util::stream;
use tokio::sync::{OwnedSemaphorePermit, watch};

use super::extract::{ApiPath, text_header};
use super::problem::{ApiResult, Kind, Problem};
use super::types::to_event_data;
use super::{Shared, find_any_scene, find_scene, jobs, scenes};
use crate::events::{Event, EventLog};
use crate::state::{App, Phase};

static LAST_EVENT_ID: HeaderName = HeaderName::from_static("last-event-id");

/// What happens to a job: `job` events with its state and progress, `snapshot` events with new versions. The stream
/// ends with the job; resumed after its last event, it is 204.
#[utoipa::path(
    get, path = "/v1/jobs/{job}/events", tag = "jobs", operation_id = "job_events",
    params(
        ("job" = String, Path, description = "The job's id"),
        ("Last-Event-ID" = Option<String>, Header, description = "Id of the last event that the client has"),
    ),
    responses(
        (status = 200, body = String, content_type = "text/event-stream", description = "`job` (a Job), `snapshot` (a SnapshotEvent), `reset` (a Job)"),
        (status = 204, description = "The job has ended and the client has all of its events"),
    )
)]
pub(super) async fn of_job(
    State(app): Shared,
    ApiPath(id): ApiPath<String>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let (number, job) = jobs::find(&app, &id)?;
    let unknown = || Problem::new(Kind::UnknownJob, format!("there is no job {id:?}"));
    let log = app.jobs.events(number).ok_or_else(unknown)?;
    let state: Arc<str> = to_event_data(&job);
    serve(&app, log, &headers, "job", Box::new(move |kept| kept.unwrap_or_else(|| state.clone())))
}

/// What happens to a scene: `job` events of all its jobs, `snapshot` events with new versions, `scene` events when
/// its objects, lights or elements change or it is deleted.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/events", tag = "scenes", operation_id = "scene_events",
    params(
        ("scene" = String, Path, description = "The scene's id"),
        ("Last-Event-ID" = Option<String>, Header, description = "Id of the last event that the client has"),
    ),
    responses(
        (status = 200, body = String, content_type = "text/event-stream", description = "`scene_state`, `reset` (a SceneSummary), `scene` (a SceneEvent), `snapshot` (a SnapshotEvent), `job` (a Job)"),
        (status = 204, description = "The scene was deleted and the client has all of its events"),
    )
)]
pub(super) async fn of_scene(
    State(app): Shared,
    ApiPath(id): ApiPath<String>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let scene = find_any_scene(&app, &id)?;
    if scene.is_damaged() {
        find_scene(&app, &id).await?;
    }
    let (its_app, log) = (app.clone(), scene.events.clone());
    let state = move |_| to_event_data(&scenes::summary(&its_app, &scene));
    serve(&app, log, &headers, "scene_state", Box::new(state))
}

/// The whole state, given what the log keeps of it.
type StateOf = Box<dyn Fn(Option<Arc<str>>) -> Arc<str> + Send>;

fn serve(
    app: &Arc<App>,
    log: Arc<EventLog>,
    headers: &HeaderMap,
    first: &'static str,
    state: StateOf,
) -> ApiResult<Response> {
    let busy = || Problem::new(Kind::TooManyStreams, "too many streams are open").retry_after(5);
    let permit = app.streams.clone().try_acquire_owned().map_err(|_| busy())?;
    let mut feed = Feed {
        changed: log.watch(),
        phase: app.phase.subscribe(),
        log,
        state,
        seen: 0,
        waiting: VecDeque::new(),
        _permit: permit,
    };
    match text_header(headers, &LAST_EVENT_ID)? {
        None => feed.begin(first),
        // What is no number was never given: the client needs the whole state.
        Some(id) => feed.seen = id.parse().unwrap_or(u64::MAX),
    }
    let batch = feed.log.since(feed.seen);
    if batch.closed && !batch.gap && batch.events.is_empty() && feed.waiting.is_empty() {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let events = stream::unfold(feed, |mut feed| async move {
        let event = feed.next().await?;
        let event = sse::Event::default().id(event.id.to_string()).event(event.name).data(&*event.data);
        Some((Ok::<_, Infallible>(event), feed))
    });
    let keep_alive = KeepAlive::new().interval(app.config.timeouts.keep_alive);
    let no_buffering = [(HeaderName::from_static("x-accel-buffering"), "no")];
    Ok((no_buffering, Sse::new(events).keep_alive(keep_alive)).into_response())
}

/// One client's view of a log.
struct Feed {
    log: Arc<EventLog>,
    changed: watch::Receiver<u64>,
    phase: watch::Receiver<Phase>,
    state: StateOf,
    seen: u64,
    waiting: VecDeque<Event>,
    _permit: OwnedSemaphorePermit,
}

impl Feed {
    /// Puts the present state first.
    fn begin(&mut self, name: &'static str) {
        let batch = self.log.since(u64::MAX);
        self.seen = batch.newest;
        self.waiting.push_back(Event { id: batch.newest, name, data: (self.state)(batch.state) });
    }

    async fn next(&mut self) -> Option<Event> {
        loop {
            if let Some(event) = self.waiting.pop_front() {
                self.seen = event.id;
                return Some(event);
            }
            let is_closing = *self.phase.borrow() == Phase::Closing;
            self.changed.mark_unchanged();
            let batch = self.log.since(self.seen);
            if batch.gap {
                self.begin("reset");
                continue;
            }
            self.waiting.extend(batch.events);
            if !self.waiting.is_empty() {
                continue;
            }
            if batch.closed || is_closing {
                return None;
            }
            tokio::select! {
                _ = self.changed.changed() => {}
                _ = self.phase.changed() => {}
            }
        }
    }
}
