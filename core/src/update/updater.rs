//! One stage of an update: the change of some layers, round by round.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::buffers::Buffers;
use super::extent::Extent;
use super::propagate::Aims;
use super::{Stage, direct, source};
use crate::accumulate::Accumulator;
use crate::job::{Canceled, Pass};
use crate::layers::{Apart, Stack};
use crate::lightmap::{LightMap, LightValues};
use crate::rounds::{First, Round};
use crate::solve::{Rows, Solvable, Subset};
use crate::transport::{Spots, Work, sums};
use crate::world::{Transition, World};

/// Slots per task.
pub(super) const CHUNK: usize = 4096;

/// Mean square of the change over that of the light after it from which on the update is a bake. Edits of furniture are
/// below 0.03; in bright rooms 0.5 has left a bias of 2 % behind (`tests/hard_cases.rs`).
const OUTGROWN: f64 = 0.4;

/// Where the parts of a round are estimated element by element.
pub(super) struct Extents {
    pub direct: Extent,
    pub source: Extent,
}

/// What all rounds of a stage share.
pub(super) struct Updater<'a, V> {
    pub(super) transition: &'a Transition,
    pub(super) world: &'a World,
    pub(super) work: &'a Work<'a>,
    pub(super) stage: &'a Stage<'a>,
    /// The sum of the old light, direct and indirect, in the new slots; black on new slots.
    pub(super) light: Vec<V>,
    /// direct + indirect of the map of `before`, in its slots.
    pub(super) before_total: Vec<V>,
    /// Computed elements that keep an old value.
    pub(super) unchanged_slots: Vec<u32>,
    /// Those of them whose direct light may change; that of the others stays.
    pub(super) direct_slots: Vec<u32>,
    /// Whether a slot is among `unchanged_slots`.
    pub(super) is_unchanged: Vec<bool>,
    pub(super) subset: Subset,
    pub(super) rows: Arc<Rows>,
    pub(super) source: source::SourceTerm<'a>,
    pub(super) direct: direct::DirectChange<'a>,
    /// Change of albedo per part of the new world; none where nothing is repainted.
    pub(super) repaint: Option<Vec<Vec3>>,
    /// Memory only: nothing is read of it that was not written in the same round.
    pub(super) buffers: Buffers<V>,
}

/// What rounds of a change go by. It can be had again from the transition and the first round's seed and samples, and,
/// for later rounds, the mean of those before.
#[derive(Clone)]
pub(super) struct Prior<V> {
    pub guide: Arc<Guide>,
    /// Indirect light of all new slots, one after the other, once there is some.
    pub new_slots: Option<Arc<[V]>>,
}

/// Where light and change were found first.
pub(super) struct Guide {
    /// Where much of all light is.
    pub spots: Option<Spots>,
    /// Of the bounces of the change.
    pub aims: Aims,
}

