//! Which elements are averaged with which, and by how much.

use glam::Vec3;
use rayon::prelude::*;

use super::nearby::{Near, Nearby};
use crate::job::{Canceled, Observer};
use crate::world::World;

/// Elements agree up to so many standard errors of their difference, both taken to have the smaller one: bright light is
/// noisier than the dark beside it. Noise has heavier tails than a normal distribution and its variance is estimated from
/// few rounds: fewer shut out what belongs together, and the noise stays.
const AGREES: f32 = 4.0;

/// Variances are averaged over elements that are nearer than so many extents.
const POOL: f32 = 1.6;

/// What an element's own variance counts in that mean.
const OWN: f32 = 1.0 / 3.0;

/// Where those that agree by pairs differ by more than so many times their variance, all together, there is more than noise,
/// such as light that rises towards a lamp, and weights fall with the square of that; not where that is so for one of a
/// pair alone, which is a speck amid others.
const SCATTER: f32 = 1.5;

/// Elements with those that they take in.
pub(super) struct Weights {
    parts: Vec<Share>,
}

/// Some elements.
#[derive(Default)]
struct Share {
    rows: Vec<Row>,
    /// Behind one another: what the rows take in, with what it counts in the mean; the element itself counts the rest.
    entries: Vec<(u32, f32)>,
}

struct Row {
    slot: u32,
    /// The row's entries end before this one.
    end: u32,
}

impl Share {
    fn rows(&self) -> impl Iterator<Item = (usize, &[(u32, f32)])> {
        let mut start = 0;
        self.rows.iter().map(move |row| {
            let entries = &self.entries[start as usize..row.end as usize];
            start = row.end;
            (row.slot as usize, entries)
        })
    }
}

impl Weights {
    /// By some light (irradiance / π) and its variance (mean over RGB), per slot. What has none neither gives nor takes.
    pub(super) fn new(
        world: &World,
        light: &[Vec3],
        variance: &[f32],
        observer: &dyn Observer,
    ) -> Result<Weights, Canceled> {
        let nearby = Nearby::new(world);
        let pooled =
            |part: &mut Vec<(u32, f32)>, slot: u32, near: &[Near]| part.push((slot, pool(variance, slot, near)));
        let variance = spread(variance, nearby.each(observer, pooled)?.iter().flatten().copied());
        let difference2 = |a: u32, b: u32| (light[a as usize] - light[b as usize]).length_squared() / 3.0;
        let agreeing = |part: &mut Share, slot: u32, near: &[Near]| {
            let agrees = |near: &&Near| {
                let smaller = variance[slot as usize].min(variance[near.slot as usize]);
                smaller > 0.0 && difference2(slot, near.slot) <= AGREES * AGREES * 2.0 * smaller
            };
            part.entries.extend(near.iter().filter(agrees).map(|near| (near.slot, near.kernel())));
            part.rows.push(Row { slot, end: part.entries.len() as u32 });
        };
        let mut weights = Weights { parts: nearby.each(observer, agreeing)? };
        drop(nearby);
        let trust = weights.each(&vec![1.0; light.len()], |slot, entries| {
            let own = slot as u32;
            let sums = entries.iter().fold((0.0, 0.0), |(found, expected), &(other, kernel)| {
                let both = variance[slot] + variance[other as usize];
                (found + kernel * difference2(own, other), expected + kernel * both)
            });
            (SCATTER * sums.1 / sums.0.max(f32::MIN_POSITIVE)).min(1.0).powi(2)
        });
        weights.scale(|slot, other| trust[slot].max(trust[other]) * world.areas()[other]);
        let areas = world.areas().copy(0..light.len());
        let agreeing =
            weights.each(&areas, |slot, entries| areas[slot] + entries.iter().map(|(_, area)| area).sum::<f32>());
        weights.scale(|slot, other| agreeing[slot].max(agreeing[other]).recip());
        Ok(weights)
    }

    /// Values per slot, averaged.
    pub(super) fn average(&self, values: &[Vec3]) -> Vec<Vec3> {
        self.each(values, |slot, entries| {
            let change = |&(other, weight): &(u32, f32)| (values[other as usize] - values[slot]) * weight;
            values[slot] + entries.iter().map(change).sum::<Vec3>()
        })
    }

    /// Expected squared error per slot, mean over RGB, of averaged light that had this variance.
    pub(super) fn squared_errors(&self, light: impl Fn(usize) -> Vec3 + Sync, variance: &[f32]) -> Vec<f32> {
        self.each(variance, |slot, entries| {
            let (mut rest, mut sum, mut change) = (1.0, 0.0, Vec3::ZERO);
            for &(other, weight) in entries {
                rest -= weight;
                sum += weight * weight * variance[other as usize];
                change += (light(other as usize) - light(slot)) * weight;
            }
            sum + rest * rest * variance[slot] + change.length_squared() / 3.0
        })
    }

    /// `of(slot, its entries)` per slot; what has no row keeps its value.
    fn each<T: Copy + Send + Sync>(&self, values: &[T], of: impl Fn(usize, &[(u32, f32)]) -> T + Sync) -> Vec<T> {
        let part = |part: &Share| part.rows().map(|(slot, entries)| (slot as u32, of(slot, entries))).collect();
        let found: Vec<Vec<(u32, T)>> = self.parts.par_iter().map(part).collect();
        spread(values, found.into_iter().flatten())
    }

    /// Multiplies each weight by `factor(slot, other)`.
    fn scale(&mut self, factor: impl Fn(usize, usize) -> f32 + Sync) {
        self.parts.par_iter_mut().for_each(|part| {
            let mut start = 0;
            for row in &part.rows {
                let entries = &mut part.entries[start as usize..row.end as usize];
                entries.iter_mut().for_each(|(other, weight)| *weight *= factor(row.slot as usize, *other as usize));
                start = row.end;
            }
        });
    }
}

/// The values, but for some slots.
fn spread<T: Copy>(values: &[T], others: impl Iterator<Item = (u32, T)>) -> Vec<T> {
    let mut values = values.to_vec();
    others.for_each(|(slot, value)| values[slot as usize] = value);
    values
}

/// The variance of a slot, averaged over those beside it that have one; few rounds tell little by themselves.
fn pool(own: &[f32], slot: u32, near: &[Near]) -> f32 {
    let beside = near.iter().filter(|near| near.distance2 < POOL * POOL).map(|near| own[near.slot as usize]);
    let (sum, count) = beside.filter(|v| *v > 0.0).fold((0.0, 0.0), |(sum, count), v| (sum + v, count + 1.0));
    let own = own[slot as usize];
    if own == 0.0 || count == 0.0 { own } else { own * OWN + sum / count * (1.0 - OWN) }
}
