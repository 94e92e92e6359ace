//! Morph targets and skins in the pose that the file puts them in (glTF 2.0, 3.7.2.2 and 3.7.3.3).

use ::gltf::json;
use glam::{DMat3, DMat4, DVec3};
use json::mesh::Primitive;

use super::accessor::{Most, read_matrices, read_vec3, require_finite};
use super::attributes::Attributes;
use super::container::File;
use super::nodes::PlacedNode;
use super::warnings::Warnings;
use super::{LoadError, malformed};

/// Sets of four influences that are read: more than any exporter writes.
const MAX_SETS: u32 = 4;

/// How a node bends its mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Pose {
    /// Weights of the morph targets; absent ones count 0.
    pub(super) morph: Vec<f32>,
    /// Per joint of the skin: the mesh's space to the node's. Empty without a skin.
    joints: Vec<DMat4>,
}

/// The vertices of a primitive that a pose moves; normals may be empty.
pub(super) struct Vertices {
    pub(super) positions: Vec<[f32; 3]>,
    pub(super) normals: Vec<[f32; 3]>,
}

/// The pose of a node. A skinned mesh ignores the transform of its node; so that edits find the node where it stands,
/// it is expressed in that transform all the same.
pub(super) fn of_node(
    file: &File<'_>,
    node: &PlacedNode,
    nodes: &[PlacedNode],
    warnings: &mut Warnings,
) -> Result<Pose, LoadError> {
    let json = &file.root.nodes[node.index];
    let of_mesh = || json.mesh.and_then(|mesh| file.root.get(mesh)?.weights.clone());
    let morph = json.weights.clone().or_else(of_mesh).unwrap_or_default();
    if morph.iter().any(|weight| !weight.is_finite()) {
        return Err(malformed(&format!("node {} \"{}\"", node.index, node.name), "a morph weight is not finite"));
    }
    let joints = match json.skin {
        Some(skin) => joints(file, skin, node, nodes, warnings)?,
        None => Vec::new(),
    };
    Ok(Pose { morph, joints })
}

fn joints(
    file: &File<'_>,
    skin: json::Index<json::Skin>,
    node: &PlacedNode,
    nodes: &[PlacedNode],
    warnings: &mut Warnings,
) -> Result<Vec<DMat4>, LoadError> {
    let place = format!("skin {}", skin.value());
    let json = file.root.get(skin).ok_or_else(|| malformed(&place, "does not exist"))?;
    let inverse_bind = match json.inverse_bind_matrices {
        Some(index) => {
            let most = json.joints.len().max(1 << 16);
            read_matrices(file, index, Most { count: most, of: ("inverse bind matrices", most) }, &place)?
        }
        None => Vec::new(),
    };
    if !inverse_bind.is_empty() && inverse_bind.len() < json.joints.len() {
        let text = format!("has {} joints but {} inverse bind matrices", json.joints.len(), inverse_bind.len());
        return Err(malformed(&place, &text));
    }
    let node_from_world = node.world_from_node.inverse();
    if !node_from_world.is_finite() {
        return Ok(Vec::new());
    }
    let mut bent = Vec::with_capacity(json.joints.len());
    for (number, joint) in json.joints.iter().enumerate() {
        let Ok(at) = nodes.binary_search_by_key(&joint.value(), |node| node.index) else {
            warnings.add("skins with joints outside the scene are ignored: their meshes keep their bind pose", place);
            return Ok(Vec::new());
        };
        let bind = inverse_bind.get(number);
        let bind = bind.map_or(DMat4::IDENTITY, |matrix| DMat4::from_cols_array(&matrix.map(f64::from)));
        bent.push(node_from_world * nodes[at].world_from_node * bind);
    }
    Ok(bent)
}

impl Pose {
    /// Whether meshes stay as they are in the file.
    pub(super) fn is_plain(&self) -> bool {
        self.joints.is_empty() && self.morph.iter().all(|weight| *weight == 0.0)
    }

