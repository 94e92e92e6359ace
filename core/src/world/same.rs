//! Whether two worlds are the same to light.

use std::sync::Arc;

use glam::Vec3;

use super::{Placed, World};
use crate::chunks::Chunks;
use crate::scene::Light;
use crate::space::ray_offset;
use crate::surface::Surface;

impl World {
    /// Whether a light map of `other` is right for this world as it is: the same elements in the same slots, the same
    /// surfaces (up to rounding), albedos and lights. Names of objects, the order of things, trees and free slots do
    /// not count.
    pub fn is_lit_like(&self, other: &World) -> bool {
        self.scene.origin == other.scene.origin
            && self.density() == other.density()
            && self.element_count() == other.element_count()
            && self.has_lights_of(other)
            && self.has_objects_of(other)
    }

    fn has_lights_of(&self, other: &World) -> bool {
        let sorted = |world: &World| -> Vec<Light> {
            let mut lights = world.scene.lights.clone();
            lights.sort_by(|a, b| a.name.cmp(&b.name));
            lights
        };
        sorted(self) == sorted(other) && self.scene.groups == other.scene.groups
    }

    fn has_objects_of(&self, other: &World) -> bool {
        fn sorted(world: &World) -> Vec<(&Arc<Placed>, usize)> {
            let counts = world.scene.objects.iter().map(|o| o.materials.len());
            let mut list: Vec<_> =
                world.placed.iter().zip(counts).filter(|(p, _)| !p.surface.triangles.is_empty()).collect();
            list.sort_by_key(|(p, _)| p.placement.elements.start);
            list
        }
        let (a, b) = (sorted(self), sorted(other));
        a.len() == b.len() && a.into_iter().zip(b).all(|(a, b)| self.is_same_object(a, other, b))
    }

    fn is_same_object(&self, a: (&Arc<Placed>, usize), other: &World, b: (&Arc<Placed>, usize)) -> bool {
        let ((a, materials), (b, other_materials)) = (a, b);
        let parts = || {
            let parts = self.space.parts_of(&a.placement).iter().zip(other.space.parts_of(&b.placement));
            parts.take(materials)
        };
        a.placement.elements == b.placement.elements
            && a.with_back == b.with_back
            && materials == other_materials
            && parts().all(|(a, b)| a.reflects_like(b))
            && a.see_through == b.see_through
            && a.facets == b.facets
            && are_same_surfaces(&a.surface, &b.surface)
            && self.has_elements_of(a, other, b)
    }

    /// Surfaces that are the same may be laid out in another order, after another way to where they are.
    fn has_elements_of(&self, a: &Placed, other: &World, b: &Placed) -> bool {
        let own = a.placement.element_indices();
        let are_close = |these: &Chunks<Vec3>, those: &Chunks<Vec3>, tolerance: f32| {
            are_close(these.range(own.clone()), those.range(own.clone()), tolerance)
        };
        Arc::ptr_eq(&a.layout, &b.layout)
            || are_close(self.positions(), other.positions(), tolerance(&a.surface))
                && are_close(self.normals(), other.normals(), SAME_NORMAL)
    }
}

/// Largest difference between unit normals that are the same: a few roundings.
const SAME_NORMAL: f32 = 1e-5;

/// How far vertices of the same surface may lie apart, metres: as far as rays start off it.
fn tolerance(surface: &Surface) -> f32 {
    let (low, high) = surface.bounds();
    ray_offset(low.abs().max(high.abs()), surface.largest_extent())
}

fn are_same_surfaces(a: &Arc<Surface>, b: &Arc<Surface>) -> bool {
    Arc::ptr_eq(a, b)
        || are_close(a.positions.iter(), b.positions.iter(), tolerance(a))
            && are_close(a.normals.iter(), b.normals.iter(), SAME_NORMAL)
            && a.triangles == b.triangles
            && a.triangle_materials == b.triangle_materials
}

