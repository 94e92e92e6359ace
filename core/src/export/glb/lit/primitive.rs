//! Triangles of one material, with a vertex for all corners that are the same.

use ::gltf::json::Value;
use glam::{Vec2, Vec3, Vec4};

use super::super::container::{Document, object};
use crate::hash::FastMap;

/// A corner, in the space of its node.
#[derive(Clone, Copy, Debug)]
pub(super) struct Vertex {
    pub(super) position: Vec3,
    /// Zero: flat.
    pub(super) normal: Vec3,
    pub(super) texcoords: [Vec2; 3],
    pub(super) color: Vec4,
    pub(super) light: Vec3,
}

impl Vertex {
    fn bits(&self) -> [u32; 19] {
        let [uv, st, pq] = self.texcoords;
        let mut bits = [0; 19];
        let numbers = self.position.to_array().into_iter().chain(self.normal.to_array());
        let numbers = numbers.chain([uv, st, pq].into_iter().flat_map(|uv| uv.to_array()));
        let numbers = numbers.chain(self.color.to_array()).chain(self.light.to_array());
        // Adding zero makes both zeros one.
        bits.iter_mut().zip(numbers).for_each(|(bits, number)| *bits = (number + 0.0).to_bits());
        bits
    }
}

/// A primitive while it is made.
#[derive(Default)]
pub(super) struct Primitive {
    ids: FastMap<[u32; 19], u32>,
    vertices: Vec<Vertex>,
    triangles: Vec<[u32; 3]>,
    /// Index in the file of its material.
    pub(super) told_material: Option<usize>,
}

/// Which attributes are written.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Attributes {
    /// Sets of texture coordinates.
    pub(super) texcoords: usize,
    /// `COLOR_0` also where it is white.
    pub(super) has_color: bool,
    /// `_LIGHT`.
    pub(super) has_light: bool,
}

impl Primitive {
    pub(super) fn add(&mut self, corners: [Vertex; 3]) {
        let ids = corners.map(|vertex| {
            let vertices = &mut self.vertices;
            *self.ids.entry(vertex.bits()).or_insert_with(|| {
                vertices.push(vertex);
                vertices.len() as u32 - 1
            })
        });
        // What has collapsed to a line is not drawn.
        if ids[0] != ids[1] && ids[1] != ids[2] && ids[2] != ids[0] {
            self.triangles.push(ids);
        }
    }

    /// Writes it as a primitive; none where there is nothing.
    pub(super) fn write(&self, document: &mut Document, attributes: Attributes, material: Value) -> Option<Value> {
        if self.triangles.is_empty() {
            return None;
        }
        let list = |pick: fn(&Vertex) -> Vec3| self.vertices.iter().map(pick).collect::<Vec<_>>();
        let mut written = vec![("POSITION", document.add_vec3(&list(|vertex| vertex.position), true))];
        if self.vertices.iter().all(|vertex| vertex.normal != Vec3::ZERO) {
            written.push(("NORMAL", document.add_vec3(&list(|vertex| vertex.normal), false)));
        }
        for (set, name) in ["TEXCOORD_0", "TEXCOORD_1", "TEXCOORD_2"].into_iter().enumerate().take(attributes.texcoords)
        {
            let places: Vec<Vec2> = self.vertices.iter().map(|vertex| vertex.texcoords[set]).collect();
            written.push((name, document.add_vec2(&places)));
        }
        let colors: Vec<Vec4> = self.vertices.iter().map(|vertex| vertex.color).collect();
        if colors.iter().any(|color| color.w != 1.0) {
            written.push(("COLOR_0", document.add_vec4(&colors)));
        } else if attributes.has_color || colors.iter().any(|color| *color != Vec4::ONE) {
            written.push(("COLOR_0", document.add_vec3(&list(|vertex| vertex.color.truncate()), false)));
        }
        if attributes.has_light {
            written.push(("_LIGHT", document.add_vec3(&list(|vertex| vertex.light), false)));
        }
        Some(object([
            ("attributes", object(written)),
            ("indices", document.add_indices(&self.triangles)),
            ("material", material),
        ]))
    }
}
