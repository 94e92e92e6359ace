//! How jobs come, change and go. What is told to clients is kept first, where anything is.

use std::sync::Arc;

use jiff::Timestamp;
use rayon::ThreadPool;

use super::budget::JobBudget;
use super::queue::{Change, Full, Job, JobKind, JobNumber, JobProgress, JobState, Outcome, SceneNumber};
use super::scheduler::{self, Decision};
use super::stop::{Asked, Stop};
use super::{JobSpec, State, merge, worker};
use crate::api::types;
use crate::engine::Progress;
use crate::metrics::{JobEnd, Metrics};
use crate::state::App;
use crate::store::StoreError;
use crate::store::lighting::Sequence;
use crate::store::records::JobRecord;
use crate::store::scene::SceneEntry;
use crate::store::versions::Published;

/// A promised place in the queue, given back where nothing comes of it.
pub(crate) struct Ticket {
    app: Arc<App>,
    scene: SceneNumber,
    pub(crate) number: JobNumber,
    is_used: bool,
}

impl Ticket {
    /// Queues the job and starts it if there is room. `accept` runs before it can start.
    pub(crate) fn submit(mut self, scene: &Arc<SceneEntry>, record: &JobRecord, accept: impl FnOnce()) -> Job {
        self.is_used = true;
        let app = self.app.clone();
        let mut state = app.jobs.lock();
        state.handle(&app, scene.id.clone(), Some(scene.clone()), record);
        state.queue.push(record.job.clone());
        accept();
        state.supersede(scene.number);
        state.tell(&app, self.number);
        let job = record.job.clone();
        app.start_what_can(&mut state);
        job
    }
}

impl Drop for Ticket {
    fn drop(&mut self) {
        if !self.is_used {
            self.app.jobs.lock().queue.give_back(self.scene);
        }
    }
}

impl App {
    /// A place in the queue, with its number.
    pub(crate) fn ticket(self: &Arc<App>, scene: SceneNumber) -> Result<Ticket, Full> {
        let mut state = self.jobs.lock();
        if state.closed {
            return Err(Full::Closed);
        }
        let number = state.queue.promise(scene)?;
        Ok(Ticket { app: self.clone(), scene, number, is_used: false })
    }

    /// Takes in a job of an earlier life.
    pub(crate) fn restore_job(&self, scene: Option<Arc<SceneEntry>>, record: &JobRecord) {
        let mut state = self.jobs.lock();
        let number = record.job.number;
        state.handle(self, self.ids.scene(record.job.scene), scene, record);
        state.queue.restore(record.job.clone());
        state.tell(self, number);
        if record.job.state.has_ended()
            && let Some(handle) = state.handles.get(&number)
        {
            handle.events.close();
        }
        for old in state.queue.take_forgotten() {
            state.handles.remove(&old);
        }
    }

    /// Numbers up to this one were given in earlier lives.
    pub(crate) fn begin_jobs_after(&self, newest: JobNumber) {
        self.jobs.lock().queue.begin_after(newest);
    }

    /// Lets jobs start.
    pub(crate) fn start_jobs(self: &Arc<App>) {
        self.start_what_can(&mut self.jobs.lock());
    }

    /// Starts nothing any more and stops what runs. Where jobs are kept they go on in the next life of the service,
    /// else they are canceled.
    pub(crate) fn close_jobs(&self) {
        let mut state = self.jobs.lock();
        state.closed = true;
        state.idle.iter().for_each(|refining| refining.ask(Asked::Interrupt));
        let open: Vec<JobNumber> =
            state.queue.iter().filter(|job| !job.state.has_ended()).map(|job| job.number).collect();
        for number in open {
            if !self.store.is_durable() {
                self.cancel_now(&mut state, number);
            } else if let Some(handle) = state.handles.get(&number) {
                handle.stop.ask(Asked::Interrupt);
            }
        }
    }

