//! Runs one job on the pool of its slot.

use std::sync::Arc;
use std::time::Instant;

use rayon::ThreadPool;
use rebake_core::edit::Cost;

use super::merge::dragged_by;
use super::observer::JobObserver;
use super::piece::{Piece, Yields};
use super::queue::{JobKind, JobNumber, Outcome, RunEnd};
use super::seeds::mixed;
use super::stop::{Asked, Stop};
use super::{JobSpec, Jobs, merge};
use crate::compute::catching;
use crate::engine::{
    Budget, Canceled, Edit, LightMap, Pass, Progress, Snapshot, Transition, Update, World, carry_over, have_same_slots,
    lengthened, with_layers_of,
};
use crate::store::earlier::State;
use crate::store::lighting::{Samples, Sequence, Unlit, Work};
use crate::store::scene::SceneEntry;

/// A job that starts.
pub(crate) struct Run {
    pub(crate) job: JobNumber,
    pub(crate) kind: JobKind,
    pub(crate) scene: Arc<SceneEntry>,
    pub(crate) stop: Arc<Stop>,
    pub(crate) accepted: Instant,
    pub(crate) spec: JobSpec,
}

/// Runs a job on `pool` and hands the pool back at the end. Whatever happens in between, the job ends.
pub(crate) fn spawn(jobs: Arc<Jobs>, run: Run, pool: &Arc<ThreadPool>) {
    let its_pool = pool.clone();
    pool.spawn(move || {
        let span =
            tracing::info_span!("job", job = jobs.ids.job(run.job), scene = run.scene.id, kind = run.kind.as_str());
        let _in_span = span.entered();
        tracing::info!(samples = run.spec.budget.samples_per_element, seed = run.spec.seed, "started");
        let started = std::time::Instant::now();
        let end = catching(|| light(&jobs, &run));
        let end = end.unwrap_or_else(|panic| RunEnd::Ended(Outcome::Failed(panic.to_string())));
        if let RunEnd::Ended(Outcome::Failed(error)) = &end {
            tracing::error!(error, "failed");
            run.scene.distrust();
        }
        let ms = started.elapsed().as_millis() as u64;
        tracing::info!(end = end.as_str(), ms, version = run.scene.published().version, "ended");
        let remains =
            Remains { scene: run.scene.clone(), sequence: run.spec.sequence, asks_for_more: run.asks_for_more(&end) };
        let job = run.job;
        drop(run);
        jobs.finish(job, &remains.scene, &end, its_pool);
        after(&jobs, remains);
    });
}

impl Run {
    /// Whether there may be more to do for the scene's target than was known when the job came: an edit has left its noise, or
    /// the target is another one by now.
    fn asks_for_more(&self, end: &RunEnd) -> bool {
        let is_new = self.scene.target() != Some(self.spec.budget);
        *end == RunEnd::Ended(Outcome::Succeeded) && (!self.kind.is_for_target() || is_new)
    }
}

/// What is left of a job that has ended.
struct Remains {
    scene: Arc<SceneEntry>,
    sequence: Sequence,
    asks_for_more: bool,
}

/// What may follow a job: work towards the scene's target, and while nobody waits geometry of canceled edits behind it, and
/// fresh trees.
fn after(jobs: &Arc<Jobs>, remains: Remains) {
    let Remains { scene, sequence, asks_for_more } = remains;
    if scene.is_deleted() {
        return;
    }
    let jobs = jobs.clone();
    jobs.clone().compute.spawn_apart(move || {
        let (world, accepted) = {
            let head = scene.head.blocking_lock();
            if asks_for_more {
                jobs.work_towards_target(&scene, &head, false);
            }
            (head.world.clone(), head.sequence)
        };
        if accepted > sequence {
            jobs.show_accepted(&scene, accepted);
        }
        let is_busy = jobs.with_queue(|queue| queue.current(scene.number).is_some());
        if is_busy || !world.needs_rebuild() {
            return;
        }
        let trees = jobs.compute.build_here(|| world.rebuilt_trees());
        let mut head = scene.head.blocking_lock();
        // None where an edit came in between: the job of that edit ends here too.
        if let Some(world) = head.world.with_trees(trees) {
            head.world = world;
            scene.set_accepted(&head);
        }
    });
}

