//! A scene in memory.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use jiff::Timestamp;
use tokio::sync::watch;

use super::accepted::{AcceptedWorld, Head};
use super::atlas::MadeAtlas;
use super::computed::KeptPart;
use super::deltas::KeptDeltas;
use super::drag::Drag;
use super::earlier::Earlier;
use super::filtered::FilteredLight;
use super::history::History;
use super::keys::IdempotencyKeys;
use super::lighting::{Lighting, Lit, Samples, Sequence, Unlit, Work};
use super::probes::KeptProbes;
use super::records::{LightRecord, LightState};
use super::tiles::KeptTiles;
use super::versions::Published;
use crate::config::Limits;
use crate::engine::{Edit, LightMap, World};
use crate::events::EventLog;
use crate::jobs::budget::JobBudget;
use crate::jobs::queue::SceneNumber;
use crate::mode::Mode;

/// One scene.
pub(crate) struct SceneEntry {
    pub(crate) number: SceneNumber,
    pub(crate) id: String,
    name: Mutex<String>,
    pub(crate) mode: Mode,
    target: Mutex<Option<JobBudget>>,
    pub(crate) created_at: Timestamp,
    pub(crate) events: Arc<EventLog>,
    /// Edits are accepted one at a time, each against the world that those before it lead to.
    pub(crate) head: Arc<tokio::sync::Mutex<Head>>,
    lighting: Mutex<Lighting>,
    /// What undo goes back to.
    pub(crate) earlier: Earlier,
    /// What lights are dragged with.
    pub(crate) drag: Drag,
    /// Between versions, for caches.
    pub(crate) deltas: KeptDeltas,
    /// Its light with less noise, for clients that ask for it.
    pub(crate) filtered: Arc<FilteredLight>,
    /// Its atlas, where it was uploaded without one.
    pub(crate) made_atlas: MadeAtlas,
    /// Pages of its atlas that clients follow.
    pub(crate) tiles: KeptTiles,
    /// Sets of probes that clients follow.
    pub(crate) probes: KeptProbes,
    /// Ambient occlusion that a client asked for.
    pub(crate) occlusion: KeptPart,
    /// From where light comes, where a client asked for that.
    pub(crate) directional: KeptPart,
    published: watch::Sender<Arc<Published>>,
    deleted: watch::Sender<bool>,
    /// No version above it may be given before more are reserved.
    pub(crate) reserved: AtomicU64,
    /// A save is under way: another would only repeat it.
    pub(crate) saving: AtomicBool,
    /// What the head holds, for those who do not wait for it.
    accepted: Mutex<Arc<AcceptedWorld>>,
    /// Bytes of the layers that the light of all accepted edits will have, at most.
    expected_layers: AtomicU64,
    /// The version beyond which idle time brings nothing.
    pub(crate) refined: AtomicU64,
    error: Mutex<Option<String>>,
    state: watch::Sender<SceneState>,
}

/// Whether a scene can be worked with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SceneState {
    /// Its elements are laid out and its trees are built: what is published is empty.
    Preparing,
    /// It takes edits.
    Ready,
    /// It cannot be served: only looked at and deleted.
    Damaged,
}

impl SceneEntry {
    /// A scene without light.
    pub(crate) fn new(new: NewScene, world: World, limits: &Limits) -> SceneEntry {
        let published = Published::black(world.clone(), new.mode);
        let keys = IdempotencyKeys::new(limits.idempotency_keys);
        let head = Head { world, sequence: 0, jobs: 0, keys, history: History::new(limits.undo_steps) };
        SceneEntry::with(new, head, Lighting::new(), published, limits)
    }

    /// A scene of an earlier life.
    pub(crate) fn with(
        new: NewScene,
        head: Head,
        lighting: Lighting,
        published: Published,
        limits: &Limits,
    ) -> SceneEntry {
        let accepted = Mutex::new(Arc::new(AcceptedWorld::new(&head.world, head.sequence)));
        SceneEntry {
            number: new.number,
            id: new.id,
            name: Mutex::new(new.name),
            mode: new.mode,
            target: Mutex::new(new.target),
            created_at: new.created_at,
            events: Arc::new(EventLog::new(limits.events, new.first_event)),
            head: Arc::new(tokio::sync::Mutex::new(head)),
            lighting: Mutex::new(lighting),
            earlier: Earlier::default(),
            drag: Drag::default(),
            deltas: KeptDeltas::default(),
            filtered: Arc::default(),
            made_atlas: MadeAtlas::default(),
            tiles: KeptTiles::default(),
            probes: KeptProbes::default(),
            occlusion: KeptPart::default(),
            directional: KeptPart::default(),
            published: watch::Sender::new(Arc::new(published)),
            deleted: watch::Sender::new(false),
            reserved: AtomicU64::new(new.reserved),
            saving: AtomicBool::new(false),
            accepted,
            expected_layers: AtomicU64::new(0),
            refined: AtomicU64::new(u64::MAX),
            error: Mutex::new(new.error),
            state: watch::Sender::new(new.state),
        }
    }

