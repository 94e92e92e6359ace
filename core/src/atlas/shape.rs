//! A mesh in metres, up to a rotation: what its coordinates depend on, and nothing else.

use std::hash::Hasher;
use std::sync::Arc;

use glam::{DMat3, DVec3};

use crate::hash::WordHasher;
use crate::scene::{Mesh, Object};

/// Relative difference of sizes that counts as none: rounding of transforms.
const SAME_SIZE: f64 = 1e-4;

/// A mesh and its size.
#[derive(Clone, Debug)]
pub(super) struct Shape {
    mesh: Arc<Mesh>,
    /// Object space to metres, up to a rotation or reflection: the upper triangle of QR.
    metres: DMat3,
}

impl Shape {
    /// None where the transform is of no use.
    pub(super) fn of(object: &Object) -> Option<Shape> {
        let metres = upper_triangle(DMat3::from_mat4(object.world_from_object))?;
        Some(Shape { mesh: Arc::clone(&object.mesh), metres })
    }

    pub(super) fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// Vertices in metres, up to a rotation.
    pub(super) fn positions(&self) -> Vec<DVec3> {
        self.mesh.positions.iter().map(|position| self.metres * position.as_dvec3()).collect()
    }

    /// Area, m².
    pub(super) fn area(&self) -> f64 {
        let at = |corner: u32| self.metres * self.mesh.positions[corner as usize].as_dvec3();
        let area = |[a, b, c]: [u32; 3]| (at(b) - at(a)).cross(at(c) - at(a)).length() * 0.5;
        self.mesh.triangles.iter().map(|corners| area(*corners)).sum()
    }

    /// A hash of the content of the mesh, as far as coordinates depend on it.
    pub(super) fn content_hash(&self) -> u64 {
        let mut hasher = WordHasher::default();
        let Mesh { positions, triangles, texcoords, .. } = &*self.mesh;
        hasher.write_usize(positions.len());
        positions.iter().flat_map(|p| p.to_array()).for_each(|x| hasher.write_u32(x.to_bits()));
        triangles.iter().flatten().for_each(|&corner| hasher.write_u32(corner));
        texcoords[1].iter().flat_map(|uv| uv.to_array()).for_each(|x| hasher.write_u32(x.to_bits()));
        hasher.finish()
    }

    /// Whether coordinates of one are right for the other.
    pub(super) fn is_like(&self, other: &Shape) -> bool {
        let size = |metres: &DMat3| metres.to_cols_array().into_iter().fold(0.0, |m: f64, x| m.max(x.abs()));
        let differs = size(&DMat3::from_cols_array(&std::array::from_fn(|k| {
            self.metres.to_cols_array()[k] - other.metres.to_cols_array()[k]
        })));
        differs <= SAME_SIZE * size(&self.metres) && same_content(&self.mesh, &other.mesh)
    }
}

fn same_content(a: &Arc<Mesh>, b: &Arc<Mesh>) -> bool {
    let same = |a: &Mesh, b: &Mesh| {
        a.positions == b.positions && a.triangles == b.triangles && a.texcoords[1] == b.texcoords[1]
    };
    Arc::ptr_eq(a, b) || same(a, b)
}

/// R of M = Q R, with a diagonal that is not negative; none where M is singular.
fn upper_triangle(m: DMat3) -> Option<DMat3> {
    let x = m.x_axis.try_normalize()?;
    let y = (m.y_axis - x * x.dot(m.y_axis)).try_normalize()?;
    let z = m.z_axis - x * x.dot(m.z_axis);
    let z = (z - y * y.dot(z)).try_normalize()?;
    let rotation = DMat3::from_cols(x, y, z);
    let mut upper = rotation.transpose() * m;
    (upper.x_axis.y, upper.x_axis.z, upper.y_axis.z) = (0.0, 0.0, 0.0);
    upper.is_finite().then_some(upper)
}

#[cfg(test)]
mod tests {
    use glam::{DMat4, DQuat, Vec3};

    use super::*;
    use crate::scene::Material;

    #[test]
    fn where_and_how_an_object_stands_does_not_matter_its_size_does() {
        let mesh = Mesh::cuboid(Vec3::ZERO, Vec3::new(1.0, 2.0, 3.0));
        let object = Object::new("a", mesh, Material::diffuse(Vec3::ONE));
        let at = |scale: DVec3, angle: f64| {
            let rotation = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -1.0).normalize(), angle);
            let world_from_object = DMat4::from_scale_rotation_translation(scale, rotation, DVec3::new(9.0, -5.0, 2.0));
            Shape::of(&Object { world_from_object, ..object.clone() })
        };
        let plain = Shape::of(&object).expect("a shape");
        let [turned, mirrored, larger] =
            [at(DVec3::ONE, 1.0), at(DVec3::new(-1.0, 1.0, 1.0), 2.0), at(DVec3::new(1.0, 1.5, 1.0), 2.0)]
                .map(|shape| shape.expect("a shape"));
        assert!(plain.is_like(&turned) && plain.is_like(&mirrored) && !plain.is_like(&larger));
        let distance = |shape: &Shape| (shape.positions()[0] - shape.positions()[7]).length();
        assert!((distance(&plain) - distance(&turned)).abs() < 1e-12 && distance(&larger) > distance(&plain));
        assert!(at(DVec3::new(0.0, 1.0, 1.0), 0.0).is_none() && at(DVec3::NAN, 0.0).is_none());
        let other = Object { mesh: Arc::new(Mesh::cuboid(Vec3::ZERO, Vec3::new(1.0, 2.0, 3.1))), ..object.clone() };
        let other = Shape::of(&other).expect("a shape");
        assert!(!plain.is_like(&other) && plain.content_hash() != other.content_hash());
    }
}
