//! A disk that is full at any one step: whoever asked is told, and what was acknowledged stays.

use std::collections::HashSet;
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use rebake::faults::Faults;
use serde_json::{Value, json};

use super::durable::{fast_directory, insert, names, start};
use super::glb::{crate_asset, room};
use super::server::{Answer, Server, path_of};

/// What a client was promised.
#[derive(Default)]
struct Promised {
    scene: Option<String>,
    objects: HashSet<String>,
    asset: Option<String>,
    ended: Option<(String, String)>,
    refused: usize,
}

impl Promised {
    /// The document where the answer is good; a storage problem is the only other one that is allowed.
    fn take(&mut self, answer: &Answer) -> Option<Value> {
        if answer.status.is_success() {
            return Some(serde_json::from_slice(&answer.body).unwrap());
        }
        let detail = answer.problem(503, "storage");
        assert!(detail.contains("the disk is full: nothing has changed"), "{detail}");
        self.refused += 1;
        None
    }
}

/// A short life with every kind of change.
async fn workload(server: &Server) -> Promised {
    let mut promised = Promised::default();
    let asset = promised.take(&server.post_glb("/v1/assets", crate_asset()).await);
    promised.asset = asset.map(|asset| asset["asset"].as_str().unwrap().to_owned());
    let created = server.post_glb("/v1/scenes?spacing=1&samples_per_element=4", room().bytes()).await;
    let Some(scene) = promised.take(&created) else { return promised };
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    promised.objects.extend(["room", "cupboard"].map(str::to_owned));
    if let Some(asset) = promised.asset.clone() {
        let edit = server.post_json(&format!("{}/edits", path_of(&scene)), &insert(&asset, "a")).await;
        if let Some(job) = promised.take(&edit) {
            promised.objects.insert("a".to_owned());
            server.end_of(job["id"].as_str().unwrap()).await;
        }
    }
    let remove = json!({ "op": "remove", "objects": ["cupboard"], "budget": { "samples_per_element": 500 } });
    if let Some(job) = promised.take(&server.post_json(&format!("{}/edits", path_of(&scene)), &remove).await) {
        promised.objects.remove("cupboard");
        let id = job["id"].as_str().unwrap();
        let canceled = server.delete(&format!("/v1/jobs/{id}")).await;
        // On a fast machine it may be done by now.
        if canceled.status != 409 && promised.take(&canceled).is_some() {
            let state = server.end_of(id).await["state"].as_str().unwrap().to_owned();
            promised.ended = Some((id.to_owned(), state));
        }
    }
    promised.scene = Some(path_of(&scene));
    promised
}

async fn check(server: &Server, promised: &Promised, about: &str) {
    // Jobs whose end could not be kept run once more; what their edits changed is shown by then.
    for job in server.get("/v1/jobs").await.json(200)["items"].as_array().unwrap() {
        server.end_of(job["id"].as_str().unwrap()).await;
    }
    let scenes = server.get("/v1/scenes").await.json(200);
    assert_eq!(scenes["items"].as_array().unwrap().len(), usize::from(promised.scene.is_some()), "{about}");
    if let Some(scene) = &promised.scene {
        let scene = server.get(scene).await.json(200);
        assert_eq!(names(&scene).into_iter().map(str::to_owned).collect::<HashSet<_>>(), promised.objects, "{about}");
    }
    if promised.asset.is_some() {
        assert_eq!(server.post_glb("/v1/assets", crate_asset()).await.status, 200, "{about}");
    }
    if let Some((job, state)) = &promised.ended {
        assert_eq!(server.get(&format!("/v1/jobs/{job}")).await.json(200)["state"], state.as_str(), "{about}");
    }
}

/// A server whose disk is full at some of its steps, counted from 0.
async fn faulty(directory: &Path, fails: impl Fn(usize) -> bool + Send + Sync + 'static) -> (Server, Arc<AtomicUsize>) {
    let steps = Arc::new(AtomicUsize::new(0));
    let counted = steps.clone();
    let armed = Arc::new(Mutex::new(false));
    let its_armed = armed.clone();
    let faults = Faults::new(move |_| {
        if !*its_armed.lock().unwrap() {
            return Ok(());
        }
        let step = counted.fetch_add(1, Ordering::SeqCst);
        if fails(step) { Err(io::ErrorKind::StorageFull.into()) } else { Ok(()) }
    });
    let server = Server::with(|config| {
        config.data_dir = Some(directory.to_owned());
        config.faults = faults;
    });
    let server = server.await;
    // Answered once all is restored.
    server.get("/v1/scenes").await.json(200);
    *armed.lock().unwrap() = true;
    (server, steps)
}

#[tokio::test]
async fn a_fault_at_any_write_is_told_and_loses_nothing() {
    let directory = fast_directory();
    let (server, steps) = faulty(directory.path(), |_| false).await;
    let promised = workload(&server).await;
    assert!(promised.refused == 0);
    server.stop().await;
    let count = steps.load(Ordering::SeqCst);
    assert!(count > 30, "{count}");
    for broken in 0..count {
        // One fault, and at some steps a disk that stays full from there on.
        for stays in [false, true].into_iter().take(1 + usize::from(broken % 3 == 0)) {
            let about = format!("step {broken} of {count}, stays full: {stays}");
            let directory = fast_directory();
            let fails = move |step| step == broken || (stays && step > broken);
            let (server, _) = faulty(directory.path(), fails).await;
            let promised = workload(&server).await;
            server.get("/healthz").await.json(200);
            if let Some(scene) = &promised.scene {
                server.get(scene).await.json(200);
            }
            server.stop().await;
            let server = start(directory.path()).await;
            check(&server, &promised, &about).await;
            server.stop().await;
        }
    }
}

/// An insert that could not be kept needs no asset.
#[tokio::test]
async fn an_asset_of_an_insert_that_failed_can_be_deleted() {
    let directory = fast_directory();
    let is_full = Arc::new(AtomicBool::new(false));
    let its_full = is_full.clone();
    let faults = Faults::new(move |_| match its_full.load(Ordering::SeqCst) {
        true => Err(io::ErrorKind::StorageFull.into()),
        false => Ok(()),
    });
    let server = Server::with(|config| {
        config.data_dir = Some(directory.path().to_owned());
        config.faults = faults;
    });
    let server = server.await;
    let asset = server.crate_asset().await;
    let scene = server.room("?bake=false").await;
    let edits = format!("{}/edits", path_of(&scene));
    is_full.store(true, Ordering::SeqCst);
    server.post_json(&edits, &insert(&asset, "a")).await.problem(503, "storage");
    is_full.store(false, Ordering::SeqCst);
    assert_eq!(server.delete(&format!("/v1/assets/{asset}")).await.status, 204);
    server.stop().await;
}
