//! Updates of maps with layers: lights that leave a shared layer are computed by themselves, layers that the edit
//! changes are brought up to date together, along the same rays, and all are summed with their weights.

use std::cell::RefCell;
use std::sync::Arc;

use glam::Vec3;

use super::plan::{Header, Piece, Plan, Planned, wants_layers};
use super::{Layer, Stack, correlation, weight_of, whole};
use crate::job::{Budget, Canceled, Observer, Pass, Progress};
use crate::lightmap::LightMap;
use crate::random::subseed;
use crate::scene::Scene;
use crate::transport::{Value, Work};
use crate::update::{Goal, Stage, Updated, run_stage};
use crate::world::{Transition, World};

/// Calls a function generic over the number of layers for the least number that holds `$layers`.
macro_rules! with_layers {
    ($layers:expr, $function:ident($($argument:expr),* $(,)?)) => {
        match $layers {
            0 | 1 => $function::<glam::Vec3>($($argument),*),
            2 => $function::<$crate::transport::Layered<2>>($($argument),*),
            3 | 4 => $function::<$crate::transport::Layered<4>>($($argument),*),
            5..=8 => $function::<$crate::transport::Layered<8>>($($argument),*),
            _ => $function::<$crate::transport::Layered<16>>($($argument),*),
        }
    };
}
pub(crate) use with_layers;

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
    let update = Update { transition, map, goal, work, plan };
    Some(update.run())
}

/// Positions of the layers of a map whose lights all move, where an edit does nothing else, with their headers after it.
pub(crate) fn moved_layers(transition: &Transition, map: &LightMap) -> Option<Vec<(usize, Header)>> {
    let observer = crate::job::Unobserved;
    let budget = crate::job::Budget { samples_per_element: 0, target_rmse: None };
    let (before, after) = (&transition.before.scene, &transition.after.scene);
    if map.layers.is_empty() {
        return None;
    }
    let update = Update {
        transition,
        map,
        goal: &Goal { budget: &budget, focus: None, seed: 0 },
        work: &Work::new(&observer),
        plan: Plan::new(before, after, map),
    };
    let plan = &update.plan;
    let same_layers = plan.leaving.is_empty()
        && plan.after.len() == map.layers.len()
        && plan.after.iter().enumerate().all(|(k, (header, origin))| {
            *origin == Some(k) && header.name == map.layers[k].name && header.lights == map.layers[k].lights
        });
    let only_moves = same_layers && !update.changes_surfaces() && plan.changed.iter().all(|&k| update.is_all_new(k));
    let header = |&k: &usize| (k, plan.after[k].0.clone());
    (only_moves && !plan.changed.is_empty()).then(|| plan.changed.iter().map(header).collect())
}

/// Samples per element, at most, of a stage before the last.
const QUIET_SAMPLES: u32 = 64;

struct Update<'a> {
    transition: &'a Transition,
    map: &'a LightMap,
    goal: &'a Goal<'a>,
    work: &'a Work<'a>,
    plan: Plan,
}

