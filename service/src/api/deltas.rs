//! What changed since a version, once or for as long as the client listens.

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;

use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures_util::stream;
use rebake_core::delta::{self, Frame};
use serde::{Deserialize, Serialize};
use tokio::sync::{OwnedSemaphorePermit, watch};
use utoipa::{IntoParams, ToSchema};

use super::coding::Coder;
use super::extract::{ApiPath, ApiQuery, Coding};
use super::filter::view;
use super::layers;
use super::problem::{ApiResult, Kind, Problem};
use super::types::PartName;
use super::versioned::{ESTIMATED_RMSE, VERSION};
use super::{Shared, etag, find_scene};
use crate::filter::Filter;
use crate::state::{App, Phase};
use crate::store::filtered::FilteredLight;
use crate::store::scene::SceneEntry;
use crate::store::versions::{Published, Wanted};

/// How values travel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum Precision {
    /// Three `f32` per value: bit for bit.
    #[default]
    Full,
    /// Three `f16` per value: half the size.
    Half,
}

/// What to fetch.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct DeltaQuery {
    /// The version that the client has; 0 for nothing.
    #[param(example = 0)]
    since: u64,
    /// Keep the connection open and send every new version.
    follow: Option<bool>,
    /// The name of a layer: its values at reference strengths, in the scene's mode, instead of the light map's. The
    /// stream ends where the map loses the layer.
    #[param(example = "ceiling")]
    layer: Option<String>,
    /// Which part, of all light or of a layer; the scene's mode where absent. Any other comes whole with every version.
    #[param(inline)]
    part: Option<PartName>,
    /// Whether noise is averaged away where it may be; `none` where absent. `since` is the version of values that were
    /// filtered alike.
    #[param(inline)]
    filter: Option<Filter>,
    /// How values travel; `full` where absent.
    #[param(inline)]
    precision: Option<Precision>,
}

/// Frames from version `since` to now. With `follow=true` the connection stays open and frames arrive as versions are
/// published; a client that is slower than that skips versions, never changes. One that reconnects with the version of
/// the last frame it has applied with flag bit 0 loses nothing.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/lightmap/deltas", tag = "light map", operation_id = "get_deltas",
    params(("scene" = String, Path, description = "The scene's id"), DeltaQuery),
    responses((status = 200, body = Vec<u8>, content_type = "application/vnd.rebake.delta", description = "Frames; none where the client is up to date",
        headers(("X-Rebake-Estimated-Rmse" = String, description = "Without `follow`, `layer`, `part` and `filter`: stated error of the light map at `ETag`. With `follow` the scene's `snapshot` events tell that of each version"))))
)]
pub(super) async fn get(
    State(app): Shared,
    ApiPath(id): ApiPath<String>,
    ApiQuery(query): ApiQuery<DeltaQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let scene = find_scene(&app, &id).await?;
    let follow = query.follow.unwrap_or(false);
    let published = scene.published();
    let (version, stated) = (published.version, published.stated_rmse());
    let layer = query.layer.as_deref().map(|text| layers::find(&published, text)).transpose()?;
    let part = query.part.map(|part| {
        let no_light =
            || Problem::field(Kind::InvalidQuery, "part", "is no light: deltas have none of it, lightmap has");
        part.of_light().ok_or_else(no_light)
    });
    let whole = part.transpose()?.filter(|part| *part != Wanted::Light(published.mode()));
    drop(published);
    if query.since > version {
        let text = format!("since: the light map is at version {version}, not {}", query.since);
        return Err(Problem::new(Kind::VersionAhead, text));
    }
    let busy = |_| Problem::new(Kind::TooManyStreams, "too many streams are open").retry_after(5);
    let permit = app.streams.clone().try_acquire_owned().map_err(busy)?;
    let coding = Coding::accepted(&headers);
    let sender = Sender::new(&app, &scene, &query, (layer, whole), coding, permit).map_err(Problem::internal)?;
    let frames = stream::unfold(sender, |mut sender| async move { Some((sender.next().await?, sender)) });
    let mut response = Body::from_stream(frames).into_response();
    let head = response.headers_mut();
    head.extend(coding.headers());
    head.insert(header::CONTENT_TYPE, header::HeaderValue::from_static(delta::CONTENT_TYPE));
    head.insert(header::VARY, header::HeaderValue::from_static("accept-encoding"));
    head.insert(HeaderName::from_static("x-accel-buffering"), header::HeaderValue::from_static("no"));
    if !follow {
        let is_map = query.layer.is_none() && whole.is_none() && query.filter.unwrap_or_default() == Filter::None;
        if let Some(stated) = stated.filter(|_| is_map) {
            head.insert(ESTIMATED_RMSE.clone(), stated.to_string().parse().map_err(Problem::internal)?);
        }
        let value = |text: String| header::HeaderValue::from_str(&text).map_err(Problem::internal);
        head.insert(header::ETAG, value(etag(version))?);
        head.insert(VERSION.clone(), value(version.to_string())?);
    }
    Ok(response)
}

