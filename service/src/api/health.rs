//! Liveness, readiness, metrics, and what problems mean.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};

use super::extract::ApiPath;
use super::problem::{self, ApiResult, Kind, Problem};
use super::types::Health;
use super::{Shared, require_serving};
use crate::gauges;
use crate::state::Phase;

/// The process is alive.
#[utoipa::path(get, path = "/healthz", tag = "service", operation_id = "alive", responses((status = 200, body = Health, description = "It answers")))]
pub(super) async fn alive() -> Json<Health> {
    Json(Health { status: "ok".to_owned() })
}

/// The service takes requests.
#[utoipa::path(get, path = "/readyz", tag = "service", operation_id = "ready", responses((status = 200, body = Health, description = "It takes work")))]
pub(super) async fn ready(State(app): Shared) -> ApiResult<Json<Health>> {
    if *app.phase.borrow() == Phase::Restoring {
        let text = format!("{} scenes are back, others are to come", app.scenes.all().len());
        return Err(Problem::new(Kind::Restoring, text).retry_after(1));
    }
    require_serving(&app)?;
    Ok(Json(Health { status: "ok".to_owned() }))
}

const OPEN_METRICS: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Content type of metrics for whoever does not ask for OpenMetrics; the lines that are written are good as both.
const PROMETHEUS_TEXT: &str = "text/plain; version=0.0.4; charset=utf-8";

/// Metrics for Prometheus, as OpenMetrics where that is accepted.
#[utoipa::path(
    get, path = "/metrics", tag = "service", operation_id = "metrics",
    responses((status = 200, description = "Prometheus text", content(
        (String = "text/plain"),
        (String = "application/openmetrics-text")
    )))
)]
pub(super) async fn metrics(State(app): Shared, headers: HeaderMap) -> ApiResult<Response> {
    let accepts = |value: &HeaderValue| value.to_str().is_ok_and(|v| v.contains("application/openmetrics-text"));
    let is_open = headers.get_all(header::ACCEPT).iter().any(accepts);
    let its_app = app.clone();
    let text = app.compute.run(move || gauges::text(&its_app)).await?.map_err(Problem::internal)?;
    Ok(([(header::CONTENT_TYPE, if is_open { OPEN_METRICS } else { PROMETHEUS_TEXT })], text).into_response())
}

/// What a kind of problem means.
#[utoipa::path(
    get, path = "/problems/{slug}", tag = "service", operation_id = "describe_problem",
    params(("slug" = String, Path, description = "Last segment of a problem's `type`", example = "unknown-object")),
    responses((status = 200, body = String, content_type = "text/plain", description = "What it means"))
)]
pub(super) async fn problem(ApiPath(slug): ApiPath<String>) -> ApiResult<String> {
    problem::describe(&slug)
        .ok_or_else(|| Problem::new(Kind::NotFound, format!("there is no kind of problem {slug:?}")))
}
