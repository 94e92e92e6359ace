//! Fewer edits to the same end: edits that queue up behind each other are lit as one where that gives the same result.
//!
//! Pure functions on lists of edits that were accepted one after the other. Of five moves of one object the last one
//! counts; an object that comes and goes leaves nothing; relights of a light add up to one. What an edit does is asked
//! of its effects ([`Effect`]): no kind of edit is named here.

use rebake_core::edit::{Effect, Property, Thing};

use crate::engine::Edit;

/// More edits than this are lit one by one: the search is quadratic.
const MAX_EDITS: usize = 1024;

/// An equivalent list, as short as it gets. Relights of several lights count as several edits.
pub(crate) fn simplify(edits: impl IntoIterator<Item = Edit>) -> Vec<Edit> {
    let mut edits: Vec<Edit> = edits.into_iter().flat_map(Edit::split).collect();
    if edits.len() > MAX_EDITS {
        return edits;
    }
    loop {
        let count = edits.len();
        edits = absorbed(edits);
        // What went last may have been all that kept an earlier one.
        if edits.len() == count {
            return edits;
        }
    }
}

/// What is left where every edit has absorbed what it can of those before it.
fn absorbed(edits: Vec<Edit>) -> Vec<Edit> {
    let mut edits: Vec<Option<Edit>> = edits.into_iter().map(Some).collect();
    for later in 1..edits.len() {
        let (before, rest) = edits.split_at_mut(later);
        rest[0] = rest[0].take().and_then(|edit| absorb(before, &edit));
    }
    edits.into_iter().flatten().collect()
}

/// How many edits [`simplify`] counts before it begins.
pub(crate) fn count(edits: &[Edit]) -> usize {
    edits.iter().cloned().map(|edit| edit.split().len()).sum()
}

/// Lights that are dragged, where the edits do nothing else: a request that drags one moves it and gives it a layer of
/// its own.
pub(crate) fn dragged_by(edits: &[Edit]) -> Vec<String> {
    let dragged = |edit: &Edit| match edit {
        Edit::MoveLight { light, own_layer: true, .. } => Some(light.clone()),
        _ => None,
    };
    edits.iter().map(dragged).collect::<Option<_>>().unwrap_or_default()
}

/// Takes out what an edit makes superfluous before it, and answers what is left of the edit itself.
fn absorb(before: &mut [Option<Edit>], edit: &Edit) -> Option<Edit> {
    let mut left = edit.clone();
    let effects = edit.effects();
    if let [Effect::Sets(thing, property)] = effects[..]
        && is_replaced(property)
        && let Some(earlier) = last_setting(before, thing, property)
    {
        before[earlier].take().into_iter().for_each(|earlier| left.take_over(earlier));
    }
    for effect in effects {
        if let Effect::Goes(thing) = effect
            && vanishes(before, thing)
        {
            left = left.without(thing)?;
        }
    }
    Some(left)
}

/// Whether a new value makes the old one as if it had never been. How many groups there are decides which others may
/// be.
fn is_replaced(property: Property<'_>) -> bool {
    match property {
        Property::Transform | Property::Strength => true,
        Property::Albedo | Property::AlbedoOf(_) | Property::Factor | Property::FactorOf(_) => true,
        // Hidden lights keep their names.
        Property::Visibility | Property::Group => false,
    }
}

/// Where a property of a thing was set last, unless its name may have meant something else then.
fn last_setting(before: &[Option<Edit>], thing: Thing<'_>, property: Property<'_>) -> Option<usize> {
    for (at, edit) in before.iter().enumerate().rev() {
        let Some(effects) = edit.as_ref().map(Edit::effects) else { continue };
        if effects == [Effect::Sets(thing, property)] {
            return Some(at);
        }
        if effects.iter().any(|effect| effect.brings_or_takes(thing)) {
            return None;
        }
    }
    None
}