/// Brings the light map up to date with the job's edit.
fn light(jobs: &Arc<Jobs>, run: &Run) -> RunEnd {
    let Run { job, kind, scene, stop, accepted, spec } = run;
    let mut observer = JobObserver::new(jobs, scene, *job, spec.budget, (stop, *accepted));
    if jobs.saving.may_publish(scene)
        && let Some(published) = scene.show(spec.sequence)
    {
        observer.shown(published.version);
        jobs.tell_edited(scene, Some(*job), &published);
    }
    let (work, shown, floor) = scene.work(jobs.config.limits.unlit_edits);
    match work {
        Work::Bake(world) => {
            let yields = if kind.is_for_target() { Yields::AtOnce } else { Yields::OnceStated };
            observer.begin(Piece { sequence: shown, slots: world.slots(), floor, yields, before: 0 });
            let result = jobs.config.engine.bake(&world, &spec.engine_budget(), spec.seed, &observer);
            match take_over_end(&observer, scene, (shown, Samples::Fresh), result) {
                Ok(_) => done(run),
                Err(end) => end,
            }
        }
        Work::Update(mut from, mut map, due) => {
            let steps = steps(due);
            let last = steps.len().saturating_sub(1);
            for (i, step) in steps.into_iter().enumerate() {
                let floor = floor.filter(|_| i == last);
                let yields = if i == last { step.yields(run) } else { Yields::Never };
                observer.begin(Piece { sequence: step.sequence, slots: step.slots, floor, yields, before: 0 });
                match light_step(run, &observer, (from, map), &step, (i, i == last)) {
                    Ok(lit) => (from, map) = (step.sequence, lit),
                    Err(end) => return end,
                }
            }
            match kind.is_for_target() {
                true => refine(run, &mut observer, &map, (shown, floor)),
                false => Outcome::Succeeded.into(),
            }
        }
    }
}

/// Goes on towards the target from a map that is right for `sequence`. `floor` is the stated error of what is published.
fn refine(
    run: &Run,
    observer: &mut JobObserver<'_>,
    map: &Arc<LightMap>,
    (sequence, floor): (Sequence, Option<f32>),
) -> RunEnd {
    let Run { scene, spec, .. } = run;
    let (world, before) = (scene.published().world.clone(), scene.samples());
    let left = spec.budget.samples_per_element.saturating_sub(before);
    let is_good = |target: f32| map.estimated_rmse(world.areas()) <= target;
    let is_reached = left == 0 || spec.budget.target_rmse.is_some_and(is_good) || observer.is_out_of_time();
    if is_reached || map.len() != world.slots() {
        return done(run);
    }
    observer.begin(Piece { sequence, slots: world.slots(), floor, yields: Yields::AtOnce, before });
    observer.goes_on();
    let budget = Budget { samples_per_element: left, ..spec.engine_budget() };
    // Runs must not repeat the samples that the map holds: each has a seed of its own, by what is there before it. Versions
    // would do, but are others after a restart.
    let seed = mixed(spec.seed ^ u64::from(before) << 32) ^ sequence;
    let result = observer.jobs.config.engine.refine(&world, map, &budget, seed, observer);
    match take_over_end(observer, scene, (sequence, Samples::More), result) {
        Ok(_) => done(run),
        Err(end) => end,
    }
}

/// The end of a job within its budget. One for the target has reached it, as far as its bounds let it.
fn done(run: &Run) -> RunEnd {
    if run.kind.is_for_target() {
        run.scene.reached(&run.spec.budget);
    }
    Outcome::Succeeded.into()
}

