//! From an uploaded file to a scene: what takes long goes on behind the answer.

use std::sync::Arc;

use tokio::sync::oneshot;
use tokio::time::{Instant, timeout_at};

use super::problem::{ApiResult, Problem};
use super::uploads::{About, Upload, keep, lay_out, layer_bytes, read_scene};
use crate::engine::World;
use crate::state::App;
use crate::store::scenes::SceneEntry;

/// A scene with the id of its bake.
pub(super) type Kept = (Arc<SceneEntry>, Option<String>);

/// Reads a file and builds its scene, and answers that and its bake's id. One that takes longer to build than an upload is
/// answered in is kept as it is, and prepared behind the answer. `held` is let go when it is built.
pub(super) async fn create(app: &Arc<App>, upload: Upload, held: impl Send + 'static) -> ApiResult<Kept> {
    let deadline = Instant::now() + app.config.timeouts.upload_answer;
    let (its_app, glb, options) = (app.clone(), upload.glb.clone(), upload.options.clone());
    let read = move || {
        let (scene, density) = read_scene(&its_app, &glb, &options)?;
        let about = About::of(&scene, density);
        Ok::<_, Problem>((scene, about))
    };
    let (scene, about) = app.compute.build(read).await??;
    let (its_app, options, density) = (app.clone(), upload.options.clone(), about.density);
    let mut building = Box::pin(async move {
        let build_app = its_app.clone();
        let built = its_app.compute.build(move || lay_out(&build_app, scene, density, &options)).await;
        drop(held);
        built.map_err(Problem::from).and_then(|built| built)
    });
    if let Ok(built) = timeout_at(deadline, &mut building).await {
        let (its_app, world) = (app.clone(), built?);
        return app.compute.run(move || keep(&its_app, &upload, &about, Some(world))).await?;
    }
    let (answer, kept) = oneshot::channel();
    // A client that goes away now leaves a scene that is prepared all the same.
    tokio::spawn(prepare(app.clone(), upload, about, building, answer));
    kept.await.unwrap_or_else(|_| Err(Problem::internal("an upload was not answered")))
}

/// Keeps a scene that is being built, answers it, and lets everybody see what it holds when that is there.
async fn prepare(
    app: Arc<App>,
    upload: Upload,
    about: About,
    building: impl Future<Output = ApiResult<World>>,
    answer: oneshot::Sender<ApiResult<Kept>>,
) {
    let its_app = app.clone();
    let kept = app.compute.run(move || keep(&its_app, &upload, &about, None)).await;
    let kept = kept.map_err(Problem::from).and_then(|kept| kept);
    let scene = kept.as_ref().ok().map(|(scene, _)| scene.clone());
    // Where the client has gone nobody waits for it.
    let _ = answer.send(kept);
    let Some(scene) = scene else { return };
    let built = building.await;
    let its_app = app.clone();
    if let Err(panic) = app.compute.run(move || finish(&its_app, &scene, built)).await {
        tracing::error!(%panic, "a scene was not prepared");
    }
}

/// Lets everybody see a scene that is built by now, or that it cannot be.
fn finish(app: &Arc<App>, scene: &Arc<SceneEntry>, built: ApiResult<World>) {
    let mut head = scene.head.blocking_lock();
    if scene.is_deleted() {
        return;
    }
    match built {
        Ok(world) => {
            scene.expect_layers(layer_bytes(&world));
            let published = scene.set_ready(&mut head, world);
            drop(head);
            tracing::info!(scene = scene.id, elements = published.world.element_count(), "prepared");
            app.tell_edited(scene, None, &published);
            app.start_jobs_of(scene.number);
        }
        Err(problem) => {
            let error = problem.to_string();
            tracing::warn!(scene = scene.id, error, "cannot be prepared");
            scene.set_damaged(error.clone());
            drop(head);
            app.fail_jobs_of(scene, &error);
        }
    }
}