impl Update<'_> {
    fn run(&self) -> Result<Option<Updated>, Canceled> {
        let (before, after) = (&self.transition.before.scene, &self.transition.after.scene);
        let old_weights = self.map.layer_weights(before);
        let correlation = correlation(self.map, &old_weights);
        let changed = self.changed();
        let weights: Vec<Vec3> =
            self.plan.after.iter().map(|(h, _)| weight_of(&h.lights, after).unwrap_or(Vec3::ONE)).collect();
        if !self.plan.leaving.is_empty() {
            let finish = |leaving: Vec<Arc<Layer>>| {
                let regrouped = self.regroup(&leaving);
                let mut map = whole(self.unchanged(&regrouped), &weights, correlation);
                map.variance = self.variance_of_pieces(&leaving, &weights, correlation);
                map
            };
            let Some(Leaving { updated, layers: leaving }) = self.compute_leaving(changed.is_empty(), &finish)? else {
                return Ok(None);
            };
            if changed.is_empty() {
                return Ok(Some(updated));
            }
            return self.compute_changed(&changed, &self.regroup(&leaving), &weights, correlation);
        }
        let regrouped = self.regroup(&[]);
        if changed.is_empty() {
            let map = Arc::new(whole(self.unchanged(&regrouped), &weights, correlation));
            announce(&map, &self.transition.after, self.work.observer());
            return Ok(Some(Updated { map, baked: false }));
        }
        self.compute_changed(&changed, &regrouped, &weights, correlation)
    }

    /// Variance of the new map: light that leaves one layer for another is in both, with opposite signs, so that only
    /// what it weighs in all counts.
    fn variance_of_pieces(&self, leaving: &[Arc<Layer>], weights: &[Vec3], correlation: f64) -> Vec<f32> {
        let mut old = vec![Vec3::ZERO; self.map.layers.len().max(1)];
        let mut new = vec![Vec3::ZERO; leaving.len()];
        for ((_, origin), weight) in self.plan.after.iter().zip(weights) {
            let pieces = origin.map_or(&[][..], |index| &self.plan.regrouped[index].pieces);
            for (piece, factor) in pieces {
                match piece {
                    Piece::Old(k) => old[*k] += *factor * *weight,
                    Piece::Leaving(k) => new[*k] += *factor * *weight,
                }
            }
        }
        let square = |v: &Vec3| v.length_squared() / 3.0;
        let mut variance = match self.map.layers.is_empty() {
            true => self.map.variance.iter().map(|v| v * square(&old[0])).collect(),
            false => whole(self.map.layers.clone(), &old, correlation).variance,
        };
        for (layer, factor) in leaving.iter().zip(new.iter().map(square)) {
            variance.iter_mut().zip(&layer.variance).for_each(|(sum, v)| *sum += v * factor);
        }
        variance
    }

    /// Positions in `plan.after` of the layers that rays are needed for.
    fn changed(&self) -> Vec<usize> {
        if self.changes_surfaces() { (0..self.plan.after.len()).collect() } else { self.plan.changed.clone() }
    }

    fn changes_surfaces(&self) -> bool {
        let transition = self.transition;
        transition.moves_geometry() || !transition.new_rows.is_empty() || transition.repaints_anything()
    }

    /// Whether all lights of a layer are new, or were moved.
    fn is_all_new(&self, place: usize) -> bool {
        let find = |scene: &Scene, name: &str| scene.lights.iter().find(|l| l.name == name).map(|l| l.kind.clone());
        let (before, after) = (&self.transition.before.scene, &self.transition.after.scene);
        let (header, _) = &self.plan.after[place];
        header.lights.iter().all(|light| find(before, &light.name) != find(after, &light.name))
    }

    /// The old light, at reference strength, of the lights of `plan.leaving`.
    fn compute_leaving(
        &self,
        publishes: bool,
        finish: &dyn Fn(Vec<Arc<Layer>>) -> LightMap,
    ) -> Result<Option<Leaving>, Canceled> {
        let world = &self.transition.before;
        let headers: Vec<&Header> = self.plan.leaving.iter().collect();
        let weights: Vec<Vec3> =
            headers.iter().map(|h| weight_of(&h.lights, &world.scene).unwrap_or(Vec3::ONE)).collect();
        let still = Transition {
            before: world.only_layers(&[], &[]),
            after: world.only_layers(&headers, &weights),
            common: world.trees.clone(),
            gone: None,
            come: None,
            new_rows: Vec::new(),
            filled_rows: Vec::new(),
        };
        let quiet = Quiet(self.work.observer());
        let quiet = Work::new(&quiet);
        let work = if publishes { self.work } else { &quiet };
        // Behind it there is more to do, and nobody sees it: it must not take all the time there is.
        let most = if publishes { u32::MAX } else { QUIET_SAMPLES };
        let budget = &self.goal.budget;
        let budget = &Budget { samples_per_element: budget.samples_per_element.min(most), ..**budget };
        let goal = Goal { budget, focus: None, seed: subseed(self.goal.seed, 0x1ea) };
        let layers = Layers { headers, weights, around: Vec::new(), from_scratch: true };
        with_layers!(layers.headers.len(), leaving(&still, &layers, &goal, work, finish))
    }

    /// The old light in its new layers.
    fn regroup(&self, leaving: &[Arc<Layer>]) -> Vec<Arc<Layer>> {
        self.plan.regrouped.iter().map(|planned| self.assemble(planned, leaving)).collect()
    }

    fn assemble(&self, planned: &Planned, leaving: &[Arc<Layer>]) -> Arc<Layer> {
        if let ([(Piece::Old(index), Vec3::ONE)], Some(layer)) = (planned.pieces.as_slice(), self.map.layers.first()) {
            let layer = self.map.layers.get(*index).unwrap_or(layer);
            if layer.name == planned.header.name && layer.lights == planned.header.lights {
                return layer.clone();
            }
        }
        let len = self.map.len();
        let mut sum = Layer {
            name: planned.header.name.clone(),
            lights: planned.header.lights.clone(),
            direct: vec![Vec3::ZERO; len],
            indirect: vec![Vec3::ZERO; len],
            variance: vec![0.0; len],
        };
        let mut add = |direct: &[Vec3], indirect: &[Vec3], variance: &[f32], factor: Vec3| {
            let square = factor.length_squared() / 3.0;
            sum.direct.iter_mut().zip(direct).for_each(|(s, v)| *s += *v * factor);
            sum.indirect.iter_mut().zip(indirect).for_each(|(s, v)| *s += *v * factor);
            sum.variance.iter_mut().zip(variance).for_each(|(s, v)| *s += *v * square);
        };
        for &(piece, factor) in &planned.pieces {
            let layer = match piece {
                Piece::Old(index) => self.map.layers.get(index),
                Piece::Leaving(index) => leaving.get(index),
            };
            match layer {
                Some(layer) => add(&layer.direct, &layer.indirect, &layer.variance, factor),
                // A map without layers is one of all lights.
                None => add(&self.map.direct, &self.map.indirect, &self.map.variance, factor),
            }
        }
        Arc::new(sum)
    }

    /// Layers of the new map that need no ray, with their new headers.
    fn unchanged(&self, regrouped: &[Arc<Layer>]) -> Vec<Arc<Layer>> {
        let layer = |(header, origin): &(Header, Option<usize>)| {
            let layer = origin.map(|index| &regrouped[index])?;
            Some(renamed(layer, header))
        };
        self.plan.after.iter().filter_map(layer).collect()
    }

    /// Brings layers up to date along the same rays.
    fn compute_changed(
        &self,
        changed: &[usize],
        regrouped: &[Arc<Layer>],
        weights: &[Vec3],
        correlation: f64,
    ) -> Result<Option<Updated>, Canceled> {
        let transition = self.transition;
        let len = transition.before.slots();
        let black = || {
            Arc::new(Layer {
                direct: vec![Vec3::ZERO; len],
                indirect: vec![Vec3::ZERO; len],
                variance: vec![0.0; len],
                ..Layer::default()
            })
        };
        let nothing = Header::default();
        let (mut headers, mut old_headers, mut old) = (Vec::new(), Vec::new(), Vec::new());
        for &k in changed {
            let (header, origin) = &self.plan.after[k];
            headers.push(header);
            old_headers.push(origin.map_or(&nothing, |index| &self.plan.regrouped[index].header));
            old.push(origin.map_or_else(black, |index| regrouped[index].clone()));
        }
        let from_scratch = !self.changes_surfaces() && changed.iter().all(|&k| self.is_all_new(k));
        let all = changed.len() == self.plan.after.len();
        let own: Vec<Vec3> = changed.iter().map(|&k| weights[k]).collect();
        let stage = Transition {
            before: transition.before.only_layers(&old_headers, &own),
            after: transition.after.only_layers(&headers, &own),
            ..transition.clone()
        };
        // In slots of the new world; without a change of geometry those are the old ones.
        let kept: Vec<Option<Arc<Layer>>> = self
            .plan
            .after
            .iter()
            .enumerate()
            .map(|(k, (header, origin))| {
                origin.filter(|_| !changed.contains(&k)).map(|index| renamed(&regrouped[index], header))
            })
            .collect();
        let finish = |computed: Vec<Arc<Layer>>, variance: Option<Vec<f32>>| {
            let mut computed = computed.into_iter();
            let layers: Vec<Arc<Layer>> = kept.iter().filter_map(|k| k.clone().or_else(|| computed.next())).collect();
            let mut map = whole(layers, weights, correlation);
            if let Some(variance) = variance.filter(|_| all) {
                map.variance = variance;
            }
            map
        };
        let around = transition.carry_over(self.map);
        let around: Vec<Vec3> = (0..around.len()).map(|slot| around.total(slot)).collect();
        let layers = Layers { headers, weights: own, around, from_scratch };
        with_layers!(changed.len(), change(&stage, &old, &self.map.variance, &layers, self.goal, self.work, &finish))
    }
}

