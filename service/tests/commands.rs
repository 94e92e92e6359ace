//! The commands that talk to a service, against a service that runs here.

use std::path::Path;
use std::process::{Command, Output};

use glam::Vec3;
use rebake::Config;
use rebake_core::export::write_scene_glb;
use rebake_core::scene::{Light, LightKind, Material, Mesh, Object, Scene};
use serde_json::Value;
use tokio::runtime::Runtime;

/// A service on a free port; it ends with its runtime.
struct Service {
    base: String,
    _runtime: Runtime,
}

impl Service {
    fn start() -> Service {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
        let listener = runtime.block_on(tokio::net::TcpListener::bind("127.0.0.1:0")).unwrap();
        let base = format!("http://{}", listener.local_addr().unwrap());
        let config = Config { threads: 2, ..Config::default() };
        runtime.spawn(rebake::run(listener, config, std::future::pending()));
        Service { base, _runtime: runtime }
    }

    fn run(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rebake"));
        command.args(arguments).env("REBAKE_SERVER", &self.base).env_remove("REBAKE_TOKEN");
        command.stdin(std::process::Stdio::null()).output().expect("the binary starts")
    }

    /// Standard output and standard error of a command that has to succeed.
    #[track_caller]
    fn told(&self, arguments: &[&str]) -> (String, String) {
        let done = self.run(arguments);
        let (out, err) = (text(&done.stdout), text(&done.stderr));
        assert!(done.status.success(), "{arguments:?}: {out}{err}");
        (out.trim_end().to_owned(), err)
    }

    #[track_caller]
    fn json(&self, arguments: &[&str]) -> Value {
        serde_json::from_str(&self.told(arguments).0).unwrap()
    }

