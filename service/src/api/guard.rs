//! Who may call what: asked before every handler.

use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::problem::{Kind, Problem};
use crate::auth::Scope;
use crate::state::App;

/// Lets a request pass whose token allows it. Health, the description and the meaning of problems are open to all.
pub(super) async fn requests(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let Some(needed) = scope_for(request.method(), request.uri().path()) else { return next.run(request).await };
    let Some(tokens) = &app.config.tokens else { return next.run(request).await };
    match bearer(request.headers()).map(|token| tokens.scope_of(token)) {
        Some(Some(scope)) if scope >= needed => next.run(request).await,
        Some(Some(_)) => refuse(Kind::Forbidden, needed, Some("insufficient_scope")),
        Some(None) => refuse(Kind::Unauthorized, needed, Some("invalid_token")),
        None => refuse(Kind::Unauthorized, needed, None),
    }
}

/// What a call needs; none where it is open.
fn scope_for(method: &Method, path: &str) -> Option<Scope> {
    if path != "/metrics" && !path.starts_with("/v1/") {
        return None;
    }
    let is_scene = path.strip_prefix("/v1/scenes/").is_some_and(|rest| !rest.trim_end_matches('/').contains('/'));
    Some(match *method {
        Method::GET | Method::HEAD | Method::OPTIONS => Scope::Read,
        // What is deleted does not come back.
        Method::DELETE if is_scene => Scope::Admin,
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
            (Method::DELETE, "/v1/jobs/j1", Some(Scope::Edit)),
            (Method::POST, "/v1/scenes/s1/edits", Some(Scope::Edit)),
            (Method::PATCH, "/v1/anything", Some(Scope::Edit)),
        ] {
            assert_eq!(scope_for(&method, path), scope, "{method} {path}");
        }
    }
}
