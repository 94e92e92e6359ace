//! Which job comes next: pure decisions on the state of the queue.

use super::queue::{JobNumber, JobState, Queue};

/// What to do next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// Start this job.
    Start(JobNumber),
    /// Nothing can start until a job arrives or ends.
    Wait,
}

/// Decides on one step. To be asked again until it says [`Decision::Wait`].
///
/// One job per scene at a time, in order of arrival. Between scenes the one whose last start is longest ago goes
/// first, so that a scene with a long queue takes one turn like every other.
pub fn tick(queue: &Queue, slots: usize) -> Decision {
    if queue.running() >= slots {
        return Decision::Wait;
    }
    let mut seen = std::collections::HashSet::new();
    queue
        .iter()
        .filter(|job| job.state == JobState::Queued && seen.insert(job.scene))
        .filter(|job| queue.running_on(job.scene).is_none())
        .min_by_key(|job| (queue.last_turn(job.scene), job.number))
        .map_or(Decision::Wait, |job| Decision::Start(job.number))
}
