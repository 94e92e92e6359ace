//! Error over time while objects are moved ten times per second: what clients of the service have, beside a client that
//! bakes the whole scene at every move and shows what it has (after figure 4 of Ulschmid et al. 2024).

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use glam::{DMat4, DQuat, DVec3};
use rebake_core::{Budget, Edit, LightMap, Observer, Progress, Snapshot, Stated, World, bake};

use super::report::ReferenceReport;
use super::study::{Curve, Point, StudyCase, as_map};
use super::{Base, Drag, Options, PreparedCase, Reference, Seen, Service, Watcher};

/// Between two moves.
const STEP: Duration = Duration::from_millis(100);
/// Places that the objects pass, there and back.
const PLACES: usize = 6;
/// Measured after the drag, seconds.
const REST: f64 = 2.0;
/// Between two points of a curve, seconds.
const GRID: f64 = 0.05;

/// Drags the objects of a `move` case from their place to the case's, and back, and so on.
pub(super) fn measure(
    case: &PreparedCase,
    moves: u32,
    options: &Options,
    service: &dyn Service,
    watcher: &mut dyn Watcher,
) -> Result<StudyCase> {
    let mode = options.mode;
    let track = Track::new(case, moves)?;
    watcher.step(&case.name, "references");
    let references: Vec<Reference> = track
        .worlds
        .iter()
        .map(|world| Reference::trace(world, options.reference_elements, options.reference_samples, options.seed))
        .collect();
    let mut errors: [Vec<Vec<f64>>; 2] = Default::default();
    for k in 0..options.seeds {
        let base = Base::of_run(options, k);
        watcher.step(&case.name, &format!("drag, run {}", k + 1));
        let shown = service.drag(&case.before, base, &track.drag())?;
        watcher.step(&case.name, &format!("re-baking, run {}", k + 1));
        let before = Seen { seconds: 0.0, values: shown.first().context("no light map")?.values.clone() };
        let rebaked = rebake(&track, before, mode, base.seed);
        errors[0].push(track.errors(shown, &references, mode));
        errors[1].push(track.errors(rebaked, &references, mode));
    }
    let labels = ["update", "re-baking"];
    Ok(StudyCase {
        name: case.name.clone(),
        about: format!("{moves} moves, ten per second, {PLACES} places; at rest from {:.1} s on", track.at_rest()),
        reference: ReferenceReport::of(&references[0], mode),
        curves: labels.into_iter().zip(&errors).map(|(label, runs)| track.curve(label, runs)).collect(),
        times: Vec::new(),
    })
}

/// Where the objects are, when.
struct Track {
    /// One world per place; all have the same slots.
    worlds: Vec<World>,
    /// The edits that bring the objects to the places.
    edits: Vec<Vec<Edit>>,
    moves: u32,
}

impl Track {
    fn new(case: &PreparedCase, moves: u32) -> Result<Track> {
        let (mut worlds, mut edits) = (vec![case.before.clone()], vec![Vec::new()]);
        let home = |name: &str| {
            let object = case.before.scene.objects.iter().find(|object| object.name == *name);
            object.map(|object| object.world_from_object).context("the object is not in the scene")
        };
        for place in 0..PLACES {
            let share = place as f64 / (PLACES - 1) as f64;
            let between = |edit: &Edit| match edit {
                Edit::Move { object, transform } => {
                    let transform = between(&home(object)?, transform, share);
                    Ok(Edit::Move { object: object.clone(), transform })
                }
                other => anyhow::bail!("only moves can be dragged, not {other:?}"),
            };
            let there: Vec<Edit> = case.edits.iter().map(between).collect::<Result<_>>()?;
            if place > 0 {
                let world = case.before.apply(&there)?.after;
                let trees = world.rebuilt_trees();
                let world = world.with_trees(trees).context("the trees do not fit the scene")?;
                ensure!(world.slots() == case.before.slots(), "transform: has to keep the objects' size");
                worlds.push(world);
                edits.push(there);
            } else {
                edits[0] = there;
            }
        }
        Ok(Track { worlds, edits, moves })
    }

    /// All moves, as a client asks for them.
    fn drag(&self) -> Drag {
        let steps = (0..self.moves).map(|step| self.edits[self.place(step)].clone()).collect();
        Drag { steps, pause: STEP, duration: Duration::from_secs_f64(self.end()) }
    }

    /// Seconds from the first move to one step after the last.
    fn at_rest(&self) -> f64 {
        STEP.as_secs_f64() * f64::from(self.moves)
    }

    /// Seconds that are measured.
    fn end(&self) -> f64 {
        self.at_rest() + REST
    }

    /// The move that is the last one at this time.
    fn step_at(&self, seconds: f64) -> u32 {
        ((seconds / STEP.as_secs_f64() + 1e-9) as u32).min(self.moves - 1)
    }

    /// The place that a move leads to.
    fn place(&self, step: u32) -> usize {
        let period = 2 * (PLACES - 1);
        let at = (step as usize + 1) % period;
        at.min(period - at)
    }

