//! From objects to surfaces.

use glam::{DMat4, DVec3, Vec3};

use super::topology::closed_volume;
use super::weld::{MIN_COSINE, geometric_normal, weld};
use super::{Surface, SurfaceError};
use crate::order::{along_curve, in_order};
use crate::scene::Object;

impl Surface {
    /// Brings an object's triangles to scene space.
    ///
    /// `scene_from_object` is [`Object::world_from_object`] after the subtraction of [`crate::scene::Scene::origin`].
    /// Triangles that have no area in scene space are dropped; the surface may end up empty, as that of a hidden object is.
    ///
    /// # Errors
    /// [`SurfaceError`]: a transform that is not usable, or a mesh with indices out of range.
    pub fn build(object: &Object, scene_from_object: DMat4) -> Result<Self, SurfaceError> {
        if object.is_hidden {
            return Ok(Surface::default());
        }
        let mut surface = weld(object, scene_from_object)?;
        surface.sort();
        (surface.closed, surface.volume) = closed_volume(&surface);
        Ok(surface)
    }

    /// Puts triangles that lie side by side next to one another.
    fn sort(&mut self) {
        let middles: Vec<Vec3> = self.all_corners().map(|[a, b, c]| a / 3.0 + b / 3.0 + c / 3.0).collect();
        let order = along_curve(&middles);
        self.triangles = in_order(&self.triangles, &order);
        self.triangle_materials = in_order(&self.triangle_materials, &order);
        self.sources = in_order(&self.sources, &order);
    }

    /// Corners of a triangle, scene space.
    #[inline]
    pub fn corners(&self, triangle: usize) -> [Vec3; 3] {
        self.triangles[triangle].map(|corner| self.positions[corner as usize])
    }

    /// Corners of all triangles, scene space.
    pub fn all_corners(&self) -> impl Iterator<Item = [Vec3; 3]> + '_ {
        (0..self.triangles.len()).map(|triangle| self.corners(triangle))
    }

    /// Area in m².
    pub fn area(&self) -> f64 {
        self.all_corners().map(triangle_area).sum()
    }

    /// Checks what the rest of the engine relies on.
    ///
    /// # Errors
    /// What is wrong, in words.
    pub fn validate(&self) -> Result<(), String> {
        let count = self.positions.len();
        if self.normals.len() != count {
            return Err("the lists per vertex differ in length".into());
        }
        if [self.triangle_materials.len(), self.sources.len()] != [self.triangles.len(); 2] {
            return Err("the lists per triangle differ in length".into());
        }
        if self.positions.iter().chain(&self.normals).any(|v| !v.is_finite()) {
            return Err("a position or normal is not finite".into());
        }
        for (index, triangle) in self.triangles.iter().enumerate() {
            if triangle.iter().any(|&corner| corner as usize >= count) {
                return Err(format!("triangle {index} refers to a vertex that does not exist"));
            }
            let [a, b, c] = self.corners(index);
            let front = geometric_normal(a, b, c).ok_or_else(|| format!("triangle {index} has no area"))?;
            let least = triangle.map(|corner| front.dot(self.normals[corner as usize])).into_iter().fold(1.0, f32::min);
            // Rounding costs a little of the bound.
            if least.is_nan() || least < 0.5 * MIN_COSINE {
                return Err(format!("triangle {index} has a normal that is {least} (cosine) off its own"));
            }
        }
        Ok(())
    }
}

/// Area in m².
pub(crate) fn triangle_area([a, b, c]: [Vec3; 3]) -> f64 {
    let (a, b, c) = (a.as_dvec3(), b.as_dvec3(), c.as_dvec3());
    (b - a).cross(c - a).length() * 0.5
}

/// Weights of the corners of a triangle at a point in its plane, none below zero.
pub(crate) fn barycentrics(point: Vec3, corners: [Vec3; 3]) -> [f32; 3] {
    let [a, b, c] = corners.map(|corner| (corner - point).as_dvec3());
    let n = (b - a).cross(c - a);
    let part = |p: DVec3, q: DVec3| (p.cross(q).dot(n) / n.length_squared()).max(0.0) as f32;
    [part(b, c), part(c, a), part(a, b)]
}

/// Area of an object in world space, m².
pub fn object_area(object: &Object) -> f64 {
    let corner =
        |vertex: u32| object.world_from_object.transform_point3(object.mesh.positions[vertex as usize].as_dvec3());
    let area = |&[a, b, c]: &[u32; 3]| {
        let a = corner(a);
        (corner(b) - a).cross(corner(c) - a).length() * 0.5
    };
    object.mesh.triangles.iter().map(area).sum()
}