/// Light of lights that leave their layer.
struct Leaving {
    updated: Updated,
    layers: Vec<Arc<Layer>>,
}

/// The layers that a stage computes.
struct Layers<'a> {
    headers: Vec<&'a Header>,
    weights: Vec<Vec3>,
    /// All light of the old map, direct + indirect, in the slots of the stage's new world.
    around: Vec<Vec3>,
    /// No light of theirs stays as it was.
    from_scratch: bool,
}

/// `finish` takes the layers so far; answers the last map and the layers, none where no round was run.
fn leaving<V: Value>(
    still: &Transition,
    layers: &Layers,
    goal: &Goal,
    work: &Work,
    finish: &dyn Fn(Vec<Arc<Layer>>) -> LightMap,
) -> Result<Option<Leaving>, Canceled> {
    let last = RefCell::new(Vec::new());
    let keep = |stack: &Stack<V>| {
        let computed = stack.to_layers(&layers.headers);
        last.replace(computed.clone());
        finish(computed)
    };
    let weights = own_weights(&layers.weights);
    let stage = Stage {
        transition: still,
        old: Stack::<V>::black(still.before.slots(), layers.headers.len()),
        weights: &weights,
        around: None,
        from_scratch: true,
        finish: &keep,
    };
    let updated = run_stage(stage, goal, work)?;
    Ok(updated.map(|updated| Leaving { updated, layers: last.take() }))
}

