//! Jobs: [`job`] is one of them with its steps, [`queue`] the state of all, [`scheduler`] decides, `worker` runs,
//! `observer` speaks for the service while the engine computes, `lifecycle` is how jobs come, change and go, `target`
//! what a scene works towards, `idle` what happens while there are none.

pub(crate) mod budget;
mod forecast;
mod idle;
pub mod job;
mod lifecycle;
pub(crate) mod merge;
mod observer;
mod phases;
mod piece;
pub mod queue;
pub mod scheduler;
pub(crate) mod seeds;
mod start;
mod stop;
mod target;
mod telling;
pub mod words;
pub(crate) mod worker;

#[cfg(test)]
mod model_tests;
#[cfg(test)]
mod tests;

use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use jiff::Timestamp;
use rayon::{ThreadPool, ThreadPoolBuildError};
use serde::{Deserialize, Serialize};
use tokio::sync::watch;

use crate::api::types;
use crate::cluster::Coordinator;
use crate::compute::{Compute, build_pool};
use crate::config::Config;
use crate::engine::{Budget, Importance};
use crate::events::EventLog;
use crate::ids::Ids;
use crate::metrics::Metrics;
use crate::saving::Saving;
use crate::store::Store;
use crate::store::lighting::Sequence;
use crate::store::records::{JobRecord, stored_importance};
use crate::store::scene::SceneEntry;
use crate::store::scenes::Scenes;

use budget::JobBudget;
use queue::{Job, JobKind, JobNumber, Priority, Queue, QueueLimits};
use stop::Stop;
pub(crate) use telling::tell_scene;

/// What to do for a scene.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct JobSpec {
    pub(crate) budget: JobBudget,
    /// What comes first.
    #[serde(flatten, with = "stored_importance")]
    pub(crate) importance: Importance,
    /// What is dragged, where the request does nothing else: something to see comes first, and the next step of the drag
    /// ends the rest.
    #[serde(default)]
    pub(crate) dragged: Vec<String>,
    pub(crate) seed: u64,
    /// Light everything up to this edit.
    pub(crate) sequence: Sequence,
}

impl JobSpec {
    /// All of the scene alike, up to an edit.
    pub(crate) fn new(budget: JobBudget, seed: u64, sequence: Sequence) -> JobSpec {
        JobSpec { budget, importance: Importance::default(), dragged: Vec::new(), seed, sequence }
    }

    /// A newer edit of the scene ends the order of its tiles: what somebody looks at then is elsewhere. Steps of a drag
    /// have a rule of their own.
    pub(crate) fn yields(&self) -> bool {
        self.importance.tiles.is_some() && self.dragged.is_empty()
    }

    /// What the engine is told; time is the observer's business.
    fn engine_budget(&self) -> Budget {
        Budget { samples_per_element: self.budget.samples_per_element, target_rmse: self.budget.target_rmse }
    }
}

/// The queue with what its jobs need to run.
pub(crate) struct Jobs {
    config: Arc<Config>,
    ids: Ids,
    scenes: Arc<Scenes>,
    store: Arc<dyn Store>,
    saving: Saving,
    compute: Compute,
    metrics: Arc<Metrics>,
    /// Others that do parts of bakes.
    coordinator: Option<Arc<Coordinator>>,
    state: Mutex<State>,
    /// Jobs that run at the same time.
    slots: usize,
    /// Where light maps are refined while no job waits: a job that comes finds its own threads free.
    idle_pool: Option<ThreadPool>,
    /// How many run.
    running: watch::Sender<usize>,
}

/// The parts of the service that jobs work with.
pub(crate) struct Means {
    pub(crate) config: Arc<Config>,
    pub(crate) ids: Ids,
    pub(crate) scenes: Arc<Scenes>,
    pub(crate) store: Arc<dyn Store>,
    pub(crate) saving: Saving,
    pub(crate) compute: Compute,
    pub(crate) metrics: Arc<Metrics>,
    pub(crate) coordinator: Option<Arc<Coordinator>>,
}

struct State {
    queue: Queue,
    handles: HashMap<JobNumber, Handle>,
    /// Pools of the free slots.
    pools: Vec<Arc<ThreadPool>>,
    /// Light maps are being refined; asks that to stop.
    idle: Option<Arc<Stop>>,
    /// No job starts any more.
    closed: bool,
    /// Jobs that ended last; their events are kept whole, for streams that are behind.
    just_ended: VecDeque<JobNumber>,
}

/// Jobs whose events are kept whole after their end.
const KEPT_WHOLE: usize = 32;

/// What clients are told of a job that the queue does not know.
#[derive(Clone, Debug)]
pub(crate) struct About {
    /// The scene's id.
    pub(crate) scene: String,
    /// Up to which of the scene's accepted edits it lights.
    pub(crate) sequence: Sequence,
    /// The stated error that it works towards.
    pub(crate) target_rmse: Option<f32>,
}

/// What belongs to a job beside its place in the queue.
struct Handle {
    about: About,
    /// Until the job ends: finished jobs must not keep a deleted scene in memory.
    scene: Option<Arc<SceneEntry>>,
    /// When this life of the service took it in: time budgets count from there.
    accepted: Instant,
    events: Arc<EventLog>,
    /// Of the present run.
    stop: Arc<Stop>,
    spec: JobSpec,
}

