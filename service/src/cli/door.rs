//! How a service is reached: its address, who may come in, and its threads.

use std::net::SocketAddr;
use std::num::NonZeroUsize;
use std::path::PathBuf;

use rebake::auth::Tokens;
use tokio::net::TcpListener;

use super::serve::{config, listen, start_log};

/// Arguments that services and replicas of them share.
#[derive(Debug, clap::Args)]
pub(super) struct DoorArgs {
    /// Address and port; port 0 takes a free one
    #[arg(long, value_name = "ADDRESS", env = "REBAKE_LISTEN", default_value = "127.0.0.1:7878")]
    listen: SocketAddr,
    /// Threads that compute [default: one per core]
    #[arg(long, value_name = "N", env = "REBAKE_THREADS")]
    threads: Option<NonZeroUsize>,
    /// File of access tokens, one per line: the token and its scopes (read, edit, admin), separated by commas.
    /// SIGHUP reads it again [default: whoever reaches the address may use it]
    #[arg(long, value_name = "FILE", env = "REBAKE_TOKEN_FILE")]
    token_file: Option<PathBuf>,
    /// Listen beyond this machine without tokens
    #[arg(long, env = "REBAKE_INSECURE")]
    insecure: bool,
    /// Let pages of this origin call the API from a browser; may be given several times; `*` for all [default: none]
    #[arg(long, value_name = "ORIGIN", env = "REBAKE_CORS_ORIGIN", value_delimiter = ',')]
    cors_origin: Vec<String>,
    /// Host name that the service answers to without tokens, beside localhost and its address; may be given several
    /// times; `*` for all
    #[arg(long, value_name = "NAME", env = "REBAKE_HOST_NAME", value_delimiter = ',')]
    host_name: Vec<String>,
}

impl DoorArgs {
    /// Opens the address, where nobody comes in that should not; from here on the log is written, and SIGHUP reads the
    /// tokens again.
    pub(super) async fn open(self) -> anyhow::Result<(TcpListener, rebake::Config)> {
        let tokens = self.token_file.as_deref().map(Tokens::read).transpose()?;
        refuse_to_be_open(self.listen, tokens.is_some(), self.insecure)?;
        start_log("info");
        let listener = listen(self.listen).await?;
        tokens.clone().into_iter().for_each(reload_at_hangup);
        let (cors_origins, host_names) = (self.cors_origin, self.host_name);
        Ok((listener, rebake::Config { tokens, cors_origins, host_names, ..config(self.threads) }))
    }
}

/// Whoever reaches the address could change scenes: without tokens that has to be this machine alone.
fn refuse_to_be_open(address: SocketAddr, has_tokens: bool, is_insecure: bool) -> anyhow::Result<()> {
    if address.ip().is_loopback() || has_tokens || is_insecure {
        return Ok(());
    }
    anyhow::bail!(
        "--listen {address} can be reached from other machines, and nobody would be asked for a token: \
         give --token-file, or --insecure if that is what you want"
    )
}

/// Reads the token file again at SIGHUP.
fn reload_at_hangup(tokens: Tokens) {
    #[cfg(unix)]
    tokio::spawn(async move {
        let Ok(mut hangup) = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::hangup()) else { return };
        while hangup.recv().await.is_some() {
            match tokens.reload() {
                Ok(count) => tracing::info!(count, "tokens read again"),
                Err(error) => tracing::error!(%error, "the tokens stay as they were"),
            }
        }
    });
    #[cfg(not(unix))]
    drop(tokens);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_open_door_has_to_be_asked_for() {
        let (here, everywhere) = (SocketAddr::from(([127, 0, 0, 1], 0)), SocketAddr::from(([0, 0, 0, 0], 0)));
        for (address, has_tokens, is_insecure, allowed) in [
            (here, false, false, true),
            (everywhere, false, false, false),
            (everywhere, true, false, true),
            (everywhere, false, true, true),
        ] {
            assert_eq!(refuse_to_be_open(address, has_tokens, is_insecure).is_ok(), allowed);
        }
    }
}
