//! The surface of one object, subdivided until neighbouring vertices are at most `spacing` apart. Its vertices are
//! the elements of the light map.

mod build;
mod elements;
mod hash;
mod order;
mod place;
mod subdivide;
#[cfg(test)]
mod tests;
mod topology;
mod weld;

pub use self::build::{DEFAULT_ELEMENTS, build_all, default_spacing, object_area};

use glam::Vec3;

/// A subdivided object in scene space. Element `i` of the object is vertex `i`.
#[derive(Clone, Debug, Default)]
pub struct Surface {
    /// Vertex positions: corners of `triangles`.
    pub vertices: Vec<Vec3>,
    /// Sample points: where an element's value is evaluated. Equal to the vertex inside a surface, moved by a small
    /// part of the spacing into the surface at its borders and hard edges.
    pub positions: Vec<Vec3>,
    /// Unit normals at the sample points.
    pub normals: Vec<Vec3>,
    /// A third of the area of the adjacent triangles, m². Sums to the area of the surface.
    pub areas: Vec<f32>,
    /// Element indices per triangle, counter-clockwise seen from the front (the side the normals point to).
    pub triangles: Vec<[u32; 3]>,
    /// Per triangle: index into the object's materials.
    pub triangle_materials: Vec<u32>,
    /// Every edge is shared by exactly two triangles of opposite direction: the surface bounds a volume.
    pub closed: bool,
    /// Signed volume, m³ (positive: normals point outward). Meaningful where `closed`.
    pub volume: f64,
}

/// Why an object has no surface.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SurfaceError {
    /// The spacing (metres) is not a positive number.
    #[error("the spacing must be a positive number of metres, not {0}")]
    Spacing(f32),
    /// The transform cannot be inverted, or takes positions beyond what `f32` can hold.
    #[error("the transform is not finite or squeezes the object flat")]
    Transform,
    /// The lists of the mesh do not fit together.
    #[error("the mesh refers to vertices or materials that do not exist")]
    Mesh,
    /// The subdivision has too many elements.
    #[error("the light map would have more than {limit} elements: choose a larger spacing")]
    TooManyElements {
        /// The greatest number allowed.
        limit: usize,
    },
}
