//! `EXT_mesh_gpu_instancing`: where a node shows its mesh.

use glam::{DMat4, DQuat, DVec3};

use super::accessor::{Most, read_floats, require_finite};
use super::container::File;
use super::nodes::PlacedNode;
use super::{LoadError, LoadLimits, malformed};

/// Instance space to world space for each instance of a node; of a plain node its own transform alone.
pub(super) fn of_node(file: &File<'_>, node: &PlacedNode, limits: &LoadLimits) -> Result<Vec<DMat4>, LoadError> {
    let extension = file.more.node(node.index).and_then(|extensions| extensions.instancing.as_ref());
    let Some(attributes) = extension.map(|extension| &extension.attributes) else {
        return Ok(vec![node.world_from_node]);
    };
    let place = format!("node {} \"{}\", instances", node.index, node.name);
    let most = Most { count: limits.max_objects, of: ("objects (nodes with a mesh)", limits.max_objects) };
    let vectors = |index: Option<_>, name: &str| {
        let place = format!("{place}, {name}");
        let values = index.map(|index| read_floats::<3>(file, index, most, &place)).transpose()?;
        require_finite(values.as_deref().unwrap_or_default(), &place)?;
        Ok::<_, LoadError>(values)
    };
    let translations = vectors(attributes.translation, "TRANSLATION")?;
    let scales = vectors(attributes.scale, "SCALE")?;
    let of_rotation = |index| read_floats::<4>(file, index, most, &format!("{place}, ROTATION"));
    let rotations = attributes.rotation.map(of_rotation).transpose()?;
    require_finite(rotations.as_deref().unwrap_or_default(), &place)?;
    let lengths =
        [translations.as_ref().map(Vec::len), scales.as_ref().map(Vec::len), rotations.as_ref().map(Vec::len)];
    let count = lengths.into_iter().flatten().min().unwrap_or(0);
    if lengths.into_iter().flatten().any(|length| length != count) {
        return Err(malformed(&place, "their attributes differ in number"));
    }
    let vector = |values: &Option<Vec<[f32; 3]>>, at: usize, absent| {
        values.as_ref().map_or(absent, |values| DVec3::from_array(values[at].map(f64::from)))
    };
    let instance = |at: usize| {
        let rotation = rotations.as_ref().map_or(DQuat::IDENTITY, |all| DQuat::from_array(all[at].map(f64::from)));
        // Quantised ones are not quite of unit length.
        let rotation = if rotation.length() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY };
        let (scale, translation) = (vector(&scales, at, DVec3::ONE), vector(&translations, at, DVec3::ZERO));
        node.world_from_node * DMat4::from_scale_rotation_translation(scale, rotation, translation)
    };
    file.read.take(count * size_of::<DMat4>(), &place)?;
    Ok((0..count).map(instance).collect())
}
