//! Jobs: [`queue`] is their state, [`scheduler`] decides, `worker` runs, `observer` speaks for the service while
//! the engine computes.

pub(crate) mod observer;
pub mod queue;
pub mod scheduler;
pub(crate) mod worker;

#[cfg(test)]
mod tests;

use std::collections::{HashMap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use jiff::Timestamp;
use rayon::{ThreadPool, ThreadPoolBuildError};
use tokio::sync::watch;

use crate::api::types;
use crate::compute::build_pool;
use crate::config::Config;
use crate::engine::{Focus, Progress};
use crate::events::EventLog;
use crate::state::App;
use crate::store::lighting::Sequence;
use crate::store::scenes::SceneEntry;
use crate::store::versions::Published;
use observer::JobBudget;
use queue::{Cancel, Full, Job, JobKind, JobNumber, JobProgress, Outcome, Queue, QueueLimits};
use scheduler::Decision;

/// What to do for a scene.
pub(crate) struct JobSpec {
    pub(crate) kind: JobKind,
    pub(crate) budget: JobBudget,
    pub(crate) focus: Option<Focus>,
    pub(crate) seed: u64,
    /// Light everything up to this edit.
    pub(crate) sequence: Sequence,
}

/// The queue with what its jobs need to run.
pub(crate) struct Jobs {
    state: Mutex<State>,
    slots: usize,
    running: watch::Sender<usize>,
}

struct State {
    queue: Queue,
    handles: HashMap<JobNumber, Handle>,
    /// Pools of the free slots.
    pools: Vec<Arc<ThreadPool>>,
    /// No job starts any more.
    closed: bool,
    /// Jobs that ended last; their events are kept whole, for streams that are behind.
    just_ended: VecDeque<JobNumber>,
}

/// Jobs whose events are kept whole after their end.
const KEPT_WHOLE: usize = 32;

/// What belongs to a job beside its place in the queue.
struct Handle {
    scene_id: String,
    /// Until the job ends: finished jobs must not keep a deleted scene in memory.
    scene: Option<Arc<SceneEntry>>,
    events: Arc<EventLog>,
    cancel: Arc<AtomicBool>,
    /// Until it starts.
    spec: Option<JobSpec>,
    /// The edit up to which it lights.
    sequence: Sequence,
}

impl Jobs {
    pub(crate) fn new(config: &Config) -> Result<Jobs, ThreadPoolBuildError> {
        let limits = &config.limits;
        let slots = config.job_slots.max(1);
        let pools = (1..=slots)
            .map(|slot| build_pool(&format!("job{slot}"), config.threads).map(Arc::new))
            .collect::<Result<_, _>>()?;
        let queue = Queue::new(QueueLimits {
            queued_per_scene: limits.queued_per_scene,
            queued: limits.queued,
            finished: limits.finished_jobs,
        });
        let state = State { queue, handles: HashMap::new(), pools, closed: false, just_ended: VecDeque::new() };
        Ok(Jobs { state: Mutex::new(state), slots, running: watch::Sender::new(0) })
    }

    /// Whether one more job of the scene has room.
    pub(crate) fn has_room(&self, scene: &SceneEntry) -> Result<(), Full> {
        self.lock().queue.has_room(scene.number)
    }

    /// Looks at the queue.
    pub(crate) fn with_queue<T>(&self, look: impl FnOnce(&Queue) -> T) -> T {
        look(&self.lock().queue)
    }

    /// A job with its scene's id.
    pub(crate) fn get(&self, number: JobNumber) -> Option<(Job, String)> {
        let state = self.lock();
        let job = state.queue.get(number)?.clone();
        Some((job, state.handles.get(&number)?.scene_id.clone()))
    }

    /// Jobs older than `before` that `wanted` says yes to, newest first, with their scenes' ids.
    pub(crate) fn older_than(
        &self,
        before: JobNumber,
        limit: usize,
        wanted: impl Fn(&Job, &str) -> bool,
    ) -> Vec<(Job, String)> {
        let state = self.lock();
        let jobs =
            state.queue.older_than(before).filter_map(|job| Some((job, &state.handles.get(&job.number)?.scene_id)));
        jobs.filter(|(job, scene)| wanted(job, scene))
            .map(|(job, scene)| (job.clone(), scene.clone()))
            .take(limit)
            .collect()
    }

    pub(crate) fn events(&self, number: JobNumber) -> Option<Arc<EventLog>> {
        self.lock().handles.get(&number).map(|handle| handle.events.clone())
    }

    /// Number of running jobs, as it changes.
    pub(crate) fn watch_running(&self) -> watch::Receiver<usize> {
        self.running.subscribe()
    }

    /// Starts nothing any more and cancels what is there.
    pub(crate) fn close(&self, app: &App) {
        let open: Vec<JobNumber> = {
            let mut state = self.lock();
            state.closed = true;
            state.queue.iter().filter(|job| !job.state.has_ended()).map(|job| job.number).collect()
        };
        for job in open {
            self.cancel(app, job);
        }
    }

    fn cancel(&self, app: &App, number: JobNumber) -> Cancel {
        let mut state = self.lock();
        let done = state.queue.cancel(number, Timestamp::now());
        match done {
            Cancel::Done => state.ended(app, number),
            Cancel::Requested => {
                if let Some(handle) = state.handles.get(&number) {
                    handle.cancel.store(true, Ordering::Relaxed);
                }
            }
            Cancel::Unknown | Cancel::Ended => {}
        }
        done
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Tells everybody of a job's state. Under the queue's lock, so that events come in the order of the changes.
    fn tell(&self, app: &App, number: JobNumber) {
        let (Some(job), Some(handle)) = (self.queue.get(number), self.handles.get(&number)) else { return };
        let data = types::to_event_data(&types::Job::new(&app.ids, job, &handle.scene_id));
        if let Some(scene) = &handle.scene {
            scene.events.push("job", data.clone());
        }
        handle.events.push_state("job", data);
    }

    fn ended(&mut self, app: &App, number: JobNumber) {
        self.tell(app, number);
        if let Some(handle) = self.handles.get_mut(&number) {
            handle.events.close();
            handle.spec = None;
            handle.scene = None;
        }
        self.just_ended.push_back(number);
        if self.just_ended.len() > KEPT_WHOLE
            && let Some(old) = self.just_ended.pop_front().and_then(|old| self.handles.get(&old))
        {
            old.events.shrink();
        }
        for old in self.queue.take_forgotten() {
            self.handles.remove(&old);
        }
    }
}

impl App {
    /// Queues a job and starts it if there is room. `accept` runs once its number is known and before it can start.
    pub(crate) fn submit(
        self: &Arc<App>,
        scene: &Arc<SceneEntry>,
        spec: JobSpec,
        accept: impl FnOnce(JobNumber),
    ) -> Result<Job, Full> {
        let mut state = self.jobs.lock();
        if state.closed {
            return Err(Full::Closed);
        }
        let number = state.queue.push(scene.number, spec.kind, Timestamp::now())?;
        let handle = Handle {
            scene_id: scene.id.clone(),
            scene: Some(scene.clone()),
            events: Arc::new(EventLog::new(self.config.limits.events)),
            cancel: Arc::default(),
            sequence: spec.sequence,
            spec: Some(spec),
        };
        state.handles.insert(number, handle);
        accept(number);
        state.tell(self, number);
        let job = state.queue.get(number).cloned();
        self.start_what_can(&mut state);
        // Just pushed, and only finished jobs are forgotten.
        job.ok_or(Full::Closed)
    }

    /// Ends all work of a scene that will not come back.
    pub(crate) fn cancel_scene(&self, scene: &SceneEntry) {
        let open = self.jobs.with_queue(|queue| queue.open_of(scene.number));
        for job in open {
            self.jobs.cancel(self, job);
        }
        self.jobs.lock().queue.forget_scene(scene.number);
    }

    /// Cancels a job. A running one stops soon; a queued one is canceled, and what its edit changed is published
    /// where no job that is still open will do so.
    pub(crate) fn cancel_job(&self, number: JobNumber) -> Cancel {
        self.jobs.cancel(self, number)
    }

    /// Publishes geometry that was accepted and that no open job will publish.
    pub(crate) fn settle(&self, scene: &Arc<SceneEntry>, accepted: Sequence) {
        let upto = {
            let state = self.jobs.lock();
            if state.queue.running_on(scene.number).is_some() {
                return;
            }
            let open = state.queue.open_of(scene.number).into_iter().filter_map(|job| state.handles.get(&job));
            open.map(|handle| handle.sequence.saturating_sub(1)).min().unwrap_or(accepted)
        };
        if let Some(published) = scene.show(upto.min(accepted)) {
            self.tell_edited(scene, None, &published);
        }
    }

    /// A running job's progress.
    pub(crate) fn report(&self, number: JobNumber, progress: JobProgress) {
        let mut state = self.jobs.lock();
        state.queue.report(number, progress);
        state.tell(self, number);
    }

    /// A new version with the same elements.
    pub(crate) fn tell_snapshot(
        &self,
        scene: &SceneEntry,
        job: Option<JobNumber>,
        published: &Arc<Published>,
        progress: Option<&Progress>,
    ) {
        let event = types::SnapshotEvent {
            scene: scene.id.clone(),
            job: job.map(|number| self.ids.job(number)),
            version: published.version,
            elements_version: published.elements_version,
            samples_per_element: progress.map(|progress| progress.samples_per_element),
            estimated_rmse: published.estimated_rmse.and_then(types::finite),
        };
        let data = types::to_event_data(&event);
        if let Some(log) = job.and_then(|number| self.jobs.events(number)) {
            log.push("snapshot", data.clone());
        }
        scene.events.push("snapshot", data);
        if let Err(error) = self.store.published(&scene.id, published) {
            tracing::error!(scene = scene.id, %error, "a version was published and could not be kept");
        }
    }

    /// A new version with other elements, objects or lights.
    pub(crate) fn tell_edited(&self, scene: &SceneEntry, job: Option<JobNumber>, published: &Arc<Published>) {
        let event = types::SceneEvent {
            scene: scene.id.clone(),
            what: types::SceneChange::Edited,
            version: published.version,
            elements_version: published.elements_version,
        };
        scene.events.push("scene", types::to_event_data(&event));
        self.tell_snapshot(scene, job, published, None);
    }

    fn finish_job(self: &Arc<App>, number: JobNumber, outcome: Outcome, pool: Arc<ThreadPool>) {
        let mut state = self.jobs.lock();
        state.queue.finish(number, outcome, Timestamp::now());
        state.ended(self, number);
        state.pools.push(pool);
        self.start_what_can(&mut state);
    }

    fn start_what_can(self: &Arc<App>, state: &mut State) {
        while !state.closed
            && let Decision::Start(number) = scheduler::tick(&state.queue, self.jobs.slots)
        {
            let Some(pool) = state.pools.pop() else { break };
            if !state.queue.start(number, Timestamp::now()) {
                state.pools.push(pool);
                break;
            }
            state.tell(self, number);
            let Some(handle) = state.handles.get_mut(&number) else { break };
            let (Some(spec), Some(scene)) = (handle.spec.take(), handle.scene.clone()) else { break };
            let run = worker::Run { job: number, scene, cancel: handle.cancel.clone(), spec };
            worker::spawn(self.clone(), run, &pool);
        }
        self.jobs.running.send_replace(state.queue.running());
    }
}
