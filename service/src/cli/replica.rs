//! `rebake replica`: serves reads of what a service on another machine publishes.

use anyhow::Context;
use rebake::cluster::replicate;

use super::door::DoorArgs;
use super::serve::{ClusterArgs, stop_signal};
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
    door: DoorArgs,
    #[command(flatten)]
    cluster: ClusterArgs,
}

/// Serves until it is told to stop.
pub(super) async fn replica(args: ReplicaArgs) -> anyhow::Result<()> {
    let (listener, config) = args.door.open().await?;
    ui::out(&format!("listening on http://{}", listener.local_addr().context("cannot tell the address")?))?;
    let config = rebake::Config { cluster: Some(args.cluster.into()), ..config };
    replicate(listener, config, stop_signal()).await.context("the replica stopped")
}
