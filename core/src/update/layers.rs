//! Updates of maps with layers: lights that leave a shared layer are computed by themselves, layers that the edit
//! changes are brought up to date together, along the same rays, and all are summed with their weights.

use std::cell::RefCell;
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::{Stage, Updated, run_stage};
use crate::bake::bake_layers;
use crate::importance::Importance;
use crate::job::{Budget, Canceled, Observer, Pass, Progress, Snapshot};
use crate::layers::{
    Apart, Computed, Layer, LayerHeader, Old, Piece, Pieces, Plan, add_square_of_rest, at_strength_of, correlation,
    is_new, less_sure, renamed, thinned, wants_layers, weights_of, weights_of_layers, weights_within, whole, whole_of,
    whole_with,
};
use crate::lightmap::{AnyLight, LightMap, SparseLight};
use crate::random::subseed;
use crate::rounds::Goal;
use crate::solve::Solvable;
use crate::transport::Work;
use crate::value::{SIDE_BY_SIDE, side_by_side};
use crate::world::{Transition, World};

/// Brings a map with layers up to date, or gives a map layers; none where the edit has no need of any.
pub(crate) fn update_layers(
    transition: &Transition,
    map: &LightMap,
    goal: &Goal,
    work: &Work,
) -> Option<Result<Option<Updated>, Canceled>> {
    let (before, after) = (&transition.before.scene, &transition.after.scene);
    if !wants_layers(before, after, map) {
        return None;
    }
    let plan = Plan::new(before, after, map);
    // What is carried where it matters only is compared with all light there: at present strength.
    let needs_all = transition.changes_surfaces() || plan.changed.len() > SIDE_BY_SIDE;
    if needs_all && map.rest().is_some() {
        let map = map.at_strength_of(after, before);
        let plan = Plan::new(before, after, &map);
        return Some(LayersUpdate::new(transition, &map, goal, work, plan, needs_all).run());
    }
    Some(LayersUpdate::new(transition, map, goal, work, plan, needs_all).run())
}

/// Samples per element, at most, of a stage before the last.
const QUIET_SAMPLES: u32 = 64;

/// A map of all that is known once lights have left their layers, and the light of those lights.
type Left = (Arc<LightMap>, Vec<Arc<Layer>>);

pub(super) struct LayersUpdate<'a> {
    pub(super) transition: &'a Transition,
    pub(super) map: &'a LightMap,
    pub(super) goal: &'a Goal<'a>,
    pub(super) work: &'a Work<'a>,
    pub(super) plan: Plan,
    /// What the layers after the edit weigh.
    pub(super) weights: Vec<Vec3>,
    /// Rays are needed for all layers.
    needs_all: bool,
}

