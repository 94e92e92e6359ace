//! `rebake worker`: does parts of bakes for services on other machines.

use std::num::NonZeroUsize;

use anyhow::Context;
use rebake::cluster::{WorkerOptions, work};

use super::serve::{ClusterArgs, start_log, stop_signal};
use super::ui;

const AFTER_HELP: &str = "\
Takes parts of large rounds of bakes from the queue, one at a time, and puts what comes of them where the service finds it.
The light maps are the same, bit for bit, with any number of workers. A worker may end, or die, at any time.
  rebake serve --queue nats://10.0.0.1:4222 --objects /mnt/shared &
  rebake worker --queue nats://10.0.0.1:4222 --objects /mnt/shared";

/// Arguments of `rebake worker`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub(super) struct WorkerArgs {
    #[command(flatten)]
    cluster: ClusterArgs,
    /// Threads that compute [default: one per core]
    #[arg(long, value_name = "N", env = "REBAKE_THREADS")]
    threads: Option<NonZeroUsize>,
}

/// Works until it is told to stop.
pub(super) async fn worker(args: WorkerArgs) -> anyhow::Result<()> {
    start_log("info");
    let options = WorkerOptions { cluster: args.cluster.into(), threads: args.threads };
    ui::note(&format!("waiting for parts of bakes at {}", without_secrets(&options.cluster.queue)));
    work(&options, stop_signal()).await.context("the worker stopped")
}

/// An address without what only its owner knows.
fn without_secrets(address: &str) -> String {
    match address.split_once("://").map(|(scheme, rest)| (scheme, rest.rsplit_once('@'))) {
        Some((scheme, Some((_, host)))) => format!("{scheme}://{host}"),
        _ => address.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn secrets_of_addresses_are_not_told() {
        assert_eq!(without_secrets("nats://me:secret@host:4222"), "nats://host:4222");
        assert_eq!(without_secrets("nats://host:4222"), "nats://host:4222");
        assert_eq!(without_secrets("host"), "host");
    }
}
