//! Plans as text.

use std::sync::Arc;

use glam::{DVec3, Vec3};

use super::plan::{Piece, Plan, groups_of, wants_layers};
use super::{
    BLOCK_SLOTS, Layer, LayerHeader, LayerLight, LightValues, MAX_GROUPS, MAX_LAYERS, REST_LAYER, SHARED_LAYER,
    SIDE_BY_SIDE, correlation, weight_of, whole, whole_of,
};
use crate::lightmap::LightMap;
use crate::scene::{Light, LightKind, Scene};

fn scene(lights: &[(&str, f32)], groups: &[(&str, &str)]) -> Scene {
    let light = |&(name, intensity): &(&str, f32)| Light {
        name: name.to_owned(),
        kind: LightKind::Point { position: DVec3::ZERO, range: None },
        color: Vec3::ONE,
        intensity,
    };
    let groups = groups.iter().map(|(light, group)| ((*light).to_owned(), (*group).to_owned())).collect();
    Scene { lights: lights.iter().map(light).collect(), groups, ..Scene::from_objects(Vec::new()) }
}

fn map(layers: &[(&str, &[(&str, f32)])]) -> LightMap {
    let light =
        |&(name, reference): &(&str, f32)| LayerLight { name: name.to_owned(), reference: Vec3::splat(reference) };
    let layer = |(name, lights): &(&str, &[(&str, f32)])| {
        Arc::new(Layer { name: (*name).to_owned(), lights: lights.iter().map(light).collect(), ..Layer::default() })
    };
    LightMap { layers: layers.iter().map(layer).collect(), ..LightMap::default() }
}

/// `name(light@reference light@reference) = pieces`, one per layer after the edit, and what changes.
fn told(plan: &Plan) -> String {
    let lights = |header: &LayerHeader| {
        let lights = header.lights.iter().map(|l| format!("{}@{}", l.name, l.reference.x));
        lights.collect::<Vec<_>>().join(" ")
    };
    let piece = |(piece, factor): &(Piece, Vec3)| match piece {
        Piece::Old(k) => format!("{:+} old {k}", factor.x),
        Piece::Leaving(k) => format!("{:+} [{}]", factor.x, lights(&plan.leaving[*k])),
    };
    let layer = |(k, (header, origin)): (usize, &(LayerHeader, Option<usize>))| {
        let pieces: Vec<String> =
            origin.map(|o| plan.regrouped[o].pieces.iter().map(piece).collect()).unwrap_or_default();
        let changed = if plan.changed.contains(&k) { " (changed)" } else { "" };
        format!("{}({}) = {}{changed}", header.name, lights(header), pieces.join(" "))
    };
    plan.after.iter().enumerate().map(layer).collect::<Vec<_>>().join("\n")
}

#[test]
fn a_relit_light_leaves_the_others() {
    let (before, after) = (scene(&[("a", 2.0), ("b", 3.0)], &[]), scene(&[("a", 4.0), ("b", 3.0)], &[]));
    assert!(wants_layers(&before, &after, &map(&[])) && !wants_layers(&before, &before, &map(&[])));
    let plan = Plan::new(&before, &after, &map(&[]));
    assert_eq!(told(&plan), "shared(b@3) = +1 old 0 -2 [a@1]\na(a@1) = +1 [a@1]");
}

#[test]
fn lights_that_change_alike_stay_together() {
    let (before, after) = (scene(&[("a", 2.0), ("b", 3.0)], &[]), scene(&[("a", 4.0), ("b", 6.0)], &[]));
    assert_eq!(told(&Plan::new(&before, &after, &map(&[]))), "shared(a@2 b@3) = +1 old 0");
}

#[test]
fn a_light_that_was_off_is_computed_anew() {
    let (before, after) = (scene(&[("a", 0.0)], &[]), scene(&[("a", 4.0)], &[]));
    let plan = Plan::new(&before, &after, &map(&[]));
    assert_eq!(told(&plan), "a(a@4) = +1 old 0 (changed)");
    // Held at unit emission it has not been forgotten.
    let plan = Plan::new(&before, &after, &map(&[("a", &[("a", 1.0)])]));
    assert_eq!(told(&plan), "a(a@1) = +1 old 0");
}

