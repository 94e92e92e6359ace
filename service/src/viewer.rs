//! The page at `/`: a level-lighting editor that talks to the API like any other client. Its files are built from
//! `viewer/` under the feature `viewer` and embedded; without them a page says how to get it.

use axum::Router;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;

use crate::api::{Coding, ETags, encode_body};

/// One embedded file.
struct File {
    name: &'static str,
    /// `Content-Type`.
    kind: &'static str,
    bytes: &'static [u8],
}

mod files {
    use super::File;

    include!(concat!(env!("OUT_DIR"), "/viewer_files.rs"));
}

/// The page loads nothing from elsewhere, and nothing but itself runs in it.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; worker-src 'self'; \
                      img-src 'self' blob: data:; connect-src 'self' blob: data:; base-uri 'none'; form-action 'none'; \
                      frame-ancestors 'none'";

/// Whether the page is part of this build.
pub fn is_embedded() -> bool {
    !files::FILES.is_empty()
}

/// `/` and the files that it names.
pub(crate) fn routes<S: Clone + Send + Sync + 'static>() -> Router<S> {
    let mut router = Router::new();
    for file in files::FILES {
        let path = if file.name == "index.html" { "/".to_owned() } else { format!("/{}", file.name) };
        router = router.route(&path, get(move |headers: HeaderMap| async move { serve(file, &headers) }));
    }
    if is_embedded() { router } else { router.route("/", get(|| async { missing() })) }
}

fn serve(file: &File, headers: &HeaderMap) -> Response {
    let tag = blake3::hash(file.bytes).to_hex()[..16].to_owned();
    let about = [
        (header::ETAG, format!("\"{tag}\"")),
        (header::CACHE_CONTROL, "no-cache".to_owned()),
        (header::VARY, "accept-encoding".to_owned()),
        (header::CONTENT_SECURITY_POLICY, POLICY.to_owned()),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff".to_owned()),
    ];
    let known = ETags::from_header(headers, &header::IF_NONE_MATCH).ok().flatten();
    if known.is_some_and(|tags| tags.matches_weakly(&tag)) {
        return (StatusCode::NOT_MODIFIED, about).into_response();
    }
    let coding = Coding::accepted(headers);
    match encode_body(coding, file.bytes.to_vec()) {
        Ok(body) => (about, [(header::CONTENT_TYPE, file.kind)], coding.headers(), body).into_response(),
        Err(_) => (about, [(header::CONTENT_TYPE, file.kind)], file.bytes).into_response(),
    }
}

/// What stands at `/` in a build without the page.
fn missing() -> Response {
    let why = files::MISSING;
    let body = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>rebake</title>\
         <h1>rebake</h1><p>The service runs. Its page is not here: {}.</p>\
         <p>To get it, install Node 20.19 or newer and build with <code>cargo run --release --features viewer</code>. \
         The API is at <a href=\"/openapi.json\">/openapi.json</a>.</p></html>",
        escape(why)
    );
    let policy = [(header::CONTENT_SECURITY_POLICY, "default-src 'none'; base-uri 'none'; form-action 'none'")];
    (policy, [(header::CONTENT_TYPE, "text/html; charset=utf-8")], body).into_response()
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}
