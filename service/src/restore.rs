//! Brings back what a data directory holds: scenes are built from their uploads, edits applied again in their order
//! (which gives the same slots), light maps loaded, jobs put back in line.
//!
//! What cannot be brought back is told, and the rest goes on: a scene whose upload or edits are damaged stays in the
//! list with its error; one whose light is damaged is baked afresh.

mod jobs;
mod replay;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::Arc;

use jiff::Timestamp;

use self::jobs::{bake_again, restore_job};
use self::replay::{fits, replay};
use crate::api::{edit_parse, skies};
use crate::engine::{self, AtlasOptions, Plan, World};
use crate::mode::Mode;
use crate::sizing::StoredSpread;
use crate::state::{App, Phase};
use crate::store::StoreError;
use crate::store::accepted::Head;
use crate::store::assets::{Assets, Content};
use crate::store::disk::{Disk, Saved, SavedEdit, SavedScene};
use crate::store::earlier::Earlier;
use crate::store::history::History;
use crate::store::keys::IdempotencyKeys;
use crate::store::lighting::{Lighting, unknown_of_saved};
use crate::store::records::{LightRecord, Origin, SceneRecord, StoredAtlas, StoredOutside};
use crate::store::scene::{NewScene, SceneEntry, SceneState};
use crate::store::versions::{Published, RESERVE};
use crate::unit::LightUnit;

/// Takes in all that was saved, and starts the jobs that were open.
pub(crate) fn restore(app: &Arc<App>, disk: &Disk, saved: Saved) {
    let (scenes, jobs) = (saved.scenes.len(), saved.jobs.len());
    app.scenes.begin_after(saved.newest_scene);
    app.jobs.begin_after(saved.newest_job);
    for id in &saved.assets {
        if let Err(error) = restore_asset(app, id) {
            tracing::error!(asset = id, %error, "an asset is lost");
        }
    }
    saved.upload_keys.into_iter().for_each(|key| app.upload_keys.insert(key));
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
        app.jobs.show_accepted(scene, accepted);
    }
    // Unless the service is about to end already.
    app.phase.send_if_modified(|phase| {
        let is_first = *phase == Phase::Restoring;
        if is_first {
            *phase = Phase::Serving;
        }
        is_first
    });
    app.jobs.start();
    tracing::info!(scenes, jobs, assets = saved.assets.len(), life = saved.life, "restored");
}

fn restore_asset(app: &App, id: &str) -> Result<(), StoreError> {
    add_asset(&app.assets, id, &app.store.asset(id)?)
}

/// Takes in an asset that was accepted at some time: scenes need it, whatever the limits are now.
fn add_asset(assets: &Assets, id: &str, file: &[u8]) -> Result<(), StoreError> {
    let content = match engine::is_sky(file) {
        true => engine::load_sky(file, usize::MAX).map(|(picture, _)| Content::from(picture)),
        false => engine::load_again(file, None).map(Content::from),
    };
    let content = content.map_err(|error| StoreError::damaged("it cannot be read any more", error))?;
    assets.insert(id.to_owned(), content, file.len());
    Ok(())
}