    /// Standard error of a command that has to end with this status.
    #[track_caller]
    fn refused(&self, status: i32, arguments: &[&str]) -> String {
        let done = self.run(arguments);
        assert_eq!(done.status.code(), Some(status), "{arguments:?}: {}", text(&done.stderr));
        text(&done.stderr)
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn room(folder: &Path) -> String {
    let walls = Mesh::cuboid(Vec3::ZERO, Vec3::new(3.0, 2.4, 3.0)).inside_out();
    let kind = LightKind::Point { position: Vec3::new(1.5, 2.0, 1.5).as_dvec3(), range: None };
    let scene = Scene::from_objects(vec![
        Object::new("walls", walls, Material::diffuse(Vec3::splat(0.7))),
        Object::new("crate", Mesh::cuboid(Vec3::new(0.4, 0.1, 0.5), Vec3::ONE), Material::diffuse(Vec3::splat(0.5))),
    ]);
    let scene = scene.with_light(Light { name: "lamp".to_owned(), kind, color: Vec3::ONE, intensity: 20.0 });
    let path = folder.join("room.glb");
    std::fs::write(&path, write_scene_glb(&scene).unwrap()).unwrap();
    path.to_str().unwrap().to_owned()
}

/// As exporters write them: a document and what it names.
#[test]
fn documents_go_with_the_files_beside_them() {
    let (service, folder) = (Service::start(), tempfile::tempdir().unwrap());
    let glb = std::fs::read(room(folder.path())).unwrap();
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let mut document: Value = serde_json::from_slice(&glb[20..20 + length]).unwrap();
    document["buffers"][0]["uri"] = "data/room.bin".into();
    std::fs::create_dir(folder.path().join("data")).unwrap();
    std::fs::write(folder.path().join("data/room.bin"), &glb[28 + length..]).unwrap();
    let file = folder.path().join("room.gltf");
    std::fs::write(&file, document.to_string()).unwrap();
    let file = file.to_str().unwrap();
    let (id, _) = service.told(&["push", file, "--spacing", "1", "--samples", "4", "--max-albedo", "0.5", "--wait"]);
    let scene = service.json(&["info", &id, "--json"]);
    assert_eq!(scene["objects"].as_array().unwrap().len(), 2);
    let warnings = scene["warnings"].to_string();
    assert!(warnings.contains("an albedo above 0.5"), "{warnings}");
    let (asset, _) = service.told(&["assets", "add", file]);
    service.told(&["edit", &id, "--samples", "1", "insert", file, "--name", "second", "--at", "1,0,1"]);
    assert_eq!(service.json(&["assets", "--json"])[0]["asset"], asset.as_str());
    let picture = folder.path().join("room.png");
    let drawn = ["--samples", "1", "--spp", "1", "--size", "16x9", "--spacing", "1"];
    let eye = ["--eye", "2.5,1.5,2.5", "--target", "0.5,0.5,0.5"];
    service.told(&[&["render", file, "-o", picture.to_str().unwrap()], &drawn[..], &eye[..]].concat());
    assert!(std::fs::read(picture).unwrap().starts_with(b"\x89PNG"));
    let refused = service.refused(2, &["push", file, "--max-albedo", "1"]);
    assert!(refused.contains("at most 0.999"), "{refused}");
}

#[test]
fn a_scene_is_pushed_looked_at_edited_and_deleted() {
    let (service, folder) = (Service::start(), tempfile::tempdir().unwrap());
    let file = room(folder.path());
    let budget = ["--spacing", "1", "--samples", "4", "--max-seconds", "50", "--target-rmse", "0.125"];
    let (id, told) = service.told(&[&["push", file.as_str(), "--wait"], &budget[..]].concat());
    assert!(told.contains("bake done"), "{told}");
    let scene = service.json(&["info", &id, "--json"]);
    let target = &scene["target"];
    assert_eq!((&target["samples_per_element"], &target["target_rmse"]), (&4.into(), &0.125.into()));
    assert_eq!(target["max_seconds"], 50.0);

    let (listed, _) = service.told(&["list"]);
    let mut lines = listed.lines();
    assert!(lines.next().unwrap().starts_with("scene"), "{listed}");
    assert!(lines.next().is_some_and(|line| line.starts_with(&id) && line.ends_with("room")), "{listed}");
    assert_eq!(service.json(&["list", "--json"])[0]["id"], id.as_str());
    let (info, _) = service.told(&["info", &id]);
    for part in ["spacing      1 m", "target       4 samples per element, error 0.1250, 50.0 s", "crate", "lamp"] {
        assert!(info.contains(part), "{part} in {info}");
    }

    // Undo and redo wait for their light, as edits do.
    service.told(&["edit", &id, "--wait", "--samples", "4", "remove", "crate"]);
    let objects = || service.json(&["info", &id, "--json"])["objects"].as_array().unwrap().len();
    assert_eq!(objects(), 1);
    let (job, told) = service.told(&["undo", &id, "--wait", "--samples", "4"]);
    assert!(objects() == 2 && told.contains("edit done"), "{told}");
    service.told(&["redo", &id, "--wait", "--samples", "4"]);
    assert_eq!(objects(), 1);
    let jobs = service.json(&["jobs", &id, "--state", "succeeded", "--json"]);
    assert!(jobs.as_array().unwrap().iter().any(|known| known["id"] == job.as_str()), "{jobs}");
    let (jobs, _) = service.told(&["jobs"]);
    assert!(jobs.lines().any(|line| line.starts_with(&job) && line.contains("100 %")), "{jobs}");
    assert!(service.refused(3, &["cancel", &job]).contains("ended"));

    service.told(&["delete", &id]);
    assert_eq!(service.json(&["list", "--json"]), Value::Array(Vec::new()));
    assert!(service.refused(3, &["info", &id]).contains(&id));
}

#[test]
fn a_job_is_canceled_and_its_end_awaited() {
    let (service, folder) = (Service::start(), tempfile::tempdir().unwrap());
    // Longer than any test: nothing but the cancel ends it.
    let (id, _) = service.told(&["push", &room(folder.path()), "--spacing", "0.1", "--samples", "65536"]);
    let job = service.json(&["info", &id, "--json"])["current_job"].as_str().unwrap().to_owned();
    let (_, told) = service.told(&["cancel", &job, "--wait"]);
    assert_eq!(told.trim_end(), format!("{job}: canceled"));
    assert_eq!(service.json(&["jobs", "--state", "canceled", "--json"])[0]["id"], job.as_str());
}

#[test]
fn assets_are_added_listed_and_deleted() {
    let (service, folder) = (Service::start(), tempfile::tempdir().unwrap());
    let (asset, _) = service.told(&["assets", "add", &room(folder.path())]);
    let (listed, _) = service.told(&["assets"]);
    assert!(listed.lines().any(|line| line.starts_with(&asset) && line.contains("24 triangles")), "{listed}");
    assert_eq!(service.json(&["assets", "--json"])[0]["asset"], asset.as_str());
    service.told(&["assets", "delete", &asset]);
    assert!(service.refused(3, &["assets", "delete", &asset]).contains("no asset"));
}

#[test]
fn colours_above_1_are_not_taken_by_accident() {
    let (service, folder) = (Service::start(), tempfile::tempdir().unwrap());
    let (id, _) = service.told(&["push", &room(folder.path()), "--spacing", "1", "--no-bake"]);
    let relight = ["relight", "lamp", "--color", "255,200,150"];
    let told = service.refused(1, &[&["edit", &id], &relight[..]].concat());
    assert!(told.contains("--color 255,200,150") && told.contains("--yes"), "{told}");
    let told = service.refused(2, &["edit", &id, "material", "crate", "--albedo", "200,30,30"]);
    assert!(told.contains("share of light"), "{told}");
    let accepted = || service.json(&["info", &id, "--json"])["accepted_edits"].clone();
    assert_eq!(accepted(), 0);
    service.told(&[&["edit", &id, "--yes"], &relight[..]].concat());
    service.told(&["edit", &id, "relight", "lamp", "--color", "#ffc896"]);
    assert_eq!(accepted(), 2);
}
