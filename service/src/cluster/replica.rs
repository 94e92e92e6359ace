//! `rebake replica`: a service that holds what another one publishes, and serves reads of it. It meets the other one
//! nowhere but in the objects and the queue, so that followers by the thousand need not.

use std::collections::{HashMap, HashSet};
use std::io;
use std::sync::Arc;
use std::time::Duration;

use async_nats::Client;
use bytes::Bytes;
use futures_util::StreamExt;
use tokio::net::TcpListener;

use super::objects::Objects;
use super::publication::{SCENE_SUBJECT, SCENES, SERVICE, Service, SharedScene, light_folder, scene_path};
use super::snapshot::Fetched;
use super::{ClusterError, FORMAT, connect, snapshot};
use crate::api::types::SceneChange;
use crate::config::Config;
use crate::engine::{World, limited};
use crate::ids::Ids;
use crate::jobs::tell_scene;
use crate::server;
use crate::state::App;
use crate::store::accepted::Head;
use crate::store::disk::codec;
use crate::store::history::History;
use crate::store::keys::IdempotencyKeys;
use crate::store::lighting::Lighting;
use crate::store::records::{EarlierLight, LightRecord};
use crate::store::scene::{NewScene, SceneEntry, SceneState};
use crate::store::versions::Published;

/// A replica looks by itself so often: messages may be lost.
const GLANCE: Duration = Duration::from_secs(3);

/// Serves reads of what the service behind `config.cluster` publishes, until `shutdown` is ready.
///
/// # Errors
/// Where the addresses are none, the service cannot be started, or the service that it follows is another one by now:
/// start it again then.
pub async fn replicate(
    listener: TcpListener,
    mut config: Config,
    shutdown: impl Future<Output = ()>,
) -> io::Result<()> {
    let cluster = config.cluster.take().ok_or_else(|| io::Error::other("a replica needs a queue and objects"))?;
    let objects = Objects::open(&cluster.objects).map_err(io::Error::other)?;
    let client = connect(&cluster.queue, "rebake replica").await.map_err(io::Error::other)?;
    let mut shutdown = std::pin::pin!(shutdown);
    let service = tokio::select! {
        service = find_service(&objects) => service,
        () = &mut shutdown => return Ok(()),
    };
    config.is_replica = true;
    config.data_dir = None;
    config.host_names.push(listener.local_addr()?.ip().to_string());
    let ids = Ids::of_service(service.suffix.clone(), service.first_event);
    let app = tokio::task::spawn_blocking(move || App::in_memory(config, ids)).await.map_err(io::Error::other)?;
    let app = app.map_err(io::Error::other)?;
    let replica = Replica { app: app.clone(), objects, service, client };
    let (end, ended) = tokio::sync::oneshot::channel();
    let following = tokio::spawn(async move {
        let error = replica.follow().await;
        // The server has ended already otherwise.
        let _ = end.send(error);
    });
    let mut told = None;
    let until = async {
        tokio::select! {
            () = &mut shutdown => {}
            error = ended => told = error.ok(),
        }
    };
    server::serve(listener, &app, until).await;
    following.abort();
    told.map_or(Ok(()), |error| Err(io::Error::other(error)))
}

/// Waits for a service to follow.
async fn find_service(objects: &Objects) -> Service {
    loop {
        match service_of(objects).await {
            Ok(service) => return service,
            Err(error) => tracing::info!(%error, "no service to follow yet"),
        }
        tokio::time::sleep(GLANCE).await;
    }
}

async fn service_of(objects: &Objects) -> Result<Service, ClusterError> {
    let bytes = objects.get(SERVICE).await?;
    let service: Service = serde_json::from_slice(&bytes).map_err(|error| ClusterError::odd("a service", error))?;
    match service.format == FORMAT {
        true => Ok(service),
        false => Err(ClusterError::OtherVersion(format!("format {}", service.format))),
    }
}

struct Replica {
    app: Arc<App>,
    objects: Objects,
    service: Service,
    client: Client,
}

/// The snapshot that a scene's world was built from, and the version that it is at.
type Held = HashMap<String, (String, u64)>;

impl Replica {
    /// Keeps up; returns why it cannot any more.
    async fn follow(self) -> ClusterError {
        let mut held = Held::new();
        let mut told = match self.client.subscribe(format!("{SCENE_SUBJECT}.*")).await {
            Ok(told) => told,
            Err(error) => return ClusterError::queue(error),
        };
        loop {
            match service_of(&self.objects).await {
                Ok(service) if service.suffix != self.service.suffix => {
                    return ClusterError::Failed("the service that it follows is another one now".to_owned());
                }
                Ok(_) => self.look_at_all(&mut held).await,
                Err(error) => tracing::warn!(%error, "the objects cannot be read"),
            }
            let glance = tokio::time::sleep(GLANCE);
            tokio::pin!(glance);
            loop {
                tokio::select! {
                    message = told.next() => match message {
                        Some(message) => {
                            let id = message.subject.rsplit('.').next().unwrap_or_default().to_owned();
                            self.look_at(&id, &mut held).await;
                        }
                        None => return ClusterError::Queue("the connection is closed".to_owned()),
                    },
                    () = &mut glance => break,
                }
            }
        }
    }

