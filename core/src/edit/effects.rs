//! The table of edits: what each reads, writes and costs, and what becomes of two that meet.
//!
//! Whoever wants to know which edits are lit as one, which one another makes superfluous, or what memory one takes asks
//! here and nowhere else. A new kind of edit is an arm of each of these matches; the compiler finds the missing ones.

use glam::DMat4;

use super::{Edit, name_matches};
use crate::scene::{ENVIRONMENT, Scene};

/// What edits are about, by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Thing<'a> {
    /// An object.
    Object(&'a str),
    /// A light.
    Light(&'a str),
    /// A material of the file, on all objects that have it.
    Material(&'a str),
}

/// What an edit gives a new value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Property<'a> {
    /// Where an object or a light stands, and how it is turned.
    Transform,
    /// The albedo of all materials of an object, or of a material.
    Albedo,
    /// The albedo of one material of an object, by its name.
    AlbedoOf(&'a str),
    /// The base colour factor of all materials of an object, or of a material.
    Factor,
    /// The base colour factor of one material of an object, by its name.
    FactorOf(&'a str),
    /// Whether an object is hidden.
    Visibility,
    /// Colour and intensity of a light.
    Strength,
    /// The group of a light.
    Group,
}

/// What an edit writes. It reads whether the things that it names are there: what comes must not be, all else has to
/// be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect<'a> {
    /// A thing comes.
    Comes(Thing<'a>),
    /// A thing goes. Objects: all whose names match.
    Goes(Thing<'a>),
    /// Lights come or go that the edit does not name: those that belong to objects.
    LightsComeOrGo,
    /// A thing that stays has another value of a property.
    Sets(Thing<'a>, Property<'a>),
}

impl Effect<'_> {
    /// Whether a thing of that name may come or go by it.
    pub fn brings_or_takes(&self, thing: Thing<'_>) -> bool {
        match (self, thing) {
            (Effect::Comes(other), _) => *other == thing,
            (Effect::Goes(Thing::Object(pattern)), Thing::Object(name)) => name_matches(pattern, name),
            (Effect::Goes(other), _) => *other == thing,
            (Effect::LightsComeOrGo, Thing::Light(_)) => true,
            (Effect::LightsComeOrGo, Thing::Object(_) | Thing::Material(_)) | (Effect::Sets(..), _) => false,
        }
    }
}

impl Effect<'_> {
    /// Whether it asks for something, of which a thing may be all there is: a pattern has to match, a material to be on an
    /// object.
    pub fn may_need(&self, thing: Thing<'_>) -> bool {
        match (self, thing) {
            (Effect::Sets(Thing::Object(pattern), Property::Visibility), Thing::Object(name)) => {
                pattern.contains('*') && name_matches(pattern, name)
            }
            (Effect::Sets(Thing::Material(_), _), Thing::Object(_)) => true,
            _ => false,
        }
    }
}

/// What the light after an edit costs, the cheapest first.
#[derive(Clone, Copy, Debug)]
pub enum Cost<'a> {
    /// Layers are split or joined: no other light.
    Layers,
    /// Weights of layers: rays only where a light has no layer of its own yet.
    Weights,
    /// Light of lights that are inserted, removed or moved, everywhere; surfaces and their transport are unchanged.
    Lights,
    /// Light between the surfaces that change and all others.
    Surfaces,
    /// Light between what comes and all else, and elements for what comes.
    Elements {
        /// What comes.
        asset: &'a Scene,
        /// Asset space to world space, metres.
        transform: &'a DMat4,
    },
}

impl Edit {
    /// What it writes.
    pub fn effects(&self) -> Vec<Effect<'_>> {
        match self {
            Edit::Insert { asset, name, .. } => {
                // An asset's environment stays behind.
                let brings_lights = asset.lights.iter().any(|light| !light.kind.is_from_outside());
                let lights = brings_lights.then_some(Effect::LightsComeOrGo);
                [Effect::Comes(Thing::Object(name))].into_iter().chain(lights).collect()
            }
            Edit::Remove { objects } => {
                let goes = objects.iter().map(|pattern| Effect::Goes(Thing::Object(pattern)));
                goes.chain([Effect::LightsComeOrGo]).collect()
            }
            Edit::Move { object, .. } => vec![Effect::Sets(Thing::Object(object), Property::Transform)],
            Edit::Material { object, .. } => vec![Effect::Sets(Thing::Object(object), Property::Albedo)],
            Edit::NamedMaterial { object: None, material, .. } => {
                vec![Effect::Sets(Thing::Material(material), Property::Albedo)]
            }
            Edit::NamedMaterial { object: Some(object), material, .. } => {
                vec![Effect::Sets(Thing::Object(object), Property::AlbedoOf(material))]
            }
            Edit::Tint { object: Some(object), material: None, .. } => {
                vec![Effect::Sets(Thing::Object(object), Property::Factor)]
            }
            Edit::Tint { object: Some(object), material: Some(material), .. } => {
                vec![Effect::Sets(Thing::Object(object), Property::FactorOf(material))]
            }
            Edit::Tint { object: None, material, .. } => {
                let material = material.as_deref().unwrap_or_default();
                vec![Effect::Sets(Thing::Material(material), Property::Factor)]
            }
            Edit::Hide { objects } | Edit::Show { objects } => {
                let sets = objects.iter().map(|name| Effect::Sets(Thing::Object(name), Property::Visibility));
                sets.chain([Effect::LightsComeOrGo]).collect()
            }
            Edit::Restore(restore) => restore.effects(),
            Edit::Relight { lights } => {
                lights.iter().map(|one| Effect::Sets(Thing::Light(&one.light), Property::Strength)).collect()
            }
            Edit::InsertLight { name, .. } => vec![Effect::Comes(Thing::Light(name))],
            // It may have been there.
            Edit::Sky { .. } => {
                let sky = Thing::Light(ENVIRONMENT);
                vec![Effect::Comes(sky), Effect::Sets(sky, Property::Transform), Effect::Sets(sky, Property::Strength)]
            }
            Edit::RemoveLight { light } => vec![Effect::Goes(Thing::Light(light))],
            Edit::MoveLight { light, .. } => vec![Effect::Sets(Thing::Light(light), Property::Transform)],
            Edit::GroupLights { lights, .. } => {
                lights.iter().map(|light| Effect::Sets(Thing::Light(light), Property::Group)).collect()
            }
        }
    }

    /// What its light costs.
    pub fn cost(&self) -> Cost<'_> {
        match self {
            Edit::GroupLights { .. } => Cost::Layers,
            Edit::Relight { .. } => Cost::Weights,
            Edit::InsertLight { .. } | Edit::Sky { .. } | Edit::RemoveLight { .. } | Edit::MoveLight { .. } => {
                Cost::Lights
            }
            Edit::Remove { .. }
            | Edit::Move { .. }
            | Edit::Material { .. }
            | Edit::NamedMaterial { .. }
            | Edit::Tint { .. }
            | Edit::Hide { .. }
            | Edit::Show { .. } => Cost::Surfaces,
            Edit::Restore(restore) => restore.cost(),
            Edit::Insert { asset, transform, .. } => Cost::Elements { asset, transform },
        }
    }

    /// Edits of one thing each that together do what this one does, as far as their order is of no matter.
    pub fn split(self) -> Vec<Edit> {
        match self {
            Edit::Relight { lights } => lights.into_iter().map(|one| Edit::Relight { lights: vec![one] }).collect(),
            // Patterns are all looked up before anything goes, groups are counted once, and a state is one.
            edit @ (Edit::Remove { .. }
            | Edit::Hide { .. }
            | Edit::Show { .. }
            | Edit::GroupLights { .. }
            | Edit::Restore(_)) => vec![edit],
            edit @ (Edit::Insert { .. }
            | Edit::Move { .. }
            | Edit::Material { .. }
            | Edit::NamedMaterial { .. }
            | Edit::Tint { .. }
            | Edit::InsertLight { .. }
            | Edit::Sky { .. }
            | Edit::RemoveLight { .. }
            | Edit::MoveLight { .. }) => vec![edit],
        }
    }

    /// Takes over what an earlier edit of the same property of the same thing set and this one leaves open.
    pub fn take_over(&mut self, earlier: Edit) {
        match (self, earlier) {
            (Edit::Relight { lights }, Edit::Relight { lights: earlier }) => {
                for old in earlier {
                    lights.iter_mut().filter(|one| one.light == old.light).for_each(|one| {
                        one.color = one.color.or(old.color);
                        one.intensity = one.intensity.or(old.intensity);
                    });
                }
            }
            (
                Edit::MoveLight { position, direction, own_layer, .. },
                Edit::MoveLight { position: old_position, direction: old_direction, own_layer: had_own_layer, .. },
            ) => {
                *own_layer |= had_own_layer;
                *position = position.or(old_position);
                *direction = direction.or(old_direction);
            }
            // They leave nothing open.
            (
                Edit::Insert { .. }
                | Edit::Remove { .. }
                | Edit::Move { .. }
                | Edit::Material { .. }
                | Edit::NamedMaterial { .. }
                | Edit::Tint { .. }
                | Edit::Hide { .. }
                | Edit::Show { .. }
                | Edit::Restore(_)
                | Edit::Relight { .. }
                | Edit::InsertLight { .. }
                | Edit::Sky { .. }
                | Edit::RemoveLight { .. }
                | Edit::MoveLight { .. }
                | Edit::GroupLights { .. },
                _,
            ) => {}
        }
    }

    /// What is left of it where it says nothing of a thing; none where that was all.
    pub fn without(mut self, thing: Thing<'_>) -> Option<Edit> {
        let is_object = |name: &str| thing == Thing::Object(name);
        let is_light = |name: &str| thing == Thing::Light(name);
        let is_left = match &mut self {
            Edit::Remove { objects } | Edit::Hide { objects } | Edit::Show { objects } => {
                keep(objects, |name| !is_object(name))
            }
            Edit::NamedMaterial { object, .. } | Edit::Tint { object, .. } => !object.as_deref().is_some_and(is_object),
            Edit::Restore(restore) => return restore.without(thing).map(|left| Edit::Restore(left.into())),
            Edit::Relight { lights } => keep(lights, |one| !is_light(&one.light)),
            Edit::GroupLights { lights, .. } => keep(lights, |name| !is_light(name)),
            Edit::Insert { name: object, .. } | Edit::Move { object, .. } | Edit::Material { object, .. } => {
                !is_object(object)
            }
            Edit::Sky { .. } => !is_light(ENVIRONMENT),
            Edit::InsertLight { name: light, .. } | Edit::RemoveLight { light } | Edit::MoveLight { light, .. } => {
                !is_light(light)
            }
        };
        is_left.then_some(self)
    }
}

/// Keeps what `is_kept` says yes to; whether anything is left.
fn keep<T>(list: &mut Vec<T>, is_kept: impl FnMut(&T) -> bool) -> bool {
    list.retain(is_kept);
    !list.is_empty()
}
