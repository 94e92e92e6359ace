//! `rebake worker`: does parts of rounds for others, one at a time, on all of its threads.

use std::collections::HashSet;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use async_nats::Client;
use async_nats::jetstream::{self, AckKind};
use bytes::Bytes;
use futures_util::StreamExt;
use rayon::ThreadPool;
use rebake_core::{Estimate, LayerHeader, Observer, PartBaker, PartError};
use tracing::Instrument;

use super::messages::{
    CLOSED_SUBJECT, FORMAT, HEARTBEAT, News, PRESENCE_SUBJECT, Task, TaskLayer, What, consumer, news_subject, stream,
};
use super::objects::Objects;
use super::{ClusterConfig, ClusterError, connect, snapshot};
use crate::compute::{build_pool, catching};
use crate::engine::World;
use crate::ids::new_suffix;

/// How long one request to the queue waits for a part.
const POLL: Duration = Duration::from_secs(5);

/// Between two tries to reach a queue that is away.
const RETRY: Duration = Duration::from_secs(1);

/// Before a part that this worker cannot do is given to another.
const HAND_ON: Duration = Duration::from_millis(200);

/// For the end of the part that it is at, where the worker is to end.
const LAST_WORDS: Duration = Duration::from_secs(2);

/// How a worker runs.
#[derive(Clone, Debug)]
pub struct WorkerOptions {
    /// Where it meets the others.
    pub cluster: ClusterConfig,
    /// Threads that compute; one per core where absent.
    pub threads: Option<NonZeroUsize>,
}

/// Works for others until `shutdown` is ready, or until what it gives is refused.
///
/// # Errors
/// Where the addresses are none, the threads cannot be started, or a coordinator refuses what it gives.
pub async fn work(options: &WorkerOptions, shutdown: impl Future<Output = ()>) -> Result<(), ClusterError> {
    let worker = Arc::new(Worker::start(options).await?);
    let closed = tokio::spawn(worker.clone().hear_of_closed());
    let present = tokio::spawn(worker.clone().tell_presence());
    let mut serving = std::pin::pin!(worker.serve());
    let end = tokio::select! {
        end = &mut serving => end,
        () = shutdown => {
            worker.gives_up.store(true, Ordering::Relaxed);
            // What it is at goes back to the queue; if that takes too long, the queue sees that it is gone.
            tokio::time::timeout(LAST_WORDS, serving).await.unwrap_or(Ok(()))
        }
    };
    closed.abort();
    present.abort();
    end
}

struct Worker {
    name: String,
    client: Client,
    jetstream: jetstream::Context,
    objects: Objects,
    pool: Arc<ThreadPool>,
    /// The scene of the last part, and what its rounds share: the next part is most likely of the same.
    prepared: Mutex<Prepared>,
    /// Offers that nobody waits for any more.
    closed: Mutex<HashSet<String>>,
    gives_up: AtomicBool,
}

#[derive(Default)]
struct Prepared {
    world: Option<(String, Arc<World>)>,
    baker: Option<(BakeKey, Arc<PartBaker>)>,
}

/// Which bake: its scene, seed and layers.
type BakeKey = (String, u64, Vec<TaskLayer>);

/// Ends a part where nobody wants it any more.
struct Wanted {
    worker: Arc<Worker>,
    offer: String,
}

impl Observer for Wanted {
    fn canceled(&self) -> bool {
        self.worker.gives_up.load(Ordering::Relaxed) || self.worker.is_closed(&self.offer)
    }
}

impl Worker {
    async fn start(options: &WorkerOptions) -> Result<Worker, ClusterError> {
        let WorkerOptions { cluster, threads } = options;
        let client = connect(&cluster.queue, "rebake worker").await?;
        let pool = build_pool("worker", threads.map_or(0, NonZeroUsize::get));
        let pool = pool.map_err(|error| ClusterError::Failed(error.to_string()))?;
        Ok(Worker {
            name: new_suffix(),
            jetstream: jetstream::new(client.clone()),
            client,
            objects: Objects::open(&cluster.objects)?,
            pool: Arc::new(pool),
            prepared: Mutex::default(),
            closed: Mutex::default(),
            gives_up: AtomicBool::new(false),
        })
    }

    /// One part after the other; returns where its results are refused.
    async fn serve(self: &Arc<Worker>) -> Result<(), ClusterError> {
        while !self.gives_up.load(Ordering::Relaxed) {
            match self.serve_one().await {
                Ok(()) => {}
                Err(ClusterError::Refused) => return Err(ClusterError::Refused),
                Err(error) => {
                    tracing::warn!(%error, "no part");
                    tokio::time::sleep(RETRY).await;
                }
            }
        }
        Ok(())
    }