/// A thing goes, by its name: what was done to it before goes too. Where one of the edits before brought it and nothing
/// else, that one goes as well; true then.
fn vanishes(before: &mut [Option<Edit>], thing: Thing<'_>) -> bool {
    if matches!(thing, Thing::Object(pattern) if pattern.contains('*')) {
        return false;
    }
    let may_bring = |edit: &Edit| edit.effects().iter().any(|effect| effect.brings_or_takes(thing));
    let came = before.iter().rposition(|edit| edit.as_ref().is_some_and(may_bring));
    for edit in &mut before[came.map_or(0, |at| at + 1)..] {
        *edit = edit.take().and_then(|edit| edit.without(thing));
    }
    let Some(came) = came else { return false };
    let may_need = |edit: &Edit| edit.effects().iter().any(|effect| effect.may_need(thing));
    if before[came + 1..].iter().flatten().any(may_need) {
        return false;
    }
    // What came with it has names of its own, which other edits may use.
    let is_all = before[came].as_ref().is_some_and(|edit| edit.effects() == [Effect::Comes(thing)]);
    if is_all {
        before[came] = None;
    }
    is_all
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::sync::Arc;

    use glam::{DMat4, DVec3, Vec3};

    use rebake_core::edit::name_matches;
    use rebake_core::scene::{ENVIRONMENT, LightKind};

    use super::super::tests::Dice;
    use super::*;
    use crate::engine::{Relight, Scene};

    /// Albedo of a material, and whether it is painted over.
    type Coat = (Vec3, bool);

    /// What the edits do, as far as they can meddle with each other.
    #[derive(Clone, Debug, Default, PartialEq)]
    struct Model {
        /// Place, wood and steel, and whether it is hidden.
        objects: BTreeMap<String, (DMat4, [Coat; 2], bool)>,
        lights: BTreeMap<String, (Vec3, f32, DVec3, Option<String>)>,
    }

    impl Model {
        /// None where the edit is refused.
        fn apply(mut self, edit: &Edit) -> Option<Model> {
            match edit {
                Edit::Insert { name, transform, .. } => {
                    if self.objects.insert(name.clone(), (*transform, [(Vec3::ONE, false); 2], false)).is_some() {
                        return None;
                    }
                }
                Edit::Remove { objects } => {
                    for pattern in objects {
                        let count = self.objects.len();
                        self.objects.retain(|name, _| !name_matches(pattern, name));
                        if self.objects.len() == count {
                            return None;
                        }
                    }
                }
                Edit::Move { object, transform } => self.objects.get_mut(object)?.0 = *transform,
                Edit::Material { object, albedo } => self.objects.get_mut(object)?.1 = [(*albedo, true); 2],
                Edit::NamedMaterial { object, material, albedo } => {
                    let index = usize::from(material == "steel");
                    match object {
                        Some(object) => self.objects.get_mut(object)?.1[index] = (*albedo, true),
                        None if self.objects.is_empty() => return None,
                        None => self.objects.values_mut().for_each(|object| object.1[index] = (*albedo, true)),
                    }
                }
                Edit::Tint { object, material, factor } => {
                    let which = material.as_deref().map_or(0..2, |material| match material {
                        "steel" => 1..2,
                        _ => 0..1,
                    });
                    let tint = |materials: &mut [Coat; 2]| {
                        materials[which.clone()].iter_mut().for_each(|material| material.0 = *factor);
                    };
                    match object {
                        Some(object) => tint(&mut self.objects.get_mut(object)?.1),
                        None if self.objects.is_empty() => return None,
                        None => self.objects.values_mut().for_each(|object| tint(&mut object.1)),
                    }
                }
                Edit::Hide { objects } | Edit::Show { objects } => {
                    for pattern in objects {
                        let found = self.objects.iter_mut().filter(|(name, _)| name_matches(pattern, name));
                        if found.map(|(_, object)| object.2 = matches!(edit, Edit::Hide { .. })).count() == 0 {
                            return None;
                        }
                    }
                }
                // Tests of their own: states are not made up.
                Edit::Restore(_) => return None,
                Edit::Relight { lights } => {
                    for one in lights {
                        let light = self.lights.get_mut(&one.light)?;
                        (light.0, light.1) = (one.color.unwrap_or(light.0), one.intensity.unwrap_or(light.1));
                    }
                }
                Edit::InsertLight { name, color, intensity, .. } => {
                    if self.lights.insert(name.clone(), (*color, *intensity, DVec3::ZERO, None)).is_some() {
                        return None;
                    }
                }
                Edit::Sky { color, intensity, .. } => {
                    let light = self.lights.entry(ENVIRONMENT.to_owned()).or_default();
                    (light.0, light.1, light.2) = (*color, *intensity, DVec3::ZERO);
                }
                Edit::RemoveLight { light } => {
                    self.lights.remove(light)?;
                }
                Edit::MoveLight { light, position, .. } => {
                    let light = self.lights.get_mut(light)?;
                    light.2 = position.unwrap_or(light.2);
                }
                Edit::GroupLights { group, lights } => {
                    for light in lights {
                        self.lights.get_mut(light)?.3 = group.clone();
                    }
                }
            }
            Some(self)
        }
    }

    fn random_edit(dice: &mut Dice) -> Edit {
        let name = |dice: &mut Dice| ["a", "b", "ab", ENVIRONMENT][dice.roll(4) as usize].to_owned();
        let object = name(dice);
        let number = dice.roll(1000) as f32;
        let transform = DMat4::from_translation(DVec3::splat(f64::from(number)));
        let asset = || Arc::new(Scene::from_objects(Vec::new()));
        let material = ["wood", "steel"][dice.roll(2) as usize].to_owned();
        match dice.roll(18) {
            15 => Edit::Tint { object: Some(object), material: None, factor: Vec3::splat(number) },
            16 => Edit::Tint { object: Some(object), material: Some(material), factor: Vec3::splat(number) },
            17 => Edit::Tint { object: None, material: Some(material), factor: Vec3::splat(number) },
            10 => Edit::Sky { kind: LightKind::Environment, color: Vec3::ONE, intensity: number },
            11 => Edit::Hide { objects: vec![format!("{object}*")] },
            12 => Edit::Show { objects: vec![object] },
            13 => Edit::NamedMaterial { object: Some(object), material, albedo: Vec3::splat(number) },
            14 => Edit::NamedMaterial { object: None, material, albedo: Vec3::splat(number) },
            9 => Edit::GroupLights { group: Some(name(dice)), lights: vec![object] },
            0 => Edit::Insert { asset: asset(), name: object, transform },
            1 => Edit::Remove { objects: vec![object] },
            2 => Edit::Remove { objects: vec![format!("{object}*")] },
            3 => Edit::Move { object, transform },
            4 => Edit::Material { object, albedo: Vec3::splat(number) },
            5 => {
                let (color, intensity) = match dice.roll(3) {
                    0 => (Some(Vec3::splat(number)), None),
                    1 => (None, Some(number)),
                    _ => (Some(Vec3::splat(number)), Some(number)),
                };
                let second = Relight { light: name(dice), color, intensity };
                Edit::Relight { lights: vec![Relight { light: object, color, intensity }, second] }
            }
            6 => {
                let kind = LightKind::Environment;
                Edit::InsertLight { name: object, kind, color: Vec3::ONE, intensity: number }
            }
            7 => Edit::RemoveLight { light: object },
            _ => Edit::MoveLight {
                light: object,
                position: Some(DVec3::splat(f64::from(number))),
                direction: None,
                own_layer: false,
            },
        }
    }

    #[test]
    fn fewer_edits_lead_to_the_same_scene() {
        let (mut saved, mut all) = (0, 0);
        for seed in 0..20_000 {
            let mut dice = Dice(seed);
            let mut model = Model::default();
            let start = loop {
                // Begin with something in the scene.
                if let Some(next) = model.clone().apply(&random_edit(&mut dice)) {
                    model = next;
                }
                if model.objects.len() + model.lights.len() > 2 {
                    break model.clone();
                }
            };
            let mut edits = Vec::new();
            for _ in 0..12 {
                let edit = random_edit(&mut dice);
                if let Some(next) = model.clone().apply(&edit) {
                    model = next;
                    edits.push(edit);
                }
            }
            let fewer = simplify(edits.clone());
            let end = fewer.iter().try_fold(start, |model, edit| model.apply(edit));
            assert_eq!(end, Some(model), "seed {seed}\n{edits:#?}\n{fewer:#?}");
            all += count(&edits);
            saved += count(&edits) - fewer.len();
            assert_eq!(simplify(fewer.clone()).len(), fewer.len(), "it is as short as it gets");
        }
        // Lists of random edits of 18 kinds seldom repeat themselves.
        assert!(saved * 11 > all, "{saved} of {all}");
    }

    /// Edits that are taken back while they wait leave nothing to light.
    #[test]
    fn an_edit_and_its_undo_are_one_that_changes_nothing() {
        use rebake_core::scene::{Material, Mesh, Object};
        use rebake_core::{Restore, World, WorldOptions};
        let cube = |name: &str| Object::new(name, Mesh::cuboid(Vec3::ZERO, Vec3::ONE), Material::diffuse(Vec3::ONE));
        let scene = Scene::from_objects(vec![cube("a")]);
        let options = WorldOptions { spacing: Some(0.5), ..WorldOptions::default() };
        let start = World::new(scene, &options).unwrap();
        let transform = DMat4::from_translation(DVec3::X * 3.0);
        let asset = Arc::new(Scene::from_objects(vec![cube("c")]));
        for edit in [
            Edit::Move { object: "a".into(), transform },
            Edit::Material { object: "a".into(), albedo: Vec3::splat(0.5) },
            Edit::Insert { asset, name: "b".into(), transform },
        ] {
            let done = start.apply(std::slice::from_ref(&edit)).unwrap().after;
            let undo = Edit::Restore(Arc::new(Restore::between(&done.scene, &start.scene)));
            let fewer = simplify([edit.clone(), undo]);
            assert!(fewer.len() < 2, "{edit:?}");
            assert!(fewer.is_empty() || start.apply(&fewer).unwrap().after.is_lit_like(&start), "{edit:?}");
        }
    }
}
