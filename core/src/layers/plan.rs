//! Which layers a map has after an edit, and what they are made of. Decisions only: nothing is computed here.

use std::collections::{BTreeMap, BTreeSet};

use glam::Vec3;

use super::rest::{free_name, with_rest};
use super::{
    LayerHeader, LayerLight, MAX_GROUPS, MAX_LAYERS, REST_LAYER, SHARED_LAYER, SIDE_BY_SIDE, Strengths, strength_of,
    strengths_of, weight_at, weight_of, weight_of_changes,
};
use crate::lightmap::LightMap;
use crate::scene::Scene;
use crate::world::Transition;

/// Whether none of a layer's lights was there, at that place, before.
pub(crate) fn is_new(header: &LayerHeader, before: &Scene, after: &Scene) -> bool {
    header.lights.iter().all(|light| kind_of(before, &light.name) != kind_of(after, &light.name))
}

/// What a layer is put together from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Piece {
    /// A layer of the old map, by position.
    Old(usize),
    /// Light of lights that leave their layer, by position in [`Plan::leaving`].
    Leaving(usize),
}

/// A layer and its pieces, each with its factor.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Planned {
    pub header: LayerHeader,
    pub pieces: Vec<(Piece, Vec3)>,
}

/// From the layers of a map to those after an edit.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Plan {
    /// Lights whose own light has to be computed in the old scene, because they leave a layer that others stay in.
    pub leaving: Vec<LayerHeader>,
    /// The old light in its new layers. Those whose lights are all gone come without a place in the new map.
    pub regrouped: Vec<Planned>,
    /// Layers of the new map, with the position in `regrouped` of those that are not new.
    pub after: Vec<(LayerHeader, Option<usize>)>,
    /// Positions in `after` whose lights come, go, move or change unlike one another.
    pub changed: Vec<usize>,
}

/// Headers of the layers of a map; one of all lights, at their present strength, where it has none.
pub(super) fn headers_of(map: &LightMap, scene: &Scene) -> Vec<LayerHeader> {
    if map.layers.is_empty() {
        return vec![LayerHeader { name: SHARED_LAYER.to_owned(), lights: at_present(scene, |_| true) }];
    }
    headers_of_layers(map)
}

/// Headers of the layers that a map has.
pub(crate) fn headers_of_layers(map: &LightMap) -> Vec<LayerHeader> {
    map.layers.iter().map(|layer| LayerHeader { name: layer.name.clone(), lights: layer.lights.clone() }).collect()
}

/// Layers of a scene that is baked: one per group, one of the lights in none; empty where there is no group. Of more
/// than [`MAX_GROUPS`], which no edit makes, the first by name count.
pub(crate) fn groups_of(scene: &Scene) -> Vec<LayerHeader> {
    if scene.groups.is_empty() {
        return Vec::new();
    }
    let named: BTreeSet<&String> = scene.groups.values().collect();
    let named: BTreeSet<&String> = named.into_iter().take(MAX_GROUPS).collect();
    let mut groups: BTreeMap<&str, LayerHeader> = BTreeMap::new();
    for light in &scene.lights {
        let group = scene.groups.get(&light.name).filter(|name| named.contains(name));
        let name = group.map_or(SHARED_LAYER, String::as_str);
        let header = groups.entry(name).or_insert_with(|| LayerHeader { name: name.to_owned(), lights: Vec::new() });
        header.lights.push(LayerLight { name: light.name.clone(), reference: light.strength() });
    }
    let mut headers: Vec<LayerHeader> = groups.into_values().collect();
    if headers.len() > SIDE_BY_SIDE {
        return with_rest(headers);
    }
    headers.iter_mut().for_each(at_unit);
    headers
}

fn at_present(scene: &Scene, wanted: impl Fn(&str) -> bool) -> Vec<LayerLight> {
    let lights = scene.lights.iter().filter(|light| wanted(&light.name));
    lights.map(|light| LayerLight { name: light.name.clone(), reference: light.strength() }).collect()
}

/// A light alone in its layer is held at unit emission.
fn at_unit(header: &mut LayerHeader) {
    if let [light] = header.lights.as_mut_slice() {
        light.reference = Vec3::ONE;
    }
}

