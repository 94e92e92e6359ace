//! `rebake watch`: follow a light map.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use rebake::client::{Arrival, Client, ClientError, EventStream, Retry};
use serde_json::Value;

use super::super::exit::Interrupted;
use super::super::ui::{self, Table};
use super::ServerArgs;

const AFTER_HELP: &str = "\
Prints one line per new version of the light map: the time since the start, the version, how many elements changed,
the bytes that came over the wire for them and the error the service states. A lost connection is taken up again from
the last version.";

const HEADINGS: [&str; 5] = ["time", "version", "changed", "bytes", "stated error"];
const WIDTHS: [usize; 5] = [8, 7, 11, 10, 12];

/// Arguments of `rebake watch`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub(in super::super) struct WatchArgs {
    /// Id of the scene
    scene: String,
    #[command(flatten)]
    server: ServerArgs,
    /// End when this version is reached
    #[arg(long, value_name = "VERSION")]
    until: Option<u64>,
}

/// Follows a scene until Ctrl-C.
pub(in super::super) async fn watch(args: WatchArgs) -> anyhow::Result<()> {
    let client = args.server.client()?;
    let scene = client.scene(&args.scene).await?;
    let mut follower = client.follow(&args.scene).with_retry(Retry { max_attempts: None, ..Retry::default() });
    let mut feed = ProgressFeed::new(client, &args.scene);
    let start = Instant::now();
    let table = Table::new(&HEADINGS, &WIDTHS);
    ui::note(&format!("{}, {} elements", scene.name.as_deref().unwrap_or(&scene.id), ui::count(scene.elements)));
    ui::out(&ui::bold(&table.row(&HEADINGS)))?;
    let bar = ui::bar("");
    let result = loop {
        tokio::select! {
            update = follower.next() => {
                let update = match update {
                    Ok(update) => update,
                    Err(error) => break Err(error.into()),
                };
                // The event that states the error is sent with the frames; give it a moment to arrive.
                let _ = tokio::time::timeout(Duration::from_millis(50), feed.reach(update.version)).await;
                let line = table.row(&cells(start.elapsed(), &update, feed.rmse_at(update.version)));
                if let Err(error) = bar.suspend(|| ui::out(&line)) {
                    break Err(error);
                }
                if args.until.is_some_and(|until| update.version >= until) {
                    break Ok(());
                }
            }
            progress = feed.next() => show(&bar, &progress),
            _ = tokio::signal::ctrl_c() => break Err(Interrupted("").into()),
        }
    };
    bar.finish_and_clear();
    result
}

fn cells(elapsed: Duration, update: &Arrival, rmse: Option<f64>) -> [String; 5] {
    [
        format!("{:.2} s", elapsed.as_secs_f64()),
        update.version.to_string(),
        ui::count(update.changed as u64),
        ui::bytes(update.bytes as u64),
        rmse.map_or_else(|| "–".to_owned(), ui::rmse),
    ]
}

fn show(bar: &indicatif::ProgressBar, progress: &Progress) {
    bar.set_position((progress.fraction.unwrap_or(0.0).clamp(0.0, 1.0) * 1000.0) as u64);
    bar.set_message(progress.pass.as_deref().unwrap_or_default().replace('_', " "));
}

/// What an event says about the running job.
#[derive(Clone, Debug, Default, PartialEq)]
pub(in super::super) struct Progress {
    fraction: Option<f64>,
    pass: Option<String>,
    version: Option<u64>,
    samples: Option<u64>,
    rmse: Option<f64>,
}

/// What a `snapshot` event says about a version.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Snapshot {
    version: u64,
    rmse: Option<f64>,
    /// There is new light in it, not just old light carried over to new geometry.
    is_lit: bool,
}

