//! What clients are told of jobs and of the versions that they publish.

use std::sync::Arc;

use super::Jobs;
use super::queue::{JobNumber, JobProgress};
use crate::api::types;
use crate::engine::Progress;
use crate::store::lighting::Sequence;
use crate::store::scene::SceneEntry;
use crate::store::versions::Published;

impl Jobs {
    /// Publishes geometry that was accepted and that no open job will publish.
    pub(crate) fn show_accepted(&self, scene: &Arc<SceneEntry>, accepted: Sequence) {
        let upto = {
            let state = self.lock();
            if state.queue.running_on(scene.number).is_some() {
                return;
            }
            let open = state.queue.open_of(scene.number).into_iter().filter_map(|job| state.handles.get(&job));
            open.map(|handle| handle.spec.sequence.saturating_sub(1)).min().unwrap_or(accepted)
        };
        if self.saving.may_publish(scene)
            && let Some(published) = scene.show(upto.min(accepted))
        {
            self.tell_edited(scene, None, &published);
        }
    }

    /// A running job's progress.
    pub(crate) fn report(&self, number: JobNumber, progress: JobProgress) {
        let mut state = self.lock();
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
            estimated_rmse: published.stated_rmse().and_then(types::finite),
            light_error: published.stated().into(),
        };
        self.metrics.published(published);
        let data = types::to_event_data(&event);
        if let Some(log) = job.and_then(|number| self.events(number)) {
            log.push("snapshot", data.clone());
        }
        scene.events.push("snapshot", data);
    }

    /// A new version with other elements, objects or lights.
    pub(crate) fn tell_edited(&self, scene: &SceneEntry, job: Option<JobNumber>, published: &Published) {
        tell_scene(scene, types::SceneChange::Edited, published);
        self.tell_snapshot(scene, job, published, None);
    }
}

/// What became of a scene.
pub(crate) fn tell_scene(scene: &SceneEntry, what: types::SceneChange, published: &Published) {
    let event = types::SceneEvent {
        scene: scene.id.clone(),
        what,
        version: published.version,
        elements_version: published.elements_version,
    };
    scene.events.push("scene", types::to_event_data(&event));
}
