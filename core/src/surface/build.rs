//! From objects to surfaces.

use std::sync::atomic::{AtomicUsize, Ordering};

use glam::{DMat4, Vec3};
use rayon::prelude::*;

use super::elements::elements;
#[cfg(test)]
use super::elements::triangle_area;
use super::order::sort;
use super::subdivide::subdivide;
use super::topology::closed_volume;
use super::weld::{MIN_COSINE, geometric_normal, weld};
use super::{Surface, SurfaceError};
use crate::scene::{Object, Scene};

/// Squares of side `spacing` that [`default_spacing`] aims at for a whole scene.
pub const DEFAULT_ELEMENTS: usize = 22_000;

impl Surface {
    /// Subdivides an object until neighbouring vertices are at most `spacing` metres apart.
    ///
    /// `scene_from_object` is [`Object::world_from_object`] after the subtraction of [`Scene::origin`]. Triangles
    /// that have no area in scene space are dropped; the surface may end up empty. Deterministic, and edges that
    /// two objects share get the same vertices in both.
    ///
    /// # Errors
    /// [`SurfaceError`]: a spacing or transform that is not usable, a mesh with indices out of range, or more than
    /// `max_elements` elements.
    pub fn build(
        object: &Object,
        scene_from_object: DMat4,
        spacing: f32,
        max_elements: usize,
    ) -> Result<Self, SurfaceError> {
        if !(spacing.is_finite() && spacing > 0.0) {
            return Err(SurfaceError::Spacing(spacing));
        }
        let coarse = weld(object, scene_from_object)?;
        // Elements are numbered with 32 bits.
        let limit = max_elements.min(u32::MAX as usize);
        if coarse.positions.len() > limit {
            return Err(SurfaceError::TooManyElements { limit });
        }
        // Splitting leaves the shape as it is: what encloses a volume does so before and after.
        let (closed, volume) = closed_volume(&coarse);
        let mesh = sort(&subdivide(coarse, spacing, limit)?);
        let elements = elements(&mesh);
        Ok(Self {
            vertices: mesh.positions,
            positions: elements.positions,
            normals: elements.normals,
            areas: elements.areas,
            triangles: mesh.triangles,
            triangle_materials: mesh.materials,
            closed,
            volume,
        })
    }

    /// Area in m².
    pub fn area(&self) -> f64 {
        self.areas.iter().map(|&area| f64::from(area)).sum()
    }

    /// Checks what the rest of the engine relies on.
    ///
    /// # Errors
    /// What is wrong, in words.
    pub fn validate(&self) -> Result<(), String> {
        let count = self.vertices.len();
        if [self.positions.len(), self.normals.len(), self.areas.len()] != [count; 3] {
            return Err("the lists per element differ in length".into());
        }
        if self.triangle_materials.len() != self.triangles.len() {
            return Err("the lists per triangle differ in length".into());
        }
        let mut best_cosine = vec![f32::NEG_INFINITY; count];
        for (index, triangle) in self.triangles.iter().enumerate() {
            if triangle.iter().any(|&corner| corner as usize >= count) {
                return Err(format!("triangle {index} refers to an element that does not exist"));
            }
            let [a, b, c] = triangle.map(|corner| self.vertices[corner as usize]);
            let front = geometric_normal(a, b, c).ok_or_else(|| format!("triangle {index} has no area"))?;
            for &corner in triangle {
                let best = &mut best_cosine[corner as usize];
                *best = best.max(front.dot(self.normals[corner as usize]));
            }
        }
        for (index, &best_cosine) in best_cosine.iter().enumerate() {
            self.validate_element(index, best_cosine).map_err(|what| format!("element {index}: {what}"))?;
        }
        Ok(())
    }

    fn validate_element(&self, index: usize, best_cosine: f32) -> Result<(), String> {
        let is_finite = |point: &[Vec3]| point[index].is_finite();
        if !(is_finite(&self.vertices) && is_finite(&self.positions)) {
            return Err("its position is not finite".into());
        }
        if !self.normals[index].is_normalized() {
            return Err(format!("its normal {} is not of unit length", self.normals[index]));
        }
        // Written so that a NaN fails.
        if !(self.areas[index] >= 0.0 && self.areas[index].is_finite()) {
            return Err(format!("its area is {}", self.areas[index]));
        }
        if best_cosine == f32::NEG_INFINITY {
            return Err("no triangle uses it".into());
        }
        // Rounding of the split points and of the interpolated normals costs a little of the bound.
        if best_cosine < 0.5 * MIN_COSINE {
            return Err(format!("its normal is {best_cosine} (cosine) off the nearest triangle's"));
        }
        Ok(())
    }
}

/// Builds the surfaces of all objects in parallel, in the order of the objects.
///
/// # Errors
/// As [`Surface::build`], with the index of the first object that has one; `max_elements` bounds the sum over all
/// objects, and where only that is exceeded the index is that of the last object.
pub fn build_all(scene: &Scene, spacing: f32, max_elements: usize) -> Result<Vec<Surface>, (usize, SurfaceError)> {
    let total = AtomicUsize::new(0);
    let scene_from_world = DMat4::from_translation(-scene.origin);
    let build = |object: &Object| {
        // Once the sum is exceeded there is no use in filling the memory further.
        if total.load(Ordering::Relaxed) > max_elements {
            return Ok(Surface::default());
        }
        let surface = Surface::build(object, scene_from_world * object.world_from_object, spacing, max_elements)?;
        total.fetch_add(surface.vertices.len(), Ordering::Relaxed);
        Ok(surface)
    };
    let results: Vec<Result<Surface, SurfaceError>> = scene.objects.par_iter().map(build).collect();
    let indexed = results.into_iter().enumerate().map(|(index, result)| result.map_err(|error| (index, error)));
    let surfaces: Vec<Surface> = indexed.collect::<Result<_, _>>()?;
    if total.into_inner() > max_elements {
        return Err((surfaces.len().saturating_sub(1), SurfaceError::TooManyElements { limit: max_elements }));
    }
    Ok(surfaces)
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

/// The spacing in metres at which `total_area` (m²) has about `elements` squares of that side, rounded to two digits.
///
/// Large flat surfaces get two to three elements per square, since it is the diagonals that must not exceed the
/// spacing. Meshes finer than this get more: every vertex of the file is an element.
pub fn default_spacing(total_area: f64, elements: usize) -> f32 {
    let spacing = (total_area / elements.max(1) as f64).sqrt();
    if !(spacing.is_finite() && spacing > 0.0) {
        return 1.0;
    }
    let unit = 10_f64.powf(spacing.log10().floor() - 1.0);
    let rounded = ((spacing / unit).round() * unit) as f32;
    if rounded.is_finite() && rounded > 0.0 { rounded } else { 1.0 }
}

/// Sum of the areas of some triangles, m².
#[cfg(test)]
pub(super) fn total_area(vertices: &[Vec3], triangles: &[[u32; 3]]) -> f64 {
    triangles.iter().map(|triangle| triangle_area(triangle.map(|corner| vertices[corner as usize]))).sum()
}
