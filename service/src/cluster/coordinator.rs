//! Speaks for bakes: offers their parts to workers, and hears what comes of them.

use std::collections::{BTreeSet, HashMap};
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

use async_nats::jetstream;
use async_nats::{Client, Message};
use bytes::Bytes;
use futures_util::StreamExt;
use rebake_core::{Estimate, Offer};
use tokio::runtime::Handle;

use super::messages::{
    CLOSED_SUBJECT, FORMAT, News, PRESENCE_SUBJECT, Task, What, news_subject, results_folder, stream, tasks_subject,
};
use super::objects::{Objects, checked};
use super::offers::{Offered, OpenOffer};
use super::snapshot::{self, Told};
use super::{ClusterConfig, ClusterError, connect};
use crate::ids::new_suffix;
use crate::jobs::queue::SceneNumber;
use crate::metrics::Metrics;
use crate::store::Store;
use crate::store::lighting::Sequence;

/// A worker that has not told for so long that it is there is not.
const PRESENCE: Duration = Duration::from_secs(10);

/// A service that has others do parts of its bakes.
pub(crate) struct Coordinator {
    /// Offers are named after it.
    id: String,
    client: Client,
    jetstream: jetstream::Context,
    objects: Objects,
    store: Arc<dyn Store>,
    metrics: Arc<Metrics>,
    runtime: Handle,
    delegates: bool,
    offers: Mutex<HashMap<String, Weak<Offered>>>,
    newest: AtomicU64,
    /// Of each scene that was told to others: its edits by then, and the hash of the manifest.
    told: Mutex<HashMap<SceneNumber, (Sequence, String)>>,
    workers: Mutex<Workers>,
}

/// What is known of workers.
#[derive(Default)]
struct Workers {
    /// When each was last heard of.
    heard: HashMap<String, Instant>,
    /// Those that have given nonsense.
    refused: BTreeSet<String>,
}

impl Coordinator {
    /// Begins to listen. Needs a runtime around it; the queue need not be there yet.
    pub(crate) fn start(
        config: &ClusterConfig,
        store: Arc<dyn Store>,
        metrics: Arc<Metrics>,
    ) -> Result<Arc<Coordinator>, ClusterError> {
        let runtime = Handle::try_current().map_err(|error| ClusterError::Failed(error.to_string()))?;
        let objects = Objects::open(&config.objects)?;
        let client = runtime.block_on(connect(&config.queue, "rebake serve"))?;
        let coordinator = Arc::new(Coordinator {
            id: new_suffix(),
            jetstream: jetstream::new(client.clone()),
            client,
            objects,
            store,
            metrics,
            runtime: runtime.clone(),
            delegates: config.delegates,
            offers: Mutex::default(),
            newest: AtomicU64::new(0),
            told: Mutex::default(),
            workers: Mutex::default(),
        });
        runtime.spawn(listen(Arc::downgrade(&coordinator), coordinator.client.clone(), coordinator.id.clone()));
        runtime.spawn(count_workers(Arc::downgrade(&coordinator), coordinator.client.clone()));
        Ok(coordinator)
    }

    /// Offers the parts of a round. They are told to others in the background.
    pub(crate) fn offer(self: &Arc<Coordinator>, told: &Told<'_>, offer: &Offer<'_>) -> OpenOffer {
        let id = format!("{}.{}", self.id, self.newest.fetch_add(1, Ordering::Relaxed));
        let offered = Arc::new(Offered::new(id.clone(), told.world.slots(), offer.parts));
        self.offers().insert(id.clone(), Arc::downgrade(&offered));
        let known = self.told_of(told.scene).filter(|(sequence, _)| *sequence == told.sequence);
        let gathered = match known {
            Some((_, hash)) => Ok((Some(hash), None)),
            None => snapshot::gather(&*self.store, told).map(|gathered| (None, Some(gathered))),
        };
        let task = Task {
            format: FORMAT,
            offer: id,
            snapshot: String::new(),
            seed: offer.seed,
            layers: offer.layers.iter().map(Into::into).collect(),
            effort: None,
            round: offer.round,
            part: 0,
            samples: 0,
            refused: Vec::new(),
        };
        match gathered {
            Ok((hash, gathered)) => {
                let (coordinator, offered) = (self.clone(), offered.clone());
                let (scene, sequence, effort) = (told.scene, told.sequence, Bytes::copy_from_slice(offer.effort));
                self.runtime.spawn(async move {
                    let tell = async {
                        let snapshot = match (hash, gathered) {
                            (Some(hash), _) => hash,
                            (None, Some(gathered)) => gathered.put(&coordinator.objects).await?,
                            (None, None) => return Ok(()),
                        };
                        coordinator.note_told(scene, sequence, &snapshot);
                        let effort = match effort.is_empty() {
                            true => None,
                            false => Some(coordinator.objects.put_file(effort).await?),
                        };
                        coordinator.queue(&offered, Task { snapshot, effort, ..task }).await
                    };
                    let told: Result<(), ClusterError> = tell.await;
                    if let Err(error) = told {
                        tracing::warn!(%error, "parts are not offered to workers");
                    }
                });
            }
            Err(error) => tracing::warn!(%error, "parts are not offered to workers"),
        }
        OpenOffer::new(self.clone(), offered)
    }

