//! One stage of an update: the change of some layers, round by round.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::extent::Extent;
use super::{Stage, direct, source};
use crate::accumulate::Accumulator;
use crate::job::{Canceled, Pass};
use crate::layers::Stack;
use crate::random::{Pcg32, subseed};
use crate::rounds::{Estimate, First, Round};
use crate::solve::{Exchange, Rows, Subset};
use crate::transport::{Source, Spots, Surfel, Value, Work};
use crate::world::{Transition, World};

/// Slots per task.
const CHUNK: usize = 4096;

/// Samples of the propagation per representative and round: at least, at most.
const PROPAGATION_SAMPLES: (u32, u32) = (8, 64);

/// Mean square of the change over that of the light after it from which on the update is a bake. Edits of furniture are
/// below 0.03; in bright rooms 0.5 has left a bias of 2 % behind (`tests/hard_cases.rs`).
const OUTGROWN: f64 = 0.4;

/// Part of them that a change gets that drowns in the noise of the old map.
const LEAST_WEIGHT: f64 = 0.25;

/// Where the parts of a round are estimated element by element.
pub(super) struct Extents {
    pub direct: Extent,
    pub source: Extent,
}

/// Change of direct and of indirect light per slot; values on new rows.
#[derive(Clone)]
pub(super) struct Parts<V> {
    pub direct: Vec<V>,
    pub indirect: Vec<V>,
}

impl<V: Value> Parts<V> {
    pub(super) fn black(slots: usize) -> Parts<V> {
        Parts { direct: vec![V::default(); slots], indirect: vec![V::default(); slots] }
    }

    /// Black in some slots.
    pub(super) fn without(mut self, slots: &[bool]) -> Parts<V> {
        for slot in slots.iter().enumerate().filter(|(_, out)| **out).map(|(slot, _)| slot) {
            (self.direct[slot], self.indirect[slot]) = (V::default(), V::default());
        }
        self
    }

    /// Direct and indirect light, bounces and all.
    pub(super) fn with(self, bounces: &[V]) -> Estimate<V> {
        let Parts { direct, mut indirect } = self;
        indirect.par_iter_mut().zip(bounces).with_min_len(CHUNK).for_each(|(i, b)| *i += *b);
        (direct, indirect)
    }
}

/// What all rounds of a stage share.
pub(super) struct Updater<'a, V> {
    pub(super) transition: &'a Transition,
    pub(super) world: &'a World,
    pub(super) work: &'a Work<'a>,
    pub(super) stage: Stage<'a, V>,
    /// The old light in the new slots; zero on new rows.
    pub(super) old: Stack<V>,
    /// direct + indirect of `old`.
    pub(super) old_total: Vec<V>,
    /// direct + indirect of the map of `before`, in its slots.
    pub(super) before_total: Vec<V>,
    /// Computed elements that keep an old value.
    pub(super) static_rows: Vec<u32>,
    /// The same by slot.
    is_static: Vec<bool>,
    pub(super) subset: Subset,
    rows: Arc<Rows>,
    pub(super) source: source::Source<'a>,
    direct: direct::DirectChange<'a>,
    /// Change of albedo per part of the new world.
    repaint: Vec<Vec3>,
}

