//! A surface put elsewhere, and its size.

use glam::{DMat4, Vec3};

use super::Surface;

impl Surface {
    /// The same elements after a rigid motion in scene space.
    pub fn transformed(&self, motion: &DMat4) -> Surface {
        let point = |p: &Vec3| motion.transform_point3(p.as_dvec3()).as_vec3();
        let vector = |n: &Vec3| motion.transform_vector3(n.as_dvec3()).as_vec3().normalize_or(*n);
        Surface {
            vertices: self.vertices.iter().map(point).collect(),
            positions: self.positions.iter().map(point).collect(),
            normals: self.normals.iter().map(vector).collect(),
            ..self.clone()
        }
    }

    /// Smallest and largest corner of all vertices, scene space, metres.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        self.vertices.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)))
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> usize {
        self.vertices.capacity() * 12
            + self.positions.capacity() * 12
            + self.normals.capacity() * 12
            + self.areas.capacity() * 4
            + self.triangles.capacity() * 12
            + self.triangle_materials.capacity() * 4
    }
}
