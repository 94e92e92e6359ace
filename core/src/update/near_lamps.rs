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
use crate::layers::{Computed, Layer, LayerHeader, add_square_of_rest, at_present, off_by, renamed, thin};
use crate::lightmap::{AnyLight, BLOCK_SLOTS, LightMap, LightValues, SIDE_BY_SIDE};
use crate::value::side_by_side;
use crate::world::Transition;

/// Of the light near an edit, so much is that of lamps which are told apart, where there are not too many.
const NEAR_SHARE: f32 = 0.95;

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
        let keys: BTreeSet<u32> = self.transition.changed_keys().into_iter().collect();
        let Transition { before, after, .. } = self.transition;
        let emitters = before.emitters.all().chain(after.emitters.all());
        let moved: BTreeSet<&str> =
            emitters.filter(|e| e.object.is_some_and(|key| keys.contains(&key))).map(|e| e.name.as_str()).collect();
        let is_moved = |(header, origin): &(LayerHeader, Option<usize>)| {
            origin.is_none() || header.lights.iter().any(|light| moved.contains(light.name.as_str()))
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
        let (dark, lit): (Vec<_>, Vec<_>) = by_light.into_iter().partition(|&(_, k)| self.is_dark(k));
        let dark: Vec<usize> = dark.into_iter().map(|(_, k)| k).collect();
        near.extend(brightest(&lit, SIDE_BY_SIDE - 1 - near.len()));
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
            let weight = self.weights[k];
            (!near.contains(&k) && !lost.contains(&k)).then_some(Other { place: k, layer, weight })
        };
        let others: Vec<Other> = (1..self.plan.after.len()).filter_map(other).collect();
        let rest = origin(0).map(|index| regrouped[index].clone()).unwrap_or_default();
        let together = sum_of(&rest, &others);
        let at_present = |other: &Other| {
            let mut lights = other.layer.lights.clone();
            lights.iter_mut().for_each(|light| light.reference *= other.weight);
            lights
        };
        let lights = others.iter().filter(|other| other.weight != Vec3::ZERO).flat_map(at_present);
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
        let parting = Parting::new(self.transition, &rest, &together, others, !lost.is_empty());
        let finish = |computed: Computed| self.assembled(near, &parting, computed, &own);
        let guides = stage.after.guides(&own);
        let change = Change { transition: &stage, headers, weights: own.clone(), guides, old };
        let updated = side_by_side!(
            change.weights.len(),
            run_change(&change, self.transition, self.map, self.goal, self.work, &finish)
        )?;
        // Where all was lit anew, layers that were not told apart are those of another scene.
        match updated {
            Some(updated) if updated.baked => Ok(Some(self.bake_anew()?.unwrap_or(updated))),
            updated => Ok(updated),
        }
    }

    /// The map of what was computed.
    fn assembled(&self, near: &[usize], parting: &Parting, computed: Computed, weights: &[Vec3]) -> LightMap {
        let slots = self.transition.after.slots();
        let mut light = LightValues::black(slots);
        // Of others alone, it is theirs.
        light.variance = computed.variance.unwrap_or_else(|| computed.layers[0].light.variance().into_owned());
        for (layer, weight) in computed.layers.iter().zip(weights) {
            light.add_light(AnyLight::Sparse(&layer.light), *weight);
        }
        let size = |slot: usize| light.direct[slot].abs().max_element() + light.indirect[slot].abs().max_element();
        let sizes: Vec<f32> = (0..slots).into_par_iter().with_min_len(CHUNK).map(size).collect();
        let mut rest = parting.rest(&computed.layers[0].light.to_dense());
        let mut layers: Vec<Option<Arc<Layer>>> = vec![None; self.plan.after.len()];
        let scene = &self.transition.after.scene;
        for (&k, layer) in near.iter().zip(&computed.layers[1..]) {
            layers[k] = Some(thin(&at_present(layer, scene), scene, &sizes, &mut rest));
        }
        parting.kept.iter().for_each(|other| layers[other.place] = Some(other.layer.clone()));
        let name = self.plan.after[0].0.name.clone();
        layers[0] = Some(Arc::new(Layer { name, lights: Vec::new(), light: rest.into() }));
        let layers: Vec<Arc<Layer>> = layers.into_iter().flatten().collect();
        let off = off_by(&layers, &self.weights_of(&layers));
        if off > 0.0 {
            add_square_of_rest(&mut light.variance, &layers[0].light, off);
        }
        self.without_gone(LightMap { light, layers }, parting.loses_layers)
    }
}

