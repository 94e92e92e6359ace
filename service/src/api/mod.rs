//! The HTTP API. Handlers unpack, call and wrap; what they call knows no HTTP.

mod accuracy;
mod assets;
pub mod atlas;
mod atlas_deltas;
mod between;
mod checks;
mod coding;
mod computed;
mod deltas;
mod drain;
mod edit_beside;
mod edit_light_types;
mod edit_lights;
mod edit_names;
mod edit_nodes;
pub(crate) mod edit_parse;
pub mod edit_types;
mod edits;
mod elements;
mod event_types;
mod events;
mod extract;
mod filter;
mod glb;
mod guard;
mod health;
mod history;
mod job_types;
mod jobs;
mod keys;
mod layers;
mod light_types;
mod lightmap;
pub(crate) mod misread;
mod objects;
mod openapi;
mod paging;
mod painter;
mod prepare;
mod probes;
pub mod problem;
mod render;
mod room;
mod sample;
mod scenes;
pub(crate) mod skies;
mod tile_stream;
mod trace;
pub mod types;
mod upload_query;
mod uploads;
mod versioned;

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::State;
use axum::http::{HeaderName, Method};
use axum::middleware::from_fn_with_state;
use axum::response::IntoResponse;
use axum::routing::{delete, get, post};

pub(crate) use coding::encode_body;
pub(crate) use extract::{Coding, ETags};
use tower_http::cors::{AllowOrigin, Any, CorsLayer};

pub use edits::{read_edits, read_focus};
pub use openapi::document;

use crate::state::App;
use crate::store::scene::SceneEntry;
use problem::{ApiResult, Kind, Problem};
pub(crate) use room::Turns;

/// What handlers get.
type Shared = State<Arc<App>>;

/// All routes.
pub(crate) fn router(app: Arc<App>) -> Router {
    let large = Router::new()
        .route("/v1/scenes/{scene}/objects/{object}", get(objects::get))
        .route("/v1/scenes/{scene}/lightmap", get(lightmap::get))
        .route("/v1/scenes/{scene}/lightmap/deltas/{versions}", get(between::get))
        .route("/v1/scenes/{scene}/elements", get(elements::get))
        .route("/v1/scenes/{scene}/atlas/{page}", get(atlas::get_page))
        .route("/v1/scenes/{scene}/atlas/deltas", get(atlas_deltas::get))
        .route("/v1/scenes/{scene}/atlas/deltas/{versions}", get(atlas_deltas::get_between))
        .route_layer(from_fn_with_state(app.clone(), room::for_answers));
    Router::new()
        .merge(large)
        .route("/v1/scenes", post(uploads::create).get(scenes::list))
        .route("/v1/scenes/{scene}", get(scenes::get).patch(scenes::patch).delete(scenes::delete))
        .route("/v1/scenes/{scene}/edits", post(edits::create).get(history::list))
        .route("/v1/scenes/{scene}/events", get(events::of_scene))
        .route("/v1/scenes/{scene}/objects", get(objects::list))
        .route("/v1/scenes/{scene}/lightmap/deltas", get(deltas::get))
        .route("/v1/scenes/{scene}/atlas", get(atlas::get))
        .route("/v1/scenes/{scene}/render", get(render::get))
        .route("/v1/scenes/{scene}/sample", post(sample::create))
        .route("/v1/scenes/{scene}/error", get(accuracy::get))
        .route("/v1/scenes/{scene}/probes", get(probes::get).post(probes::create))
        .route("/v1/assets", post(assets::create).get(assets::list))
        .route("/v1/assets/{asset}", delete(assets::delete))
        .route("/v1/jobs", get(jobs::list))
        .route("/v1/jobs/{job}", get(jobs::get).delete(jobs::cancel))
        .route("/v1/jobs/{job}/pause", post(jobs::pause))
        .route("/v1/jobs/{job}/resume", post(jobs::resume))
        .route("/v1/jobs/{job}/events", get(events::of_job))
        .route("/healthz", get(health::alive))
        .route("/readyz", get(health::ready))
        .route("/metrics", get(health::metrics))
        .route("/openapi.json", get(openapi::get))
        .route("/problems/{slug}", get(health::problem))
        .merge(crate::viewer::routes())
        .fallback(|| async { Problem::new(Kind::NotFound, "there is nothing at this path").into_response() })
        .method_not_allowed_fallback(|| async {
            Problem::new(Kind::MethodNotAllowed, "this path does not take this method").into_response()
        })
        .layer(from_fn_with_state(app.clone(), guard::requests))
        .layer(from_fn_with_state(app.clone(), drain::bodies))
        .layer(cors(&app.config.cors_origins))
        .layer(from_fn_with_state(app.clone(), trace::requests))
        .with_state(app)
}

/// Which pages of other origins a browser lets call the API: none unless configured.
fn cors(origins: &[String]) -> CorsLayer {
    let origin = match origins.iter().any(|origin| origin == "*") {
        true => AllowOrigin::any(),
        false => AllowOrigin::list(origins.iter().filter_map(|origin| origin.parse().ok())),
    };
    if origins.is_empty() {
        return CorsLayer::new();
    }
    let exposed = [
        "etag",
        "location",
        "retry-after",
        "x-rebake-version",
        "x-rebake-estimated-rmse",
        "x-request-id",
        "content-encoding",
    ];
    CorsLayer::new()
        .allow_origin(origin)
        .allow_methods([Method::GET, Method::POST, Method::PATCH, Method::DELETE])
        .allow_headers(Any)
        .expose_headers(exposed.map(HeaderName::from_static))
        .max_age(Duration::from_secs(3600))
}

/// A scene that can be worked with, by its id. One that is being prepared is waited for.
async fn find_scene(app: &App, id: &str) -> ApiResult<Arc<SceneEntry>> {
    let scene = find_any_scene(app, id)?;
    if tokio::time::timeout(app.config.timeouts.preparing, scene.prepared()).await.is_err() {
        let reason = "the scene is being prepared: its elements are laid out and its trees are built";
        return Err(Problem::new(Kind::ScenePreparing, reason).retry_after(5));
    }
    if scene.is_deleted() {
        return find_any_scene(app, id);
    }
    match scene.error() {
        Some(error) if scene.is_damaged() => Err(Problem::new(Kind::SceneDamaged, error)),
        _ => Ok(scene),
    }
}

/// A scene by its id, whatever its state.
fn find_any_scene(app: &App, id: &str) -> ApiResult<Arc<SceneEntry>> {
    let found = app.ids.parse_scene(id).and_then(|number| app.scenes.get(number));
    found.ok_or_else(|| Problem::new(Kind::UnknownScene, format!("there is no scene {id:?}")))
}

/// Refuses new work while the service ends.
fn require_serving(app: &App) -> ApiResult<()> {
    if app.is_serving() {
        return Ok(());
    }
    Err(Problem::new(Kind::ShuttingDown, "the service is about to end").retry_after(5))
}

/// A version, or a number of accepted edits, as an entity tag.
fn etag(version: u64) -> String {
    format!("\"{version}\"")
}