/// `finish` takes the layers so far, and the variance of their weighted sum where there are several.
fn change<V: Value>(
    transition: &Transition,
    old: &[Arc<Layer>],
    variance: &[f32],
    layers: &Layers,
    goal: &Goal,
    work: &Work,
    finish: &dyn Fn(Vec<Arc<Layer>>, Option<Vec<f32>>) -> LightMap,
) -> Result<Option<Updated>, Canceled> {
    let several = layers.headers.len() > 1;
    let keep = |stack: &Stack<V>| finish(stack.to_layers(&layers.headers), several.then(|| stack.variance.clone()));
    let weights = own_weights(&layers.weights);
    let old = Stack::<V>::of_layers(old, variance, transition.before.slots());
    let stage = Stage {
        transition,
        old,
        weights: &weights,
        around: Some(&layers.around),
        from_scratch: layers.from_scratch,
        finish: &keep,
    };
    run_stage(stage, goal, work)
}

/// A single layer is computed at its own scale: its variance is that of the layer.
fn own_weights(weights: &[Vec3]) -> Vec<Vec3> {
    if weights.len() > 1 { weights.to_vec() } else { vec![Vec3::ONE] }
}

fn renamed(layer: &Arc<Layer>, header: &Header) -> Arc<Layer> {
    if layer.name == header.name && layer.lights == header.lights {
        return layer.clone();
    }
    Arc::new(Layer { name: header.name.clone(), lights: header.lights.clone(), ..Layer::clone(layer) })
}

/// One snapshot of a map that no ray was needed for.
fn announce(map: &Arc<LightMap>, world: &World, observer: &dyn Observer) {
    let progress = Progress::at_once(Pass::Direct, 1, Some(map.estimated_rmse(world.areas())));
    observer.progress(&progress);
    observer.snapshot(map, &progress);
}

/// Lets nothing out: a stage's map is not yet that of the edit.
struct Quiet<'a>(&'a dyn Observer);

impl Observer for Quiet<'_> {
    fn canceled(&self) -> bool {
        self.0.canceled()
    }

    fn plan_round(&self, so_far: &Progress, proposed: u32) -> u32 {
        self.0.plan_round(so_far, proposed)
    }
}