    /// Moves the vertices of a primitive: first by its morph targets, then by its joints.
    pub(super) fn apply(&self, attributes: &Attributes<'_>, vertices: &mut Vertices) -> Result<(), LoadError> {
        self.morph(attributes.file, attributes.primitive, vertices, attributes.place)?;
        if !self.joints.is_empty() {
            self.skin(attributes, vertices)?;
        }
        Ok(())
    }

    fn morph(
        &self,
        file: &File<'_>,
        primitive: &Primitive,
        vertices: &mut Vertices,
        place: &str,
    ) -> Result<(), LoadError> {
        let count = vertices.positions.len();
        let read = |index, place: &str| {
            let deltas = read_vec3(file, index, Most { count, of: ("values in a morph target", count) }, place)?;
            require_finite(&deltas, place)?;
            if deltas.len() == count {
                return Ok(deltas);
            }
            Err(malformed(place, &format!("has {} values for {count} vertices", deltas.len())))
        };
        let targets = primitive.targets.iter().flatten().zip(&self.morph);
        for (number, (target, &weight)) in targets.enumerate().filter(|(_, (_, weight))| **weight != 0.0) {
            if let Some(index) = target.positions {
                let deltas = read(index, &format!("{place}, target {number}, POSITION"))?;
                add(&mut vertices.positions, &deltas, weight);
            }
            if let Some(index) = target.normals.filter(|_| !vertices.normals.is_empty()) {
                let deltas = read(index, &format!("{place}, target {number}, NORMAL"))?;
                add(&mut vertices.normals, &deltas, weight);
            }
        }
        require_finite(&vertices.positions, &format!("{place}, morphed POSITION"))
    }

    fn skin(&self, attributes: &Attributes<'_>, vertices: &mut Vertices) -> Result<(), LoadError> {
        let count = vertices.positions.len();
        let mut sets = Vec::new();
        for set in 0..MAX_SETS {
            let Some(influences) = attributes.influences(set, count)? else { break };
            sets.push(influences);
        }
        let out_of_range = |joint: u32| malformed(attributes.place, &format!("joint {joint} is out of range"));
        for vertex in 0..count {
            let (mut bend, mut total) = (DMat4::ZERO, 0.0);
            for (joints, weights) in &sets {
                let both = joints[vertex].into_iter().zip(weights[vertex]);
                for (joint, weight) in both.filter(|(_, weight)| *weight > 0.0) {
                    let matrix = self.joints.get(joint as usize).ok_or_else(|| out_of_range(joint))?;
                    bend += *matrix * f64::from(weight);
                    total += f64::from(weight);
                }
            }
            if total > 0.0 {
                let normal = vertices.normals.get_mut(vertex);
                bend_vertex(&(bend * (1.0 / total)), &mut vertices.positions[vertex], normal);
            }
        }
        require_finite(&vertices.positions, &format!("{}, skinned POSITION", attributes.place))
    }
}

fn add(values: &mut [[f32; 3]], deltas: &[[f32; 3]], weight: f32) {
    for (value, delta) in values.iter_mut().flatten().zip(deltas.iter().flatten()) {
        *value += weight * delta;
    }
}

fn bend_vertex(bend: &DMat4, position: &mut [f32; 3], normal: Option<&mut [f32; 3]>) {
    *position = bend.transform_point3(DVec3::from_array(position.map(f64::from))).as_vec3().to_array();
    let Some(normal) = normal else { return };
    let turn = DMat3::from_mat4(*bend);
    // Normals go with the inverse transpose; its size does not matter, its sign does.
    let cofactors = DMat3::from_cols(
        turn.y_axis.cross(turn.z_axis),
        turn.z_axis.cross(turn.x_axis),
        turn.x_axis.cross(turn.y_axis),
    );
    let turned = cofactors * DVec3::from_array(normal.map(f64::from)) * turn.determinant().signum();
    *normal = turned.normalize_or_zero().as_vec3().to_array();
}
