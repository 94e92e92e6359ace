//! What of the light is kept, and when.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use crate::compute::Compute;
use crate::jobs::queue::JobNumber;
use crate::metrics::Metrics;
use crate::store::scene::{SceneEntry, SceneState};
use crate::store::scenes::Scenes;
use crate::store::versions::RESERVE;
use crate::store::{Store, StoreError};

/// Keeps light, and tells where that fails.
#[derive(Clone)]
pub(crate) struct Saving {
    pub(crate) store: Arc<dyn Store>,
    pub(crate) compute: Compute,
    pub(crate) metrics: Arc<Metrics>,
}

impl Saving {
    /// Whether the scene may get one more version. Versions are reserved long before they are needed; where the disk
    /// fails for so long that none is left, the light map stays at its last version.
    pub(crate) fn may_publish(&self, scene: &SceneEntry) -> bool {
        let (version, reserved) = (scene.published().version, scene.reserved.load(Ordering::Relaxed));
        if !self.store.is_durable() || reserved - version > RESERVE / 10 {
            return true;
        }
        match self.store.versions_reserved(scene.number, version + RESERVE) {
            Ok(()) => {
                scene.reserved.store(version + RESERVE, Ordering::Relaxed);
                true
            }
            Err(error) => {
                self.note_unsaved(scene, &error);
                version < reserved
            }
        }
    }

    /// Saves the light of a scene in the background, unless that is under way already.
    pub(crate) fn save_soon(&self, scene: &Arc<SceneEntry>) {
        if !self.store.is_durable() || scene.saving.swap(true, Ordering::AcqRel) {
            return;
        }
        let (saving, scene) = (self.clone(), scene.clone());
        self.compute.spawn(move || {
            let result = saving.store.light_saved(scene.number, &scene.light_record());
            scene.saving.store(false, Ordering::Release);
            match result {
                Ok(()) => scene.set_error(None),
                Err(error) => saving.note_unsaved(&scene, &error),
            }
        });
    }

    /// Saves all light at the end of the service, so that every version that was given can be resumed, and closes what
    /// is kept.
    pub(crate) fn save_all(&self, scenes: &Scenes) {
        if !self.store.is_durable() {
            return;
        }
        for scene in scenes.all().iter().filter(|scene| scene.state() == SceneState::Ready) {
            let light = scene.light_record();
            let version = light.about.version;
            let saved = self.store.light_saved(scene.number, &light);
            if let Err(error) = saved.and_then(|()| self.store.versions_reserved(scene.number, version)) {
                self.note_unsaved(scene, &error);
            }
        }
        self.store.close();
    }

    /// Jobs that are remembered no more.
    pub(crate) fn forget_jobs(&self, jobs: &[JobNumber]) {
        if jobs.is_empty() || !self.store.is_durable() {
            return;
        }
        if let Err(error) = self.store.jobs_forgotten(jobs) {
            // The next start forgets them.
            tracing::debug!(%error, "old jobs stay on the disk");
        }
    }

    /// Light of a scene could not be kept: it tells so until that works again.
    pub(crate) fn note_unsaved(&self, scene: &SceneEntry, error: &StoreError) {
        tracing::error!(scene = scene.id, %error, "the light could not be saved");
        self.metrics.unsaved.inc();
        scene.set_error(Some(format!("the light map could not be saved: {}", error.reason)));
    }
}
