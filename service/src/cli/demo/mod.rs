//! `rebake demo`: the service on a built-in room, used as any client uses it, and measured.

mod pictures;
mod room;

use std::net::SocketAddr;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use glam::Vec3;
use rebake::client::types::{Job, NewScene};
use rebake::client::{Client, DeltaFollower, EditOptions};
use rebake_core::export::write_scene_glb;
use rebake_core::scene::{LoadLimits, Scene, load};
use rebake_core::{Edit, Relight, World, WorldOptions};
use rebake_lab::truth::{Comparison, compare};
use serde_json::{Value, json};

use super::exit::Interrupted;
use super::remote::{ProgressFeed, wait_for_job};
use super::serve;
use super::ui::{self, Table};
use super::values::positive;
use pictures::Pictures;

const AFTER_HELP: &str = "\
Where a terminal is attached the service goes on running afterwards, to be tried with `rebake watch`, `rebake edit` \
or curl; --exit ends it. Nothing is written to disk unless --save asks for it.
  rebake demo
  rebake demo --exit --spacing 0.1
  rebake demo --save demo                  room.glb, chair.glb and the last light map, to start from
  rebake demo --exit --pictures docs       the pictures of the README";

const HEADINGS: [&str; 9] =
    ["step", "elements", "rays", "first light", "done", "stated error", "error", "path tracing", "ratio"];
const WIDTHS: [usize; 9] = [12, 8, 7, 11, 7, 12, 16, 12, 7];

/// The room with its chair, and its spacing: what `rebake bench` measures without a file.
pub(super) fn bench_scene() -> (rebake_core::scene::Scene, f32) {
    let mut scene = room::room();
    let chair = room::chair().objects.into_iter().map(Arc::unwrap_or_clone);
    scene.objects.extend(chair.map(|part| Arc::new(part.placed(room::chair_place()))));
    (scene, room::SPACING)
}

/// Arguments of `rebake demo`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub(super) struct DemoArgs {
    /// End the service after the last step
    #[arg(long)]
    exit: bool,
    /// Address and port [default: 127.0.0.1:7878, with --exit a free port]
    #[arg(long, value_name = "ADDRESS")]
    listen: Option<SocketAddr>,
    /// Largest distance between neighbouring elements, metres
    #[arg(long, value_name = "METRES", default_value_t = f64::from(room::SPACING), value_parser = positive)]
    spacing: f64,
    /// Threads that compute [default: one per core]
    #[arg(long, value_name = "N", env = "REBAKE_THREADS")]
    threads: Option<NonZeroUsize>,
    /// Write the room, the chair and the last light map into this directory
    #[arg(long, value_name = "DIR")]
    save: Option<PathBuf>,
    /// Write pictures of the room before and after the edits, of the change and of the stated error into this directory
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
}

/// Runs the demo.
pub(super) async fn demo(args: DemoArgs) -> anyhow::Result<()> {
    serve::start_log("warn");
    let stays = !args.exit && ui::is_interactive();
    let default = SocketAddr::from(([127, 0, 0, 1], if stays { 7878 } else { 0 }));
    let listener =
        serve::listen(args.listen.unwrap_or(default)).await.context("give the demo another address with --listen")?;
    let address = listener.local_addr().context("cannot tell the address")?;
    let work = async {
        tokio::select! {
            result = steps(&args, address, stays) => result,
            _ = tokio::signal::ctrl_c() => Err(Interrupted("").into()),
        }
    };
    rebake::run_while(listener, serve::config(args.threads), work).await.context("the service stopped")?
}

