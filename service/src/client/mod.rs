//! A small asynchronous client of the HTTP API, as the command line and the demo use it. It knows what the API's
//! description says and nothing of the service behind it.

mod error;
mod follow;
mod parts;
mod sse;
#[cfg(test)]
mod tests;
pub mod types;

pub use error::ClientError;
pub use follow::{Arrival, DeltaFollower, Retry};
pub use parts::{Part, Parts};
pub use sse::{Event, EventStream, SseParser};

use std::time::Duration;

use reqwest::{Method, RequestBuilder, Response, Url, header};
use serde::de::DeserializeOwned;
use serde_json::Value;
use types::{Asset, Job, NewScene, Page, Scene};

/// Longest answer that is read into memory.
const MAX_BODY_BYTES: usize = 4 << 30;
/// Longest problem document that is read.
const MAX_PROBLEM_BYTES: usize = 64 << 10;

/// A connection to one service. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Client {
    http: reqwest::Client,
    base: Url,
    token: Option<header::HeaderValue>,
}

/// What an edit request may carry in its headers.
#[derive(Clone, Debug, Default)]
pub struct EditOptions {
    /// Makes the request safe to repeat.
    pub idempotency_key: Option<String>,
    /// Refuse unless the scene has accepted exactly so many edits, as its `ETag` tells.
    pub if_match: Option<u64>,
}

impl Client {
    /// A client of the service at `server`, e.g. `http://127.0.0.1:7878`.
    pub fn new(server: &str) -> Result<Client, ClientError> {
        let unusable = |why: &str| ClientError::Server { server: server.to_owned(), why: why.to_owned() };
        let mut base = Url::parse(server).map_err(|error| unusable(&error.to_string()))?;
        match base.scheme() {
            "http" => {}
            "https" => {
                return Err(unusable("this build speaks plain http; put a TLS proxy in front and use http here"));
            }
            _ => return Err(unusable("it has to begin with http://")),
        }
        // A base without the slash would lose its last segment when joined.
        if !base.path().ends_with('/') {
            base.set_path(&format!("{}/", base.path()));
        }
        base.set_query(None);
        base.set_fragment(None);
        let http = reqwest::Client::builder()
            .connect_timeout(Duration::from_secs(10))
            .tcp_keepalive(Duration::from_secs(20))
            .user_agent(concat!("rebake/", env!("CARGO_PKG_VERSION")))
            .build()
            .map_err(ClientError::Http)?;
        Ok(Client { http, base, token: None })
    }

    /// Sends a bearer token with every request.
    pub fn with_token(mut self, token: &str) -> Result<Client, ClientError> {
        let mut value = header::HeaderValue::from_str(&format!("Bearer {token}")).map_err(|_| ClientError::Token)?;
        // Keeps it out of debug output.
        value.set_sensitive(true);
        self.token = Some(value);
        Ok(self)
    }

    /// The service's address.
    pub fn server(&self) -> &Url {
        &self.base
    }

    /// Whether the service takes work: an error says why not.
    pub async fn ready(&self) -> Result<(), ClientError> {
        self.send(self.request(Method::GET, &["readyz"], &[])?).await.map(drop)
    }

    /// Uploads a scene and, if `new.bake` says so, starts its bake.
    pub async fn create_scene(&self, glb: Vec<u8>, new: &NewScene) -> Result<Scene, ClientError> {
        let request = self
            .request(Method::POST, &["v1", "scenes"], &new.query())?
            .header(header::CONTENT_TYPE, "model/gltf-binary")
            .body(glb);
        self.json(request).await
    }

    /// A scene: objects, lights, version, current job.
    pub async fn scene(&self, scene: &str) -> Result<Scene, ClientError> {
        self.json(self.request(Method::GET, &["v1", "scenes", scene], &[])?).await
    }

    /// A scene, once it is prepared: right after its upload it may not be.
    pub async fn prepared_scene(&self, scene: &str) -> Result<Scene, ClientError> {
        let mut changes = self.scene_events(scene, None).await?;
        loop {
            let scene = self.scene(scene).await?;
            if !scene.is_preparing() || changes.next().await?.is_none() {
                return Ok(scene);
            }
        }
    }

    /// All scenes, newest first, as the API tells them (`SceneSummary`).
    pub async fn scenes(&self) -> Result<Vec<Value>, ClientError> {
        self.all(&["v1", "scenes"], &[]).await
    }

    /// A scene as the API tells it.
    pub async fn scene_json(&self, scene: &str) -> Result<Value, ClientError> {
        self.json(self.request(Method::GET, &["v1", "scenes", scene], &[])?).await
    }

    /// Deletes a scene.
    pub async fn delete_scene(&self, scene: &str) -> Result<(), ClientError> {
        self.send(self.request(Method::DELETE, &["v1", "scenes", scene], &[])?).await.map(drop)
    }

