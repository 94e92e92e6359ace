//! More samples where variance and area say so.
//!
//! The squared error of a map, Σ A σ² / n over the elements, is least for a given number of samples Σ n where n is
//! proportional to σ √A. A few elements often carry most of it: those beside a lamp, or behind a slit.

use rayon::prelude::*;

use crate::world::World;

/// No element gets more than so many times the samples of the others.
const MOST: f64 = 16.0;

/// Elements per partial sum: fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 4096;

/// How many times the nominal number of samples an element gets.
#[derive(Clone, Debug, Default)]
pub(crate) struct Effort {
    /// Per slot; empty where all get the nominal number.
    factors: Vec<u8>,
}

impl Effort {
    /// For a world whose elements have the given variances so far. On average at most twice the nominal number.
    pub(crate) fn new(world: &World, variance: &[f32]) -> Effort {
        let smooth = smoothed(world, variance);
        let areas = world.areas();
        let need = |i: usize| f64::from(smooth[i] * areas[i]).sqrt();
        let len = smooth.len();
        let partial = |c: usize| {
            let range = c * CHUNK..len.min((c + 1) * CHUNK);
            range.filter(|&i| areas[i] > 0.0).fold((0.0, 0u32), |(sum, n), i| (sum + need(i), n + 1))
        };
        let partials: Vec<(f64, u32)> = (0..len.div_ceil(CHUNK)).into_par_iter().map(partial).collect();
        let (sum, count) = partials.into_iter().fold((0.0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        if sum <= 0.0 {
            return Effort::default();
        }
        let mean = sum / f64::from(count);
        let factor = |i: usize| (need(i) / mean).clamp(1.0, MOST) as u8;
        Effort { factors: (0..len).into_par_iter().with_min_len(CHUNK).map(factor).collect() }
    }

    /// As [`Effort::factors`] has it; none where these are no factors of a world of so many slots.
    pub(crate) fn of_factors(factors: &[u8], slots: usize) -> Option<Effort> {
        let is_one = factors.is_empty()
            || factors.len() == slots && factors.iter().all(|factor| (1..=MOST as u8).contains(factor));
        is_one.then(|| Effort { factors: factors.to_vec() })
    }

    /// How many times the nominal number of samples each slot gets; empty where all get it once.
    pub(crate) fn factors(&self) -> &[u8] {
        &self.factors
    }

    /// Samples of an element where most get `nominal`.
    #[inline]
    pub(crate) fn samples(&self, slot: u32, nominal: u32) -> u32 {
        nominal * self.factor(slot)
    }

    /// How many times the nominal number of samples an element gets.
    #[inline]
    pub(crate) fn factor(&self, slot: u32) -> u32 {
        self.factors.get(slot as usize).map_or(1, |f| u32::from(*f))
    }
}

/// Averages with neighbours, over the cells at each element: few rounds tell a variance badly, and least where a rare
/// bright sample is still to come.
fn smoothed(world: &World, variance: &[f32]) -> Vec<f32> {
    let mut smooth = variance.to_vec();
    for placed in &world.placed {
        for side in placed.sides() {
            let own = side.start as usize..side.end as usize;
            let variance = &variance[own.clone()];
            let mean = |(element, smooth): (usize, &mut f32)| {
                let of_neighbours = placed.layout.neighbours_of(element as u32).map(|other| variance[other as usize]);
                let (sum, count) = of_neighbours.fold((0.0, 0.0), |(sum, count), other| (sum + other, count + 1.0));
                if count > 0.0 {
                    *smooth = (variance[element] + 2.0 * sum / count) / 3.0;
                }
            };
            smooth[own].par_iter_mut().enumerate().with_min_len(CHUNK).for_each(mean);
        }
    }
    smooth
}
