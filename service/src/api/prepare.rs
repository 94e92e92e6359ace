//! From an uploaded file to a scene: what takes long goes on behind the answer.

use std::collections::BTreeMap;
use std::sync::Arc;

use bytes::Bytes;
use tokio::sync::{OwnedMutexGuard, oneshot};
use tokio::time::{Instant, timeout_at};

use super::atlas::atlas_problem;
use super::problem::{ApiResult, Kind, Problem};
use super::types::SceneChange;
use super::upload_query::Options;
use super::uploads::{Upload, check_strengths, keep, load_problem, memory_problem};
use super::{layers, skies};
use crate::engine::{self, Density, Plan, Scene, SurfaceError, World, WorldError};
use crate::jobs::tell_scene;
use crate::memory;
use crate::state::App;
use crate::store::accepted::Head;
use crate::store::layers::LAYER_BYTES;
use crate::store::scene::SceneEntry;

/// A scene with the id of its bake.
pub(super) type Kept = (Arc<SceneEntry>, Option<String>);

/// Reads a file and builds its scene, and answers that and its bake's id. One that takes longer to build than an upload is
/// answered in is kept as it is, and prepared behind the answer. `held` is let go when it is built.
pub(super) async fn create(app: &Arc<App>, upload: Upload, held: impl Send + 'static) -> ApiResult<Kept> {
    let deadline = Instant::now() + app.config.timeouts.upload_answer;
    let (its_app, glb, options) = (app.clone(), upload.glb.clone(), upload.options.clone());
    let read = move || {
        let read = read_scene(&its_app, &glb, &options)?;
        let outline = Outline::of(&read);
        Ok::<_, Problem>((read, outline))
    };
    let (read, outline) = app.compute.build(read).await??;
    let (its_app, options) = (app.clone(), upload.options.clone());
    let mut building = Box::pin(async move {
        let build_app = its_app.clone();
        let built = its_app.compute.build(move || lay_out(&build_app, read, &options)).await;
        drop(held);
        built.map_err(Problem::from).and_then(|built| built)
    });
    if let Ok(built) = timeout_at(deadline, &mut building).await {
        let (its_app, world) = (app.clone(), built?);
        return app.compute.run(move || keep(&its_app, &upload, &outline, Some(world))).await?;
    }
    let (answer, kept) = oneshot::channel();
    // A client that goes away now leaves a scene that is prepared all the same.
    tokio::spawn(prepare(app.clone(), upload, outline, building, answer));
    kept.await.unwrap_or_else(|_| Err(Problem::internal("an upload was not answered")))
}

/// Keeps a scene that is being built, answers it, and lets everybody see what it holds when that is there.
async fn prepare(
    app: Arc<App>,
    upload: Upload,
    outline: Outline,
    building: impl Future<Output = ApiResult<World>>,
    answer: oneshot::Sender<ApiResult<Kept>>,
) {
    let its_app = app.clone();
    let kept = app.compute.run(move || keep(&its_app, &upload, &outline, None)).await;
    let kept = kept.map_err(Problem::from).and_then(|kept| kept);
    let scene = kept.as_ref().ok().map(|(scene, _)| scene.clone());
    // Where the client has gone nobody waits for it.
    let _ = answer.send(kept);
    let Some(scene) = scene else { return };
    let built = building.await;
    let (its_app, head) = (app.clone(), scene.head.clone().lock_owned().await);
    if let Err(panic) = app.compute.run(move || finish(&its_app, &scene, head, built)).await {
        tracing::error!(%panic, "a scene was not prepared");
    }
}

/// Lets everybody see a scene that is built by now, or that it cannot be.
fn finish(app: &Arc<App>, scene: &Arc<SceneEntry>, mut head: OwnedMutexGuard<Head>, built: ApiResult<World>) {
    if scene.is_deleted() {
        return;
    }
    match built {
        Ok(world) => {
            scene.expect_layers(layer_bytes(&world));
            let published = scene.set_ready(&mut head, world);
            drop(head);
            tracing::info!(scene = scene.id, elements = published.world.element_count(), "prepared");
            app.jobs.tell_edited(scene, None, &published);
            app.jobs.scene_prepared(scene.number);
        }
        Err(problem) => {
            let error = problem.to_string();
            tracing::warn!(scene = scene.id, error, "cannot be prepared");
            scene.set_damaged(error.clone());
            drop(head);
            tell_scene(scene, SceneChange::Damaged, &scene.published());
            app.jobs.scene_failed(scene, &error);
        }
    }
}