impl<'a> LayersUpdate<'a> {
    fn new(
        transition: &'a Transition,
        map: &'a LightMap,
        goal: &'a Goal<'a>,
        work: &'a Work<'a>,
        plan: Plan,
        needs_all: bool,
    ) -> LayersUpdate<'a> {
        let headers: Vec<LayerHeader> = plan.after.iter().map(|(header, _)| header.clone()).collect();
        let weights = weights_of(&headers, &transition.after.scene);
        LayersUpdate { transition, map, goal, work, plan, weights, needs_all }
    }

    /// What the errors of the old layers have in common.
    fn correlation(&self) -> f64 {
        correlation(self.map, &self.map.layer_weights(&self.transition.before.scene))
    }

    fn run(&self) -> Result<Option<Updated>, Canceled> {
        let gets_rest = self.map.rest().is_none() && self.plan.after.len() > SIDE_BY_SIDE;
        if self.plan.leaving.len() > SIDE_BY_SIDE || gets_rest && self.needs_all {
            return self.bake_anew();
        }
        let changed = self.changed();
        let mut leaving = Vec::new();
        if !self.plan.leaving.is_empty() {
            let Some((map, layers)) = self.compute_leaving(changed.is_empty())? else { return Ok(None) };
            if changed.is_empty() {
                return Ok(Some(Updated { map, baked: false }));
            }
            leaving = layers;
        }
        let regrouped = self.pieces(&leaving).regroup();
        if changed.is_empty() {
            let (before, after) = (&self.transition.before.scene, &self.transition.after.scene);
            let layers = thinned(self.unchanged(&regrouped), |_| gets_rest, after);
            let map = Arc::new(self.without_gone(whole_of(layers, self.map, before, after), false));
            announce(&map, &self.transition.after, self.work.observer());
            return Ok(Some(Updated { map, baked: false }));
        }
        if self.needs_all && self.map.rest().is_some() {
            let near = self.near_lamps(&regrouped);
            return near.map_or_else(|| self.bake_anew(), |near| self.compute_near(&near, &regrouped));
        }
        self.compute_changed(&changed, &regrouped)
    }

    /// A bake of all layers: where most of them would be computed one after the other, it is less work.
    pub(super) fn bake_anew(&self) -> Result<Option<Updated>, Canceled> {
        let Transition { after, .. } = self.transition;
        let headers: Vec<LayerHeader> = self.plan.after.iter().map(|(header, _)| header.clone()).collect();
        let is_many = headers.len() > SIDE_BY_SIDE;
        let headers = if is_many { at_strength_of(&headers, &after.scene) } else { headers };
        let weights = weights_of(&headers, &after.scene);
        let finish = |computed: Computed| computed.into_map(&weights);
        let map = bake_layers(after, &headers, &finish, self.goal, self.work)?;
        Ok(map.map(|map| Updated { map, baked: true }))
    }

    fn pieces<'p>(&'p self, leaving: &'p [Arc<Layer>]) -> Pieces<'p> {
        Pieces { plan: &self.plan, map: self.map, leaving }
    }

    /// Positions in `plan.after` of the layers that rays are needed for.
    fn changed(&self) -> Vec<usize> {
        match self.needs_all {
            true => (0..self.plan.after.len()).collect(),
            false => self.plan.changed.clone(),
        }
    }

    /// The old light, at reference strength, of the lights of `plan.leaving`. The map is published where nothing is
    /// left to do behind it.
    fn compute_leaving(&self, publishes: bool) -> Result<Option<Left>, Canceled> {
        let (last, correlation) = (RefCell::new(Vec::new()), self.correlation());
        let finish = |computed: Computed| {
            let pieces = self.pieces(&computed.layers);
            let is_new = |k: usize| self.map.rest().is_none() || !self.is_as_before(k);
            let layers = thinned(self.unchanged(&pieces.regroup()), is_new, &self.transition.after.scene);
            let variance = pieces.variance(&self.weights, correlation);
            last.replace(computed.layers);
            let weights = self.weights_of(&layers);
            self.without_gone(whole_with(layers, &weights, variance), false)
        };
        let quiet = Quiet(self.work.observer());
        let quiet = Work::new(&quiet);
        let work = if publishes { self.work } else { &quiet };
        // Behind it there is more to do, and nobody sees it: it must not take all the time there is.
        let most = if publishes { u32::MAX } else { QUIET_SAMPLES };
        let budget = self.goal.budget;
        let budget = Budget { samples_per_element: budget.samples_per_element.min(most), ..*budget };
        let importance = if publishes { *self.goal.importance } else { Importance::default() };
        let goal = Goal {
            budget: &budget,
            importance: &importance,
            seed: subseed(self.goal.seed, 0x1ea),
            estimates: false,
            guesses: true,
            offers: false,
        };
        let map = bake_layers(&self.transition.before, &self.plan.leaving, &finish, &goal, work)?;
        Ok(map.map(|map| (map, last.take())))
    }

    /// What layers weigh after the edit: those that were thinned are at present strength.
    pub(super) fn weights_of(&self, layers: &[Arc<Layer>]) -> Vec<Vec3> {
        weights_of_layers(layers, &self.transition.after.scene)
    }

    /// A map after the edit. Of layers that go with it (or `more`) something is left in the rest: that is stated.
    pub(super) fn without_gone(&self, mut map: LightMap, more: bool) -> LightMap {
        let stays = |index: usize| self.plan.after.iter().any(|(_, origin)| *origin == Some(index));
        let goes = more || (0..self.plan.regrouped.len()).any(|index| !stays(index));
        if let Some(rest) = map.rest().filter(|_| goes && self.map.rest().is_some()).cloned() {
            add_square_of_rest(&mut map.light.variance, &rest.light, 1.0);
            map.layers[0] = less_sure(&rest, 1.0);
        }
        map
    }

    /// Whether a layer of the new map is one of the old.
    fn is_as_before(&self, place: usize) -> bool {
        let pieces = self.plan.after[place].1.map(|index| &*self.plan.regrouped[index].pieces);
        matches!(pieces, Some([(Piece::Old(_), Vec3::ONE)]))
    }

    /// Layers of the new map that need no ray, with their new headers.
    fn unchanged(&self, regrouped: &[Arc<Layer>]) -> Vec<Arc<Layer>> {
        let layer = |(header, origin): &(LayerHeader, Option<usize>)| Some(renamed(&regrouped[(*origin)?], header));
        self.plan.after.iter().filter_map(layer).collect()
    }

    /// Brings layers up to date along the same rays.
    fn compute_changed(&self, changed: &[usize], regrouped: &[Arc<Layer>]) -> Result<Option<Updated>, Canceled> {
        // In slots of the new world; without a change of geometry those are the old ones.
        let keep = |(k, (header, origin)): (usize, &(LayerHeader, Option<usize>))| {
            origin.filter(|_| !changed.contains(&k)).map(|index| renamed(&regrouped[index], header))
        };
        let kept: Vec<Option<Arc<Layer>>> = self.plan.after.iter().enumerate().map(keep).collect();
        let correlation = self.correlation();
        let finish = |computed: Computed| {
            let mut new = computed.layers.into_iter();
            let layers: Vec<Arc<Layer>> = kept.iter().filter_map(|k| k.clone().or_else(|| new.next())).collect();
            let is_new = |k: usize| self.map.rest().is_none() || changed.contains(&k);
            let layers = thinned(layers, is_new, &self.transition.after.scene);
            let weights = self.weights_of(&layers);
            let map = match computed.variance.filter(|_| changed.len() == self.plan.after.len()) {
                Some(variance) => whole_with(layers, &weights, variance),
                None => whole(layers, &weights, correlation),
            };
            self.without_gone(map, false)
        };
        let headers: Vec<LayerHeader> = changed.iter().map(|&k| self.plan.after[k].0.clone()).collect();
        let Transition { before, after, .. } = self.transition;
        let are_new = headers.iter().all(|header| is_new(header, &before.scene, &after.scene));
        // What the rest has of a lamp at its old place is taken out of it by way of the change.
        let is_in_rest = |k: &usize| self.map.rest().is_some() && self.plan.after[*k].1.is_some();
        if !self.transition.changes_surfaces() && are_new && !changed.iter().any(is_in_rest) {
            let map = bake_layers(after, &headers, &finish, self.goal, self.work)?;
            return Ok(map.map(|map| Updated { map, baked: false }));
        }
        let origins: Vec<Option<usize>> = changed.iter().map(|&k| self.plan.after[k].1).collect();
        let old_headers: Vec<LayerHeader> = origins
            .iter()
            .map(|origin| origin.map(|index| self.plan.regrouped[index].header.clone()).unwrap_or_default())
            .collect();
        let own: Vec<Vec3> = changed.iter().map(|&k| self.weights[k]).collect();
        let stage = Transition {
            before: before.only_layers(&old_headers, &own),
            after: after.only_layers(&headers, &own),
            ..self.transition.clone()
        };
        let black = || Arc::new(Layer { light: SparseLight::black(before.slots()), ..Layer::default() });
        let old = origins.into_iter().map(|origin| origin.map_or_else(black, |index| regrouped[index].clone()));
        let guides = stage.after.guides(&own);
        let change = Change { transition: &stage, headers, weights: own, guides, old: old.collect() };
        side_by_side!(changed.len(), run_change(&change, self.transition, self.map, self.goal, self.work, &finish))
    }
}