impl<'a, V: Solvable> Updater<'a, V> {
    pub(super) fn new(stage: &'a Stage<'a>, work: &'a Work<'a>) -> Updater<'a, V> {
        let transition = stage.transition;
        let world = &transition.after;
        let mut is_new = vec![false; world.slots()];
        transition.new_slots.iter().for_each(|&slot| is_new[slot as usize] = true);
        let is_unchanged = |(slot, is_new): (usize, &bool)| !is_new && world.is_computed(slot);
        let is_unchanged: Vec<bool> = is_new.par_iter().enumerate().with_min_len(CHUNK).map(is_unchanged).collect();
        let slots = (0..world.slots() as u32).into_par_iter().with_min_len(CHUNK);
        let unchanged_slots: Vec<u32> = slots.filter(|&slot| is_unchanged[slot as usize]).collect();
        let direct = direct::DirectChange::new(transition);
        let subset = Subset::new(world);
        let before_total = stage.old.total();
        let mut light: Vec<V> = transition.carry(&before_total);
        transition.new_slots.iter().for_each(|&slot| light[slot as usize] = V::default());
        Updater {
            transition,
            world,
            work,
            stage,
            light,
            before_total,
            rows: Arc::new(Rows::all(&subset)),
            source: source::SourceTerm::new(transition),
            direct_slots: direct.may_change(&unchanged_slots),
            unchanged_slots,
            is_unchanged,
            subset,
            direct,
            repaint: transition.repaints_anything().then(|| transition.repaint()),
            buffers: Buffers::new(),
        }
    }

    /// Area-weighted mean over the slots that keep an old value.
    pub(super) fn mean(&self, values: &[f32]) -> f64 {
        self.mean_of(|slot| values[slot])
    }

    /// Area-weighted mean, over the slots that keep an old value, of the variance that the old map brings along.
    pub(super) fn carried_variance(&self) -> f64 {
        let old = &self.stage.old;
        self.mean_of(|slot| old.variance(slot))
    }

    fn mean_of(&self, value: impl Fn(usize) -> f32 + Sync) -> f64 {
        let areas = self.world.areas();
        let of_slot = |&slot: &u32| {
            let area = f64::from(areas[slot as usize]);
            [area * f64::from(value(slot as usize)), area]
        };
        let [sum, area] = sums(self.unchanged_slots.par_chunks(CHUNK), of_slot);
        if area > 0.0 { sum / area } else { 0.0 }
    }

    /// Element by element where `is_wanted` says so, and S only near the edit; elsewhere on the subset.
    pub(super) fn extents(&self, is_wanted: impl Fn(u32) -> bool) -> Extents {
        let is_near = self.source.is_near();
        let slots = self.world.slots();
        Extents {
            direct: Extent::new(&self.direct_slots, &self.subset, slots, &is_wanted),
            source: Extent::new(&self.unchanged_slots, &self.subset, slots, |slot| is_wanted(slot) && is_near(slot)),
        }
    }

    /// The mean of what was done first and what followed, by samples.
    pub(super) fn merged(&self, first: &First<V>, sum: &Accumulator<V>) -> Stack<V> {
        let slots = self.unchanged_slots.iter().chain(&self.transition.new_slots).copied();
        first.merged(sum, slots, &self.world.validity)
    }

    /// The first estimate, and what others go by.
    pub(super) fn first_round(
        &self,
        round: &Round,
        extents: &Extents,
        out: &mut LightValues<V>,
    ) -> Result<Prior<V>, Canceled> {
        let (guide, bounces) = self.explore(round, extents, out)?;
        out.add_indirect(&bounces);
        self.buffers.give(bounces);
        Ok(Prior { guide: Arc::new(guide), new_slots: None })
    }

    /// What light arrives before any bounce, and its bounces, where nothing is known yet. What is found tells where to
    /// look: no ray looks twice.
    pub(super) fn explore(
        &self,
        round: &Round,
        extents: &Extents,
        out: &mut LightValues<V>,
    ) -> Result<(Guide, Vec<V>), Canceled> {
        let new_slots = &self.transition.new_slots;
        out.blacken(self.world.slots());
        self.straight(round, extents, new_slots, &mut out.direct)?;
        let spots = self.spots(&out.direct);
        self.arriving(round, extents, (new_slots, None), spots.as_ref(), out)?;
        let change = self.change(out);
        let aims = self.aims(&change, round)?;
        let bounces = self.propagate(change, round, &aims, None, &[])?;
        Ok((Guide { spots, aims }, bounces))
    }

    /// What the next round goes by.
    pub(super) fn prior(&self, last: Prior<V>, sum: &Accumulator<V>) -> Prior<V> {
        let indirect = &sum.mean().indirect;
        let new_slots = self.transition.new_slots.iter().map(|&slot| indirect[slot as usize]);
        Prior { new_slots: Some(new_slots.collect()), ..last }
    }

    /// One independent estimate: changes on unchanged slots, values on new slots.
    pub(super) fn round(
        &self,
        Prior { guide, new_slots }: &Prior<V>,
        round: &Round,
        extents: &Extents,
        out: &mut LightValues<V>,
    ) -> Result<(), Canceled> {
        out.blacken(self.world.slots());
        self.straight(round, extents, &self.transition.new_slots, &mut out.direct)?;
        self.arriving(round, extents, (&self.transition.new_slots, new_slots.as_deref()), guide.spots.as_ref(), out)?;
        let bounces = self.propagate(self.change(out), round, &guide.aims, None, &extents.source.fine)?;
        out.add_indirect(&bounces);
        self.buffers.give(bounces);
        Ok(())
    }

    /// Light straight from lights: ΔD on the unchanged slots of `extents`, all of it on some new slots.
    pub(super) fn straight(
        &self,
        round: &Round,
        extents: &Extents,
        new_slots: &[u32],
        direct: &mut [V],
    ) -> Result<(), Canceled> {
        (round.begin)(Pass::Direct, 0.0..0.2);
        self.direct.estimate(&extents.direct, &self.subset, round.samples, round.seed, self.work, direct)?;
        self.direct_of_new_slots(round, new_slots, direct)
    }

    /// What changes before any bounce beside direct light: S on the unchanged slots of `extents`, the indirect light of
    /// some new slots, with what is known of that of all. `parts`, changes on unchanged slots and values on new slots,
    /// holds direct light and what is known elsewhere; `spots` is where to aim.
    pub(super) fn arriving(
        &self,
        round: &Round,
        extents: &Extents,
        (new_slots, known): (&[u32], Option<&[V]>),
        spots: Option<&Spots>,
        parts: &mut LightValues<V>,
    ) -> Result<(), Canceled> {
        let (world, work) = (self.world, self.work);
        let LightValues { direct, indirect, .. } = parts;
        (round.begin)(Pass::Object, 0.2..0.4);
        self.new_slots(round, new_slots, known, spots, direct, indirect)?;

        (round.begin)(Pass::Source, 0.4..0.8);
        let mut light = self.buffers.take();
        light.clone_from(&self.light);
        for &slot in &self.transition.new_slots {
            light[slot as usize] = direct[slot as usize] + indirect[slot as usize];
        }
        world.validity.fill(&mut light);
        let maps = source::Maps { before: &self.before_total, after: &light, spots };
        self.source.estimate(&extents.source, &self.subset, &maps, round, work, direct, indirect)?;
        self.buffers.give(light);
        Ok(())
    }

    /// Where to aim at light that is not to be missed, once direct light is known.
    fn spots(&self, direct: &[V]) -> Option<Spots> {
        let mut light = match self.transition.new_slots.is_empty() {
            true => self.light.clone(),
            false => self.with_direct(direct),
        };
        self.world.validity.fill(&mut light);
        let spots = Spots::of_map(self.world, &light, self.stage.guides);
        self.buffers.give(light);
        spots
    }

    /// Old light with changed direct light on the unchanged elements, direct light alone on new slots.
    pub(super) fn with_direct(&self, direct: &[V]) -> Vec<V> {
        let mut field = self.buffers.take();
        self.light.par_iter().zip(direct).with_min_len(CHUNK).map(|(t, d)| *t + *d).collect_into_vec(&mut field);
        self.transition.new_slots.iter().for_each(|&slot| field[slot as usize] = direct[slot as usize]);
        field
    }

    /// Whether the change is so large beside the light that is left that a bake is the better update:
    /// what the subset gets wrong of it would show. The new slots' own light is no change.
    pub(super) fn outgrows_the_light(&self, LightValues { direct, indirect, .. }: &LightValues<V>) -> bool {
        let (areas, guides, before) = (self.world.areas(), self.stage.guides, self.light_before());
        let squares = |&slot: &u32| {
            let slot = slot as usize;
            let delta = (direct[slot] + indirect[slot]).weighted(guides);
            let then = before(slot) + delta;
            [delta, then].map(|light| f64::from(areas[slot]) * f64::from(light.length_squared()))
        };
        let [change, left] = sums(self.unchanged_slots.par_chunks(CHUNK), squares);
        change >= OUTGROWN * left && change > 0.0
    }

    /// All light that was there before the change, as it matters; none on new slots.
    pub(super) fn light_before(&self) -> impl Fn(usize) -> Vec3 + Sync {
        let (light, Stage { guides, around, .. }) = (&*self.light, self.stage);
        move |slot| around.map_or_else(|| light[slot].weighted(guides), |around| around[slot])
    }

    pub(super) fn new_flags(&self) -> Vec<bool> {
        let mut flags = vec![false; self.world.slots()];
        self.transition.new_slots.iter().for_each(|&slot| flags[slot as usize] = true);
        flags
    }

    /// The map of what lies side by side.
    pub(super) fn finish(&self, stack: &Stack<V>) -> LightMap {
        (self.stage.finish)(Apart::of_stack(stack, self.stage.weights.len()))
    }
}