#[test]
fn groups_divide_and_join() {
    let lights = [("a", 2.0), ("b", 3.0), ("c", 5.0)];
    let (before, after) = (scene(&lights, &[]), scene(&lights, &[("a", "g"), ("b", "g")]));
    let plan = Plan::new(&before, &after, &map(&[]));
    assert_eq!(told(&plan), "shared(c@5) = +1 old 0 -1 [a@2 b@3]\ng(a@2 b@3) = +1 [a@2 b@3]");
    // Layers that are there are summed at what they weigh.
    let alone = map(&[("a", &[("a", 1.0)]), ("b", &[("b", 1.0)]), ("c", &[("c", 1.0)])]);
    let plan = Plan::new(&before, &after, &alone);
    assert_eq!(told(&plan), "g(a@2 b@3) = +2 old 0 +3 old 1\nc(c@1) = +1 old 2");
    assert!(plan.leaving.is_empty());
}

#[test]
fn lights_come_and_go() {
    let layers = map(&[("a", &[("a", 1.0)]), ("rest", &[("b", 2.0), ("c", 2.0)])]);
    let before = scene(&[("a", 2.0), ("b", 4.0), ("c", 4.0)], &[]);
    let after = scene(&[("b", 4.0), ("d", 7.0)], &[]);
    let plan = Plan::new(&before, &after, &layers);
    assert_eq!(told(&plan), "rest(b@2) = +1 old 1 (changed)\nd(d@1) =  (changed)");
}

#[test]
fn there_are_never_more_layers_than_fit() {
    let names: Vec<String> = (0..MAX_LAYERS + 40).map(|i| format!("l{i}")).collect();
    let strengths = |by: f32| -> Vec<(&str, f32)> {
        names.iter().enumerate().map(|(i, n)| (n.as_str(), 1.0 + by * i as f32)).collect()
    };
    let (before, after) = (strengths(0.0), strengths(1.0));
    let plan = Plan::new(&scene(&before, &[]), &scene(&after, &[]), &map(&[]));
    assert_eq!(plan.after.len(), MAX_LAYERS);
    let mut held: Vec<&str> = plan.after.iter().flat_map(|(h, _)| h.lights.iter().map(|l| l.name.as_str())).collect();
    held.sort_unstable();
    held.dedup();
    assert_eq!(held.len(), names.len(), "every light is in one layer");
    // Those that had to stay together change in it, and hold their present strength.
    assert_eq!(plan.changed, [1]);
    // What is left of all where they matter little comes first, and is nothing yet.
    let (rest, origin) = &plan.after[0];
    assert!(rest.is_rest() && plan.regrouped[origin.unwrap()].pieces.is_empty());
    assert!(plan.after.iter().all(|(h, _)| weight_of(&h.lights, &scene(&after, &[])).is_some()));
}

#[test]
fn more_groups_than_layers_share_one() {
    let names: Vec<String> = (0..MAX_LAYERS + 5).map(|k| format!("lamp-{k:04}")).collect();
    let lights: Vec<(&str, f32)> = names.iter().map(|name| (name.as_str(), 1.0)).collect();
    let groups: Vec<(&str, &str)> = names.iter().map(|name| (name.as_str(), name.as_str())).collect();
    let headers = groups_of(&scene(&lights, &groups));
    assert_eq!(headers.len(), MAX_LAYERS);
    let shared = headers.iter().find(|header| header.name == SHARED_LAYER).unwrap();
    assert_eq!(shared.lights.len(), names.len() - MAX_GROUPS);
}

