//! A surface put elsewhere, and its size.

use glam::{DMat4, Vec3};

use super::{FileTriangle, Surface};

/// The box around points: upside down where there are none.
pub(crate) fn bounds_of(points: impl Iterator<Item = Vec3>) -> (Vec3, Vec3) {
    points.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)))
}

/// Whether two boxes, low and high corners, have a point in common.
#[inline]
pub(crate) fn overlap(a: &(Vec3, Vec3), b: &(Vec3, Vec3)) -> bool {
    a.0.cmple(b.1).all() && b.0.cmple(a.1).all()
}

impl Surface {
    /// This surface after a rigid motion in scene space.
    pub fn transformed(&self, motion: &DMat4) -> Surface {
        Surface {
            positions: moved_points(motion, &self.positions),
            normals: moved_normals(motion, &self.normals),
            triangles: self.triangles.clone(),
            triangle_materials: self.triangle_materials.clone(),
            sources: self.sources.clone(),
            ..*self
        }
    }

    /// Smallest and largest corner of all vertices, scene space, metres.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        bounds_of(self.positions.iter().copied())
    }

    /// Longest side of the boxes of its triangles, metres: hits on them are as exact as this is small.
    pub fn largest_extent(&self) -> f32 {
        let extent = |[a, b, c]: [Vec3; 3]| (a.max(b).max(c) - a.min(b).min(c)).max_element();
        self.all_corners().map(extent).fold(0.0, f32::max)
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> usize {
        self.positions.capacity() * size_of::<Vec3>()
            + self.normals.capacity() * size_of::<Vec3>()
            + self.triangles.capacity() * size_of::<[u32; 3]>()
            + self.triangle_materials.capacity() * size_of::<u32>()
            + self.sources.capacity() * size_of::<FileTriangle>()
    }
}

/// Distances between points after a rigid motion are at most so many times what they were: coordinates are rounded.
pub(crate) const ROUNDED: f32 = 1.01;

/// Points after a rigid motion.
pub(crate) fn moved_points(motion: &DMat4, points: &[Vec3]) -> Vec<Vec3> {
    points.iter().map(|p| motion.transform_point3(p.as_dvec3()).as_vec3() + Vec3::ZERO).collect()
}

/// Unit normals after a rigid motion.
pub(crate) fn moved_normals(motion: &DMat4, normals: &[Vec3]) -> Vec<Vec3> {
    normals.iter().map(|n| motion.transform_vector3(n.as_dvec3()).as_vec3().normalize_or(*n)).collect()
}
