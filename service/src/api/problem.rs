//! RFC 9457 problem documents: every error that a client sees.

use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Media type of problem documents.
pub const CONTENT_TYPE: &str = "application/problem+json";

/// A problem document.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct ProblemDocument {
    /// Stable URI of the kind of problem; `GET` it for a description.
    #[serde(rename = "type")]
    #[schema(example = "/problems/unknown-object")]
    pub type_uri: String,
    /// The kind of problem in words.
    #[schema(example = "Unknown object")]
    pub title: String,
    /// HTTP status.
    #[schema(example = 422)]
    pub status: u16,
    /// What was wrong.
    #[schema(example = "edits[1].objects[0]: no object is named \"sofa\"")]
    pub detail: String,
    /// The field at fault, where there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = "edits[1].objects[0]")]
    pub field: Option<String>,
}

/// An error on its way to a client.
#[derive(Clone, Debug)]
pub(crate) struct Problem {
    kind: Kind,
    detail: String,
    field: Option<String>,
    retry_after_secs: Option<u32>,
}

/// What a handler answers.
pub(crate) type ApiResult<T> = Result<T, Problem>;

impl Problem {
    pub(crate) fn new(kind: Kind, detail: impl Into<String>) -> Problem {
        Problem { kind, detail: detail.into(), field: None, retry_after_secs: None }
    }

    /// A problem with one field: the detail begins with its name.
    pub(crate) fn field(kind: Kind, field: impl Into<String>, reason: impl std::fmt::Display) -> Problem {
        let field = field.into();
        Problem { kind, detail: format!("{field}: {reason}"), field: Some(field), retry_after_secs: None }
    }

    /// This problem, told as another kind.
    pub(crate) fn with_kind(self, kind: Kind) -> Problem {
        Problem { kind, ..self }
    }

    pub(crate) fn retry_after(mut self, secs: u32) -> Problem {
        self.retry_after_secs = Some(secs);
        self
    }

    /// Something that is our fault; the log has the details.
    pub(crate) fn internal(error: impl std::fmt::Display) -> Problem {
        tracing::error!(%error, "request failed");
        Problem::new(Kind::Internal, "the service failed on this request; its log says more")
    }
}

impl std::fmt::Display for Problem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.detail)
    }
}

impl From<crate::compute::Panicked> for Problem {
    fn from(panic: crate::compute::Panicked) -> Problem {
        Problem::internal(panic)
    }
}

impl From<crate::store::StoreError> for Problem {
    fn from(error: crate::store::StoreError) -> Problem {
        tracing::error!(%error, "not kept");
        Problem::new(Kind::Storage, format!("{}: nothing has changed", error.reason)).retry_after(5)
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let (slug, status, title, _) = self.kind.row();
        let document = ProblemDocument {
            type_uri: format!("/problems/{slug}"),
            title: title.to_owned(),
            status: status.as_u16(),
            detail: self.detail,
            field: self.field,
        };
        let body = serde_json::to_vec(&document).unwrap_or_default();
        // What is not there yet may be there soon: a cache would take a 404 or 410 for an answer that lasts.
        let about = [(header::CONTENT_TYPE, CONTENT_TYPE), (header::CACHE_CONTROL, "no-store")];
        let mut response = (status, about, body).into_response();
        if let Some(secs) = self.retry_after_secs {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(secs));
        }
        response
    }
}

macro_rules! kinds {
    ($($kind:ident $slug:literal $status:ident $title:literal $about:literal;)*) => {
        /// The kinds of problem.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(crate) enum Kind { $(#[doc = $about] $kind,)* }

        impl Kind {
            const ALL: &'static [Kind] = &[$(Kind::$kind,)*];

            /// Slug, status, title, description.
            pub(crate) fn row(self) -> (&'static str, StatusCode, &'static str, &'static str) {
                match self { $(Kind::$kind => ($slug, StatusCode::$status, $title, $about),)* }
            }
        }
    };
}

