//! Brings back what a data directory holds: scenes are built from their uploads, edits applied again in their order
//! (which gives the same slots), light maps loaded, jobs put back in line.
//!
//! What cannot be brought back is told, and the rest goes on: a scene whose upload or edits are damaged stays in the
//! list with its error; one whose light is damaged is baked afresh.

use std::collections::BTreeMap;
use std::sync::Arc;

use jiff::Timestamp;
use rebake_core::allowed::Allowed;

use crate::api::{edit_parse, skies};
use crate::engine::{self, AtlasOptions, Edit, World};
use crate::jobs::budget::JobBudget;
use crate::jobs::queue::{JobKind, JobState, Outcome, Priority};
use crate::jobs::{JobSpec, new_record};
use crate::mode::Mode;
use crate::state::{App, Phase};
use crate::store::StoreError;
use crate::store::assets::Content;
use crate::store::disk::{Disk, Saved, SavedEdit, SavedScene};
use crate::store::history::{self, History, Turn};
use crate::store::keys::IdempotencyKeys;
use crate::store::lighting::{Lighting, Sequence, Unlit, unknown_of_saved};
use crate::store::records::{JobRecord, LightRecord, SceneRecord, StoredAtlas, StoredOutside};
use crate::store::scene::{Head, NewScene, SceneEntry, SceneState};
use crate::store::versions::{Published, RESERVE};
use crate::unit::LightUnit;

/// Takes in all that was saved, and starts the jobs that were open.
pub(crate) fn restore(app: &Arc<App>, disk: &Disk, saved: Saved) {
    let (scenes, jobs) = (saved.scenes.len(), saved.jobs.len());
    app.scenes.begin_after(saved.newest_scene);
    app.begin_jobs_after(saved.newest_job);
    for id in &saved.assets {
        if let Err(error) = restore_asset(app, id) {
            tracing::error!(asset = id, %error, "an asset is lost");
        }
    }
    let mut unbaked = Vec::new();
    for scene in saved.scenes {
        let (entry, is_unbaked) = restore_scene(app, disk, &scene);
        if is_unbaked {
            unbaked.push(entry.clone());
        }
        app.scenes.insert(entry);
    }
    for record in saved.jobs {
        match record {
            Ok(record) => restore_job(app, record),
            Err(error) => tracing::error!(%error, "a job is lost; its edit is not"),
        }
    }
    unbaked.iter().for_each(|scene| bake_again(app, scene));
    for scene in app.scenes.all().iter().filter(|scene| !scene.is_damaged()) {
        let accepted = scene.head.blocking_lock().sequence;
        app.settle(scene, accepted);
    }
    // Unless the service is about to end already.
    app.phase.send_if_modified(|phase| {
        let is_first = *phase == Phase::Restoring;
        if is_first {
            *phase = Phase::Serving;
        }
        is_first
    });
    app.start_jobs();
    tracing::info!(scenes, jobs, assets = saved.assets.len(), life = saved.life, "restored");
}

fn restore_asset(app: &App, id: &str) -> Result<(), StoreError> {
    let file = app.store.asset(id)?;
    // Scenes need what was acknowledged, whatever the limits are now.
    let content = match engine::is_sky(&file) {
        true => engine::load_sky(&file, usize::MAX).map(|(picture, _)| Content::from(picture)),
        false => engine::load_again(&file, None).map(Content::from),
    };
    let content = content.map_err(|error| StoreError::damaged("it cannot be read any more", error))?;
    app.assets.insert(id.to_owned(), content, file.len());
    Ok(())
}

/// A scene, and whether its light is lost.
fn restore_scene(app: &App, disk: &Disk, saved: &SavedScene) -> (Arc<SceneEntry>, bool) {
    match rebuild(app, disk, saved) {
        Ok((entry, is_unbaked)) => (Arc::new(entry), is_unbaked),
        Err(error) => {
            tracing::error!(scene = app.ids.scene(saved.number), %error, "a scene is damaged");
            (Arc::new(damaged(app, saved, &error)), false)
        }
    }
}

