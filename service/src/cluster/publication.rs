//! Versions of scenes, put where replicas find them: `scenes/ID.json` tells of the newest one by hashes of files, and a
//! message tells that it is there. A replica that has missed messages has missed nothing.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::coordinator::Coordinator;
use super::snapshot::{self, Told};
use super::{ClusterError, FORMAT};
use crate::compute::Compute;
use crate::ids::Ids;
use crate::jobs::budget::JobBudget;
use crate::jobs::queue::SceneNumber;
use crate::mode::Mode;
use crate::store::Store;
use crate::store::disk::codec;
use crate::store::lighting::Sequence;
use crate::store::records::LightState;
use crate::store::scene::{SceneEntry, SceneState};
use crate::store::scenes::Scenes;

/// Between two versions of a scene that are put, and before what failed is tried again.
const PACE: Duration = Duration::from_millis(50);
const RETRY: Duration = Duration::from_secs(1);

/// The service that replicas follow.
pub(super) const SERVICE: &str = "service.json";

/// Folder of what is told of scenes.
pub(super) const SCENES: &str = "scenes";

/// Subject of a scene's versions; its id comes behind the dot.
pub(super) const SCENE_SUBJECT: &str = "rebake.scenes";

/// Whom replicas follow.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Service {
    pub(super) format: u32,
    /// How ids end.
    pub(super) suffix: String,
    /// Ids of events rise from the one after it.
    pub(super) first_event: u64,
}

/// A version of a scene.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct SharedScene {
    pub(super) number: SceneNumber,
    pub(super) name: String,
    pub(super) mode: Mode,
    pub(super) target: Option<JobBudget>,
    pub(super) created_at: Timestamp,
    /// Hash of the manifest of what is published.
    pub(super) snapshot: String,
    /// Edits that were accepted.
    pub(super) accepted: Sequence,
    pub(super) light: LightState,
    /// Hashes of the light map, and of the versions that last changed its values.
    pub(super) map: String,
    pub(super) changed: String,
    /// Hash of which elements nothing is known of, a byte each; none where all are known.
    pub(super) unknown: Option<String>,
}

impl SharedScene {
    /// Its files in [`light_folder`].
    fn into_files(self) -> Vec<String> {
        [self.map, self.changed].into_iter().chain(self.unknown).collect()
    }
}

/// Where what is told of a scene lies.
pub(super) fn scene_path(id: &str) -> String {
    format!("{SCENES}/{id}.json")
}

/// Folder of the light of a scene: its own, since scenes of the same light would share files by their hashes.
pub(super) fn light_folder(id: &str) -> String {
    format!("light/{id}")
}

/// Puts versions of scenes.
struct Publisher {
    coordinator: Arc<Coordinator>,
    store: Arc<dyn Store>,
    compute: Compute,
}

/// Puts all versions of all scenes from when they are `restored` on.
pub(crate) async fn publish(
    coordinator: Arc<Coordinator>,
    ids: Ids,
    (scenes, store): (Arc<Scenes>, Arc<dyn Store>),
    compute: Compute,
    restored: impl Future<Output = ()>,
) {
    let service = Service { format: FORMAT, suffix: ids.suffix().to_owned(), first_event: ids.first_event };
    let publisher = Arc::new(Publisher { coordinator, store, compute });
    restored.await;
    while let Err(error) = publisher.begin(&service, &scenes).await {
        tracing::warn!(%error, "nothing is told to replicas");
        tokio::time::sleep(RETRY).await;
    }
    let (mut newest, mut followed) = (scenes.watch_newest(), SceneNumber::MIN);
    loop {
        let first = followed;
        for scene in scenes.all().into_iter().filter(|scene| scene.number >= first) {
            followed = scene.number + 1;
            tokio::spawn(publisher.clone().follow(scene));
        }
        if newest.changed().await.is_err() {
            return;
        }
    }
}

impl Publisher {
    /// Scenes that an earlier life has told of, and that are no more, are over.
    async fn begin(&self, service: &Service, scenes: &Scenes) -> Result<(), ClusterError> {
        let objects = self.coordinator.objects();
        let bytes = serde_json::to_vec(service).map_err(|error| ClusterError::odd("a service", error))?;
        objects.put(SERVICE, bytes.into()).await?;
        let there: HashSet<String> = scenes.all().iter().map(|scene| scene.id.clone()).collect();
        for name in objects.names(SCENES).await? {
            let Some(id) = name.strip_suffix(".json").filter(|id| !there.contains(*id)) else { continue };
            self.end(id).await?;
        }
        Ok(())
    }