/// From a map that is right for a sequence number to that after a step, the `index`-th of its job; how the job ends where
/// there is none.
fn light_step(
    run: &Run,
    observer: &JobObserver<'_>,
    (sequence, map): (Sequence, Arc<LightMap>),
    step: &Step,
    (index, is_last): (usize, bool),
) -> Result<Arc<LightMap>, RunEnd> {
    let Run { scene, spec, .. } = run;
    let Some(transition) = &step.transition else {
        let map = step.carries.iter().fold(map, |map, transition| carry_over(transition, &map));
        scene.set_lit(step.sequence, map.clone(), Samples::Same);
        return Ok(map);
    };
    let before = State { sequence, world: transition.before.clone(), map };
    scene.earlier.remember(&before);
    if let Some(known) = scene.earlier.recall(&transition.after) {
        let known = lengthened(&known, step.slots);
        let lit = if step.relights() { with_layers_of(known, &before.map, &transition.after.scene) } else { known };
        restore(observer, scene, step.sequence, &transition.after, &lit);
        scene.earlier.computed(&before, &step.edits, &lit, false);
        return Ok(lit);
    }
    scene.drag.drop_stale(&transition.after);
    if is_last && step.drags() {
        first_frame(observer, scene, transition, &before.map, spec.seed);
    }
    let shortcut = scene.earlier.shortcut(&before.map, transition, &step.edits);
    let (transition, from, edits) = match &shortcut {
        Some(shortcut) => (&shortcut.transition, &shortcut.from, &shortcut.edits),
        None => (transition, &before, &step.edits),
    };
    let budget = &spec.engine_budget();
    let importance = Some(&spec.importance).filter(|_| is_last);
    let work = Update { transition, map: &from.map, budget, importance, seed: spec.seed.wrapping_add(index as u64) };
    let result = observer.jobs.config.engine.update(&work, observer).map(|map| lengthened(&map, step.slots));
    if result.is_err() && observer.ended_as_estimate() {
        // The estimate stays in sight, but the next step starts from the light that is right.
        step.as_unlit().into_iter().for_each(|unlit| scene.fold_unlit(unlit));
        return Err(Outcome::Succeeded.into());
    }
    let lit = take_over_end(observer, scene, (step.sequence, |_| Samples::Same), result)?;
    scene.earlier.computed(from, edits, &lit, observer.was_cut());
    Ok(lit)
}

/// Shows a dragged light at its new place as soon as may be, where the scene's transport has been sampled; else samples
/// it, for the frames to come.
fn first_frame(
    observer: &JobObserver<'_>,
    scene: &SceneEntry,
    transition: &Transition,
    map: &LightMap,
    seed: u64,
) -> Option<()> {
    let basis = match scene.drag.get(&transition.after) {
        Some(basis) => basis,
        None => scene.drag.keep(observer.jobs.config.engine.drag_basis(&transition.after, seed, observer).ok()?),
    };
    let frame = basis.frame(transition, map, seed, observer).ok()??;
    observer.publish(&Arc::new(frame), Snapshot::Estimate, &Progress::at_once(Pass::Direct, 1, None));
    Some(())
}

/// Publishes a map that was there before an edit that this one takes back.
fn restore(observer: &JobObserver<'_>, scene: &SceneEntry, sequence: Sequence, world: &World, map: &Arc<LightMap>) {
    let stated = Some(map.estimated_rmse(world.areas()));
    let progress = Progress::at_once(Pass::FinalGather, observer.budget.samples_per_element, stated);
    observer.publish(map, Snapshot::Complete { stated }, &progress);
    scene.set_lit(sequence, map.clone(), Samples::Same);
    tracing::info!("restored");
}

/// One piece of work on the way to an up-to-date map.
struct Step {
    /// What the map is right for then.
    sequence: Sequence,
    /// Length of the map then.
    slots: usize,
    /// None where all edits together change nothing.
    transition: Option<Arc<Transition>>,
    /// From where the map is to there, without light.
    carries: Vec<Arc<Transition>>,
    /// What is asked for.
    edits: Arc<[Edit]>,
}

