//! Kill -9 at random moments of a random workload: whatever was acknowledged is there afterwards.
//!
//! `REBAKE_KILLS=200 cargo test -p rebake-tests crash` kills 200 times; `REBAKE_SEED` chooses the workload.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::{Duration, Instant};

use glam::Vec3;
use rebake::client::DeltaFollower;
use serde_json::{Value, json};

use super::durable::fast_directory;
use super::glb::{crate_asset, room, translation};
use super::process::Service;
use super::server::{Server, patiently};

fn start(directory: &Path) -> Service {
    let directory = format!("data-dir={}", directory.display());
    // No job is forgotten while this test still asks for it.
    Service::start(&[&directory, "save-ms=5", "finished-jobs=1000000"])
}

/// What a client knows of a scene.
#[derive(Default)]
struct Known {
    /// Objects after all acknowledged edits.
    objects: BTreeSet<String>,
    /// An edit without an answer: its key, its body, and what it does.
    pending: Option<(String, Value, Change)>,
    map: Vec<Vec3>,
    version: u64,
    inserted: usize,
}

#[derive(Clone)]
enum Change {
    Inserts(String),
    Removes(String),
    Nothing,
}

impl Known {
    fn take(&mut self, change: Change) {
        match change {
            Change::Inserts(name) => assert!(self.objects.insert(name)),
            Change::Removes(name) => assert!(self.objects.remove(&name)),
            Change::Nothing => {}
        }
    }
}

/// The client's side of the workload.
struct Workload {
    dice: u64,
    asset: Option<String>,
    scenes: BTreeMap<String, Known>,
    /// Jobs by id, with their state where they were seen to have ended.
    jobs: BTreeMap<String, Option<String>>,
    /// An upload or a deletion without an answer: there may be a scene more or less.
    uploading: bool,
    deleting: Option<String>,
    acknowledged: usize,
}

