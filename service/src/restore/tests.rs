use glam::Vec3;
use rebake_core::export::write_scene_glb;
use rebake_core::scene::{Material, Mesh, Object, Scene};
use rusqlite::Connection;
use tempfile::TempDir;

use super::*;
use crate::config::Config;
use crate::engine::LightMap;
use crate::store::Store;
use crate::store::faults::Faults;
use crate::store::lighting::{Lit, Samples};

/// Scenes 1, 2 and 3 with a plate each, and what `break_it` does to the database.
fn restored(break_it: &str) -> Arc<App> {
    let directory = with_plates();
    change(&directory, break_it);
    opened(&directory)
}

/// A data directory with scenes 1, 2 and 3 of a plate each.
fn with_plates() -> TempDir {
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
            elements: None,
            spread: StoredSpread::default(),
            environment: None,
            outside: StoredOutside::default(),
            unit: LightUnit::default(),
            groups: BTreeMap::new(),
            max_albedo: None,
            atlas: None,
            target: None,
            created_at: Timestamp::now(),
        };
        disk.scene_created(number, &record, &glb, None, None).unwrap();
    }
    disk.close();
    directory
}

fn change(directory: &TempDir, sql: &str) {
    Connection::open(directory.path().join("rebake.db")).unwrap().execute_batch(sql).unwrap();
}

fn opened(directory: &TempDir) -> Arc<App> {
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
        ("INSERT INTO earlier VALUES (2, 0, 0, 'no such file')", whole),
        ("INSERT INTO earlier VALUES (2, -1, 0, x'ff'); INSERT INTO earlier VALUES (2, 0, 'x', 'a')", whole),
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
        app.jobs.close();
    }
}

/// A data directory with [`with_plates`] of which the second has a light map; its version, and the map.
fn with_light() -> (TempDir, u64, Arc<LightMap>) {
    let directory = with_plates();
    let app = opened(&directory);
    let scene = app.scenes.get(2).unwrap();
    let mut map = LightMap::black(scene.published().world.slots());
    map.light.direct.fill(Vec3::splat(2.0));
    let map = Arc::new(map);
    let lit = Lit { map: &map, estimated_rmse: Some(0.1), resolution: None, is_right: true };
    let version = scene.snapshot(0, lit).version;
    scene.set_lit(0, map.clone(), Samples::Fresh(4));
    app.store.light_saved(2, &scene.light_record()).unwrap();
    app.jobs.close();
    app.store.close();
    (directory, version, map)
}

/// What undo goes back to comes back with the light, as far as its files are there.
#[test]
fn earlier_light_comes_back_where_it_can_be_read() {
    let (directory, _, map) = with_light();
    change(
        &directory,
        "INSERT INTO earlier SELECT 2, 0, 0, 'no such file';
        INSERT INTO earlier SELECT 2, 1, 0, lit FROM light WHERE scene = 2;
        INSERT INTO earlier SELECT 2, -1, 9, lit FROM light WHERE scene = 2;",
    );
    let app = opened(&directory);
    let scene = app.scenes.get(2).unwrap();
    assert!(scene.error().is_none() && !scene.is_damaged());
    let known = scene.earlier.recall(&scene.published().world);
    assert!(known.is_some_and(|known| *known == *map));
    // No edit led to the ninth state.
    let saved = scene.light_record().earlier;
    assert!(saved.base.is_none() && saved.kept.len() == 1 && saved.kept[0].0 == 0);
    app.jobs.close();
}

/// Light that another version of the layout has kept is for other elements, even where these are as many: the scene is
/// there with all else, without it, and is baked anew. Records without a version are of the first.
#[test]
fn light_of_another_layout_is_baked_anew_and_never_read() {
    for (about, is_read) in [
        (format!("json_set(about, '$.layout_version', {})", engine::LAYOUT_VERSION), true),
        ("json_remove(about, '$.layout_version')".to_owned(), false),
        ("json_set(about, '$.layout_version', 1)".to_owned(), false),
        ("json_set(about, '$.layout_version', 0)".to_owned(), false),
        ("json_set(about, '$.layout_version', 77)".to_owned(), false),
    ] {
        let (directory, kept, map) = with_light();
        change(&directory, &format!("UPDATE light SET about = {about}"));
        let app = opened(&directory);
        let scene = app.scenes.get(2).unwrap();
        assert!(scene.error().is_none() && !scene.is_damaged(), "{about}");
        let published = scene.published();
        let warnings = &published.world.scene.warnings;
        let is_told = warnings.iter().any(|warning| warning.contains("layout") && warning.contains("baked anew"));
        assert_eq!(is_told, !is_read, "{about}: {warnings:?}");
        let jobs = app.jobs.older_than(u64::MAX, 9, |job, _| job.scene == 2);
        assert_eq!(jobs.len(), usize::from(!is_read), "{about}");
        assert!(published.version > kept, "{about}");
        match is_read {
            true => assert!(*published.map == *map, "{about}"),
            // A bake may have ended by now, and what it has is its own: no lamp shines.
            false => assert!(published.map.light.direct.iter().all(|light| *light == Vec3::ZERO), "{about}"),
        }
        app.jobs.close();
    }
}