    /// Ends all work of a scene that will not come back.
    pub(crate) fn cancel_scene(&self, scene: &SceneEntry) {
        let mut state = self.jobs.lock();
        for job in state.queue.open_of(scene.number) {
            self.cancel_now(&mut state, job);
        }
        state.queue.forget_scene(scene.number);
    }

    /// A scene is prepared: what waited for it is in line.
    pub(crate) fn start_jobs_of(self: &Arc<App>, scene: SceneNumber) {
        let mut state = self.jobs.lock();
        state.queue.scene_prepared(scene);
        self.start_what_can(&mut state);
    }

    /// A scene cannot be built: nobody can do what waits for it.
    pub(crate) fn fail_jobs_of(&self, scene: &SceneEntry, error: &str) {
        let mut state = self.jobs.lock();
        for number in state.queue.open_of(scene.number) {
            let outcome = Outcome::Failed(error.to_owned());
            let kept = self.keep_change(&state, number, |job| job.end(&outcome, Timestamp::now()));
            kept.unwrap_or_else(|error| self.note_unsaved(scene, &error));
            if state.queue.fail(number, error, Timestamp::now()) {
                state.ended(self, number);
            }
        }
    }

    /// Cancels a job. A running one stops soon; a queued one is canceled, and what its edit changed is published
    /// where no job that is still open will do so.
    pub(crate) fn cancel_job(&self, number: JobNumber) -> Result<Change, StoreError> {
        let mut state = self.jobs.lock();
        self.keep_change(&state, number, |job| match job.state {
            JobState::Running => job.cancel_requested = true,
            _ => job.end(&Outcome::Canceled, Timestamp::now()),
        })?;
        Ok(self.cancel_now(&mut state, number))
    }

    /// Pauses a job: one that runs makes room soon.
    pub(crate) fn pause_job(&self, number: JobNumber) -> Result<Change, StoreError> {
        let mut state = self.jobs.lock();
        self.keep_change(&state, number, |job| job.pause_requested = true)?;
        let change = state.queue.pause(number);
        if change == Change::Requested
            && let Some(handle) = state.handles.get(&number)
        {
            handle.stop.ask(Asked::Interrupt);
        }
        state.tell(self, number);
        Ok(change)
    }

    /// Puts a paused job in line again.
    pub(crate) fn resume_job(self: &Arc<App>, number: JobNumber) -> Result<Change, StoreError> {
        let mut state = self.jobs.lock();
        self.keep_change(&state, number, |job| {
            (job.pause_requested, job.state) = (false, JobState::Queued);
        })?;
        let change = state.queue.resume(number);
        state.tell(self, number);
        self.start_what_can(&mut state);
        Ok(change)
    }

    /// Keeps a change before it is made. Rare and small: under the queue's lock, so that nothing comes in between.
    fn keep_change(&self, state: &State, number: JobNumber, change: impl FnOnce(&mut Job)) -> Result<(), StoreError> {
        let Some(mut job) = state.queue.get(number).filter(|job| !job.state.has_ended()).cloned() else {
            return Ok(());
        };
        change(&mut job);
        state.record(job).map_or(Ok(()), |record| self.store.job_changed(&record))
    }

    fn cancel_now(&self, state: &mut State, number: JobNumber) -> Change {
        let change = state.queue.cancel(number, Timestamp::now());
        match change {
            Change::Done => state.ended(self, number),
            Change::Requested => {
                if let Some(handle) = state.handles.get(&number) {
                    handle.stop.ask(Asked::Cancel);
                }
            }
            Change::Unknown | Change::Ended => {}
        }
        change
    }