/// Layers that an edit changes.
pub(super) struct Change<'a> {
    /// With the lights of these layers only.
    pub(super) transition: &'a Transition,
    pub(super) headers: Vec<LayerHeader>,
    pub(super) weights: Vec<Vec3>,
    pub(super) guides: Vec<Vec3>,
    /// Before the edit, in its slots.
    pub(super) old: Vec<Arc<Layer>>,
}

impl Change<'_> {
    /// All light of a slot before the edit, these layers as they matter. A single layer has its own scale, and so has this.
    fn around(&self, map: &LightMap, slot: usize) -> Vec3 {
        let own = |layer: &Layer| {
            let (direct, indirect) = layer.light.at(slot);
            direct + indirect
        };
        let factors = self.guides.iter().zip(&self.weights).map(|(guide, weight)| *guide - *weight);
        let more = self.old.iter().zip(factors).filter(|(_, factor)| *factor != Vec3::ZERO);
        let more = more.map(|(layer, factor)| own(layer) * factor);
        let around = map.total(slot) + more.sum::<Vec3>();
        match (&*self.old, &*self.guides) {
            ([layer], [scale]) => Vec3::select(scale.cmpgt(Vec3::ZERO), around / *scale, own(layer)),
            _ => around,
        }
    }
}

/// `map` is the whole map before the edit.
pub(super) fn run_change<V: Solvable>(
    change: &Change,
    transition: &Transition,
    map: &LightMap,
    goal: &Goal,
    work: &Work,
    finish: &dyn Fn(Computed) -> LightMap,
) -> Result<Option<Updated>, Canceled> {
    let around: Vec<Vec3> = (0..map.len()).into_par_iter().map(|slot| change.around(map, slot)).collect();
    let around = transition.carry(&around);
    let parts = change.old.iter().map(|layer| AnyLight::Sparse(&layer.light)).collect();
    let stage = Stage {
        transition: change.transition,
        old: Old::new(parts, &map.light.variance, change.transition),
        weights: weights_within(&change.weights),
        guides: weights_within(&change.guides),
        around: Some(&around),
        finish: &|layers: Apart| finish(layers.named(&change.headers)),
    };
    run_stage::<V>(&stage, goal, work)
}

/// One snapshot of a map that no ray was needed for.
fn announce(map: &Arc<LightMap>, world: &World, observer: &dyn Observer) {
    let stated = Some(map.estimated_rmse(world.areas()));
    let progress = Progress::at_once(Pass::Direct, 1, stated);
    observer.progress(&progress);
    observer.snapshot(map, Snapshot::Complete { stated }, &progress);
}

/// Lets nothing out: a stage's map is not yet that of the edit.
struct Quiet<'a>(&'a dyn Observer);

impl Observer for Quiet<'_> {
    fn canceled(&self) -> bool {
        self.0.canceled()
    }

    fn advanced(&self, part: f32) {
        self.0.advanced(part);
    }

    fn plan_round(&self, so_far: &Progress, proposed: u32) -> u32 {
        self.0.plan_round(so_far, proposed)
    }
}