fn rebuild(app: &App, disk: &Disk, saved: &SavedScene) -> Result<(SceneEntry, bool), StoreError> {
    note_assets(app, saved);
    let record = saved.record.clone()?;
    let uploaded = build(app, &disk.upload_of(saved)?, &record)?;
    // Whatever is wrong with the light can be baked again.
    let light = disk.light(saved);
    let mut replayed = replay(app, uploaded, &saved.edits, light.as_ref().ok().and_then(Option::as_ref))?;
    let (world, sequence) = (replayed.world.clone(), replayed.sequence);
    let mut history = std::mem::replace(&mut replayed.history, History::new(0));
    history.limit(app.config.limits.undo_steps);
    let light = light.and_then(|light| light.map(|light| fits(&replayed, light)).transpose());
    let mut keys = IdempotencyKeys::new(app.config.limits.idempotency_keys);
    saved.keys.iter().cloned().for_each(|key| keys.insert(key));
    let head = Head { world: world.clone(), sequence, jobs: saved.jobs, keys, history };

    let (published, lighting, error) = match light {
        Ok(Some((shown, light))) => {
            let unknown = unknown_of_saved(&light, &replayed.unlit);
            let published = Published::restored(shown, record.mode, light.clone(), unknown, saved.reserved);
            (published, Lighting::restored(&light, replayed.unlit), None)
        }
        // Nothing was saved yet; versions may have been given all the same.
        Ok(None) => (Published::lost(world, record.mode, saved.reserved), Lighting::baked_next(sequence), None),
        Err(error) => {
            tracing::error!(scene = app.ids.scene(saved.number), %error, "its light is lost: it is baked afresh");
            let text = format!("the light map is lost and baked afresh: {}", error.reason);
            (Published::lost(world, record.mode, saved.reserved), Lighting::baked_next(sequence), Some(text))
        }
    };
    let reserved = published.version + RESERVE;
    app.store.versions_reserved(saved.number, reserved)?;
    let is_unbaked = error.is_some();
    let new = describe(app, saved, record, reserved, error);
    Ok((SceneEntry::with(new, head, lighting, published, &app.config.limits), is_unbaked))
}

/// Notes which assets the scene's history needs, whatever else is wrong with it.
fn note_assets(app: &App, saved: &SavedScene) {
    let missing = |asset: &str| {
        tracing::error!(scene = app.ids.scene(saved.number), asset, "an asset is missing");
    };
    let sky = saved.record.as_ref().ok().and_then(|record| record.outside.sky.as_ref());
    if let Some(Err(asset)) = sky.map(|sky| app.assets.need(saved.number, &[&sky.asset])) {
        missing(asset);
    }
    for edit in &saved.edits {
        if let Ok(parsed) = edit_parse::parse(&edit.body, usize::MAX)
            && let Err(asset) = app.assets.need(saved.number, &edit_parse::used_assets(&parsed))
        {
            missing(asset);
        }
    }
}

fn build(app: &App, glb: &[u8], record: &SceneRecord) -> Result<World, StoreError> {
    let unreadable = |error: &dyn std::fmt::Display| StoreError::damaged("the upload cannot be read any more", error);
    let mut scene = engine::load_again(glb, record.max_albedo).map_err(|error| unreadable(&error))?;
    record.unit.convert(&mut scene);
    let outside = skies::outside(record.environment, &record.outside, &app.assets);
    outside.map_err(|problem| unreadable(&problem))?.add_to(&mut scene);
    scene.groups = record.groups.clone();
    let atlas = record.atlas.map(|StoredAtlas { texels_per_metre, max_texels }| AtlasOptions {
        texels_per_metre: Some(texels_per_metre),
        max_texels,
    });
    engine::build_again(scene, record.density(), record.mode.stated(), record.max_albedo, atlas)
        .map_err(|error| unreadable(&error))
}

/// A scene after all of its edits.
struct Replayed {
    world: World,
    sequence: Sequence,
    /// The world that the saved light was published with.
    shown: Option<World>,
    /// Slots of the world that the saved light to start from is right for.
    lit_slots: Option<usize>,
    /// Edits that the saved light does not know.
    unlit: Vec<Unlit>,
    history: History,
}

/// Applies all edits again. Only what `light` does not know is kept: every world has arrays of its own.
fn replay(
    app: &App,
    uploaded: World,
    edits: &[SavedEdit],
    light: Option<&LightRecord>,
) -> Result<Replayed, StoreError> {
    let shown = light.map(|light| light.about.shown);
    let lit = light.and_then(|light| light.lit.as_ref()).map(|(sequence, _)| *sequence);
    let known = shown.map_or(Sequence::MAX, |shown| lit.map_or(shown, |lit| lit.min(shown)));
    let mut replayed = Replayed {
        world: uploaded,
        sequence: 0,
        shown: None,
        lit_slots: None,
        unlit: Vec::new(),
        history: History::new(usize::MAX),
    };
    replayed.note(shown, lit);
    for saved in edits {
        let sequence = &saved.sequence;
        let failed = |why: String| StoreError::damaged("an edit cannot be applied again", format!("{sequence}: {why}"));
        if *sequence != replayed.sequence + 1 {
            return Err(failed("an earlier one is missing".to_owned()));
        }
        let (edits, turn) = read_edits(app, &saved.body, &replayed.history).map_err(failed)?;
        let transition = replayed.world.apply_again(&edits).map_err(|error| failed(error.to_string()))?;
        let (body, job, accepted_at) = (saved.body.clone().into(), saved.job, saved.accepted_at);
        let accepted = history::Accepted { body, job, accepted_at, turn: None, is_undone: false };
        replayed.history.accept(accepted, turn, (&replayed.world.scene, &transition.after.scene));
        replayed.world = transition.after.clone();
        replayed.sequence = *sequence;
        replayed.note(shown, lit);
        if *sequence > known {
            let transition = Arc::new(transition);
            replayed.unlit.push(Unlit { sequence: *sequence, transition, edits: edits.into() });
        }
    }
    replayed.world = engine::limited(replayed.world, &app.config.limits);
    Ok(replayed)
}