impl Jobs {
    pub(crate) fn new(means: Means) -> Result<Jobs, ThreadPoolBuildError> {
        let Means { config, ids, scenes, store, saving, compute, metrics, coordinator } = means;
        let limits = &config.limits;
        let slots = config.job_slots.max(1);
        // One more than slots, for what is urgent.
        let pools = (1..=slots + 1)
            .map(|slot| build_pool(&format!("job{slot}"), config.threads).map(Arc::new))
            .collect::<Result<_, _>>()?;
        let queue = Queue::new(QueueLimits {
            queued_per_scene: limits.queued_per_scene,
            queued: limits.queued,
            finished: limits.finished_jobs,
        });
        let idle_pool = config.idle_refine.map(|_| build_pool("idle", config.threads)).transpose()?;
        let state =
            State { queue, handles: HashMap::new(), pools, idle: None, closed: false, just_ended: VecDeque::new() };
        let (state, running) = (Mutex::new(state), watch::Sender::new(0));
        Ok(Jobs { config, ids, scenes, store, saving, compute, metrics, coordinator, state, slots, idle_pool, running })
    }

    /// Looks at the queue.
    pub(crate) fn with_queue<T>(&self, look: impl FnOnce(&Queue) -> T) -> T {
        look(&self.lock().queue)
    }

    /// A job with what it is about.
    pub(crate) fn get(&self, number: JobNumber) -> Option<(Job, About)> {
        let state = self.lock();
        let job = state.queue.get(number)?.clone();
        Some((job, state.handles.get(&number)?.about.clone()))
    }

    /// Jobs older than `before` that `wanted` says yes to, newest first, with what they are about.
    pub(crate) fn older_than(
        &self,
        before: JobNumber,
        limit: usize,
        wanted: impl Fn(&Job, &About) -> bool,
    ) -> Vec<(Job, About)> {
        let state = self.lock();
        let jobs = state.queue.older_than(before).filter_map(|job| Some((job, &state.handles.get(&job.number)?.about)));
        jobs.filter(|(job, about)| wanted(job, about))
            .map(|(job, about)| (job.clone(), about.clone()))
            .take(limit)
            .collect()
    }

    pub(crate) fn events(&self, number: JobNumber) -> Option<Arc<EventLog>> {
        self.lock().handles.get(&number).map(|handle| handle.events.clone())
    }

    /// Workers on other machines; none where there is no queue.
    pub(crate) fn worker_count(&self) -> Option<usize> {
        self.coordinator.as_ref().map(|coordinator| coordinator.worker_count())
    }

    /// Whether light maps are being refined while no job waits.
    pub(crate) fn is_refining(&self) -> bool {
        self.lock().idle.is_some()
    }

    /// Number of running jobs, as it changes; refining counts as one.
    pub(crate) fn watch_running(&self) -> watch::Receiver<usize> {
        self.running.subscribe()
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Jobs that run, and refining while there are none.
    fn running(&self) -> usize {
        self.queue.running() + usize::from(self.idle.is_some())
    }

    /// Tells everybody of a job's state. Under the queue's lock, so that events come in the order of the changes.
    fn tell(&self, jobs: &Jobs, number: JobNumber) {
        let (Some(job), Some(handle)) = (self.queue.get(number), self.handles.get(&number)) else { return };
        let data = types::to_event_data(&types::Job::new(&jobs.ids, job, &handle.about));
        if let Some(scene) = &handle.scene {
            scene.events.push("job", data.clone());
        }
        handle.events.push_state("job", data);
    }

    fn ended(&mut self, jobs: &Jobs, number: JobNumber) {
        self.tell(jobs, number);
        if let Some(handle) = self.handles.get_mut(&number) {
            handle.events.close();
            handle.scene = None;
        }
        self.just_ended.push_back(number);
        if self.just_ended.len() > KEPT_WHOLE
            && let Some(old) = self.just_ended.pop_front().and_then(|old| self.handles.get(&old))
        {
            old.events.shrink();
        }
        let forgotten = self.queue.take_forgotten();
        for old in &forgotten {
            self.handles.remove(old);
        }
        jobs.saving.forget_jobs(&forgotten);
    }

    /// What is kept of a job.
    fn record(&self, job: Job) -> Option<JobRecord> {
        let spec = self.handles.get(&job.number)?.spec.clone();
        Some(JobRecord { job, spec })
    }

    fn handle(&mut self, jobs: &Jobs, scene_id: String, scene: Option<Arc<SceneEntry>>, record: &JobRecord) {
        let events = Arc::new(EventLog::new(jobs.config.limits.events, jobs.ids.first_event));
        let (sequence, target_rmse) = (record.spec.sequence, record.spec.budget.target_rmse);
        let about = About { scene: scene_id, sequence, target_rmse };
        let handle =
            Handle { about, scene, accepted: Instant::now(), events, stop: Arc::default(), spec: record.spec.clone() };
        self.handles.insert(record.job.number, handle);
    }
}

/// The record of a job that comes.
pub(crate) fn new_record(
    number: JobNumber,
    scene: &SceneEntry,
    (kind, priority): (JobKind, Priority),
    spec: JobSpec,
) -> JobRecord {
    JobRecord { job: Job::new(number, scene.number, kind, priority, Timestamp::now()), spec }
}
