//! Fewer edits to the same end: edits that queue up behind each other are lit as one where that gives the same result.
//!
//! Pure functions on lists of edits that were accepted one after the other. Of five moves of one object the last one
//! counts; an object that comes and goes leaves nothing; relights of a light add up to one.

use rebake_core::edit::name_matches;
use rebake_core::scene::LightKind;

use crate::engine::{Edit, Relight};

/// More edits than this are lit one by one: the search is quadratic.
const MAX_EDITS: usize = 1024;

/// An equivalent list, as short as it gets. Relights of several lights count as several edits.
pub(crate) fn simplify(edits: impl IntoIterator<Item = Edit>) -> Vec<Edit> {
    let mut edits: Vec<Option<Edit>> = edits.into_iter().flat_map(split).map(Some).collect();
    if edits.len() <= MAX_EDITS {
        for later in 1..edits.len() {
            absorb(&mut edits, later);
        }
    }
    edits.into_iter().flatten().collect()
}

/// How many edits [`simplify`] counts before it begins.
pub(crate) fn count(edits: &[Edit]) -> usize {
    edits.iter().map(|edit| if let Edit::Relight { lights } = edit { lights.len() } else { 1 }).sum()
}

/// Lights that are dragged, where the edits do nothing else.
pub(crate) fn dragged_by(edits: &[Edit]) -> Vec<String> {
    let dragged = |edit: &Edit| match edit {
        Edit::MoveLight { light, drag: true, .. } => Some(light.clone()),
        _ => None,
    };
    edits.iter().map(dragged).collect::<Option<_>>().unwrap_or_default()
}

fn split(edit: Edit) -> Vec<Edit> {
    match edit {
        Edit::Relight { lights } => lights.into_iter().map(|light| Edit::Relight { lights: vec![light] }).collect(),
        edit => vec![edit],
    }
}

/// Takes out what the edit at `later` makes superfluous before it, and that edit itself where nothing is left of it.
fn absorb(edits: &mut [Option<Edit>], later: usize) {
    let (before, rest) = edits.split_at_mut(later);
    let slot = &mut rest[0];
    match slot {
        Some(Edit::Move { object, .. }) => {
            take_last(before, object, |edit, name| matches!(edit, Edit::Move { object, .. } if object == name));
        }
        Some(Edit::Material { object, .. }) => {
            take_last(before, object, |edit, name| matches!(edit, Edit::Material { object, .. } if object == name));
        }
        Some(Edit::Remove { objects }) => {
            objects.retain(|name| !vanishes(before, name));
            if objects.is_empty() {
                *slot = None;
            }
        }
        Some(Edit::Relight { lights }) => lights.iter_mut().for_each(|light| add_relight(before, light)),
        Some(Edit::MoveLight { light, position, direction, drag }) => {
            if let Some(earlier) = last_of_light(before, light, |edit| matches!(edit, Edit::MoveLight { .. }))
                && let Some(Edit::MoveLight {
                    position: old_position, direction: old_direction, drag: was_dragged, ..
                }) = earlier.take()
            {
                *drag |= was_dragged;
                *position = position.or(old_position);
                *direction = direction.or(old_direction);
            }
        }
        Some(Edit::RemoveLight { light }) => {
            if light_vanishes(before, light) {
                *slot = None;
            }
        }
        Some(Edit::Insert { .. } | Edit::InsertLight { .. } | Edit::GroupLights { .. }) | None => {}
    }
}

/// Drops the last edit that `is_same` says is superseded, unless the name meant something else then.
fn take_last(before: &mut [Option<Edit>], name: &str, is_same: impl Fn(&Edit, &str) -> bool) {
    for slot in before.iter_mut().rev() {
        match slot {
            Some(edit) if is_same(edit, name) => {
                *slot = None;
                return;
            }
            Some(edit) if comes_or_goes(edit, name) => return,
            _ => {}
        }
    }
}

/// Whether an object of that name may come or go by the edit.
fn comes_or_goes(edit: &Edit, object: &str) -> bool {
    match edit {
        Edit::Insert { name, .. } => name == object,
        Edit::Remove { objects } => objects.iter().any(|pattern| name_matches(pattern, object)),
        _ => false,
    }
}

