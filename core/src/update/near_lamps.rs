//! Edits of surfaces in maps of many layers. The lamps that matter near the edit are brought up to date each by itself, and
//! all others together along the same rays, as one layer more: what changes of their light is little, and goes to the
//! rest. So an edit costs what a map of a few layers would take.

use std::collections::BTreeSet;
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::Updated;
use super::layers::{Change, LayersUpdate, run_change};
use crate::job::Canceled;
use crate::layers::{Computed, Layer, LayerHeader, add_square_of_rest, off_by, renamed, thin};
use crate::lightmap::{AnyLight, BLOCK_SLOTS, LightMap, LightValues, SIDE_BY_SIDE};
use crate::value::with_layers;
use crate::world::{Emitters, Transition};

/// Lamps near an edit that are told apart, unless more of them change themselves.
const NEAR_LAMPS: usize = 7;

/// Elements within this many spacings of what changed tell which lamps matter.
const ZONE: f32 = 5.0;

/// Boxes around what changed, from which on one around all of them tells enough.
const BOXES: usize = 16;

/// Slots per task.
const CHUNK: usize = 4096;

/// Layers of a plan, by their places in it, ascending.
pub(super) struct Near {
    /// Those that are told apart.
    own: Vec<usize>,
    /// Those of lamps that are off and were lit by what changes, for which there is no room: they are lit anew when they
    /// are on again.
    lost: Vec<usize>,
}

