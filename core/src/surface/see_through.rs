//! Triangles of an object that let light through: in places (cut-outs), in part (blended), or tinted (transmission).

use std::sync::Arc;

use glam::{DMat3, DMat4, Vec2, Vec3, Vec4};

use super::{Corners, Surface};
use crate::scene::{Look, Object, Passage, TextureUse, Through};

const OPAQUE: u32 = u32::MAX;

/// How the triangles of an object let light through. Objects without any have none of this.
#[derive(Debug, PartialEq)]
pub(crate) struct SeeThrough {
    /// Per triangle of the surface: index into `faces`, or `OPAQUE`.
    of_triangle: Vec<u32>,
    faces: Vec<Face>,
    /// Per face: linear RGBA at its corners; empty where the mesh has no colours.
    colors: Vec<[Vec4; 3]>,
    /// Per face: texture coordinates of the pictures of transmission and of thickness; empty where there are none.
    glass_uv: Vec<[[Vec2; 3]; 2]>,
    /// Per material.
    panes: Vec<Option<Pane>>,
}

/// A triangle that lets light through.
#[derive(Debug, PartialEq)]
struct Face {
    /// Texture coordinates of the picture at its corners.
    uv: [Vec2; 3],
    material: u32,
}

#[derive(Debug, PartialEq)]
struct Pane {
    look: Arc<Look>,
    /// What the volume behind one surface leaves of light.
    volume: Vec3,
}

impl SeeThrough {
    /// Of an object whose surface has been built with `scene_from_object`; none where every triangle is opaque.
    pub(crate) fn of(object: &Object, surface: &Surface, scene_from_object: DMat4) -> Option<Arc<SeeThrough>> {
        let scale = DMat3::from_mat4(scene_from_object).determinant().abs().cbrt() as f32;
        let pane = |look: &Option<Arc<Look>>| -> Option<Pane> {
            let look = look.as_ref().filter(|look| look.may_let_light_through())?;
            Some(Pane { look: Arc::clone(look), volume: volume(look, scale, surface.closed) })
        };
        let panes: Vec<Option<Pane>> = object.looks.iter().map(pane).collect();
        if panes.iter().all(Option::is_none) {
            return None;
        }
        let has_pictures = panes.iter().flatten().any(|pane| !pane.is_plain());
        let (mut faces, mut colors, mut glass_uv) = (Vec::new(), Vec::new(), Vec::new());
        let of_face = |(face, &material): (usize, &u32)| {
            let Some(Pane { look, .. }) = panes.get(material as usize).and_then(Option::as_ref) else { return OPAQUE };
            let corners = Corners::new(&object.mesh, surface, face as u32);
            if look.is_opaque_over(|set| corners.texcoords(set), corners.colors.map(|color| color.w)) {
                return OPAQUE;
            }
            let of_picture = |texture: &Option<TextureUse>| match texture {
                Some(texture) => corners.texcoords(texture.texcoord).map(|uv| texture.map(uv)),
                None => [Vec2::ZERO; 3],
            };
            faces.push(Face { uv: of_picture(&look.base_color), material });
            if has_pictures {
                glass_uv.push([of_picture(&look.transmission_texture), of_picture(&look.thickness_texture)]);
            }
            if !object.mesh.colors.is_empty() {
                colors.push(corners.colors);
            }
            faces.len() as u32 - 1
        };
        let of_triangle = surface.triangle_materials.iter().enumerate().map(of_face).collect();
        (!faces.is_empty()).then(|| Arc::new(SeeThrough { of_triangle, faces, colors, glass_uv, panes }))
    }

    /// Triangles of the surface that let light through.
    pub(crate) fn triangles(&self) -> impl Iterator<Item = usize> + '_ {
        self.of_triangle.iter().enumerate().filter(|(_, face)| **face != OPAQUE).map(|(triangle, _)| triangle)
    }

    /// Whether some of them tint light.
    pub(crate) fn is_tinted(&self) -> bool {
        self.panes.iter().flatten().any(|pane| pane.look.transmission > 0.0)
    }

    /// What happens to light at a place of a triangle, given by the barycentric weights of its second and third corner;
    /// none where the triangle is opaque.
    #[inline]
    pub(crate) fn at(&self, triangle: usize, [u, v]: [f32; 2]) -> Option<Passage> {
        let face = self.of_triangle[triangle];
        let Face { uv, material } = self.faces.get(face as usize)?;
        let pane @ Pane { look, volume } = self.panes[*material as usize].as_ref()?;
        let weights = [1.0 - u - v, u, v];
        let place = |uv: &[Vec2; 3]| uv.iter().zip(weights).map(|(corner, w)| *corner * w).sum();
        let through = match self.glass_uv.get(face as usize).filter(|_| !pane.is_plain()) {
            Some(uv) => look.through(uv.each_ref().map(place), *volume),
            None => Through { share: look.transmission, volume: *volume },
        };
        let mean = |corners: &[Vec4; 3]| corners.iter().zip(weights).map(|(corner, w)| *corner * w).sum();
        let color = self.colors.get(face as usize).map_or(Vec4::ONE, mean);
        Some(look.passage(place(uv), color, through))
    }

    /// Bytes held, without textures.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.of_triangle.capacity() * size_of::<u32>()
            + self.faces.capacity() * size_of::<Face>()
            + self.colors.capacity() * size_of::<[Vec4; 3]>()
            + self.glass_uv.capacity() * size_of::<[[Vec2; 3]; 2]>()
            + self.panes.capacity() * size_of::<Pane>()
    }
}

impl Pane {
    /// Whether it lets the same share of light through all over.
    fn is_plain(&self) -> bool {
        self.look.transmission_texture.is_none() && self.look.thickness_texture.is_none()
    }
}

/// What is left of light behind one surface over a volume. Light goes through two surfaces of what is closed, each of them
/// over half of the thickness, and through one of a sheet.
fn volume(look: &Look, scale: f32, closed: bool) -> Vec3 {
    let length = look.thickness * scale * if closed { 0.5 } else { 1.0 };
    if length > 0.0 { (-look.absorption * length).exp() } else { Vec3::ONE }
}
