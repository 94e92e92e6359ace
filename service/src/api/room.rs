//! Large answers take turns on a connection, and have room in memory before they are made.

use std::sync::Arc;

use axum::body::HttpBody as _;
use axum::extract::rejection::PathRejection;
use axum::extract::{Extension, Path, Request, State};
use axum::http::StatusCode;
use axum::middleware::Next;
use axum::response::Response;
use http_body_util::BodyExt;
use tokio::sync::Semaphore;

use super::problem::{ApiResult, Kind, Problem};
use crate::state::App;

/// Large answers of one connection that are made or sent at the same time; the others wait.
const PER_CONNECTION: usize = 4;
/// Bytes per element of the largest file, glTF by vertices.
const BYTES_PER_ELEMENT: u64 = 80;
/// Smaller answers need no room.
const SMALL: u64 = 64 << 10;

/// The turns of one connection.
#[derive(Clone)]
pub(crate) struct Turns(Arc<Semaphore>);

impl Turns {
    pub(crate) fn new() -> Turns {
        Turns(Arc::new(Semaphore::new(PER_CONNECTION)))
    }
}

/// Around routes whose answers grow with the scene.
pub(super) async fn for_answers(
    State(app): State<Arc<App>>,
    Extension(Turns(turns)): Extension<Turns>,
    names: Result<Path<Vec<(String, String)>>, PathRejection>,
    request: Request,
    next: Next,
) -> ApiResult<Response> {
    let turn = turns.acquire_owned().await.map_err(Problem::internal)?;
    // What is wrong with a path is told by who answers.
    let names = names.map_or_else(|_| Vec::new(), |Path(names)| names);
    let scene = names.iter().find(|(name, _)| name == "scene").and_then(|(_, id)| app.ids.parse_scene(id));
    let elements =
        scene.and_then(|number| app.scenes.get(number)).map_or(0, |scene| scene.published().world.element_count());
    let room = app.answers.room(elements as u64 * BYTES_PER_ELEMENT).await.ok_or_else(|| {
        let reason = "clients take in so little of what they asked for that there is no room for more";
        Problem::new(Kind::TooManyAnswers, reason).retry_after(5)
    })?;
    let (head, body) = next.run(request).await.into_parts();
    match body.size_hint().exact() {
        Some(bytes) if bytes > SMALL && head.status == StatusCode::OK => {
            // It is all there: nothing waits for a client here.
            let bytes = body.collect().await.map_err(Problem::internal)?.to_bytes();
            Ok(Response::from_parts(head, room.send(bytes, turn)))
        }
        _ => Ok(Response::from_parts(head, body)),
    }
}