/// What a file holds, with what is asked for beside it.
pub(super) struct Read {
    scene: Scene,
    /// How far its elements will lie apart.
    density: Density,
    /// Memory that it will take, without layers.
    bytes: u64,
}

/// What is told of a scene before it is built.
pub(super) struct Outline {
    pub(super) density: Density,
    pub(super) groups: BTreeMap<String, String>,
    pub(super) warnings: Vec<String>,
}

impl Outline {
    fn of(Read { scene, density, .. }: &Read) -> Outline {
        Outline { density: *density, groups: scene.groups.clone(), warnings: scene.warnings.clone() }
    }
}

/// Bytes that the layers of a scene take which its upload asks for.
pub(super) fn layer_bytes(world: &World) -> u64 {
    (layers::count(&world.scene, &world.scene.groups) * LAYER_BYTES * world.slots()) as u64
}

/// A file as the scene that its upload makes of it.
pub(super) fn build_world(app: &App, glb: &Bytes, options: &Options) -> ApiResult<World> {
    lay_out(app, read_scene(app, glb, options)?, options)
}

fn read_scene(app: &App, glb: &Bytes, options: &Options) -> ApiResult<Read> {
    let limits = &app.config.limits;
    let mut scene = engine::load(glb, limits, options.max_albedo).map_err(load_problem)?;
    options.unit.convert(&mut scene);
    let outside = skies::outside(options.environment, &options.outside, &app.assets)?;
    if !outside.add_to(&mut scene) {
        let reason = "the file has a light named \"environment\" already";
        return Err(Problem::field(Kind::NameTaken, "environment", reason));
    }
    check_strengths(&scene)?;
    scene.groups = options.layers.groups(&scene)?;
    let (areas, vertices) = (engine::object_areas(&scene), memory::vertices(&scene));
    let within = |wanted: Density| {
        // Where nothing that is large gives way, building says what is too much.
        wanted.within(&areas, vertices, limits.elements).unwrap_or(wanted)
    };
    let density = match (options.spacing, options.elements) {
        (Some(spacing), _) => within(Density::even(spacing)),
        (None, Some(elements)) => Density::of_elements(&scene, elements).map_err(|error| world_problem(&error))?,
        (None, None) => within(Density::chosen(&areas)),
    };
    let bytes = memory::estimate(density, options.spread, &areas, vertices);
    Ok(Read { scene, density, bytes })
}

/// Its elements and trees: seconds for large scenes.
fn lay_out(app: &App, Read { scene, density, bytes }: Read, options: &Options) -> ApiResult<World> {
    let of_layers = memory::estimate_layers(bytes, layers::count(&scene, &scene.groups));
    let what = if of_layers > 0 { "scene with its layers" } else { "scene" };
    let _promise = app.memory.promise(bytes.saturating_add(of_layers), 0).map_err(|full| memory_problem(what, full))?;
    let Options { elements, spread, max_albedo, atlas, .. } = *options;
    let plan = Plan { density, elements, spread, stated: options.mode.stated(), max_albedo, atlas };
    let built = app.config.engine.build(scene, &plan.within(&app.config.limits));
    built.map_err(|error| world_problem(&error))
}

fn world_problem(error: &WorldError) -> Problem {
    match error {
        WorldError::Atlas(error) => atlas_problem(error),
        WorldError::TooLarge { .. } | WorldError::Surface { source: SurfaceError::TooManyElements { .. }, .. } => {
            Problem::new(Kind::SceneTooLarge, error.to_string())
        }
        error => Problem::new(Kind::UnsupportedFile, error.to_string()),
    }
}
