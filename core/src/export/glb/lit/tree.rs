//! Nodes: the hierarchy of the upload as edits have left it, and what they brought.

use std::collections::{BTreeMap, BTreeSet};

use ::gltf::json::Value;
use glam::{DMat4, DQuat, DVec3};
use serde_json::Map;

use super::super::container::{object, push};
use super::super::scene::{add_camera, frame_of, light_json};
use super::Writer;
use super::stand::{Stand, is_valid};
use crate::export::ExportError;
use crate::scene::{Light, LightKind, Original};

/// How far a light may lie from its node without being apart from it, relative, and its direction.
const NEAR: f64 = 1e-5;

/// What is below a node of a file, and whether it is still there.
struct Tree<'a> {
    file: &'a Original,
    children: Vec<Vec<usize>>,
    /// Parents before what is below them.
    order: Vec<usize>,
    /// Per node the objects of the scene that it is.
    objects: Vec<Vec<usize>>,
    /// Per node its light.
    lights: Vec<Option<&'a Light>>,
    /// Per node: it is written.
    is_kept: Vec<bool>,
}

/// Adds all nodes, with their meshes, lights and cameras.
pub(super) fn write(writer: &mut Writer<'_>) -> Result<(), ExportError> {
    let nothing = Original::default();
    let (world, originals) = (writer.export.world, writer.export.originals);
    let file = originals.scene.as_ref().unwrap_or(&nothing);
    let tree = Tree::new(writer, file);
    let mut left: BTreeSet<&str> = world.scene.lights.iter().map(|light| light.name.as_str()).collect();
    let mut roots: Vec<Value> = Vec::new();
    tree.write(writer, &mut left, &mut roots)?;
    let from_file: BTreeSet<usize> = tree.objects.iter().flatten().copied().collect();
    for (index, item) in world.scene.objects.iter().enumerate() {
        if !item.is_hidden && !from_file.contains(&index) {
            let node = add_object(writer, index, DMat4::IDENTITY, &mut left)?;
            roots.push(node);
        }
    }
    for light in world.scene.lights.iter().filter(|light| left.contains(light.name.as_str())) {
        roots.extend(add_light(writer, light, DMat4::IDENTITY)?);
    }
    if originals.scene.is_none() {
        for camera in &world.scene.cameras {
            roots.push(add_camera(&mut writer.document, camera)?);
        }
    }
    let name = file.scene_name.as_ref().map(|name| ("name", name.as_str().into()));
    let nodes = (!roots.is_empty()).then(|| ("nodes", roots.into()));
    writer.document.scenes.push(object(name.into_iter().chain(nodes)));
    Ok(())
}

/// An object as a node of its own, with the lights that hang on it.
fn add_object(
    writer: &mut Writer<'_>,
    index: usize,
    parent: DMat4,
    left: &mut BTreeSet<&str>,
) -> Result<Value, ExportError> {
    let scene = &writer.export.world.scene;
    let item = &scene.objects[index];
    let stand =
        Stand::below(parent, item.world_from_object).ok_or_else(|| ExportError::NotFinite(item.name.clone()))?;
    let mesh = writer.add_mesh(index, &stand)?;
    let mut node = vec![("name", item.name.as_str().into())];
    node.extend(mesh.map(|mesh| ("mesh", mesh)));
    node.extend(stand.json.iter().cloned());
    node.push(("extras", object([("light_map", writer.place(index))])));
    let mut children = Vec::new();
    if item.node.is_none() {
        let hangs = |light: &&Light| scene.light_parents.get(&light.name) == Some(&item.name);
        for light in scene.lights.iter().filter(hangs) {
            if left.remove(light.name.as_str()) {
                children.extend(add_light(writer, light, stand.world_from_node)?);
            }
        }
    }
    node.extend((!children.is_empty()).then(|| ("children", children.into())));
    Ok(push(&mut writer.document.nodes, object(node)))
}

/// A light as a node of its own; none for what has no place in glTF.
fn add_light(writer: &mut Writer<'_>, light: &Light, parent: DMat4) -> Result<Option<Value>, ExportError> {
    let (Some(json), Some(frame)) = (light_json(light), frame_of(light)) else { return Ok(None) };
    let stand = Stand::below(parent, frame).ok_or_else(|| ExportError::NotFinite(light.name.clone()))?;
    let index = push(&mut writer.document.lights, json);
    let node = [("name", light.name.as_str().into()), ("extensions", punctual(index))];
    Ok(Some(push(&mut writer.document.nodes, object(node.into_iter().chain(stand.json)))))
}

fn punctual(light: Value) -> Value {
    object([("KHR_lights_punctual", object([("light", light)]))])
}

