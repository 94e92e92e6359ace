//! Commands that talk to a service.

mod budget;
mod change;
mod edit;
mod look;
mod operation;
mod probes;
mod pull;
mod push;
mod watch;

pub(super) use change::{AssetsArgs, CancelArgs, DeleteArgs, TurnArgs, assets, cancel, delete, turn};
pub(super) use edit::{EditArgs, edit};
pub(super) use look::{InfoArgs, JobsArgs, ListArgs, info, jobs, list};
pub(super) use probes::{ProbesArgs, probes};
pub(super) use pull::{PullArgs, Replacement, pull};
pub(super) use push::{PushArgs, push};
pub(super) use watch::{ProgressFeed, WatchArgs, watch};

use std::path::Path;
use std::time::Duration;

use anyhow::Context;
use rebake::client::Client;
use rebake::client::types::{Job, JobState};

use super::exit::{Interrupted, JobEnded};
use super::ui;

/// Where the service is.
#[derive(Debug, clap::Args)]
pub(super) struct ServerArgs {
    /// Address of the service
    #[arg(long, global = true, value_name = "URL", env = "REBAKE_SERVER", default_value = "http://127.0.0.1:7878")]
    server: String,
    /// Access token, where the service asks for one
    #[arg(long, global = true, value_name = "TOKEN", env = "REBAKE_TOKEN", hide_env_values = true)]
    token: Option<String>,
}

impl ServerArgs {
    pub(super) fn client(&self) -> anyhow::Result<Client> {
        let client = Client::new(&self.server)?;
        Ok(match &self.token {
            Some(token) => client.with_token(token)?,
            None => client,
        })
    }
}

/// Arguments of `rebake health`.
#[derive(Debug, clap::Args)]
pub(super) struct HealthArgs {
    #[command(flatten)]
    server: ServerArgs,
}

/// Succeeds where the service takes work: for the health checks of containers.
pub(super) async fn health(args: HealthArgs) -> anyhow::Result<()> {
    const PATIENCE: Duration = Duration::from_secs(2);
    let client = args.server.client()?;
    tokio::time::timeout(PATIENCE, client.ready()).await.context("the service does not answer")??;
    ui::out("ready")
}

fn read_file(path: &Path) -> anyhow::Result<Vec<u8>> {
    std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))
}

/// A scene or an asset as it is sent: a `.gltf` goes together with the files that it names.
fn read_packed(path: &Path) -> anyhow::Result<Vec<u8>> {
    rebake_core::scene::packed(path).context("cannot read the file")
}

/// Runs `work` unless Ctrl-C comes first; `hint` says what goes on regardless.
pub(super) async fn interruptible<T>(
    work: impl Future<Output = anyhow::Result<T>>,
    hint: &'static str,
) -> anyhow::Result<T> {
    tokio::select! {
        result = work => result,
        _ = tokio::signal::ctrl_c() => Err(Interrupted(hint).into()),
    }
}

/// Waits for a job with a progress bar; an error unless it succeeds.
pub(super) async fn wait_for_job(client: &Client, job: &Job) -> anyhow::Result<Job> {
    let bar = ui::bar(if job.kind.is_empty() { "job" } else { &job.kind });
    let ended = client.wait_for_job(&job.id, |job| show_progress(&bar, job)).await;
    bar.finish_and_clear();
    let ended = ended?;
    match ended.state {
        JobState::Failed => {
            let why = ended.error_text().map(|why| format!(": {why}")).unwrap_or_default();
            Err(JobEnded(format!("job {} failed{why}", ended.id)).into())
        }
        JobState::Canceled => Err(JobEnded(format!("job {} was canceled", ended.id)).into()),
        _ => Ok(ended),
    }
}

fn show_progress(bar: &indicatif::ProgressBar, job: &Job) {
    let progress = &job.progress;
    bar.set_position((progress.fraction.unwrap_or(0.0).clamp(0.0, 1.0) * 1000.0) as u64);
    bar.set_message(match job.state {
        JobState::Queued => "queued".to_owned(),
        JobState::Paused => "paused".to_owned(),
        _ => describe(job),
    });
}

/// Pass, samples and error of a job, as far as it tells.
fn describe(job: &Job) -> String {
    let progress = &job.progress;
    let mut parts: Vec<String> = progress.pass.iter().map(|pass| pass.replace('_', " ")).collect();
    if let Some(samples) = progress.samples_per_element.filter(|samples| *samples > 0) {
        parts.push(format!("{} samples per element", ui::count(samples)));
    }
    if let Some(rmse) = progress.estimated_rmse {
        parts.push(format!("error {}", ui::rmse(rmse)));
    }
    if let Some(rmse) = progress.light_error.resolution {
        parts.push(format!("of resolution {}", ui::rmse(rmse)));
    }
    parts.join(", ")
}

/// One line about a job that is done.
fn note_done(job: &Job) {
    let seconds = job.progress.elapsed_ms.map(|ms| format!(" in {}", ui::seconds(ms as f64 / 1000.0)));
    let mut result = job.clone();
    result.progress.pass = None;
    let result = describe(&result);
    let result = if result.is_empty() { result } else { format!(": {result}") };
    ui::note(&format!("{} done{}{result}", job.kind, seconds.unwrap_or_default()));
    job.warnings.iter().for_each(|warning| ui::note(&format!("warning: {warning}")));
}
