//! What surfaces reflect. By place every element has the mean of what its footprint shows, in linear light, so that the
//! energy is right and no texture is read while rays are traced. The cap of the world is applied
//! here and nowhere else: whatever a file, an inserted asset or a repaint says, light ends in a closed room.

use std::sync::Arc;

use glam::Vec3;

use super::layout::Layout;
use crate::scene::{Look, Object};
use crate::surface::{Corners, Surface, barycentrics};

/// A diffuse albedo, linear RGB, as it is told and as light has it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Albedo {
    /// Of the file or the paint, each part in 0..=1.
    pub told: Vec3,
    /// At most what the world allows.
    pub reflected: Vec3,
    /// Somewhere less than what is told.
    pub is_capped: bool,
}

impl Albedo {
    /// Caps what is told at `most`.
    pub(crate) fn new(told: Vec3, most: f32) -> Albedo {
        Albedo { told, reflected: told.min(Vec3::splat(most)), is_capped: told.max_element() > most }
    }
}

/// What an object reflects.
pub(crate) struct Albedos {
    /// Per material: where it is the same all over, else with the mean over the object as what is told.
    pub of_materials: Vec<Albedo>,
    /// Per element of one side, as light has it. None where every material is the same all over.
    pub by_place: Option<Arc<[Vec3]>>,
}

impl Albedos {
    /// The albedos of an object whose elements have these areas, capped at `most`.
    pub(crate) fn new(object: &Object, surface: &Surface, layout: &Layout, areas: &[f32], most: f32) -> Albedos {
        let mut of_materials: Vec<Albedo> = object.materials.iter().map(|m| Albedo::new(m.albedo, most)).collect();
        let by_place = by_place(object, surface, layout).map(|places| {
            let total: f32 = areas.iter().sum();
            if total > 0.0 {
                let mean = places.iter().zip(areas).map(|((told, _), area)| *told * *area).sum::<Vec3>() / total;
                of_materials.iter_mut().for_each(|albedo| albedo.told = mean);
            }
            of_materials.iter_mut().for_each(|albedo| albedo.is_capped = false);
            let reflected = |(told, material): (Vec3, u32)| {
                let albedo = Albedo::new(told, most);
                of_materials[material as usize].is_capped |= albedo.is_capped;
                albedo.reflected
            };
            places.into_iter().map(reflected).collect()
        });
        Albedos { of_materials, by_place }
    }
}

/// Per element of one side: mean of base colour × vertex colour × factor over its cells, weighted by area, holes left
/// out; and a material that it is of. None where every material of an object is the same all over.
fn by_place(object: &Object, surface: &Surface, layout: &Layout) -> Option<Vec<(Vec3, u32)>> {
    let look = |material: usize| object.looks.get(material).and_then(Option::as_deref);
    let is_textured = |material: usize| look(material).is_some_and(|l| l.base_color.is_some() && !l.is_painted);
    let mesh = &*object.mesh;
    let is_white = mesh.colors.iter().all(|color| color.truncate() == Vec3::ONE);
    if is_white && !(0..object.materials.len()).any(is_textured) {
        return None;
    }
    // Of every cell: its elements, and colour and weight of what it shows.
    let cells = layout.of_cells(surface, |patch| {
        let number = surface.triangle_materials[patch.face as usize];
        let material = number as usize;
        let corners = Corners::new(mesh, surface, patch.face);
        let places = patch.corners.map(|corner| barycentrics(corner, surface.corners(patch.face as usize)));
        let uniform = object.materials[material].albedo;
        let (color, weight) = match look(material) {
            Some(look) if look.is_painted => (uniform, 1.0),
            Some(look) => shown(&corners, look, &places),
            None => (uniform * mean_color(&corners, &places), 1.0),
        };
        let [a, b, c] = patch.corners;
        Some((patch.elements, color.clamp(Vec3::ZERO, Vec3::ONE), weight * (b - a).cross(c - a).length(), number))
    });
    let mut sums = vec![(Vec3::ZERO, 0.0_f32, 0); layout.len()];
    for (element, color, weight, number) in
        cells.into_iter().flat_map(|(elements, color, weight, number)| elements.map(|e| (e, color, weight, number)))
    {
        let sum = &mut sums[element as usize];
        *sum = (sum.0 + color * weight, sum.1 + weight, number);
    }
    // An element between holes alone is seen by nobody.
    let mean = |(color, weight, number): (Vec3, f32, u32)| {
        let uniform = || object.materials.get(number as usize).map_or(Vec3::ZERO, |material| material.albedo);
        (if weight > 0.0 { color / weight } else { uniform() }, number)
    };
    Some(sums.into_iter().map(mean).collect())
}

