//! `rebake serve`: the service itself.

use std::io::IsTerminal;
use std::net::SocketAddr;
use std::num::NonZeroUsize;
use std::path::PathBuf;

use anyhow::Context;
use tokio::net::TcpListener;
use tracing_subscriber::EnvFilter;

use super::{exit, ui};

const AFTER_HELP: &str = "\
Prints the address it listens on, then logs to standard error (RUST_LOG chooses what, e.g. RUST_LOG=debug).
SIGTERM or Ctrl-C ends it: running jobs are canceled, answers under way are finished; a second Ctrl-C ends it at once.
  rebake serve --listen 127.0.0.1:0 --threads 4";

/// Arguments of `rebake serve`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub(super) struct ServeArgs {
    /// Address and port; port 0 takes a free one
    #[arg(long, value_name = "ADDRESS", env = "REBAKE_LISTEN", default_value = "127.0.0.1:7878")]
    listen: SocketAddr,
    /// Where to keep scenes, edits and light maps across restarts [default: nowhere, they live in memory]
    #[arg(long, value_name = "DIR", env = "REBAKE_DATA_DIR")]
    data_dir: Option<PathBuf>,
    /// Threads that compute [default: one per core]
    #[arg(long, value_name = "N", env = "REBAKE_THREADS")]
    threads: Option<NonZeroUsize>,
    /// File of access tokens (not in this build: whoever reaches the address may use it)
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
}

/// Runs the service until it is told to stop.
pub(super) async fn serve(args: ServeArgs) -> anyhow::Result<()> {
    refuse_what_is_not_there(&args)?;
    start_log("info");
    let listener = listen(args.listen).await?;
    let address = listener.local_addr().context("cannot tell the address")?;
    if !address.ip().is_loopback() {
        ui::note("warning: this build asks for no token: whoever reaches this address can change scenes");
    }
    ui::out(&format!("listening on http://{address}"))?;
    match &args.data_dir {
        Some(directory) => tracing::info!(directory = %directory.display(), "scenes are kept"),
        None => ui::note("no --data-dir: scenes live in memory and are gone when the service ends"),
    }
    let config = rebake::Config { data_dir: args.data_dir, ..config(args.threads) };
    rebake::run(listener, config, stop_signal()).await.context("the service stopped")?;
    Ok(())
}

/// An option that is accepted has to do what it says.
fn refuse_what_is_not_there(args: &ServeArgs) -> anyhow::Result<()> {
    if args.token_file.is_some() {
        anyhow::bail!("--token-file: this build checks no tokens; leave the option out and keep the address private");
    }
    Ok(())
}

/// Opens the address.
pub(super) async fn listen(address: SocketAddr) -> anyhow::Result<TcpListener> {
    TcpListener::bind(address).await.with_context(|| format!("cannot listen on {address}"))
}

/// The service's configuration with so many threads.
pub(super) fn config(threads: Option<NonZeroUsize>) -> rebake::Config {
    rebake::Config { threads: threads.map_or(0, NonZeroUsize::get), ..rebake::Config::default() }
}

/// Logs to standard error; `RUST_LOG` overrides `default`.
pub(super) fn start_log(default: &str) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(default));
    let ansi = std::io::stderr().is_terminal();
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_ansi(ansi).with_writer(std::io::stderr);
    // Set already where a test runs several commands in one process.
    let _ = log.try_init();
}

/// Resolves at SIGTERM or Ctrl-C. From then on a second Ctrl-C ends the process.
pub(super) async fn stop_signal() {
    #[cfg(unix)]
    let terminate = async {
        match tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate()) {
            Ok(mut signal) => {
                signal.recv().await;
            }
            Err(_) => std::future::pending().await,
        }
    };
    #[cfg(not(unix))]
    let terminate = std::future::pending::<()>();
    tokio::select! {
        _ = tokio::signal::ctrl_c() => {}
        () = terminate => {}
    }
    tokio::spawn(exit::at_next_interrupt());
}

/// The API description.
pub(super) fn openapi_document() -> anyhow::Result<String> {
    let document = rebake::api::document();
    Ok(serde_json::to_string_pretty(&document)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_of_later_builds_are_refused_not_ignored() {
        let args = |data_dir: Option<&str>, token_file: Option<&str>| ServeArgs {
            listen: SocketAddr::from(([127, 0, 0, 1], 0)),
            data_dir: data_dir.map(PathBuf::from),
            threads: None,
            token_file: token_file.map(PathBuf::from),
        };
        assert!(refuse_what_is_not_there(&args(Some("x"), None)).is_ok());
        for args in [args(None, Some("x"))] {
            let message = refuse_what_is_not_there(&args).unwrap_err().to_string();
            assert!(message.contains("this build"), "{message}");
        }
    }
}
