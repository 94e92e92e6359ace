//! Unpacking of requests. Every rejection is a problem document.

use std::time::Duration;

use axum::body::{Body, to_bytes};
use axum::extract::rejection::{PathRejection, QueryRejection};
use axum::extract::{FromRequestParts, Path, Query};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderName, header};
use bytes::{Bytes, BytesMut};
use http_body_util::BodyExt;
use serde::de::DeserializeOwned;

use super::misread::read;
use super::problem::{ApiResult, Kind, Problem};
use crate::memory::Promise;
use crate::state::App;

/// Path segments.
pub(crate) struct ApiPath<T>(pub(crate) T);

impl<S: Send + Sync, T: DeserializeOwned + Send> FromRequestParts<S> for ApiPath<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let rejected = |rejection: PathRejection| Problem::new(Kind::BadRequest, rejection.body_text());
        Path::from_request_parts(parts, state).await.map(|Path(path)| ApiPath(path)).map_err(rejected)
    }
}

/// Query parameters.
pub(crate) struct ApiQuery<T>(pub(crate) T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequestParts<S> for ApiQuery<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let rejected = |rejection: QueryRejection| {
            let text = rejection.body_text();
            let reason = text.strip_prefix("Failed to deserialize query string: ").unwrap_or(&text);
            // "spacing: invalid float literal", or "unknown field `x`, expected ..." without a place.
            match reason.split_once(": ") {
                Some((field, reason)) if !field.contains(' ') => Problem::field(Kind::InvalidQuery, field, reason),
                _ => Problem::new(Kind::InvalidQuery, reason),
            }
        };
        Query::from_request_parts(parts, state).await.map(|Query(query)| ApiQuery(query)).map_err(rejected)
    }
}

/// Reads a small JSON body, and names the field at fault where it is not of the expected shape.
pub(crate) async fn read_json<T: DeserializeOwned>(app: &App, headers: &HeaderMap, body: Body) -> ApiResult<T> {
    require_content_type(headers, &["application/json"])?;
    let body = read_body(app, headers, body, app.config.limits.edit_bytes).await?;
    let invalid = |error: serde_json::Error| Problem::new(Kind::InvalidJson, error.to_string());
    read(serde_json::from_slice(&body).map_err(invalid)?, "")
}

/// Reads the file of an upload within its limits of size and time. What has arrived counts as memory for as long as the
/// promise is held, and a client that sends nothing for a while is let go: others wait for neither.
pub(crate) async fn read_upload<'a>(
    app: &'a App,
    headers: &HeaderMap,
    mut body: Body,
) -> ApiResult<(Bytes, Promise<'a>)> {
    let (limit, timeouts) = (app.config.limits.upload_bytes, &app.config.timeouts);
    let too_large = || Problem::new(Kind::PayloadTooLarge, format!("the body may have {limit} bytes"));
    let announced = announced(headers);
    if announced.is_some_and(|length| length > limit as u64) {
        return Err(too_large());
    }
    let full = |full| super::uploads::memory_problem("upload", full);
    let mut room = app.memory.promise(0, 0).map_err(full)?;
    let mut glb = BytesMut::with_capacity(reserved(announced));
    let read = async {
        loop {
            let next = tokio::time::timeout(timeouts.body_idle, body.frame()).await;
            let Some(frame) = next.map_err(|_| late(timeouts.body_idle, "nothing of the body arrived for"))? else {
                return Ok(());
            };
            let frame = frame.map_err(|_| Problem::new(Kind::BadRequest, "the body broke off"))?;
            let Ok(data) = frame.into_data() else { continue };
            if data.len() > limit - glb.len() {
                return Err(too_large());
            }
            app.memory.promise_more(&mut room, data.len() as u64).map_err(full)?;
            glb.extend_from_slice(&data);
        }
    };
    let read = tokio::time::timeout(timeouts.body, read).await;
    read.map_err(|_| late(timeouts.body, "the body did not arrive within"))??;
    Ok((glb.freeze(), room))
}

/// Bytes to reserve for a body: what is only announced takes no more of the memory than this.
fn reserved(announced: Option<u64>) -> usize {
    announced.unwrap_or(0).min(1 << 20) as usize
}