    /// Errors on the grid: at each time that of the last map that was there, in the scene as it is then.
    fn errors(&self, shown: Vec<Seen>, references: &[Reference], mode: Stated) -> Vec<f64> {
        let maps: Vec<(f64, LightMap)> = shown.into_iter().map(|s| (s.seconds, as_map(s.values, mode))).collect();
        self.grid()
            .map(|seconds| {
                let known = maps.partition_point(|(arrival, _)| *arrival <= seconds).max(1) - 1;
                let reference = &references[self.place(self.step_at(seconds))];
                reference.mean_square_error(&maps[known].1, mode).root()
            })
            .collect()
    }

    fn grid(&self) -> impl Iterator<Item = f64> {
        (0..=(self.end() / GRID).round() as u32).map(|k| f64::from(k) * GRID)
    }

    /// The mean over runs.
    fn curve(&self, label: &str, runs: &[Vec<f64>]) -> Curve {
        let mean = |k: usize| runs.iter().map(|run| run[k]).sum::<f64>() / runs.len() as f64;
        let points: Vec<Point> = self.grid().enumerate().map(|(k, seconds)| Point { seconds, rmse: mean(k) }).collect();
        let dragged = points.iter().filter(|point| point.seconds < self.at_rest()).map(|point| point.rmse);
        let count = dragged.clone().count() as f64;
        Curve { label: label.to_owned(), mean_rmse: Some(dragged.sum::<f64>() / count), points }
    }
}

/// Part of the way from one place to another.
fn between(from: &DMat4, to: &DMat4, share: f64) -> DMat4 {
    let parts = |m: &DMat4| -> (DVec3, DQuat, DVec3) { m.to_scale_rotation_translation() };
    let (a, b) = (parts(from), parts(to));
    DMat4::from_scale_rotation_translation(a.0.lerp(b.0, share), a.1.slerp(b.1, share), a.2.lerp(b.2, share))
}

/// Bakes the scene from scratch as it is, over and over, on all threads; what it has is shown. A move ends a bake that
/// has something to show: one that has not would never come to it.
fn rebake(track: &Track, before: Seen, mode: Stated, seed: u64) -> Vec<Seen> {
    let shown = Mutex::new(vec![before]);
    let start = Instant::now();
    while start.elapsed().as_secs_f64() < track.end() {
        let step = track.step_at(start.elapsed().as_secs_f64());
        let watcher = Rebaking { track, start, step, has_light: AtomicBool::new(false), mode, shown: &shown };
        let budget = Budget { samples_per_element: 1 << 20, target_rmse: None };
        // Canceled by the next move or at the end: what it had until then has been shown.
        drop(bake(&track.worlds[track.place(step)], &budget, seed.wrapping_add(u64::from(step)), &watcher));
    }
    shown.into_inner().unwrap_or_else(PoisonError::into_inner)
}

/// One bake among them.
struct Rebaking<'a> {
    track: &'a Track,
    start: Instant,
    step: u32,
    has_light: AtomicBool,
    mode: Stated,
    shown: &'a Mutex<Vec<Seen>>,
}

impl Observer for Rebaking<'_> {
    fn canceled(&self) -> bool {
        let now = self.start.elapsed().as_secs_f64();
        now >= self.track.end() || self.has_light.load(Ordering::Relaxed) && self.track.step_at(now) != self.step
    }

    fn snapshot(&self, map: &Arc<LightMap>, _: Snapshot, _: &Progress) {
        let values = match self.mode {
            Stated::Full => (0..map.len()).map(|slot| map.total(slot)).collect(),
            Stated::Indirect => map.light.indirect.clone(),
        };
        let seen = Seen { seconds: self.start.elapsed().as_secs_f64(), values };
        self.shown.lock().unwrap_or_else(PoisonError::into_inner).push(seen);
        self.has_light.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_way_leads_there_and_back() {
        let track = Track { worlds: Vec::new(), edits: Vec::new(), moves: 12 };
        let places: Vec<usize> = (0..12).map(|step| track.place(step)).collect();
        assert_eq!(places, [1, 2, 3, 4, 5, 4, 3, 2, 1, 0, 1, 2]);
        let steps: Vec<u32> = [0.0, 0.05, 0.1, 0.199, 0.3, 1.1, 9.0].into_iter().map(|t| track.step_at(t)).collect();
        assert_eq!(steps, [0, 0, 1, 1, 3, 11, 11]);
        assert_eq!(track.grid().count(), 65);
    }

    #[test]
    fn halfway_is_halfway() {
        let from = DMat4::from_translation(DVec3::X);
        let to = DMat4::from_rotation_translation(DQuat::from_rotation_y(1.0), DVec3::new(3.0, 0.0, 2.0));
        let half = DMat4::from_rotation_translation(DQuat::from_rotation_y(0.5), DVec3::new(2.0, 0.0, 1.0));
        assert!(between(&from, &to, 0.5).abs_diff_eq(half, 1e-12));
        assert!(between(&from, &to, 0.0).abs_diff_eq(from, 1e-12));
    }
}