impl Replayed {
    fn note(&mut self, shown: Option<Sequence>, lit: Option<Sequence>) {
        if shown == Some(self.sequence) {
            self.shown = Some(self.world.clone());
        }
        if lit == Some(self.sequence) {
            self.lit_slots = Some(self.world.slots());
        }
    }
}

fn read_edits(app: &App, body: &[u8], history: &History) -> Result<(Vec<Edit>, Option<Turn>), String> {
    let parsed = edit_parse::parse(body, usize::MAX).map_err(|problem| problem.to_string())?;
    let edits = edit_parse::to_edits(&parsed, &app.assets, history, Allowed::KEPT);
    Ok((edits.map_err(|problem| problem.to_string())?, parsed.turn()))
}

/// The light with the world it belongs to; an error where their slots differ.
fn fits(replayed: &Replayed, light: LightRecord) -> Result<(World, LightRecord), StoreError> {
    let differs = || StoreError::damaged("it does not fit the scene", "the slots differ");
    let shown = replayed.shown.as_ref().ok_or_else(differs)?;
    let about = &light.about;
    if light.map.len() != shown.slots() || about.layout != engine::layout_hash(shown) {
        return Err(differs());
    }
    if about.weights.len() != light.map.layers.len() {
        return Err(differs());
    }
    if light.lit.as_ref().is_some_and(|(_, lit)| replayed.lit_slots != Some(lit.len())) {
        return Err(differs());
    }
    Ok((shown.clone(), light))
}

/// A scene that can only be looked at and deleted.
fn damaged(app: &App, saved: &SavedScene, error: &StoreError) -> SceneEntry {
    let record = saved.record.clone().unwrap_or_else(|_| SceneRecord {
        name: "?".to_owned(),
        mode: Mode::Full,
        spacing: 1.0,
        object_squares: None,
        environment: None,
        outside: StoredOutside::default(),
        unit: LightUnit::default(),
        max_albedo: None,
        atlas: None,
        groups: BTreeMap::new(),
        target: None,
        created_at: Timestamp::UNIX_EPOCH,
    });
    let mode = record.mode;
    let world = engine::empty_world(record.spacing);
    let (keys, history) = (IdempotencyKeys::new(1), History::new(0));
    let head = Head { world: world.clone(), sequence: 0, jobs: 0, keys, history };
    let mut new = describe(app, saved, record, u64::MAX, Some(error.reason.to_owned()));
    new.state = SceneState::Damaged;
    SceneEntry::with(new, head, Lighting::new(), Published::lost(world, mode, saved.reserved), &app.config.limits)
}

fn describe(app: &App, saved: &SavedScene, record: SceneRecord, reserved: u64, error: Option<String>) -> NewScene {
    NewScene {
        number: saved.number,
        id: app.ids.scene(saved.number),
        name: record.name,
        mode: record.mode,
        target: record.target,
        created_at: record.created_at,
        first_event: app.first_event,
        reserved,
        error,
        state: SceneState::Ready,
    }
}

/// Puts a job back in line. One that was asked to stop, or whose scene is damaged, ends.
fn restore_job(app: &App, mut record: JobRecord) {
    let scene = app.scenes.get(record.job.scene);
    let job = &mut record.job;
    if !job.state.has_ended() {
        let outcome = match &scene {
            None => Some(Outcome::Canceled),
            Some(scene) if scene.is_damaged() => Some(Outcome::Failed("the scene is damaged".to_owned())),
            Some(_) if job.cancel_requested => Some(Outcome::Canceled),
            Some(_) => None,
        };
        if let Some(outcome) = outcome {
            job.end(&outcome, Timestamp::now());
            if let Err(error) = app.store.job_changed(&record) {
                tracing::warn!(%error, "the end of a job could not be saved");
            }
        } else if job.state == JobState::Running {
            job.started_at = None;
        }
    }
    app.restore_job(scene, &record);
}

