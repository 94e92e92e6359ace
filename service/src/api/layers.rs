//! Layers, as clients ask for them and see them.

use std::collections::{BTreeMap, BTreeSet};

use rebake_core::allowed::Allowed;
use rebake_core::edit::{Effect, Property, Thing};
use serde::Deserialize;

use super::checks::check_group;
use super::problem::{ApiResult, Kind, Problem};
use super::types;
use super::uploads::memory_problem;
use crate::engine::{Edit, MAX_GROUPS, SHARED_LAYER, SIDE_BY_SIDE, Scene, World};
use crate::memory::Promise;
use crate::state::App;
use crate::store::layers::{LAYER_BYTES, PublishedLayer};
use crate::store::scene::SceneEntry;
use crate::store::versions::{LightPart, Published};

/// The layers that an upload asks for.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) enum Wanted {
    /// One of all lights, until somebody relights or groups some.
    #[default]
    Shared,
    /// One per light.
    Each,
    /// Names of layers with those of their lights.
    Groups(BTreeMap<String, Vec<String>>),
}

impl Wanted {
    /// Reads the query parameter `layers`.
    pub(super) fn parse(text: &str) -> ApiResult<Wanted> {
        match text {
            "shared" => return Ok(Wanted::Shared),
            "each" => return Ok(Wanted::Each),
            _ => {}
        }
        let read = |error: serde_json::Error| {
            let example = r#"{"ceiling": ["lamp-1"]}"#;
            refused(format!("has to be `shared`, `each` or a JSON object of lists of lights, as {example}: {error}"))
        };
        let Groups(groups) = serde_json::from_str(text).map_err(read)?;
        if groups.len() > MAX_GROUPS {
            return Err(refused(format!(
                "names {} layers, a scene has at most {MAX_GROUPS} beside the shared one",
                groups.len()
            )));
        }
        for (name, lights) in &groups {
            check_group(Allowed::ASKED, name, "layers")?;
            if lights.is_empty() {
                return Err(refused(format!("{name:?} names no light")));
            }
        }
        Ok(Wanted::Groups(groups))
    }

    /// Names of lights with those of their layers.
    pub(super) fn groups(&self, scene: &Scene) -> ApiResult<BTreeMap<String, String>> {
        let lists = match self {
            Wanted::Shared => return Ok(BTreeMap::new()),
            Wanted::Groups(lists) => lists,
            Wanted::Each if scene.lights.len() > MAX_GROUPS => {
                let count = scene.lights.len();
                let reason = format!(
                    "the scene has {count} lights, at most {MAX_GROUPS} can have layers of their own: group them, as {}",
                    r#"layers={"ceiling": ["lamp-1", "lamp-2"]}"#
                );
                return Err(refused(reason));
            }
            Wanted::Each => {
                let own = |light: &rebake_core::scene::Light| (light.name.clone(), light.name.clone());
                return Ok(scene.lights.iter().map(own).collect());
            }
        };
        let known: BTreeSet<&str> = scene.lights.iter().map(|light| light.name.as_str()).collect();
        let mut groups = BTreeMap::new();
        for (name, lights) in lists {
            for light in lights {
                if !known.contains(light.as_str()) {
                    let reason = format!("the scene has no light {light:?}");
                    return Err(Problem::field(Kind::UnknownLight, "layers", reason));
                }
                if groups.insert(light.clone(), name.clone()).is_some() {
                    return Err(refused(format!("names the light {light:?} twice")));
                }
            }
        }
        Ok(groups)
    }
}

/// Layers that a bake of so grouped lights keeps light of at a place, at most.
pub(super) fn count(scene: &Scene, groups: &BTreeMap<String, String>) -> usize {
    let names: BTreeSet<&String> = groups.values().collect();
    let shares = !groups.is_empty() && scene.lights.iter().any(|light| !groups.contains_key(&light.name));
    at_a_place(names.len() + usize::from(shares))
}

/// An object in which no name comes twice.
struct Groups(BTreeMap<String, Vec<String>>);

impl<'de> Deserialize<'de> for Groups {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Groups, D::Error> {
        struct Visitor;
        impl<'de> serde::de::Visitor<'de> for Visitor {
            type Value = Groups;

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("an object of lists of lights")
            }

            fn visit_map<A: serde::de::MapAccess<'de>>(self, mut map: A) -> Result<Groups, A::Error> {
                let mut groups = BTreeMap::new();
                while let Some((name, lights)) = map.next_entry::<String, Vec<String>>()? {
                    if groups.contains_key(&name) {
                        return Err(serde::de::Error::custom(format!("{name:?} comes twice")));
                    }
                    groups.insert(name, lights);
                }
                Ok(Groups(groups))
            }
        }
        deserializer.deserialize_map(Visitor)
    }
}

fn refused(reason: String) -> Problem {
    Problem::field(Kind::InvalidQuery, "layers", reason)
}

/// What a client asks for of a light map.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Chosen {
    /// A part of all light.
    Part(LightPart),
    /// One layer, by its name.
    Layer(String),
    /// Every layer.
    All,
}

/// Reads the query parameter `layer`. Words for parts come before names; a name between double quotes is always one.
pub(super) fn choose(published: &Published, text: &str) -> ApiResult<Chosen> {
    match text {
        "full" => Ok(Chosen::Part(LightPart::Full)),
        "direct" => Ok(Chosen::Part(LightPart::Direct)),
        "indirect" => Ok(Chosen::Part(LightPart::Indirect)),
        "all" => Ok(Chosen::All),
        _ => find(published, text).map(Chosen::Layer),
    }
}