/// Whether an edit asks for layers, or the map has some.
pub(crate) fn wants_layers(before: &Scene, after: &Scene, map: &LightMap) -> bool {
    let relit = |light: &crate::scene::Light| strength_of(before, &light.name).is_some_and(|s| s != light.strength());
    !map.layers.is_empty() || !after.groups.is_empty() || after.lights.iter().any(relit)
}

/// Where a light goes when its layer is divided.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Target {
    Stays,
    Group(String),
    Alone(String),
}

impl Plan {
    pub(crate) fn new(before: &Scene, after: &Scene, map: &LightMap) -> Plan {
        let mut plan = Plan::default();
        let old = headers_of(map, before);
        let mut quota = Quota::new(&old);
        let lights =
            Lights { before, after, strength_before: strengths_of(before), strength_after: strengths_of(after) };
        for (index, header) in old.iter().enumerate() {
            if header.is_rest() && !map.layers.is_empty() {
                let pieces = vec![(Piece::Old(index), Vec3::ONE)];
                plan.regrouped.push(Planned { header: header.clone(), pieces });
                continue;
            }
            plan.divide(index, header, &lights, &mut quota);
        }
        plan.assemble(&lights);
        if plan.after.len() > SIDE_BY_SIDE && !plan.after[0].0.is_rest() {
            plan.add_rest();
        }
        plan
    }

    /// A first layer for what is left of the others where they matter little: there is nothing yet.
    fn add_rest(&mut self) {
        let header = LayerHeader { name: self.free_name(REST_LAYER), lights: Vec::new() };
        self.after.insert(0, (header.clone(), Some(self.regrouped.len())));
        self.changed.iter_mut().for_each(|place| *place += 1);
        self.regrouped.push(Planned { header, pieces: Vec::new() });
    }

    /// Puts the lights of an old layer where they belong.
    fn divide(&mut self, index: usize, header: &LayerHeader, lights: &Lights, quota: &mut Quota) {
        let before = lights.before;
        let mut targets: BTreeMap<Target, Vec<LayerLight>> = BTreeMap::new();
        for (light, target) in header.lights.iter().zip(targets_of(header, lights, quota)) {
            targets.entry(target).or_default().push(light.clone());
        }
        let whole = targets.len() == 1;
        let mut rest = vec![(Piece::Old(index), Vec3::ONE)];
        let (mut heir, mut others) = (None, Vec::new());
        for (k, (target, lights)) in targets.into_iter().enumerate() {
            // What is left when all others have left belongs to the first: those that stay, where there are any.
            if k == 0 {
                heir = Some((target, lights));
                continue;
            }
            let piece = Piece::Leaving(self.leaving.len());
            let mut leaving = LayerHeader { name: String::new(), lights: lights.clone() };
            let single = matches!(target, Target::Alone(_));
            if single {
                at_unit(&mut leaving);
            }
            rest.push((piece, if single { -lights[0].reference } else { Vec3::NEG_ONE }));
            self.leaving.push(leaving.clone());
            others.push((target, leaving.lights, vec![(piece, Vec3::ONE)]));
        }
        if let Some((target, lights)) = heir {
            let lights = if whole { header.lights.clone() } else { lights };
            self.join(&target, lights, rest, before, header);
        }
        for (target, lights, pieces) in others {
            self.join(&target, lights, pieces, before, header);
        }
    }

    /// Adds lights, whose light at reference strength is `pieces`, to the layer of their target.
    fn join(
        &mut self,
        target: &Target,
        lights: Vec<LayerLight>,
        pieces: Vec<(Piece, Vec3)>,
        before: &Scene,
        from: &LayerHeader,
    ) {
        let name = match target {
            Target::Stays => from.name.clone(),
            Target::Group(name) | Target::Alone(name) => name.clone(),
        };
        let is_group = matches!(target, Target::Group(_));
        let same_group = |p: &&mut Planned| is_group && p.header.name == name && !p.header.is_rest();
        let Some(there) = self.regrouped.iter_mut().find(same_group) else {
            let name = self.free_name(&name);
            self.regrouped.push(Planned { header: LayerHeader { name, lights }, pieces });
            return;
        };
        // Layers of different weight are joined at present strength.
        let mut new = Planned { header: LayerHeader { name, lights }, pieces };
        there.fold(before);
        new.fold(before);
        there.header.lights.extend(new.header.lights);
        there.pieces.extend(new.pieces);
    }