    async fn look_at_all(&self, held: &mut Held) {
        let names = match self.objects.names(SCENES).await {
            Ok(names) => names,
            Err(error) => return tracing::warn!(%error, "the objects cannot be read"),
        };
        let there = names.iter().filter_map(|name| name.strip_suffix(".json").map(str::to_owned));
        let all: HashSet<String> = there.chain(held.keys().cloned()).collect();
        for id in all {
            self.look_at(&id, held).await;
        }
    }

    /// Brings a scene up to its newest version.
    async fn look_at(&self, id: &str, held: &mut Held) {
        if self.app.ids.parse_scene(id).is_none() {
            return;
        }
        if let Err(error) = self.take(id, held).await {
            tracing::warn!(scene = id, %error, "a version is not taken");
        }
    }

    async fn take(&self, id: &str, held: &mut Held) -> Result<(), ClusterError> {
        let bytes = match self.objects.find(&scene_path(id)).await? {
            Some(bytes) => bytes,
            None => {
                if let Some(scene) = self.app.ids.parse_scene(id).and_then(|number| self.app.scenes.remove(number)) {
                    held.remove(id);
                    self.app
                        .store
                        .scene_deleted(scene.number)
                        .map_err(|error| ClusterError::Failed(error.to_string()))?;
                    scene.mark_deleted();
                    tell_scene(&scene, SceneChange::Deleted, &scene.published());
                }
                return Ok(());
            }
        };
        let shared: SharedScene =
            serde_json::from_slice(&bytes).map_err(|error| ClusterError::odd("a scene", error))?;
        let known = held.get(id).cloned();
        if known.as_ref().is_some_and(|(_, version)| *version >= shared.light.version) {
            return Ok(());
        }
        let folder = light_folder(id);
        let files = Files {
            map: self.objects.file_of(&folder, &shared.map).await?,
            changed: self.objects.file_of(&folder, &shared.changed).await?,
            unknown: match &shared.unknown {
                Some(hash) => Some(self.objects.file_of(&folder, hash).await?),
                None => None,
            },
        };
        let scene = self.app.scenes.get(shared.number);
        let fetched = match known.is_some_and(|(snapshot, _)| snapshot == shared.snapshot) && scene.is_some() {
            true => None,
            false => Some(snapshot::fetch(&self.objects, &shared.snapshot).await?),
        };
        let (app, its_id, taken) = (self.app.clone(), id.to_owned(), shared.clone());
        let take = move || publish(&app, its_id, scene, &taken, files, fetched);
        let done = self.app.compute.build(take).await.map_err(|panic| ClusterError::Failed(panic.to_string()))?;
        done?;
        held.insert(id.to_owned(), (shared.snapshot, shared.light.version));
        Ok(())
    }
}

struct Files {
    map: Bytes,
    changed: Bytes,
    unknown: Option<Bytes>,
}

/// Lets clients of the replica see a version.
fn publish(
    app: &Arc<App>,
    id: String,
    scene: Option<Arc<SceneEntry>>,
    shared: &SharedScene,
    files: Files,
    fetched: Option<Fetched>,
) -> Result<(), ClusterError> {
    let failed = |error: &dyn std::fmt::Display| ClusterError::Failed(error.to_string());
    let is_edited = fetched.is_some();
    let world = match (fetched, &scene) {
        (Some(fetched), _) => {
            // Exports copy from the files.
            fetched.keep(&*app.store, shared.number).map_err(|error| failed(&error))?;
            limited(World::clone(&*fetched.build()?), &app.config.limits)
        }
        (None, Some(scene)) => scene.published().world.clone(),
        (None, None) => return Err(failed(&"the scene has no world")),
    };
    let map = codec::decode_map(&files.map).ok_or_else(|| failed(&"the light map cannot be read"))?;
    let changed = codec::decode_versions(&files.changed, map.len());
    let changed = changed.ok_or_else(|| failed(&"the versions of elements cannot be read"))?;
    if map.len() != world.slots() {
        return Err(ClusterError::OtherLayout);
    }
    let unknown = files.unknown.map(|bytes| bytes.iter().map(|byte| *byte != 0).collect());
    let light = LightRecord {
        about: shared.light.clone(),
        map: Arc::new(map),
        changed: changed.into(),
        lit: None,
        earlier: EarlierLight::default(),
    };
    let lighting = Lighting::restored(&light, []);
    let version = light.about.version;
    let published = Published::restored(world.clone(), shared.mode, light, unknown, version);
    let scene = match scene {
        Some(scene) => {
            scene.replace(world, shared.accepted, lighting, published);
            scene.set_name(shared.name.clone());
            scene
        }
        None => {
            let new = NewScene {
                number: shared.number,
                id,
                name: shared.name.clone(),
                mode: shared.mode,
                target: shared.target,
                created_at: shared.created_at,
                first_event: app.ids.first_event,
                reserved: u64::MAX,
                error: None,
                state: SceneState::Ready,
            };
            let (keys, history) = (IdempotencyKeys::new(1), History::new(0));
            let head = Head { world, sequence: shared.accepted, jobs: 0, keys, history };
            let scene = Arc::new(SceneEntry::with(new, head, lighting, published, &app.config.limits));
            app.scenes.insert(scene.clone());
            scene
        }
    };
    if let Some(target) = shared.target.filter(|target| scene.target() != Some(*target)) {
        scene.set_target(target);
    }
    let published = scene.published();
    match is_edited {
        true => app.jobs.tell_edited(&scene, None, &published),
        false => app.jobs.tell_snapshot(&scene, None, &published, None),
    }
    Ok(())
}