impl<'a> Tree<'a> {
    fn new<'w: 'a>(writer: &Writer<'w>, file: &'a Original) -> Tree<'a> {
        let scene = &writer.export.world.scene;
        let place = |index: u32| file.nodes.binary_search_by_key(&(index as usize), |node| node.index).ok();
        let mut objects = vec![Vec::new(); file.nodes.len()];
        for (index, item) in scene.objects.iter().enumerate().filter(|(_, item)| !item.is_hidden) {
            if let Some(place) = item.node.as_ref().and_then(|source| place(source.index)) {
                objects[place].push(index);
            }
        }
        let mut lights = vec![None; file.nodes.len()];
        for light in scene.lights.iter().filter(|light| frame_of(light).is_some()) {
            if let Some(place) = scene.light_nodes.get(&light.name).and_then(|source| place(source.index)) {
                lights[place] = Some(light);
            }
        }
        let mut children = vec![Vec::new(); file.nodes.len()];
        for (place, node) in file.nodes.iter().enumerate() {
            node.parent.into_iter().for_each(|parent| children[parent].push(place));
        }
        let mut stack: Vec<usize> = (0..file.nodes.len()).filter(|&k| file.nodes[k].parent.is_none()).collect();
        let mut order = Vec::with_capacity(file.nodes.len());
        while let Some(place) = stack.pop() {
            order.push(place);
            stack.extend(&children[place]);
        }
        let is_kept = vec![false; file.nodes.len()];
        let mut tree = Tree { file, children, order, objects, lights, is_kept };
        tree.keep();
        tree
    }

    /// Nodes stay that are something, or have something below them; and those that were nothing all along.
    fn keep(&mut self) {
        for &place in self.order.iter().rev() {
            let (node, json) = (&self.file.nodes[place], self.file.nodes[place].json());
            let was_something = ["mesh", "camera"].iter().any(|key| json.contains_key(*key)) || has_light(&json);
            let is_something = !self.objects[place].is_empty()
                || self.lights[place].is_some()
                || json.contains_key("camera")
                || self.children[place].iter().any(|&below| self.is_kept[below]);
            let is_marker = !was_something && self.children[place].is_empty() && !node.is_hidden;
            self.is_kept[place] = is_something || is_marker;
        }
    }

    /// Adds the nodes that stay, in the order of the file. Lights that go with them are taken from `left`.
    fn write(
        &self,
        writer: &mut Writer<'_>,
        left: &mut BTreeSet<&str>,
        roots: &mut Vec<Value>,
    ) -> Result<(), ExportError> {
        let first = writer.document.nodes.len();
        let mut written: Vec<Option<usize>> = vec![None; self.is_kept.len()];
        let kept: Vec<usize> = (0..self.is_kept.len()).filter(|&place| self.is_kept[place]).collect();
        kept.iter().enumerate().for_each(|(count, &place)| written[place] = Some(first + count));
        writer.document.nodes.resize(first + kept.len(), Value::Null);
        let stands = self.stands(writer);
        let mut cameras = BTreeMap::new();
        for &place in &kept {
            let node = &self.file.nodes[place];
            let (stand, is_as_it_was) = &stands[place];
            let mut json = node.json();
            let was = std::mem::take(&mut json);
            let transform = ["matrix", "translation", "rotation", "scale"];
            let stays = |key: &str| ["name", "extras"].contains(&key) || *is_as_it_was && transform.contains(&key);
            json.extend(was.iter().filter(|(key, _)| stays(key)).map(|(key, value)| (key.clone(), value.clone())));
            if !is_as_it_was {
                json.extend(stand.json.iter().map(|(key, value)| ((*key).to_owned(), value.clone())));
            }
            let below = self.children[place].iter().filter_map(|&below| written[below]);
            let mut children: Vec<Value> = below.map(Value::from).collect();
            self.add_objects(writer, place, stand, &mut json, &mut children, left)?;
            if let Some(index) = was.get("camera").and_then(Value::as_u64)
                && let Some(camera) = self.file.lists.cameras.get(index as usize)
            {
                let add = || push(&mut writer.document.cameras, camera.clone());
                json.insert("camera".to_owned(), cameras.entry(index).or_insert_with(add).clone());
            }
            if let Some(light) = self.lights[place].filter(|light| is_at(light, &stand.world_from_node))
                && let Some(light_map) = light_json(light)
            {
                left.remove(light.name.as_str());
                let index = push(&mut writer.document.lights, light_map);
                json.insert("extensions".to_owned(), punctual(index));
            }
            if !children.is_empty() {
                json.insert("children".to_owned(), children.into());
            }
            let index = written[place].unwrap_or_default();
            writer.document.nodes[index] = json.into();
            let is_root = node.parent.is_none_or(|parent| written[parent].is_none());
            roots.extend(is_root.then(|| Value::from(index)));
        }
        Ok(())
    }

    /// The objects that a node is: itself, or nodes below it where they are instances.
    fn add_objects(
        &self,
        writer: &mut Writer<'_>,
        place: usize,
        stand: &Stand,
        json: &mut Map<String, Value>,
        children: &mut Vec<Value>,
        left: &mut BTreeSet<&str>,
    ) -> Result<(), ExportError> {
        let objects = &self.objects[place];
        if self.file.nodes[place].is_instanced {
            for &index in objects {
                children.push(add_object(writer, index, stand.world_from_node, left)?);
            }
            return Ok(());
        }
        let Some(&index) = objects.first() else { return Ok(()) };
        let name = &writer.export.world.scene.objects[index].name;
        let is_named = json.get("name").and_then(Value::as_str).is_some_and(|name| !name.trim().is_empty());
        if !is_named {
            json.insert("name".to_owned(), name.as_str().into());
        }
        if let Some(mesh) = writer.add_mesh(index, stand)? {
            json.insert("mesh".to_owned(), mesh);
        }
        let light_map = writer.place(index);
        if let Value::Object(extras) = json.entry("extras".to_owned()).or_insert_with(|| object([])) {
            extras.insert("light_map".to_owned(), light_map);
        }
        Ok(())
    }

    /// Where each node stands, and whether that is as the file says.
    fn stands(&self, writer: &Writer<'_>) -> Vec<(Stand, bool)> {
        let mut stands: Vec<Option<(Stand, bool)>> = self.file.nodes.iter().map(|_| None).collect();
        for &place in &self.order {
            let node = &self.file.nodes[place];
            let parent = node.parent.and_then(|parent| stands[parent].as_ref());
            let (above, is_above_as_it_was) =
                parent.map_or((DMat4::IDENTITY, true), |(s, was)| (s.world_from_node, *was));
            let json = node.json();
            let target = self.target(writer, place, &json, above);
            let as_it_was = || Stand { world_from_node: node.world_from_node, baked: None, json: Vec::new() };
            let is_as_it_was = is_above_as_it_was && target == node.world_from_node && is_valid(&json);
            let stand = match is_as_it_was {
                true => None,
                false => Stand::below(above, target),
            };
            stands[place] = Some(stand.map_or_else(|| (as_it_was(), true), |stand| (stand, false)));
        }
        stands.into_iter().flatten().collect()
    }

    /// Where a node is to stand, in the world. What is neither an object nor a camera nor a light that has moved goes
    /// with the node above.
    fn target(&self, writer: &Writer<'_>, place: usize, json: &Map<String, Value>, above: DMat4) -> DMat4 {
        let node = &self.file.nodes[place];
        if let (false, Some(&index)) = (node.is_instanced, self.objects[place].first()) {
            return writer.export.world.scene.objects[index].world_from_object;
        }
        if json.contains_key("camera") {
            return node.world_from_node;
        }
        let of_file = node.parent.map_or(DMat4::IDENTITY, |parent| self.file.nodes[parent].world_from_node);
        let along =
            if above == of_file { node.world_from_node } else { above * (of_file.inverse() * node.world_from_node) };
        match self.lights[place] {
            Some(light) if self.children[place].is_empty() && !is_at(light, &along) => moved(light, along),
            _ => along,
        }
    }
}

