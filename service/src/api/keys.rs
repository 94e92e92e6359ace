//! Requests that a client may send again with their `Idempotency-Key`.

use std::sync::Arc;

use axum::http::{HeaderMap, HeaderName};
use bytes::Bytes;

use super::extract::text_header;
use super::problem::{ApiResult, Kind, Problem};
use crate::jobs::queue::{JobNumber, SceneNumber};
use crate::state::App;
use crate::store::records::UploadRecord;
use crate::store::upload_keys;

static IDEMPOTENCY_KEY: HeaderName = HeaderName::from_static("idempotency-key");

/// The key of a request, where it has one.
pub(super) fn idempotency_key(headers: &HeaderMap) -> ApiResult<Option<String>> {
    const MAX_CHARS: usize = 255;
    match text_header(headers, &IDEMPOTENCY_KEY)? {
        None => Ok(None),
        Some(key) if (1..=MAX_CHARS).contains(&key.len()) => Ok(Some(key.to_owned())),
        Some(_) => {
            let reason = format!("has to have 1 to {MAX_CHARS} characters");
            Err(Problem::field(Kind::BadRequest, "Idempotency-Key", reason))
        }
    }
}

/// The key of an upload, while no other one with it is under way.
pub(super) struct Turn(upload_keys::Turn);

impl Turn {
    /// That of a request, where it has a key. Waits for its turn: the first of several answers the others.
    pub(super) async fn of(app: &App, headers: &HeaderMap) -> ApiResult<Option<Turn>> {
        match idempotency_key(headers)? {
            Some(key) => Ok(Some(Turn(app.upload_keys.begin(key).await))),
            None => Ok(None),
        }
    }

    /// Something came with the key before.
    pub(super) fn is_known(&self) -> bool {
        self.0.known().is_some()
    }
}

/// An upload with a key.
pub(super) struct Keyed {
    turn: Turn,
    hash: blake3::Hash,
}

impl Keyed {
    /// `how` the file is to be taken counts as well as what is in it: another of either is another upload.
    pub(super) async fn new(app: &App, turn: Option<Turn>, how: String, file: &Bytes) -> ApiResult<Option<Keyed>> {
        let Some(turn) = turn else { return Ok(None) };
        let file = file.clone();
        let hash = move || {
            let mut hasher = blake3::Hasher::new();
            // Its length keeps the two apart.
            hasher.update(&(how.len() as u64).to_le_bytes()).update(how.as_bytes()).update(&file);
            hasher.finalize()
        };
        Ok(Some(Keyed { turn, hash: app.compute.run(hash).await? }))
    }

    /// What came with the key before; an error where that was another upload.
    pub(super) fn known(&self) -> ApiResult<Option<Arc<UploadRecord>>> {
        match self.turn.0.known() {
            Some(known) if known.hash != self.hash => Err(reused()),
            known => Ok(known),
        }
    }

    /// What is to be remembered of it.
    pub(super) fn record(&self, scene: Option<SceneNumber>, job: Option<JobNumber>) -> UploadRecord {
        UploadRecord { key: self.turn.0.key().to_owned(), hash: self.hash, scene, job }
    }
}

/// A key came with something else before.
pub(super) fn reused() -> Problem {
    Problem::new(Kind::KeyReused, "this Idempotency-Key came with another body before")
}
