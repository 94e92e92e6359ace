//! X: the bounces of what has changed, through the new scene. On the subset, and near the edit element by element.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::allotment::{ALBEDO, Allotment};
use super::direct::LampChange;
use super::extent::Extent;
use super::updater::{CHUNK, Updater};
use crate::job::{Canceled, Pass};
use crate::lightmap::LightValues;
use crate::random::{PartSeed, Pcg32, subseed};
use crate::rounds::Round;
use crate::solve::{Exchange, Paths, Rows, Solvable};
use crate::space::Patch;
use crate::transport::{Effort, Radiance, Rough, Source, Spots, Surfel, blacken, gather};
use crate::world::World;

/// Samples of the propagation per representative and round: at least, at most.
const PROPAGATION_SAMPLES: (u32, u32) = (8, 64);

/// Part of them that a change gets that drowns in the noise of the old map.
const LEAST_WEIGHT: f64 = 0.25;

/// Samples of direct light per element that tell where its change is rough.
const ROUGH_SAMPLES: u32 = 4;

/// From so many samples on X is gathered element by element near the edit: before, noise hides what interpolation gets
/// wrong.
const FINE_FROM: u32 = 8;

/// Where paths look for a change, as it was estimated first.
pub(super) struct Aims {
    spots: Option<Spots>,
    /// Where what lamps change must not be looked up.
    rough: Rough,
    allotment: Allotment,
}

/// What somebody looks at, where X is known roughly.
pub(super) struct Seen<'a, V> {
    /// Representatives that it is interpolated from.
    pub rows: &'a Arc<Rows>,
    /// X everywhere.
    pub bounces: &'a [V],
    /// Per slot.
    pub is_seen: &'a [bool],
}

/// Light that has changed, as it is looked up.
pub(super) struct Change<'a, V> {
    /// ΔD + S, as elements see it that have an old value.
    seen_by_old: Vec<V>,
    /// S alone: new slots have gathered ΔD and the repainted surfaces already. Empty where there are none.
    seen_by_new: Vec<V>,
    is_new: Vec<bool>,
    /// What lamps change, where nothing else changes direct light: it is sampled where a bake samples it, at near surfaces
    /// and where interpolation between elements would be off.
    lamps: Option<LampChange<'a>>,
    /// Change of albedo per part, and the light that it reflects; none where nothing was repainted.
    repainted: Option<(&'a [Vec3], &'a [V])>,
    /// How much light has changed per slot ([`Change::amounts_of`]).
    amounts: Vec<f32>,
}

impl<V: Solvable> Change<'_, V> {
    /// Reflected change; with that of some bounces, where they are known.
    fn source<'s>(&'s self, bounces: Option<&'s [V]>, aims: &'s Aims) -> Source<'s, impl Radiance<V> + 's, V> {
        Source {
            radiance: move |slot: u32,
                            s: &Surfel,
                            near: bool,
                            share: Vec3,
                            rng: &mut Pcg32,
                            rays: &mut u64,
                            light: &mut V| {
                match self.lamps.as_ref().filter(|_| near || aims.rough.contains(s.cell)) {
                    Some(lamps) => self.add_sampled(lamps, bounces, s, near, share, rng, rays, light),
                    None => self.add_radiance(bounces, slot, s, near, share, light),
                }
            },
            looked_up: &self.seen_by_old,
            skies: &[],
            spots: aims.spots.as_ref(),
        }
    }

    /// What lamps change at a surface, which is all there is but for bounces.
    #[inline]
    #[expect(clippy::too_many_arguments, reason = "the inner loop of all gathers")]
    fn add_sampled(
        &self,
        lamps: &LampChange,
        bounces: Option<&[V]>,
        s: &Surfel,
        near: bool,
        share: Vec3,
        rng: &mut Pcg32,
        rays: &mut u64,
        light: &mut V,
    ) {
        let by = share * s.albedo;
        light.add_scaled(&lamps.at((s.ray_origin(), s.normal), rng, rays), by);
        if let (Some(bounces), Some(footprint)) = (bounces.filter(|_| !near), s.footprint) {
            footprint.for_each(bounces, |value, weight| light.add_scaled(value, by * weight));
        }
    }

    /// Near surfaces are looked up too: the change has no other estimate there. Its bounces are not. New slots have
    /// gone on from near surfaces through the new scene when they were gathered.
    #[inline]
    fn add_radiance(&self, bounces: Option<&[V]>, slot: u32, s: &Surfel, near: bool, share: Vec3, light: &mut V) {
        let Some(footprint) = s.footprint else { return };
        let mut add = |values: &[V], by: Vec3| {
            footprint.for_each(values, |value, weight| light.add_scaled(value, by * weight));
        };
        let by = share * s.albedo;
        bounces.filter(|_| !near).into_iter().for_each(|bounces| add(bounces, by));
        if self.is_new.get(slot as usize).copied().unwrap_or(false) {
            if !near {
                add(&self.seen_by_new, by);
            }
            return;
        }
        add(&self.seen_by_old, by);
        self.repainted.into_iter().for_each(|(repaint, light)| add(light, share * repaint[s.part as usize]));
    }
}

