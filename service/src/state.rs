//! What all requests and jobs share.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use tokio::sync::{Semaphore, watch};

use crate::answers::Answers;
use crate::compute::Compute;
use crate::config::Config;
use crate::jobs::Jobs;
use crate::metrics::Metrics;
use crate::pictures::Pictures;
use crate::store::assets::Assets;
use crate::store::disk::{Disk, Saved};
use crate::store::scenes::Scenes;
use crate::store::{InMemory, Store, StoreError};

/// Why the service cannot start.
#[derive(Debug, thiserror::Error)]
pub(crate) enum StartError {
    /// No threads.
    #[error("cannot start the compute threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
    /// The data directory cannot be used.
    #[error("cannot use the data directory: {0}")]
    Store(#[from] StoreError),
}

/// How far the end of the service is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Phase {
    /// Brings back what the data directory holds.
    Restoring,
    /// Takes requests.
    Serving,
    /// Takes no new work; running jobs are being stopped.
    Draining,
    /// Streams send what is left and end.
    Closing,
}

/// A data directory with what it holds, where there is one.
pub(crate) type ToRestore = Option<(Arc<Disk>, Saved)>;

/// The service's state.
pub(crate) struct App {
    pub(crate) config: Config,
    pub(crate) ids: Ids,
    pub(crate) compute: Compute,
    pub(crate) answers: Arc<Answers>,
    pub(crate) jobs: Jobs,
    pub(crate) scenes: Arc<Scenes>,
    pub(crate) assets: Assets,
    pub(crate) pictures: Pictures,
    pub(crate) store: Arc<dyn Store>,
    pub(crate) phase: watch::Sender<Phase>,
    /// Uploads that are read and built.
    pub(crate) uploads: Arc<Semaphore>,
    /// Open event and delta streams.
    pub(crate) streams: Arc<Semaphore>,
    /// Bytes of scenes that are being built.
    pub(crate) promised_memory: AtomicU64,
    pub(crate) metrics: Metrics,
    /// Ids of this life's events rise from the one after it.
    pub(crate) first_event: u64,
}

impl App {
    /// The state, and what the data directory holds, to be restored.
    pub(crate) fn new(config: Config) -> Result<(Arc<App>, ToRestore), StartError> {
        let Some(directory) = &config.data_dir else {
            return Ok((App::with_store(config, Ids::new(), Arc::new(InMemory::default()), 0)?, None));
        };
        let disk = Disk::open(directory, config.faults.clone(), config.limits.idempotency_keys)?;
        let saved = disk.load(&Ids::new().suffix)?;
        let ids = Ids { suffix: saved.suffix.clone() };
        // Far enough apart that no life reaches the next one's ids, and exact in JSON for two million lives.
        let first_event = (saved.life - 1) << 32;
        let disk = Arc::new(disk);
        let app = App::with_store(config, ids, disk.clone(), first_event)?;
        app.phase.send_replace(Phase::Restoring);
        Ok((app, Some((disk, saved))))
    }

    fn with_store(config: Config, ids: Ids, store: Arc<dyn Store>, first_event: u64) -> Result<Arc<App>, StartError> {
        let (limits, timeouts) = (&config.limits, &config.timeouts);
        Ok(Arc::new(App {
            ids,
            compute: Compute::new(config.threads)?,
            answers: Answers::new(limits.answer_bytes, timeouts.answer_stall, timeouts.answer_room),
            jobs: Jobs::new(&config)?,
            scenes: Arc::new(Scenes::new()),
            assets: Assets::new(limits.assets, limits.asset_bytes),
            pictures: Pictures::new(),
            store,
            phase: watch::Sender::new(Phase::Serving),
            uploads: Arc::new(Semaphore::new(limits.concurrent_uploads)),
            streams: Arc::new(Semaphore::new(limits.streams)),
            promised_memory: AtomicU64::new(0),
            metrics: Metrics::default(),
            first_event,
            config,
        }))
    }

    pub(crate) fn is_serving(&self) -> bool {
        *self.phase.borrow() == Phase::Serving
    }
}

/// Ids that clients see: a letter, a number, and a suffix of this life of the service, so that an id (and with it a
/// version or an event id) that a client kept from an earlier life is unknown instead of meaning something else.
#[derive(Clone, Debug)]
pub(crate) struct Ids {
    suffix: String,
}

impl Ids {
    fn new() -> Ids {
        const DIGITS: &[u8; 32] = b"0123456789abcdefghjkmnpqrstvwxyz";
        // The standard library's hasher keys are random per process: enough for ids, which are no secrets.
        let mut random = RandomState::new().build_hasher();
        random.write_i128(jiff::Timestamp::now().as_nanosecond());
        let bits = random.finish();
        Ids { suffix: (0..6).map(|i| char::from(DIGITS[(bits >> (5 * i)) as usize & 31])).collect() }
    }

    pub(crate) fn scene(&self, number: u64) -> String {
        format!("s{number}-{}", self.suffix)
    }

    pub(crate) fn job(&self, number: u64) -> String {
        format!("j{number}-{}", self.suffix)
    }

    pub(crate) fn parse_scene(&self, id: &str) -> Option<u64> {
        self.parse(id, 's')
    }

    pub(crate) fn parse_job(&self, id: &str) -> Option<u64> {
        self.parse(id, 'j')
    }

    fn parse(&self, id: &str, letter: char) -> Option<u64> {
        let (number, suffix) = id.strip_prefix(letter)?.split_once('-')?;
        let canonical = !number.starts_with(['0', '+']) && suffix == self.suffix;
        canonical.then(|| number.parse().ok()).flatten()
    }
}