    fn free_name(&self, name: &str) -> String {
        free_name(name, |name| {
            self.regrouped.iter().any(|p| p.header.name == name) || self.after.iter().any(|(h, _)| h.name == name)
        })
    }

    /// The layers after the edit.
    fn assemble(&mut self, lights: &Lights) {
        let Lights { before, after, strength_before, strength_after } = lights;
        let (kinds_before, kinds_after) = (kinds_of(before), kinds_of(after));
        for (index, planned) in self.regrouped.iter().enumerate() {
            let mut header = planned.header.clone();
            header.lights.retain(|light| strength_after.contains_key(light.name.as_str()));
            if header.lights.is_empty() && !planned.header.lights.is_empty() {
                continue;
            }
            let gone = header.lights.len() < planned.header.lights.len();
            let uneven = weight_at(&header.lights, strength_after).is_none();
            let is_moved = |name: &str| kinds_before.get(name) != kinds_after.get(name);
            let moved = header.lights.iter().any(|light| is_moved(&light.name));
            if gone || uneven || moved {
                self.changed.push(self.after.len());
            }
            self.after.push((header, Some(index)));
        }
        // Of many layers, those of lamps that were off may be missing.
        let known: BTreeSet<String> =
            self.regrouped.iter().flat_map(|p| p.header.lights.iter().map(|light| light.name.clone())).collect();
        let comes = |light: &&crate::scene::Light| {
            let was_dark = !known.contains(&light.name) && light.strength() != Vec3::ZERO;
            !strength_before.contains_key(light.name.as_str()) || was_dark
        };
        let came = after.lights.iter().filter(comes);
        let joined: BTreeSet<usize> =
            came.filter_map(|light| self.add_new(after, &light.name, light.strength())).collect();
        for (k, (header, origin)) in self.after.iter_mut().enumerate() {
            if joined.contains(&k) || weight_at(&header.lights, strength_after).is_none() {
                if let Some(index) = *origin {
                    self.regrouped[index].fold(before);
                }
                let names: Vec<&str> = header.lights.iter().map(|l| l.name.as_str()).collect();
                header.lights = at_present(after, |name| names.contains(&name));
            }
        }
    }

    /// A light that the edit inserted: in its group's layer, in one of its own, or where there is no place in the
    /// first. Answers the layer that it joined, which has to be held at present strength then.
    fn add_new(&mut self, after: &Scene, name: &str, strength: Vec3) -> Option<usize> {
        let group = after.groups.get(name);
        let mut place = self.after.iter().position(|(h, _)| Some(&h.name) == group && !h.is_rest());
        if place.is_none() && self.after.len() >= MAX_LAYERS - 1 {
            place = self.after.iter().position(|(header, _)| !header.is_rest());
        }
        let light = LayerLight { name: name.to_owned(), reference: strength };
        if let Some(place) = place {
            self.after[place].0.lights.push(light);
            if !self.changed.contains(&place) {
                self.changed.push(place);
            }
            return Some(place);
        }
        let name = group.map_or(name, String::as_str).to_owned();
        let taken = |name: &str| self.after.iter().any(|(header, _)| header.name == name);
        let name = if taken(&name) { format!("{name}'") } else { name };
        let mut header = LayerHeader { name, lights: vec![light] };
        if group.is_none() {
            at_unit(&mut header);
        }
        self.changed.push(self.after.len());
        self.after.push((header, None));
        None
    }
}

/// Positions of the layers of a map whose lights all move, where an edit does nothing else, with their headers after
/// it.
pub(crate) fn moved_layers(transition: &Transition, map: &LightMap) -> Option<Vec<(usize, LayerHeader)>> {
    if map.layers.is_empty() || transition.changes_surfaces() {
        return None;
    }
    let (before, after) = (&transition.before.scene, &transition.after.scene);
    let plan = Plan::new(before, after, map);
    let stays = |(k, (header, origin)): (usize, &(LayerHeader, Option<usize>))| {
        *origin == Some(k) && header.name == map.layers[k].name && header.lights == map.layers[k].lights
    };
    let same_layers =
        plan.leaving.is_empty() && plan.after.len() == map.layers.len() && plan.after.iter().enumerate().all(stays);
    let only_moves = plan.changed.iter().all(|&k| is_new(&plan.after[k].0, before, after));
    let header = |&k: &usize| (k, plan.after[k].0.clone());
    (same_layers && only_moves && !plan.changed.is_empty()).then(|| plan.changed.iter().map(header).collect())
}

