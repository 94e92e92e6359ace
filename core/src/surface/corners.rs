//! What a mesh has at the corners of a triangle beside positions.

use glam::{Vec2, Vec4};

use super::Surface;
use crate::scene::Mesh;

/// Texture coordinates and colours at the corners of a surface's triangle, in the order of its corners.
pub(crate) struct Corners {
    /// Both sets; not a number where the mesh has none.
    texcoords: [[Vec2; 3]; 2],
    /// Linear RGBA; one where the mesh has none.
    pub colors: [Vec4; 3],
}

impl Corners {
    pub(crate) fn new(mesh: &Mesh, surface: &Surface, face: u32) -> Corners {
        let source = surface.sources[face as usize];
        let [a, b, c] = mesh.triangles[source.triangle()];
        let vertices = if source.turned() { [a, c, b] } else { [a, b, c] }.map(|vertex| vertex as usize);
        let texcoords = [0, 1].map(|set| vertices.map(|v| mesh.texcoords[set].get(v).copied().unwrap_or(Vec2::NAN)));
        let colors = vertices.map(|v| mesh.colors.get(v).copied().unwrap_or(Vec4::ONE));
        Corners { texcoords, colors }
    }

    /// Of one set; not a number where the mesh has none.
    pub(crate) fn texcoords(&self, set: usize) -> [Vec2; 3] {
        self.texcoords.get(set).copied().unwrap_or([Vec2::NAN; 3])
    }

    /// Of a place given by barycentric weights.
    pub(crate) fn texcoord(&self, set: usize, place: [f32; 3]) -> Vec2 {
        self.texcoords(set).iter().zip(place).map(|(uv, w)| *uv * w).sum()
    }

    /// Of a place given by barycentric weights.
    pub(crate) fn color(&self, place: [f32; 3]) -> Vec4 {
        self.colors.iter().zip(place).map(|(color, w)| *color * w).sum()
    }
}
