//! `EXT_mesh_gpu_instancing`: where a node shows its mesh.

use glam::{DMat4, DQuat, DVec3, Vec3};

use super::accessor::{Most, read_floats, require_finite};
use super::container::File;
use super::nodes::PlacedNode;
use super::{LoadError, LoadLimits, malformed};
use crate::scene::Mesh;

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
/// A matrix that squeezes a mesh flat along an axis along which it is flat already, with some other length of that axis: the
/// surface is the same, and has normals.
pub(super) fn with_thickness(matrix: DMat4, mesh: &Mesh) -> DMat4 {
    let columns = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(|column| column.truncate());
    let zeros: Vec<usize> = (0..3).filter(|&k| columns[k] == DVec3::ZERO).collect();
    let [axis] = zeros[..] else { return matrix };
    let at = |position: &Vec3| position[axis];
    let (low, high) =
        mesh.positions.iter().map(at).fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
    if low < high {
        return matrix;
    }
    let [u, v] = [columns[(axis + 1) % 3], columns[(axis + 2) % 3]];
    let length = u.length().max(v.length());
    let mut mended = matrix;
    *mended.col_mut(axis) = (u.cross(v).normalize_or_zero() * length).extend(0.0);
    // The plane that the mesh is in stays where the matrix has it.
    mended.w_axis -= mended.col(axis) * f64::from(if low.is_finite() { low } else { 0.0 });
    mended
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_flat_already_keeps_its_area() {
        let flat = DMat4::from_scale_rotation_translation(
            DVec3::new(2.0, 0.0, 3.0),
            DQuat::from_rotation_x(0.4),
            DVec3::new(1.0, 2.0, 3.0),
        );
        let plane = Mesh::quad(Vec3::Y * 0.5, Vec3::Z, Vec3::X);
        let mended = with_thickness(flat, &plane);
        assert!((mended.determinant() - 18.0).abs() < 1e-9, "{}", mended.determinant());
        for position in &plane.positions {
            let [there, here] = [flat, mended].map(|matrix| matrix.transform_point3(position.as_dvec3()));
            assert!(there.distance(here) < 1e-12, "{there} {here}");
        }
        let cube = Mesh::cuboid(Vec3::ZERO, Vec3::ONE);
        assert_eq!(with_thickness(flat, &cube), flat);
        let nothing = DMat4::from_scale(DVec3::new(1.0, 0.0, 0.0));
        assert_eq!(with_thickness(nothing, &plane), nothing);
    }
}
