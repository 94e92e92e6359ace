//! One stage of an update: the change of some layers, round by round.

use std::cell::{OnceCell, RefCell};
use std::sync::Arc;

use glam::Vec3;

use super::buffers::Buffers;
use super::extent::Extent;
use super::propagate::Aims;
use super::{Stage, direct, source};
use crate::accumulate::Accumulator;
use crate::job::{Canceled, Pass};
use crate::layers::{Apart, Stack};
use crate::lightmap::{LightMap, LightValues};
use crate::rounds::{First, Round};
use crate::solve::{Rows, Subset};
use crate::transport::{Spots, Work};
use crate::value::Value;
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
    /// The old light in the new slots, for what is looked at first; zero on new rows.
    old: OnceCell<Stack<V>>,
    /// Its sum, direct and indirect, with new rows' own values as they were found last: what is looked up of the new
    /// scene.
    pub(super) light: RefCell<Vec<V>>,
    /// That sum with new rows black; empty where nothing is repainted.
    pub(super) old_total: Vec<V>,
    /// direct + indirect of the map of `before`, in its slots.
    pub(super) before_total: Vec<V>,
    /// Computed elements that keep an old value.
    pub(super) static_rows: Vec<u32>,
    /// Whether a slot is among `static_rows`.
    pub(super) is_static: Vec<bool>,
    pub(super) subset: Subset,
    pub(super) rows: Arc<Rows>,
    pub(super) source: source::Source<'a>,
    direct: direct::DirectChange<'a>,
    /// Where much of all light is, as it was known first: whatever it says, what is gathered has no bias.
    spots: OnceCell<Option<Spots>>,
    /// Of the bounces of the change.
    pub(super) aims: OnceCell<Aims>,
    /// Change of albedo per part of the new world.
    pub(super) repaint: Vec<Vec3>,
    pub(super) buffers: Buffers<V>,
}

