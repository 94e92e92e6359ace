//! A span, an id and a log line per request; a panic becomes an answer.

use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderName, HeaderValue};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures_util::FutureExt;
use tracing::Instrument;

use super::problem::Problem;
use crate::state::App;

static REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");
static COUNT: AtomicU64 = AtomicU64::new(1);

/// Wraps every request.
pub(super) async fn requests(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let id = request_id(&request);
    let route = request.extensions().get::<MatchedPath>().map_or("-", MatchedPath::as_str).to_owned();
    let method = request.method().clone();
    let span = tracing::info_span!(
        "request",
        id = id.to_str().unwrap_or_default(),
        %method,
        path = request.uri().path(),
        route = route.as_str(),
    );
    let started = Instant::now();
    let answer = AssertUnwindSafe(next.run(request)).catch_unwind();
    async move {
        let mut response = match answer.await {
            Ok(response) => response,
            Err(_panic) => Problem::internal("a handler panicked").into_response(),
        };
        let (status, seconds) = (response.status().as_u16(), started.elapsed().as_secs_f64());
        app.metrics.answered(method.as_str(), &route, status, seconds);
        // Hundredths are as much as a log needs.
        let ms = (seconds * 1e5).round() / 1e2;
        if response.status().is_server_error() {
            tracing::warn!(status, ms, "answered");
        } else {
            tracing::info!(status, ms, "answered");
        }
        response.headers_mut().insert(REQUEST_ID.clone(), id);
        response
    }
    .instrument(span)
    .await
}

/// The client's id where it sent a sensible one.
fn request_id(request: &Request) -> HeaderValue {
    let sensible = |id: &&HeaderValue| id.len() <= 64 && id.as_bytes().iter().all(u8::is_ascii_graphic);
    match request.headers().get(&REQUEST_ID).filter(sensible) {
        Some(id) => id.clone(),
        None => HeaderValue::from(COUNT.fetch_add(1, Ordering::Relaxed)),
    }
}