/// Mean vertex colour of a cell, whose corners are given by barycentric weights.
fn mean_color(corners: &Corners, places: &[[f32; 3]; 3]) -> Vec3 {
    places.iter().map(|place| corners.color(*place).truncate()).sum::<Vec3>() / 3.0
}

/// Mean colour of a cell, and the share of it that is no hole.
fn shown(corners: &Corners, look: &Look, places: &[[f32; 3]; 3]) -> (Vec3, f32) {
    let factor = look.factor * mean_color(corners, places);
    let Some(texture) = &look.base_color else { return (factor, 1.0) };
    let mean = texture.mean_over(places.map(|place| corners.texcoord(texture.texcoord, place)));
    (factor * mean.color, mean.weight)
}

#[cfg(test)]
mod tests {
    use glam::{DMat4, Mat2, Vec2, Vec4};

    use super::*;
    use crate::edit::Edit;
    use crate::scene::{AlphaUse, Material, Mesh, Scene, Texture, TextureUse, Wrap};
    use crate::space::Distances;
    use crate::world::{World, WorldOptions};

    /// A square of a metre whose texture is black on the left and white on the right, and transparent on top.
    fn square(alpha: AlphaUse) -> Object {
        let texel = |x: u32, y: u32| {
            [255 * u8::from(x >= 4), 255 * u8::from(x >= 4), 255 * u8::from(x >= 4), 255 * u8::from(y >= 4)]
        };
        let texels: Vec<u8> = (0..64).flat_map(|i| texel(i % 8, i / 8)).collect();
        let texture = Arc::new(Texture::new(8, 8, &texels, alpha, 1 << 20));
        let base_color =
            TextureUse { texture, texcoord: 0, linear: Mat2::IDENTITY, offset: Vec2::ZERO, wrap: [Wrap::Clamp; 2] };
        let look = Look { base_color: Some(base_color), ..Look::plain(Vec3::new(0.5, 0.25, 1.0)) };
        let mut mesh = Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y);
        mesh.texcoords[0] = mesh.positions.iter().map(|p| Vec2::new(p.x, p.y)).collect();
        let mut object = Object::new("square", mesh, Material::diffuse(Vec3::splat(0.3)));
        object.looks = vec![Some(Arc::new(look))];
        object
    }

    fn laid(object: &Object) -> (Vec<Vec3>, Vec<Vec3>) {
        let surface = Surface::build(object, DMat4::IDENTITY).expect("a square");
        let (layout, elements) = Layout::new(&surface, &Distances::even(0.05), 10_000).expect("elements");
        let albedos = Albedos::new(object, &surface, &layout, &elements.areas, 0.95);
        (elements.positions, albedos.by_place.expect("albedos").to_vec())
    }

    #[test]
    fn elements_have_the_mean_of_what_they_show() {
        let (positions, albedos) = laid(&square(AlphaUse::Ignored));
        let mut area = 0.0;
        for (p, albedo) in positions.iter().zip(&albedos) {
            match p.x {
                // A texel is an eighth of the square; the edge between both halves is sharp, footprints are not.
                x if x < 0.4 => assert_eq!(*albedo, Vec3::ZERO),
                x if x > 0.6 => assert!(albedo.distance(Vec3::new(0.5, 0.25, 0.95)) < 1e-3, "{albedo}"),
                _ => area += 1.0,
            }
        }
        assert!(area > 0.0, "some lie between");
        // Where holes are left out, what is left counts in full.
        let (positions, albedos) = laid(&square(AlphaUse::Cutoff(0.5)));
        let holes = positions.iter().zip(&albedos).filter(|(p, _)| p.x > 0.6 && p.y < 0.4);
        assert!(holes.clone().count() > 0 && holes.clone().all(|(_, albedo)| *albedo == Vec3::splat(0.3)));
    }

    #[test]
    fn vertex_colours_count() {
        let mut object =
            Object::new("quad", Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y), Material::diffuse(Vec3::splat(0.5)));
        let mesh = Arc::make_mut(&mut object.mesh);
        mesh.colors = mesh.positions.iter().map(|p| Vec4::new(p.x, 1.0, 0.0, 1.0)).collect();
        let (positions, albedos) = laid(&object);
        let within = |p: &Vec3| p.x > 0.1 && p.x < 0.9 && p.y > 0.1 && p.y < 0.9;
        for (p, albedo) in positions.iter().zip(&albedos).filter(|(p, _)| within(p)) {
            assert!(albedo.distance(Vec3::new(0.5 * p.x, 0.5, 0.0)) < 0.01, "{albedo} at {p}");
        }
    }

    /// One albedo for all of a textured object takes the picture off: the same as if it never had one.
    #[test]
    fn painting_takes_the_picture_off() {
        let options = WorldOptions { spacing: Some(0.1), ..WorldOptions::default() };
        let lamp = Object::new("lamp", Mesh::quad(Vec3::Z, Vec3::X, Vec3::Y), Material::emissive(Vec3::ONE));
        let scene = Scene::from_objects(vec![square(AlphaUse::Ignored), lamp]);
        let textured = World::new(scene, &options).expect("a world");
        let albedo_of = |world: &World| world.objects().next().expect("a square").albedo;
        assert!(albedo_of(&textured).distance(Vec3::new(0.25, 0.125, 0.5)) < 0.02, "{}", albedo_of(&textured));
        let paint = Edit::Material { object: "square".into(), albedo: Vec3::new(0.1, 0.2, 0.3) };
        let painted = textured.apply(&[paint]).expect("paint").after;
        assert!(albedo_of(&painted).distance(Vec3::new(0.1, 0.2, 0.3)) < 1e-6);
        assert_eq!(painted.objects().next().expect("a square").name, "square");
        assert_eq!(painted.element_count(), textured.element_count());
        assert_eq!(painted.scene.lights, textured.scene.lights);
    }

    /// One cap for what is loaded, inserted and painted; what is told of an object is as it was said.
    #[test]
    fn a_world_caps_what_light_meets_wherever_it_comes_from() {
        let white = || Object::new("white", Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y), Material::diffuse(Vec3::ONE));
        let mut tinted = white();
        tinted.name = "tinted".to_owned();
        let mesh = Arc::make_mut(&mut tinted.mesh);
        mesh.colors = mesh.positions.iter().map(|_| Vec4::new(1.0, 0.5, 0.25, 1.0)).collect();
        let asset = Arc::new(Scene::from_objects(vec![white()]));
        for max_albedo in [0.95, 0.9, 1.0] {
            let options = WorldOptions { spacing: Some(0.5), max_albedo, ..WorldOptions::default() };
            let start = World::new(Scene::from_objects(vec![white(), tinted.clone()]), &options).expect("a world");
            let insert = Edit::Insert { asset: asset.clone(), name: "come".into(), transform: DMat4::IDENTITY };
            let paint = ["tinted", "come"].map(|object| Edit::Material { object: object.into(), albedo: Vec3::ONE });
            let inserted = start.apply(&[insert]).expect("an insert").after;
            let painted = inserted.apply(&paint).expect("paint").after;
            let reflected = |world: &World, object: usize| {
                let part = &world.space.parts_of(&world.placed[object].placement)[0];
                part.albedos.as_ref().map_or(part.albedo, |albedos| albedos[0])
            };
            let told = |world: &World| world.objects().map(|object| object.albedo).collect::<Vec<_>>();
            let capped = Vec3::splat(max_albedo);
            assert_eq!([0, 1, 2].map(|i| reflected(&inserted, i)), [capped, Vec3::new(max_albedo, 0.5, 0.25), capped]);
            assert_eq!([0, 1, 2].map(|i| reflected(&painted, i)), [capped; 3]);
            assert!(told(&inserted)[1].distance(Vec3::new(1.0, 0.5, 0.25)) < 1e-6, "{:?}", told(&inserted));
            assert!(told(&painted).iter().all(|told| *told == Vec3::ONE), "{:?}", told(&painted));
        }
    }
}
