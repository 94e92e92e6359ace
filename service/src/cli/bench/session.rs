//! A service of the bench's own on loopback, and one scene in it, as a client sees it.

use std::net::Ipv4Addr;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use glam::Vec3;
use rebake::Config;
use rebake::client::types::{Job, JobState, NewScene};
use rebake::client::{Client, DeltaFollower, EditOptions};
use rebake_core::export::write_scene_glb;
use rebake_core::scene::Scene;
use rebake_core::{Edit, Stated, World};
use rebake_lab::bench::{Base, Seen};
use serde_json::{Value, json};
use tokio::net::TcpListener;

/// A baked scene and the client's copy of its light map.
pub(super) struct Session {
    pub(super) client: Client,
    pub(super) scene: String,
    pub(super) follower: DeltaFollower,
}

/// Runs `work` with a service that has baked `world`, and ends the service.
pub(super) fn with_session<T>(world: &World, base: Base, work: impl AsyncFnOnce(Session) -> Result<T>) -> Result<T> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
    runtime.block_on(async {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await?;
        let client = Client::new(&format!("http://{}", listener.local_addr()?))?;
        let mut config = Config { threads: rayon::current_num_threads(), seed: base.seed, ..Config::default() };
        config.defaults.bake_samples = base.samples;
        let work = async { work(Session::open(client, world, base.mode).await?).await };
        rebake::run_while(listener, config, work).await?
    })
}

impl Session {
    async fn open(client: Client, world: &World, mode: Stated) -> Result<Session> {
        let mode = match mode {
            Stated::Full => "full",
            Stated::Indirect => "indirect",
        };
        let new = NewScene { spacing: Some(world.spacing()), mode: Some(mode.to_owned()), ..NewScene::default() };
        let created = client.create_scene(write_scene_glb(&world.scene)?, &new).await?;
        let scene = client.prepared_scene(&created.id).await?;
        let follower = client.follow(&scene.id);
        let mut session = Session { client, follower, scene: scene.id.clone() };
        session.finish(created.job_id().context("the upload started no bake")?).await?;
        session.follower.catch_up().await?;
        Ok(session)
    }

    /// Posts an edit.
    pub(super) async fn edit(&self, body: &Value) -> Result<Job> {
        Ok(self.client.edit(&self.scene, body, &EditOptions::default()).await?)
    }

    /// Waits for the good end of a job.
    pub(super) async fn finish(&self, job: &str) -> Result<Job> {
        let job = self.client.wait_for_job(job, |_| {}).await?;
        ensure!(job.state == JobState::Succeeded, "job {}: {}", job.id, job.error_text().unwrap_or_default());
        Ok(job)
    }

    /// Takes in every version until there is nothing more to come of `job`.
    pub(super) async fn watch(&mut self, job: &str, start: Instant) -> Result<Vec<Seen>> {
        let client = self.client.clone();
        let ended = client.wait_for_job(job, |_| {});
        tokio::pin!(ended);
        let (mut seen, mut last) = (Vec::new(), None);
        while last.is_none_or(|version| self.follower.version() < version) {
            tokio::select! {
                update = self.follower.next() => {
                    update?;
                    seen.push(self.see(start.elapsed()));
                }
                job = &mut ended, if last.is_none() => {
                    let job = job?;
                    ensure!(job.state == JobState::Succeeded, "{}", job.error_text().unwrap_or_default());
                    last = Some(job.progress.version.context("the job published nothing")?);
                }
            }
        }
        Ok(seen)
    }

    /// The client's map as it is.
    pub(super) fn see(&self, after: Duration) -> Seen {
        Seen { seconds: after.as_secs_f64(), values: self.follower.map().to_vec() }
    }

    /// Uploads what is inserted, and writes edits as clients do.
    pub(super) async fn to_json(&self, edits: &[Edit]) -> Result<Vec<Value>> {
        let mut list = Vec::new();
        for edit in edits {
            list.push(match edit {
                Edit::Insert { asset, name, transform } => {
                    let asset = self.upload(asset).await?;
                    json!({"op": "insert", "asset": asset, "name": name, "transform": transform.to_cols_array()})
                }
                Edit::Remove { objects } => json!({"op": "remove", "objects": objects}),
                Edit::Move { object, transform } => {
                    json!({"op": "move", "object": object, "transform": transform.to_cols_array()})
                }
                Edit::Material { object, albedo } => {
                    json!({"op": "material", "object": object, "albedo": albedo.to_array()})
                }
                other => anyhow::bail!("cases have no such edit: {other:?}"),
            });
        }
        Ok(list)
    }

    async fn upload(&self, asset: &Scene) -> Result<String> {
        Ok(self.client.create_asset(write_scene_glb(asset)?).await?)
    }

    /// The service must have cut the same scene into the same elements, or nothing could be compared.
    pub(super) async fn check_layout(&self, world: &World) -> Result<()> {
        let records = self.client.elements(&self.scene).await?;
        let (records, rest) = records.as_chunks::<32>();
        ensure!(
            rest.is_empty() && records.len() == world.slots(),
            "the service has {} elements, not {}",
            records.len(),
            world.slots()
        );
        let number = |record: &[u8; 32], k: usize| {
            f32::from_le_bytes([record[4 * k], record[4 * k + 1], record[4 * k + 2], record[4 * k + 3]])
        };
        let origin = world.scene.origin;
        for (slot, record) in records.iter().enumerate().filter(|(slot, _)| world.areas()[*slot] > 0.0) {
            let here = (world.positions()[slot].as_dvec3() + origin).as_vec3();
            let there = Vec3::new(number(record, 0), number(record, 1), number(record, 2));
            ensure!(here.distance(there) < 0.01 * world.spacing(), "element {slot} lies elsewhere in the service");
        }
        Ok(())
    }
}
