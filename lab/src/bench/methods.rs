//! The methods that are compared, each run for a number of seconds or samples.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use crate::paper::{Equation, PaperOptions, paper_update};
use crate::path::path_trace;
use rebake_core::{Budget, LightMap, Observer, Progress, Snapshot, Unobserved, World, bake, update};

use super::PreparedCase;

/// Which method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// From scratch, path by path.
    PathTrace,
    /// From scratch, by look-ups: [`rebake_core::bake`].
    Cached,
    /// Update of the old map as published: [`crate::paper`].
    Paper {
        /// N.
        iterations: u32,
        /// M.
        path_length: u32,
        /// (3) or (4).
        equation: Equation,
    },
    /// Update of the old map: [`rebake_core::update`].
    Rebake,
    /// Update of the old map through the service, over loopback ([`super::Service::run`]).
    Service,
}

/// When a run ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal {
    /// After about this many seconds, and never before its first round.
    Seconds(f64),
    /// After this many samples per element.
    Samples(u32),
}

/// A light map and what it cost.
pub struct Timed {
    /// The result.
    pub map: Arc<LightMap>,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Seconds of all processors, where the system tells: on a machine that has other work, too, the fairer measure.
    pub cpu_seconds: Option<f64>,
    /// Samples per element.
    pub samples: u32,
    /// Rays traced.
    pub rays: u64,
    /// Stated error, where there is one.
    pub estimated_rmse: Option<f32>,
}

impl Method {
    /// Its name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Method::PathTrace => "path-trace",
            Method::Cached => "cached",
            Method::Paper { .. } => "paper",
            Method::Rebake => "rebake",
            Method::Service => "service",
        }
    }

    /// Whether it starts from the old light map.
    pub fn is_update(self) -> bool {
        matches!(self, Method::Paper { .. } | Method::Rebake)
    }
}

impl Goal {
    /// Seconds that the run has; none where samples count.
    pub fn seconds(self) -> Option<f64> {
        match self {
            Goal::Seconds(s) => Some(s),
            Goal::Samples(_) => None,
        }
    }

    /// For people.
    pub fn describe(self) -> String {
        match self {
            Goal::Seconds(s) => format!("{s} s"),
            Goal::Samples(n) => format!("{n} samples"),
        }
    }

    fn samples(self) -> u32 {
        match self {
            Goal::Seconds(_) => 1 << 20,
            Goal::Samples(n) => n,
        }
    }
}

/// Time since a start, on the wall and on the processors.
struct Stopwatch {
    start: Instant,
    cpu: Option<f64>,
}

impl Stopwatch {
    fn start() -> Stopwatch {
        Stopwatch { start: Instant::now(), cpu: process_cpu_seconds() }
    }

    fn seconds(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    fn cpu_seconds(&self) -> Option<f64> {
        Some(process_cpu_seconds()? - self.cpu?)
    }

    fn stop(&self, map: LightMap, samples: u32, rays: u64) -> Timed {
        let (seconds, cpu_seconds) = (self.seconds(), self.cpu_seconds());
        Timed { map: Arc::new(map), seconds, cpu_seconds, samples, rays, estimated_rmse: None }
    }
}

/// What this process has used of the processors so far: Linux tells in hundredths of a second.
pub fn process_cpu_seconds() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    // Behind the name, which may hold anything: user and system time are the 12th and 13th field.
    let mut fields = text.rsplit_once(')')?.1.split_whitespace().skip(11);
    let mut ticks = || fields.next()?.parse::<f64>().ok();
    Some((ticks()? + ticks()?) / 100.0)
}

/// Ends a run by the clock and keeps the last snapshot.
struct Clock {
    start: Stopwatch,
    goal: Goal,
    last: Mutex<Option<Timed>>,
}

impl Clock {
    fn start(goal: Goal) -> Clock {
        Clock { start: Stopwatch::start(), goal, last: Mutex::new(None) }
    }

