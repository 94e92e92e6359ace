//! The loop that bakes and updates share: rounds of growing size until a budget or the caller ends them.

use std::sync::Arc;

use crate::accumulate::Accumulator;
use crate::job::{Budget, Canceled, Pass, Progress};
use crate::lightmap::LightMap;
use crate::random::subseed;
use crate::transport::Work;

/// Samples per element of the first two rounds; every later round doubles the total.
const FIRST_SAMPLES: u32 = 4;

/// What one round is told.
pub(crate) struct Round<'a> {
    /// Samples per element.
    pub samples: u32,
    /// This round's own seed.
    pub seed: u64,
    /// What earlier rounds have gathered.
    pub sum: &'a Accumulator,
    /// Tells the caller which pass begins; `f32` is the part of the round that is done.
    pub begin: &'a dyn Fn(Pass, f32),
}

/// Runs rounds. `round` adds one to the accumulator; `compose` makes a light map of it, `stated` tells its
/// error, `enough` whether more rounds are of use.
#[expect(clippy::too_many_arguments, reason = "the parts of one loop, each named at its three calls")]
pub(crate) fn run(
    len: usize,
    budget: &Budget,
    seed: u64,
    work: &Work,
    stated: impl Fn(&LightMap) -> Option<f32>,
    enough: impl Fn(&Accumulator, &LightMap) -> bool,
    mut round: impl FnMut(&Round) -> Result<(Vec<glam::Vec3>, Vec<glam::Vec3>), Canceled>,
    compose: impl Fn(&Accumulator) -> LightMap,
) -> Result<Option<Arc<LightMap>>, Canceled> {
    let observer = work.observer();
    let mut sum = Accumulator::new(len);
    let mut last: Option<Arc<LightMap>> = None;
    let mut estimated_rmse = None;
    for index in 0.. {
        let left = budget.samples_per_element.saturating_sub(sum.samples());
        let proposed = sum.samples().max(FIRST_SAMPLES).min(left);
        let progress = |pass, round_samples, round_fraction| Progress {
            pass,
            samples_per_element: sum.samples(),
            round_samples,
            round_fraction,
            rays: work.rays(),
            estimated_rmse,
        };
        work.check()?;
        if proposed == 0 {
            break;
        }
        let samples = observer.plan_round(&progress(Pass::Direct, proposed, 0.0), proposed).min(proposed);
        if samples == 0 {
            break;
        }
        let begin = |pass, fraction| observer.progress(&progress(pass, samples, fraction));
        let (direct, indirect) = round(&Round { samples, seed: subseed(seed, index), sum: &sum, begin: &begin })?;
        sum.add(samples, &direct, &indirect);
        let map = Arc::new(compose(&sum));
        if sum.knows_variance() {
            estimated_rmse = stated(&map);
        }
        let done = Progress {
            pass: Pass::FinalGather,
            samples_per_element: sum.samples(),
            round_samples: samples,
            round_fraction: 1.0,
            rays: work.rays(),
            estimated_rmse,
        };
        observer.progress(&done);
        observer.snapshot(&map, &done);
        let reached = matches!((budget.target_rmse, estimated_rmse), (Some(target), Some(rmse)) if rmse <= target);
        let enough = reached || enough(&sum, &map);
        last = Some(map);
        if enough {
            break;
        }
    }
    Ok(last)
}
