//! The node hierarchy: which nodes are in the scene, where they stand, what they are called.

use ::gltf::json;
use glam::{DMat4, DQuat, DVec3, DVec4};

use super::container::File;
use super::warnings::Warnings;
use super::{LoadError, LoadLimits, malformed};
use crate::scene::NodeSource;

/// A node of the scene.
#[derive(Debug)]
pub(super) struct PlacedNode {
    /// Index into the file's nodes.
    pub(super) index: usize,
    /// Node name, else mesh name, else `node-<index>`; not yet unique.
    pub(super) name: String,
    /// Node space to world space, finite.
    pub(super) world_from_node: DMat4,
    /// The nearest node at or above this one that has a mesh.
    pub(super) object: Option<usize>,
    /// Hidden by itself or by a node above (`KHR_node_visibility`): its mesh and its light do not count.
    pub(super) is_hidden: bool,
}

/// A node that is to be placed, and what it takes from the one above.
#[derive(Clone, Copy)]
struct Waiting {
    index: usize,
    world_from_parent: DMat4,
    depth: usize,
    object: Option<usize>,
    is_hidden: bool,
}

/// How far the last row of a matrix may be off.
const ROUNDING: f64 = 1e-5;
/// Longest `extras.id` that is kept, bytes.
const LONGEST_ID: usize = 256;

/// What an object or a light is told to come from. An `id` is a word or a whole number; anything else in `extras` is not ours.
pub(super) fn source(root: &json::Root, index: usize) -> NodeSource {
    #[derive(serde::Deserialize)]
    struct Extras {
        id: Option<serde_json::Value>,
    }
    let extras = root.nodes[index].extras.as_ref();
    let extras = extras.and_then(|extras| serde_json::from_str::<Extras>(extras.get()).ok());
    let id = match extras.and_then(|extras| extras.id) {
        Some(serde_json::Value::String(id)) => Some(id),
        Some(serde_json::Value::Number(id)) => Some(id.to_string()),
        _ => None,
    };
    let id = id.filter(|id| (1..=LONGEST_ID).contains(&id.len())).map(Into::into);
    NodeSource { index: index as u32, id }
}

/// The nodes of the scene in the order of the file.
pub(super) fn place(
    file: &File<'_>,
    limits: &LoadLimits,
    warnings: &mut Warnings,
) -> Result<Vec<PlacedNode>, LoadError> {
    let root = &file.root;
    let parents = parents(root)?;
    let roots = scene_roots(root, &parents, warnings);
    let mut placed = Vec::new();
    let mut reached = vec![false; root.nodes.len()];
    let first = |index| Waiting { index, world_from_parent: DMat4::IDENTITY, depth: 1, object: None, is_hidden: false };
    let mut stack: Vec<Waiting> = roots.into_iter().map(first).collect();
    while let Some(Waiting { index, world_from_parent, depth, object, is_hidden }) = stack.pop() {
        let name = name_of(root, index);
        let here = || format!("node {index} \"{name}\"");
        if std::mem::replace(&mut reached[index], true) {
            return Err(malformed(&here(), "is in the hierarchy more than once, or among its own ancestors"));
        }
        if depth > limits.max_depth {
            let text = format!("{}: nodes are nested more than {} levels deep", here(), limits.max_depth);
            return Err(LoadError::TooLarge(text));
        }
        let node = &root.nodes[index];
        let world_from_node = world_from_parent * local_transform(node, &here)?;
        if !world_from_node.is_finite() {
            return Err(malformed(&here(), "its transform is not finite"));
        }
        let object = node.mesh.map(|_| index).or(object);
        if !is_hidden && !file.more.is_visible(index) {
            warnings.add("hidden nodes (KHR_node_visibility) are left out with all below them", here());
        }
        let is_hidden = is_hidden || !file.more.is_visible(index);
        let below = |child: &json::Index<json::Node>| Waiting {
            index: child.value(),
            world_from_parent: world_from_node,
            depth: depth + 1,
            object,
            is_hidden,
        };
        stack.extend(node.children.iter().flatten().map(below));
        placed.push(PlacedNode { index, name, world_from_node, object, is_hidden });
    }
    placed.sort_unstable_by_key(|node| node.index);
    Ok(placed)
}