/// Queues a bake of a scene whose light is lost, unless a job waits that will do it.
fn bake_again(app: &Arc<App>, scene: &Arc<SceneEntry>) {
    if app.jobs.with_queue(|queue| queue.current(scene.number)).is_some() {
        return;
    }
    let mut head = scene.head.blocking_lock();
    let samples_per_element = app.config.defaults.bake_samples;
    let default = JobBudget { samples_per_element, max_seconds: None, target_rmse: None };
    let budget = scene.target().unwrap_or(default);
    let mut jobs = head.jobs;
    let seed = crate::jobs::seeds::next_seed(app.config.seed, &mut jobs);
    let sequence = head.sequence;
    let spec = JobSpec::new(budget, seed, sequence);
    let Ok(ticket) = app.ticket(scene.number) else { return };
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

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use rebake_core::export::write_scene_glb;
    use rebake_core::scene::{Material, Mesh, Object, Scene};
    use rusqlite::Connection;

    use super::*;
    use crate::config::Config;
    use crate::store::Store;
    use crate::store::faults::Faults;

    /// Scenes 1, 2 and 3 with a plate each, and what `break_it` does to the database.
    fn restored(break_it: &str) -> Arc<App> {
        let directory = tempfile::tempdir().unwrap();
        let plate = Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Z);
        let scene = Scene::from_objects(vec![Object::new("plate", plate, Material::diffuse(Vec3::splat(0.5)))]);
        let glb = write_scene_glb(&scene).unwrap();
        let disk = Disk::open(directory.path(), Faults::default(), 2).unwrap();
        disk.load("test").unwrap();
        for number in 1..=3 {
            let record = SceneRecord {
                name: "a".to_owned(),
                mode: Mode::Full,
                spacing: 0.5,
                object_squares: None,
                environment: None,
                outside: StoredOutside::default(),
                unit: LightUnit::default(),
                groups: BTreeMap::new(),
                max_albedo: None,
                atlas: None,
                target: None,
                created_at: Timestamp::now(),
            };
            disk.scene_created(number, &record, &glb, None).unwrap();
        }
        disk.close();
        Connection::open(directory.path().join("rebake.db")).unwrap().execute_batch(break_it).unwrap();
        let config = Config { data_dir: Some(directory.path().to_owned()), threads: 1, ..Config::default() };
        let (app, saved) = App::new(config).unwrap();
        let (disk, saved) = saved.expect("a data directory");
        restore(&app, &disk, saved);
        app
    }

    #[test]
    fn a_bad_row_of_any_table_leaves_all_other_scenes_served() {
        // What becomes of scene 2: it is whole, tells an error, is damaged, or is left out.
        let (whole, told, damaged, left_out) = (Some((false, false)), Some((true, false)), Some((true, true)), None);
        let garbled = "UPDATE scenes SET record = 'x' WHERE number = 2";
        for (break_it, expected) in [
            ("", whole),
            ("UPDATE scenes SET record = json_set(record, '$.spacing', 0) WHERE number = 2", damaged),
            ("UPDATE scenes SET record = json_set(record, '$.spacing', 1e300) WHERE number = 2", damaged),
            (garbled, damaged),
            ("UPDATE scenes SET reserved = x'00' WHERE number = 2", left_out),
            ("UPDATE scenes SET blob = 'no such file' WHERE number = 2", damaged),
            ("INSERT INTO edits VALUES (2, 1, x'ff')", damaged),
            ("INSERT INTO edits VALUES (2, 1, 7)", damaged),
            ("INSERT INTO light (scene, about, map, changed) VALUES (2, x'ff', 'a', 'b')", told),
            ("INSERT INTO light (scene, about, map, changed) VALUES (2, '{}', 'a', 'b')", told),
            ("INSERT INTO assets VALUES (x'ff'); INSERT INTO assets VALUES ('no such file')", whole),
            ("INSERT INTO jobs VALUES (7, 2, 1, 'x'); INSERT INTO jobs VALUES (8, 2, 1, x'ff')", whole),
            ("INSERT INTO keys (scene, key, body_hash, job, answer) VALUES (2, x'ff', 'a', 1, 'a')", whole),
        ] {
            let app = restored(break_it);
            for number in [1, 3] {
                let scene = app.scenes.get(number).unwrap();
                assert!(scene.error().is_none() && !scene.is_damaged(), "{break_it}: {number}");
                assert!(scene.published().world.element_count() > 0, "{break_it}: {number}");
            }
            let found = app.scenes.get(2).map(|scene| (scene.error().is_some(), scene.is_damaged()));
            // A bake that is queued anew may have ended by now, and with it the error.
            let is_baked = expected == told && found == whole;
            assert!(found == expected || is_baked, "{break_it}: {found:?}");
            app.close_jobs();
        }
    }
}
