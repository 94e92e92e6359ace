//! Tiles of atlas pages for as long as a client listens.

use std::io;
use std::sync::Arc;

use axum::body::Body;
use axum::http::{HeaderName, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures_util::stream;
use rebake_core::delta::TILE_CONTENT_TYPE;
use tokio::sync::{OwnedSemaphorePermit, watch};

use super::atlas_deltas::make;
use super::coding::Coder;
use super::extract::Coding;
use super::problem::{ApiResult, Kind, Problem};
use crate::state::{App, Phase};
use crate::store::scene::SceneEntry;
use crate::store::tiles::Selection;
use crate::store::versions::Published;

/// Bytes that are compressed at a time.
const PIECE: usize = 1 << 20;

/// Every new version from `since` on, until the scene or the layer is gone.
pub(super) fn follow(
    app: &Arc<App>,
    scene: &Arc<SceneEntry>,
    selection: Selection,
    since: u64,
    coding: Coding,
) -> ApiResult<Response> {
    let busy = |_| Problem::new(Kind::TooManyStreams, "too many streams are open").retry_after(5);
    let permit = app.streams.clone().try_acquire_owned().map_err(busy)?;
    let sender = Sender {
        app: Arc::clone(app),
        published: scene.watch_published(),
        deleted: scene.watch_deleted(),
        phase: app.phase.subscribe(),
        coder: Some(Coder::new(coding).map_err(Problem::internal)?),
        version: (since > 0).then_some(since),
        waiting: Bytes::new(),
        scene: Arc::clone(scene),
        selection,
        _permit: permit,
    };
    let pieces = stream::unfold(sender, |mut sender| async move { Some((sender.next().await?, sender)) });
    let about = [
        (header::CONTENT_TYPE, HeaderValue::from_static(TILE_CONTENT_TYPE)),
        (header::VARY, HeaderValue::from_static("accept-encoding")),
        (HeaderName::from_static("x-accel-buffering"), HeaderValue::from_static("no")),
    ];
    Ok((about, coding.headers(), Body::from_stream(pieces)).into_response())
}

/// Sends frames to one client, at the client's pace: a snapshot is made when all of the one before is on its way, from
/// whatever is newest then.
struct Sender {
    app: Arc<App>,
    scene: Arc<SceneEntry>,
    published: watch::Receiver<Arc<Published>>,
    deleted: watch::Receiver<bool>,
    phase: watch::Receiver<Phase>,
    /// None at the end, or while it works on the pool.
    coder: Option<Coder>,
    /// The client's, once it has everything sent; none before the first frame of a client that has nothing.
    version: Option<u64>,
    /// What is left of the snapshot.
    waiting: Bytes,
    selection: Selection,
    _permit: OwnedSemaphorePermit,
}

impl Sender {
    async fn next(&mut self) -> Option<io::Result<Bytes>> {
        loop {
            if !self.waiting.is_empty() {
                return Some(self.piece().await);
            }
            // Looked at before the map: what was published before the end is still sent.
            let is_gone = *self.deleted.borrow() || self.published.has_changed().is_err();
            let ends = is_gone || *self.phase.borrow() == Phase::Closing;
            let published = self.published.borrow_and_update().clone();
            let is_there = self.selection.layer.as_ref().is_none_or(|name| published.layer(name).is_some());
            if is_there && self.version.is_none_or(|version| version < published.version) {
                let (since, version) = (self.version.unwrap_or(0), published.version);
                match make(&self.app, &self.scene, published, &self.selection, since).await {
                    Ok(delta) => self.waiting = delta.frame,
                    Err(problem) => {
                        self.coder = None;
                        return Some(Err(io::Error::other(problem.to_string())));
                    }
                }
                self.app.metrics.delta_bytes.inc_by(self.waiting.len() as u64);
                self.version = Some(version);
                continue;
            }
            drop(published);
            if ends || !is_there {
                return match self.coder.take()?.finish() {
                    Ok(tail) if tail.is_empty() => None,
                    end => Some(end),
                };
            }
            // An error is the end of the scene: the loop sees it above.
            tokio::select! {
                _ = self.published.changed() => {}
                _ = self.deleted.changed() => {}
                _ = self.phase.changed() => {}
            }
        }
    }

    /// The next bytes of the snapshot, compressed.
    async fn piece(&mut self) -> io::Result<Bytes> {
        let piece = self.waiting.split_to(self.waiting.len().min(PIECE));
        let mut coder = self.coder.take().ok_or_else(|| io::Error::other("the stream has ended"))?;
        let encode = move || (coder.push(piece), coder);
        let (bytes, coder) = self.app.compute.answer(encode).await.map_err(io::Error::other)?;
        self.coder = Some(coder);
        bytes
    }
}