    /// Publishes geometry that was accepted and that no open job will publish.
    pub(crate) fn settle(&self, scene: &Arc<SceneEntry>, accepted: Sequence) {
        let upto = {
            let state = self.jobs.lock();
            if state.queue.running_on(scene.number).is_some() {
                return;
            }
            let open = state.queue.open_of(scene.number).into_iter().filter_map(|job| state.handles.get(&job));
            open.map(|handle| handle.spec.sequence.saturating_sub(1)).min().unwrap_or(accepted)
        };
        if self.may_publish(scene)
            && let Some(published) = scene.show(upto.min(accepted))
        {
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
        published: &Published,
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
        self.metrics.published(published);
        let data = types::to_event_data(&event);
        if let Some(log) = job.and_then(|number| self.jobs.events(number)) {
            log.push("snapshot", data.clone());
        }
        scene.events.push("snapshot", data);
    }

    /// A new version with other elements, objects or lights.
    pub(crate) fn tell_edited(&self, scene: &SceneEntry, job: Option<JobNumber>, published: &Published) {
        let event = types::SceneEvent {
            scene: scene.id.clone(),
            what: types::SceneChange::Edited,
            version: published.version,
            elements_version: published.elements_version,
        };
        scene.events.push("scene", types::to_event_data(&event));
        self.tell_snapshot(scene, job, published, None);
    }

    /// Takes over how a job ended, once that and its light are kept.
    pub(super) fn finish_job(
        self: &Arc<App>,
        number: JobNumber,
        scene: &SceneEntry,
        outcome: &Outcome,
        pool: Arc<ThreadPool>,
    ) {
        let now = Timestamp::now();
        let kept = match self.store.is_durable() && *outcome != Outcome::Interrupted {
            true => self.keep_end(number, scene, outcome, now),
            false => Vec::new(),
        };
        let mut state = self.jobs.lock();
        let changed = state.queue.finish(number, outcome, now);
        // One that was merged and canceled while its end was being kept ended as its client was told.
        for job in kept.iter().filter(|job| !changed.contains(job)) {
            let record = state.queue.get(*job).cloned().and_then(|job| state.record(job));
            if let Some(Err(error)) = record.map(|record| self.store.job_changed(&record)) {
                self.note_unsaved(scene, &error);
            }
        }
        for job in changed {
            state.queue.get(job).into_iter().for_each(|ended| count_end(&self.metrics, ended));
            match state.queue.get(job).is_some_and(|job| job.state.has_ended()) {
                true => state.ended(self, job),
                false => state.tell(self, job),
            }
        }
        state.pools.push(pool);
        self.start_what_can(&mut state);
    }

    /// Keeps the end of a job and of those merged into it, with the light; answers which.
    fn keep_end(&self, number: JobNumber, scene: &SceneEntry, outcome: &Outcome, now: Timestamp) -> Vec<JobNumber> {
        let records: Vec<JobRecord> = {
            let state = self.jobs.lock();
            let ended = state.queue.preview_finish(number, outcome, now);
            ended.into_iter().filter_map(|job| state.record(job)).collect()
        };
        // The light goes with the first: after a restart no job has ended whose light is not there.
        let mut light = (!scene.is_deleted()).then(|| scene.light_record());
        for record in &records {
            if let Err(error) = self.store.job_ended(record, light.take().as_ref()) {
                // Nothing is lost: after a restart the job runs once more.
                self.note_unsaved(scene, &error);
                return Vec::new();
            }
        }
        scene.set_error(None);
        records.into_iter().map(|record| record.job.number).collect()
    }

    pub(super) fn start_what_can(self: &Arc<App>, state: &mut State) {
        while !state.closed
            && let Decision::Start(number) = scheduler::tick(&state.queue, self.jobs.slots)
        {
            let Some(pool) = state.pools.pop() else { break };
            let batch = state.batch(number);
            let number = batch.last().copied().unwrap_or(number);
            if !state.queue.start(number, Timestamp::now()) {
                state.pools.push(pool);
                break;
            }
            state.idle.iter().for_each(|refining| refining.ask(Asked::Interrupt));
            state.tell(self, number);
            let budgets: Vec<JobBudget> =
                batch.iter().filter_map(|job| Some(state.handles.get(job)?.spec.budget)).collect();
            for other in batch.into_iter().filter(|other| *other != number) {
                state.queue.merge(other, number);
                state.tell(self, other);
            }
            let Some(handle) = state.handles.get_mut(&number) else { break };
            let Some(scene) = handle.scene.clone() else { break };
            handle.stop = Arc::new(Stop::default());
            let mut spec = handle.spec.clone();
            spec.budget = budgets.into_iter().fold(spec.budget, JobBudget::both);
            let kind = state.queue.get(number).map_or(JobKind::Edit, |job| job.kind);
            let (stop, accepted) = (handle.stop.clone(), handle.accepted);
            let run = worker::Run { job: number, kind, scene: scene.clone(), stop, accepted, spec };
            state.supersede(scene.number);
            worker::spawn(self.clone(), run, &pool);
        }
        for number in scheduler::make_room(&state.queue) {
            state.handles.get(&number).into_iter().for_each(|handle| handle.stop.ask(Asked::MakeRoom));
        }
        self.refine_if_idle(state);
        self.jobs.running.send_replace(state.running());
    }
}

impl State {
    /// Tells the job of a scene where an edit waits behind it, and whether that is the next step of the same drag.
    fn supersede(&self, scene: SceneNumber) {
        let Some(running) = self.queue.running_on(scene) else { return };
        let edits = self.queue.iter().filter(|job| job.scene == scene && job.kind == JobKind::Edit && job.is_in_line());
        let next = edits.min_by_key(|job| job.number).and_then(|job| self.handles.get(&job.number));
        if let Some(next) = next
            && let Some(handle) = self.handles.get(&running)
        {
            let is_next_step = is_next_step(&handle.spec, &next.spec);
            handle.stop.ask(if is_next_step { Asked::NextStep } else { Asked::NewerEdit });
        }
    }

