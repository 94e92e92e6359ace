//! How jobs come, change and go. What is told to clients is kept first, where anything is.

use std::sync::Arc;

use jiff::Timestamp;
use rayon::ThreadPool;

use super::queue::{Change, Ended, Full, Job, JobNumber, Outcome, RunEnd, SceneNumber};
use super::stop::Asked;
use super::{Jobs, State};
use crate::metrics::{JobEnd, Metrics};
use crate::store::StoreError;
use crate::store::records::JobRecord;
use crate::store::scene::{SceneEntry, SceneState};

/// A promised place in the queue, given back where nothing comes of it.
pub(crate) struct Ticket {
    jobs: Arc<Jobs>,
    scene: SceneNumber,
    pub(crate) number: JobNumber,
    is_used: bool,
}

impl Ticket {
    /// Queues the job and starts it if there is room. `accept` runs before it can start.
    pub(crate) fn submit(mut self, scene: &Arc<SceneEntry>, record: &JobRecord, accept: impl FnOnce()) -> Job {
        self.is_used = true;
        let jobs = self.jobs.clone();
        let mut state = jobs.lock();
        state.handle(&jobs, scene.id.clone(), Some(scene.clone()), record);
        if scene.state() == SceneState::Preparing {
            state.queue.scene_preparing(scene.number);
        }
        state.queue.push(record.job.clone());
        accept();
        state.supersede(scene.number);
        state.tell(&jobs, self.number);
        let job = record.job.clone();
        jobs.start_what_can(&mut state);
        job
    }
}

impl Drop for Ticket {
    fn drop(&mut self) {
        if !self.is_used {
            self.jobs.lock().queue.give_back(self.scene);
        }
    }
}

impl Jobs {
    /// A place in the queue, with its number.
    pub(crate) fn ticket(self: &Arc<Jobs>, scene: SceneNumber) -> Result<Ticket, Full> {
        let mut state = self.lock();
        if state.closed {
            return Err(Full::Closed);
        }
        let number = state.queue.promise(scene)?;
        Ok(Ticket { jobs: self.clone(), scene, number, is_used: false })
    }

    /// Takes in a job of an earlier life.
    pub(crate) fn restore(&self, scene: Option<Arc<SceneEntry>>, record: &JobRecord) {
        let mut state = self.lock();
        let number = record.job.number;
        state.handle(self, self.ids.scene(record.job.scene), scene, record);
        state.queue.restore(record.job.clone());
        state.tell(self, number);
        if record.job.has_ended()
            && let Some(handle) = state.handles.get(&number)
        {
            handle.events.close();
        }
        for old in state.queue.take_forgotten() {
            state.handles.remove(&old);
        }
    }

    /// Numbers up to this one were given in earlier lives.
    pub(crate) fn begin_after(&self, newest: JobNumber) {
        self.lock().queue.begin_after(newest);
    }

    /// Lets jobs start.
    pub(crate) fn start(self: &Arc<Jobs>) {
        self.start_what_can(&mut self.lock());
    }

    /// Starts nothing any more and stops what runs. Where jobs are kept they go on in the next life of the service,
    /// else they are canceled.
    pub(crate) fn close(&self) {
        let mut state = self.lock();
        state.closed = true;
        state.idle.iter().for_each(|refining| refining.ask(Asked::Interrupt));
        let open: Vec<JobNumber> = state.queue.iter().filter(|job| !job.has_ended()).map(|job| job.number).collect();
        for number in open {
            if !self.store.is_durable() {
                self.cancel_now(&mut state, number, Timestamp::now());
            } else if let Some(handle) = state.handles.get(&number) {
                handle.stop.ask(Asked::Interrupt);
            }
        }
    }

    /// Ends all work of a scene that will not come back.
    pub(crate) fn cancel_scene(&self, scene: &SceneEntry) {
        let mut state = self.lock();
        for job in state.queue.open_of(scene.number) {
            self.cancel_now(&mut state, job, Timestamp::now());
        }
        state.queue.forget_scene(scene.number);
    }

    /// A scene is prepared: what waited for it is in line.
    pub(crate) fn scene_prepared(self: &Arc<Jobs>, scene: SceneNumber) {
        let mut state = self.lock();
        state.queue.scene_prepared(scene);
        self.start_what_can(&mut state);
    }

    /// A scene cannot be built: nobody can do what waits for it.
    pub(crate) fn scene_failed(&self, scene: &SceneEntry, error: &str) {
        let mut state = self.lock();
        for number in state.queue.open_of(scene.number) {
            let now = Timestamp::now();
            let kept = self.keep_change(&state, number, |job| job.end(Outcome::Failed(error.to_owned()), now));
            kept.unwrap_or_else(|error| self.saving.note_unsaved(scene, &error));
            if state.queue.fail(number, error, now) {
                state.ended(self, number);
            }
        }
        state.queue.forget_scene(scene.number);
    }