/// The first of some layers, the brightest first, that have most of their light, and no more than so many.
fn brightest(layers: &[(f32, usize)], most: usize) -> impl Iterator<Item = usize> {
    let wanted = NEAR_SHARE * layers.iter().map(|(light, _)| light).sum::<f32>();
    let before = layers.iter().scan(0.0, |sum, (light, k)| Some((std::mem::replace(sum, *sum + light), *k)));
    before.take(most).take_while(move |(before, _)| *before < wanted).map(|(_, k)| k)
}

/// A layer that is not told apart.
struct Other {
    /// In the plan.
    place: usize,
    layer: Arc<Layer>,
    weight: Vec3,
}

/// What the rest is, of light of all that is not told apart.
struct Parting {
    /// Layers that are not told apart, in the slots after the edit. What came or moved is in none of them.
    kept: Vec<Other>,
    /// The rest before the edit; black where all light is new.
    rest: LightValues,
    /// With the light of those layers.
    together: LightValues,
    /// Of some layers nothing is kept.
    loses_layers: bool,
}

impl Parting {
    fn new(
        transition: &Transition,
        rest: &Layer,
        together: &LightValues,
        others: Vec<Other>,
        loses_layers: bool,
    ) -> Parting {
        let mut is_new = vec![false; transition.after.slots()];
        transition.new_slots.iter().for_each(|&slot| is_new[slot as usize] = true);
        let carried = |light: &LightValues| {
            let carried = LightValues {
                direct: transition.carry(&light.direct),
                indirect: transition.carry(&light.indirect),
                variance: transition.carry(&light.variance),
            };
            let mut carried = carried.without(&is_new);
            transition.new_slots.iter().for_each(|&slot| carried.variance[slot as usize] = 0.0);
            carried
        };
        let carry = |other: Other| Other { layer: transition.carried_without(&other.layer, &is_new), ..other };
        let kept = others.into_par_iter().map(carry).collect();
        Parting { rest: carried(&rest.light.to_dense()), together: carried(together), kept, loses_layers }
    }

    /// Of `new`, the light after the edit of all that is not told apart.
    fn rest(&self, new: &LightValues) -> LightValues {
        let light = |rest: &[Vec3], old: &[Vec3], new: &[Vec3]| -> Vec<Vec3> {
            let each = rest.par_iter().zip(old).zip(new).with_min_len(CHUNK);
            each.map(|((rest, old), new)| *rest + (*new - *old)).collect()
        };
        let (rest, old) = (&self.rest, &self.together);
        let variance = rest.variance.iter().zip(&old.variance).zip(&new.variance);
        LightValues {
            direct: light(&rest.direct, &old.direct, &new.direct),
            indirect: light(&rest.indirect, &old.indirect, &new.indirect),
            variance: variance.map(|((rest, old), new)| (rest + (new - old)).max(0.0)).collect(),
        }
    }
}

/// The sum of layers, each with its weight.
fn sum_of(rest: &Layer, others: &[Other]) -> LightValues {
    let mut sum = rest.light.to_dense();
    for Other { layer, weight, .. } in others.iter().filter(|other| other.weight != Vec3::ZERO) {
        sum.add_scaled(AnyLight::Sparse(&layer.light), *weight);
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
            let own = placed.placement.element_indices();
            let own = own.start.min(zone.len())..own.end.min(zone.len());
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
