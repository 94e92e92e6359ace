//! What clients see of a bake before its first round: an estimate, in place of a black map, that nothing is left of.

use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use glam::Vec3;
use rebake::engine::{Budget, Canceled, CoreEngine, Engine, LightMap, Observer, Progress, Snapshot, World};
use rebake_core::Unobserved;
use rebake_core::delta::Frame;

use super::deltas::{Follower, open};
use super::glb;
use super::server::{Server, path_of};

/// The real engine, whose bakes wait behind their estimate until they are let go.
#[derive(Debug, Default)]
struct Waiting {
    is_let_go: Mutex<bool>,
    let_go: Condvar,
    /// The light map of a bake that nobody looks on at, with the inputs and the seed of the last observed one.
    unobserved: Mutex<Option<Arc<LightMap>>>,
}

/// The observer of such a bake.
struct Behind<'a>(&'a Waiting, &'a dyn Observer);

impl Observer for Behind<'_> {
    fn canceled(&self) -> bool {
        self.1.canceled()
    }

    fn progress(&self, progress: &Progress) {
        self.1.progress(progress);
    }

    fn plan_round(&self, so_far: &Progress, proposed: u32) -> u32 {
        self.1.plan_round(so_far, proposed)
    }

    fn wants_estimates(&self) -> bool {
        self.1.wants_estimates()
    }

    fn snapshot(&self, map: &Arc<LightMap>, snapshot: Snapshot, progress: &Progress) {
        self.1.snapshot(map, snapshot, progress);
        if snapshot != Snapshot::Estimate {
            return;
        }
        let mut is_let_go = self.0.is_let_go.lock().unwrap();
        while !*is_let_go && !self.canceled() {
            (is_let_go, _) = self.0.let_go.wait_timeout(is_let_go, Duration::from_millis(5)).unwrap();
        }
    }
}

impl Engine for Waiting {
    fn bake(&self, world: &World, budget: &Budget, seed: u64, o: &dyn Observer) -> Result<Arc<LightMap>, Canceled> {
        *self.unobserved.lock().unwrap() = Some(CoreEngine.bake(world, budget, seed, &Unobserved)?);
        CoreEngine.bake(world, budget, seed, &Behind(self, o))
    }
}

#[tokio::test]
async fn a_bake_is_shown_with_an_ambient_term_until_its_first_round_is_done() {
    let engine = Arc::new(Waiting::default());
    let server = Server::with(|config| config.engine = engine.clone()).await;
    let glb = glb::room().point_light("lamp-2", [1.0, 2.5, 3.0], 10.0).bytes();
    let path = "/v1/scenes?spacing=0.3&samples_per_element=16&layers=each";
    let scene = server.post_glb(path, glb).await.json(201);
    let job = scene["current_job"].as_str().unwrap();
    let mut stream = open(&server, &scene, "since=0&follow=true").await;
    let job_now = server.until(job, |job| job["progress"]["version"].is_u64()).await;
    assert_eq!((&job_now["state"], &job_now["progress"]["samples_per_element"]), (&"running".into(), &0.into()));

    // The first light that a client gets: not black, and without a stated error.
    let mut follower = Follower::default();
    follower.reach(&mut stream, job_now["progress"]["version"].as_u64().unwrap()).await;
    let shown = server.get(&path_of(&scene)).await.json(200);
    assert!(shown["estimated_rmse"].is_null(), "{shown}");
    assert_eq!(shown["layers"].as_array().map(Vec::len), Some(2), "{shown}");
    let first = follower.map.clone();
    let indirect = server.get(&format!("{}/lightmap?format=raw&layer=lamp-2&part=indirect", path_of(&scene))).await;
    let indirect = Frame::decode(&indirect.body).unwrap().0.values;
    let ambient = indirect.iter().find(|light| **light != Vec3::ZERO).expect("light after a bounce");
    assert!(
        indirect.iter().all(|light| *light == Vec3::ZERO || light == ambient),
        "one ambient term for all of a layer"
    );
    assert!(first.iter().filter(|light| light.min_element() > 0.0).count() > first.len() / 2);

    *engine.is_let_go.lock().unwrap() = true;
    engine.let_go.notify_all();
    assert_eq!(server.end_of(job).await["state"], "succeeded");
    let end = server.get(&path_of(&scene)).await.json(200);
    assert!(end["estimated_rmse"].as_f64().is_some_and(|rmse| rmse > 0.0), "{end}");
    follower.reach(&mut stream, end["version"].as_u64().unwrap()).await;
    assert_ne!(follower.map, first);
    let unobserved = engine.unobserved.lock().unwrap().clone().expect("a bake");
    let wanted: Vec<Vec3> = (0..unobserved.len()).map(|slot| unobserved.total(slot)).collect();
    assert_eq!(follower.map, wanted, "the estimate has left a trace");
}