/// The name of a layer of the map.
pub(super) fn find(published: &Published, text: &str) -> ApiResult<String> {
    let quoted = text.strip_prefix('"').and_then(|text| text.strip_suffix('"'));
    let found = [Some(text), quoted].into_iter().flatten().find(|name| published.layer(name).is_some());
    found.map(str::to_owned).ok_or_else(|| {
        let names: Vec<String> = published.layers.iter().map(|layer| format!("{:?}", layer.layer.name)).collect();
        let known = match names.is_empty() {
            true => "it has none before a light is relit or lights are grouped".to_owned(),
            false => format!("it has {}", names.join(", ")),
        };
        Problem::field(Kind::InvalidQuery, "layer", format!("the light map has no layer {text:?}; {known}"))
    })
}

/// A layer, as a scene tells it.
pub(super) fn describe(layer: &PublishedLayer) -> types::SceneLayer {
    let light = |light: &rebake_core::layers::LayerLight| types::SceneLayerLight {
        name: light.name.clone(),
        reference: light.reference.to_array(),
    };
    types::SceneLayer {
        name: layer.layer.name.clone(),
        weight: layer.weight.to_array(),
        lights: layer.layer.lights.iter().map(light).collect(),
        memory_bytes: layer.memory_bytes() as u64,
    }
}

/// The layers with their weights and lights, for the header of a picture.
pub(super) fn to_json(published: &Published) -> String {
    types::to_event_data(&published.layers.iter().map(describe).collect::<Vec<_>>()).to_string()
}

/// Memory for the layers of a scene with more edits.
pub(super) struct Room<'a> {
    /// Bytes of all layers, once the edits are lit.
    pub(super) expected: u64,
    _promise: Promise<'a>,
}

/// Memory for the layers that edits may add to a scene.
pub(super) fn room_for<'a>(app: &'a App, scene: &SceneEntry, after: &World, edits: &[Edit]) -> ApiResult<Room<'a>> {
    let published = scene.published();
    let count = expected(scene, &published, &after.scene, edits);
    let expected = (count * LAYER_BYTES * after.slots()) as u64;
    let to_come = scene.layers_to_come(&published);
    let more = expected.saturating_sub(published.layer_bytes() as u64 + to_come);
    let present = scene.accepted().bytes + published.memory_bytes() as u64 + to_come;
    let promise = app.memory.promise(more, present);
    Ok(Room { expected, _promise: promise.map_err(|full| memory_problem("scene with its layers", full))? })
}

/// Layers that the map will have at a place, at most, once all that was accepted and `edits` are lit.
fn expected(scene: &SceneEntry, published: &Published, after: &Scene, edits: &[Edit]) -> usize {
    let mut names: BTreeSet<&str> = published.layers.iter().map(|layer| layer.layer.name.as_str()).collect();
    names.extend(after.groups.values().map(String::as_str));
    let waiting = scene.unlit_edits();
    let all = || waiting.iter().flat_map(|(_, edits)| edits.iter()).chain(edits);
    let is_alone = |light: &str| published.map.layer_of(light).is_some_and(|layer| layer.lights.len() == 1);
    let effects = || all().flat_map(Edit::effects);
    let relit = effects().filter_map(|effect| match effect {
        Effect::Sets(Thing::Light(light), Property::Strength) => Some(light),
        Effect::Sets(..) | Effect::Comes(_) | Effect::Goes(_) | Effect::LightsComeOrGo => None,
    });
    names.extend(relit.filter(|light| !is_alone(light) && !after.groups.contains_key(*light)));
    if names.is_empty() {
        return 0;
    }
    names.extend(effects().filter_map(|effect| match effect {
        Effect::Comes(Thing::Light(light)) => Some(light),
        Effect::Comes(Thing::Object(_) | Thing::Material(_))
        | Effect::Goes(_)
        | Effect::LightsComeOrGo
        | Effect::Sets(..) => None,
    }));
    if published.layers.is_empty() && after.lights.len() > names.len() {
        names.insert(SHARED_LAYER);
    }
    at_a_place(names.len())
}

/// Of so many layers, those that light is kept of at a place, at most.
fn at_a_place(layers: usize) -> usize {
    // Of direct and of indirect light as many as are carried side by side, and the rest.
    layers.min(2 * SIDE_BY_SIDE + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layers_of_an_upload_are_words_or_an_object() {
        let parse = |text: &str| Wanted::parse(text).map_err(|problem| problem.to_string());
        assert_eq!((parse("shared"), parse("each")), (Ok(Wanted::Shared), Ok(Wanted::Each)));
        let Ok(Wanted::Groups(groups)) = parse(r#"{"ceiling": ["a", "b"]}"#) else { panic!() };
        assert_eq!(groups["ceiling"], ["a", "b"]);
        let many: Vec<String> = (0..=MAX_GROUPS).map(|i| format!("\"{i}\": [\"a\"]")).collect();
        let many = format!("{{{}}}", many.join(","));
        for text in [
            "",
            "all",
            "[]",
            r#"{"a": []}"#,
            r#"{"a": [1]}"#,
            r#"{"": ["a"]}"#,
            r#"{"shared": ["a"]}"#,
            r#"{"a": ["b"], "a": ["c"]}"#,
            &many,
        ] {
            assert!(parse(text).unwrap_err().starts_with("layers: "), "{text}");
        }
    }
}