impl Workload {
    fn roll(&mut self, sides: u64) -> u64 {
        self.dice = self.dice.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.dice >> 33) % sides
    }

    /// Requests, one after the other, until the service is gone.
    async fn run(&mut self, server: &Server) {
        loop {
            let went_well = match self.roll(12) {
                _ if self.asset.is_none() => self.upload_asset(server).await,
                _ if self.scenes.is_empty() => self.upload(server).await,
                0 if self.scenes.len() < 4 => self.upload(server).await,
                1 if self.scenes.len() > 2 => self.delete(server).await,
                2 | 3 => self.look(server).await,
                4 => self.cancel(server).await,
                _ => self.edit(server).await,
            };
            if went_well.is_none() {
                return;
            }
            self.acknowledged += 1;
        }
    }

    async fn upload_asset(&mut self, server: &Server) -> Option<()> {
        self.asset = Some(server.client.create_asset(crate_asset()).await.ok()?);
        Some(())
    }

    async fn upload(&mut self, server: &Server) -> Option<()> {
        self.uploading = true;
        let request = server.request(reqwest::Method::POST, "/v1/scenes?spacing=1&samples_per_element=4");
        let request = request.header("content-type", "model/gltf-binary").body(room().bytes());
        let scene = answer(request, 201).await?;
        self.uploading = false;
        self.jobs.insert(text(&scene["current_job"]), None);
        let objects = BTreeSet::from(["room".to_owned(), "cupboard".to_owned()]);
        self.scenes.insert(text(&scene["id"]), Known { objects, ..Known::default() });
        Some(())
    }

    async fn delete(&mut self, server: &Server) -> Option<()> {
        let scene = self.pick();
        self.scenes.remove(&scene);
        self.deleting = Some(scene.clone());
        server.client.delete_scene(&scene).await.ok()?;
        self.deleting = None;
        Some(())
    }

    async fn edit(&mut self, server: &Server) -> Option<()> {
        let (scene, roll) = (self.pick(), self.roll(3));
        let asset = self.asset.clone()?;
        let known = self.scenes.get_mut(&scene)?;
        known.inserted += 1;
        let (mut body, change) = match roll {
            0 if known.objects.len() > 2 => {
                let name = known.objects.iter().find(|name| name.starts_with('a'))?.clone();
                (json!({ "op": "remove", "objects": [name] }), Change::Removes(name))
            }
            1 => (json!({ "op": "material", "object": "room", "albedo": [0.4, 0.5, 0.6] }), Change::Nothing),
            _ => {
                let (name, at) = (format!("a{}", known.inserted), translation(2.0, 0.01, 2.0));
                (json!({ "op": "insert", "asset": asset, "name": name, "transform": at }), Change::Inserts(name))
            }
        };
        body["budget"] = json!({ "samples_per_element": 4 });
        known.pending = Some((format!("{scene}-{}", known.inserted), body, change));
        self.post_pending(server, &scene).await
    }

    /// Posts the edit that has no answer yet, for the first time or again.
    async fn post_pending(&mut self, server: &Server, scene: &str) -> Option<()> {
        let (key, body, change) = self.scenes.get(scene)?.pending.clone()?;
        let request = server.request(reqwest::Method::POST, &format!("/v1/scenes/{scene}/edits"));
        let request = request.header("content-type", "application/json").header("idempotency-key", key);
        let response = request.body(body.to_string()).send().await.ok()?;
        let status = response.status();
        let job: Value = serde_json::from_slice(&response.bytes().await.ok()?).ok()?;
        let known = self.scenes.get_mut(scene)?;
        known.pending = None;
        if status == 429 {
            return Some(());
        }
        assert_eq!(status, 202, "{job}");
        known.take(change);
        self.jobs.insert(text(&job["id"]), None);
        Some(())
    }

    async fn look(&mut self, server: &Server) -> Option<()> {
        let scene = self.pick();
        let known = self.scenes.get_mut(&scene)?;
        let mut follower = DeltaFollower::resume(server.client.clone(), &scene, known.map.clone(), known.version);
        let result = follower.catch_up().await;
        (known.map, known.version) = follower.into_map();
        result.ok()?;
        let page = answer(server.request(reqwest::Method::GET, "/v1/jobs?limit=20"), 200).await?;
        for job in page["items"].as_array().unwrap().iter().filter(|job| job["finished_at"].is_string()) {
            self.jobs.insert(text(&job["id"]), Some(text(&job["state"])));
        }
        Some(())
    }

    async fn cancel(&mut self, server: &Server) -> Option<()> {
        let open: Vec<String> = self.jobs.iter().filter(|(_, end)| end.is_none()).map(|(id, _)| id.clone()).collect();
        let Some(job) = open.last() else { return Some(()) };
        let response = server.request(reqwest::Method::DELETE, &format!("/v1/jobs/{job}")).send().await.ok()?;
        let status = response.status();
        response.bytes().await.ok()?;
        if status == 200 {
            self.jobs.insert(job.clone(), Some("canceled".to_owned()));
        }
        Some(())
    }

    fn pick(&mut self) -> String {
        let n = self.roll(self.scenes.len() as u64) as usize;
        self.scenes.keys().nth(n).cloned().unwrap_or_default()
    }

    /// After a restart: all that was acknowledged is there, and nothing else that was not asked for.
    async fn check(&mut self, server: &Server) {
        if self.asset.is_some() {
            assert_eq!(server.post_glb("/v1/assets", crate_asset()).await.status, 200, "the asset is there");
        }
        for scene in self.scenes.keys().cloned().collect::<Vec<_>>() {
            // Safe to repeat: applied once, whether it had been accepted or not.
            if self.scenes[&scene].pending.is_some() {
                self.post_pending(server, &scene).await.unwrap();
            }
        }
        let listed = server.get("/v1/scenes?limit=100").await.json(200);
        let listed: BTreeSet<String> = listed["items"].as_array().unwrap().iter().map(|s| text(&s["id"])).collect();
        let known: BTreeSet<String> = self.scenes.keys().cloned().collect();
        assert!(known.is_subset(&listed), "{known:?} {listed:?}");
        let deleting = self.deleting.take();
        let surplus: Vec<&String> = listed.difference(&known).filter(|id| deleting.as_ref() != Some(*id)).collect();
        assert!(surplus.len() <= usize::from(self.uploading), "{surplus:?}");
        for scene in listed.difference(&known) {
            server.client.delete_scene(scene).await.unwrap();
        }
        self.uploading = false;
        self.check_jobs(server).await;
        for (id, known) in &mut self.scenes {
            let scene = server.get(&format!("/v1/scenes/{id}")).await.json(200);
            let objects = scene["objects"].as_array().unwrap().iter().map(|object| text(&object["name"]));
            assert_eq!(objects.collect::<BTreeSet<_>>(), known.objects, "{id}");
            assert_eq!(scene["error"], json!(null));
            assert!(scene["version"].as_u64().unwrap() >= known.version, "{id}");
            let map = std::mem::take(&mut known.map);
            let mut follower = DeltaFollower::resume(server.client.clone(), id, map, known.version);
            follower.catch_up().await.unwrap();
            let mut fresh = server.client.follow(id);
            fresh.catch_up().await.unwrap();
            assert_eq!((follower.version(), follower.map()), (fresh.version(), fresh.map()), "{id}: never a wrong map");
            (known.map, known.version) = follower.into_map();
        }
    }

    async fn check_jobs(&mut self, server: &Server) {
        for (id, end) in &self.jobs {
            let answer = server.get(&format!("/v1/jobs/{id}")).await;
            // Jobs of a scene that is gone may be gone with it.
            if answer.status == 404 && end.is_none() {
                continue;
            }
            let state = text(&answer.json(200)["state"]);
            match end {
                Some(end) => assert_eq!(state, *end, "{id}"),
                None => assert_ne!(server.end_of(id).await["state"], "failed", "{id}"),
            }
        }
        // Old jobs are forgotten sooner or later.
        while self.jobs.len() > 100 {
            self.jobs.pop_first();
        }
    }
}

async fn answer(request: reqwest::RequestBuilder, status: u16) -> Option<Value> {
    let response = request.send().await.ok()?;
    assert_eq!(response.status(), status);
    serde_json::from_slice(&response.bytes().await.ok()?).ok()
}

fn text(value: &Value) -> String {
    value.as_str().unwrap().to_owned()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn kills_at_random_moments_lose_nothing_that_was_acknowledged() {
    let number = |name: &str, default| std::env::var(name).ok().map_or(default, |text| text.parse().unwrap());
    let (kills, seed) = (number("REBAKE_KILLS", 10), number("REBAKE_SEED", 1));
    let directory = fast_directory();
    let mut workload = Workload {
        dice: seed,
        asset: None,
        scenes: BTreeMap::new(),
        jobs: BTreeMap::new(),
        uploading: false,
        deleting: None,
        acknowledged: 0,
    };
    let started = Instant::now();
    for kill in 0..kills {
        let service = start(directory.path());
        let delay = Duration::from_millis(workload.roll(120));
        let alive = async {
            patiently(workload.check(&service.server)).await;
            let _ = tokio::time::timeout(delay, workload.run(&service.server)).await;
        };
        alive.await;
        service.kill();
        assert!(started.elapsed() < Duration::from_secs(3600), "kill {kill} took too long");
    }
    let service = start(directory.path());
    workload.check(&service.server).await;
    service.kill();
    eprintln!(
        "{kills} kills in {:.1} s, {} acknowledged requests, seed {seed}: nothing lost",
        started.elapsed().as_secs_f64(),
        workload.acknowledged
    );
}