impl LayersUpdate<'_> {
    /// Which layers are told apart; none where they are too many.
    pub(super) fn near_lamps(&self, regrouped: &[Arc<Layer>]) -> Option<Near> {
        let mut near: BTreeSet<usize> = self.plan.changed.iter().copied().collect();
        let moved: BTreeSet<u32> = self.transition.changed_keys().into_iter().collect();
        let Transition { before, after, .. } = self.transition;
        let stand = |emitters: &Emitters, name: &str| {
            emitters.all().any(|e| e.name == name && e.object.is_some_and(|key| moved.contains(&key)))
        };
        let is_moved = |(header, origin): &(LayerHeader, Option<usize>)| {
            origin.is_none()
                || header.lights.iter().any(|l| stand(&before.emitters, &l.name) || stand(&after.emitters, &l.name))
        };
        near.extend(self.plan.after.iter().enumerate().filter(|(_, layer)| is_moved(layer)).map(|(k, _)| k));
        near.remove(&0);
        if near.len() >= SIDE_BY_SIDE {
            return None;
        }
        let zone = zone(self.transition);
        let light = |k: &usize| self.plan.after[*k].1.map_or(0.0, |index| light_in(&regrouped[index], &zone));
        let others = (1..self.plan.after.len()).filter(|k| !near.contains(k));
        let mut by_light: Vec<(f32, usize)> =
            others.map(|k| (light(&k), k)).filter(|(light, _)| *light > 0.0).collect();
        by_light.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        // What is off is in no sum of others, and has to be told apart.
        let (dark, lit): (Vec<_>, Vec<_>) = by_light.into_iter().map(|(_, k)| k).partition(|&k| self.is_dark(k));
        near.extend(lit.into_iter().take(NEAR_LAMPS.saturating_sub(near.len())));
        let room = (SIDE_BY_SIDE - 1).saturating_sub(near.len()).min(dark.len());
        let (own, lost) = dark.split_at(room);
        near.extend(own);
        Some(Near { own: near.into_iter().collect(), lost: lost.to_vec() })
    }

    fn is_dark(&self, place: usize) -> bool {
        self.weights[place] == Vec3::ZERO
    }

    /// Brings the layers at some positions up to date, and all others together.
    pub(super) fn compute_near(&self, near: &Near, regrouped: &[Arc<Layer>]) -> Result<Option<Updated>, Canceled> {
        let Transition { before, after, .. } = self.transition;
        let origin = |k: usize| self.plan.after[k].1;
        let Near { own: near, lost } = near;
        let other = |k: usize| {
            let layer = renamed(&regrouped[origin(k)?], &self.plan.after[k].0);
            (!near.contains(&k) && !lost.contains(&k)).then_some(Other { place: k, layer, is_dark: self.is_dark(k) })
        };
        let others: Vec<Other> = (1..self.plan.after.len()).filter_map(other).collect();
        let rest = origin(0).map(|index| regrouped[index].clone()).unwrap_or_default();
        let together = sum_of(&rest, &others);
        let lights = others.iter().filter(|other| !other.is_dark).flat_map(|other| other.layer.lights.clone());
        let header = LayerHeader { name: rest.name.clone(), lights: lights.collect() };
        let old_header = |&k: &usize| origin(k).map(|index| self.plan.regrouped[index].header.clone());
        let old_headers = near.iter().map(|k| old_header(k).unwrap_or_default());
        let old_headers: Vec<LayerHeader> = std::iter::once(header.clone()).chain(old_headers).collect();
        let new_headers = near.iter().map(|&k| self.plan.after[k].0.clone());
        let headers: Vec<LayerHeader> = std::iter::once(header).chain(new_headers).collect();
        let own: Vec<Vec3> = std::iter::once(Vec3::ONE).chain(near.iter().map(|&k| self.weights[k])).collect();
        let stage = Transition {
            before: before.only_layers(&old_headers, &own),
            after: after.only_layers(&headers, &own),
            ..self.transition.clone()
        };
        let light = together.clone().into();
        let black = || Arc::new(Layer { light: LightValues::black(before.slots()).into(), ..Layer::default() });
        let old = near.iter().map(|&k| origin(k).map_or_else(black, |index| regrouped[index].clone()));
        let old: Vec<Arc<Layer>> = std::iter::once(Arc::new(Layer { light, ..Layer::default() })).chain(old).collect();
        let parting = Parting::new(self.transition, &rest, &together, others);
        let finish = |computed: Computed| self.assembled(near, &parting, computed, &own);
        let guides = stage.after.guides(&own);
        let change = Change { transition: &stage, headers, weights: own.clone(), guides, old };
        let updated = with_layers!(
            change.weights.len(),
            run_change(&change, self.transition, self.map, self.goal, self.work, &finish)
        )?;
        // Where all was lit anew, layers that were not told apart are those of another scene.
        if updated.as_ref().is_some_and(|updated| updated.baked) { self.bake_anew() } else { Ok(updated) }
    }

    /// The map of what was computed.
    fn assembled(&self, near: &[usize], parting: &Parting, computed: Computed, weights: &[Vec3]) -> LightMap {
        let slots = self.transition.after.slots();
        let mut light = LightValues::black(slots);
        light.variance = computed.variance.unwrap_or_else(|| vec![0.0; slots]);
        for (layer, weight) in computed.layers.iter().zip(weights) {
            light.add_light(AnyLight::Sparse(&layer.light), *weight);
        }
        let size = |slot: usize| light.direct[slot].abs().max_element() + light.indirect[slot].abs().max_element();
        let sizes: Vec<f32> = (0..slots).into_par_iter().with_min_len(CHUNK).map(size).collect();
        let mut rest = parting.rest(&computed.layers[0].light.to_dense());
        let mut layers: Vec<Option<Arc<Layer>>> = vec![None; self.plan.after.len()];
        for ((&k, layer), weight) in near.iter().zip(&computed.layers[1..]).zip(&weights[1..]) {
            layers[k] = Some(thin(layer, *weight, &sizes, &mut rest));
        }
        parting.kept.iter().for_each(|other| layers[other.place] = Some(other.layer.clone()));
        let name = self.plan.after[0].0.name.clone();
        layers[0] = Some(Arc::new(Layer { name, lights: Vec::new(), light: rest.into() }));
        let layers: Vec<Arc<Layer>> = layers.into_iter().flatten().collect();
        let off = off_by(&layers, &self.weights_of(&layers));
        if off > 0.0 {
            add_square_of_rest(&mut light.variance, &layers[0].light, off);
        }
        LightMap { light, layers }
    }
}

/// A layer that is not told apart.
struct Other {
    /// In the plan.
    place: usize,
    layer: Arc<Layer>,
    /// Its lamps are off.
    is_dark: bool,
}

/// What the rest is, of light of all that is not told apart.
struct Parting {
    /// Layers that are not told apart, in the slots after the edit.
    kept: Vec<Other>,
    /// The rest before the edit.
    rest: LightValues,
    /// With the light of those layers.
    together: LightValues,
    /// Slots that get all their light anew, and what the layers that are kept have there.
    new_slots: Vec<(u32, LightValues)>,
}

