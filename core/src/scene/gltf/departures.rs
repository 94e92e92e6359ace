//! Remarks on departures from the specification that are mended where they are read, without a place for remarks there.

use ::gltf::json;
use json::validation::Checked;

use super::warnings::Warnings;

pub(super) fn remark(root: &json::Root, warnings: &mut Warnings) {
    for (index, view) in root.buffer_views.iter().enumerate() {
        if view.byte_stride.is_some_and(|stride| stride.0 == 0) {
            warnings.add("a byteStride of 0 is taken as none", format!("buffer view {index}"));
        }
    }
    for (index, mesh) in root.meshes.iter().enumerate() {
        for (number, primitive) in mesh.primitives.iter().enumerate() {
            if primitive.attributes.contains_key(&Checked::Invalid) {
                let place = format!("mesh {index}, primitive {number}");
                warnings.add("attributes that are not known are left out", place);
            }
        }
    }
}
