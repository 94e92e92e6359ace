//! The triangles of an object, as it is drawn: its own with places on pages, or the cells between its elements.

use std::collections::BTreeMap;

use glam::{DMat3, DMat4, Vec2, Vec3, Vec4};

use super::primitive::{Primitive, Vertex};
use super::told::Told;
use crate::atlas::{Atlas, Entry};
use crate::scene::Object;
use crate::space::Patch;
use crate::surface::barycentrics;
use crate::world::{Placed, World};

/// Distance between the front and the back of a surface that is drawn twice, in diagonals of the object: neither is
/// seen through the other where both are drawn from both sides, and nobody sees a gap.
const APART: f32 = 1e-4;
/// Weights of corners are multiples of it, so that both sides of an edge agree on it.
const WEIGHT_STEP: f64 = 1.0 / (1 << 20) as f64;

/// Which triangles are one primitive: slot of the material, whether it has normals, whether it is the back.
pub(super) type PrimitiveKey = (u32, bool, bool);

/// An object that is about to be written.
pub(super) struct Drawn<'a> {
    pub(super) item: &'a Object,
    pub(super) placed: &'a Placed,
    pub(super) told: Option<Told<'a>>,
    /// What its vertices are transformed by, since its node cannot say it.
    pub(super) baked: Option<DMat4>,
    /// Its node, as it is written, mirrors.
    pub(super) is_mirrored: bool,
}

/// A corner of a triangle, in the object's space.
#[derive(Clone, Copy)]
struct Corner {
    position: Vec3,
    normal: Vec3,
    sets: [Vec2; 2],
    color: Vec4,
}

/// A triangle of the surface, seen from its front.
struct Face {
    triangle: usize,
    material: u32,
    corners: [Corner; 3],
    /// Unit normal of its plane.
    normal: Vec3,
}