impl Progress {
    /// Reads the fields wherever the event has them: at its top, in `progress`, or in `job.progress`.
    fn from_event(data: &str) -> Option<Progress> {
        let data: Value = serde_json::from_str(data).ok()?;
        let places = [&data["job"]["progress"], &data["progress"], &data];
        let field = |name: &str| places.iter().map(|place| &place[name]).find(|value| !value.is_null());
        let progress = Progress {
            fraction: field("fraction").and_then(Value::as_f64),
            pass: field("pass").and_then(Value::as_str).map(str::to_owned),
            version: field("version").and_then(Value::as_u64),
            samples: field("samples_per_element").and_then(Value::as_u64),
            rmse: field("estimated_rmse").and_then(Value::as_f64),
        };
        (progress != Progress::default()).then_some(progress)
    }
}

/// The scene's events, reconnected where they break off, with what they said about the latest versions.
pub(in super::super) struct ProgressFeed {
    client: Client,
    scene: String,
    events: Option<EventStream>,
    last_id: Option<String>,
    recent: VecDeque<Snapshot>,
    seen: u64,
}

impl ProgressFeed {
    pub(in super::super) fn new(client: Client, scene: &str) -> ProgressFeed {
        ProgressFeed { client, scene: scene.to_owned(), events: None, last_id: None, recent: VecDeque::new(), seen: 0 }
    }

    /// The next word about progress. Waits forever if there is none; may be dropped at any time.
    pub(in super::super) async fn next(&mut self) -> Progress {
        loop {
            match self.next_event().await {
                Ok(Some(progress)) => return progress,
                Ok(None) => {}
                Err(_) => {
                    self.events = None;
                    tokio::time::sleep(Duration::from_secs(1)).await;
                }
            }
        }
    }

    /// Reads on until something was said about `version`.
    pub(in super::super) async fn reach(&mut self, version: u64) {
        while self.seen < version {
            self.next().await;
        }
    }

    /// The stated error of a version, where an event told it.
    fn rmse_at(&self, version: u64) -> Option<f64> {
        self.recent.iter().rev().find(|snapshot| snapshot.version == version)?.rmse
    }

    /// The first version after `version` with new light in it.
    pub(in super::super) fn first_lit_after(&self, version: u64) -> Option<u64> {
        self.recent.iter().find(|snapshot| snapshot.version > version && snapshot.is_lit).map(|s| s.version)
    }

    async fn next_event(&mut self) -> Result<Option<Progress>, ClientError> {
        let events = match &mut self.events {
            Some(events) => events,
            None => {
                let stream = self.client.scene_events(&self.scene, self.last_id.as_deref()).await?;
                self.events.insert(stream)
            }
        };
        let event = events.next().await?.ok_or(ClientError::Ended)?;
        self.last_id.clone_from(&event.id);
        let progress = Progress::from_event(&event.data);
        // Other events tell of the version too, but not of one and the same moment.
        if event.event == "snapshot"
            && let Some(Progress { version: Some(version), samples, rmse, .. }) = progress
        {
            self.seen = self.seen.max(version);
            self.recent.push_back(Snapshot { version, rmse, is_lit: samples.is_some_and(|samples| samples > 0) });
            while self.recent.len() > 64 {
                self.recent.pop_front();
            }
        }
        Ok(progress)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_is_found_where_the_event_has_it() {
        let expected = Progress { fraction: Some(0.5), pass: None, version: Some(3), samples: None, rmse: Some(0.25) };
        for data in [
            r#"{"fraction":0.5,"version":3,"estimated_rmse":0.25}"#,
            r#"{"id":"j","progress":{"fraction":0.5,"version":3,"estimated_rmse":0.25,"pass":null}}"#,
            r#"{"job":{"id":"j","progress":{"fraction":0.5,"version":3,"estimated_rmse":0.25}}}"#,
        ] {
            assert_eq!(Progress::from_event(data), Some(expected.clone()), "{data}");
        }
        for data in ["", "{}", "[1]", "null", r#"{"state":"queued"}"#] {
            assert_eq!(Progress::from_event(data), None, "{data}");
        }
    }
}
