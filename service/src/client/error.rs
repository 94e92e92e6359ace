//! What can go wrong between client and service.

use rebake_core::delta::DeltaError;
use serde::Deserialize;

/// A call that did not succeed.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The server's address cannot be used.
    #[error("the server address {server:?} cannot be used: {why}")]
    Server {
        /// The address given.
        server: String,
        /// What is wrong with it.
        why: String,
    },
    /// The token cannot be sent.
    #[error("the token holds more than visible ASCII")]
    Token,
    /// The request did not reach the service, or the answer did not reach us.
    #[error("{}", describe(.0))]
    Http(#[source] reqwest::Error),
    /// The service said no.
    #[error("{title} ({status}){}", detail.as_deref().map(|detail| format!(": {detail}")).unwrap_or_default())]
    Refused {
        /// HTTP status.
        status: u16,
        /// The problem's stable type.
        kind: String,
        /// The problem in few words.
        title: String,
        /// What was wrong, with which field.
        detail: Option<String>,
    },
    /// The answer is not what the API's description says.
    #[error("the answer of {url} cannot be read")]
    Answer {
        /// What was asked for.
        url: String,
        /// What is wrong with it.
        #[source]
        source: serde_json::Error,
    },
    /// The answer's bytes are not what they should be.
    #[error("{0} cannot be read")]
    Malformed(&'static str),
    /// The answer is longer than this client reads.
    #[error("the answer is longer than {limit} bytes")]
    TooLong {
        /// The limit.
        limit: usize,
    },
    /// The deltas cannot be applied.
    #[error("the deltas cannot be applied")]
    Delta(#[from] DeltaError),
    /// The connection was lost again and again.
    #[error("gave up after {attempts} attempts to reconnect")]
    Lost {
        /// How often it was tried.
        attempts: u32,
        /// What went wrong last.
        #[source]
        last: Box<ClientError>,
    },
    /// A stream ended that should have gone on.
    #[error("the service ended the stream")]
    Ended,
}

/// RFC 9457.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Problem {
    r#type: String,
    title: String,
    detail: Option<String>,
}

impl ClientError {
    /// From a status and the body that came with it.
    pub(super) fn refused(status: u16, body: &[u8]) -> ClientError {
        let problem: Problem = serde_json::from_slice(body).unwrap_or_default();
        let title = if problem.title.is_empty() { "the service refused".to_owned() } else { problem.title };
        ClientError::Refused { status, kind: problem.r#type, title, detail: problem.detail }
    }

    /// Whether the same call may well succeed a little later.
    pub fn is_transient(&self) -> bool {
        match self {
            ClientError::Http(error) => !error.is_builder(),
            ClientError::Refused { status, .. } => matches!(status, 408 | 429 | 502 | 503 | 504),
            ClientError::Ended => true,
            _ => false,
        }
    }
}

fn describe(error: &reqwest::Error) -> String {
    let place = error.url().map(|url| format!(" {}", url.origin().ascii_serialization())).unwrap_or_default();
    if error.is_connect() {
        format!("cannot connect to{place} (is `rebake serve` running?)")
    } else if error.is_timeout() {
        format!("timed out waiting for{place}")
    } else {
        format!("the connection to{place} failed")
    }
}