/// All steps, and the time after them.
async fn steps(args: &DemoArgs, address: SocketAddr, stays: bool) -> anyhow::Result<()> {
    let mut demo = Demo::new(args, address)?;
    ui::out(&format!("service on http://{address}, a room of 5 × 2.8 × 4 m made in code, {} threads\n", demo.threads))?;
    ui::out(&ui::bold(&demo.table.row(&HEADINGS)))?;
    demo.bake().await?;
    let mut pictures = args.pictures.as_deref().map(Pictures::new).transpose()?;
    if let Some(pictures) = &mut pictures {
        pictures.light(&demo.client, &demo.scene, "room-before.png").await?;
    }
    let asset = demo.client.create_asset(demo.chair_glb.clone()).await?;
    let place = room::chair_place();
    let chair = load(&demo.chair_glb, &LoadLimits::default())?;
    let insert = json!({"op": "insert", "asset": asset, "name": "chair", "transform": place.to_cols_array()});
    let inserted = Edit::Insert { asset: Arc::new(chair), name: "chair".to_owned(), transform: place };
    demo.edit("+ chair", insert, inserted).await?;
    let removed = Edit::Remove { objects: vec![room::SOFA.to_owned()] };
    demo.edit("- sofa", json!({"op": "remove", "objects": [room::SOFA]}), removed).await?;
    if let Some(pictures) = &mut pictures {
        pictures.light(&demo.client, &demo.scene, "room-after.png").await?;
        pictures.change_and_error(&demo.client, &demo.scene).await?;
    }
    let relight = json!({"op": "relight", "lights": [{"light": room::LAMP, "intensity": room::LAMP_INTENSITY / 2.0}]});
    let dimmed = Relight { light: room::LAMP.to_owned(), color: None, intensity: Some(room::LAMP_INTENSITY / 2.0) };
    demo.edit("lamp at half", relight, Edit::Relight { lights: vec![dimmed] }).await?;
    demo.check_against_a_fresh_download().await?;
    demo.explain()?;
    if let Some(dir) = &args.save {
        demo.save(dir).await?;
    }
    if stays {
        demo.invite(address)?;
        serve::stop_signal().await;
    }
    Ok(())
}

/// The demo as a client: what it knows of the service's scene, and a copy of the scene to measure against.
struct Demo {
    client: Client,
    follower: Option<DeltaFollower>,
    /// Open across the steps, so that no event is missed.
    feed: Option<ProgressFeed>,
    scene: String,
    room_glb: Vec<u8>,
    chair_glb: Vec<u8>,
    spacing: f32,
    world: Option<World>,
    threads: usize,
    pool: Arc<rayon::ThreadPool>,
    table: Table,
    last: Option<Comparison>,
    delta_bytes: usize,
}

/// Times and job of one step.
struct Step {
    job: Job,
    first_light: f64,
    done: f64,
}

impl Demo {
    fn new(args: &DemoArgs, address: SocketAddr) -> anyhow::Result<Demo> {
        let threads = args.threads.map_or(0, NonZeroUsize::get);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().context("cannot start the threads")?;
        // The service may listen on all addresses; one's own is reached by loopback.
        let host =
            if address.ip().is_unspecified() { SocketAddr::from(([127, 0, 0, 1], address.port())) } else { address };
        Ok(Demo {
            client: Client::new(&format!("http://{host}"))?,
            follower: None,
            feed: None,
            scene: String::new(),
            room_glb: write_scene_glb(&room::room())?,
            chair_glb: write_scene_glb(&room::chair())?,
            spacing: args.spacing as f32,
            world: None,
            threads: pool.current_num_threads(),
            pool: Arc::new(pool),
            table: Table::new(&HEADINGS, &WIDTHS),
            last: None,
            delta_bytes: 0,
        })
    }

    /// Uploads the room and follows its bake.
    async fn bake(&mut self) -> anyhow::Result<()> {
        let start = Instant::now();
        let new = NewScene { name: Some("demo".to_owned()), spacing: Some(self.spacing), ..NewScene::default() };
        let created = self.client.create_scene(self.room_glb.clone(), &new).await?;
        let scene = self.client.prepared_scene(&created.id).await?;
        self.scene.clone_from(&scene.id);
        self.follower = Some(self.client.follow(&scene.id));
        self.feed = Some(ProgressFeed::new(self.client.clone(), &scene.id));
        let job = self.client.job(created.job_id().context("the upload started no bake")?).await?;
        let step = self.follow(job, start).await?;
        let room = self.load(&self.room_glb)?;
        let options = WorldOptions { spacing: Some(self.spacing), ..WorldOptions::default() };
        self.world = Some(self.compute(move || World::new(room, &options)).await??);
        self.measure("bake", &step).await
    }