fn late(limit: Duration, what: &str) -> Problem {
    Problem::new(Kind::Timeout, format!("{what} {} s", limit.as_secs_f32()))
}

fn announced(headers: &HeaderMap) -> Option<u64> {
    headers.get(header::CONTENT_LENGTH).and_then(|v| v.to_str().ok()?.parse::<u64>().ok())
}

/// Reads a body within its limits of size and time.
pub(crate) async fn read_body(app: &App, headers: &HeaderMap, body: Body, limit: usize) -> ApiResult<Bytes> {
    let too_large = || Problem::new(Kind::PayloadTooLarge, format!("the body may have {limit} bytes"));
    if announced(headers).is_some_and(|length| length > limit as u64) {
        return Err(too_large());
    }
    match tokio::time::timeout(app.config.timeouts.body, to_bytes(body, limit)).await {
        Err(_elapsed) => Err(late(app.config.timeouts.body, "the body did not arrive within")),
        Ok(Ok(bytes)) => Ok(bytes),
        Ok(Err(error)) => {
            let is_limit =
                std::error::Error::source(&error).is_some_and(|source| source.is::<http_body_util::LengthLimitError>());
            if is_limit { Err(too_large()) } else { Err(Problem::new(Kind::BadRequest, "the body broke off")) }
        }
    }
}

/// Checks the body's media type, parameters aside.
pub(crate) fn require_content_type(headers: &HeaderMap, accepted: &[&str]) -> ApiResult<()> {
    let found = text_header(headers, &header::CONTENT_TYPE)?;
    let essence = found.and_then(|value| value.split(';').next()).map_or("", str::trim);
    if accepted.iter().any(|wanted| wanted.eq_ignore_ascii_case(essence)) {
        return Ok(());
    }
    let found = found.map_or_else(|| "none".to_owned(), |value| format!("{value:?}"));
    let detail = format!("Content-Type has to be {}, not {found}", accepted.join(" or "));
    Err(Problem::new(Kind::UnsupportedMediaType, detail))
}

/// A header as text; absent or readable.
pub(crate) fn text_header<'a>(headers: &'a HeaderMap, name: &HeaderName) -> ApiResult<Option<&'a str>> {
    let Some(value) = headers.get(name) else { return Ok(None) };
    let unreadable = |_| Problem::new(Kind::BadRequest, format!("the header {name} holds more than visible ASCII"));
    value.to_str().map(Some).map_err(unreadable)
}

/// The first of some formats that `Accept` names by its media type; none where it names none of them.
pub(crate) fn first_named<F: Copy, const N: usize>(
    headers: &HeaderMap,
    formats: [F; N],
    content_type: impl Fn(F) -> &'static str,
) -> Option<F> {
    let lines = headers.get_all(header::ACCEPT).iter().filter_map(|line| line.to_str().ok());
    let mut named = lines.flat_map(|line| line.split(',')).filter_map(|range| {
        let essence = range.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
        formats.into_iter().find(|format| content_type(*format) == essence)
    });
    named.next()
}

/// `If-Match` or `If-None-Match`.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum ETags {
    /// `*`
    Any,
    /// Tags without their quotes, and whether they are weak.
    Listed(Vec<(bool, String)>),
}

impl ETags {
    /// Parses all lines of a header; `None` where it is absent.
    pub(crate) fn from_header(headers: &HeaderMap, name: &HeaderName) -> ApiResult<Option<ETags>> {
        let malformed =
            || Problem::new(Kind::BadRequest, format!("the header {name} has to be * or a list of \"tags\""));
        let mut tags = Vec::new();
        let mut lines = headers.get_all(name).iter().peekable();
        if lines.peek().is_none() {
            return Ok(None);
        }
        for line in lines {
            let mut rest = line.to_str().map_err(|_| malformed())?.trim();
            if rest == "*" {
                return Ok(Some(ETags::Any));
            }
            while !rest.is_empty() {
                let (weak, quoted) = match rest.strip_prefix("W/") {
                    Some(quoted) => (true, quoted),
                    None => (false, rest),
                };
                let (tag, after) = quoted.strip_prefix('"').and_then(|s| s.split_once('"')).ok_or_else(malformed)?;
                tags.push((weak, tag.to_owned()));
                let after = after.trim_start();
                rest = match after.strip_prefix(',') {
                    Some(more) => more.trim_start(),
                    None if after.is_empty() => after,
                    None => return Err(malformed()),
                };
            }
        }
        if tags.is_empty() { Err(malformed()) } else { Ok(Some(ETags::Listed(tags))) }
    }