    /// Uploads something to insert later, or a picture of the sky; answers its id.
    pub async fn create_asset(&self, file: Vec<u8>) -> Result<String, ClientError> {
        let media_type = match rebake_core::scene::is_sky(&file) {
            true if file.starts_with(b"#?") => "image/vnd.radiance",
            true => "image/x-exr",
            false => "model/gltf-binary",
        };
        let request =
            self.request(Method::POST, &["v1", "assets"], &[])?.header(header::CONTENT_TYPE, media_type).body(file);
        let asset: Asset = self.json(request).await?;
        Ok(asset.asset)
    }

    /// All assets, newest first, as the API tells them (`AssetSummary`).
    pub async fn assets(&self) -> Result<Vec<Value>, ClientError> {
        self.all(&["v1", "assets"], &[]).await
    }

    /// Deletes an asset that no scene needs.
    pub async fn delete_asset(&self, asset: &str) -> Result<(), ClientError> {
        self.send(self.request(Method::DELETE, &["v1", "assets", asset], &[])?).await.map(drop)
    }

    /// Posts one edit, or several as `{"edits": [...]}`, as the API takes them
    /// (`openapi/openapi.json`).
    pub async fn edit(&self, scene: &str, edit: &Value, options: &EditOptions) -> Result<Job, ClientError> {
        let mut request = self
            .request(Method::POST, &["v1", "scenes", scene, "edits"], &[])?
            .header(header::CONTENT_TYPE, "application/json")
            .body(edit.to_string());
        if let Some(key) = &options.idempotency_key {
            request = request.header("Idempotency-Key", key);
        }
        if let Some(accepted) = options.if_match {
            request = request.header(header::IF_MATCH, format!("\"{accepted}\""));
        }
        self.json(request).await
    }

    /// Jobs, newest first, as the API tells them (`Job`): of one scene or all, in one state or any.
    pub async fn jobs(&self, scene: Option<&str>, state: Option<&str>) -> Result<Vec<Value>, ClientError> {
        let mut query: Vec<(&str, String)> = Vec::new();
        query.extend(scene.map(|scene| ("scene", scene.to_owned())));
        query.extend(state.map(|state| ("state", state.to_owned())));
        self.all(&["v1", "jobs"], &query).await
    }

    /// A job.
    pub async fn job(&self, job: &str) -> Result<Job, ClientError> {
        self.json(self.request(Method::GET, &["v1", "jobs", job], &[])?).await
    }

    /// Cancels a job.
    pub async fn cancel_job(&self, job: &str) -> Result<(), ClientError> {
        self.send(self.request(Method::DELETE, &["v1", "jobs", job], &[])?).await.map(drop)
    }

    /// A job's events from the beginning, or after the event `last_event_id`.
    pub async fn job_events(&self, job: &str, last_event_id: Option<&str>) -> Result<EventStream, ClientError> {
        self.events(&["v1", "jobs", job, "events"], last_event_id).await
    }

    /// A scene's events.
    pub async fn scene_events(&self, scene: &str, last_event_id: Option<&str>) -> Result<EventStream, ClientError> {
        self.events(&["v1", "scenes", scene, "events"], last_event_id).await
    }

    /// Waits until a job has ended, whatever the outcome, and calls `seen` with every state on the way. Follows the
    /// job's events and asks for the job where they are silent or the connection is lost.
    pub async fn wait_for_job(&self, job: &str, mut seen: impl FnMut(&Job)) -> Result<Job, ClientError> {
        const SILENCE: Duration = Duration::from_secs(2);
        let mut events: Option<EventStream> = None;
        let mut last_id: Option<String> = None;
        let mut failures = 0u32;
        loop {
            let known = match self.job(job).await {
                Ok(known) => known,
                Err(error) if error.is_transient() && failures < 8 => {
                    failures += 1;
                    tokio::time::sleep(Duration::from_millis(100 << failures)).await;
                    continue;
                }
                Err(error) => return Err(error),
            };
            failures = 0;
            seen(&known);
            if known.state.has_ended() {
                return Ok(known);
            }
            if events.is_none() {
                events = self.job_events(job, last_id.as_deref()).await.ok();
            }
            let Some(stream) = &mut events else {
                tokio::time::sleep(Duration::from_millis(200)).await;
                continue;
            };
            match tokio::time::timeout(SILENCE, stream.next()).await {
                Ok(Ok(Some(event))) => last_id = event.id.or(last_id),
                Ok(_) => {
                    events = None;
                    tokio::time::sleep(Duration::from_millis(50)).await;
                }
                Err(_silence) => {}
            }
        }
    }

    /// A follower of a scene's light map that starts with nothing, from version 0.
    pub fn follow(&self, scene: &str) -> DeltaFollower {
        DeltaFollower::new(self.clone(), scene)
    }

    /// The light map as a file: `exr`, `glb` or `raw`.
    pub async fn lightmap(&self, scene: &str, query: &[(&str, String)]) -> Result<Response, ClientError> {
        self.send(self.request(Method::GET, &["v1", "scenes", scene, "lightmap"], query)?).await
    }

    /// Where objects lie in the scene's atlas: an `AtlasDocument` of the API, as JSON.
    pub async fn atlas(&self, scene: &str) -> Result<serde_json::Value, ClientError> {
        self.json(self.request(Method::GET, &["v1", "scenes", scene, "atlas"], &[])?).await
    }