impl Planned {
    /// Holds the light of a layer at the strength before the edit: its weight becomes 1.
    fn fold(&mut self, before: &Scene) {
        let weight = weight_of(&self.header.lights, before).unwrap_or(Vec3::ONE);
        self.header.lights.iter_mut().for_each(|l| l.reference *= weight);
        self.pieces.iter_mut().for_each(|(_, factor)| *factor *= weight);
    }
}

/// The lights before and after an edit.
struct Lights<'a> {
    before: &'a Scene,
    after: &'a Scene,
    strength_before: Strengths<'a>,
    strength_after: Strengths<'a>,
}

/// How many layers there may be more, and which there are.
struct Quota {
    left: usize,
    known: BTreeSet<String>,
}

impl Quota {
    fn new(old: &[LayerHeader]) -> Quota {
        let known = old.iter().map(|header| header.name.clone()).collect();
        Quota { left: (MAX_LAYERS - 1).saturating_sub(old.len()), known }
    }

    fn take(&mut self, name: &str) -> bool {
        if self.known.contains(name) {
            return true;
        }
        let free = self.left > 0;
        if free {
            self.left -= 1;
            self.known.insert(name.to_owned());
        }
        free
    }
}

/// Where the lights of a layer go, in their order.
fn targets_of(header: &LayerHeader, lights: &Lights, quota: &mut Quota) -> Vec<Target> {
    let is_there = |light: &LayerLight| lights.strength_after.contains_key(light.name.as_str());
    let group = |light: &LayerLight| lights.after.groups.get(&light.name).filter(|_| is_there(light));
    let stay: Vec<&LayerLight> = header.lights.iter().filter(|light| group(light).is_none()).collect();
    let kept = lights_that_keep(&stay, lights);
    let target = |light: &LayerLight| match group(light) {
        Some(group) if quota.take(group) => Target::Group(group.clone()),
        None if !kept.contains(&light.name) && quota.take(&light.name) => Target::Alone(light.name.clone()),
        _ => Target::Stays,
    };
    header.lights.iter().map(target).collect()
}

/// Of lights that may change unlike one another, the names of those that stay together: those of the most common
/// factor, and rather those that do not change. Lights that go stay with them.
fn lights_that_keep(
    lights: &[&LayerLight],
    Lights { strength_before, strength_after, .. }: &Lights,
) -> BTreeSet<String> {
    let change = |light: &LayerLight| strength_after.get(light.name.as_str()).map(|after| (light.reference, *after));
    let fits = |light: &LayerLight, to: &LayerLight| {
        change(light).is_none_or(|light| weight_of_changes([Some(light), change(to)].into_iter().flatten()).is_some())
    };
    let fitting = |to: &LayerLight| lights.iter().filter(|light| fits(light, to)).count();
    let is_steady =
        |light: &LayerLight| strength_before.get(light.name.as_str()) == strength_after.get(light.name.as_str());
    let candidates = lights.iter().filter(|light| strength_after.contains_key(light.name.as_str()));
    // The same change has the same lights: each is looked at once.
    let mut seen: Vec<(LayerLight, usize)> = Vec::new();
    let mut fitting = |to: &LayerLight| {
        let same = |(other, _): &&(LayerLight, usize)| change(other) == change(to);
        if let Some((_, count)) = seen.iter().find(same) {
            return *count;
        }
        let count = fitting(to);
        seen.push((to.clone(), count));
        count
    };
    let best = candidates.max_by_key(|light| (fitting(light), is_steady(light)));
    let kept = lights.iter().filter(|light| best.is_none_or(|best| fits(light, best)));
    kept.map(|light| light.name.clone()).collect()
}

fn kinds_of(scene: &Scene) -> BTreeMap<&str, &crate::scene::LightKind> {
    scene.lights.iter().rev().map(|light| (light.name.as_str(), &light.kind)).collect()
}

fn kind_of<'a>(scene: &'a Scene, name: &str) -> Option<&'a crate::scene::LightKind> {
    scene.lights.iter().find(|light| light.name == name).map(|light| &light.kind)
}