impl Drawn<'_> {
    /// Whether it has a set of texture coordinates.
    pub(super) fn has_texcoords(&self, set: usize) -> bool {
        match &self.told {
            Some(told) => told.has_texcoords(set),
            None => !self.item.mesh.texcoords[set].is_empty(),
        }
    }

    fn face(&self, face: usize) -> Face {
        let (mesh, surface) = (&*self.item.mesh, &self.placed.surface);
        let source = surface.sources[face];
        let triangle = source.triangle();
        let vertices = mesh.triangles[triangle].map(|vertex| vertex as usize);
        let sets = [0, 1].map(|set| match &self.told {
            Some(told) => told.texcoords(triangle, set),
            None => vertices.map(|vertex| mesh.texcoords[set].get(vertex).copied().unwrap_or_default()),
        });
        let corner = |k: usize| Corner {
            position: mesh.positions[vertices[k]],
            normal: mesh.normals.get(vertices[k]).copied().unwrap_or_default(),
            sets: [sets[0][k], sets[1][k]],
            color: mesh.colors.get(vertices[k]).copied().unwrap_or(Vec4::ONE),
        };
        let order = if source.turned() { [0, 2, 1] } else { [0, 1, 2] };
        let corners = order.map(corner);
        let [a, b, c] = corners.map(|corner| corner.position.as_dvec3());
        let mirrors = DMat3::from_mat4(self.item.world_from_object).determinant() < 0.0;
        let normal = (b - a).cross(c - a) * if mirrors { -1.0 } else { 1.0 };
        Face {
            triangle,
            material: surface.triangle_materials[face],
            corners,
            normal: normal.normalize_or_zero().as_vec3(),
        }
    }

    /// Distance of backs, in the object's space.
    fn apart(&self) -> f32 {
        let bound = |pick: fn(Vec3, Vec3) -> Vec3| self.item.mesh.positions.iter().copied().reduce(pick);
        let (low, high) = (bound(Vec3::min).unwrap_or_default(), bound(Vec3::max).unwrap_or_default());
        low.distance(high) * APART
    }

    /// A triangle of a face, counter-clockwise as its front is seen, as it is written.
    fn add(
        &self,
        parts: &mut BTreeMap<PrimitiveKey, Primitive>,
        face: &Face,
        is_back: bool,
        corners: [Vertex; 3],
        apart: f32,
    ) {
        // Nobody sees the back of what has one side.
        if is_back && !self.item.materials.get(face.material as usize).is_some_and(|material| material.double_sided) {
            return;
        }
        let is_smooth = corners.iter().all(|vertex| vertex.normal != Vec3::ZERO);
        let part = parts.entry((face.material, is_smooth, is_back)).or_default();
        if let Some(told) = &self.told {
            part.told_material = told.material(face.triangle);
        }
        let side = |mut vertex: Vertex| {
            if is_back {
                let away = if vertex.normal.dot(face.normal) > 0.0 { vertex.normal } else { face.normal };
                (vertex.position, vertex.normal) = (vertex.position - away * apart, -vertex.normal);
            }
            self.bake(vertex)
        };
        let [a, b, c] = corners.map(side);
        part.add(if self.is_mirrored == is_back { [a, b, c] } else { [a, c, b] });
    }

    fn bake(&self, vertex: Vertex) -> Vertex {
        self.baked.map_or(vertex, |matrix| transformed(vertex, &matrix))
    }

    /// Its own triangles with places on the pages of an atlas: the second set. The file's second set is the third.
    pub(super) fn on_pages(&self, atlas: &Atlas, entry: &Entry) -> BTreeMap<PrimitiveKey, Primitive> {
        let (mut parts, pages, apart) = (BTreeMap::new(), atlas.pages(), self.apart());
        let places: Vec<[Vec2; 3]> = entry.texcoords().collect();
        let has_first = self.has_texcoords(0);
        for (rectangle, is_back) in [(Some(&entry.front), false), (entry.back.as_ref(), true)] {
            let Some(rectangle) = rectangle else { continue };
            let (scale, offset) = entry.to_page(rectangle, pages[rectangle.page]);
            let (scale, offset) = (scale.as_vec2(), offset.as_vec2());
            for index in 0..self.placed.surface.triangles.len() {
                let face = self.face(index);
                let [a, b, c] = places[face.triangle];
                let places = if self.placed.surface.sources[index].turned() { [a, c, b] } else { [a, b, c] };
                let corner = |k: usize| {
                    let Corner { position, normal, sets, color } = face.corners[k];
                    let page = places[k] * scale + offset;
                    // The format knows no second set without a first.
                    let texcoords = [if has_first { sets[0] } else { page }, page, sets[1]];
                    Vertex { position, normal, texcoords, color: color.clamp(Vec4::ZERO, Vec4::ONE), light: Vec3::ZERO }
                };
                self.add(&mut parts, &face, is_back, [corner(0), corner(1), corner(2)], apart);
            }
        }
        parts
    }

    /// The cells between its elements, whose `values` (per element, those of the back behind those of the front) are
    /// vertex colours.
    pub(super) fn by_element(
        &self,
        world: &World,
        values: &[Vec3],
        is_shown: bool,
    ) -> BTreeMap<PrimitiveKey, Primitive> {
        let (mut parts, apart, surface) = (BTreeMap::new(), self.apart(), &self.placed.surface);
        let cells = self.placed.layout.of_cells(surface, |patch| Some(*patch));
        let object_from_world = self.item.world_from_object.inverse();
        let place = |corner: Vec3| object_from_world.transform_point3(corner.as_dvec3() + world.scene.origin).as_vec3();
        let elements = self.placed.layout.len();
        let sides = if self.placed.with_back { 2 } else { 1 };
        let mut last: Option<(u32, Face)> = None;
        for patch in &cells {
            if last.as_ref().is_none_or(|(index, _)| *index != patch.face) {
                last = Some((patch.face, self.face(patch.face as usize)));
            }
            let Some((_, face)) = &last else { continue };
            let corners = surface.corners(patch.face as usize);
            for side in 0..sides {
                let reads = world.shown_at(self.placed, patch, side == 1);
                let corner = |k: usize| {
                    let light = reads[k].of(&values[side * elements..]);
                    let vertex = vertex(face, weights(patch, k, corners), place(patch.corners[k]), light);
                    // The specification has colours end at 1.
                    let color = if is_shown { vertex.color.clamp(Vec4::ZERO, Vec4::ONE) } else { vertex.color };
                    Vertex { color, ..vertex }
                };
                self.add(&mut parts, face, side == 1, [corner(0), corner(1), corner(2)], apart);
            }
        }
        parts
    }

    /// What of it lets all light through, by material of the file: triangles without light.
    pub(super) fn clear(&self) -> BTreeMap<Option<usize>, Primitive> {
        let mut parts: BTreeMap<Option<usize>, Primitive> = BTreeMap::new();
        for piece in self.told.iter().flat_map(|told| &told.pieces) {
            let Some(clear) = &piece.mesh.clear else { continue };
            let mesh = &*clear.mesh;
            let matrix = match (self.baked, piece.object_from_mesh) {
                (Some(outer), Some(inner)) => Some(outer * inner),
                (outer, inner) => outer.or(inner),
            };
            let is_turned = matrix.is_some_and(|matrix| DMat3::from_mat4(matrix).determinant() < 0.0);
            for (triangle, &slot) in mesh.triangles.iter().zip(&mesh.triangle_materials) {
                let corners = triangle.map(|corner| {
                    let corner = corner as usize;
                    let set = |set: usize| mesh.texcoords[set].get(corner).copied().unwrap_or_default();
                    let vertex = Vertex {
                        position: mesh.positions[corner],
                        normal: mesh.normals.get(corner).copied().unwrap_or_default(),
                        texcoords: [set(0), set(1), Vec2::ZERO],
                        color: mesh.colors.get(corner).copied().unwrap_or(Vec4::ONE).clamp(Vec4::ZERO, Vec4::ONE),
                        light: Vec3::ZERO,
                    };
                    matrix.map_or(vertex, |matrix| transformed(vertex, &matrix))
                });
                let [a, b, c] = corners;
                let part = parts.entry(clear.materials[slot as usize]).or_default();
                part.add(if is_turned { [a, c, b] } else { [a, b, c] });
            }
        }
        parts
    }
}

