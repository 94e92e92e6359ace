//! Refusals are heard: what a client still sends behind a request that was answered already is read and dropped, within
//! bounds. Clients that send first and read then would see a broken pipe in place of the answer.

use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};

use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::{StatusCode, header};
use axum::middleware::Next;
use axum::response::Response;
use bytes::Bytes;
use http_body_util::BodyExt;
use hyper::body::{Body as HttpBody, Frame, SizeHint};

use crate::state::App;

/// Answers, and drains what is left of the body beside that.
pub(super) async fn bodies(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let (parts, body) = request.into_parts();
    if body.is_end_stream() {
        return next.run(Request::from_parts(parts, body)).await;
    }
    let waits_for_leave = parts.headers.contains_key(header::EXPECT);
    let body = SharedBody(Arc::new(Mutex::new(Inner { body, was_read: false })));
    let response = next.run(Request::from_parts(parts, Body::new(body.clone()))).await;
    // Who was too slow has had its time, and who waits for `100 Continue` sends nothing more.
    let sends = response.status() != StatusCode::REQUEST_TIMEOUT && (body.lock().was_read || !waits_for_leave);
    if sends && !body.is_end_stream() {
        let (limit, time) = (app.config.limits.drain_bytes, app.config.timeouts.drain);
        tokio::spawn(tokio::time::timeout(time, drain(body, limit)));
    }
    response
}

async fn drain(mut body: SharedBody, limit: usize) {
    let mut left = limit;
    while let Some(Ok(frame)) = body.frame().await {
        let bytes = frame.data_ref().map_or(0, Bytes::len);
        if bytes > left {
            return;
        }
        left -= bytes;
    }
}

/// A body that outlives its handler.
#[derive(Clone)]
struct SharedBody(Arc<Mutex<Inner>>);

struct Inner {
    body: Body,
    was_read: bool,
}

impl SharedBody {
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl HttpBody for SharedBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let mut state = self.lock();
        state.was_read = true;
        Pin::new(&mut state.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.lock().body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.lock().body.size_hint()
    }
}