    /// Posts an edit, follows its update, and does the same to the demo's own copy of the scene.
    async fn edit(&mut self, name: &str, edit: Value, same: Edit) -> anyhow::Result<()> {
        let start = Instant::now();
        let job = self.client.edit(&self.scene, &edit, &EditOptions::default()).await?;
        let step = self.follow(job, start).await?;
        let world = self.world.take().context("there is no scene yet")?;
        self.world = Some(self.compute(move || world.apply(&[same]).map(|transition| transition.after)).await??);
        self.measure(name, &step).await
    }

    /// Applies deltas until the job is done and its last version has arrived.
    async fn follow(&mut self, job: Job, start: Instant) -> anyhow::Result<Step> {
        let follower = self.follower.as_mut().context("there is no scene yet")?;
        let feed = self.feed.as_mut().context("there is no scene yet")?;
        let client = self.client.clone();
        let before = follower.version();
        let ended = wait_for_job(&client, &job);
        tokio::pin!(ended);
        let mut arrivals: Vec<(u64, Duration)> = Vec::new();
        let mut last: Option<(Job, u64)> = None;
        while last.as_ref().is_none_or(|(_, version)| follower.version() < *version) {
            tokio::select! {
                update = follower.next() => {
                    let update = update?;
                    self.delta_bytes += update.bytes;
                    arrivals.push((update.version, start.elapsed()));
                }
                _ = feed.next() => {}
                job = &mut ended, if last.is_none() => {
                    let job = job?;
                    let version = job.progress.version.with_context(|| format!("job {} published nothing", job.id))?;
                    last = Some((job, version));
                }
            }
        }
        let (job, version) = last.context("the job has no end")?;
        let at = |version: u64| {
            arrivals.iter().find(|(v, _)| *v >= version).map_or(start.elapsed(), |(_, time)| *time).as_secs_f64()
        };
        // The event of the last version comes with its frames: it is here, or will be in a moment.
        let _ = tokio::time::timeout(Duration::from_secs(1), feed.reach(version)).await;
        // A job's first version may be the old light on new geometry: what counts is the first with samples in it.
        let first_lit = feed.first_lit_after(before).unwrap_or(version);
        Ok(Step { job, first_light: at(first_lit), done: at(version) })
    }

    /// Compares the followed map with path tracing of the demo's copy, and prints the step's line.
    async fn measure(&mut self, name: &str, step: &Step) -> anyhow::Result<()> {
        let follower = self.follower.as_ref().context("there is no scene yet")?;
        let world = self.world.clone().context("there is no scene yet")?;
        let map: Vec<Vec3> = follower.map().to_vec();
        let elements = world.element_count();
        let spinner = ui::spinner("reference");
        spinner.set_message(format!("path tracing, to compare with {name}"));
        let seed = follower.version();
        let compared = self.compute(move || compare(&world, &map, seed)).await;
        spinner.finish_and_clear();
        let comparison = compared??;
        let progress = &step.job.progress;
        let path_seconds = comparison.path_seconds();
        let at_least = if comparison.is_told() { "" } else { "> " };
        ui::out(&self.table.row(&[
            name.to_owned(),
            ui::count(elements as u64),
            progress.rays.map_or_else(|| "–".to_owned(), |rays| ui::short(rays as f64)),
            ui::seconds(step.first_light),
            ui::seconds(step.done),
            progress.estimated_rmse.map_or_else(|| "–".to_owned(), ui::rmse),
            rmse_text(&comparison),
            format!("{at_least}{}", ui::seconds(path_seconds)),
            format!("{at_least}{}×", ui::short(path_seconds / step.done)),
        ]))?;
        self.last = Some(comparison);
        Ok(())
    }