/// Weights of the corners of its face at a corner of a cell.
fn weights(patch: &Patch, k: usize, face: [Vec3; 3]) -> [f64; 3] {
    let rounded = |weight: f32| (f64::from(weight) / WEIGHT_STEP).round() * WEIGHT_STEP;
    let [_, v, w] = barycentrics(patch.corners[k], face).map(rounded);
    let (v, w) = (v.clamp(0.0, 1.0), w.clamp(0.0, 1.0 - v.clamp(0.0, 1.0)));
    [1.0 - v - w, v, w]
}

/// What a face has at a place.
fn vertex(face: &Face, weights: [f64; 3], position: Vec3, light: Vec3) -> Vertex {
    let mix = |pick: &dyn Fn(&Corner) -> Vec4| -> Vec4 {
        let parts = face.corners.iter().zip(weights).map(|(corner, weight)| pick(corner).as_dvec4() * weight);
        parts.sum::<glam::DVec4>().as_vec4()
    };
    let has_normals = face.corners.iter().all(|corner| corner.normal != Vec3::ZERO);
    let normal = mix(&|corner| corner.normal.extend(0.0)).truncate().normalize_or_zero();
    let normal = if has_normals && normal == Vec3::ZERO { face.normal } else { normal };
    let sets = mix(&|corner| Vec4::new(corner.sets[0].x, corner.sets[0].y, corner.sets[1].x, corner.sets[1].y));
    let color = mix(&|corner| corner.color) * light.extend(1.0);
    Vertex {
        position,
        normal: if has_normals { normal } else { Vec3::ZERO },
        texcoords: [Vec2::new(sets.x, sets.y), Vec2::new(sets.z, sets.w), Vec2::ZERO],
        color,
        light,
    }
}

fn transformed(vertex: Vertex, matrix: &DMat4) -> Vertex {
    let turn = DMat3::from_mat4(*matrix).inverse().transpose();
    Vertex {
        position: matrix.transform_point3(vertex.position.as_dvec3()).as_vec3(),
        normal: (turn * vertex.normal.as_dvec3()).normalize_or_zero().as_vec3(),
        ..vertex
    }
}
