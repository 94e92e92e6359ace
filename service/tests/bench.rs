//! `rebake bench` as a whole: a scene and edits made here, the report read back.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use glam::{DMat4, DVec3, Vec3};
use rebake_core::export::write_scene_glb;
use rebake_core::scene::{Material, Mesh, Object, Scene};
use serde_json::{Value, json};

/// A folder of its own, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Folder {
        let path = std::env::temp_dir().join(format!("rebake-bench-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).expect("a folder");
        Folder(path)
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.0.join(name);
        std::fs::write(&path, bytes).expect("a file");
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // A folder left in the temporary directory harms nobody.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn cube(name: &str, low: Vec3, size: Vec3, albedo: f32) -> Object {
    Object::new(name, Mesh::cuboid(low, low + size), Material::diffuse(Vec3::splat(albedo)))
}

/// A closed room with two crates and a lamp.
fn room() -> Scene {
    let walls = Mesh::cuboid(Vec3::ZERO, Vec3::new(3.0, 2.4, 3.0)).inside_out();
    let lamp = Mesh::quad(Vec3::new(1.1, 2.3, 1.1), Vec3::X * 0.8, Vec3::Z * 0.8);
    Scene::from_objects(vec![
        Object::new("walls", walls, Material::diffuse(Vec3::splat(0.7))),
        cube("crate_1", Vec3::new(0.4, 0.0, 0.5), Vec3::new(0.8, 0.9, 0.6), 0.5),
        cube("crate_2", Vec3::new(1.9, 0.0, 1.6), Vec3::new(0.7, 1.1, 0.7), 0.2),
        Object::new("lamp", lamp, Material::emissive(Vec3::splat(10.0))),
    ])
}

fn bench(scene: &Path, edits: &Path, more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_rebake"))
        .arg("bench")
        .args([scene, edits])
        .args(more)
        .args(["--spacing", "0.2", "--threads", "2"])
        .output()
        .expect("the binary starts")
}

fn number(value: &Value, field: &str) -> f64 {
    value[field].as_f64().unwrap_or_else(|| panic!("{field} of {value}"))
}

/// Names of an object's fields: part of the contract.
fn keys(value: &Value) -> Vec<&str> {
    let mut keys: Vec<&str> = value.as_object().expect("an object").keys().map(String::as_str).collect();
    keys.sort_unstable();
    keys
}

#[test]
fn a_bench_measures_every_method_on_every_case() {
    let folder = Folder::new("whole");
    let scene = folder.write("room.glb", write_scene_glb(&room()).expect("a scene"));
    let ball = Scene::from_objects(vec![cube("thing", Vec3::splat(-0.25), Vec3::splat(0.5), 0.4)]);
    std::fs::create_dir_all(folder.0.join("assets")).expect("a folder");
    folder.write("assets/thing.glb", write_scene_glb(&ball).expect("an asset"));
    let place = DMat4::from_translation(DVec3::new(2.0, 0.25, 0.7)).to_cols_array();
    let edits = folder.write(
        "edits.json",
        json!({"scene": "room.glb", "cases": [
            {"name": "+ crates", "edit": "insert", "objects": ["crate_*"]},
            {"name": "- crate", "edit": "remove", "objects": ["crate_2"]},
            {"name": "move crate", "edit": "move", "objects": ["crate_2"],
             "transform": DMat4::from_translation(DVec3::new(-0.3, 0.0, -0.9)).to_cols_array()},
            {"name": "white crate", "edit": "material", "objects": ["crate_2"], "albedo": [0.9, 0.9, 0.9]},
            {"name": "+ thing", "edit": "insert", "asset": "assets/thing.glb", "transform": place},
        ]})
        .to_string(),
    );
    let output = folder.0.join("report.json");
    let done = bench(
        &scene,
        &edits,
        &[
            "--budget-seconds=0.3",
            "--methods=path-trace,cached,paper,rebake",
            "--seeds=2",
            "--reference-samples=256",
            "--reference-elements=800",
            "--base-samples=128",
            "--mode=full",
            "-o",
            output.to_str().expect("a path"),
        ],
    );
    let errors = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{errors}");
    let table = String::from_utf8(done.stdout).expect("text");
    let report: Value = serde_json::from_slice(&std::fs::read(&output).expect("a report")).expect("JSON");
    assert_eq!(keys(&report), ["cases", "elements", "mode", "scene", "seeds", "spacing", "threads"]);
    assert!(report["scene"] == "room.glb" && report["elements"].as_u64() > Some(500) && report["threads"] == 2);
    let cases = report["cases"].as_array().expect("cases");
    assert_eq!(cases.len(), 5);
    for case in cases {
        check_case(case);
        assert!(table.contains(case["name"].as_str().expect("a name")), "{table}");
    }
    let plot = std::fs::read_to_string(folder.0.join("report.svg")).expect("a plot");
    assert!(plot.starts_with("<svg") && plot.trim_end().ends_with("</svg>"));
    assert_eq!(plot.matches("no update").count(), 5, "a line per case");
}

/// `rebake bench --measure WHAT` on a move of a crate, with so many options as make it quick; the report and its table.
fn study(folder: &Folder, what: &str, more: &[&str]) -> (Value, String) {
    let scene = folder.write("room.glb", write_scene_glb(&room()).expect("a scene"));
    let place = DMat4::from_translation(DVec3::new(-0.6, 0.0, -0.9)).to_cols_array();
    let case = json!({"name": "crate", "edit": "move", "objects": ["crate_2"], "transform": place});
    let edits = folder.write("edits.json", json!({"scene": "room.glb", "cases": [case]}).to_string());
    let output = folder.0.join("report.json");
    let quick = ["--seeds=1", "--reference-samples=128", "--reference-elements=400", "--base-samples=128"];
    let path = output.to_str().expect("a path");
    let options: Vec<&str> = ["--measure", what, "-o", path].iter().chain(&quick).chain(more).copied().collect();
    let done = bench(&scene, &edits, &options);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let plot = std::fs::read_to_string(folder.0.join("report.svg")).expect("a plot");
    assert!(plot.starts_with("<svg") && plot.matches("<polyline").count() == 2, "{plot}");
    let report = std::fs::read(&output).expect("a report");
    (serde_json::from_slice(&report).expect("JSON"), String::from_utf8(done.stdout).expect("text"))
}

fn errors(curve: &Value) -> Vec<f64> {
    curve["points"].as_array().expect("points").iter().map(|point| number(point, "rmse")).collect()
}

#[test]
fn a_focus_is_measured_as_a_client_sees_it() {
    let folder = Folder::new("focus");
    let focus = json!({"point": [2.2, 0.0, 2.0], "radius": 0.8}).to_string();
    let (report, table) = study(&folder, "focus", &["--samples=16", "--focus", &focus]);
    let head = ["cases", "elements", "mode", "scene", "seeds", "spacing", "study", "threads"];
    assert!(keys(&report) == head && report["scene"] == "room.glb", "{report}");
    let case = &report["cases"][0];
    assert_eq!(keys(case), ["about", "curves", "name", "reference", "times"]);
    for curve in case["curves"].as_array().expect("curves") {
        let errors = errors(curve);
        assert!(errors.last() < errors.first(), "no better than the old light: {curve}");
    }
    let times = case["times"].as_array().expect("times");
    assert!(times.iter().any(|time| time["ratio"].is_number()), "{case}");
    assert!(table.contains("with focus") && table.contains("crate"), "{table}");
}

#[test]
fn a_drag_is_measured_beside_baking_again_and_again() {
    let folder = Folder::new("drag");
    let (report, table) = study(&folder, "drag", &["--moves=6"]);
    let curves = report["cases"][0]["curves"].as_array().expect("curves");
    let labels: Vec<_> = curves.iter().map(|curve| curve["label"].as_str().expect("a label")).collect();
    assert_eq!(labels, ["update", "re-baking"]);
    for curve in curves {
        let errors = errors(curve);
        // 0.6 s of moves and two at rest, twenty points a second.
        assert!(errors.len() == 53 && errors.iter().all(|rmse| rmse.is_finite()), "{curve}");
        assert!(errors[52] < errors[0], "at rest it is worse than right after the first move: {curve}");
        assert!(number(curve, "mean_rmse") > 0.0);
    }
    assert!(table.contains("while dragged"), "{table}");
}

fn check_case(case: &Value) {
    let name = case["name"].as_str().expect("a name");
    let reference = &case["reference"];
    let (noise, samples) = (number(reference, "rmse_noise"), number(reference, "samples_per_element"));
    assert!(noise > 0.0 && samples == 256.0, "{reference}");
    let untouched = number(case, "no_update_rmse");
    let fields = ["base", "edited_share", "elements", "name", "no_update_rmse", "reference", "runs"];
    assert_eq!(keys(case), fields, "{name}");
    let runs = case["runs"].as_array().expect("runs");
    let methods: Vec<_> = runs.iter().map(|run| run["method"].as_str().expect("a name")).collect();
    assert_eq!(methods, ["path-trace", "cached", "paper", "rebake"], "{name}");
    for run in runs {
        assert!(number(run, "seconds") > 0.0 && number(run, "rays") > 1000.0, "{name}: {run}");
        assert!(number(run, "samples_per_element") >= 1.0 && run["bias_floor"].is_number(), "{name}: {run}");
    }
    // What this is all about: an update is nearer to the truth than the map before it, and by more than noise.
    let rebake = &runs[3];
    let (rmse, error) = (number(rebake, "rmse"), number(rebake, "rmse_error"));
    assert!(rmse + 3.0 * error < untouched, "{name}: {rmse} ± {error} against {untouched} without an update");
    // No gain is told where the error drowns in the reference's noise.
    assert!(rmse == 0.0 || number(rebake, "gain") > 1.0, "{name}: worse than path tracing in the same time");
}

#[test]
fn faults_are_named_with_their_field() {
    let folder = Folder::new("faults");
    let scene = folder.write("room.glb", write_scene_glb(&room()).expect("a scene"));
    let output = folder.0.join("report.json");
    let of = |case: Value| json!({"scene": "room.glb", "cases": [case]});
    for (edits, expected) in [
        (json!({"scene": "room.glb", "cases": []}), "cases: is empty"),
        (of(json!({"name": "x", "edit": "explode", "objects": ["lamp"]})), "cases[0].edit: unknown variant"),
        (of(json!({"name": "x", "edit": "remove", "object": "lamp"})), "cases[0].object: unknown field"),
        (of(json!({"name": "x", "edit": "remove"})), "cases[0] (\"x\"): objects: name at least one"),
        (of(json!({"name": "x", "edit": "remove", "objects": ["sofa_*"]})), "objects[0]: the scene has no object"),
        (of(json!({"name": "x", "edit": "insert"})), "or give an asset"),
        (of(json!({"name": "x", "edit": "insert", "asset": "none.glb"})), "asset: cannot load"),
        (of(json!({"name": "x", "edit": "move", "objects": ["crate_1"]})), "transform: is missing"),
        (of(json!({"name": "x", "edit": "move", "objects": ["crate_1"], "transform": [1, 2]})), "cases[0].transform"),
        (of(json!({"name": "x", "edit": "material", "objects": ["crate_1"]})), "albedo: is missing"),
        (
            of(json!({"name": "x", "edit": "material", "objects": ["crate_1"], "albedo": [2, 0, 0]})),
            "albedo: must hold",
        ),
    ] {
        let path = folder.write("edits.json", edits.to_string());
        let done = bench(&scene, &path, &["-o", output.to_str().expect("a path")]);
        let errors = String::from_utf8_lossy(&done.stderr);
        assert!(!done.status.success() && errors.contains(expected), "{edits}: {errors}");
        assert!(!output.exists(), "{edits}: a report of nothing");
    }
}
