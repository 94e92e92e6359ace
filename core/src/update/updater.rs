//! One stage of an update: the change of some layers, round by round.

use std::cell::RefCell;
use std::sync::Arc;

use glam::Vec3;

use super::extent::Extent;
use super::{Stage, direct, source};
use crate::accumulate::Accumulator;
use crate::focus::Focus;
use crate::job::{Canceled, Pass};
use crate::layers::Stack;
use crate::random::{Pcg32, subseed};
use crate::rounds::{First, Goal, Phase, Round, Rounds};
use crate::solve::{Exchange, Rows, Source, Subset};
use crate::transport::{Surfel, Value, Work};
use crate::world::{Transition, World};

/// Samples of the propagation per representative and round: at least, at most.
const PROPAGATION_SAMPLES: (u32, u32) = (8, 64);

/// Part of them that a change gets that drowns in the noise of the old map.
const LEAST_WEIGHT: f64 = 0.25;

/// Where the parts of a round are estimated element by element.
pub(super) struct Extents {
    direct: Extent,
    source: Extent,
}

/// What all rounds of a stage share.
pub(super) struct Updater<'a, V> {
    pub(super) transition: &'a Transition,
    pub(super) world: &'a World,
    pub(super) work: &'a Work<'a>,
    stage: Stage<'a, V>,
    /// The old light in the new slots; zero on new rows.
    old: Stack<V>,
    /// direct + indirect of `old`.
    pub(super) old_total: Vec<V>,
    /// direct + indirect of the map of `before`, in its slots.
    before_total: Vec<V>,
    /// Computed elements that keep an old value.
    static_rows: Vec<u32>,
    pub(super) subset: Subset,
    rows: Arc<Rows>,
    source: source::Source<'a>,
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

    /// Brings what is looked at up to date.
    pub(super) fn look_first(&self, focus: &Focus, goal: &Goal, work: &Work) -> Result<Option<First<V>>, Canceled> {
        let is_seen = focus.covers(self.world);
        if !is_seen.iter().any(|seen| *seen) {
            return Ok(None);
        }
        let extents = self.extents(|slot| is_seen[slot as usize]);
        let last = RefCell::new(None);
        let compose = |s: &Accumulator<V>| {
            let mut stack = self.compose(s);
            let unseen = self.static_rows.iter().copied().filter(|&slot| !is_seen[slot as usize]);
            stack.blend(&self.old, unseen, 1.0, None);
            stack.fill_invalid(&self.world.validity);
            last.replace(Some((stack.clone(), s.samples())));
            (self.stage.finish)(stack)
        };
        // The rest of the map is out of date: nothing can be stated about the whole.
        let (len, weights) = (self.world.slots(), self.stage.weights);
        let (budget, seed) = (&goal.first_budget(), goal.first_seed());
        let rounds = Rounds { len, weights, budget, seed, work, phase: Phase::Part };
        rounds.run(|_| None, |_| false, |r| self.round(r, &extents), compose)?;
        Ok(last.take().map(|(stack, samples)| First { stack, is_seen, samples }))
    }

    /// The mean of what was done first and what followed, by samples.
    pub(super) fn merge(&self, first: &First<V>, mut stack: Stack<V>, samples: u32) -> Stack<V> {
        first.merge(&mut stack, samples, self.static_rows.iter().copied(), Some(&self.old));
        stack.fill_invalid(&self.world.validity);
        stack
    }

    /// One independent estimate: changes on static rows, values on new rows.
    pub(super) fn round(&self, round: &Round<V>, extents: &Extents) -> Result<(Vec<V>, Vec<V>), Canceled> {
        let (world, work) = (self.world, self.work);
        (round.begin)(Pass::Direct, 0.0);
        let mut direct = vec![V::default(); world.slots()];
        self.direct.estimate(&extents.direct, &self.subset, round.samples, round.seed, work, &mut direct)?;

        (round.begin)(Pass::Object, 0.2);
        let mut indirect = vec![V::default(); world.slots()];
        self.new_rows(round, &mut direct, &mut indirect)?;

        (round.begin)(Pass::Source, 0.4);
        // What the rays of S look up in the new scene: the old map, and the new rows' own values.
        let mut guess = self.old_total.clone();
        for &slot in &self.transition.new_rows {
            guess[slot as usize] = direct[slot as usize] + indirect[slot as usize];
        }
        world.validity.fill(&mut guess);
        let maps = source::Maps { before: &self.before_total, after: &guess };
        let extent = &extents.source;
        self.source.estimate(extent, &self.subset, &maps, round, work, &mut direct, &mut indirect)?;

        (round.begin)(Pass::Propagation, 0.8);
        let bounces = self.propagate(&direct, &indirect, round)?;
        indirect.iter_mut().zip(bounces).for_each(|(i, b)| *i += b);
        Ok((direct, indirect))
    }

    /// Whether the change is larger than the light that is left: its noise would be, too, and a bake is the better
    /// update (design, section 3.9). The new rows' own light is no change.
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
        change > left
    }

    /// X = Σ_k u_k. New rows have gathered ΔD and the repainted surfaces already: they see only what S changed.
    fn propagate(&self, direct: &[V], indirect: &[V], round: &Round<V>) -> Result<Vec<V>, Canceled> {
        let world = self.world;
        let (mut seen_by_old, mut seen_by_new) = (vec![V::default(); world.slots()], vec![V::default(); world.slots()]);
        for &slot in &self.static_rows {
            let slot = slot as usize;
            seen_by_new[slot] = indirect[slot];
            seen_by_old[slot] = direct[slot] + indirect[slot];
        }
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
            if is_new.get(slot as usize).copied().unwrap_or(false) {
                return if near { V::default() } else { s.interpolate(elements, &seen_by_new) * s.albedo };
            }
            let change = s.interpolate(elements, &seen_by_old) * s.albedo;
            if !repainted {
                return change;
            }
            change + s.interpolate(elements, old_total) * repaint[s.part as usize]
        };
        let source = Source { radiance: change, sky: V::default() };
        let samples = (round.samples * 2).clamp(PROPAGATION_SAMPLES.0, PROPAGATION_SAMPLES.1);
        let samples = (f64::from(samples) * self.weight_of(&seen_by_old)).ceil() as u32;
        let seed = subseed(round.seed, 0x9409);
        let exchange = Exchange::trace(world, &self.subset, &self.rows, &source, samples, seed, self.work)?;
        let bounces = exchange.to_representatives(&self.subset, &exchange.all_bounces(&exchange.first));
        let mut field = self.subset.interpolate(&bounces);
        world.validity.fill(&mut field);
        Ok(field)
    }

    /// How well a change has to be known beside the noise that the old map has anyway, up to 1.
    fn weight_of(&self, change: &[V]) -> f64 {
        let square = |v: &V| v.weighted(self.stage.weights).length_squared() / 3.0;
        let squares: Vec<f32> = change.iter().map(square).collect();
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