/// An object is removed by name. Where one of the edits before inserted it, that one goes, with all that was done to
/// the object; true then. Else what was done to it goes all the same.
fn vanishes(before: &mut [Option<Edit>], name: &str) -> bool {
    if name.contains('*') {
        return false;
    }
    let of_object =
        |edit: &Edit| matches!(edit, Edit::Move { object, .. } | Edit::Material { object, .. } if object == name);
    let came = before.iter().rposition(|edit| edit.as_ref().is_some_and(|edit| comes_or_goes(edit, name)));
    let first = came.map_or(0, |at| at + 1);
    for slot in &mut before[first..] {
        if slot.as_ref().is_some_and(of_object) {
            *slot = None;
        }
    }
    let Some(came) = came else { return false };
    // Lights that came with it have names of their own that other edits may use.
    let is_plain = matches!(&before[came], Some(Edit::Insert { asset, .. })
        if asset.lights.iter().all(|light| matches!(light.kind, LightKind::Environment)));
    if is_plain {
        before[came] = None;
    }
    is_plain
}

/// The last edit of a light that `is_wanted` says yes to, unless the name may have meant something else then.
fn last_of_light<'a>(
    before: &'a mut [Option<Edit>],
    light: &str,
    is_wanted: impl Fn(&Edit) -> bool,
) -> Option<&'a mut Option<Edit>> {
    for slot in before.iter_mut().rev() {
        let Some(edit) = slot else { continue };
        if names_light(edit, light) && is_wanted(edit) {
            return Some(slot);
        }
        if light_comes_or_goes(edit, light) {
            return None;
        }
    }
    None
}

fn names_light(edit: &Edit, name: &str) -> bool {
    match edit {
        Edit::Relight { lights } => lights.iter().any(|light| light.light == name),
        Edit::MoveLight { light, .. } => light == name,
        _ => false,
    }
}

/// Whether a light of that name may come or go by the edit. Objects take their lights along.
fn light_comes_or_goes(edit: &Edit, light: &str) -> bool {
    match edit {
        Edit::Insert { asset, .. } => !asset.lights.is_empty(),
        Edit::Remove { .. } => true,
        Edit::InsertLight { name, .. } => name == light,
        Edit::RemoveLight { light: removed } => removed == light,
        _ => false,
    }
}

fn add_relight(before: &mut [Option<Edit>], relight: &mut Relight) {
    let Some(earlier) = last_of_light(before, &relight.light, |edit| matches!(edit, Edit::Relight { .. })) else {
        return;
    };
    if let Some(Edit::Relight { lights }) = earlier.take() {
        for old in lights {
            relight.color = relight.color.or(old.color);
            relight.intensity = relight.intensity.or(old.intensity);
        }
    }
}

/// A light is removed. Where one of the edits before inserted it, that one goes with all that was done to the light.
fn light_vanishes(before: &mut [Option<Edit>], light: &str) -> bool {
    let is_end = |edit: &Option<Edit>| edit.as_ref().is_some_and(|edit| light_comes_or_goes(edit, light));
    let Some(came) = before.iter().rposition(is_end) else { return false };
    if !matches!(&before[came], Some(Edit::InsertLight { .. })) {
        return false;
    }
    for slot in &mut before[came..] {
        if let Some(Edit::GroupLights { lights, .. }) = slot {
            lights.retain(|name| name != light);
            if lights.is_empty() {
                *slot = None;
            }
        }
        if slot.as_ref().is_some_and(|edit| names_light(edit, light)) {
            *slot = None;
        }
    }
    before[came] = None;
    true
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::sync::Arc;

    use glam::{DMat4, DVec3, Vec3};

    use super::super::tests::Dice;
    use super::*;
    use crate::engine::Scene;

    /// What the edits do, as far as they can meddle with each other.
    #[derive(Clone, Debug, Default, PartialEq)]
    struct Model {
        objects: BTreeMap<String, (DMat4, Vec3)>,
        lights: BTreeMap<String, (Vec3, f32, DVec3, Option<String>)>,
    }

    impl Model {
        /// None where the edit is refused.
        fn apply(mut self, edit: &Edit) -> Option<Model> {
            match edit {
                Edit::Insert { name, transform, .. } => {
                    if self.objects.insert(name.clone(), (*transform, Vec3::ONE)).is_some() {
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
                Edit::Material { object, albedo } => self.objects.get_mut(object)?.1 = *albedo,
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
        let name = |dice: &mut Dice| ["a", "b", "ab"][dice.roll(3) as usize].to_owned();
        let object = name(dice);
        let number = dice.roll(1000) as f32;
        let transform = DMat4::from_translation(DVec3::splat(f64::from(number)));
        let asset = || Arc::new(Scene::from_objects(Vec::new()));
        match dice.roll(10) {
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
                drag: false,
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
        assert!(saved * 10 > all, "{saved} of {all}");
    }
}
