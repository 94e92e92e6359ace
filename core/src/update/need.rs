//! How many samples an update needs: as many as its noise shows beside that of the map it began with.

use rayon::prelude::*;

use super::updater::{CHUNK, Updater};
use crate::accumulate::{Accumulator, Scatter};
use crate::solve::Solvable;
use crate::transport::sums;

/// What the error of the whole map may grow to by an update's noise, and that of new elements beside the old error around
/// them.
const WHOLE: f64 = 1.05;

/// What the error may grow to where the change is seen: few places, beside which the eye has the change itself.
const SEEN: f64 = 2.0;

/// A change is seen where it is above so many standard errors of the new map.
const SEEN_ABOVE: f32 = 2.0;

/// Some places: their area, and variances weighted by it.
#[derive(Clone, Copy)]
struct Places {
    area: f64,
    /// Of the update.
    own: f64,
    /// Of the old map.
    old: f64,
}

impl Places {
    fn of([area, own, old]: [f64; 3]) -> Places {
        Places { area, own, old }
    }

    /// How many times as large their variance is as it may be.
    fn excess(&self, allowed: f64) -> f64 {
        if self.own > 0.0 { self.own / allowed } else { 0.0 }
    }

    /// How many times as large it is as may be where the error is to grow by `factor` at most.
    fn growth(&self, factor: f64) -> f64 {
        self.excess((factor * factor - 1.0) * self.old)
    }
}

impl<V: Solvable> Updater<'_, V> {
    /// How many times the samples so far it takes until the update's own noise raises the error of the old map to
    /// [`WHOLE`] of what it was everywhere together, to [`SEEN`] where the change is seen, and makes new elements as
    /// good as what is around them. At most 1 where it is there.
    pub(super) fn needed(&self, sum: &Accumulator<V>) -> f32 {
        let scatter = sum.scatter();
        let [area, own, old, seen @ ..] = self.kept_places(sum, &scatter);
        let (kept, seen) = (Places::of([area, own, old]), Places::of(seen));
        let areas = self.world.areas();
        let of_new = |&slot: &u32| {
            let area = f64::from(areas[slot as usize]);
            [area, area * f64::from(scatter.of_whole(slot as usize)), 0.0]
        };
        let new = Places::of(sums(self.transition.new_slots.par_chunks(CHUNK), of_new));
        let all = Places { own: kept.own + new.own, ..kept };
        let around = if seen.area > 0.0 { seen } else { kept };
        let as_around = WHOLE * WHOLE * around.old / around.area.max(f64::MIN_POSITIVE) * new.area;
        all.growth(WHOLE).max(seen.growth(SEEN)).max(new.excess(as_around)) as f32
    }

    /// Area, variance of the update and of the old map: of all slots that keep an old value, and of those where the change
    /// is seen.
    fn kept_places(&self, sum: &Accumulator<V>, scatter: &Scatter<V>) -> [f64; 6] {
        let (areas, old, weights) = (self.world.areas(), &self.stage.old, self.stage.weights);
        let mean = sum.mean();
        let of_slot = |&slot: &u32| {
            let slot = slot as usize;
            let (own, old) = (scatter.of_whole(slot), old.variance(slot));
            let change = (mean.direct[slot] + mean.indirect[slot]).weighted(weights);
            let is_seen = change.length_squared() / 3.0 > SEEN_ABOVE * SEEN_ABOVE * (own + old);
            let area = f64::from(areas[slot]);
            let [own, old] = [own, old].map(|variance| area * f64::from(variance));
            if is_seen { [area, own, old, area, own, old] } else { [area, own, old, 0.0, 0.0, 0.0] }
        };
        sums(self.unchanged_slots.par_chunks(CHUNK), of_slot)
    }
}