impl<'a, V: Value> Updater<'a, V> {
    pub(super) fn new(stage: &'a Stage<'a>, work: &'a Work<'a>) -> Updater<'a, V> {
        let transition = stage.transition;
        let world = &transition.after;
        let mut is_new = vec![false; world.slots()];
        transition.new_rows.iter().for_each(|&slot| is_new[slot as usize] = true);
        let static_rows: Vec<u32> = world.computed_slots().into_iter().filter(|&i| !is_new[i as usize]).collect();
        let mut is_static = vec![false; world.slots()];
        static_rows.iter().for_each(|&slot| is_static[slot as usize] = true);
        let subset = Subset::new(world);
        let before_total = stage.old.total();
        let mut light: Vec<V> = transition.carry(&before_total);
        transition.new_rows.iter().for_each(|&slot| light[slot as usize] = V::default());
        Updater {
            transition,
            world,
            work,
            stage,
            old_total: if transition.repaints_anything() { light.clone() } else { Vec::new() },
            light: RefCell::new(light),
            before_total,
            old: OnceCell::new(),
            rows: Arc::new(Rows::all(&subset)),
            source: source::Source::new(transition),
            static_rows,
            is_static,
            subset,
            direct: direct::DirectChange::new(transition),
            spots: OnceCell::new(),
            aims: OnceCell::new(),
            repaint: transition.repaint(),
            buffers: Buffers::new(),
        }
    }

    /// Area-weighted mean over the rows that keep an old value.
    pub(super) fn mean(&self, values: &[f32]) -> f64 {
        self.mean_of(|slot| values[slot])
    }

    /// Area-weighted mean, over the rows that keep an old value, of the variance that the old map brings along.
    pub(super) fn carried_variance(&self) -> f64 {
        self.mean_of(|slot| self.stage.old.variance(slot))
    }

    fn mean_of(&self, value: impl Fn(usize) -> f32) -> f64 {
        self.world.area_mean(self.static_rows.iter().map(|&slot| slot as usize), |slot| f64::from(value(slot)))
    }

    /// The old light in the new slots; zero on new rows.
    pub(super) fn old(&self) -> &Stack<V> {
        self.old.get_or_init(|| self.stage.old.stack())
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
    pub(super) fn merge(&self, first: &First<V>, sum: &Accumulator<V>) -> Stack<V> {
        let mut stack = self.compose(sum);
        let rows = self.static_rows.iter().chain(&self.transition.new_rows).copied();
        first.merge(&mut stack, sum.samples(), rows, Some(self.old()));
        stack.fill_invalid(&self.world.validity);
        stack
    }

    /// One independent estimate: changes on static rows, values on new rows.
    pub(super) fn round(&self, round: &Round<V>, extents: &Extents, out: &mut LightValues<V>) -> Result<(), Canceled> {
        out.blacken(self.world.slots());
        let known = (round.sum.samples() > 0).then(|| round.sum.mean().indirect.as_slice());
        self.arriving(round, extents, (&self.transition.new_rows, known), out)?;
        let bounces = self.propagate(out, round, None, &extents.source.fine)?;
        out.add_indirect(&bounces);
        self.buffers.give(bounces);
        Ok(())
    }

    /// What changes before any bounce: ΔD and S on the static rows of `extents`, light of some new rows, with what is
    /// known of the indirect light of all. `parts`, changes on static rows and values on new rows, holds what is known
    /// elsewhere.
    pub(super) fn arriving(
        &self,
        round: &Round<V>,
        extents: &Extents,
        (new_rows, known): (&[u32], Option<&[V]>),
        parts: &mut LightValues<V>,
    ) -> Result<(), Canceled> {
        let (world, work) = (self.world, self.work);
        let LightValues { direct, indirect, .. } = parts;
        (round.begin)(Pass::Direct, 0.0);
        self.direct.estimate(&extents.direct, &self.subset, round.samples, round.seed, work, direct)?;

        (round.begin)(Pass::Object, 0.2);
        self.new_rows(round, new_rows, known, direct, indirect)?;

        (round.begin)(Pass::Source, 0.4);
        let light = &mut *self.light.borrow_mut();
        for &slot in &self.transition.new_rows {
            light[slot as usize] = direct[slot as usize] + indirect[slot as usize];
        }
        world.validity.fill(light);
        let maps = source::Maps { before: &self.before_total, after: light, spots: self.spots_of_light(light) };
        self.source.estimate(&extents.source, &self.subset, &maps, round, work, direct, indirect)
    }

    /// Where to aim at light that is not to be missed; `light` is all of it.
    pub(super) fn spots_of_light(&self, light: &[V]) -> Option<&Spots> {
        self.spots.get_or_init(|| Spots::of_map(self.world, light, self.stage.guides)).as_ref()
    }

    /// Whether the change is so large beside the light that is left that a bake is the better update:
    /// what the subset gets wrong of it would show. The new rows' own light is no change.
    pub(super) fn outgrows_the_light(&self, LightValues { direct, indirect, .. }: &LightValues<V>) -> bool {
        let (areas, guides, light) = (self.world.areas(), self.stage.guides, self.light.borrow());
        let (mut change, mut left) = (0.0f64, 0.0f64);
        for &slot in &self.static_rows {
            let slot = slot as usize;
            let delta = (direct[slot] + indirect[slot]).weighted(guides);
            let then = self.stage.around.map_or_else(|| light[slot].weighted(guides), |a| a[slot]) + delta;
            change += f64::from(areas[slot]) * f64::from(delta.length_squared());
            left += f64::from(areas[slot]) * f64::from(then.length_squared());
        }
        change >= OUTGROWN * left && change > 0.0
    }

    pub(super) fn new_flags(&self) -> Vec<bool> {
        let mut flags = vec![false; self.world.slots()];
        self.transition.new_rows.iter().for_each(|&slot| flags[slot as usize] = true);
        flags
    }

    /// Old values plus the mean change on static rows, mean values on new rows.
    pub(super) fn compose(&self, sum: &Accumulator<V>) -> Stack<V> {
        Stack::of_mean(sum, Some(self.old()), &self.world.validity)
    }

    /// The map of what lies side by side.
    pub(super) fn finish(&self, stack: &Stack<V>) -> LightMap {
        (self.stage.finish)(Apart::of_stack(stack, self.stage.weights.len()))
    }
}
