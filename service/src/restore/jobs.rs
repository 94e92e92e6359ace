//! Jobs of an earlier life put back in line.

use std::sync::Arc;

use jiff::Timestamp;

use crate::jobs::budget::JobBudget;
use crate::jobs::queue::{JobKind, Outcome, Priority};
use crate::jobs::{JobSpec, new_record};
use crate::state::App;
use crate::store::records::JobRecord;
use crate::store::scene::SceneEntry;

/// Puts a job back in line. One that was asked to stop, or whose scene is damaged, ends.
pub(super) fn restore_job(app: &App, mut record: JobRecord) {
    let scene = app.scenes.get(record.job.scene);
    let job = &mut record.job;
    let outcome = match &scene {
        _ if job.has_ended() => None,
        None => Some(Outcome::Canceled),
        Some(scene) if scene.is_damaged() => Some(Outcome::Failed("the scene is damaged".to_owned())),
        Some(_) => job.requests().cancel.then_some(Outcome::Canceled),
    };
    if let Some(outcome) = outcome {
        job.end(outcome, Timestamp::now());
        if let Err(error) = app.store.job_changed(&record) {
            tracing::warn!(%error, "the end of a job could not be saved");
        }
    }
    app.jobs.restore(scene, &record);
}

/// Queues a bake of a scene whose light is lost, unless a job waits that will do it.
pub(super) fn bake_again(app: &Arc<App>, scene: &Arc<SceneEntry>) {
    if app.jobs.with_queue(|queue| queue.current(scene.number)).is_some() {
        return;
    }
    let mut head = scene.head.blocking_lock();
    let samples_per_element = app.config.defaults.bake_samples;
    let default = JobBudget { samples_per_element, max_seconds: None, target_rmse: None, by_error: false };
    let budget = scene.target().unwrap_or(default);
    let mut jobs = head.jobs;
    let seed = crate::jobs::seeds::next_seed(app.config.seed, &mut jobs);
    let sequence = head.sequence;
    let spec = JobSpec::new(budget, seed, sequence);
    let Ok(ticket) = app.jobs.ticket(scene.number) else { return };
    let record = new_record(ticket.number, scene, (JobKind::Bake, Priority::Normal), spec);
    let accepted = crate::store::records::Accepted { scene: scene.number, edit: None, job: &record, key: None, jobs };
    match app.store.accepted(&accepted) {
        Ok(()) => {
            head.jobs = jobs;
            ticket.submit(scene, &record, || ());
        }
        Err(error) => tracing::error!(scene = scene.id, %error, "no bake could be queued"),
    }
}
