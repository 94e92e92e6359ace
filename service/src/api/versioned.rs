//! The version that an answer is of: what its headers tell, and whether the client has it.

use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};

use super::etag;
use super::extract::ETags;
use super::problem::{ApiResult, Problem};
use crate::store::versions::{Published, Wanted};

/// Header with the light map's version.
pub(super) static VERSION: HeaderName = HeaderName::from_static("x-rebake-version");

/// Header with the stated error of the light that is delivered.
pub(super) static ESTIMATED_RMSE: HeaderName = HeaderName::from_static("x-rebake-estimated-rmse");

/// An answer that is the same until its tag changes.
pub(super) struct Versioned {
    /// Headers of the answer.
    pub(super) about: HeaderMap,
    /// The client has this version (`If-None-Match`).
    pub(super) is_known: bool,
}

impl Versioned {
    /// An answer that changes with the light map. `vary`: names of the request headers that choose among its forms.
    pub(super) fn of_light(published: &Published, headers: &HeaderMap, vary: Option<&'static str>) -> ApiResult<Self> {
        Versioned::new(published.version, published.version, headers, vary)
    }

    /// One that changes with the elements.
    pub(super) fn of_elements(
        published: &Published,
        headers: &HeaderMap,
        vary: Option<&'static str>,
    ) -> ApiResult<Self> {
        Versioned::new(published.elements_version, published.version, headers, vary)
    }

    fn new(tag: u64, version: u64, headers: &HeaderMap, vary: Option<&'static str>) -> ApiResult<Versioned> {
        let known = ETags::from_header(headers, &header::IF_NONE_MATCH)?;
        let mut about = HeaderMap::new();
        about.insert(header::ETAG, HeaderValue::from_str(&etag(tag)).map_err(Problem::internal)?);
        about.insert(VERSION.clone(), HeaderValue::from(version));
        vary.into_iter().for_each(|names| drop(about.insert(header::VARY, HeaderValue::from_static(names))));
        Ok(Versioned { about, is_known: known.is_some_and(|tags| tags.matches_weakly(&tag.to_string())) })
    }

    /// States the error of the light that is delivered, where anything is known of it: that of direct or indirect light alone
    /// is not, unless it is the scene's mode.
    pub(super) fn state_error(&mut self, published: &Published, wanted: Wanted) -> ApiResult<()> {
        let is_stated = wanted == Wanted::Error || wanted == Wanted::Light(published.mode());
        if let Some(rmse) = published.stated_rmse().filter(|_| is_stated) {
            let value = HeaderValue::from_str(&rmse.to_string()).map_err(Problem::internal)?;
            self.about.insert(ESTIMATED_RMSE.clone(), value);
        }
        Ok(())
    }

    /// What a client is told that has it.
    pub(super) fn not_modified(self) -> Response {
        (StatusCode::NOT_MODIFIED, self.about).into_response()
    }
}