impl<V: Solvable> Change<'_, V> {
    /// How much the light has changed that leaves an element, over a usual albedo, mean over RGB.
    fn amounts_of(&self, world: &World, guides: &[Vec3]) -> Vec<f32> {
        let amount = |light: Vec3| light.abs().element_sum() / 3.0;
        let of_light = |light: &V| amount(light.weighted(guides));
        let mut amounts: Vec<f32> = self.seen_by_old.par_iter().with_min_len(CHUNK).map(of_light).collect();
        let Some((repaint, light)) = self.repainted else { return amounts };
        for placed in &world.placed {
            let repaint = &repaint[placed.placement.part_indices()];
            if repaint.iter().all(|change| *change == Vec3::ZERO) {
                continue;
            }
            let of_cell = |patch: &Patch| {
                let change = repaint[placed.surface.triangle_materials[patch.face as usize] as usize];
                (change != Vec3::ZERO).then_some((patch.elements, change))
            };
            for (elements, change) in placed.layout.of_cells(&placed.surface, of_cell) {
                for slot in placed.sides().flat_map(|side| elements.map(|element| (side.start + element) as usize)) {
                    let reflected = amount(light[slot].weighted(guides) * change) / ALBEDO;
                    amounts[slot] = amounts[slot].max(reflected);
                }
            }
        }
        amounts
    }
}

