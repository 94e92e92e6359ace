//! Which job comes next, and what idle time is for: pure decisions on the state of the queue.

use std::cmp::Reverse;
use std::collections::HashMap;

use super::queue::{Job, JobKind, JobNumber, Priority, Queue, SceneNumber, Standing};

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
/// One job per scene at a time: edits in order of arrival, then what works towards the target. Between scenes the highest priority goes first; among equals the
/// one whose last start is longest ago, so that a scene with a long queue takes one turn like every other. Where all slots are taken, one edit
/// of high priority runs beside them.
pub fn tick(queue: &Queue, slots: usize) -> Decision {
    let is_free = |job: &Job, priority: Priority| {
        let beside = job.kind == JobKind::Edit && priority == Priority::High;
        queue.running() < slots + usize::from(beside)
    };
    // The first in line of each scene, with the highest priority of all that wait behind it.
    let mut first_of: HashMap<SceneNumber, (&Job, Priority)> = HashMap::new();
    for job in queue.in_line().filter(|job| queue.running_on(job.scene).is_none()) {
        let (first, priority) = first_of.entry(job.scene).or_insert((job, job.priority));
        if job.place() < first.place() {
            *first = job;
        }
        *priority = (*priority).max(job.priority);
    }
    first_of
        .into_values()
        .filter(|(job, priority)| is_free(job, *priority))
        .min_by_key(|(job, priority)| {
            let last_turn = queue.last_turn(job.scene);
            let waited = queue.turn() - last_turn.max(joined(job));
            (Reverse(*priority as u64 + waited / AGEING_TURNS), last_turn, job.number)
        })
        .map_or(Decision::Wait, |(job, _)| Decision::Start(job.number))
}

/// Starts when a job joined the line; where it does not wait, none.
fn joined(job: &Job) -> u64 {
    match job.standing {
        Standing::Waiting { turn, .. } => turn,
        Standing::Running { .. } | Standing::Paused { .. } | Standing::Ended(_) => 0,
    }
}

/// Running jobs that are to make room for a scene that waits, once they have had their share: they work towards targets, and
/// can go on later from where they are.
pub fn make_room(queue: &Queue) -> Vec<JobNumber> {
    let waiting = queue.in_line().filter(|job| queue.running_on(job.scene).is_none());
    let Some(priority) = waiting.map(|job| job.priority).max() else { return Vec::new() };
    let gives_way = |job: &&Job| job.kind.is_for_target() && job.priority <= priority;
    queue.iter().filter(|job| job.is_running()).filter(gives_way).map(|job| job.number).collect()
}

/// Whether nothing runs and nothing could.
pub fn is_idle(queue: &Queue) -> bool {
    queue.running() == 0 && queue.in_line().next().is_none()
}

/// A scene on which idle time can be spent: its light is up to date.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UpToDate {
    /// Which one.
    pub scene: SceneNumber,
    /// Stated error of its light map.
    pub stated: f64,
    /// Mean light of its light map.
    pub mean: f64,
}

/// A scene to be refined, and to which stated error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spell {
    /// Which one.
    pub scene: SceneNumber,
    /// Where to stop and decide again.
    pub target: f64,
}

/// What idle time is spent on: the scene whose stated error is the largest part of its mean light, until that has
/// halved or is down to `goal`. None where all scenes are that good. A map without light or without a stated error
/// stays as it is.
pub fn idle(scenes: &[UpToDate], goal: f64) -> Option<Spell> {
    let share = |scene: &UpToDate| scene.stated / scene.mean;
    let worst = scenes
        .iter()
        .filter(|scene| scene.stated > 0.0 && scene.mean > 0.0 && share(scene).is_finite() && share(scene) > goal)
        .max_by(|a, b| share(a).total_cmp(&share(b)).then(b.scene.cmp(&a.scene)))?;
    Some(Spell { scene: worst.scene, target: (0.5 * worst.stated).max(goal * worst.mean) })
}
