//! Lights of a file: emissive materials of its objects and `KHR_lights_punctual`.

use std::collections::BTreeMap;

use ::gltf::json;
use glam::{DVec3, Vec3};
use json::extensions::scene::khr_lights_punctual::{Light as JsonLight, Type};
use json::validation::Checked;

use super::nodes::{PlacedNode, source};
use super::warnings::Warnings;
use super::{LoadError, LoadLimits, LoadedObject, malformed, too_large};
use crate::allowed::Allowed;
use crate::scene::names::UniqueNames;
use crate::scene::{ENVIRONMENT, Light, LightKind, NodeSource};

/// Lights, and of those under an object's node: their names with that object's. Of punctual ones the nodes.
pub(super) struct Lights {
    pub(super) lights: Vec<Light>,
    pub(super) parents: BTreeMap<String, String>,
    pub(super) nodes: BTreeMap<String, NodeSource>,
}

/// Emissive lights in the order of the objects, then punctual ones in the order of the nodes. Names are unique.
pub(super) fn collect(
    root: &json::Root,
    nodes: &[PlacedNode],
    objects: &[LoadedObject],
    limits: &LoadLimits,
    warnings: &mut Warnings,
) -> Result<Lights, LoadError> {
    let mut names = UniqueNames::default();
    names.claim(ENVIRONMENT);
    let mut lights = emissive(objects, &mut names);
    let (mut parents, mut light_nodes) = (BTreeMap::new(), BTreeMap::new());
    // The first of several instances stands for its node.
    let mut object_of: BTreeMap<usize, &str> = BTreeMap::new();
    for loaded in objects {
        object_of.entry(loaded.node).or_insert(&loaded.object.name);
    }
    for node in nodes.iter().filter(|node| !node.is_hidden) {
        let Some((index, light)) = punctual_of(root, node)? else { continue };
        let place = format!("light {index} \"{}\"", node.name);
        if !matches!(light.type_, Checked::Valid(Type::Point)) && direction_of(node).is_none() {
            warnings.add("lights whose node has a scale of zero shine in no direction: they are left out", place);
            continue;
        }
        let name = names.claim(&node.name);
        if name != node.name {
            warnings.add("lights of the same name were renamed", format!("\"{}\" to \"{name}\"", node.name));
        }
        if let Some(object) = node.object.and_then(|object| object_of.get(&object)) {
            parents.insert(name.clone(), (*object).to_owned());
        }
        light_nodes.insert(name.clone(), source(root, node.index));
        lights.push(read_punctual(light, name, node, &place, warnings)?);
    }
    if lights.len() > limits.max_lights {
        return Err(too_large("lights", limits.max_lights));
    }
    Ok(Lights { lights, parents, nodes: light_nodes })
}

/// A light per object and emissive material: the object's name, further ones `name/2`, `name/3`, ….
fn emissive(objects: &[LoadedObject], names: &mut UniqueNames) -> Vec<Light> {
    let mut lights = Vec::new();
    for LoadedObject { object, loaded, .. } in objects {
        for (index, material) in loaded.materials.iter().enumerate() {
            if material.emission_color == Vec3::ZERO || !object.shines(index) {
                continue;
            }
            lights.push(Light {
                name: names.claim_with(&object.name, '/'),
                kind: LightKind::Emissive { object: object.name.clone(), material: index as u32 },
                color: material.emission_color,
                intensity: material.emission_intensity,
            });
        }
    }
    lights
}

fn punctual_of<'r>(root: &'r json::Root, node: &PlacedNode) -> Result<Option<(usize, &'r JsonLight)>, LoadError> {
    let extension = root.nodes[node.index].extensions.as_ref();
    let Some(reference) = extension.and_then(|e| e.khr_lights_punctual.as_ref()) else { return Ok(None) };
    let index = reference.light.value();
    let light = root.get(reference.light);
    let missing =
        || malformed(&format!("node {} \"{}\"", node.index, node.name), &format!("its light {index} does not exist"));
    light.map(|light| Some((index, light))).ok_or_else(missing)
}

/// A light as edits allow it; what exporters write beside that is mended with a warning.
fn read_punctual(
    light: &JsonLight,
    name: String,
    node: &PlacedNode,
    place: &str,
    warnings: &mut Warnings,
) -> Result<Light, LoadError> {
    let (mut color, mut intensity) = (Vec3::from_array(light.color), light.intensity);
    if !color.is_finite() || !intensity.is_finite() {
        let text = format!("its colour is {color} and its intensity {intensity}, they must be finite");
        return Err(malformed(place, &text));
    }
    if color.min_element() < 0.0 || intensity < 0.0 {
        warnings.add("lights of a negative colour or intensity take no light away: they count as 0", place);
        (color, intensity) = (color.max(Vec3::ZERO), intensity.max(0.0));
    }
    Allowed::KEPT.check_product(color, intensity).map_err(|reason| malformed(place, &format!("its {reason}")))?;
    let range = light.range.filter(|range| range.is_finite() && *range > 0.0);
    if range != light.range {
        warnings.add("ranges of lights that are not above 0 are taken as none", place);
    }
    let position = node.world_from_node.transform_point3(DVec3::ZERO);
    let direction =
        |node| direction_of(node).ok_or_else(|| malformed(place, "its node has a scale of zero: no direction"));
    let kind = match light.type_ {
        Checked::Invalid => return Err(malformed(place, "its type is unknown")),
        Checked::Valid(Type::Point) => LightKind::Point { position, range },
        Checked::Valid(Type::Directional) => LightKind::Directional { direction: direction(node)?, angle: 0.0 },
        Checked::Valid(Type::Spot) => {
            let (inner_cone_angle, outer_cone_angle) = cone(light, place, warnings)?;
            let direction = direction(node)?;
            LightKind::Spot { position, direction, inner_cone_angle, outer_cone_angle, range }
        }
    };
    Ok(Light { name, kind, color, intensity })
}

/// The −z axis of the node; none where its scale is zero.
fn direction_of(node: &PlacedNode) -> Option<Vec3> {
    node.world_from_node.transform_vector3(DVec3::NEG_Z).try_normalize().map(|direction| direction.as_vec3())
}

/// Inner and outer angle, 0 <= inner <= outer <= pi/2; an edge between equal ones is hard.
fn cone(light: &JsonLight, place: &str, warnings: &mut Warnings) -> Result<(f32, f32), LoadError> {
    if light.spot.is_none() {
        warnings.add("spot lights without a cone have that of the specification, 45 degrees to each side", place);
    }
    let default = (0.0, std::f32::consts::FRAC_PI_4);
    let (inner, outer) = light.spot.as_ref().map_or(default, |spot| (spot.inner_cone_angle, spot.outer_cone_angle));
    if !(inner.is_finite() && outer.is_finite() && outer > 0.0) {
        return Err(malformed(
            place,
            &format!("its cone angles are {inner} and {outer}, the outer one must be above 0"),
        ));
    }
    // The smallest f32 above pi/2 still stands for pi/2.
    let mended_outer = outer.min(std::f32::consts::FRAC_PI_2);
    let mended_inner = inner.clamp(0.0, mended_outer);
    if inner >= outer {
        warnings.add("spot lights whose inner cone is not below the outer one have a hard edge", place);
    }
    if outer > mended_outer {
        warnings.add("spot lights wider than 90 degrees to each side end there", place);
    } else if inner < 0.0 {
        warnings.add("negative inner cone angles of spot lights are taken as 0", place);
    }
    Ok((mended_inner, mended_outer))
}
