//! Who may call what: asked before every handler.

use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderValue, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::problem::{Kind, Problem};
use crate::auth::{self, Scope};
use crate::state::{App, Phase};

/// Lets a request pass whose token allows it, once all is restored. Health, the description and the meaning of problems
/// are open to all, at any time. Without tokens only requests to the service's own names pass.
pub(super) async fn requests(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    if app.config.tokens.is_none() && !is_to_own_host(&request, &app.config.host_names) {
        let text = "the service answers only to its own host names: --host-name gives it more";
        return Problem::new(Kind::ForeignHost, text).into_response();
    }
    if request.uri().path().starts_with("/v1/") && !is_restored(&app).await {
        let text = "the service is bringing back what its data directory holds";
        return Problem::new(Kind::Restoring, text).retry_after(5).into_response();
    }
    let Some(needed) = scope_for(request.method(), request.uri().path()) else { return next.run(request).await };
    if app.config.is_replica && needed != Scope::Read {
        return Problem::new(Kind::ReadOnly, "this is a replica: changes go to the service that it follows")
            .into_response();
    }
    let Some(tokens) = &app.config.tokens else { return next.run(request).await };
    match bearer(request.headers()).map(|token| tokens.scope_of(token)) {
        Some(Some(scope)) if scope >= needed => next.run(request).await,
        Some(Some(_)) => refuse(Kind::Forbidden, needed, Some("insufficient_scope")),
        Some(None) => refuse(Kind::Unauthorized, needed, Some("invalid_token")),
        None => refuse(Kind::Unauthorized, needed, None),
    }
}

/// Waits for the end of a restore, not for ever.
async fn is_restored(app: &App) -> bool {
    let mut phase = app.phase.subscribe();
    let end = phase.wait_for(|phase| *phase != Phase::Restoring);
    tokio::time::timeout(app.config.timeouts.restore, end).await.is_ok()
}

/// Whether a request names this service, and not what somebody else's name server made point to it.
fn is_to_own_host(request: &Request, own: &[String]) -> bool {
    let named = request.headers().get_all(header::HOST).iter().map(|host| host.to_str().unwrap_or_default());
    let mut hosts = request.uri().authority().map(Authority::as_str).into_iter().chain(named);
    // Browsers always name one.
    hosts.all(|host| auth::is_own_host(host, own))
}

/// What a call needs; none where it is open.
fn scope_for(method: &Method, path: &str) -> Option<Scope> {
    if path != "/metrics" && !path.starts_with("/v1/") {
        return None;
    }
    let whole = |list: &str| path.strip_prefix(list).is_some_and(|rest| !rest.trim_end_matches('/').contains('/'));
    let is_upload = whole("/v1/scenes/") || whole("/v1/assets/");
    Some(match *method {
        Method::GET | Method::HEAD | Method::OPTIONS => Scope::Read,
        Method::POST if ["/sample", "/probes"].iter().any(|end| path.trim_end_matches('/').ends_with(end)) => {
            Scope::Read
        }
        // What is deleted does not come back.
        Method::DELETE if is_upload => Scope::Admin,
        _ => Scope::Edit,
    })
}

/// The token of `Authorization: Bearer …`.
fn bearer(headers: &HeaderMap) -> Option<&str> {
    let (scheme, token) = headers.get(header::AUTHORIZATION)?.to_str().ok()?.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then_some(token.trim())
}

/// RFC 6750.
fn refuse(kind: Kind, needed: Scope, error: Option<&str>) -> Response {
    let scope = needed.as_str();
    let detail = match kind {
        Kind::Forbidden => format!("the token does not allow this call: it needs the scope {scope}"),
        _ => format!("send Authorization: Bearer with a token of the scope {scope}"),
    };
    let error = error.map(|error| format!(", error=\"{error}\", scope=\"{scope}\"")).unwrap_or_default();
    let mut response = Problem::new(kind, detail).into_response();
    if let Ok(value) = HeaderValue::from_str(&format!("Bearer realm=\"rebake\"{error}")) {
        response.headers_mut().insert(header::WWW_AUTHENTICATE, value);
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_call_needs_its_scope() {
        for (method, path, scope) in [
            (Method::GET, "/healthz", None),
            (Method::GET, "/openapi.json", None),
            (Method::GET, "/metrics", Some(Scope::Read)),
            (Method::GET, "/v1/scenes", Some(Scope::Read)),
            (Method::POST, "/v1/scenes", Some(Scope::Edit)),
            (Method::DELETE, "/v1/scenes/s1", Some(Scope::Admin)),
            (Method::DELETE, "/v1/scenes/s1/", Some(Scope::Admin)),
            (Method::DELETE, "/v1/assets/d749", Some(Scope::Admin)),
            (Method::DELETE, "/v1/jobs/j1", Some(Scope::Edit)),
            (Method::POST, "/v1/scenes/s1/edits", Some(Scope::Edit)),
            (Method::POST, "/v1/scenes/s1/sample", Some(Scope::Read)),
            (Method::POST, "/v1/scenes/s1/probes", Some(Scope::Read)),
            (Method::PATCH, "/v1/anything", Some(Scope::Edit)),
        ] {
            assert_eq!(scope_for(&method, path), scope, "{method} {path}");
        }
    }
}