/// Per node its parent. Refuses nodes with several parents and cycles, also outside the scene.
fn parents(root: &json::Root) -> Result<Vec<Option<usize>>, LoadError> {
    let mut parents = vec![None; root.nodes.len()];
    for (index, node) in root.nodes.iter().enumerate() {
        for child in node.children.iter().flatten() {
            let here = format!("node {index}");
            let slot = parents.get_mut(child.value());
            let slot = slot.ok_or_else(|| malformed(&here, &format!("its child {} does not exist", child.value())))?;
            if let Some(other) = slot.replace(index) {
                return Err(malformed(
                    &format!("node {}", child.value()),
                    &format!("is a child of node {other} and again of node {index}"),
                ));
            }
        }
    }
    // With one parent each, the nodes that no root reaches are those on a cycle and below it.
    let mut unreached = root.nodes.len();
    let mut stack: Vec<usize> = (0..parents.len()).filter(|&index| parents[index].is_none()).collect();
    while let Some(index) = stack.pop() {
        unreached -= 1;
        stack.extend(root.nodes[index].children.iter().flatten().map(|child| child.value()));
    }
    if unreached > 0 {
        return Err(LoadError::Malformed(format!("{unreached} nodes are their own ancestors")));
    }
    Ok(parents)
}

/// The default scene, else scene 0, else all nodes without a parent.
fn scene_roots(root: &json::Root, parents: &[Option<usize>], warnings: &mut Warnings) -> Vec<usize> {
    let chosen = root.scene.and_then(|index| root.get(index)).or(root.scenes.first());
    if root.scenes.len() > 1 {
        let which = root.scene.map_or(0, |index| index.value());
        warnings.add("the file has several scenes, one was taken", format!("scene {which}"));
    }
    match chosen {
        Some(scene) if !scene.nodes.is_empty() => scene.nodes.iter().map(|node| node.value()).collect(),
        Some(_) if !root.nodes.is_empty() => {
            warnings.add("the scene is empty: all nodes of the file were taken", "");
            (0..parents.len()).filter(|&index| parents[index].is_none()).collect()
        }
        _ => (0..parents.len()).filter(|&index| parents[index].is_none()).collect(),
    }
}

fn name_of(root: &json::Root, index: usize) -> String {
    let node = &root.nodes[index];
    let mesh_name = || root.get(node.mesh?)?.name.as_deref();
    let given = |name: &&str| !name.trim().is_empty();
    let name = node.name.as_deref().filter(given).or_else(|| mesh_name().filter(given));
    name.map_or_else(|| format!("node-{index}"), str::to_owned)
}

fn local_transform(node: &json::Node, here: &dyn Fn() -> String) -> Result<DMat4, LoadError> {
    if let Some(matrix) = node.matrix {
        let matrix = DMat4::from_cols_array(&matrix.map(f64::from));
        if !matrix.is_finite() {
            return Err(malformed(&here(), "its matrix has a number that is not finite"));
        }
        // Products of matrices, as exporters write them, have it but for rounding.
        let last = matrix.row(3);
        if (last - DVec4::W).abs().max_element() > ROUNDING {
            return Err(malformed(&here(), "the last row of its matrix is not 0 0 0 1"));
        }
        let affine = |column: DVec4, end: f64| column.truncate().extend(end);
        let [x, y, z, w] = [matrix.x_axis, matrix.y_axis, matrix.z_axis, matrix.w_axis];
        return Ok(DMat4::from_cols(affine(x, 0.0), affine(y, 0.0), affine(z, 0.0), affine(w, 1.0)));
    }
    let vector = |values: Option<[f32; 3]>, default| values.map_or(default, |v| DVec3::from_array(v.map(f64::from)));
    let translation = vector(node.translation, DVec3::ZERO);
    let scale = vector(node.scale, DVec3::ONE);
    let rotation = DQuat::from_array(node.rotation.unwrap_or_default().0.map(f64::from));
    if !(translation.is_finite() && scale.is_finite() && rotation.is_finite()) {
        return Err(malformed(&here(), "its translation, rotation or scale has a number that is not finite"));
    }
    let length = rotation.length();
    if !(0.5..2.0).contains(&length) {
        return Err(malformed(&here(), &format!("its rotation is not a unit quaternion, its length is {length}")));
    }
    Ok(DMat4::from_scale_rotation_translation(scale, rotation / length, translation))
}
