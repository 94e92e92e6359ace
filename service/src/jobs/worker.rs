//! Runs one job on the pool of its slot.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use rayon::ThreadPool;

use super::JobSpec;
use super::observer::JobObserver;
use super::queue::{JobNumber, Outcome};
use crate::compute::catching;
use crate::engine::{Budget, Canceled, LightMap, Update};
use crate::state::App;
use crate::store::lighting::{Sequence, Work};
use crate::store::scenes::SceneEntry;

/// A job that starts.
pub(crate) struct Run {
    pub(crate) job: JobNumber,
    pub(crate) scene: Arc<SceneEntry>,
    pub(crate) cancel: Arc<AtomicBool>,
    pub(crate) spec: JobSpec,
}

/// Runs a job on `pool` and hands the pool back at the end. Whatever happens in between, the job ends.
pub(crate) fn spawn(app: Arc<App>, run: Run, pool: &Arc<ThreadPool>) {
    let its_pool = pool.clone();
    pool.spawn(move || {
        let span = tracing::info_span!("job", job = app.ids.job(run.job), scene = run.scene.id, kind = ?run.spec.kind);
        let _in_span = span.entered();
        tracing::info!(samples = run.spec.budget.samples_per_element, seed = run.spec.seed, "started");
        let started = std::time::Instant::now();
        let outcome = catching(|| light(&app, &run)).unwrap_or_else(|panic| Outcome::Failed(panic.to_string()));
        if let Outcome::Failed(error) = &outcome {
            tracing::error!(error, "failed");
            run.scene.distrust();
        }
        let ms = started.elapsed().as_millis() as u64;
        tracing::info!(?outcome, ms, version = run.scene.published().version, "ended");
        let (job, scene, sequence) = (run.job, run.scene.clone(), run.spec.sequence);
        drop(run);
        app.finish_job(job, outcome, its_pool);
        after(&app, &scene, sequence);
    });
}

/// What may follow a job while nobody waits: geometry of canceled edits behind it, and fresh trees.
fn after(app: &Arc<App>, scene: &Arc<SceneEntry>, sequence: Sequence) {
    if scene.is_deleted() {
        return;
    }
    let (app, scene) = (app.clone(), scene.clone());
    app.clone().compute.spawn(move || {
        let (world, accepted) = {
            let head = scene.head.blocking_lock();
            (head.world.clone(), head.sequence)
        };
        if accepted > sequence {
            app.settle(&scene, accepted);
        }
        let is_busy = app.jobs.with_queue(|queue| queue.current(scene.number).is_some());
        if is_busy || !world.needs_rebuild() {
            return;
        }
        let trees = world.rebuilt_trees();
        let mut head = scene.head.blocking_lock();
        // None where an edit came in between: the job of that edit ends here too.
        if let Some(world) = head.world.with_trees(trees) {
            head.world = world;
        }
    });
}

/// Brings the light map up to date with the job's edit.
fn light(app: &Arc<App>, run: &Run) -> Outcome {
    let Run { job, scene, cancel, spec } = run;
    let mut observer = JobObserver::new(app, scene, *job, spec.budget, cancel);
    if let Some(published) = scene.show(spec.sequence) {
        observer.shown(published.version);
        app.tell_edited(scene, Some(*job), &published);
    }
    let budget = Budget { samples_per_element: spec.budget.samples_per_element, target_rmse: spec.budget.target_rmse };
    let engine = &app.config.engine;
    let (work, shown) = scene.work(app.config.limits.unlit_edits);
    match work {
        Work::Bake(world) => {
            observer.begin(shown);
            let result = engine.bake(&world, &budget, spec.seed, &observer);
            match end_of(&observer, result) {
                Some((map, outcome)) => {
                    scene.set_lit(shown, map);
                    outcome
                }
                None => Outcome::Canceled,
            }
        }
        Work::Update(mut map, transitions) => {
            let last = transitions.len().saturating_sub(1);
            for (i, (sequence, transition)) in transitions.into_iter().enumerate() {
                observer.begin(sequence);
                let work = Update {
                    transition: &transition,
                    map: &map,
                    budget: &budget,
                    focus: spec.focus.as_ref().filter(|_| i == last),
                    seed: spec.seed.wrapping_add(i as u64),
                };
                let result = engine.update(&work, &observer);
                let Some((lit, outcome)) = end_of(&observer, result) else { return Outcome::Canceled };
                scene.set_lit(sequence, lit.clone());
                if outcome != Outcome::Succeeded {
                    return outcome;
                }
                map = lit;
            }
            Outcome::Succeeded
        }
    }
}

/// The map a piece of work ends with, if it ends with one that is right, and how it ended. A job out of time ends
/// well with its last complete map.
fn end_of(observer: &JobObserver<'_>, result: Result<Arc<LightMap>, Canceled>) -> Option<(Arc<LightMap>, Outcome)> {
    let latest = observer.take_latest();
    match result {
        Ok(map) => Some((map, Outcome::Succeeded)),
        Err(Canceled) if observer.cancel_requested() => latest.map(|map| (map, Outcome::Canceled)),
        Err(Canceled) => latest.map(|map| (map, Outcome::Succeeded)),
    }
}
