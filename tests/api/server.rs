//! A service on a free port, and shorthands to talk to it.

use std::time::Duration;

use rebake::Config;
use rebake::client::{Client, EventStream};
use rebake::cluster::{ClusterConfig, replicate};
use reqwest::{Method, RequestBuilder, StatusCode};
use serde_json::Value;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

use super::described;
use super::engine::{Script, Scripted, Step};
use super::glb;

/// Longer than anything a test waits for.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

/// A running service.
pub(crate) struct Server {
    pub(crate) base: String,
    pub(crate) http: reqwest::Client,
    pub(crate) client: Client,
    stop: Option<oneshot::Sender<()>>,
    ended: JoinHandle<std::io::Result<()>>,
}

/// An answer, read to its end.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) status: StatusCode,
    pub(crate) headers: reqwest::header::HeaderMap,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    /// Sends the request. The description has to tell of the answer's status.
    pub(crate) async fn to(request: RequestBuilder) -> Answer {
        let (http, request) = request.build_split();
        let request = request.unwrap();
        let (method, path) = (request.method().clone(), request.url().path().to_owned());
        let response = http.execute(request).await.unwrap();
        let (status, headers) = (response.status(), response.headers().clone());
        described::check(&method, &path, status);
        Answer { status, headers, body: response.bytes().await.unwrap().to_vec() }
    }

    /// The body as JSON; the status has to be `status`.
    #[track_caller]
    pub(crate) fn json(&self, status: u16) -> Value {
        assert_eq!(self.status, status, "{}", String::from_utf8_lossy(&self.body));
        serde_json::from_slice(&self.body).unwrap()
    }

    /// A problem document of this kind; answers its detail.
    #[track_caller]
    pub(crate) fn problem(&self, status: u16, slug: &str) -> String {
        let document = self.json(status);
        assert_eq!(self.header("content-type"), "application/problem+json");
        assert_eq!(document["type"], format!("/problems/{slug}"), "{document}");
        assert_eq!(document["status"], status);
        assert!(document["title"].is_string());
        document["detail"].as_str().unwrap().to_owned()
    }

    #[track_caller]
    pub(crate) fn header(&self, name: &str) -> &str {
        self.headers.get(name).unwrap_or_else(|| panic!("no header {name}")).to_str().unwrap()
    }
}

impl Server {
    /// A service with the real engine and few threads.
    pub(crate) async fn start() -> Server {
        Server::with(|_| ()).await
    }

    /// A service whose jobs go on only when the script says so.
    pub(crate) async fn scripted() -> (Server, Script) {
        Server::scripted_with(|_| ()).await
    }

    pub(crate) async fn scripted_with(change: impl FnOnce(&mut Config)) -> (Server, Script) {
        let (engine, script) = Scripted::new();
        let server = Server::with(|config| {
            config.engine = engine;
            config.timeouts.progress = Duration::ZERO;
            // Turns end when the script says so.
            config.timeouts.share = Duration::from_secs(3600);
            change(config);
        });
        (server.await, script)
    }

    pub(crate) async fn with(change: impl FnOnce(&mut Config)) -> Server {
        let mut config = Config { threads: 2, ..Config::default() };
        // However busy the machine is: uploads are answered with their scenes.
        config.timeouts.upload_answer = Duration::from_secs(600);
        // Streams that a test leaves open are cut then.
        config.timeouts.shutdown = Duration::from_secs(1);
        change(&mut config);
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let base = format!("http://{}", listener.local_addr().unwrap());
        let (stop, stopped) = oneshot::channel::<()>();
        let shutdown = async move {
            let _ = stopped.await;
        };
        let ended = tokio::spawn(rebake::run(listener, config, shutdown));
        let client = Client::new(&base).unwrap();
        Server { base, http: reqwest::Client::new(), client, stop: Some(stop), ended }
    }

    /// A replica of the service that meets others there.
    pub(crate) async fn replica(cluster: ClusterConfig) -> Server {
        let mut config = Config { threads: 2, cluster: Some(cluster), ..Config::default() };
        config.timeouts.shutdown = Duration::from_secs(1);
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let base = format!("http://{}", listener.local_addr().unwrap());
        let (stop, stopped) = oneshot::channel::<()>();
        let shutdown = async move {
            let _ = stopped.await;
        };
        let ended = tokio::spawn(replicate(listener, config, shutdown));
        let client = Client::new(&base).unwrap();
        Server { base, http: reqwest::Client::new(), client, stop: Some(stop), ended }
    }

    /// A service that runs in another process.
    pub(crate) fn elsewhere(base: &str) -> Server {
        let (base, client) = (base.to_owned(), Client::new(base).unwrap());
        Server { base, http: reqwest::Client::new(), client, stop: None, ended: tokio::spawn(async { Ok(()) }) }
    }