#[test]
fn more_layers_than_fit_side_by_side_have_a_rest_and_are_held_as_they_are() {
    let names: Vec<String> = (0..20).map(|k| format!("lamp-{k:02}")).collect();
    let lights: Vec<(&str, f32)> = names.iter().enumerate().map(|(k, name)| (name.as_str(), k as f32)).collect();
    let group =
        |count: usize| -> Vec<(&str, &str)> { names[..count].iter().map(|n| (n.as_str(), n.as_str())).collect() };
    let few = groups_of(&scene(&lights, &group(15)));
    assert!(few.len() == SIDE_BY_SIDE && few.iter().all(|header| !header.is_rest()));
    let many = groups_of(&scene(&lights, &group(16)));
    // The lamp that is off has no layer: it is in none of the 15 groups that are left, the shared one and the rest.
    assert_eq!((many.len(), many[0].name.as_str(), many[0].is_rest()), (SIDE_BY_SIDE + 1, REST_LAYER, true));
    let reference = |name: &str| many.iter().find(|header| header.name == name).map(|h| h.lights[0].reference.x);
    assert_eq!((reference("lamp-00"), reference("lamp-07")), (None, Some(7.0)));
    // The rest stays the first, as it is, through edits.
    let as_lights = |header: &LayerHeader| (header.name.clone(), header.lights.clone());
    let layer = |header: &LayerHeader| {
        let (name, lights) = as_lights(header);
        Arc::new(Layer { name, lights, ..Layer::default() })
    };
    let old = LightMap { layers: many.iter().map(layer).collect(), ..LightMap::default() };
    let mut brighter = lights.clone();
    brighter[3].1 = 30.0;
    let plan = Plan::new(&scene(&lights, &group(16)), &scene(&brighter, &group(16)), &old);
    assert!(plan.after[0].0.is_rest() && plan.changed.is_empty() && plan.leaving.is_empty());
    assert_eq!(plan.regrouped[0].pieces, [(Piece::Old(0), Vec3::ONE)]);
    // It gets one when it is turned on.
    brighter[0].1 = 2.0;
    let plan = Plan::new(&scene(&lights, &group(16)), &scene(&brighter, &group(16)), &old);
    let (header, origin) = plan.after.last().unwrap();
    assert_eq!((header.name.as_str(), *origin, &*plan.changed), ("lamp-00", None, &[plan.after.len() - 1][..]));
}

/// Three blocks: a lamp in the first, another in the last, and what is left of both everywhere.
#[test]
fn a_relit_layer_changes_its_own_blocks_alone() {
    let slots = 3 * BLOCK_SLOTS;
    let (before, after) = (scene(&[("a", 1.0), ("b", 1.0)], &[]), scene(&[("a", 3.0), ("b", 1.0)], &[]));
    let light = |block: Option<usize>| {
        let is_lit = |slot: usize| block.is_none_or(|block| slot / BLOCK_SLOTS == block);
        let value = |slot: usize, scale: f32| if is_lit(slot) { scale * (1.0 + (slot % 7) as f32) } else { 0.0 };
        let values = |scale: f32| -> Vec<Vec3> { (0..slots).map(|slot| Vec3::splat(value(slot, scale))).collect() };
        let variance = (0..slots).map(|slot| value(slot, 1e-3)).collect();
        LightValues { direct: values(1.0), indirect: values(0.5), variance }
    };
    let named = map(&[("rest", &[]), ("a", &[("a", 1.0)]), ("b", &[("b", 1.0)])]).layers;
    let with = |(layer, block): (&Arc<Layer>, Option<usize>)| {
        Arc::new(Layer { light: light(block).into(), ..Layer::clone(layer) })
    };
    let layers: Vec<Arc<Layer>> = named.iter().zip([None, Some(0), Some(2)]).map(with).collect();
    let weights = |scene: &Scene| LightMap { layers: layers.clone(), ..LightMap::default() }.layer_weights(scene);
    let old = whole(layers.clone(), &weights(&before), 0.0);
    let relit = whole_of(layers.clone(), &old, &before, &after);
    let anew = whole(layers.clone(), &weights(&after), correlation(&old, &weights(&before)));
    assert!(relit.light.direct == anew.light.direct && relit.light.indirect == anew.light.indirect);
    let close = |a: f32, b: f32| (a - b).abs() <= 1e-5 * b;
    for slot in 0..slots {
        assert!(close(relit.light.variance[slot], anew.light.variance[slot]), "slot {slot}");
        // The rest has this lamp at a third of its strength: it is off by twice itself at most.
        let rest = 1.5 * (1.0 + (slot % 7) as f32);
        if slot >= BLOCK_SLOTS {
            assert!(close(relit.light.variance[slot], old.light.variance[slot] + 4.0 * rest * rest), "slot {slot}");
        }
    }
    // And back.
    let back = whole_of(layers, &relit, &after, &before);
    assert_eq!(back.light.direct, old.light.direct);
    for slot in 0..slots {
        // What was added in between is taken out again, but for the last bits of it.
        let difference = (back.light.variance[slot] - old.light.variance[slot]).abs();
        assert!(difference <= 1e-5 * old.light.variance[slot] + 1e-6 * relit.light.variance[slot], "slot {slot}");
    }
}
