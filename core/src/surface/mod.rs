//! The surface of one object in scene space: the triangles of its file that have an area, welded. Rays meet these;
//! light has a resolution of its own (`space`).

mod build;
mod corners;
mod facets;
mod place;
mod see_through;
#[cfg(test)]
mod tests;
mod topology;
mod touching;
mod weld;

pub use self::build::object_area;

pub(crate) use self::build::{barycentrics, triangle_area};
pub(crate) use self::corners::Corners;
pub(crate) use self::facets::{Facet, Facets, facet_area};
pub(crate) use self::place::{ROUNDED, bounds_of, moved_normals, moved_points, overlap};
pub(crate) use self::see_through::SeeThrough;
pub(crate) use self::weld::{MIN_COSINE, geometric_normal};

use glam::Vec3;

/// An object's triangles in scene space, welded: vertices differ in position or normal.
#[derive(Clone, Debug, Default)]
pub struct Surface {
    /// Vertex positions, metres; never −0, so that equal means bitwise equal.
    pub positions: Vec<Vec3>,
    /// Unit shading normals per vertex, on the front's side of all triangles there.
    pub normals: Vec<Vec3>,
    /// Vertex indices, counter-clockwise seen from the front (the side the normals point to).
    pub triangles: Vec<[u32; 3]>,
    /// Per triangle: index into the object's materials.
    pub triangle_materials: Vec<u32>,
    /// Per triangle: where it comes from.
    pub sources: Vec<FileTriangle>,
    /// Triangles of the mesh that have no area in scene space and were dropped.
    pub dropped: u32,
    /// Every edge is shared by exactly two triangles of opposite direction: the surface bounds a volume.
    pub closed: bool,
    /// Signed volume, m³ (positive: normals point outward). Meaningful where `closed`.
    pub volume: f64,
}

/// A triangle of the mesh: texture coordinates and vertex colours are read there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileTriangle(u32);

impl FileTriangle {
    const TURNED: u32 = 1 << 31;

    pub(crate) fn new(triangle: u32, turned: bool) -> FileTriangle {
        FileTriangle(triangle | if turned { FileTriangle::TURNED } else { 0 })
    }

    /// Index of the triangle in the mesh.
    pub fn triangle(self) -> usize {
        (self.0 & !FileTriangle::TURNED) as usize
    }

    /// Whether the second and third corner have changed places, since the object is mirrored or its winding opposes its
    /// normals.
    pub fn turned(self) -> bool {
        self.0 & FileTriangle::TURNED != 0
    }
}

/// Why an object has no surface, or no elements.
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
