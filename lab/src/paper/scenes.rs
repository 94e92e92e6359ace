//! A scene taken apart: S without the object, the object O alone, and both together.

use std::collections::BTreeSet;
use std::sync::Arc;

use glam::Vec3;

use rebake_core::{Emitter, Placed, Transition, Trees, Validity, World};

/// Keys of objects.
pub(super) type Keys = BTreeSet<u32>;

/// S ∪ O, S and O. Slots of elements, triangles and parts are those of S ∪ O.
pub(super) struct ObjectScene<'a> {
    /// S ∪ O.
    pub with: &'a World,
    /// S, as trees.
    pub without: Trees,
    /// Of the elements of S while O is away; it may be neither that before nor that after an edit.
    pub validity: Validity,
    /// O.
    pub object: Trees,
    /// Sphere around O: centre, radius (metres).
    pub sphere: (Vec3, f32),
    /// Per part: it belongs to O.
    pub is_object: Vec<bool>,
    /// Element slots of S.
    pub rows: Vec<u32>,
    /// Valid element slots of O.
    pub object_rows: Vec<u32>,
}

impl<'a> ObjectScene<'a> {
    /// Takes the objects `keys` of `with` as O.
    pub(super) fn new(with: &'a World, keys: &Keys) -> ObjectScene<'a> {
        let (object, without) = with.apart(keys);
        let placed = || with.placed().iter().filter(|p| keys.contains(&p.key));
        let of = |inside: bool| {
            let placed = with.placed().iter().filter(move |p| keys.contains(&p.key) == inside);
            placed.flat_map(|p| p.placement.elements.clone()).filter(|&i| with.areas()[i as usize] > 0.0)
        };
        let bounds = placed().map(|p| p.surface.bounds());
        let bounds = bounds.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1))).unwrap_or((Vec3::INFINITY, Vec3::NEG_INFINITY));
        ObjectScene {
            with,
            validity: with.validity_among(&without, bounds),
            without,
            object,
            sphere: bounding_sphere(&placed().flat_map(|p| p.surface.all_corners()).collect::<Vec<_>>()),
            is_object: with.part_objects().map(|object| keys.contains(&object)).collect(),
            rows: of(false).collect(),
            object_rows: of(true).filter(|&i| with.is_valid(i as usize)).collect(),
        }
    }
}

/// The sphere around the middle of the bounding box.
fn bounding_sphere(corners: &[[Vec3; 3]]) -> (Vec3, f32) {
    let points = || corners.iter().flatten().copied();
    let (low, high) = points().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
    let center = (low + high) * 0.5;
    (center, points().map(|p| p.distance(center)).fold(0.0, f32::max) * 1.0001)
}

/// Objects to remove from the world before and to insert into the world after: what is removed, inserted, moved or
/// repainted.
pub(super) fn edited(transition: &Transition) -> (Keys, Keys) {
    let (before, after) = (&transition.before, &transition.after);
    let changed = |one: &World, other: &World| -> Keys {
        let stays = |p: &Placed| {
            let twin = other.placed().iter().find(|q| q.key == p.key);
            twin.is_some_and(|q| Arc::ptr_eq(&q.surface, &p.surface) && one.albedos_of(p) == other.albedos_of(q))
        };
        one.placed().iter().filter(|p| !stays(p)).map(|p| p.key).collect()
    };
    (changed(before, after), changed(after, before))
}

/// Whether anything but the lights on edited objects shines otherwise than before.
pub(super) fn lights_differ(before: &World, after: &World, gone: &Keys, come: &Keys) -> bool {
    let steady = |world: &World, keys: &Keys| {
        let list =
            world.emitters().iter().chain(world.skies()).filter(|e| e.object.is_none_or(|key| !keys.contains(&key)));
        list.cloned().collect::<Vec<_>>()
    };
    let (old, new) = (steady(before, gone), steady(after, come));
    let same = |(a, b): (&Emitter, &Emitter)| a.name == b.name && a.strength == b.strength && a.same_shape(b);
    old.len() != new.len() || !old.iter().zip(&new).all(same)
}
