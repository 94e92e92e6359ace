//! How a command ends: exit status and one line that says why.

use std::process::ExitCode;
use std::time::{Duration, Instant};

use rebake::client::ClientError;

use super::ui;

/// A job did not succeed.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(super) struct JobEnded(pub(super) String);

/// Ctrl-C.
#[derive(Debug, thiserror::Error)]
#[error("interrupted{0}")]
pub(super) struct Interrupted(pub(super) &'static str);

/// After a first Ctrl-C: the next one ends the process at once. One that comes right behind the first is the same
/// one, sent to the process and to its group.
pub(super) async fn at_next_interrupt() {
    let begin = Instant::now();
    while tokio::signal::ctrl_c().await.is_ok() {
        if begin.elapsed() > Duration::from_millis(300) {
            std::process::exit(130);
        }
    }
}

/// Prints the error with its causes on one line and picks the exit status.
pub(super) fn report(error: &anyhow::Error) -> ExitCode {
    // A reader that has had enough, as in `rebake watch | head`, is not an error.
    let pipe_closed = |cause: &(dyn std::error::Error + 'static)| {
        cause.downcast_ref::<std::io::Error>().is_some_and(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
    };
    if error.chain().next_back().is_some_and(pipe_closed) && error.downcast_ref::<ClientError>().is_none() {
        return ExitCode::SUCCESS;
    }
    ui::note(&format!("{} {}", ui::red("error:"), one_line(error)));
    ExitCode::from(status(error))
}

fn status(error: &anyhow::Error) -> u8 {
    for cause in error.chain() {
        if cause.is::<Interrupted>() {
            return 130;
        }
        if cause.is::<JobEnded>() {
            return 4;
        }
        if matches!(cause.downcast_ref(), Some(ClientError::Refused { .. })) {
            return 3;
        }
    }
    1
}

/// All causes, from the outermost to the first, without what only repeats the one before.
fn one_line(error: &anyhow::Error) -> String {
    let mut parts: Vec<String> = Vec::new();
    let mut inside_http = false;
    let mut causes = error.chain().peekable();
    while let Some(cause) = causes.next() {
        // Layers of the HTTP library say the same thing several times over: the first cause is enough.
        let skip = inside_http && causes.peek().is_some();
        inside_http |= matches!(cause.downcast_ref(), Some(ClientError::Http(_)));
        let text = cause.to_string();
        if !skip && parts.last().is_none_or(|last| !last.contains(&text)) {
            parts.push(text);
        }
    }
    parts.join(": ").replace('\n', " ")
}

#[cfg(test)]
mod tests {
    use anyhow::Context;

    use super::*;

    fn failed(error: impl std::error::Error + Send + Sync + 'static) -> anyhow::Error {
        Err::<(), _>(error).context("cannot do it").unwrap_err()
    }

    #[test]
    fn each_way_to_fail_has_its_status() {
        let refused = ClientError::Refused { status: 404, kind: String::new(), title: "no".into(), detail: None };
        assert_eq!(status(&failed(refused)), 3);
        assert_eq!(status(&failed(JobEnded("the bake failed".into()))), 4);
        assert_eq!(status(&failed(Interrupted(""))), 130);
        assert_eq!(status(&anyhow::anyhow!("other")), 1);
    }

    #[test]
    fn causes_stand_on_one_line() {
        let io = std::io::Error::other("disk\nfull");
        assert_eq!(one_line(&failed(io)), "cannot do it: disk full");
    }

    #[tokio::test]
    async fn a_refused_connection_is_said_once() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        drop(listener);
        let client = rebake::client::Client::new(&format!("http://{address}")).unwrap();
        let error = client.scene("s").await.unwrap_err();
        let line = one_line(&failed(error));
        assert!(line.starts_with("cannot do it: cannot connect to http://127.0.0.1:"), "{line}");
        assert!(line.contains("Connection refused") && line.matches("connect").count() == 1, "{line}");
    }
}