    /// A scene is no more.
    async fn end(&self, id: &str) -> Result<(), ClusterError> {
        let objects = self.coordinator.objects();
        objects.remove(&scene_path(id)).await?;
        self.tell(id).await;
        objects.remove_all(&light_folder(id)).await
    }

    /// Puts the versions of a scene until it is deleted.
    async fn follow(self: Arc<Publisher>, scene: Arc<SceneEntry>) {
        let (mut published, mut deleted) = (scene.watch_published(), scene.watch_deleted());
        let mut last = Vec::new();
        while !*deleted.borrow_and_update() {
            published.borrow_and_update();
            if scene.state() == SceneState::Ready
                && let Err(error) = self.put(&scene, &mut last).await
            {
                tracing::warn!(scene = scene.id, %error, "a version is not told to replicas");
                tokio::time::sleep(RETRY).await;
                published.mark_changed();
            }
            tokio::time::sleep(PACE).await;
            tokio::select! {
                _ = published.changed() => {}
                _ = deleted.changed() => {}
            }
        }
        if let Err(error) = self.end(&scene.id).await {
            tracing::warn!(scene = scene.id, %error, "a scene stays with replicas");
        }
    }

    /// Puts the present version. Files of the `last` one stay for replicas that are reading them; older ones go.
    async fn put(&self, scene: &Arc<SceneEntry>, last: &mut Vec<String>) -> Result<(), ClusterError> {
        let (objects, folder) = (self.coordinator.objects(), light_folder(&scene.id));
        let (its_scene, store, known) = (scene.clone(), self.store.clone(), self.coordinator.told_of(scene.number));
        let read = move || {
            let (light, published) = its_scene.shared_light();
            let told = Told { scene: its_scene.number, sequence: light.about.shown, world: &published.world };
            let snapshot = match known.filter(|(sequence, _)| *sequence == told.sequence) {
                Some((_, hash)) => (Some(hash), None),
                None => (None, Some(snapshot::gather(&*store, &told)?)),
            };
            let unknown = published.unknown().as_ref().map(|unknown| unknown.iter().map(|u| u8::from(*u)).collect());
            let changed = codec::encode_versions(&light.changed)?;
            let files = (codec::encode_map(&light.map), changed, unknown);
            Ok::<_, crate::store::StoreError>((snapshot, light.about, files))
        };
        let read = self.compute.build(read).await.map_err(|panic| ClusterError::Failed(panic.to_string()))?;
        let ((hash, gathered), about, (map, changed, unknown)) =
            read.map_err(|error| ClusterError::Failed(error.to_string()))?;
        let snapshot = match (hash, gathered) {
            (Some(hash), _) => hash,
            (None, Some(gathered)) => gathered.put(objects).await?,
            (None, None) => return Ok(()),
        };
        self.coordinator.note_told(scene.number, about.shown, &snapshot);
        let unknown: Option<Vec<u8>> = unknown;
        let shared = SharedScene {
            number: scene.number,
            name: scene.name(),
            mode: scene.mode,
            target: scene.target(),
            created_at: scene.created_at,
            snapshot,
            accepted: scene.accepted().sequence,
            light: about,
            map: objects.put_into(&folder, map.into()).await?,
            changed: objects.put_into(&folder, changed.into()).await?,
            unknown: match unknown {
                Some(unknown) => Some(objects.put_into(&folder, unknown.into()).await?),
                None => None,
            },
        };
        let bytes = serde_json::to_vec(&shared).map_err(|error| ClusterError::odd("a scene", error))?;
        objects.put(&scene_path(&scene.id), bytes.into()).await?;
        self.tell(&scene.id).await;
        let present = shared.into_files();
        for file in objects.names(&folder).await? {
            if !present.contains(&file) && !last.contains(&file) {
                objects.remove(&format!("{folder}/{file}")).await?;
            }
        }
        *last = present;
        Ok(())
    }

    /// A replica that does not hear it looks by itself.
    async fn tell(&self, id: &str) {
        if let Err(error) = self.coordinator.tell(format!("{SCENE_SUBJECT}.{id}"), "").await {
            tracing::debug!(%error, "a version is not told");
        }
    }
}