    fn finish(self) -> Option<Timed> {
        self.last.into_inner().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Observer for Clock {
    fn plan_round(&self, so_far: &Progress, proposed: u32) -> u32 {
        let Some(seconds) = self.goal.seconds() else { return proposed };
        let elapsed = self.start.seconds();
        if so_far.samples_per_element == 0 {
            return proposed;
        }
        let per_sample = elapsed / f64::from(so_far.samples_per_element);
        let affordable = ((seconds - elapsed) / per_sample).floor().max(0.0) as u32;
        // Rather stop than begin a round that is hardly worth its fixed costs.
        if affordable < so_far.samples_per_element / 4 { 0 } else { affordable.min(proposed) }
    }

    fn snapshot(&self, map: &Arc<LightMap>, _: Snapshot, progress: &Progress) {
        let timed = Timed {
            map: Arc::clone(map),
            seconds: self.start.seconds(),
            cpu_seconds: self.start.cpu_seconds(),
            samples: progress.samples_per_element,
            rays: progress.rays,
            estimated_rmse: progress.estimated_rmse,
        };
        *self.last.lock().unwrap_or_else(PoisonError::into_inner) = Some(timed);
    }
}

/// Runs a method on a prepared case; `base` is right for the world before the edit. None where the method cannot do
/// the edit.
pub fn run_method(method: Method, case: &PreparedCase, base: &LightMap, goal: Goal, seed: u64) -> Option<Timed> {
    if let Method::Paper { iterations, path_length, equation } = method {
        let options = PaperOptions { samples: 1, iterations, path_length, equation };
        return update_as_published(case, base, options, goal, seed);
    }
    let clock = Clock::start(goal);
    let budget = Budget { samples_per_element: goal.samples(), target_rmse: None };
    match method {
        Method::Paper { .. } | Method::Service => {}
        Method::PathTrace => return Some(trace_whole(&case.after, goal, seed)),
        // Nobody cancels: what is dropped is the map that the clock has, too.
        Method::Cached => drop(bake(&case.after, &budget, seed, &clock)),
        Method::Rebake => drop(update(&case.transition, base, &budget, None, seed, &clock)),
    }
    clock.finish()
}

/// The published method takes its number of samples beforehand: a first run, whose time does not count, tells how many
/// fit.
fn update_as_published(
    case: &PreparedCase,
    base: &LightMap,
    options: PaperOptions,
    goal: Goal,
    seed: u64,
) -> Option<Timed> {
    let run = |samples: u32| {
        let watch = Stopwatch::start();
        let options = PaperOptions { samples, ..options };
        let done = paper_update(&case.transition, base, &options, seed, &Unobserved).ok()?;
        Some(watch.stop(done.map, samples, done.rays))
    };
    match goal {
        Goal::Samples(n) => run(n),
        Goal::Seconds(s) => {
            let probe = run(2)?;
            let samples = (2.0 * s / probe.seconds) as u32;
            if samples == 2 { Some(probe) } else { run(samples.max(1)) }
        }
    }
}

/// Paths per element of the first call, which tells the speed.
const FIRST_PATHS: u32 = 2;

fn trace_whole(world: &World, goal: Goal, seed: u64) -> Timed {
    let slots: Vec<u32> =
        (0..world.slots() as u32).filter(|&i| world.areas()[i as usize] > 0.0 && world.is_valid(i as usize)).collect();
    let watch = Stopwatch::start();
    let mut map = LightMap::black(world.slots());
    let (mut total, mut rays) = (0u32, 0);
    loop {
        let count = match goal {
            Goal::Samples(n) => n.saturating_sub(total),
            Goal::Seconds(_) if total == 0 => FIRST_PATHS,
            Goal::Seconds(s) => {
                let elapsed = watch.seconds();
                let affordable = ((s - elapsed) / (elapsed / f64::from(total))) as u32;
                // The tracer takes whole batches where there are many paths.
                if affordable > 16 { affordable / 16 * 16 } else { affordable }
            }
        };
        if count == 0 {
            break;
        }
        let Ok((traced, r)) = path_trace(world, &slots, count, seed.wrapping_add(u64::from(total) << 32), &Unobserved)
        else {
            break;
        };
        rays += r;
        let weight = count as f32 / (total + count) as f32;
        for (&slot, t) in slots.iter().zip(&traced) {
            let slot = slot as usize;
            map.light.direct[slot] = map.light.direct[slot].lerp(t.direct, weight);
            map.light.indirect[slot] = map.light.indirect[slot].lerp(t.indirect, weight);
        }
        total += count;
    }
    watch.stop(map, total, rays)
}
