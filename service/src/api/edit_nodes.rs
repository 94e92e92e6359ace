//! Objects and lights of edits that are named by the node of the file, or by the `extras.id` of it, in place of a name:
//! `{"node": 3}`, `{"id": "b7c1"}`. They are turned into names where an edit is accepted, and are kept as such: nodes do
//! not change, and no name does.

use std::collections::HashMap;

use bytes::Bytes;
use rebake_core::scene::{Light, LightKind};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;

use super::edit_names::MAX_NAMES;
use super::problem::{ApiResult, Kind, Problem};
use crate::engine::{NodeSource, Scene};

/// An object or a light of a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(untagged)]
pub(super) enum Reference {
    /// Its name.
    #[schema(example = "lamp")]
    Name(String),
    /// The node of the file that it is, where no other is the same node.
    Node(NodeReference),
    /// The `extras.id` of that node.
    Id(IdReference),
}

/// A node of the scene's file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct NodeReference {
    /// Index in the file's list of nodes.
    pub node: u32,
}

/// A node of the scene's file, by what the program that wrote it knows it by.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct IdReference {
    /// `extras.id` of the node.
    pub id: String,
}

/// What is named.
#[derive(Clone, Copy)]
enum Thing {
    Object,
    Light,
}

/// Fields of edits that hold a reference or a list of them.
const FIELDS: [(&str, Thing); 4] =
    [("object", Thing::Object), ("objects", Thing::Object), ("light", Thing::Light), ("lights", Thing::Light)];

/// The body of an edit request with names alone. What is no edit request stays as it is: reading it says why.
pub(super) fn with_names(body: &Bytes, scene: &Scene) -> ApiResult<Bytes> {
    let mentions = |key: &[u8]| body.windows(key.len()).any(|bytes| bytes == key);
    if !mentions(b"\"node\"") && !mentions(b"\"id\"") {
        return Ok(body.clone());
    }
    let Ok(Value::Object(mut fields)) = serde_json::from_slice::<Value>(body) else { return Ok(body.clone()) };
    let mut names = Names::new(scene);
    names.of_edit(&mut fields, "")?;
    if let Some(Value::Array(edits)) = fields.get_mut("edits") {
        for (index, edit) in edits.iter_mut().enumerate() {
            if let Value::Object(edit) = edit {
                names.of_edit(edit, &format!("edits[{index}]."))?;
            }
        }
    }
    if names.found == 0 {
        return Ok(body.clone());
    }
    serde_json::to_vec(&fields).map(Bytes::from).map_err(Problem::internal)
}

/// Names with the nodes that they are.
type Nodes<'s> = Vec<(&'s NodeSource, &'s str)>;

struct Names<'s> {
    objects: Nodes<'s>,
    lights: Nodes<'s>,
    /// References that were turned into names.
    found: usize,
}

impl<'s> Names<'s> {
    fn new(scene: &'s Scene) -> Names<'s> {
        let objects: Nodes<'s> =
            scene.objects.iter().filter_map(|object| Some((object.node.as_ref()?, object.name.as_str()))).collect();
        let by_name: HashMap<&str, &NodeSource> = objects.iter().map(|(node, name)| (*name, *node)).collect();
        let of_light = |light: &'s Light| match &light.kind {
            LightKind::Emissive { object, .. } => by_name.get(object.as_str()).copied(),
            _ => scene.light_nodes.get(&light.name),
        };
        let lights = scene.lights.iter().filter_map(|light| Some((of_light(light)?, light.name.as_str()))).collect();
        Names { objects, lights, found: 0 }
    }

    fn of_edit(&mut self, edit: &mut Map<String, Value>, path: &str) -> ApiResult<()> {
        // Its `light` is what the new light is.
        let is_new = edit.get("op").is_some_and(|op| op == "insert_light");
        for (field, thing) in FIELDS.into_iter().filter(|_| !is_new) {
            let place = format!("{path}{field}");
            match edit.get_mut(field) {
                Some(Value::Array(list)) => {
                    for (index, one) in list.iter_mut().enumerate() {
                        let place = format!("{place}[{index}]");
                        // `relight` has the light among what it becomes.
                        match one.get_mut("light") {
                            Some(light) => self.of_value(light, thing, &format!("{place}.light"))?,
                            None => self.of_value(one, thing, &place)?,
                        }
                    }
                }
                Some(one) => self.of_value(one, thing, &place)?,
                None => {}
            }
        }
        Ok(())
    }

    fn of_value(&mut self, value: &mut Value, thing: Thing, place: &str) -> ApiResult<()> {
        if !value.is_object() {
            return Ok(());
        }
        let about =
            "has to be a name, {\"node\": 3} with a node of the file, or {\"id\": \"…\"} with the extras.id of one";
        let reference =
            Reference::deserialize(&*value).map_err(|_| Problem::field(Kind::InvalidValue, place, about))?;
        self.found += 1;
        if self.found > MAX_NAMES {
            let reason = format!("a request may hold {MAX_NAMES} references to nodes");
            return Err(Problem::field(Kind::InvalidValue, place, reason));
        }
        *value = Value::String(self.name_of(&reference, thing, place)?);
        Ok(())
    }

    fn name_of(&self, reference: &Reference, thing: Thing, place: &str) -> ApiResult<String> {
        let is_meant = |node: &NodeSource| match reference {
            Reference::Name(_) => false,
            Reference::Node(NodeReference { node: index }) => node.index == *index,
            Reference::Id(IdReference { id }) => node.id.as_deref() == Some(id),
        };
        let all = match thing {
            Thing::Object => &self.objects,
            Thing::Light => &self.lights,
        };
        let names: Vec<&str> = all.iter().filter(|(node, _)| is_meant(node)).map(|(_, name)| *name).collect();
        let (kind, things) = match thing {
            Thing::Object => (Kind::UnknownObject, "objects"),
            Thing::Light => (Kind::UnknownLight, "lights"),
        };
        match names[..] {
            [name] => Ok(name.to_owned()),
            [] => Err(Problem::field(kind, place, "the scene has nothing that is this node")),
            [first, second, ..] => {
                let reason =
                    format!("{} {things} are this node, {first:?} and {second:?} among them: give a name", names.len());
                Err(Problem::field(Kind::InvalidValue, place, reason))
            }
        }
    }
}
