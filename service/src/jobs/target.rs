//! What a scene works towards: a target of its own, which jobs pursue whenever no edit waits.

use std::sync::Arc;

use super::budget::JobBudget;
use super::queue::{JobKind, Priority, Queue};
use super::seeds::next_seed;
use super::stop::Asked;
use super::{JobSpec, Jobs, new_record};
use crate::store::accepted::Head;
use crate::store::records::Accepted;
use crate::store::scene::SceneEntry;

/// Seeds of jobs that no request asked for lie here, those of requests far below.
const FIRST_SEED: u64 = 1 << 49;

impl Jobs {
    /// Gives a scene another target. Jobs that work towards the old one go on towards the new one, and where none does, one
    /// begins if there is anything to do.
    pub(crate) fn set_target(self: &Arc<Jobs>, scene: &Arc<SceneEntry>, head: &Head, target: JobBudget) {
        scene.set_target(target);
        {
            let mut state = self.lock();
            for number in state.queue.open_of(scene.number) {
                let Some(job) = state.queue.get(number).filter(|job| job.kind.is_for_target()).cloned() else {
                    continue;
                };
                let Some(handle) = state.handles.get_mut(&number) else { continue };
                handle.spec.budget = target;
                handle.about.target_rmse = target.target_rmse;
                if job.is_running() {
                    handle.stop.ask(Asked::NewerEdit);
                }
                if let Some(Err(error)) = state.record(job).map(|record| self.store.job_changed(&record)) {
                    self.saving.note_unsaved(scene, &error);
                }
            }
        }
        self.work_towards_target(scene, head, true);
    }

    /// Queues a job that brings a scene's light closer to its target, where it is not there yet and none is open that will.
    /// `head`: the scene's, so that no edit is accepted meanwhile. `takes_up`: edits whose jobs were canceled are lit with it.
    pub(crate) fn work_towards_target(self: &Arc<Jobs>, scene: &Arc<SceneEntry>, head: &Head, takes_up: bool) {
        let is_canceled = takes_up && scene.unlit() > 0;
        let is_wanted = |target: &JobBudget| !scene.is_deleted() && (is_canceled || scene.is_behind(target));
        let Some(target) = scene.target().filter(is_wanted) else { return };
        // An open job lights all edits up to its own, and what it leaves asks again at its end.
        let is_open = |queue: &Queue| is_canceled && !queue.open_of(scene.number).is_empty();
        if self.with_queue(|queue| queue.has_target_work(scene.number) || is_open(queue)) {
            return;
        }
        // A full queue has enough to do: the next edit asks again.
        let Ok(ticket) = self.ticket(scene.number) else { return };
        let seed = next_seed(self.config.seed, &mut (FIRST_SEED | head.sequence));
        let spec = JobSpec::new(target, seed, head.sequence);
        let record = new_record(ticket.number, scene, (JobKind::Refine, Priority::Low), spec);
        let accepted = Accepted { scene: scene.number, edit: None, job: &record, key: None, jobs: head.jobs };
        match self.store.accepted(&accepted) {
            Ok(()) => drop(ticket.submit(scene, &record, || ())),
            Err(error) => self.saving.note_unsaved(scene, &error),
        }
    }
}
