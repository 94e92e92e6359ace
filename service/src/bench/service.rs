//! The same edit through the service, over loopback: upload, bake, POST of the edit, download. What clients get.

use std::net::Ipv4Addr;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use glam::Vec3;
use rebake_core::export::write_scene_glb;
use rebake_core::scene::Scene;
use rebake_core::{Edit, LightMap, World};
use serde_json::{Value, json};
use tokio::net::TcpListener;

use super::{Goal, Mode, PreparedCase, Timed};
use crate::Config;
use crate::client::types::{Job, JobState, NewScene};
use crate::client::{Client, EditOptions};

/// Runs a case's edit through a service of its own whose bake takes `base_samples` samples per element. Seconds are from
/// the POST of the edit to the end of its job; the light map is what a client that starts to follow the scene then
/// gets, all of it in the part that `mode` measures.
pub fn run_service(case: &PreparedCase, base_samples: u32, goal: Goal, mode: Mode, seed: u64) -> Result<Timed> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
    runtime.block_on(async {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await?;
        let client = Client::new(&format!("http://{}", listener.local_addr()?))?;
        let mut config = Config { threads: rayon::current_num_threads(), seed, ..Config::default() };
        config.defaults.bake_samples = base_samples;
        crate::run_while(listener, config, through(&client, case, goal, mode)).await?
    })
}

async fn through(client: &Client, case: &PreparedCase, goal: Goal, mode: Mode) -> Result<Timed> {
    let mode_name = match mode {
        Mode::Full => "full",
        Mode::Indirect => "indirect",
    };
    let new =
        NewScene { spacing: Some(case.before.spacing()), mode: Some(mode_name.to_owned()), ..NewScene::default() };
    let scene = client.create_scene(write_scene_glb(&case.before.scene)?, &new).await?;
    let bake = scene.job_id().context("the upload started no bake")?.to_owned();
    finish(client, &bake).await?;
    let edits = to_json(client, &case.edits).await?;
    let mut body = json!({ "edits": edits });
    body["budget"] = match goal {
        Goal::Seconds(seconds) => json!({ "max_seconds": seconds }),
        Goal::Samples(samples) => json!({ "samples_per_element": samples }),
    };
    let start = Instant::now();
    let job = client.edit(&scene.id, &body, &EditOptions::default()).await?;
    let job = finish(client, &job.id).await?;
    let seconds = start.elapsed().as_secs_f64();
    check_layout(&case.after, &client.elements(&scene.id).await?)?;
    let mut follower = client.follow(&scene.id);
    follower.catch_up().await?;
    let (values, _) = follower.into_map();
    client.delete_scene(&scene.id).await?;
    Ok(Timed {
        map: Arc::new(as_map(values, mode)),
        seconds,
        cpu_seconds: None,
        samples: job.progress.samples_per_element.unwrap_or(0) as u32,
        rays: 0,
        estimated_rmse: job.progress.estimated_rmse.map(|rmse| rmse as f32),
    })
}

async fn finish(client: &Client, job: &str) -> Result<Job> {
    let job = client.wait_for_job(job, |_| {}).await?;
    ensure!(job.state == JobState::Succeeded, "job {}: {}", job.id, job.error_text().unwrap_or_default());
    Ok(job)
}

fn as_map(values: Vec<Vec3>, mode: Mode) -> LightMap {
    let black = LightMap::black(values.len());
    match mode {
        Mode::Full => LightMap { direct: values, ..black },
        Mode::Indirect => LightMap { indirect: values, ..black },
    }
}

/// Uploads what is inserted, and writes edits as clients do.
async fn to_json(client: &Client, edits: &[Edit]) -> Result<Vec<Value>> {
    let mut list = Vec::new();
    for edit in edits {
        list.push(match edit {
            Edit::Insert { asset, name, transform } => {
                let asset = upload(client, asset).await?;
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

async fn upload(client: &Client, asset: &Scene) -> Result<String> {
    Ok(client.create_asset(write_scene_glb(asset)?).await?)
}

/// The service must have cut the same scene into the same elements, or nothing could be compared.
fn check_layout(world: &World, records: &[u8]) -> Result<()> {
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
