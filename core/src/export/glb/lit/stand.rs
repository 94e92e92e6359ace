//! Where nodes stand: glTF knows no shear, so what has one gives it to its vertices.

use ::gltf::json::Value;
use glam::{DMat4, DQuat, DVec3};
use serde_json::Map;

use super::super::container::numbers;

/// Part of a transform that rounding may change.
const ROUNDING: f64 = 1e-6;
/// How far from 1 the length of a rotation in a file may be.
const UNIT: f64 = 1e-3;

/// A node's transform as it is written.
pub(super) struct Stand {
    /// Node space to world space.
    pub(super) world_from_node: DMat4,
    /// What is left to its vertices, and what they become in the node's space.
    pub(super) baked: Option<DMat4>,
    /// `translation`, `rotation` and `scale`, where they are not those of the identity.
    pub(super) json: Vec<(&'static str, Value)>,
}

impl Stand {
    /// Has what is to stand at `target` stand there, below a node. None where no transform leads there.
    pub(super) fn below(parent: DMat4, target: DMat4) -> Option<Stand> {
        let local = parent.inverse() * target;
        if !local.is_finite() {
            return None;
        }
        let (scale, rotation, translation) = local.to_scale_rotation_translation();
        let again = DMat4::from_scale_rotation_translation(scale, rotation, translation);
        let largest =
            [local.x_axis, local.y_axis, local.z_axis].map(|axis| axis.length()).into_iter().fold(0.0, f64::max);
        let is_exact = again.is_finite() && again.abs_diff_eq(local, ROUNDING * largest.max(f64::MIN_POSITIVE));
        let (scale, rotation) = if is_exact { (scale, rotation) } else { (DVec3::ONE, DQuat::IDENTITY) };
        let mut json = Vec::new();
        if translation != DVec3::ZERO {
            json.push(("translation", numbers(translation.as_vec3().to_array())));
        }
        if rotation != DQuat::IDENTITY {
            json.push(("rotation", numbers(rotation.normalize().as_quat().to_array())));
        }
        if scale != DVec3::ONE {
            json.push(("scale", numbers(scale.as_vec3().to_array())));
        }
        let world_from_node = if is_exact { target } else { parent * DMat4::from_translation(translation) };
        let baked = (!is_exact).then(|| world_from_node.inverse() * target);
        Some(Stand { world_from_node, baked, json })
    }
}

/// Whether the transform that a file gives a node is one that may be written.
pub(super) fn is_valid(node: &Map<String, Value>) -> bool {
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    let list = |key: &str| Some(node.get(key)?.as_array()?.iter().map(number).collect::<Vec<f64>>());
    let is_unit = |rotation: Vec<f64>| (rotation.iter().map(|x| x * x).sum::<f64>().sqrt() - 1.0).abs() < UNIT;
    let is_plain = |matrix: Vec<f64>| {
        <[f64; 16]>::try_from(matrix).is_ok_and(|matrix| {
            let stand = Stand::below(DMat4::IDENTITY, DMat4::from_cols_array(&matrix));
            stand.is_some_and(|stand| stand.baked.is_none())
        })
    };
    list("rotation").is_none_or(is_unit) && list("matrix").is_none_or(is_plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(stand: &Stand) -> DMat4 {
        let list = |key: &str| -> Option<Vec<f64>> {
            let found = stand.json.iter().find(|(name, _)| *name == key)?;
            Some(found.1.as_array()?.iter().filter_map(Value::as_f64).collect())
        };
        let vector = |key: &str, absent| list(key).map_or(absent, |list| DVec3::from_slice(&list));
        let rotation = list("rotation").map_or(DQuat::IDENTITY, |list| DQuat::from_slice(&list));
        DMat4::from_scale_rotation_translation(
            vector("scale", DVec3::ONE),
            rotation,
            vector("translation", DVec3::ZERO),
        )
    }

    /// Below a parent that is turned and stretched, mirrored or not, nodes stand where they are told to.
    #[test]
    fn what_is_written_leads_to_the_target() {
        let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7);
        let even = DMat4::from_scale_rotation_translation(DVec3::splat(2.0), turn, DVec3::new(1.0, 2.0, 3.0));
        let uneven = DMat4::from_scale_rotation_translation(DVec3::new(1.0, 3.0, -0.5), turn, DVec3::X);
        let target = DMat4::from_scale_rotation_translation(DVec3::new(-1.0, 1.0, 4.0), turn.inverse(), DVec3::Y);
        for (parent, is_sheared) in [(DMat4::IDENTITY, false), (even, false), (uneven, true)] {
            let stand = Stand::below(parent, target).expect("a transform");
            assert_eq!(stand.baked.is_some(), is_sheared);
            assert!((parent * read(&stand)).abs_diff_eq(stand.world_from_node, 1e-5));
            let whole = stand.world_from_node * stand.baked.unwrap_or(DMat4::IDENTITY);
            assert!(whole.abs_diff_eq(target, 1e-9), "{whole} {target}");
        }
        let flat = DMat4::from_scale(DVec3::new(1.0, 0.0, 1.0));
        assert!(Stand::below(flat, target).is_none());
    }
}