    /// Name for people.
    pub(crate) fn name(&self) -> String {
        self.name.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(crate) fn set_name(&self, name: String) {
        *self.name.lock().unwrap_or_else(PoisonError::into_inner) = name;
    }

    /// What it works towards; none: nothing but its edits.
    pub(crate) fn target(&self) -> Option<JobBudget> {
        *self.target.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// From here on it works towards another target.
    pub(crate) fn set_target(&self, target: JobBudget) {
        *self.target.lock().unwrap_or_else(PoisonError::into_inner) = Some(target);
        self.lighting().set_done(false);
    }

    /// A target is reached, as far as its bounds let it; that of a job that began before a new one came counts no more.
    pub(crate) fn reached(&self, target: &JobBudget) {
        let is_present = self.target() == Some(*target);
        self.lighting().set_done(is_present);
    }

    /// Whether its light is less than a target asks for.
    pub(crate) fn is_behind(&self, target: &JobBudget) -> bool {
        let lighting = self.lighting();
        lighting.is_behind(&self.published(), target)
    }

    /// Samples per element of the last bake and of what has refined it since.
    pub(crate) fn samples(&self) -> u32 {
        self.lighting().effort().samples
    }

    /// There is no light to go on from.
    pub(crate) fn needs_bake(&self) -> bool {
        self.lighting().needs_bake()
    }

    /// What is wrong with it, for people.
    pub(crate) fn error(&self) -> Option<String> {
        self.error.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(crate) fn set_error(&self, error: Option<String>) {
        *self.error.lock().unwrap_or_else(PoisonError::into_inner) = error;
    }

    /// Bytes of what stands beside the world and the map: deltas, tiles, the transport of drags, earlier maps, filtered light.
    pub(crate) fn aside_bytes(&self, published: &Published) -> usize {
        let parts = self.occlusion.memory_bytes() + self.directional.memory_bytes() + self.filtered.memory_bytes();
        let told = self.deltas.memory_bytes() + self.tiles.memory_bytes() + self.probes.memory_bytes() + parts;
        told + self.drag.memory_bytes() + self.earlier.memory_bytes(&published.map)
    }

    /// What clients see now.
    pub(crate) fn published(&self) -> Arc<Published> {
        self.published.borrow().clone()
    }

    /// What clients see now, and up to which accepted edit its geometry is.
    pub(crate) fn shown(&self) -> (Arc<Published>, Sequence) {
        let lighting = self.lighting();
        (self.published(), lighting.shown())
    }

    /// Told of every new version; skips what it is too slow for.
    pub(crate) fn watch_published(&self) -> watch::Receiver<Arc<Published>> {
        self.published.subscribe()
    }

    /// Becomes true when the scene is deleted.
    pub(crate) fn watch_deleted(&self) -> watch::Receiver<bool> {
        self.deleted.subscribe()
    }

    pub(crate) fn is_deleted(&self) -> bool {
        *self.deleted.borrow()
    }

    pub(crate) fn mark_deleted(&self) {
        self.deleted.send_replace(true);
        // Who waits for it is told.
        self.state.send_replace(SceneState::Damaged);
    }

    pub(crate) fn state(&self) -> SceneState {
        *self.state.borrow()
    }

    pub(crate) fn is_damaged(&self) -> bool {
        self.state() == SceneState::Damaged
    }

    /// Waits until it is prepared.
    pub(crate) async fn prepared(&self) {
        let mut state = self.state.subscribe();
        // The sender lives as long as the scene.
        let _ = state.wait_for(|state| *state != SceneState::Preparing).await;
    }

    /// It is prepared: here is what it holds.
    pub(crate) fn set_ready(&self, head: &mut Head, world: World) -> Arc<Published> {
        head.world = world.clone();
        self.set_accepted(head);
        let published = self.publish(Published::laid_out(world, self.mode));
        published.objects();
        self.state.send_replace(SceneState::Ready);
        published
    }

    /// It cannot be built.
    pub(crate) fn set_damaged(&self, error: String) {
        self.set_error(Some(error));
        self.state.send_replace(SceneState::Damaged);
    }

    pub(crate) fn accept(&self, unlit: Unlit) {
        self.lighting().accept(unlit);
    }

    /// Light and version of one moment, to be saved.
    pub(crate) fn light_record(&self) -> LightRecord {
        self.shared_light().0
    }

    /// Another version, as a service that this one follows has published it. Waits for the head: not from an async thread.
    pub(crate) fn replace(&self, world: World, accepted: Sequence, lighting: Lighting, published: Published) {
        let mut head = self.head.blocking_lock();
        (head.world, head.sequence) = (world, accepted);
        self.set_accepted(&head);
        let mut own = self.lighting();
        *own = lighting;
        self.publish(published);
    }

    /// Light and version of one moment, with what is published then.
    pub(crate) fn shared_light(&self) -> (LightRecord, Arc<Published>) {
        // What is costly is done without the lock.
        let (published, shown, right_for, lit, effort) = {
            let lighting = self.lighting();
            let (right_for, lit) = lighting.saved();
            (self.published(), lighting.shown(), right_for, lit, lighting.effort())
        };
        let saved = lit.as_ref().map(|(_, lit)| self.earlier.saved(lit));
        let (earlier, is_coarse) = saved.unwrap_or_default();
        let record = LightRecord {
            about: LightState { effort, is_coarse, ..published.state(shown, right_for) },
            map: published.map.clone(),
            changed: published.changed.clone(),
            lit,
            earlier,
        };
        (record, published)
    }

    /// What edits asked for that are not lit yet.
    pub(crate) fn unlit_edits(&self) -> Vec<(Sequence, Arc<[Edit]>)> {
        self.lighting().unlit_edits()
    }

    pub(crate) fn unlit(&self) -> usize {
        self.lighting().unlit()
    }

    /// What all accepted edits lead to.
    pub(crate) fn accepted(&self) -> Arc<AcceptedWorld> {
        self.accepted.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The head holds another world.
    pub(crate) fn set_accepted(&self, head: &Head) {
        let accepted = Arc::new(AcceptedWorld::new(&head.world, head.sequence));
        *self.accepted.lock().unwrap_or_else(PoisonError::into_inner) = accepted;
    }

    /// Bytes of layers that are expected and not there yet.
    pub(crate) fn layers_to_come(&self, published: &Published) -> u64 {
        self.expected_layers.load(Ordering::Relaxed).saturating_sub(published.layer_bytes() as u64)
    }

    pub(crate) fn expect_layers(&self, bytes: u64) {
        self.expected_layers.store(bytes, Ordering::Relaxed);
    }

    /// What clients see with the map behind it, where that is right for all that was accepted.
    pub(crate) fn up_to_date(&self) -> Option<(Arc<Published>, Arc<LightMap>)> {
        let lighting = self.lighting();
        let published = self.published();
        let map = lighting.up_to_date(&published)?;
        Some((published, map))
    }

    /// Publishes a more accurate map in place of `of`; `None` where anything came in between.
    pub(crate) fn refine(&self, of: &Arc<LightMap>, lit: Lit<'_>) -> Option<Arc<Published>> {
        let mut lighting = self.lighting();
        let next = lighting.refine(&self.published(), of, lit)?;
        Some(self.publish(next))
    }

    /// Publishes the geometry up to `sequence`, with old light. The new version where that changed anything.
    pub(crate) fn show(&self, sequence: Sequence) -> Option<Arc<Published>> {
        let mut lighting = self.lighting();
        let next = lighting.show(&self.published(), sequence)?;
        Some(self.publish(next))
    }

    /// What to do, what it leads to, and the stated error of what is published for that already.
    pub(crate) fn work(&self, max_unlit: usize) -> (Work, Sequence, Option<f32>) {
        let mut lighting = self.lighting();
        let published = self.published();
        let work = lighting.work(&published, max_unlit);
        let shown = lighting.shown();
        (work, shown, lighting.floor(&published, shown))
    }

    /// The world of what was accepted up to `sequence`, where clients see that one.
    pub(crate) fn shown_world(&self, sequence: Sequence) -> Option<World> {
        (self.lighting().shown() == sequence).then(|| self.published().world.clone())
    }

    /// Publishes a map that is right for `sequence`.
    pub(crate) fn snapshot(&self, sequence: Sequence, lit: Lit<'_>) -> Arc<Published> {
        let mut lighting = self.lighting();
        let next = lighting.snapshot(&self.published(), sequence, lit);
        self.publish(next)
    }

    pub(crate) fn set_lit(&self, sequence: Sequence, map: Arc<LightMap>, samples: Samples) {
        self.lighting().set_lit(sequence, map, samples);
    }

    /// Edits up to that of `unlit` that are not lit yet add up to it.
    pub(crate) fn fold_unlit(&self, unlit: Unlit) {
        self.lighting().fold(unlit);
    }

    pub(crate) fn distrust(&self) {
        self.lighting().distrust();
    }

    /// Only with `lighting` locked: versions are made one after the other.
    fn publish(&self, next: Published) -> Arc<Published> {
        let next = Arc::new(next);
        self.published.send_replace(next.clone());
        next
    }

    fn lighting(&self) -> MutexGuard<'_, Lighting> {
        // What a panicking job leaves behind is distrusted by `worker`; the lock itself stays usable.
        self.lighting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What a new scene is called.
pub(crate) struct NewScene {
    pub(crate) number: SceneNumber,
    pub(crate) id: String,
    pub(crate) name: String,
    pub(crate) mode: Mode,
    pub(crate) target: Option<JobBudget>,
    pub(crate) created_at: Timestamp,
    /// Ids of its events rise from the one after it.
    pub(crate) first_event: u64,
    /// Versions that may be given.
    pub(crate) reserved: u64,
    pub(crate) error: Option<String>,
    pub(crate) state: SceneState,
}
