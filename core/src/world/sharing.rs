//! What a world has in common with the one before an edit.

use std::sync::Arc;

use glam::{DMat4, DVec3, Vec3};

use super::{World, WorldOptions};
use crate::edit::Edit;
use crate::lightmap::LightMap;
use crate::scene::{Material, Mesh, Object, Scene};

/// A floor of some 40,000 elements with boxes on it, one of which leans into the next.
fn world() -> World {
    let grey = || Material::diffuse(Vec3::splat(0.5));
    let floor = Mesh::quad(Vec3::ZERO, Vec3::Z * 10.0, Vec3::X * 10.0);
    let mut objects = vec![Object::new("floor", floor, grey())];
    for (index, x) in [1.0, 1.3, 5.0, 7.0].into_iter().enumerate() {
        let low = Vec3::new(x, 0.1, 1.0);
        objects.push(Object::new(format!("box {index}"), Mesh::cuboid(low, low + Vec3::splat(0.5)), grey()));
    }
    let options = WorldOptions { spacing: Some(0.05), ..WorldOptions::default() };
    World::new(Scene::from_objects(objects), &options).unwrap()
}

/// Bytes of elements that `after` does not share with `before`.
fn own_bytes(after: &World, before: &World) -> usize {
    let (new, old) = (after.space.slots(), before.space.slots());
    new.positions.own_bytes(&old.positions)
        + new.normals.own_bytes(&old.normals)
        + new.areas.own_bytes(&old.areas)
        + new.owners.own_bytes(&old.owners)
}

#[test]
fn a_move_copies_the_elements_of_what_moves() {
    let before = world();
    let index = |name: &str| before.scene.objects.iter().position(|o| o.name == name).unwrap();
    let (moved, floor) = (index("box 3"), index("floor"));
    let transform = DMat4::from_translation(DVec3::new(0.0, 0.5, 2.0));
    let after = before.apply(&[Edit::Move { object: "box 3".into(), transform }]).unwrap().after;
    // Positions and normals, in whole chunks of 1,024, of which the object's slots begin and end in the middle.
    let moved_elements = before.placed[moved].placement.elements.len();
    assert!(own_bytes(&after, &before) <= (moved_elements + 2 * 1024) * 2 * size_of::<Vec3>());
    assert!(before.element_count() > 30_000 && moved_elements < 3_000, "{moved_elements}");
    for other in (0..before.placed.len()).filter(|other| *other != moved) {
        assert!(Arc::ptr_eq(&after.placed[other], &before.placed[other]));
        assert!(Arc::ptr_eq(&after.scene.objects[other], &before.scene.objects[other]));
    }
    assert!(before.placed[floor].placement.elements.len() > 20_000);
}

#[test]
fn edits_of_lights_and_albedos_copy_no_element() {
    let before = world();
    let paint = Edit::Material { object: "floor".into(), albedo: Vec3::splat(0.2) };
    let after = before.apply(&[paint]).unwrap().after;
    assert!(after.space.has_slots_of(&before.space));
    assert!(Arc::ptr_eq(&after.validity, &before.validity));
}

#[test]
fn a_map_is_carried_over_as_it_is_where_slots_stay() {
    let before = world();
    let map = Arc::new(LightMap::black(before.slots()));
    let paint = Edit::Material { object: "floor".into(), albedo: Vec3::splat(0.2) };
    assert!(Arc::ptr_eq(&before.apply(&[paint]).unwrap().carried(&map), &map));
    let transition = before.apply(&[Edit::Remove { objects: vec!["box 1".into()] }]).unwrap();
    let carried = transition.carried(&map);
    assert!(!Arc::ptr_eq(&carried, &map) && carried.len() == transition.after.slots());
}
