//! From one state of a scene to another, as an edit: undo and redo.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use super::{Cost, Effect, Property, Thing};
use crate::scene::{HiddenLight, Light, Object, Scene};

/// What takes a scene from one of its states to another. It holds what differs and nothing else; geometry is shared.
#[derive(Clone, Debug, Default)]
pub struct Restore {
    pub(crate) objects: Vec<Restored>,
    /// All lights; none where they are the same in both states.
    pub(crate) lights: Option<Lights>,
    /// Of the lights nothing but strengths differs.
    is_relight: bool,
}

/// An object that differs.
#[derive(Clone, Debug)]
pub(crate) enum Restored {
    /// It is not there any more.
    Gone(String),
    /// It is there, at this place in the list.
    Back(usize, Arc<Object>),
    /// It stands elsewhere.
    Moved(Arc<Object>),
    /// Its materials differ.
    Painted(Arc<Object>),
    /// It has another surface, or differs in more than one way.
    Replaced(Arc<Object>),
}

/// All that a scene knows of lights.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Lights {
    pub(crate) lights: Vec<Light>,
    pub(crate) groups: BTreeMap<String, String>,
    pub(crate) parents: BTreeMap<String, String>,
    pub(crate) hidden: BTreeMap<String, Vec<HiddenLight>>,
}

impl Lights {
    pub(crate) fn of(scene: &Scene) -> Lights {
        Lights {
            lights: scene.lights.clone(),
            groups: scene.groups.clone(),
            parents: scene.light_parents.clone(),
            hidden: scene.hidden_lights.clone(),
        }
    }

    fn is_relit(&self, other: &Lights) -> bool {
        let same_kind = |(a, b): (&Light, &Light)| a.name == b.name && a.kind == b.kind;
        self.lights.len() == other.lights.len()
            && self.lights.iter().zip(&other.lights).all(same_kind)
            && self.groups == other.groups
            && self.parents == other.parents
            && self.hidden == other.hidden
    }
}

impl Restored {
    pub(crate) fn name(&self) -> &str {
        match self {
            Restored::Gone(name) => name,
            Restored::Back(_, object)
            | Restored::Moved(object)
            | Restored::Painted(object)
            | Restored::Replaced(object) => &object.name,
        }
    }

    fn between(from: &Object, to: &Arc<Object>) -> Option<Restored> {
        let is_placed_alike = from.world_from_object == to.world_from_object;
        let is_painted_alike = from.materials == to.materials;
        let same_look = |(a, b): (&Option<Arc<_>>, &Option<Arc<_>>)| match (a, b) {
            (Some(a), Some(b)) => Arc::ptr_eq(a, b),
            (a, b) => a.is_none() && b.is_none(),
        };
        let has_same_looks = from.looks.len() == to.looks.len() && from.looks.iter().zip(&to.looks).all(same_look);
        let is_same_mesh = Arc::ptr_eq(&from.mesh, &to.mesh) && from.is_hidden == to.is_hidden && has_same_looks;
        match (is_same_mesh, is_placed_alike, is_painted_alike) {
            (true, true, true) => None,
            (true, false, true) => Some(Restored::Moved(Arc::clone(to))),
            (true, true, false) => Some(Restored::Painted(Arc::clone(to))),
            _ => Some(Restored::Replaced(Arc::clone(to))),
        }
    }

    fn effects(&self) -> Vec<Effect<'_>> {
        let thing = Thing::Object(self.name());
        match self {
            Restored::Gone(_) => vec![Effect::Goes(thing)],
            Restored::Back(..) => vec![Effect::Comes(thing)],
            Restored::Moved(_) => vec![Effect::Sets(thing, Property::Transform)],
            Restored::Painted(_) => vec![Effect::Sets(thing, Property::Albedo)],
            Restored::Replaced(_) => {
                [Property::Transform, Property::Albedo, Property::Visibility].map(|p| Effect::Sets(thing, p)).into()
            }
        }
    }
}

impl Restore {
    /// What takes `from` to `to`, which are states of one scene.
    pub fn between(from: &Scene, to: &Scene) -> Restore {
        let old: BTreeMap<&str, &Arc<Object>> = from.objects.iter().map(|o| (o.name.as_str(), o)).collect();
        let names: BTreeSet<&str> = to.objects.iter().map(|o| o.name.as_str()).collect();
        let gone = from.objects.iter().filter(|o| !names.contains(o.name.as_str()));
        let mut objects: Vec<Restored> = gone.map(|o| Restored::Gone(o.name.clone())).collect();
        objects.extend(to.objects.iter().enumerate().filter_map(
            |(index, object)| match old.get(object.name.as_str()) {
                None => Some(Restored::Back(index, Arc::clone(object))),
                Some(old) => Restored::between(old, object),
            },
        ));
        let (before, after) = (Lights::of(from), Lights::of(to));
        let is_relight = before.is_relit(&after);
        Restore { objects, lights: (before != after).then_some(after), is_relight }
    }

    pub(super) fn effects(&self) -> Vec<Effect<'_>> {
        let of_objects = self.objects.iter().flat_map(Restored::effects);
        of_objects.chain(self.lights.as_ref().map(|_| Effect::LightsComeOrGo)).collect()
    }

    pub(super) fn cost(&self) -> Cost<'_> {
        match () {
            () if !self.objects.is_empty() => Cost::Surfaces,
            () if self.is_relight => Cost::Weights,
            () => Cost::Lights,
        }
    }

    /// What is left of it where it says nothing of an object; none where that was all.
    pub(super) fn without(&self, thing: Thing<'_>) -> Option<Restore> {
        let mut left = self.clone();
        left.objects.retain(|object| thing != Thing::Object(object.name()));
        (!left.objects.is_empty() || left.lights.is_some()).then_some(left)
    }
}