    /// RFC 9110, 13.1.1: strong comparison.
    pub(crate) fn matches_strongly(&self, tag: &str) -> bool {
        match self {
            ETags::Any => true,
            ETags::Listed(tags) => tags.iter().any(|(weak, listed)| !weak && listed == tag),
        }
    }

    /// RFC 9110, 13.1.2: weak comparison.
    pub(crate) fn matches_weakly(&self, tag: &str) -> bool {
        match self {
            ETags::Any => true,
            ETags::Listed(tags) => tags.iter().any(|(_, listed)| listed == tag),
        }
    }
}

/// How an answer is compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Coding {
    Identity,
    Gzip,
    Zstd,
}

impl Coding {
    /// What the client likes best; zstd, then gzip, where it likes several alike.
    pub(crate) fn accepted(headers: &HeaderMap) -> Coding {
        let mut best = (0.0, Coding::Identity);
        let lines = headers.get_all(header::ACCEPT_ENCODING).iter().filter_map(|line| line.to_str().ok());
        for entry in lines.flat_map(|line| line.split(',')) {
            let (name, parameters) = entry.split_once(';').unwrap_or((entry, ""));
            let quality = parameters.trim().strip_prefix("q=").map_or(1.0, |q| q.trim().parse::<f32>().unwrap_or(0.0));
            let coding = match name.trim().to_ascii_lowercase().as_str() {
                "zstd" => Coding::Zstd,
                "gzip" | "x-gzip" => Coding::Gzip,
                _ => continue,
            };
            if quality > best.0 || (quality == best.0 && quality > 0.0 && coding == Coding::Zstd) {
                best = (quality, coding);
            }
        }
        best.1
    }

    pub(crate) fn header_value(self) -> Option<&'static str> {
        match self {
            Coding::Identity => None,
            Coding::Gzip => Some("gzip"),
            Coding::Zstd => Some("zstd"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(name: &HeaderName, values: &[&str]) -> HeaderMap {
        let mut map = HeaderMap::new();
        for value in values {
            map.append(name, value.parse().unwrap());
        }
        map
    }

    #[test]
    fn an_announced_length_reserves_little() {
        assert_eq!([None, Some(100), Some(u64::MAX)].map(reserved), [0, 100, 1 << 20]);
    }

    #[test]
    fn entity_tags() {
        let parse = |values: &[&str]| ETags::from_header(&headers(&header::IF_MATCH, values), &header::IF_MATCH);
        assert_eq!(parse(&[]).unwrap(), None);
        assert_eq!(parse(&["*"]).unwrap(), Some(ETags::Any));
        let tags = parse(&["\"1\", W/\"2\"", "\"a,b\""]).unwrap().unwrap();
        assert!(tags.matches_strongly("1") && !tags.matches_strongly("2") && tags.matches_strongly("a,b"));
        assert!(tags.matches_weakly("2") && !tags.matches_weakly("3"));
        for bad in ["3", "\"3", "\"1\" \"2\"", "", "W/3"] {
            assert!(parse(&[bad]).is_err(), "{bad}");
        }
    }

    #[test]
    fn content_codings() {
        let accepted = |values: &[&str]| Coding::accepted(&headers(&header::ACCEPT_ENCODING, values));
        assert_eq!(accepted(&[]), Coding::Identity);
        assert_eq!(accepted(&["gzip, deflate, br, zstd"]), Coding::Zstd);
        assert_eq!(accepted(&["gzip"]), Coding::Gzip);
        assert_eq!(accepted(&["zstd;q=0.5, gzip;q=0.9"]), Coding::Gzip);
        assert_eq!(accepted(&["zstd;q=0", "gzip;q=x"]), Coding::Identity);
        assert_eq!(accepted(&["br"]), Coding::Identity);
    }
}
