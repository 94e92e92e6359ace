//! What all requests and jobs share.

use std::sync::Arc;

use tokio::sync::{Semaphore, watch};

use crate::answers::Answers;
use crate::cluster::{ClusterError, Coordinator, publish};
use crate::compute::Compute;
use crate::config::Config;
use crate::ids::{Ids, new_suffix};
use crate::jobs::{Jobs, Means};
use crate::memory::Memory;
use crate::metrics::Metrics;
use crate::pictures::Pictures;
use crate::saving::Saving;
use crate::store::assets::Assets;
use crate::store::disk::{Disk, Saved};
use crate::store::scenes::Scenes;
use crate::store::upload_keys::UploadKeys;
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
    /// Other machines cannot be reached that way.
    #[error("cannot work with others: {0}")]
    Cluster(#[from] ClusterError),
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

/// The service's state: parts that requests and jobs share, with one task each. A part holds those that it works with
/// and knows nothing of the rest.
pub(crate) struct App {
    /// Limits, waits, and what a client gets that does not ask for anything else.
    pub(crate) config: Arc<Config>,
    /// What clients call scenes, jobs and events by.
    pub(crate) ids: Ids,
    /// Threads for what is no job: short tasks, builds, pictures.
    pub(crate) compute: Compute,
    /// All scenes in memory.
    pub(crate) scenes: Arc<Scenes>,
    /// What may be inserted, and pictures of skies.
    pub(crate) assets: Arc<Assets>,
    /// What uploads came with that clients may send again.
    pub(crate) upload_keys: Arc<UploadKeys>,
    /// The queue, what runs from it, and what clients are told of both.
    pub(crate) jobs: Arc<Jobs>,
    /// What survives a restart: a data directory, or nothing.
    pub(crate) store: Arc<dyn Store>,
    /// When light goes to the store.
    pub(crate) saving: Saving,
    /// How much memory scenes and assets take, and whether more fits.
    pub(crate) memory: Memory,
    /// Room for large answers that clients have yet to take in.
    pub(crate) answers: Arc<Answers>,
    /// Preview pictures: room to draw them, and what changes are shown against.
    pub(crate) pictures: Pictures,
    /// What is counted for Prometheus.
    pub(crate) metrics: Arc<Metrics>,
    /// Room for uploads that are read and built.
    pub(crate) uploads: Arc<Semaphore>,
    /// Room for event and delta streams.
    pub(crate) streams: Arc<Semaphore>,
    /// How far the end of the service is.
    pub(crate) phase: watch::Sender<Phase>,
}

impl App {
    /// The state, and what the data directory holds, to be restored.
    pub(crate) fn new(config: Config) -> Result<(Arc<App>, ToRestore), StartError> {
        let Some(directory) = &config.data_dir else {
            let store = if config.cluster.is_some() { InMemory::with_origins() } else { InMemory::default() };
            return Ok((App::with_store(config, Ids::new(), Arc::new(store), Phase::Serving)?, None));
        };
        let disk = Disk::open(directory, config.faults.clone(), config.limits.idempotency_keys)?;
        let saved = disk.load(&new_suffix())?;
        let ids = Ids::of_life(saved.suffix.clone(), saved.life);
        let disk = Arc::new(disk);
        let app = App::with_store(config, ids, disk.clone(), Phase::Restoring)?;
        Ok((app, Some((disk, saved))))
    }

    /// A state that keeps nothing, with ids of another service.
    pub(crate) fn in_memory(config: Config, ids: Ids) -> Result<Arc<App>, StartError> {
        App::with_store(config, ids, Arc::new(InMemory::default()), Phase::Serving)
    }

    fn with_store(config: Config, ids: Ids, store: Arc<dyn Store>, phase: Phase) -> Result<Arc<App>, StartError> {
        let phase = watch::Sender::new(phase);
        let config = Arc::new(config);
        let (limits, timeouts) = (&config.limits, &config.timeouts);
        let compute = Compute::new(config.threads)?;
        let (scenes, metrics) = (Arc::new(Scenes::new()), Arc::new(Metrics::default()));
        let assets = Arc::new(Assets::new(limits.assets, limits.asset_bytes));
        let saving = Saving { store: store.clone(), compute: compute.clone(), metrics: metrics.clone() };
        let start = |cluster| Coordinator::start(cluster, store.clone(), metrics.clone());
        let coordinator = config.cluster.as_ref().map(start).transpose()?;
        let jobs = Jobs::new(Means {
            config: config.clone(),
            ids: ids.clone(),
            scenes: scenes.clone(),
            store: store.clone(),
            saving: saving.clone(),
            compute: compute.clone(),
            metrics: metrics.clone(),
            coordinator: coordinator.clone(),
        })?;
        if let Some(coordinator) = coordinator {
            let runtime = coordinator.runtime().clone();
            let mut restoring = phase.subscribe();
            let restored = async move {
                // The sender lives as long as the service.
                let _ = restoring.wait_for(|phase| *phase != Phase::Restoring).await;
            };
            let kept = (scenes.clone(), store.clone());
            runtime.spawn(publish(coordinator, ids.clone(), kept, compute.clone(), restored));
        }
        Ok(Arc::new(App {
            memory: Memory::new(limits.memory_bytes, scenes.clone(), assets.clone(), store.clone()),
            answers: Answers::new(limits.answer_bytes, timeouts.answer_stall, timeouts.answer_room),
            uploads: Arc::new(Semaphore::new(limits.concurrent_uploads)),
            streams: Arc::new(Semaphore::new(limits.streams)),
            upload_keys: Arc::new(UploadKeys::new(limits.idempotency_keys)),
            pictures: Pictures::new(),
            phase,
            jobs: Arc::new(jobs),
            ids,
            compute,
            scenes,
            assets,
            store,
            saving,
            metrics,
            config,
        }))
    }

    /// Whether requests may begin new work.
    pub(crate) fn is_serving(&self) -> bool {
        *self.phase.borrow() == Phase::Serving
    }
}
