//! Which job comes next: pure decisions on the state of the queue.

use std::cmp::Reverse;
use std::collections::HashMap;

use super::queue::{Job, JobNumber, Priority, Queue, SceneNumber};

/// What to do next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// Start this job.
    Start(JobNumber),
    /// Nothing can start until a job arrives or ends.
    Wait,
}

/// Starts of others after which a scene that waits counts as one priority higher: nothing waits for ever.
const AGEING_TURNS: u64 = 8;

/// Decides on one step. To be asked again until it says [`Decision::Wait`].
///
/// One job per scene at a time, in order of arrival. Between scenes the highest priority goes first; among equals the
/// one whose last start is longest ago, so that a scene with a long queue takes one turn like every other.
pub fn tick(queue: &Queue, slots: usize) -> Decision {
    if queue.running() >= slots {
        return Decision::Wait;
    }
    // The first in line of each scene, with the highest priority of all that wait behind it.
    let mut first_of: HashMap<SceneNumber, (&Job, Priority)> = HashMap::new();
    for job in queue.iter().filter(|job| job.is_in_line() && queue.running_on(job.scene).is_none()) {
        let (_, priority) = first_of.entry(job.scene).or_insert((job, job.priority));
        *priority = (*priority).max(job.priority);
    }
    first_of
        .into_values()
        .min_by_key(|(job, priority)| {
            let last_turn = queue.last_turn(job.scene);
            let waited = queue.turn() - last_turn.max(job.arrived_turn);
            (Reverse(*priority as u64 + waited / AGEING_TURNS), last_turn, job.number)
        })
        .map_or(Decision::Wait, |(job, _)| Decision::Start(job.number))
}
