//! `rebake serve`: the service itself.

use std::io::IsTerminal;
use std::net::{IpAddr, SocketAddr};
use std::num::NonZeroUsize;
use std::path::PathBuf;

use anyhow::Context;
use rebake::cluster::ClusterConfig;
use rebake::config::{IdleRefine, Limits};
use tokio::net::TcpListener;
use tracing_subscriber::EnvFilter;

use super::door::DoorArgs;
use super::{exit, ui};

const AFTER_HELP: &str = "\
Prints the address it listens on, then logs to standard error (RUST_LOG chooses what, e.g. RUST_LOG=debug).
SIGTERM or Ctrl-C ends it: running jobs are canceled, answers under way are finished; a second Ctrl-C ends it at once.
  rebake serve --listen 127.0.0.1:0 --threads 4";

/// Arguments of `rebake serve`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub(super) struct ServeArgs {
    #[command(flatten)]
    door: DoorArgs,
    /// Where to keep scenes, edits and light maps across restarts [default: nowhere, they live in memory]
    #[arg(long, value_name = "DIR", env = "REBAKE_DATA_DIR")]
    data_dir: Option<PathBuf>,
    /// Memory that scenes, assets and uploads under way may take together, in GiB [default: three quarters of the
    /// machine's]
    #[arg(long, value_name = "GIB", env = "REBAKE_MEMORY", value_parser = super::values::positive)]
    memory: Option<f64>,
    #[command(flatten)]
    limits: LimitArgs,
    #[command(flatten)]
    cluster: Option<ClusterArgs>,
    /// Leave parts of bakes to workers as long as there are any
    #[arg(long, env = "REBAKE_DELEGATE", help_heading = "Other machines", requires = "queue")]
    delegate: bool,
    /// Refine light maps while no job waits, until their stated error is SHARE of their mean light. Every refined map
    /// is a new version
    #[arg(long, value_name = "SHARE", env = "REBAKE_IDLE_REFINE", num_args = 0..=1, require_equals = true,
        default_missing_value = "0.01", value_parser = super::values::positive)]
    idle_refine: Option<f64>,
}

/// Where machines meet that share bakes.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Other machines")]
#[group(multiple = true)]
pub(super) struct ClusterArgs {
    /// NATS server with JetStream, as nats://host:4222, whose work queue parts of bakes go through
    #[arg(long, value_name = "URL", env = "REBAKE_QUEUE", required = false, requires = "objects")]
    queue: String,
    /// Where files are shared: a folder, or an address such as s3://bucket/prefix where that is built in
    #[arg(long, value_name = "URL", env = "REBAKE_OBJECTS", required = false, requires = "queue")]
    objects: String,
}

impl From<ClusterArgs> for ClusterConfig {
    fn from(ClusterArgs { queue, objects }: ClusterArgs) -> ClusterConfig {
        ClusterConfig { queue, objects, delegates: false }
    }
}

/// How much there may be.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Limits")]
struct LimitArgs {
    /// Size of an uploaded scene or asset, in MiB [default: 512]
    #[arg(long, value_name = "MIB", env = "REBAKE_MAX_UPLOAD")]
    max_upload: Option<NonZeroUsize>,
    /// Scenes [default: 64]
    #[arg(long, value_name = "N", env = "REBAKE_MAX_SCENES")]
    max_scenes: Option<NonZeroUsize>,
    /// Assets [default: 1024]
    #[arg(long, value_name = "N", env = "REBAKE_MAX_ASSETS")]
    max_assets: Option<NonZeroUsize>,
    /// Size of all assets together, as uploaded, in MiB [default: 4096]
    #[arg(long, value_name = "MIB", env = "REBAKE_MAX_ASSET_BYTES")]
    max_asset_bytes: Option<NonZeroUsize>,
    /// Open connections [default: 1024]
    #[arg(long, value_name = "N", env = "REBAKE_MAX_CONNECTIONS")]
    max_connections: Option<NonZeroUsize>,
}

impl LimitArgs {
    fn set(&self, limits: &mut Limits) {
        let mib = |given: NonZeroUsize| given.get().saturating_mul(1 << 20);
        let set = |limit: &mut usize, given: Option<usize>| *limit = given.unwrap_or(*limit);
        set(&mut limits.upload_bytes, self.max_upload.map(mib));
        set(&mut limits.scenes, self.max_scenes.map(NonZeroUsize::get));
        set(&mut limits.assets, self.max_assets.map(NonZeroUsize::get));
        set(&mut limits.asset_bytes, self.max_asset_bytes.map(mib));
        set(&mut limits.connections, self.max_connections.map(NonZeroUsize::get));
    }
}

/// Runs the service until it is told to stop.
pub(super) async fn serve(args: ServeArgs) -> anyhow::Result<()> {
    let (listener, config) = args.door.open().await?;
    let address = listener.local_addr().context("cannot tell the address")?;
    match &args.data_dir {
        Some(directory) => tracing::info!(directory = %directory.display(), "scenes are kept"),
        None => ui::note("no --data-dir: scenes live in memory and are gone when the service ends"),
    }
    ui::out(&format!("listening on http://{address}"))?;
    if rebake::viewer::is_embedded() {
        ui::note(&format!("open {} in a browser for the page", page(address)));
    }
    let mut config = rebake::Config { data_dir: args.data_dir, ..config };
    config.idle_refine = args.idle_refine.map(|error_share| IdleRefine { error_share, ..IdleRefine::default() });
    let delegates = args.delegate;
    config.cluster = args.cluster.map(|cluster| ClusterConfig { delegates, ..cluster.into() });
    args.limits.set(&mut config.limits);
    if let Some(gib) = args.memory {
        config.limits.memory_bytes = (gib * f64::from(1u32 << 30)) as u64;
    }
    rebake::run(listener, config, stop_signal()).await.context("the service stopped")?;
    Ok(())
}

/// Where a browser on this machine finds the page: an address that stands for all of them is none to go to.
fn page(address: SocketAddr) -> String {
    let port = address.port();
    match address.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => format!("http://127.0.0.1:{port}/"),
        IpAddr::V6(ip) if ip.is_unspecified() => format!("http://[::1]:{port}/"),
        _ => format!("http://{address}/"),
    }
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
    fn the_page_is_where_a_browser_can_go() {
        for (listened, opened) in [
            ("127.0.0.1:7878", "http://127.0.0.1:7878/"),
            ("0.0.0.0:80", "http://127.0.0.1:80/"),
            ("[::]:7878", "http://[::1]:7878/"),
            ("192.168.1.7:1", "http://192.168.1.7:1/"),
        ] {
            assert_eq!(page(listened.parse().unwrap()), opened);
        }
    }
}