fn has_light(json: &Map<String, Value>) -> bool {
    json.get("extensions").is_some_and(|extensions| extensions.get("KHR_lights_punctual").is_some())
}

/// Whether a light is where a node is, and shines along its −z axis.
fn is_at(light: &Light, world_from_node: &DMat4) -> bool {
    let is_near = |position: DVec3| {
        let at = world_from_node.w_axis.truncate();
        at.distance(position) <= NEAR * position.length().max(1.0)
    };
    let is_along = |direction: glam::Vec3| {
        let along = world_from_node.transform_vector3(DVec3::NEG_Z).normalize_or_zero();
        along.distance(direction.as_dvec3().normalize_or_zero()) <= NEAR
    };
    match light.kind {
        LightKind::Point { position, .. } => is_near(position),
        LightKind::Spot { position, direction, .. } => is_near(position) && is_along(direction),
        LightKind::Directional { direction, .. } => is_along(direction),
        LightKind::Emissive { .. } | LightKind::Environment | LightKind::Sky { .. } => false,
    }
}

/// Where the node of a light goes with it: what the light does not say stays.
fn moved(light: &Light, from: DMat4) -> DMat4 {
    let turn =
        |direction: glam::Vec3| DQuat::from_rotation_arc(DVec3::NEG_Z, direction.as_dvec3().normalize_or(DVec3::NEG_Z));
    let at = from.w_axis.truncate();
    match light.kind {
        LightKind::Point { position, .. } => DMat4::from_translation(position - at) * from,
        LightKind::Spot { position, direction, .. } => DMat4::from_rotation_translation(turn(direction), position),
        LightKind::Directional { direction, .. } => DMat4::from_rotation_translation(turn(direction), at),
        LightKind::Emissive { .. } | LightKind::Environment | LightKind::Sky { .. } => from,
    }
}