impl Step {
    /// Nothing but strengths of lights changes.
    fn relights(&self) -> bool {
        self.edits.iter().all(|edit| matches!(edit.cost(), Cost::Weights))
    }

    /// Nothing but lights that are dragged.
    fn drags(&self) -> bool {
        !dragged_by(&self.edits).is_empty()
    }

    /// What it makes way for, as the last step of a job.
    fn yields(&self, run: &Run) -> Yields {
        match () {
            () if self.drags() || !run.spec.dragged.is_empty() => Yields::ToNextStep,
            () if run.spec.yields() || run.kind.is_for_target() => Yields::OnceStated,
            () => Yields::Never,
        }
    }

    /// As one edit that is still to be lit, where clients know its slots.
    fn as_unlit(&self) -> Option<Unlit> {
        let transition = self.transition.clone().filter(|transition| transition.after.slots() == self.slots)?;
        Some(Unlit { sequence: self.sequence, transition, edits: self.edits.clone() })
    }
}

/// What is due, in as few steps as give the same result.
fn steps(due: Vec<Unlit>) -> Vec<Step> {
    if let Some(step) = merged(&due) {
        return vec![step];
    }
    let each = |unlit: Unlit| Step {
        sequence: unlit.sequence,
        slots: unlit.transition.after.slots(),
        transition: Some(unlit.transition),
        carries: Vec::new(),
        edits: unlit.edits,
    };
    due.into_iter().map(each).collect()
}

/// All that is due as one step, where fewer edits do the same.
fn merged(due: &[Unlit]) -> Option<Step> {
    let [first, .., last] = due else { return None };
    let edits: Vec<_> = due.iter().flat_map(|unlit| unlit.edits.iter().cloned()).collect();
    let count = merge::count(&edits);
    let fewer = merge::simplify(edits);
    if fewer.len() >= count {
        return None;
    }
    let after = &last.transition.after;
    let transition = match fewer.is_empty() {
        true => None,
        false => {
            let transition = first.transition.before.apply(&fewer).ok()?;
            // Clients know the slots that the edits had one by one.
            have_same_slots(&transition.after, after).then_some(())?;
            Some(Arc::new(transition))
        }
    };
    tracing::info!(edits = count, lit = fewer.len(), "merged");
    let carries = due.iter().map(|unlit| unlit.transition.clone()).collect();
    Some(Step { sequence: last.sequence, slots: after.slots(), transition, carries, edits: fewer.into() })
}

/// Takes over the map that a piece of work ends with, if it ends with one that is right. A job out of time ends well
/// with its last complete map; one that was stopped says how as the error.
fn take_over_end(
    observer: &JobObserver<'_>,
    scene: &SceneEntry,
    (sequence, samples): (Sequence, fn(u32) -> Samples),
    result: Result<Arc<LightMap>, Canceled>,
) -> Result<Arc<LightMap>, RunEnd> {
    let complete = observer.take_complete();
    let count = samples(complete.as_ref().map_or(0, |complete| complete.samples));
    let asked = observer.stop.asked();
    if result.is_err() && observer.has_made_way() {
        complete.into_iter().for_each(|complete| scene.set_lit(sequence, complete.map, count));
        return Err(RunEnd::Interrupted);
    }
    if result.is_err() && asked == Asked::Interrupt {
        return Err(RunEnd::Interrupted);
    }
    let was_canceled = result.is_err() && asked == Asked::Cancel;
    let (latest, held_back) = complete.map_or((None, None), |complete| (Some(complete.map), complete.held_back));
    let Some(map) = result.ok().or(latest) else { return Err(Outcome::Canceled.into()) };
    if let Some(progress) = held_back.filter(|_| !was_canceled) {
        observer.publish(&map, Snapshot::Complete { stated: progress.estimated_rmse }, &progress);
    }
    scene.set_lit(sequence, map.clone(), count);
    if was_canceled { Err(Outcome::Canceled.into()) } else { Ok(map) }
}