    /// Probes of the scene: `Probes` of the API, as JSON; `query` as the API describes it.
    pub async fn probes(&self, scene: &str, query: &[(&str, String)]) -> Result<serde_json::Value, ClientError> {
        self.json(self.request(Method::GET, &["v1", "scenes", scene, "probes"], query)?).await
    }

    /// A page of the scene's atlas; `query` as the API describes it.
    pub async fn atlas_page(
        &self,
        scene: &str,
        page: usize,
        query: &[(&str, String)],
    ) -> Result<Response, ClientError> {
        self.send(self.request(Method::GET, &["v1", "scenes", scene, "atlas", &page.to_string()], query)?).await
    }

    /// A picture; `query` as the API describes it.
    pub async fn render(&self, scene: &str, query: &[(&str, String)]) -> Result<Response, ClientError> {
        self.send(self.request(Method::GET, &["v1", "scenes", scene, "render"], query)?).await
    }

    /// A picture that gets better while one waits; `query` as the API describes it.
    pub async fn render_progressively(&self, scene: &str, query: &[(&str, String)]) -> Result<Parts, ClientError> {
        let query = [query, &[("progressive", "true".to_owned())]].concat();
        self.render(scene, &query).await.map(Parts::new)
    }

    /// Positions, normals, areas and objects: 32 bytes per element.
    pub async fn elements(&self, scene: &str) -> Result<Vec<u8>, ClientError> {
        let response = self.send(self.request(Method::GET, &["v1", "scenes", scene, "elements"], &[])?).await?;
        read_body(response, MAX_BODY_BYTES).await
    }

    /// Frames since version `since`; with `follow` the connection stays open.
    pub async fn deltas(&self, scene: &str, since: u64, follow: bool) -> Result<Response, ClientError> {
        let mut query = vec![("since", since.to_string())];
        if follow {
            query.push(("follow", "true".to_owned()));
        }
        let request = self.request(Method::GET, &["v1", "scenes", scene, "lightmap", "deltas"], &query)?;
        self.send(request).await
    }

    /// The items of all pages of a list.
    async fn all(&self, path: &[&str], query: &[(&str, String)]) -> Result<Vec<Value>, ClientError> {
        let mut items = Vec::new();
        let mut cursor: Option<String> = None;
        loop {
            let mut query = query.to_vec();
            query.extend(cursor.map(|cursor| ("cursor", cursor)));
            let page: Page = self.json(self.request(Method::GET, path, &query)?).await?;
            items.extend(page.items);
            match page.next_cursor {
                Some(next) => cursor = Some(next),
                None => return Ok(items),
            }
        }
    }

    async fn events(&self, path: &[&str], last_event_id: Option<&str>) -> Result<EventStream, ClientError> {
        let mut request = self.request(Method::GET, path, &[])?.header(header::ACCEPT, "text/event-stream");
        if let Some(id) = last_event_id {
            request = request.header("Last-Event-ID", id);
        }
        Ok(EventStream::new(self.send(request).await?))
    }

    fn request(&self, method: Method, path: &[&str], query: &[(&str, String)]) -> Result<RequestBuilder, ClientError> {
        let mut url = self.base.clone();
        match url.path_segments_mut() {
            // Segments are escaped here: an id from the command line cannot reach another path.
            Ok(mut segments) => {
                segments.pop_if_empty().extend(path);
            }
            Err(()) => {
                let why = "it cannot carry a path".to_owned();
                return Err(ClientError::Server { server: self.base.to_string(), why });
            }
        }
        if !query.is_empty() {
            url.query_pairs_mut().extend_pairs(query);
        }
        let request = self.http.request(method, url);
        Ok(match &self.token {
            Some(token) => request.header(header::AUTHORIZATION, token.clone()),
            None => request,
        })
    }

    async fn send(&self, request: RequestBuilder) -> Result<Response, ClientError> {
        let response = request.send().await.map_err(ClientError::Http)?;
        let status = response.status();
        if status.is_success() {
            return Ok(response);
        }
        let body = read_body(response, MAX_PROBLEM_BYTES).await.unwrap_or_default();
        Err(ClientError::refused(status.as_u16(), &body))
    }

    async fn json<T: DeserializeOwned>(&self, request: RequestBuilder) -> Result<T, ClientError> {
        let response = self.send(request).await?;
        let url = response.url().to_string();
        let body = read_body(response, MAX_BODY_BYTES).await?;
        serde_json::from_slice(&body).map_err(|source| ClientError::Answer { url, source })
    }
}

/// Reads a body of at most `limit` bytes.
pub async fn read_body(mut response: Response, limit: usize) -> Result<Vec<u8>, ClientError> {
    let mut body = Vec::new();
    while let Some(chunk) = response.chunk().await.map_err(ClientError::Http)? {
        if body.len() + chunk.len() > limit {
            return Err(ClientError::TooLong { limit });
        }
        body.extend_from_slice(&chunk);
    }
    Ok(body)
}