impl Parting {
    fn new(transition: &Transition, rest: &Layer, together: &LightValues, others: Vec<Other>) -> Parting {
        let carried = |light: &LightValues| LightValues {
            direct: transition.carry(&light.direct),
            indirect: transition.carry(&light.indirect),
            variance: transition.carry(&light.variance),
        };
        let carry = |other: Other| Other { layer: transition.carried_layer(&other.layer), ..other };
        let kept: Vec<Other> = others.into_par_iter().map(carry).collect();
        let at = |&slot: &u32| {
            let mut sum = LightValues::black(1);
            for other in kept.iter().filter(|other| !other.is_dark) {
                let (direct, indirect) = other.layer.light.at(slot as usize);
                sum.direct[0] += direct;
                sum.indirect[0] += indirect;
            }
            (slot, sum)
        };
        let new_slots = transition.new_slots.par_iter().map(at).collect();
        Parting { rest: carried(&rest.light.to_dense()), together: carried(together), new_slots, kept }
    }

    /// Of `new`, the light after the edit of all that is not told apart.
    fn rest(&self, new: &LightValues) -> LightValues {
        let light = |rest: &[Vec3], old: &[Vec3], new: &[Vec3]| -> Vec<Vec3> {
            let each = rest.par_iter().zip(old).zip(new).with_min_len(CHUNK);
            each.map(|((rest, old), new)| *rest + (*new - *old)).collect()
        };
        let (rest, old) = (&self.rest, &self.together);
        let variance = rest.variance.iter().zip(&old.variance).zip(&new.variance);
        let mut found = LightValues {
            direct: light(&rest.direct, &old.direct, &new.direct),
            indirect: light(&rest.indirect, &old.indirect, &new.indirect),
            variance: variance.map(|((rest, old), new)| (rest + (new - old)).max(0.0)).collect(),
        };
        for (slot, kept) in &self.new_slots {
            let slot = *slot as usize;
            found.direct[slot] = new.direct[slot] - kept.direct[0];
            found.indirect[slot] = new.indirect[slot] - kept.indirect[0];
            found.variance[slot] = new.variance[slot];
        }
        found
    }
}

/// The sum of layers, which are at present strength or dark.
fn sum_of(rest: &Layer, others: &[Other]) -> LightValues {
    let mut sum = rest.light.to_dense();
    for other in others.iter().filter(|other| !other.is_dark) {
        for (index, block) in other.layer.light.blocks() {
            let own = index * BLOCK_SLOTS..index * BLOCK_SLOTS + block.direct.len();
            sum.direct[own.clone()].iter_mut().zip(block.direct).for_each(|(sum, light)| *sum += *light);
            sum.indirect[own.clone()].iter_mut().zip(block.indirect).for_each(|(sum, light)| *sum += *light);
            sum.variance[own].iter_mut().zip(block.variance).for_each(|(sum, variance)| *sum += *variance);
        }
    }
    sum
}

/// Area, per slot before the edit, of elements near what changed.
fn zone(transition: &Transition) -> Vec<f32> {
    let (before, after) = (&transition.before, &transition.after);
    let mut boxes = transition.changed_bounds();
    if boxes.len() > BOXES {
        let all = |(low, high): (Vec3, Vec3), (l, h): &(Vec3, Vec3)| (low.min(*l), high.max(*h));
        boxes = vec![boxes.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), all)];
    }
    let reach = ZONE * after.resolution.smooth;
    let areas: Vec<f32> = before.areas().iter().copied().collect();
    let is_near = |p: Vec3| boxes.iter().any(|(low, high)| (p.clamp(*low, *high) - p).length_squared() < reach * reach);
    let positions = before.positions();
    let area = |slot: usize| if is_near(positions[slot]) { areas[slot] } else { 0.0 };
    let mut zone: Vec<f32> = (0..before.slots()).into_par_iter().with_min_len(CHUNK).map(area).collect();
    let repaint = transition.repaint();
    for placed in &after.placed {
        if repaint[placed.placement.part_indices()].iter().any(|change| *change != Vec3::ZERO) {
            let own = placed.placement.element_indices().start..placed.placement.element_indices().end.min(zone.len());
            zone[own.clone()].copy_from_slice(&areas[own]);
        }
    }
    zone
}

/// Light of a layer, times area, over a zone.
fn light_in(layer: &Layer, zone: &[f32]) -> f32 {
    let of_block = |(index, block): (usize, crate::lightmap::LightBlock)| -> f32 {
        let areas = &zone[index * BLOCK_SLOTS..][..block.direct.len()];
        let light = areas.iter().zip(block.direct.iter().zip(block.indirect));
        light.map(|(area, (direct, indirect))| area * (*direct + *indirect).abs().element_sum()).sum()
    };
    layer.light.blocks().map(of_block).sum()
}
