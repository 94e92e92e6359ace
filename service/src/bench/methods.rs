//! The methods that are compared, each run for a number of seconds or samples.

use std::sync::{Arc, Mutex};
use std::time::Instant;

use rebake_core::path::path_trace;
use rebake_core::{Budget, LightMap, Observer, Progress, Unobserved, bake, update};

use super::PreparedCase;

/// A way to get the light map after an edit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// From scratch, path by path.
    PathTrace,
    /// From scratch, by look-ups: [`rebake_core::bake`].
    Cached,
    /// Update of the old map: [`rebake_core::update`].
    Rebake,
}

/// A light map and what it cost.
pub struct Timed {
    /// The result after the last round that fitted.
    pub map: Arc<LightMap>,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Samples per element.
    pub samples: u32,
    /// Rays traced.
    pub rays: u64,
    /// Stated error, where there is one.
    pub estimated_rmse: Option<f32>,
}

/// Ends a run by the clock and keeps the last snapshot.
struct Clock {
    start: Instant,
    seconds: f64,
    last: Mutex<Option<Timed>>,
}

impl Observer for Clock {
    fn plan_round(&self, so_far: &Progress, proposed: u32) -> u32 {
        let elapsed = self.start.elapsed().as_secs_f64();
        if so_far.samples_per_element == 0 {
            return proposed;
        }
        let per_sample = elapsed / f64::from(so_far.samples_per_element);
        let affordable = ((self.seconds - elapsed) / per_sample).floor().max(0.0) as u32;
        // Rather stop than begin a round that is hardly worth its fixed costs.
        if affordable < so_far.samples_per_element / 4 { 0 } else { affordable.min(proposed) }
    }

    fn snapshot(&self, map: &Arc<LightMap>, progress: &Progress) {
        let timed = Timed {
            map: Arc::clone(map),
            seconds: self.start.elapsed().as_secs_f64(),
            samples: progress.samples_per_element,
            rays: progress.rays,
            estimated_rmse: progress.estimated_rmse,
        };
        if let Ok(mut last) = self.last.lock() {
            *last = Some(timed);
        }
    }
}

/// Runs a method for about `seconds` (at least its first round) or `samples`, whichever ends first.
pub fn run_method(method: Method, case: &PreparedCase, base: &LightMap, seconds: f64, samples: u32, seed: u64) -> Option<Timed> {
    let clock = Clock { start: Instant::now(), seconds, last: Mutex::new(None) };
    let budget = Budget { samples_per_element: samples, target_rmse: None };
    match method {
        Method::PathTrace => return Some(trace_whole(case, seconds, samples, seed)),
        Method::Cached => drop(bake(&case.transition.after, &budget, seed, &clock)),
        Method::Rebake => drop(update(&case.transition, base, &budget, None, seed, &clock)),
    }
    clock.last.into_inner().ok().flatten()
}

fn trace_whole(case: &PreparedCase, seconds: f64, samples: u32, seed: u64) -> Timed {
    let world = &case.transition.after;
    let slots: Vec<u32> = (0..world.slots() as u32).filter(|&i| world.areas()[i as usize] > 0.0).collect();
    let start = Instant::now();
    let mut map = LightMap::black(world.slots());
    let (mut total, mut rays) = (0u32, 0);
    while total < samples {
        let elapsed = start.elapsed().as_secs_f64();
        let affordable = if total == 0 { 16.0 } else { (seconds - elapsed) / (elapsed / f64::from(total)) };
        let count = (affordable as u32 / 16 * 16).min(samples - total);
        if count == 0 {
            break;
        }
        let Ok((traced, r)) = path_trace(world, &slots, count, seed + u64::from(total), &Unobserved) else { break };
        rays += r;
        let weight = count as f32 / (total + count) as f32;
        for (&slot, t) in slots.iter().zip(&traced) {
            let slot = slot as usize;
            map.direct[slot] = map.direct[slot].lerp(t.direct, weight);
            map.indirect[slot] = map.indirect[slot].lerp(t.indirect, weight);
        }
        total += count;
    }
    Timed { map: Arc::new(map), seconds: start.elapsed().as_secs_f64(), samples: total, rays, estimated_rmse: None }
}