    /// Tells the service to stop.
    pub(crate) fn signal(&mut self) {
        if let Some(stop) = self.stop.take() {
            let _ = stop.send(());
        }
    }

    /// Stops the service and waits for its end.
    pub(crate) async fn stop(mut self) {
        self.signal();
        patiently(self.ended).await.unwrap().unwrap();
    }

    pub(crate) fn request(&self, method: Method, path: &str) -> RequestBuilder {
        self.http.request(method, format!("{}{path}", self.base)).timeout(PATIENCE)
    }

    pub(crate) async fn get(&self, path: &str) -> Answer {
        Answer::to(self.request(Method::GET, path)).await
    }

    pub(crate) async fn delete(&self, path: &str) -> Answer {
        Answer::to(self.request(Method::DELETE, path)).await
    }

    pub(crate) async fn post_glb(&self, path: &str, glb: Vec<u8>) -> Answer {
        let request = self.request(Method::POST, path).header("content-type", "model/gltf-binary").body(glb);
        Answer::to(request).await
    }

    pub(crate) async fn post_json(&self, path: &str, body: &Value) -> Answer {
        self.post_text(path, &body.to_string(), &[]).await
    }

    pub(crate) async fn post_text(&self, path: &str, body: &str, headers: &[(&str, &str)]) -> Answer {
        let mut request = self.request(Method::POST, path).header("content-type", "application/json");
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        Answer::to(request.body(body.to_owned())).await
    }

    /// Uploads the room; `query` begins with `?` or is empty. Coarse, so that everything is quick.
    pub(crate) async fn room(&self, query: &str) -> Value {
        let join = if query.is_empty() { "?" } else { "&" };
        self.post_glb(&format!("/v1/scenes{query}{join}spacing=1"), glb::room().bytes()).await.json(201)
    }

    /// Uploads the crate; answers the asset's id.
    pub(crate) async fn crate_asset(&self) -> String {
        let answer = self.post_glb("/v1/assets", glb::crate_asset()).await;
        answer.json(if answer.status == 200 { 200 } else { 201 })["asset"].as_str().unwrap().to_owned()
    }

    /// Posts an edit that has to be accepted; answers the job's id.
    pub(crate) async fn edit(&self, scene: &Value, edit: &Value) -> String {
        let answer = self.post_json(&format!("{}/edits", path_of(scene)), edit).await;
        let job = answer.json(202);
        assert_eq!(answer.header("location"), format!("/v1/jobs/{}", job["id"].as_str().unwrap()));
        job["id"].as_str().unwrap().to_owned()
    }

    /// Follows a job's events until `wanted`; answers the job as of then.
    pub(crate) async fn until(&self, job: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        let mut events = self.client.job_events(job, None).await.unwrap();
        loop {
            let event = next_event(&mut events).await.unwrap_or_else(|| panic!("the events of {job} ended"));
            // A reader that is too slow for the remembered events gets the whole state instead.
            if ["job", "reset"].contains(&event.0.as_str()) && wanted(&event.2) {
                return event.2;
            }
        }
    }

    /// Waits for a job's end.
    pub(crate) async fn end_of(&self, job: &str) -> Value {
        self.until(job, |job| ["succeeded", "failed", "canceled"].iter().any(|end| job["state"] == *end)).await
    }

    /// A room whose bake is done, with an edit that runs until the script lets it go; answers the edit's job too.
    pub(crate) async fn held_room(&self, script: &Script) -> (Value, String) {
        script.run(&[Step::Round, Step::Finish]);
        let scene = self.baked_room("").await;
        let dim = serde_json::json!({ "op": "relight", "lights": [{ "light": "lamp", "intensity": 7 }] });
        let hold = self.edit(&scene, &dim).await;
        self.until(&hold, |job| job["state"] == "running").await;
        (scene, hold)
    }

    /// Lets the bake of a new scene run to its end.
    pub(crate) async fn baked_room(&self, query: &str) -> Value {
        let scene = self.room(query).await;
        let job = self.end_of(scene["current_job"].as_str().unwrap()).await;
        assert_eq!(job["state"], "succeeded", "{job}");
        self.get(&path_of(&scene)).await.json(200)
    }
}

/// Waits, but not for ever.
pub(crate) async fn patiently<T>(future: impl Future<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, future).await.expect("it takes too long")
}

/// The next event: type, id, data. None where the stream ends.
pub(crate) async fn next_event(events: &mut EventStream) -> Option<(String, u64, Value)> {
    let event = patiently(events.next()).await.unwrap()?;
    let id = event.id.as_deref().unwrap().parse().unwrap();
    Some((event.event, id, serde_json::from_str(&event.data).unwrap()))
}

pub(crate) fn path_of(scene: &Value) -> String {
    format!("/v1/scenes/{}", scene["id"].as_str().unwrap())
}