/// Sends frames to one client, at the client's pace: the next one is made when the connection asks for it, from
/// whatever is newest then.
struct Sender {
    app: Arc<App>,
    published: watch::Receiver<Arc<Published>>,
    deleted: watch::Receiver<bool>,
    phase: watch::Receiver<Phase>,
    /// None at the end, or while it works on the pool.
    coder: Option<Coder>,
    /// The client's, once it has everything sent; none before the first frame of a client that has nothing.
    version: Option<u64>,
    /// Of which layer; none for the map itself.
    layer: Option<Arc<str>>,
    /// A part of which no history is kept.
    whole: Option<Wanted>,
    filter: Filter,
    filtered: Arc<FilteredLight>,
    follow: bool,
    half: bool,
    waiting: VecDeque<Bytes>,
    _permit: OwnedSemaphorePermit,
}

impl Sender {
    fn new(
        app: &Arc<App>,
        scene: &SceneEntry,
        query: &DeltaQuery,
        (layer, whole): (Option<String>, Option<Wanted>),
        coding: Coding,
        permit: OwnedSemaphorePermit,
    ) -> io::Result<Sender> {
        Ok(Sender {
            app: app.clone(),
            published: scene.watch_published(),
            deleted: scene.watch_deleted(),
            phase: app.phase.subscribe(),
            coder: Some(Coder::new(coding)?),
            version: (query.since > 0).then_some(query.since),
            layer: layer.map(Arc::from),
            whole,
            filter: query.filter.unwrap_or_default(),
            filtered: scene.filtered.clone(),
            follow: query.follow.unwrap_or(false),
            half: query.precision == Some(Precision::Half),
            waiting: VecDeque::new(),
            _permit: permit,
        })
    }

    async fn next(&mut self) -> Option<io::Result<Bytes>> {
        loop {
            if let Some(bytes) = self.waiting.pop_front() {
                return Some(Ok(bytes));
            }
            let coder = self.coder.take()?;
            // Looked at before the map: what was published before the end is still sent.
            let is_gone = *self.deleted.borrow() || self.published.has_changed().is_err();
            let ends = !self.follow || is_gone || *self.phase.borrow() == Phase::Closing;
            let published = self.published.borrow_and_update().clone();
            let is_there = self.layer.as_ref().is_none_or(|name| published.layer(name).is_some());
            let ends = ends || !is_there;
            if is_there && self.version.is_none_or(|version| version < published.version) {
                if let Err(error) = self.encode(coder, published).await {
                    return Some(Err(error));
                }
                continue;
            }
            drop(published);
            if ends {
                match coder.finish() {
                    Ok(tail) if tail.is_empty() => return None,
                    end => return Some(end),
                }
            }
            self.coder = Some(coder);
            // An error is the end of the scene: the loop sees it above.
            tokio::select! {
                _ = self.published.changed() => {}
                _ = self.deleted.changed() => {}
                _ = self.phase.changed() => {}
            }
        }
    }

    async fn encode(&mut self, mut coder: Coder, published: Arc<Published>) -> io::Result<()> {
        const VALUE_BYTES: usize = 12;
        let told = |problem: Problem| io::Error::other(problem.to_string());
        let published = view(&self.app, &self.filtered, published, self.filter).await.map_err(told)?;
        let since = self.version.unwrap_or(0);
        let (version, half, layer, whole) = (published.version, self.half, self.layer.clone(), self.whole);
        let max_values = (self.app.config.limits.frame_bytes / VALUE_BYTES).max(1);
        let encode = move || {
            let frame = match (&layer, whole) {
                (None, None) => Some(published.delta(since)),
                (Some(name), None) => published.layer_delta(name, since),
                (None, Some(part)) => Some(Frame::whole(&published.deliver(part), version)),
                (Some(name), Some(part)) => published.deliver_layer(name, part).map(|v| Frame::whole(&v, version)),
            };
            let mut frame = frame.ok_or_else(|| io::Error::other("the layer is gone"))?;
            drop(published);
            if half {
                frame = frame.halved();
            }
            let mut bytes = 0;
            let pieces = frame.split(max_values).into_iter().map(|frame| {
                let frame = frame.encode();
                bytes += frame.len();
                coder.push(frame)
            });
            let pieces = pieces.collect::<io::Result<VecDeque<Bytes>>>()?;
            io::Result::Ok((pieces, coder, bytes))
        };
        let (pieces, coder, bytes) = self.app.compute.answer(encode).await.map_err(io::Error::other)??;
        self.app.metrics.delta_bytes.inc_by(bytes as u64);
        self.waiting = pieces;
        self.coder = Some(coder);
        self.version = Some(version);
        Ok(())
    }
}