/// A world as it came to be, from the files that it was made of: its upload, and its assets by their ids. The same bits
/// wherever it is made.
pub(crate) fn world_of<'a>(
    upload: &[u8],
    files: impl IntoIterator<Item = (&'a str, &'a [u8])>,
    origin: &Origin,
) -> Result<World, StoreError> {
    let assets = Assets::new(usize::MAX, usize::MAX);
    files.into_iter().try_for_each(|(id, file)| add_asset(&assets, id, file))?;
    let uploaded = build(&assets, upload, &origin.record)?;
    let edit =
        |(sequence, body): (u64, &Vec<u8>)| SavedEdit { sequence, body: body.clone(), job: None, accepted_at: None };
    let edits: Vec<SavedEdit> = (1..).zip(&origin.edits).map(edit).collect();
    Ok(replay(&assets, uploaded, &edits, None)?.world)
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
    let uploaded = build(&app.assets, &disk.upload_of(saved)?, &record)?;
    // Whatever is wrong with the light can be baked again.
    let light = disk.light(saved);
    let other_layout = light.as_ref().ok().and_then(Option::as_ref).and_then(of_other_layout);
    let light = if other_layout.is_some() { Ok(None) } else { light };
    let light_to_fit = light.as_ref().ok().and_then(Option::as_ref);
    let mut replayed = replay(&app.assets, uploaded, &saved.edits, light_to_fit)?;
    replayed.world = engine::limited(replayed.world, &app.config.limits);
    if let Some(warning) = &other_layout {
        tracing::warn!(scene = app.ids.scene(saved.number), warning, "baked anew");
        let warnings = [&replayed.world.scene.warnings[..], std::slice::from_ref(warning)].concat();
        replayed.world = engine::warned(replayed.world, &warnings);
    }
    let (world, sequence) = (replayed.world.clone(), replayed.sequence);
    let mut history = std::mem::replace(&mut replayed.history, History::new(0));
    history.limit(app.config.limits.undo_steps);
    let light = light.and_then(|light| light.map(|light| fits(&replayed, light)).transpose());
    let mut keys = IdempotencyKeys::new(app.config.limits.idempotency_keys);
    saved.keys.iter().cloned().for_each(|key| keys.insert(key));
    let head = Head { world: world.clone(), sequence, jobs: saved.jobs, keys, history };

    let mut earlier = Earlier::default();
    let (published, lighting, error) = match light {
        Ok(Some((shown, light))) => {
            let unknown = unknown_of_saved(&light, &replayed.unlit);
            if let Some((_, present)) = &light.lit {
                let (worlds, since_base) = (&replayed.earlier, replayed.since_base);
                let present = (present, light.about.is_coarse);
                earlier = Earlier::restored(light.earlier.clone(), worlds, since_base, present);
            }
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
    let is_unbaked = error.is_some() || other_layout.is_some();
    let new = describe(app, saved, record, reserved, error);
    let mut entry = SceneEntry::with(new, head, lighting, published, &app.config.limits);
    entry.earlier = earlier;
    Ok((entry, is_unbaked))
}

/// What to tell of light whose elements are laid out as another version of this program does it: it is none of these
/// elements, and is baked anew.
fn of_other_layout(light: &LightRecord) -> Option<String> {
    let (version, own) = (light.about.layout_version, engine::LAYOUT_VERSION);
    (version != own).then(|| {
        format!(
            "its light was kept by version {version} of the layout of elements, this program has version {own}: it \
             is baked anew"
        )
    })
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

fn build(assets: &Assets, glb: &[u8], record: &SceneRecord) -> Result<World, StoreError> {
    let unreadable = |error: &dyn std::fmt::Display| StoreError::damaged("the upload cannot be read any more", error);
    let mut scene = engine::load_again(glb, record.max_albedo).map_err(|error| unreadable(&error))?;
    record.unit.convert(&mut scene);
    let outside = skies::outside(record.environment, &record.outside, assets);
    outside.map_err(|problem| unreadable(&problem))?.add_to(&mut scene);
    scene.groups = record.groups.clone();
    let atlas = record.atlas.map(|StoredAtlas { texels_per_metre, max_texels }| AtlasOptions {
        texels_per_metre: Some(texels_per_metre),
        max_texels,
    });
    let plan = Plan {
        density: record.density(),
        elements: record.elements,
        spread: record.spread.into(),
        stated: record.mode.stated(),
        max_albedo: record.max_albedo,
        atlas,
    };
    engine::build_again(scene, &plan).map_err(|error| unreadable(&error))
}

/// A scene that can only be looked at and deleted.
fn damaged(app: &App, saved: &SavedScene, error: &StoreError) -> SceneEntry {
    let record = saved.record.clone().unwrap_or_else(|_| SceneRecord {
        name: "?".to_owned(),
        mode: Mode::Full,
        spacing: 1.0,
        object_squares: None,
        elements: None,
        spread: StoredSpread::default(),
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
        first_event: app.ids.first_event,
        reserved,
        error,
        state: SceneState::Ready,
    }
}