    /// The job with those behind it on its scene that are better lit together with it: the last of them does the work.
    fn batch(&self, first: JobNumber) -> Vec<JobNumber> {
        let mut batch = vec![first];
        let Some((job, handle)) = self.queue.get(first).zip(self.handles.get(&first)) else { return batch };
        let Some(scene) = handle.scene.as_ref().filter(|_| job.kind == JobKind::Edit) else { return batch };
        let unlit = scene.unlit_edits();
        let upto = |after: Sequence, last: Sequence| {
            let due = unlit.iter().filter(move |(sequence, _)| (after + 1..=last).contains(sequence));
            due.flat_map(|(_, edits)| edits.iter().cloned()).collect::<Vec<_>>()
        };
        let mut last = handle.spec.sequence;
        let mut edits = merge::simplify(upto(0, last));
        // Where there is no light to go on from, one bake lights them all.
        let bakes = scene.needs_bake();
        let behind = self.queue.iter().filter(|other| other.scene == job.scene && other.number > first);
        for other in behind.filter(|other| other.is_in_line() && other.kind == JobKind::Edit) {
            let Some(handle) = self.handles.get(&other.number) else { break };
            let next = upto(last, handle.spec.sequence);
            let apart = edits.len() + merge::count(&next);
            let together = merge::simplify(edits.iter().cloned().chain(next));
            if together.len() >= apart && !bakes {
                break;
            }
            (edits, last) = (together, handle.spec.sequence);
            batch.push(other.number);
        }
        batch
    }
}

/// Whether all that is dragged goes on being dragged.
fn is_next_step(running: &JobSpec, next: &JobSpec) -> bool {
    !running.dragged.is_empty() && running.dragged.iter().all(|light| next.dragged.contains(light))
}

fn count_end(metrics: &Metrics, job: &Job) {
    // Jobs that did not run themselves have no duration.
    let (Some(started_at), Some(finished_at)) = (job.started_at, job.finished_at) else { return };
    metrics.job_ended(&JobEnd {
        kind: job.kind,
        state: job.state,
        wait_seconds: started_at.duration_since(job.created_at).as_secs_f64(),
        seconds: finished_at.duration_since(started_at).as_secs_f64(),
    });
}