impl<'a, V: Value> Updater<'a, V> {
    pub(super) fn new(mut stage: Stage<'a, V>, work: &'a Work<'a>) -> Updater<'a, V> {
        let transition = stage.transition;
        let world = &transition.after;
        let before_total = stage.old.total();
        let mut old = std::mem::replace(&mut stage.old, Stack::black(0, 1)).carried_over(transition);
        let mut is_new = vec![false; world.slots()];
        transition.new_rows.iter().for_each(|&slot| is_new[slot as usize] = true);
        old.clear(&transition.new_rows);
        let static_rows: Vec<u32> = world.computed_slots().into_iter().filter(|&i| !is_new[i as usize]).collect();
        let mut is_static = vec![false; world.slots()];
        static_rows.iter().for_each(|&slot| is_static[slot as usize] = true);
        let subset = Subset::new(world);
        Updater {
            transition,
            world,
            work,
            stage,
            old_total: old.total(),
            before_total,
            old,
            rows: Arc::new(Rows::all(&subset)),
            source: source::Source::new(transition),
            static_rows,
            is_static,
            subset,
            direct: direct::DirectChange::new(transition),
            repaint: transition.repaint(),
        }
    }

    /// Area-weighted mean over the rows that keep an old value.
    pub(super) fn mean(&self, values: &[f32]) -> f64 {
        self.world.area_mean(self.static_rows.iter().map(|&slot| slot as usize), |slot| f64::from(values[slot]))
    }

    /// The same of what the old map brings along.
    pub(super) fn carried_variance(&self) -> f64 {
        self.mean(&self.old.variance)
    }

    /// Element by element where `is_wanted` says so, and S only near the edit; elsewhere on the subset.
    pub(super) fn extents(&self, is_wanted: impl Fn(u32) -> bool) -> Extents {
        let is_near = self.source.is_near();
        let slots = self.world.slots();
        Extents {
            direct: Extent::new(&self.static_rows, &self.subset, slots, &is_wanted),
            source: Extent::new(&self.static_rows, &self.subset, slots, |slot| is_wanted(slot) && is_near(slot)),
        }
    }

    /// The mean of what was done first and what followed, by samples.
    pub(super) fn merge(&self, first: &First<V>, mut stack: Stack<V>, samples: u32) -> Stack<V> {
        let rows = self.static_rows.iter().chain(&self.transition.new_rows).copied();
        first.merge(&mut stack, samples, rows, Some(&self.old));
        stack.fill_invalid(&self.world.validity);
        stack
    }

    /// One independent estimate: changes on static rows, values on new rows.
    pub(super) fn round(&self, round: &Round<V>, extents: &Extents) -> Result<Estimate<V>, Canceled> {
        let mut parts = Parts::black(self.world.slots());
        let known = (round.sum.samples() > 0).then(|| round.sum.indirect());
        self.arriving(round, extents, (&self.transition.new_rows, known.as_deref()), &mut parts)?;
        let bounces = self.propagate(&parts, round, None)?;
        Ok(parts.with(&bounces))
    }

    /// What changes before any bounce: ΔD and S on the static rows of `extents`, light of some new rows, with what is known
    /// of the indirect light of all. `parts` holds what is known elsewhere.
    pub(super) fn arriving(
        &self,
        round: &Round<V>,
        extents: &Extents,
        (new_rows, known): (&[u32], Option<&[V]>),
        parts: &mut Parts<V>,
    ) -> Result<(), Canceled> {
        let (world, work) = (self.world, self.work);
        let Parts { direct, indirect } = parts;
        (round.begin)(Pass::Direct, 0.0);
        self.direct.estimate(&extents.direct, &self.subset, round.samples, round.seed, work, direct)?;

        (round.begin)(Pass::Object, 0.2);
        self.new_rows(round, new_rows, known, direct, indirect)?;

        (round.begin)(Pass::Source, 0.4);
        // What the rays of S look up in the new scene: the old map, and the new rows' own values.
        let mut guess = self.old_total.par_iter().with_min_len(CHUNK).copied().collect::<Vec<V>>();
        for &slot in &self.transition.new_rows {
            guess[slot as usize] = direct[slot as usize] + indirect[slot as usize];
        }
        world.validity.fill(&mut guess);
        let maps = source::Maps { before: &self.before_total, after: &guess };
        self.source.estimate(&extents.source, &self.subset, &maps, round, work, direct, indirect)
    }

    /// Whether the change is so large beside the light that is left that a bake is the better update (design, section 3.9):
    /// what the subset gets wrong of it would show. The new rows' own light is no change.
    pub(super) fn outgrows_the_light(&self, direct: &[V], indirect: &[V]) -> bool {
        let (areas, weights) = (self.world.areas(), self.stage.weights);
        let (mut change, mut left) = (0.0f64, 0.0f64);
        for &slot in &self.static_rows {
            let slot = slot as usize;
            let delta = (direct[slot] + indirect[slot]).weighted(weights);
            let then = self.stage.around.map_or_else(|| self.old_total[slot].weighted(weights), |a| a[slot]) + delta;
            change += f64::from(areas[slot]) * f64::from(delta.length_squared());
            left += f64::from(areas[slot]) * f64::from(then.length_squared());
        }
        change >= OUTGROWN * left && change > 0.0
    }

    /// X = Σ_k u_k. New rows have gathered ΔD and the repainted surfaces already: they see only what S changed. Where X is
    /// `known` roughly, only what some rows gather of it is computed anew, and the answer is of use for them only.
    pub(super) fn propagate(
        &self,
        parts: &Parts<V>,
        round: &Round<V>,
        known: Option<(&Arc<Rows>, &[V])>,
    ) -> Result<Vec<V>, Canceled> {
        let world = self.world;
        let Parts { direct, indirect } = parts;
        (round.begin)(Pass::Propagation, 0.8);
        let seen = |light: &(dyn Fn(usize) -> V + Sync)| -> Vec<V> {
            let slots = self.is_static.par_iter().enumerate().with_min_len(CHUNK);
            slots.map(|(slot, is_static)| if *is_static { light(slot) } else { V::default() }).collect()
        };
        let mut seen_by_old = seen(&|slot| direct[slot] + indirect[slot]);
        let mut seen_by_new = seen(&|slot| indirect[slot]);
        // Elements that came out of a solid had a value copied from neighbours, and S has looked that up.
        for &slot in &self.transition.filled_rows {
            let slot = slot as usize;
            seen_by_old[slot] = direct[slot] + indirect[slot] - self.before_total[slot];
        }
        world.validity.fill(&mut seen_by_old);
        world.validity.fill(&mut seen_by_new);
        let is_new = self.new_flags();
        let (repaint, old_total) = (&self.repaint, &self.old_total);
        let repainted = repaint.iter().any(|r| *r != Vec3::ZERO);
        // Near surfaces are looked up too: the change has no other estimate there. Its bounces are not. New rows have
        // gone on from near surfaces through the new scene when they were gathered.
        let change = |slot: u32, s: &Surfel, near: bool, _: &mut Pcg32, _: &mut u64| {
            let Some(elements) = s.elements else { return V::default() };
            let bounced = match known {
                Some((_, bounces)) if !near => s.interpolate(elements, bounces) * s.albedo,
                _ => V::default(),
            };
            if is_new.get(slot as usize).copied().unwrap_or(false) {
                return if near { bounced } else { bounced + s.interpolate(elements, &seen_by_new) * s.albedo };
            }
            let change = bounced + s.interpolate(elements, &seen_by_old) * s.albedo;
            if !repainted {
                return change;
            }
            change + s.interpolate(elements, old_total) * repaint[s.part as usize]
        };
        let spots = Spots::of_map(world, &seen_by_old, self.stage.weights);
        let source = Source { radiance: change, looked_up: &seen_by_old, sky: V::default(), spots: spots.as_ref() };
        let samples = (round.samples * 2).clamp(PROPAGATION_SAMPLES.0, PROPAGATION_SAMPLES.1);
        let samples = (f64::from(samples) * self.weight_of(&seen_by_old)).ceil() as u32;
        let seed = subseed(round.seed, 0x9409);
        let rows = known.map_or(&self.rows, |(rows, _)| rows);
        let exchange = Exchange::trace(world, &self.subset, rows, &source, samples, seed, self.work)?;
        let bounces = match known {
            Some(_) => exchange.to_representatives(&self.subset, &exchange.first),
            None => exchange.to_representatives(&self.subset, &exchange.all_bounces(&exchange.first)),
        };
        let mut field = self.subset.interpolate(&bounces);
        world.validity.fill(&mut field);
        Ok(field)
    }

    /// How well a change has to be known beside the noise that the old map has anyway, up to 1.
    fn weight_of(&self, change: &[V]) -> f64 {
        let square = |v: &V| v.weighted(self.stage.weights).length_squared() / 3.0;
        let squares: Vec<f32> = change.par_iter().with_min_len(CHUNK).map(square).collect();
        let carried = self.mean(&self.old.variance);
        let ratio = if carried > 0.0 { self.mean(&squares) / carried } else { 1.0 };
        if ratio.is_finite() { ratio.clamp(LEAST_WEIGHT, 1.0) } else { 1.0 }
    }

    pub(super) fn new_flags(&self) -> Vec<bool> {
        let mut flags = vec![false; self.world.slots()];
        self.transition.new_rows.iter().for_each(|&slot| flags[slot as usize] = true);
        flags
    }

    /// Old values plus the mean change on static rows, mean values on new rows.
    pub(super) fn compose(&self, sum: &Accumulator<V>) -> Stack<V> {
        let mut stack = Stack::mean_of(sum);
        stack.add(&self.old);
        stack.fill_invalid(&self.world.validity);
        stack
    }
}
