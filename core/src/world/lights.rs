//! Edits of lights that change no geometry: strength, and which share a layer.

use std::collections::BTreeSet;

use glam::Vec3;

use super::apply::Draft;
use super::check::{check_kind, check_name, check_strength, error, invalid};
use crate::edit::{EditError, EditErrorKind, Relight};
use crate::lightmap::MAX_GROUPS;
use crate::scene::{ENVIRONMENT, Light, LightKind};

impl Draft {
    pub(super) fn relight(&mut self, relight: &Relight) -> Result<(), EditError> {
        let index = self.light_index("light", &relight.light)?;
        check_strength(self.allowed, relight.color, relight.intensity)?;
        let light = &mut self.scene_mut().lights[index];
        light.color = relight.color.unwrap_or(light.color);
        light.intensity = relight.intensity.unwrap_or(light.intensity);
        Ok(())
    }

    /// Light from outside takes the place of what there is of it.
    pub(super) fn set_sky(&mut self, kind: &LightKind, color: Vec3, intensity: f32) -> Result<(), EditError> {
        check_strength(self.allowed, Some(color), Some(intensity))?;
        check_kind(self.allowed, self.world.scene.origin, kind)?;
        if !kind.is_from_outside() {
            return Err(invalid("kind", "must be light from outside"));
        }
        let sky = Light { name: ENVIRONMENT.to_owned(), kind: kind.clone(), color, intensity };
        let lights = &mut self.scene_mut().lights;
        match lights.iter_mut().find(|light| light.name == ENVIRONMENT) {
            None => lights.push(sky),
            Some(light) if light.kind.is_from_outside() => *light = sky,
            Some(_) => {
                let reason = format!("a light named {ENVIRONMENT:?} does not shine from outside");
                return Err(error("op", reason, EditErrorKind::Conflict));
            }
        }
        Ok(())
    }

    /// Gives a light that is in no group one of its own, where there is room.
    pub(super) fn set_apart(&mut self, light: &str) {
        let groups = &mut self.scene_mut().groups;
        let names: BTreeSet<&str> = groups.values().map(String::as_str).collect();
        if !groups.contains_key(light) && !names.contains(light) && names.len() < MAX_GROUPS {
            groups.insert(light.to_owned(), light.to_owned());
        }
    }

    pub(super) fn group_lights(&mut self, group: Option<&str>, lights: &[String]) -> Result<(), EditError> {
        group.map_or(Ok(()), |name| check_name(self.allowed, name))?;
        if lights.is_empty() {
            return Err(invalid("lights", "is empty"));
        }
        for (k, light) in lights.iter().enumerate() {
            self.light_index(&format!("lights[{k}]"), light)?;
            match group {
                Some(group) => self.scene_mut().groups.insert(light.clone(), group.to_owned()),
                None => self.scene_mut().groups.remove(light),
            };
        }
        let groups: BTreeSet<&String> = self.world.scene.groups.values().collect();
        if groups.len() > MAX_GROUPS {
            let reason = format!("the scene would have more than {MAX_GROUPS} groups of lights");
            return Err(error("name", reason, EditErrorKind::TooLarge));
        }
        Ok(())
    }
}
