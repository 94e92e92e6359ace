//! How far rays start off a surface.

use glam::Vec3;

/// Offset over the largest coordinate, or over the extent of the triangle where that is larger: about thirty units in
/// the last place of `f32`. It follows the place of the ray: what is parked far away in a scene does not make rays
/// elsewhere pass walls.
const RELATIVE: f32 = 4e-6;

/// Metres to move a point off a surface whose triangles have at most this extent (m) along its normal.
#[inline]
pub(crate) fn ray_offset(point: Vec3, extent: f32) -> f32 {
    RELATIVE * point.abs().max_element().max(extent).max(f32::MIN_POSITIVE * 1e10)
}
