//! `rebake replica`: serves reads of what a service on another machine publishes.

use std::net::SocketAddr;
use std::num::NonZeroUsize;
use std::path::PathBuf;

use anyhow::Context;
use rebake::auth::Tokens;
use rebake::cluster::replicate;

use super::serve::{ClusterArgs, config, listen, refuse_to_be_open, start_log, stop_signal};
use super::ui;

const AFTER_HELP: &str = "\
Has the scenes of a service that runs with --queue and --objects, and answers all reads of them, streams of deltas and events
included, with the same versions. Changes are refused. It may lag behind by some tenths of a second.
  rebake replica --queue nats://10.0.0.1:4222 --objects /mnt/shared --listen 127.0.0.1:7879";

/// Arguments of `rebake replica`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub(super) struct ReplicaArgs {
    #[command(flatten)]
    cluster: ClusterArgs,
    /// Address and port; port 0 takes a free one
    #[arg(long, value_name = "ADDRESS", env = "REBAKE_LISTEN", default_value = "127.0.0.1:7878")]
    listen: SocketAddr,
    /// Threads that compute [default: one per core]
    #[arg(long, value_name = "N", env = "REBAKE_THREADS")]
    threads: Option<NonZeroUsize>,
    /// File of access tokens, as of `rebake serve`
    #[arg(long, value_name = "FILE", env = "REBAKE_TOKEN_FILE")]
    token_file: Option<PathBuf>,
    /// Listen beyond this machine without tokens
    #[arg(long, env = "REBAKE_INSECURE")]
    insecure: bool,
    /// Let pages of this origin call the API from a browser; may be given several times; `*` for all [default: none]
    #[arg(long, value_name = "ORIGIN", env = "REBAKE_CORS_ORIGIN", value_delimiter = ',')]
    cors_origin: Vec<String>,
    /// Host name that it answers to without tokens, beside localhost and its address; may be given several times; `*` for all
    #[arg(long, value_name = "NAME", env = "REBAKE_HOST_NAME", value_delimiter = ',')]
    host_name: Vec<String>,
}

/// Serves until it is told to stop.
pub(super) async fn replica(args: ReplicaArgs) -> anyhow::Result<()> {
    let tokens = args.token_file.as_deref().map(Tokens::read).transpose()?;
    refuse_to_be_open(args.listen, tokens.is_some(), args.insecure)?;
    start_log("info");
    let listener = listen(args.listen).await?;
    ui::out(&format!("listening on http://{}", listener.local_addr().context("cannot tell the address")?))?;
    let config = rebake::Config {
        tokens,
        cors_origins: args.cors_origin,
        host_names: args.host_name,
        cluster: Some(args.cluster.into()),
        ..config(args.threads)
    };
    replicate(listener, config, stop_signal()).await.context("the replica stopped")
}