    /// The followed map and a fresh download have to be the same, bit for bit; so have the element layouts of the
    /// service and of the copy that the errors were measured with.
    async fn check_against_a_fresh_download(&self) -> anyhow::Result<()> {
        let follower = self.follower.as_ref().context("there is no scene yet")?;
        let mut fresh = self.client.follow(&self.scene);
        fresh.catch_up().await?;
        let same = fresh.version() == follower.version()
            && fresh.map().len() == follower.map().len()
            && fresh.map().iter().zip(follower.map()).all(|(a, b)| rebake_core::delta::same_bits(*a, *b));
        anyhow::ensure!(same, "the followed light map is not the one the service has");
        let elements = self.client.elements(&self.scene).await?;
        let world = self.world.as_ref().context("there is no scene yet")?;
        let areas = elements.chunks_exact(32).map(|record| [record[24], record[25], record[26], record[27]]);
        let same = elements.len() == world.slots() * 32 && areas.eq(world.areas().iter().map(|a| a.to_le_bytes()));
        anyhow::ensure!(same, "the elements of the service are not those the errors were measured with");
        ui::out(&format!(
            "\nThe map put together from deltas ({}) is, bit for bit, the one a fresh download gives.",
            ui::bytes(self.delta_bytes as u64)
        ))
    }

    /// What the columns mean.
    fn explain(&self) -> anyhow::Result<()> {
        let Some(last) = &self.last else { return Ok(()) };
        let text = format!(
            "first light, done: from the request to the first and the last new light in the client's copy.\n\
             stated error: what the service says. error: what was measured. Both are the area-weighted RMSE of\n\
             radiance / albedo; measured on {} elements against path tracing with {} samples each, whose own noise\n\
             ({} at the last step) is taken out. path tracing: time from scratch to the same error on as many threads,\n\
             extrapolated from that run by the law that its error falls with the root of the time.",
            ui::count(last.elements as u64),
            ui::count(u64::from(last.samples)),
            ui::rmse(last.noise),
        );
        text.lines().try_for_each(|line| ui::out(&ui::faint(line)))
    }

    async fn save(&self, dir: &Path) -> anyhow::Result<()> {
        let response = self.client.lightmap(&self.scene, &[("format", "glb".to_owned())]).await?;
        let lightmap = rebake::client::read_body(response, usize::MAX).await?;
        std::fs::create_dir_all(dir).with_context(|| format!("cannot create {}", dir.display()))?;
        for (name, bytes) in [("room.glb", &self.room_glb), ("chair.glb", &self.chair_glb), ("lightmap.glb", &lightmap)]
        {
            let path = dir.join(name);
            std::fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
        }
        ui::out(&format!("\nWritten to {}: room.glb, chair.glb, lightmap.glb", dir.display()))
    }

    /// What to try with the service that goes on running.
    fn invite(&self, address: SocketAddr) -> anyhow::Result<()> {
        let scene = &self.scene;
        let server = if address.port() == 7878 { String::new() } else { format!(" --server http://{address}") };
        if rebake::viewer::is_embedded() {
            ui::out(&format!("\nThe room is on a page, to look at and to edit: http://{address}/#{scene}"))?;
        }
        ui::out(&format!(
            "\nThe service goes on running; Ctrl-C ends it. Try in another terminal:\n  \
             rebake watch {scene}{server}\n  \
             rebake edit {scene}{server} --wait move chair --at 1.2,0,2.6\n  \
             rebake edit {scene}{server} --wait material wall-left --albedo 0.2,0.5,0.2\n  \
             rebake pull {scene}{server} -o room.glb\n  \
             curl http://{address}/v1/scenes/{scene}"
        ))
    }

    fn load(&self, glb: &[u8]) -> anyhow::Result<Scene> {
        load(glb, &LoadLimits::default()).context("the built-in room does not load")
    }

    /// Runs `task` on the demo's own compute threads.
    async fn compute<T: Send + 'static>(&self, task: impl FnOnce() -> T + Send + 'static) -> anyhow::Result<T> {
        let pool = Arc::clone(&self.pool);
        tokio::task::spawn_blocking(move || pool.install(task)).await.context("the computation broke down")
    }
}

/// An RMSE with its standard error; where it cannot be told from zero, what it lies below.
fn rmse_text(comparison: &Comparison) -> String {
    match comparison.rmse() {
        Some((rmse, error)) => format!("{} ± {}", ui::rmse(rmse), ui::rmse(error)),
        None => format!("< {}", ui::rmse(comparison.bound())),
    }
}