kinds! {
    BadRequest "bad-request" BAD_REQUEST "Bad request" "A header, the path or the body cannot be read.";
    InvalidJson "invalid-json" BAD_REQUEST "Invalid JSON" "The body is not JSON, or not of the expected shape.";
    InvalidQuery "invalid-query" BAD_REQUEST "Invalid query" "A query parameter is unknown, malformed or out of range.";
    MalformedFile "malformed-file" BAD_REQUEST "Malformed file" "The uploaded file is not a valid binary glTF.";
    Unauthorized "unauthorized" UNAUTHORIZED "Unauthorized" "The call needs a bearer token that the service knows.";
    ReadOnly "read-only" FORBIDDEN "Read only" "A replica serves reads alone: changes go to the service that it follows.";
    Forbidden "forbidden" FORBIDDEN "Forbidden" "The token's scopes do not allow this call.";
    NotFound "not-found" NOT_FOUND "Not found" "There is nothing at this path.";
    UnknownScene "unknown-scene" NOT_FOUND "Unknown scene" "There is no such scene, or it was deleted.";
    AssetNotFound "asset-not-found" NOT_FOUND "Asset not found" "There is no such asset, or it was deleted.";
    ObjectNotFound "object-not-found" NOT_FOUND "Object not found" "The scene has no object of that name.";
    UnknownVersion "unknown-version" NOT_FOUND "Unknown version" "The light map has no such version yet.";
    UnknownJob "unknown-job" NOT_FOUND "Unknown job" "There is no such job, or it ended long ago and was forgotten.";
    MethodNotAllowed "method-not-allowed" METHOD_NOT_ALLOWED "Method not allowed" "The path exists, but not with this method; see the Allow header.";
    Timeout "request-timeout" REQUEST_TIMEOUT "Request timeout" "The body did not arrive in time.";
    NameTaken "name-taken" CONFLICT "Name taken" "The scene has something of that name already.";
    NothingToTurn "nothing-to-undo" CONFLICT "Nothing to undo" "There is no edit that can be taken back, or none that was taken back last and can be made again.";
    JobEnded "job-ended" CONFLICT "Job ended" "The job has ended and cannot be canceled.";
    TooManyScenes "too-many-scenes" CONFLICT "Too many scenes" "The service holds as many scenes as it may; delete one.";
    NoMemory "no-memory" CONFLICT "Not enough memory" "The scene does not fit beside the others; delete one, or choose a larger spacing.";
    TooManyAssets "too-many-assets" CONFLICT "Too many assets" "The service holds as many assets, or bytes of assets, as it may.";
    AssetNeeded "asset-needed" CONFLICT "Asset needed" "A scene, or its history, needs the asset; delete the scene first.";
    VersionAhead "version-ahead" CONFLICT "Version ahead" "The client's version is newer than the scene's: it belongs to something else. Start over from version 0.";
    SceneGone "scene-gone" GONE "Scene gone" "The scene that was uploaded with this Idempotency-Key was deleted; another key uploads another one.";
    VersionForgotten "version-forgotten" GONE "Version forgotten" "What is asked for needs a version, or a delta between versions, that is not kept any more.";
    PreconditionFailed "precondition-failed" PRECONDITION_FAILED "Precondition failed" "The scene has accepted other edits than If-Match names.";
    PayloadTooLarge "payload-too-large" PAYLOAD_TOO_LARGE "Payload too large" "The body is larger than the service takes.";
    SceneTooLarge "scene-too-large" PAYLOAD_TOO_LARGE "Scene too large" "The scene has more triangles, elements or other parts than the service takes.";
    ForeignHost "foreign-host" MISDIRECTED_REQUEST "Foreign host" "The service answers only to its own host names; `--host-name` gives it more, and with tokens it answers to all.";
    UnsupportedMediaType "unsupported-media-type" UNSUPPORTED_MEDIA_TYPE "Unsupported media type" "The body's Content-Type is not one that this call takes.";
    UnsupportedFile "unsupported-file" UNPROCESSABLE_ENTITY "Unsupported file" "The file is a glTF but holds something that cannot be baked.";
    InvalidValue "invalid-value" UNPROCESSABLE_ENTITY "Invalid value" "A field has a value that is not allowed, or is missing or unknown.";
    UnknownObject "unknown-object" UNPROCESSABLE_ENTITY "Unknown object" "The body names an object that the scene does not have.";
    UnknownLight "unknown-light" UNPROCESSABLE_ENTITY "Unknown light" "The request names a light that the scene does not have.";
    UnknownMaterial "unknown-material" UNPROCESSABLE_ENTITY "Unknown material" "The body names a material that the scene, or the object, does not have.";
    UnknownAsset "unknown-asset" UNPROCESSABLE_ENTITY "Unknown asset" "The body names an asset that was not uploaded.";
    UnknownCamera "unknown-camera" UNPROCESSABLE_ENTITY "Unknown camera" "The body names a camera that the scene does not have.";
    EditTooLarge "edit-too-large" UNPROCESSABLE_ENTITY "Edit too large" "The edit would make the scene larger than the service takes.";
    KeyReused "idempotency-key-reused" UNPROCESSABLE_ENTITY "Idempotency key reused" "The key came with another body before.";
    QueueFull "queue-full" TOO_MANY_REQUESTS "Queue full" "Too many jobs wait already.";
    TooManyUploads "too-many-uploads" TOO_MANY_REQUESTS "Too many uploads" "Too many uploads are under way.";
    TooManyAnswers "too-many-answers" TOO_MANY_REQUESTS "Too many answers" "Clients take in too little of the large answers that they asked for.";
    TooManyStreams "too-many-streams" TOO_MANY_REQUESTS "Too many streams" "Too many event and delta streams are open.";
    SceneDamaged "scene-damaged" INTERNAL_SERVER_ERROR "Scene damaged" "The scene cannot be built, or what was kept of it cannot be read any more. It can be looked at and deleted.";
    Internal "internal" INTERNAL_SERVER_ERROR "Internal error" "The service failed. Nothing that was acknowledged is lost.";
    ScenePreparing "scene-preparing" SERVICE_UNAVAILABLE "Scene preparing" "The scene was uploaded just now, and its elements are still being laid out.";
    Restoring "restoring" SERVICE_UNAVAILABLE "Restoring" "The service is bringing back what its data directory holds.";
    ShuttingDown "shutting-down" SERVICE_UNAVAILABLE "Shutting down" "The service is about to end and takes no new work.";
    Storage "storage" SERVICE_UNAVAILABLE "Storage failed" "The change could not be kept; nothing has changed.";
}

/// The description of a kind of problem, by its slug.
pub(crate) fn describe(slug: &str) -> Option<String> {
    let (slug, status, title, about) = Kind::ALL.iter().map(|kind| kind.row()).find(|row| row.0 == slug)?;
    Some(format!("{title} (/problems/{slug}, HTTP {})\n\n{about}\n", status.as_u16()))
}
