//! One object: its mesh as the file has it, and the cells between its elements with their light.

use std::collections::BTreeMap;

use ::gltf::json::Value;
use glam::DVec3;

use super::container::{Document, numbers, object, push};
use super::scene::{add_mesh, transform};
use super::{MeshExport, add_light_mesh};
use crate::export::ExportError;
use crate::scene::{Light, LightKind, NodeSource, Object};

/// One object to be written.
#[derive(Clone, Copy, Debug)]
pub struct ObjectExport<'a> {
    /// The object.
    pub object: &'a Object,
    /// All lights of its scene: the strength of those that it emits is written as its emission.
    pub lights: &'a [Light],
    /// Its elements with their light.
    pub elements: MeshExport<'a>,
    /// World-space point (metres) that is the zero of the elements' positions.
    pub origin: DVec3,
    /// Slot of the first element.
    pub first_element: u32,
    /// The second half of the elements belongs to the back.
    pub with_back: bool,
}

/// Writes one object as two scenes.
///
/// Scene 0, which viewers show, holds its mesh as the file has it: positions and normals in object space, whatever
/// texture coordinates are known, and materials of their names with the mean albedo and the emission in force. The
/// node's `matrix` is object space to world space; its `extras` hold the node's index in the file as `node` and its
/// `extras.id` as `id`, where it has them.
///
/// Scene 1, absent of an object without elements, holds the cells between its elements, in world space: vertex *i* is
/// the element in slot `extras.first_element + i`, its light the float `COLOR_0`. With `extras.with_back` the second
/// half of the elements belongs to the back. Vertices of the file that share elements, and corners of cells that reach
/// into walls, follow where there are any; then every vertex says which it reads: `_ELEMENTS` (less `first_element`) and
/// `_WEIGHTS`.
///
/// # Errors
/// [`ExportError`]: lists that do not fit together, numbers that are not finite, more than 4 GiB.
pub fn write_object_glb(export: &ObjectExport<'_>) -> Result<Vec<u8>, ExportError> {
    let (item, name) = (export.object, export.object.name.as_str());
    let mut document = Document::default();
    let mut emission: BTreeMap<(&str, u32), &Light> = BTreeMap::new();
    for light in export.lights {
        if let LightKind::Emissive { object, material } = &light.kind {
            emission.insert((object, *material), light);
        }
    }
    let mesh = add_mesh(&mut document, item, &emission, true)?;
    let mut node = vec![("name", name.into()), ("mesh", mesh)];
    node.extend(transform(item.world_from_object, name)?);
    node.extend(item.node.as_ref().map(|source| ("extras", extras(source))));
    let node = push(&mut document.nodes, object(node));
    document.scenes.push(object([("name", "mesh".into()), ("nodes", vec![node].into())]));
    if !export.elements.triangles.is_empty() {
        let mesh = add_light_mesh(&mut document, &export.elements)?;
        let about = [("first_element", export.first_element.into()), ("with_back", export.with_back.into())];
        let mut node = vec![("name", name.into()), ("mesh", mesh), ("extras", object(about))];
        if export.origin != DVec3::ZERO {
            node.push(("translation", numbers(export.origin.as_vec3().to_array())));
        }
        let node = push(&mut document.nodes, object(node));
        document.scenes.push(object([("name", "elements".into()), ("nodes", vec![node].into())]));
    }
    document.finish()
}

fn extras(source: &NodeSource) -> Value {
    let id = source.id.as_ref().map(|id| ("id", (&**id).into()));
    object([("node", source.index.into())].into_iter().chain(id))
}