    /// Puts the parts that wait into the queue.
    async fn queue(&self, offered: &Offered, task: Task) -> Result<(), ClusterError> {
        stream(&self.jetstream).await?;
        offered.lock().task = Some(task);
        let count = offered.lock().parts.len() as u32;
        for part in (0..count).take_while(|_| self.is_open(offered)) {
            self.queue_part(offered, part).await?;
        }
        if !self.is_open(offered) {
            self.unqueue_all(offered).await;
        }
        Ok(())
    }

    async fn queue_part(&self, offered: &Offered, part: u32) -> Result<(), ClusterError> {
        let task = {
            let state = offered.lock();
            let Some(task) = state.task.as_ref().filter(|_| state.board.is_waiting(part)) else { return Ok(()) };
            let refused = self.workers().refused.iter().cloned().collect();
            Task { part, samples: state.parts[part as usize], refused, ..task.clone() }
        };
        let bytes = serde_json::to_vec(&task).map_err(|error| ClusterError::odd("a task", error))?;
        let sent =
            self.jetstream.publish(tasks_subject(&offered.id), bytes.into()).await.map_err(ClusterError::queue)?;
        let place = sent.await.map_err(ClusterError::queue)?.sequence;
        offered.lock().queued.insert(part, place);
        Ok(())
    }

    /// An offer is over.
    pub(super) fn forget(&self, offer: &str) {
        self.offers().remove(offer);
    }

    pub(super) fn metrics(&self) -> &Metrics {
        &self.metrics
    }

    fn is_open(&self, offered: &Offered) -> bool {
        self.offers().contains_key(&offered.id)
    }

    /// A worker has said something of an offer.
    async fn hear(self: &Arc<Coordinator>, message: Message) {
        let Some(offer) = message.subject.strip_prefix(news_subject("").as_str()) else { return };
        let offered = self.offers().get(offer).and_then(Weak::upgrade);
        let Some(offered) = offered else { return };
        let Ok(news) = serde_json::from_slice::<News>(&message.payload) else {
            return tracing::warn!(offer, "a worker says what cannot be read");
        };
        let News { worker, round, part, what } = news;
        if self.workers().refused.contains(&worker) {
            return;
        }
        self.is_there(&worker);
        let is_this = offered.lock().task.as_ref().is_some_and(|task| task.round == round);
        if !is_this {
            return;
        }
        match what {
            What::Working => offered.lock().board.working(part, &worker, offered.age()),
            What::Failed { reason } => {
                tracing::warn!(worker, part, reason, "a worker cannot do a part");
                offered.lock().board.failed(part, &worker);
            }
            What::Done { hash, ms } => self.take(&offered, part, &worker, (&hash, ms)).await,
        }
        offered.notify();
    }

    /// Reads what a worker has kept, and refuses all of its results where that is nonsense.
    async fn take(self: &Arc<Coordinator>, offered: &Arc<Offered>, part: u32, worker: &str, (hash, ms): (&str, u64)) {
        let task = {
            let state = offered.lock();
            let samples = state.parts.get(part as usize).copied().unwrap_or_default();
            let task = state.task.clone().filter(|_| state.board.wants(part));
            task.map(|task| Task { part, samples, ..task })
        };
        let Some(task) = task else { return };
        let path = task.result_path(worker);
        let read = async { read_result(self.objects.get(&path).await?, hash, &task, offered.slots) };
        match read.await {
            Ok(estimate) => {
                tracing::debug!(worker, part, ms, "a part came");
                offered.lock().board.done(part, estimate);
                self.metrics.part_done("elsewhere");
            }
            // It may have been taken and removed already, where a worker tells twice; or the objects are away.
            Err(ClusterError::Objects(error)) => {
                tracing::warn!(worker, part, %error, "a result cannot be read");
                offered.lock().board.failed(part, worker);
            }
            Err(error) => {
                tracing::warn!(worker, part, %error, "a worker gives nonsense: nothing is taken from it any more");
                self.metrics.part_done("refused");
                {
                    let mut workers = self.workers();
                    workers.heard.remove(worker);
                    workers.refused.insert(worker.to_owned());
                }
                offered.lock().board.forget(worker);
                // Another worker may be sooner than this machine.
                if let Err(error) = self.queue_part(offered, part).await {
                    tracing::warn!(%error, "a part is not offered again");
                }
            }
        }
        if let Err(error) = self.objects.remove(&path).await {
            tracing::debug!(%error, "a result stays");
        }
    }

