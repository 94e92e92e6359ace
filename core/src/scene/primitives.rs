//! Objects made in code: for tests, the demo, and anything that needs a scene without a file.
//!
//! All meshes are in object space with the normals outward; lengths are metres.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{DMat4, DVec3, Vec3};

use super::{Light, LightKind, Material, Mesh, Object, Scene};

impl Material {
    /// A single-sided material that reflects `albedo` and emits nothing.
    pub fn diffuse(albedo: Vec3) -> Self {
        Self { albedo, emission: Vec3::ZERO, double_sided: false }
    }

    /// A single-sided black material that emits `radiance`.
    pub fn emissive(radiance: Vec3) -> Self {
        Self { albedo: Vec3::ZERO, emission: radiance, double_sided: false }
    }

    /// A double-sided copy of this material: both sides of a surface reflect and emit.
    #[must_use]
    pub fn double_sided(self) -> Self {
        Self { double_sided: true, ..self }
    }
}

impl Mesh {
    /// A parallelogram with corner `corner` and the sides `u` and `v`; its front is the side of `u × v`.
    pub fn quad(corner: Vec3, u: Vec3, v: Vec3) -> Self {
        let mut mesh = Self::default();
        mesh.add_quad(corner, u, v);
        mesh
    }

    /// An axis-aligned box between two corners, each side flat.
    pub fn cuboid(low: Vec3, high: Vec3) -> Self {
        let (low, high) = (low.min(high), low.max(high));
        let [x, y, z] = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| axis * (high - low));
        let mut mesh = Self::default();
        for [u, v, w] in [[x, y, z], [y, z, x], [z, x, y]] {
            mesh.add_quad(low, v, u);
            mesh.add_quad(low + w, u, v);
        }
        mesh
    }

    /// A sphere around the origin: an icosahedron, each face split into four `levels` times (at most 8 levels:
    /// 1,310,720 triangles), its vertices on the sphere, smooth.
    pub fn icosphere(radius: f32, levels: u32) -> Self {
        let (mut directions, mut triangles) = icosahedron();
        for _ in 0..levels.min(8) {
            let mut middles = BTreeMap::new();
            let mut middle = |a: u32, b: u32| {
                *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    directions.push((directions[a as usize] + directions[b as usize]).normalize());
                    directions.len() as u32 - 1
                })
            };
            let split = |[a, b, c]: [u32; 3]| {
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            };
            triangles = triangles.into_iter().flat_map(split).collect();
        }
        Self {
            positions: directions.iter().map(|&direction| direction * radius).collect(),
            normals: directions,
            triangle_materials: vec![0; triangles.len()],
            triangles,
            ..Self::default()
        }
    }

    /// This surface seen from the other side: a box becomes a room.
    #[must_use]
    pub fn inside_out(mut self) -> Self {
        self.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        self.normals.iter_mut().for_each(|normal| *normal = -*normal);
        self
    }

    fn add_quad(&mut self, corner: Vec3, u: Vec3, v: Vec3) {
        let first = self.positions.len() as u32;
        self.positions.extend([corner, corner + u, corner + u + v, corner + v]);
        self.normals.extend([u.cross(v).normalize_or_zero(); 4]);
        self.triangles.extend([[0, 1, 2], [0, 2, 3]].map(|triangle| triangle.map(|vertex| first + vertex)));
        self.triangle_materials.extend([0; 2]);
    }
}

/// Unit vertices and outward triangles.
fn icosahedron() -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let long = (1.0 + 5.0_f32.sqrt()) / 2.0;
    let mut vertices = Vec::with_capacity(12);
    for (a, b) in [(-1.0, long), (1.0, long), (-1.0, -long), (1.0, -long)] {
        vertices.push(Vec3::new(a, b, 0.0).normalize());
    }
    for (a, b) in [(-1.0, long), (1.0, long), (-1.0, -long), (1.0, -long)] {
        vertices.push(Vec3::new(0.0, a, b).normalize());
    }
    for (a, b) in [(-1.0, long), (1.0, long), (-1.0, -long), (1.0, -long)] {
        vertices.push(Vec3::new(b, 0.0, a).normalize());
    }
    // Faces are the triples of vertices at the least distance from each other.
    let is_near = |a: usize, b: usize| vertices[a].dot(vertices[b]) > 0.4;
    let mut triangles = Vec::with_capacity(20);
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                if is_near(a, b) && is_near(b, c) && is_near(a, c) {
                    let outward = vertices[a].dot(vertices[b].cross(vertices[c])) > 0.0;
                    let [a, b, c] = [a as u32, b as u32, c as u32];
                    triangles.push(if outward { [a, b, c] } else { [a, c, b] });
                }
            }
        }
    }
    (vertices, triangles)
}

impl Object {
    /// An object of one material whose object space is world space.
    pub fn new(name: impl Into<String>, mesh: Mesh, material: Material) -> Self {
        Self {
            name: name.into(),
            mesh: Arc::new(mesh),
            materials: vec![material],
            material_names: vec!["".into()],
            looks: Vec::new(),
            world_from_object: DMat4::IDENTITY,
            is_hidden: false,
            is_inserted: false,
            node: None,
            asset: None,
        }
    }