/// Moving there and back rounds twice; rays start off a surface by as much as that.
fn are_close<'a>(
    a: impl ExactSizeIterator<Item = &'a Vec3>,
    b: impl ExactSizeIterator<Item = &'a Vec3>,
    tolerance: f32,
) -> bool {
    a.len() == b.len() && a.zip(b).all(|(a, b)| (*a - *b).abs().max_element() <= tolerance)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DMat4, DVec3, Vec3};

    use crate::scene::{Material, Mesh, Object, Scene};
    use crate::{Edit, Relight, World, WorldOptions};

    fn cube(name: &str, at: f32) -> Object {
        let low = Vec3::splat(at);
        Object::new(name, Mesh::cuboid(low, low + Vec3::ONE), Material::diffuse(Vec3::splat(0.5)))
    }

    #[test]
    fn edits_that_cancel_out_are_recognised() {
        let lamp = Object::new("lamp", Mesh::quad(Vec3::Y * 9.0, Vec3::X, Vec3::Z), Material::emissive(Vec3::ONE));
        let scene = Scene::from_objects(vec![cube("a", 0.0), cube("b", 3.0), lamp]);
        let options = WorldOptions { spacing: Some(0.25), ..WorldOptions::default() };
        let start = World::new(scene, &options).expect("a world");
        let apply = |world: &World, edit: Edit| world.apply(&[edit]).expect("an edit").after;
        let asset = Arc::new(Scene::from_objects(vec![cube("c", 6.0)]));
        let insert = Edit::Insert { asset, name: "c".into(), transform: DMat4::IDENTITY };
        let more = apply(&start, insert.clone());
        assert!(!more.is_lit_like(&start));
        let less = apply(&more, Edit::Remove { objects: vec!["c".into()] });
        assert!(less.is_lit_like(&start));
        assert!(apply(&less, insert).is_lit_like(&more), "the same thing at the same place, under another key");

        let step = |to| Edit::Move { object: "b".into(), transform: DMat4::from_translation(DVec3::X * to) };
        let moved = apply(&start, step(2.0));
        assert!(!moved.is_lit_like(&start) && apply(&moved, step(0.0)).is_lit_like(&start));
        let paint = |albedo| Edit::Material { object: "a".into(), albedo: Vec3::splat(albedo) };
        let painted = apply(&start, paint(0.1));
        assert!(!painted.is_lit_like(&start) && apply(&painted, paint(0.5)).is_lit_like(&start));
        let light = start.lights().next().expect("a lamp").light.name.clone();
        let dim = |intensity| Edit::Relight {
            lights: vec![Relight { light: light.clone(), color: None, intensity: Some(intensity) }],
        };
        let was = start.lights().next().expect("a lamp").light.intensity;
        let dimmed = apply(&start, dim(0.5 * was));
        assert!(!dimmed.is_lit_like(&start) && apply(&dimmed, dim(was)).is_lit_like(&start));
    }

    /// An object keeps the order of its elements when it is turned; one that is inserted where that now stands has
    /// another.
    #[test]
    fn elements_in_another_order_are_not_the_same() {
        let options = WorldOptions { spacing: Some(0.25), ..WorldOptions::default() };
        let start = World::new(Scene::from_objects(vec![cube("a", 0.0)]), &options).expect("a world");
        let plate = Object::new("c", Mesh::quad(Vec3::Y * 5.0, Vec3::X, Vec3::Z), Material::diffuse(Vec3::ONE));
        let asset = Arc::new(Scene::from_objects(vec![plate]));
        let insert = |transform| Edit::Insert { asset: Arc::clone(&asset), name: "c".into(), transform };
        let apply = |world: &World, edit: Edit| world.apply(&[edit]).expect("an edit").after;
        let there = apply(&start, insert(DMat4::IDENTITY));
        let mut others = 0;
        for angle in [0.5, 1.0, 1.5].map(|half| half * std::f64::consts::PI) {
            let turned = DMat4::from_rotation_y(angle);
            let moved = apply(&there, Edit::Move { object: "c".into(), transform: turned });
            let inserted = apply(&start, insert(turned));
            let of = |world: &World| Arc::clone(world.placed.last().expect("a plate"));
            let (a, b) = (of(&moved), of(&inserted));
            if a.placement.elements != b.placement.elements {
                continue;
            }
            let apart = |slot: usize| moved.positions()[slot].distance(inserted.positions()[slot]);
            let same = a.placement.element_indices().all(|slot| apart(slot) < 1e-3);
            assert_eq!(moved.has_elements_of(&a, &inserted, &b), same, "turned by {angle}");
            others += u32::from(!same);
        }
        assert!(others > 0, "no turn leaves the number of elements as it is and puts them in another order");
    }
}