    /// Nobody waits for the parts of an offer any more.
    pub(super) async fn close(self: Arc<Coordinator>, offered: Arc<Offered>) {
        let closed = async {
            let id = offered.id.clone();
            self.client.publish(CLOSED_SUBJECT, id.into()).await.map_err(ClusterError::queue)?;
            self.unqueue_all(&offered).await;
            self.objects.remove_all(&results_folder(&offered.id)).await
        };
        if let Err(error) = closed.await {
            tracing::debug!(%error, "an offer is not cleared away");
        }
    }

    /// One by one: where a subject is purged, nats-server 2.9 has the consumer skip what is in the queue of others.
    async fn unqueue_all(&self, offered: &Offered) {
        let places: Vec<u64> = offered.lock().queued.drain().map(|(_, place)| place).collect();
        for place in places {
            self.unqueue(place).await;
        }
    }

    /// Takes a task out of the queue, if no worker was sooner.
    pub(super) async fn unqueue(&self, place: u64) {
        let deleted = async {
            let stream = stream(&self.jetstream).await?;
            stream.delete_message(place).await.map_err(ClusterError::queue)
        };
        if let Err(error) = deleted.await {
            tracing::debug!(%error, place, "not taken out of the queue");
        }
    }

    pub(crate) fn runtime(&self) -> &Handle {
        &self.runtime
    }

    pub(super) fn objects(&self) -> &Objects {
        &self.objects
    }

    /// As of which edit a scene was told to others last, and the hash of the manifest.
    pub(super) fn told_of(&self, scene: SceneNumber) -> Option<(Sequence, String)> {
        self.told().get(&scene).cloned()
    }

    pub(super) fn note_told(&self, scene: SceneNumber, sequence: Sequence, hash: &str) {
        self.told().insert(scene, (sequence, hash.to_owned()));
    }

    /// Tells whoever listens.
    pub(super) async fn tell(&self, subject: String, what: &'static str) -> Result<(), ClusterError> {
        self.client.publish(subject, what.into()).await.map_err(ClusterError::queue)
    }

    fn is_there(&self, worker: &str) {
        let mut workers = self.workers();
        if !workers.refused.contains(worker) {
            workers.heard.insert(worker.to_owned(), Instant::now());
        }
    }

    /// Workers that are there.
    pub(crate) fn worker_count(&self) -> usize {
        let mut workers = self.workers();
        workers.heard.retain(|_, heard| heard.elapsed() < PRESENCE);
        workers.heard.len()
    }

    pub(super) fn leaves_parts(&self) -> bool {
        self.delegates && self.worker_count() > 0
    }

    fn workers(&self) -> MutexGuard<'_, Workers> {
        self.workers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn offers(&self) -> MutexGuard<'_, HashMap<String, Weak<Offered>>> {
        self.offers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn told(&self) -> MutexGuard<'_, HashMap<SceneNumber, (Sequence, String)>> {
        self.told.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl fmt::Debug for Coordinator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Coordinator").field("id", &self.id).finish_non_exhaustive()
    }
}

/// The estimate of a part, if it is one and all of it is light.
fn read_result(bytes: Bytes, hash: &str, task: &Task, slots: usize) -> Result<Estimate, ClusterError> {
    let bytes = checked(bytes, hash)?;
    let odd = |reason: &dyn fmt::Display| ClusterError::odd("a result", reason);
    let estimate = Estimate::from_bytes(&bytes, slots).map_err(|error| odd(&error))?;
    let is_it = (estimate.round, estimate.part, estimate.samples) == (task.round, task.part, task.samples);
    match is_it && estimate.is_finite() {
        true => Ok(estimate),
        false => Err(odd(&"it is of another part, or not finite")),
    }
}

/// Hears workers until the coordinator is gone.
async fn listen(coordinator: Weak<Coordinator>, client: Client, id: String) {
    let mut news = match client.subscribe(news_subject(&format!("{id}.*"))).await {
        Ok(news) => news,
        Err(error) => return tracing::error!(%error, "workers cannot be heard"),
    };
    while let Some(message) = news.next().await {
        let Some(coordinator) = coordinator.upgrade() else { return };
        tokio::spawn(async move { coordinator.hear(message).await });
    }
}

/// Hears which workers there are until the coordinator is gone.
async fn count_workers(coordinator: Weak<Coordinator>, client: Client) {
    let mut presence = match client.subscribe(PRESENCE_SUBJECT).await {
        Ok(presence) => presence,
        Err(error) => return tracing::error!(%error, "workers cannot be heard"),
    };
    while let Some(message) = presence.next().await {
        let Some(coordinator) = coordinator.upgrade() else { return };
        coordinator.is_there(&String::from_utf8_lossy(&message.payload));
    }
}