impl<V: Solvable> Updater<'_, V> {
    /// X = Σ_k u_k. Where X is `known` roughly, it is computed anew for what somebody looks at. Elements `near` the edit gather it themselves: interpolation is off in corners, where there
    /// are no representatives, and after many edits that adds up (a crate that was inserted and removed fifty times:
    /// 9.4 % of the mean light, 5.5 % with it).
    pub(super) fn propagate(
        &self,
        change: Change<V>,
        round: &Round,
        aims: &Aims,
        known: Option<&Seen<V>>,
        near: &[u32],
    ) -> Result<Vec<V>, Canceled> {
        let world = self.world;
        (round.begin)(Pass::Propagation, 0.8..1.0);
        let mut field = self.on_the_subset(&change, round, aims, known)?;
        if !near.is_empty() && round.earlier >= FINE_FROM {
            let bounces = known.map_or(&*field, |known| known.bounces);
            let source = change.source(Some(bounces), aims);
            let seed = subseed(round.seed, 0x9410);
            let found = gather(world, &source, near, round.samples, &Effort::default(), seed, self.work)?;
            drop(source);
            near.iter().zip(found).for_each(|(&slot, light)| field[slot as usize] = light);
            world.validity.fill(&mut field);
        }
        self.buffers.give(change.seen_by_old);
        if !change.seen_by_new.is_empty() {
            self.buffers.give(change.seen_by_new);
        }
        Ok(field)
    }

    /// X of all slots, interpolated.
    fn on_the_subset(
        &self,
        change: &Change<V>,
        round: &Round,
        aims: &Aims,
        known: Option<&Seen<V>>,
    ) -> Result<Vec<V>, Canceled> {
        let world = self.world;
        let samples = (round.samples * 2).clamp(PROPAGATION_SAMPLES.0, PROPAGATION_SAMPLES.1);
        let samples = (f64::from(samples) * self.weight_of(&change.amounts)).ceil() as u32;
        let seed = PartSeed::whole(subseed(round.seed, 0x9409));
        let rows = known.map_or(&self.rows, |known| known.rows);
        let (rows, paths) = aims.allotment.rows(world, &self.subset, rows, samples);
        let source = change.source(known.map(|known| known.bounces), aims);
        let paths = Paths::OfRows(&paths);
        let exchange = Exchange::trace(world, &self.subset, &Arc::new(rows), &source, paths, seed, self.work)?;
        let mut field = self.buffers.take();
        match known {
            None => {
                let found = exchange.to_representatives(&self.subset, &exchange.all_bounces(&exchange.first));
                self.subset.interpolate(&found, &mut field);
            }
            Some(Seen { bounces, is_seen, .. }) => {
                let found = exchange.to_representatives(&self.subset, &exchange.first);
                let elsewhere = bounces.par_iter().zip(*is_seen).with_min_len(CHUNK);
                let elsewhere = elsewhere.map(|(bounce, seen)| if *seen { V::default() } else { *bounce });
                elsewhere.collect_into_vec(&mut field);
                self.subset.add_where(|slot| is_seen[slot as usize], &found, &mut field);
            }
        }
        world.validity.fill(&mut field);
        Ok(field)
    }

    /// Where to look for a change.
    pub(super) fn aims(&self, change: &Change<V>, round: &Round) -> Result<Aims, Canceled> {
        let rough = change.lamps.as_ref().map(|lamps| match lamps.is_exact() {
            true => Ok(self.rough(&change.seen_by_old)),
            false => self.rough_by_itself(round),
        });
        let before = self.light_before();
        let amount = |slot: usize| before(slot).abs().element_sum() / 3.0;
        Ok(Aims {
            spots: Spots::of_change(self.world, &change.seen_by_old, self.stage.guides),
            rough: rough.transpose()?.unwrap_or_default(),
            allotment: Allotment::new(self.world, &self.subset, &change.amounts, amount),
        })
    }

    /// Where a change of direct light is rough, from samples that nothing else uses: a choice must not know the noise of
    /// what it chooses between.
    fn rough_by_itself(&self, round: &Round) -> Result<Rough, Canceled> {
        let mut change: Vec<V> = self.buffers.take();
        blacken(&mut change, self.world.slots());
        let every = Extent::new(&self.direct_slots, &self.subset, self.world.slots(), |_| true);
        let seed = subseed(round.seed, 0x940a);
        self.direct.estimate(&every, &self.subset, ROUGH_SAMPLES, seed, self.work, &mut change)?;
        self.world.validity.fill(&mut change);
        let rough = self.rough(&change);
        self.buffers.give(change);
        Ok(rough)
    }

    fn rough(&self, change: &[V]) -> Rough {
        let guides = self.stage.guides;
        Rough::new(self.world, |slot| change[slot as usize].weighted(guides).element_sum())
    }

    /// What has changed, of changes on unchanged slots and values on new slots.
    pub(super) fn change(&self, LightValues { direct, indirect, .. }: &LightValues<V>) -> Change<'_, V> {
        let seen = |light: &(dyn Fn(usize) -> V + Sync)| -> Vec<V> {
            let mut seen = self.buffers.take();
            let slots = self.is_unchanged.par_iter().enumerate().with_min_len(CHUNK);
            let light = |(slot, is_unchanged): (usize, &bool)| if *is_unchanged { light(slot) } else { V::default() };
            slots.map(light).collect_into_vec(&mut seen);
            seen
        };
        let mut seen_by_old = seen(&|slot| direct[slot] + indirect[slot]);
        let has_new = !self.transition.new_slots.is_empty();
        let mut seen_by_new = if has_new { seen(&|slot| indirect[slot]) } else { Vec::new() };
        // Elements that were invalid had a value copied from neighbours, and S has looked that up.
        for &slot in &self.transition.filled_slots {
            let slot = slot as usize;
            seen_by_old[slot] = direct[slot] + indirect[slot] - self.before_total[slot];
        }
        self.world.validity.fill(&mut seen_by_old);
        if has_new {
            self.world.validity.fill(&mut seen_by_new);
        }
        let repainted = self.repaint.as_deref().map(|repaint| (repaint, &*self.light));
        let lamps = self.direct.of_lamps().filter(|_| self.transition.new_slots.is_empty() && repainted.is_none());
        let is_new = self.new_flags();
        let change = Change { seen_by_old, seen_by_new, is_new, lamps, repainted, amounts: Vec::new() };
        Change { amounts: change.amounts_of(self.world, self.stage.guides), ..change }
    }

    /// How well a change has to be known beside the noise that the old map has anyway, up to 1.
    fn weight_of(&self, amounts: &[f32]) -> f64 {
        let squares: Vec<f32> = amounts.par_iter().with_min_len(CHUNK).map(|amount| amount * amount).collect();
        let carried = self.carried_variance();
        let ratio = if carried > 0.0 { self.mean(&squares) / carried } else { 1.0 };
        if ratio.is_finite() { ratio.clamp(LEAST_WEIGHT, 1.0) } else { 1.0 }
    }
}
