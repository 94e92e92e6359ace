//! Which job starts, with which others in one, and what makes room for it.

use std::sync::Arc;

use jiff::Timestamp;

use super::budget::JobBudget;
use super::queue::{JobKind, JobNumber, SceneNumber};
use super::scheduler::{self, Decision};
use super::stop::{Asked, Stop};
use super::{JobSpec, Jobs, State, merge, worker};
use crate::store::lighting::Sequence;

impl Jobs {
    /// Starts whatever the scheduler finds room for, and asks what is to make room.
    pub(super) fn start_what_can(self: &Arc<Jobs>, state: &mut State) {
        while !state.closed
            && let Decision::Start(number) = scheduler::tick(&state.queue, self.slots)
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
        self.running.send_replace(state.running());
    }
}

impl State {
    /// Tells the job of a scene where an edit waits behind it, and whether that is the next step of the same drag.
    pub(super) fn supersede(&self, scene: SceneNumber) {
        let Some(running) = self.queue.running_on(scene) else { return };
        let edits = self.queue.in_line().filter(|job| job.scene == scene && job.kind == JobKind::Edit);
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
        let behind = self.queue.in_line().filter(|other| other.scene == job.scene && other.number > first);
        for other in behind.filter(|other| other.kind == JobKind::Edit) {
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
    !running.dragged.is_empty() && running.dragged.iter().all(|thing| next.dragged.contains(thing))
}