    /// Cancels a job. A running one stops soon; a queued one is canceled, and what its edit changed is published
    /// where no job that is still open will do so.
    pub(crate) fn cancel(&self, number: JobNumber) -> Result<Change, StoreError> {
        let mut state = self.lock();
        let now = Timestamp::now();
        self.keep_change(&state, number, |job| _ = job.cancel(now))?;
        Ok(self.cancel_now(&mut state, number, now))
    }

    /// Pauses a job: one that runs makes room soon.
    pub(crate) fn pause(&self, number: JobNumber) -> Result<Change, StoreError> {
        let mut state = self.lock();
        self.keep_change(&state, number, |job| _ = job.pause())?;
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
    pub(crate) fn resume(self: &Arc<Jobs>, number: JobNumber) -> Result<Change, StoreError> {
        let mut state = self.lock();
        self.keep_change(&state, number, |job| _ = job.resume(0))?;
        let change = state.queue.resume(number);
        state.tell(self, number);
        self.start_what_can(&mut state);
        Ok(change)
    }

    /// Keeps a change before it is made. Rare and small: under the queue's lock, so that nothing comes in between.
    fn keep_change(&self, state: &State, number: JobNumber, change: impl FnOnce(&mut Job)) -> Result<(), StoreError> {
        let Some(mut job) = state.queue.get(number).filter(|job| !job.has_ended()).cloned() else {
            return Ok(());
        };
        change(&mut job);
        state.record(job).map_or(Ok(()), |record| self.store.job_changed(&record))
    }

    fn cancel_now(&self, state: &mut State, number: JobNumber, now: Timestamp) -> Change {
        let change = state.queue.cancel(number, now);
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

    /// Takes over the end of a job's run, once that and its light are kept.
    pub(super) fn finish(self: &Arc<Jobs>, number: JobNumber, scene: &SceneEntry, end: &RunEnd, pool: Arc<ThreadPool>) {
        let now = Timestamp::now();
        let kept = match self.store.is_durable() {
            true => self.keep_end(number, scene, end, now),
            false => Vec::new(),
        };
        let mut state = self.lock();
        let changed = state.queue.finish(number, end, now);
        // One that was merged and canceled while its end was being kept ended as its client was told; one that made way
        // and was canceled just then has ended.
        let canceled = changed.iter().filter(|job| {
            let has_ended = state.queue.get(**job).is_some_and(Job::has_ended);
            *end == RunEnd::Interrupted && has_ended && !kept.contains(job)
        });
        for job in kept.iter().filter(|job| !changed.contains(job)).chain(canceled) {
            let record = state.queue.get(*job).cloned().and_then(|job| state.record(job));
            if let Some(Err(error)) = record.map(|record| self.store.job_changed(&record)) {
                self.saving.note_unsaved(scene, &error);
            }
        }
        for number in changed {
            let Some(job) = state.queue.get(number) else { continue };
            count_end(&self.metrics, job);
            match job.has_ended() {
                true => state.ended(self, number),
                false => state.tell(self, number),
            }
        }
        state.pools.push(pool);
        self.start_what_can(&mut state);
    }

    /// Keeps the end of a job and of those merged into it, with the light; answers which have ended.
    fn keep_end(&self, number: JobNumber, scene: &SceneEntry, end: &RunEnd, now: Timestamp) -> Vec<JobNumber> {
        let records: Vec<JobRecord> = {
            let state = self.lock();
            let ended = state.queue.preview_finish(number, end, now);
            ended.into_iter().filter_map(|job| state.record(job)).collect()
        };
        if records.is_empty() {
            return Vec::new();
        }
        // The light goes with the first: after a restart no job has ended whose light is not there.
        let mut light = (!scene.is_deleted()).then(|| scene.light_record());
        for record in &records {
            if let Err(error) = self.store.job_ended(record, light.take().as_ref()) {
                // Nothing is lost: after a restart the job runs once more.
                self.saving.note_unsaved(scene, &error);
                return Vec::new();
            }
        }
        scene.set_error(None);
        records.into_iter().map(|record| record.job.number).collect()
    }
}

fn count_end(metrics: &Metrics, job: &Job) {
    // Jobs that did not run themselves have no duration.
    let Some(Ended { started_at: Some(started_at), finished_at, .. }) = job.ended() else { return };
    metrics.job_ended(&JobEnd {
        kind: job.kind,
        state: job.state(),
        wait_seconds: started_at.duration_since(job.created_at).as_secs_f64(),
        seconds: finished_at.duration_since(*started_at).as_secs_f64(),
    });
}
