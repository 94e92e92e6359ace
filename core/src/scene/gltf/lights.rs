//! Lights of a file: emissive materials of its objects and `KHR_lights_punctual`.

use std::sync::Arc;

use ::gltf::json;
use glam::{DVec3, Vec3};
use json::extensions::scene::khr_lights_punctual::{Light as JsonLight, Type};
use json::validation::Checked;

use super::mesh::LoadedMesh;
use super::nodes::PlacedNode;
use super::warnings::Warnings;
use super::{LoadError, LoadLimits, malformed, too_large};
use crate::scene::names::UniqueNames;
use crate::scene::{Light, LightKind, Object};

/// Emissive lights in the order of the objects, then punctual ones in the order of the nodes. Names are unique.
pub(super) fn collect(
    root: &json::Root,
    nodes: &[PlacedNode],
    objects: &[(Object, Arc<LoadedMesh>)],
    limits: &LoadLimits,
    warnings: &mut Warnings,
) -> Result<Vec<Light>, LoadError> {
    let mut names = UniqueNames::default();
    // The name of the light from outside.
    names.claim("environment");
    let mut lights = emissive(objects, &mut names);
    for node in nodes {
        let Some((index, light)) = punctual_of(root, node)? else { continue };
        let place = format!("light {index} \"{}\"", node.name);
        let name = names.claim(&node.name);
        if name != node.name {
            warnings.add("lights of the same name were renamed", format!("\"{}\" to \"{name}\"", node.name));
        }
        lights.push(read_punctual(light, name, node, &place)?);
    }
    if lights.len() > limits.max_lights {
        return Err(too_large("lights", limits.max_lights));
    }
    Ok(lights)
}

/// A light per object and emissive material: the object's name, further ones `name/2`, `name/3`, ….
fn emissive(objects: &[(Object, Arc<LoadedMesh>)], names: &mut UniqueNames) -> Vec<Light> {
    let mut lights = Vec::new();
    for (object, mesh) in objects {
        for (index, material) in mesh.materials.iter().enumerate() {
            if material.emission_color == Vec3::ZERO {
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

fn read_punctual(light: &JsonLight, name: String, node: &PlacedNode, place: &str) -> Result<Light, LoadError> {
    let color = Vec3::from_array(light.color);
    if !color.is_finite() || color.min_element() < 0.0 {
        return Err(malformed(place, &format!("its colour is {color}, each part must be 0 or more")));
    }
    if !light.intensity.is_finite() || light.intensity < 0.0 {
        return Err(malformed(place, &format!("its intensity is {}, it must be 0 or more", light.intensity)));
    }
    if light.range.is_some_and(|range| !(range.is_finite() && range > 0.0)) {
        return Err(malformed(place, &format!("its range is {:?}, it must be above 0", light.range)));
    }
    let (position, range) = (node.world_from_node.transform_point3(DVec3::ZERO), light.range);
    let kind = match light.type_ {
        Checked::Invalid => return Err(malformed(place, "its type is unknown")),
        Checked::Valid(Type::Point) => LightKind::Point { position, range },
        Checked::Valid(Type::Directional) => LightKind::Directional { direction: direction_of(node, place)? },
        Checked::Valid(Type::Spot) => {
            let (inner_cone_angle, outer_cone_angle) = cone(light, place)?;
            let direction = direction_of(node, place)?;
            LightKind::Spot { position, direction, inner_cone_angle, outer_cone_angle, range }
        }
    };
    Ok(Light { name, kind, color, intensity: light.intensity })
}

/// The −z axis of the node.
fn direction_of(node: &PlacedNode, place: &str) -> Result<Vec3, LoadError> {
    let direction = node.world_from_node.transform_vector3(DVec3::NEG_Z).try_normalize();
    direction.map(|d| d.as_vec3()).ok_or_else(|| malformed(place, "its node has a scale of zero: no direction"))
}

fn cone(light: &JsonLight, place: &str) -> Result<(f32, f32), LoadError> {
    let spot = light.spot.as_ref().ok_or_else(|| malformed(place, "a spot light without its cone"))?;
    let (inner, outer) = (spot.inner_cone_angle, spot.outer_cone_angle);
    // The smallest f32 above pi/2 still stands for pi/2.
    if inner >= 0.0 && inner < outer && outer <= std::f32::consts::FRAC_PI_2 {
        Ok((inner, outer))
    } else {
        Err(malformed(place, &format!("its cone angles are {inner} and {outer}; 0 <= inner < outer <= pi/2 is needed")))
    }
}