    /// This object elsewhere.
    #[must_use]
    pub fn placed(self, world_from_object: DMat4) -> Self {
        Self { world_from_object, ..self }
    }

    /// A light per emissive material, named as [`super::load`] names them: the object's name, further ones
    /// `name/2`, `name/3`, …. Colour: the emission divided by its largest part; intensity: that part.
    pub fn emissive_lights(&self) -> Vec<Light> {
        let emissive = self.materials.iter().enumerate().filter(|(_, material)| material.emission != Vec3::ZERO);
        let light = |(number, (index, material)): (usize, (usize, &Material))| {
            let intensity = material.emission.max_element();
            Light {
                name: if number == 0 { self.name.clone() } else { format!("{}/{}", self.name, number + 1) },
                kind: LightKind::Emissive { object: self.name.clone(), material: index as u32 },
                color: material.emission / intensity,
                intensity,
            }
        };
        emissive.enumerate().map(light).collect()
    }
}

impl Object {
    /// Low and high corner of its triangles where they stand, world space, metres. None without triangles.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        let mesh = &self.mesh;
        let corners = mesh.triangles.iter().flatten().map(|&corner| mesh.positions[corner as usize].as_dvec3());
        let corners = corners.map(|corner| self.world_from_object.transform_point3(corner));
        corners.fold(None, |bounds, at| {
            let (low, high) = bounds.unwrap_or((at, at));
            Some((low.min(at), high.max(at)))
        })
    }
}

impl Scene {
    /// Low and high corner of all objects where they stand, world space, metres. None without triangles.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        let all = self.objects.iter().filter_map(|object| object.bounds());
        all.reduce(|(low, high), (l, h)| (low.min(l), high.max(h)))
    }

    /// A scene of objects made in code, with their emissive materials as lights. Its origin is that of the world.
    pub fn from_objects(objects: Vec<Object>) -> Self {
        Self {
            origin: glam::DVec3::ZERO,
            lights: objects.iter().flat_map(Object::emissive_lights).collect(),
            objects: objects.into_iter().map(Arc::new).collect(),
            groups: BTreeMap::new(),
            light_parents: BTreeMap::new(),
            light_nodes: BTreeMap::new(),
            hidden_lights: BTreeMap::new(),
            cameras: Vec::new(),
            asset: None,
            warnings: Vec::new(),
            degenerate_triangles: 0,
        }
    }

    /// Adds a warning where there is no light at all, or none that is on.
    pub fn warn_where_dark(&mut self) {
        self.warnings = self.present_warnings();
    }

    /// Its warnings; whether it is dark is told of the lights that it has now.
    pub fn present_warnings(&self) -> Vec<String> {
        const DARK: &str = "the scene has no light, so its light map is black: add lamps, or light from outside (sky, environment or \
             default_sky)";
        let is_dark = self.lights.iter().all(|light| light.strength() == Vec3::ZERO);
        let others = self.warnings.iter().filter(|warning| *warning != DARK).cloned();
        others.chain(is_dark.then(|| DARK.to_owned())).collect()
    }

    /// This scene with one more light.
    #[must_use]
    pub fn with_light(mut self, light: Light) -> Self {
        self.lights.push(light);
        self
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::surface::Surface;

    #[test]
    fn meshes_have_the_area_and_volume_of_their_shape() {
        let cuboid = Mesh::cuboid(Vec3::new(1.0, 5.0, 3.0), Vec3::new(0.0, 2.0, 1.0));
        let cases = [
            (Mesh::quad(Vec3::ONE, Vec3::X * 2.0, Vec3::Y * 3.0), 6.0, None, 1e-6),
            (cuboid.clone(), 22.0, Some(6.0), 1e-6),
            (cuboid.inside_out(), 22.0, Some(-6.0), 1e-6),
            (Mesh::icosphere(2.0, 5), 16.0 * PI, Some(32.0 / 3.0 * PI), 2e-3),
        ];
        for (mesh, area, volume, tolerance) in cases {
            let object = Object::new("mesh", mesh, Material::diffuse(Vec3::ONE));
            let surface = Surface::build(&object, DMat4::IDENTITY).unwrap();
            surface.validate().unwrap();
            assert!((surface.area() / area - 1.0).abs() < tolerance, "{} {area}", surface.area());
            assert_eq!(surface.closed, volume.is_some());
            assert!(volume.is_none_or(|volume| (surface.volume / volume - 1.0).abs() < tolerance));
        }
    }

    #[test]
    fn icospheres_quadruple_per_level_up_to_their_limit() {
        let triangles = |levels| Mesh::icosphere(1.0, levels).triangles.len();
        assert_eq!([triangles(0), triangles(1), triangles(3), triangles(99)], [20, 80, 1280, 1_310_720]);
    }
}