    /// Waits a while for a part, and does it.
    async fn serve_one(self: &Arc<Worker>) -> Result<(), ClusterError> {
        let consumer = consumer(&stream(&self.jetstream).await?).await?;
        let mut parts = consumer.batch().max_messages(1).expires(POLL).messages().await.map_err(ClusterError::queue)?;
        let Some(message) = parts.next().await else { return Ok(()) };
        let message = message.map_err(ClusterError::queue)?;
        let message = &message;
        let acknowledge = |kind| async move { message.ack_with(kind).await.map_err(ClusterError::queue) };
        let task = serde_json::from_slice::<Task>(&message.payload).ok().filter(|task| task.format == FORMAT);
        let Some(task) = task else {
            // For a worker of another version.
            return acknowledge(AckKind::Nak(Some(RETRY))).await;
        };
        if task.refused.contains(&self.name) {
            acknowledge(AckKind::Nak(Some(HAND_ON))).await?;
            return Err(ClusterError::Refused);
        }
        if self.is_closed(&task.offer) {
            return acknowledge(AckKind::Ack).await;
        }
        let span = tracing::info_span!("part", offer = task.offer, round = task.round, part = task.part);
        let mut doing = std::pin::pin!(self.clone().keep_result(task.clone()).instrument(span));
        let done = loop {
            self.tell(&task, What::Working).await?;
            acknowledge(AckKind::Progress).await?;
            if let Ok(done) = tokio::time::timeout(HEARTBEAT, &mut doing).await {
                break done;
            }
        };
        match done {
            Ok(done) => {
                self.tell(&task, done).await?;
                acknowledge(AckKind::Ack).await
            }
            Err(ClusterError::Part(PartError::Canceled(_))) => {
                let is_over = self.is_closed(&task.offer);
                acknowledge(if is_over { AckKind::Ack } else { AckKind::Nak(None) }).await
            }
            Err(error) => {
                tracing::warn!(%error, "this part is for others");
                self.tell(&task, What::Failed { reason: error.to_string() }).await?;
                acknowledge(AckKind::Nak(Some(HAND_ON))).await
            }
        }
    }

    /// Does a part and keeps its result.
    async fn keep_result(self: Arc<Worker>, task: Task) -> Result<What, ClusterError> {
        let begun = Instant::now();
        let world = self.world(&task.snapshot).await?;
        let effort = match &task.effort {
            Some(hash) => self.objects.file(hash).await?,
            None => Bytes::new(),
        };
        let path = task.result_path(&self.name);
        let worker = self.clone();
        let computed = self.compute(move || worker.do_part(&task, &world, &effort)).await??;
        let bytes = Bytes::from(computed.to_bytes());
        let hash = blake3::hash(&bytes).to_hex().to_string();
        self.objects.put(&path, bytes).await?;
        let ms = begun.elapsed().as_millis() as u64;
        tracing::info!(ms, "done");
        Ok(What::Done { hash, ms })
    }

    /// The scene of a part: the one of the last part, or one that is built.
    async fn world(self: &Arc<Worker>, snapshot: &str) -> Result<Arc<World>, ClusterError> {
        let known = self.prepared().world.as_ref().filter(|(hash, _)| hash == snapshot).map(|(_, world)| world.clone());
        if let Some(world) = known {
            return Ok(world);
        }
        let fetched = snapshot::fetch(&self.objects, snapshot).await?;
        // One scene at a time is in memory.
        *self.prepared() = Prepared::default();
        let world = self.compute(move || fetched.build()).await??;
        tracing::info!(elements = world.element_count(), "a scene is built");
        self.prepared().world = Some((snapshot.to_owned(), world.clone()));
        Ok(world)
    }

    fn do_part(self: &Arc<Worker>, task: &Task, world: &World, effort: &[u8]) -> Result<Estimate, ClusterError> {
        let wanted = Wanted { worker: self.clone(), offer: task.offer.clone() };
        let key = (task.snapshot.clone(), task.seed, task.layers.clone());
        let known = self.prepared().baker.as_ref().filter(|(known, _)| *known == key).map(|(_, baker)| baker.clone());
        let baker = match known {
            Some(baker) => baker,
            None => {
                let layers: Vec<LayerHeader> = task.layers.iter().map(Into::into).collect();
                let baker = Arc::new(PartBaker::new(world, &layers, task.seed, &wanted)?);
                self.prepared().baker = Some((key, baker.clone()));
                baker
            }
        };
        Ok(baker.part(task.spec(), effort, &wanted)?)
    }

    async fn compute<T: Send + 'static>(
        self: &Arc<Worker>,
        task: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, ClusterError> {
        let (send, receive) = tokio::sync::oneshot::channel();
        self.pool.spawn(move || {
            // Nobody waits at the end of the process.
            let _ = send.send(catching(task));
        });
        let failed = |error: &dyn std::fmt::Display| ClusterError::Failed(error.to_string());
        receive.await.map_err(|error| failed(&error))?.map_err(|panic| failed(&panic))
    }

    async fn tell(&self, task: &Task, what: What) -> Result<(), ClusterError> {
        let news = News { worker: self.name.clone(), round: task.round, part: task.part, what };
        let bytes = serde_json::to_vec(&news).map_err(|error| ClusterError::odd("news", error))?;
        self.client.publish(news_subject(&task.offer), bytes.into()).await.map_err(ClusterError::queue)?;
        self.client.flush().await.map_err(ClusterError::queue)
    }

    async fn tell_presence(self: Arc<Worker>) {
        loop {
            if let Err(error) = self.client.publish(PRESENCE_SUBJECT, self.name.clone().into()).await {
                tracing::debug!(%error, "not told that it is there");
            }
            tokio::time::sleep(HEARTBEAT).await;
        }
    }

    async fn hear_of_closed(self: Arc<Worker>) {
        /// Older ones are over.
        const REMEMBERED: usize = 1024;
        let Ok(mut closed) = self.client.subscribe(CLOSED_SUBJECT).await else { return };
        while let Some(message) = closed.next().await {
            let mut known = self.closed.lock().unwrap_or_else(PoisonError::into_inner);
            if known.len() >= REMEMBERED {
                known.clear();
            }
            known.insert(String::from_utf8_lossy(&message.payload).into_owned());
        }
    }

    fn is_closed(&self, offer: &str) -> bool {
        self.closed.lock().unwrap_or_else(PoisonError::into_inner).contains(offer)
    }

    fn prepared(&self) -> std::sync::MutexGuard<'_, Prepared> {
        self.prepared.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
