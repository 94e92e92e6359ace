//! What happens while there are no jobs: the worst light map is refined, spell by spell, until all are good enough or
//! more samples do not help. It has threads of its own and makes room as soon as a job starts.
//!
//! A refined map takes the place of exactly the one it was made from (see `store::lighting`), so nothing that a job
//! does meanwhile can be undone by it, however late it stops.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use super::phases::PhaseClock;
use super::scheduler::{self, Spell, UpToDate};
use super::seeds::{mixed, next_seed};
use super::stop::Stop;
use super::{Jobs, State};
use crate::compute::catching;
use crate::config::IdleRefine;
use crate::engine::{Budget, LightMap, Meter, Observer, Progress, Snapshot, World, mean_light};
use crate::store::lighting::Lit;
use crate::store::scene::SceneEntry;

/// Seeds of idle time lie here, those of a scene's jobs far below.
const FIRST_SEED: u64 = 1 << 48;

impl Jobs {
    /// Begins to refine where no job runs or waits.
    pub(super) fn refine_if_idle(self: &Arc<Jobs>, state: &mut State) {
        let Some((pool, bounds)) = self.idle_pool.as_ref().zip(self.config.idle_refine) else { return };
        if state.closed || state.idle.is_some() || !scheduler::is_idle(&state.queue) {
            return;
        }
        let stop = Arc::new(Stop::default());
        state.idle = Some(stop.clone());
        let jobs = self.clone();
        pool.spawn(move || {
            if let Err(panic) = catching(|| refine_all(&jobs, bounds, &stop)) {
                tracing::error!(%panic, "refining failed");
            }
            jobs.end_refining(&stop);
        });
    }

    fn end_refining(self: &Arc<Jobs>, stop: &Stop) {
        let mut state = self.lock();
        state.idle = None;
        match stop.must_end() {
            // The job that came may have ended by now, and nothing else would begin again.
            true => self.start_what_can(&mut state),
            false => drop(self.running.send_replace(state.running())),
        }
    }
}

/// Spell after spell, until all scenes are good enough.
fn refine_all(jobs: &Arc<Jobs>, bounds: IdleRefine, stop: &Stop) {
    while !stop.must_end()
        && let Some(spell) = next_spell(jobs, bounds, stop)
    {
        let Some(scene) = jobs.scenes.get(spell.scene) else { continue };
        let before = scene.published().version;
        let reached = catching(|| refine(jobs, &scene, spell, bounds, stop)).unwrap_or_else(|panic| {
            tracing::error!(scene = scene.id, %panic, "refining failed");
            false
        });
        let after = scene.published().version;
        if after > before {
            jobs.saving.save_soon(&scene);
        }
        if !reached && !stop.must_end() {
            scene.refined.store(after, Ordering::Relaxed);
        }
    }
}

fn next_spell(jobs: &Jobs, bounds: IdleRefine, stop: &Stop) -> Option<Spell> {
    let mut scenes = Vec::new();
    for scene in jobs.scenes.all() {
        if stop.must_end() {
            return None;
        }
        let Some((published, map)) = scene.up_to_date() else { continue };
        if published.version == scene.refined.load(Ordering::Relaxed) {
            continue;
        }
        let world = &published.world;
        let (stated, mean) = (f64::from(map.estimated_rmse(world.areas())), mean_light(world, &map));
        scenes.push(UpToDate { scene: scene.number, stated, mean });
    }
    scheduler::idle(&scenes, bounds.error_share)
}

/// One spell; whether it got as far as it should.
fn refine(jobs: &Arc<Jobs>, scene: &Arc<SceneEntry>, spell: Spell, bounds: IdleRefine, stop: &Stop) -> bool {
    let Some((published, map)) = scene.up_to_date() else { return true };
    let target = spell.target as f32;
    let budget = Budget { samples_per_element: bounds.samples, target_rmse: Some(target) };
    let world = &published.world;
    let stated = map.estimated_rmse(world.areas());
    tracing::debug!(scene = scene.id, stated, target, "refining");
    // Versions do not repeat, so every spell has random numbers of its own.
    let seed = next_seed(jobs.config.seed, &mut (FIRST_SEED | published.version));
    let meter = Meter::after(published.resolution.clone().map(Arc::unwrap_or_clone));
    let (clock, saved) = (PhaseClock::default(), Instant::now());
    let held = Held { map: map.clone(), stated, clock, saved, meter, is_over: false };
    let observer = IdleObserver { jobs, scene, world, stop, held: Mutex::new(held) };
    // Where it was canceled the last snapshot stands.
    let _ = jobs.config.engine.refine(world, &map, &budget, seed, &observer);
    let mut held = observer.lock();
    held.clock.stop(&jobs.metrics);
    // Whatever came in between decides anew.
    held.is_over || held.stated <= target
}

/// Publishes what is better.
struct IdleObserver<'a> {
    jobs: &'a Arc<Jobs>,
    scene: &'a Arc<SceneEntry>,
    /// What is refined is right for it.
    world: &'a World,
    stop: &'a Stop,
    held: Mutex<Held>,
}

struct Held {
    /// The newest map, with its stated error.
    map: Arc<LightMap>,
    stated: f32,
    clock: PhaseClock,
    saved: Instant,
    meter: Meter,
    /// Something else has changed the scene's light.
    is_over: bool,
}

impl IdleObserver<'_> {
    fn lock(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Observer for IdleObserver<'_> {
    fn canceled(&self) -> bool {
        self.stop.must_end() || self.scene.is_deleted()
    }

    fn progress(&self, progress: &Progress) {
        self.lock().clock.tick(&self.jobs.metrics, progress);
    }

    fn plan_round(&self, so_far: &Progress, proposed: u32) -> u32 {
        self.progress(so_far);
        if self.lock().is_over { 0 } else { proposed }
    }

    fn snapshot(&self, map: &Arc<LightMap>, snapshot: Snapshot, progress: &Progress) {
        let mut held = self.lock();
        let better = match snapshot {
            Snapshot::Complete { stated } => stated.filter(|stated| *stated < held.stated),
            Snapshot::Estimate | Snapshot::Partial => None,
        };
        if held.is_over || self.canceled() || !self.jobs.saving.may_publish(self.scene) {
            return;
        }
        let Some(stated) = better else { return };
        let seed = mixed(self.jobs.config.seed ^ self.scene.published().version);
        // What was known stays where it is canceled.
        let _ = held.meter.measure(self.world, map, progress.rays, seed, self);
        let resolution = held.meter.error().cloned().map(Arc::new);
        let lit = Lit { map, estimated_rmse: Some(stated), resolution: resolution.as_ref(), is_right: true };
        let Some(published) = self.scene.refine(&held.map, lit) else {
            held.is_over = true;
            return;
        };
        (held.map, held.stated) = (map.clone(), stated);
        let is_due = held.saved.elapsed() >= self.jobs.config.timeouts.save;
        if is_due {
            held.saved = Instant::now();
        }
        drop(held);
        self.jobs.metrics.idle_versions.inc();
        self.jobs.tell_snapshot(self.scene, None, &published, Some(progress));
        if is_due {
            self.jobs.saving.save_soon(self.scene);
        }
    }
}
