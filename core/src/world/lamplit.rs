//! Whether lamps shine on backs. Rays from elements find only what is seen from where elements are: nothing has elements
//! inside of an empty room whose normals face out, and nothing sees a roof from above.

use std::ops::Range;

use glam::Vec3;

use super::{Emitter, Placed, World};
use crate::bvh::Ray;
use crate::random::Pcg32;
use crate::sampling::cosine_hemisphere;

/// Pairs of an element and a lamp that are asked per object.
const TESTS: u32 = 256;

/// A side is lit from this part of them on: rays along edges may slip through.
const LIT: f64 = 0.02;

/// Lamps that are asked about per object: the nearest.
const LAMPS: usize = 8;

/// From this part of all elements on that get light from afar, a scene is seen from outside.
const OUTDOORS: f64 = 0.25;

/// What may shine on backs.
pub(super) struct Lamps<'a> {
    world: &'a World,
    /// Those with a place.
    near: Vec<&'a Emitter>,
    /// Sun and sky.
    far: Vec<&'a Emitter>,
    /// Whether outsides are looked at. The sun shines on a house, too, whose rooms are.
    is_outdoors: bool,
}

impl<'a> Lamps<'a> {
    /// Those of a world that `is_asked` about.
    pub(super) fn new(world: &'a World, is_asked: impl Fn(&Emitter) -> bool) -> Lamps<'a> {
        let asked = world.emitters.all().filter(|emitter| is_asked(emitter));
        let (near, far): (Vec<&Emitter>, Vec<&Emitter>) = asked.partition(|emitter| emitter.sphere().is_some());
        let mut lamps = Lamps { world, near, far, is_outdoors: false };
        let slots = 0..world.slots() as u32;
        lamps.is_outdoors = !slots.is_empty() && lamps.share(slots, &lamps.far, false, 7) >= OUTDOORS;
        lamps
    }

    /// Whether there is none.
    pub(super) fn is_empty(&self) -> bool {
        self.near.is_empty() && self.far.is_empty()
    }

    /// Whether they shine on the back of an object.
    pub(super) fn reach_back_of(&self, placed: &Placed) -> bool {
        let first = placed.placement.elements.start;
        let front = first..first + placed.layout.len() as u32;
        let are_lit = |lamps: &[&Emitter], back| self.share(front.clone(), lamps, back, placed.key) >= LIT;
        let near = self.nearest(placed);
        if are_lit(&near, true) {
            return true;
        }
        let all: Vec<&Emitter> = near.iter().chain(&self.far).copied().collect();
        are_lit(&self.far, true) && (self.is_outdoors || !are_lit(&all, false) && !self.sees_anything(front.clone()))
    }

    /// Lamps beside an object that are not its own.
    fn nearest(&self, placed: &Placed) -> Vec<&'a Emitter> {
        let (low, high) = placed.surface.bounds();
        let distance = |emitter: &Emitter| {
            let (center, _) = emitter.sphere()?;
            (emitter.object != Some(placed.key)).then(|| center.distance_squared(center.clamp(low, high)))
        };
        let mut near: Vec<(f32, &Emitter)> = self.near.iter().filter_map(|e| Some((distance(e)?, *e))).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        near.truncate(LAMPS);
        near.into_iter().map(|(_, emitter)| emitter).collect()
    }

    /// Of pairs of an element and a lamp, the part in which the one shines on the other: on its front or its `back`.
    fn share(&self, slots: Range<u32>, lamps: &[&Emitter], back: bool, seed: u32) -> f64 {
        if lamps.is_empty() || slots.is_empty() {
            return 0.0;
        }
        let mut rng = Pcg32::new(0x1a3b, u64::from(seed));
        let is_lit = |_: &u32| {
            let slot = slots.start + rng.next_below(slots.len()) as u32;
            let lamp = lamps[rng.next_below(lamps.len())];
            shines(self.world, lamp, self.world.side_of(slot as usize, back), rng.next_2d())
        };
        (0..TESTS).filter(is_lit).count() as f64 / f64::from(TESTS)
    }

    /// Whether any surface is seen from some elements.
    fn sees_anything(&self, slots: Range<u32>) -> bool {
        let mut rng = Pcg32::new(0x1a3c, u64::from(slots.start));
        (0..TESTS).any(|_| {
            let slot = slots.start + rng.next_below(slots.len()) as u32;
            let (origin, n) = self.world.ray_origin(slot as usize);
            let direction = cosine_hemisphere(n, rng.next_2d());
            self.world.trees.closest_hit(&Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY }).is_some()
        })
    }
}

impl World {
    /// A point just off an element, on its side or the other, and the normal there.
    fn side_of(&self, slot: usize, back: bool) -> (Vec3, Vec3) {
        let (point, n) = self.ray_origin(slot);
        if back { (self.positions()[slot] * 2.0 - point, -n) } else { (point, n) }
    }
}

/// Whether one sample of a lamp arrives at a point with a normal.
fn shines(world: &World, lamp: &Emitter, (point, n): (Vec3, Vec3), u: [f32; 2]) -> bool {
    if lamp.is_below_horizon(point, n) {
        return false;
    }
    let Some(sample) = lamp.sample(point, n, u).filter(|sample| sample.weight > 0.0) else { return false };
    let ray =
        Ray { origin: point, direction: sample.direction, t_min: 0.0, t_max: sample.distance - sample.end(point) };
    world.trees.transmittance(&ray) != Vec3::ZERO
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DMat4, DVec3};

    use super::*;
    use crate::edit::Edit;
    use crate::scene::{Light, LightKind, Material, Mesh, Object, Scene};
    use crate::world::{World, WorldOptions};
    use crate::{Budget, Unobserved, bake, update};

    fn white() -> Material {
        Material::diffuse(Vec3::splat(0.5)).double_sided()
    }

    fn world(objects: Vec<Object>, lights: &[LightKind]) -> World {
        let mut scene = Scene::from_objects(objects);
        let light = |(k, kind): (usize, &LightKind)| Light {
            name: format!("lamp {k}"),
            kind: kind.clone(),
            color: Vec3::ONE,
            intensity: 1.0,
        };
        scene.lights = lights.iter().enumerate().map(light).collect();
        let options = WorldOptions { spacing: Some(0.25), ..WorldOptions::default() };
        World::new(scene, &options).expect("a test scene")
    }

    fn bulb(position: DVec3) -> LightKind {
        LightKind::Point { position, range: None }
    }

    fn sun_from_above() -> LightKind {
        LightKind::Directional { direction: Vec3::new(0.1, -1.0, 0.05).normalize(), angle: 0.0 }
    }

    /// A room of 3 × 2 × 3 m that nothing stands in, and whose normals face out.
    fn empty_room() -> Object {
        Object::new("room", Mesh::cuboid(Vec3::ZERO, Vec3::new(3.0, 2.0, 3.0)), white())
    }

    /// A square at some height, facing up or down: the lower the larger.
    fn sheet(name: &str, height: f32, faces_up: bool) -> Object {
        let side = 4.0 - height;
        let mesh = Mesh::quad(Vec3::new(-0.5 * side, height, -0.5 * side), Vec3::Z * side, Vec3::X * side);
        Object::new(name, if faces_up { mesh } else { mesh.inside_out() }, white())
    }

    fn have_backs(world: &World) -> Vec<bool> {
        world.placed.iter().map(|placed| placed.with_back).collect()
    }

    /// Φ / A / (1 − ρ) is the mean of all light over π in a closed room, with a bulb of Φ = 4π.
    #[test]
    fn an_empty_room_that_faces_out_has_light_inside() {
        let lamp = bulb(DVec3::new(1.2, 1.1, 1.4));
        let lit = world(vec![empty_room()], std::slice::from_ref(&lamp));
        let dark = world(vec![empty_room()], &[]);
        assert_eq!((have_backs(&lit), have_backs(&dark)), (vec![true], vec![false]));
        let budget = Budget { samples_per_element: 64, target_rmse: None };
        let old = bake(&dark, &budget, 1, &Unobserved).expect("nobody cancels");
        let insert = Edit::InsertLight { name: "bulb".into(), kind: lamp, color: Vec3::ONE, intensity: 1.0 };
        let transition = dark.apply(&[insert]).expect("a lamp");
        let later = update(&transition, &old, &budget, None, 1, &Unobserved).expect("nobody cancels");
        for (world, map) in
            [(&lit, bake(&lit, &budget, 1, &Unobserved).expect("nobody cancels")), (&transition.after, later)]
        {
            let inside = world.placed[0].sides().nth(1).expect("a back");
            let sum = |f: &dyn Fn(usize) -> f32| inside.clone().map(|s| f64::from(f(s as usize))).sum::<f64>();
            let area = sum(&|slot| world.areas()[slot]);
            let mean = sum(&|slot| world.areas()[slot] * map.total(slot).y) / area;
            assert!((area - 42.0).abs() < 0.1, "{area}");
            assert!((mean / (4.0 / 42.0 / 0.5) - 1.0).abs() < 0.02, "{mean}");
        }
    }

    #[test]
    fn a_roof_that_faces_down_is_sunlit_on_top() {
        let scene = vec![sheet("ground", 0.0, true), sheet("roof", 3.0, false)];
        assert_eq!(have_backs(&world(scene.clone(), &[sun_from_above()])), [false, true]);
        assert_eq!(have_backs(&world(scene, &[bulb(DVec3::new(0.0, 2.0, 0.0))])), [false, false]);
        assert_eq!(have_backs(&world(vec![sheet("ground", 0.0, false)], &[sun_from_above()])), [true]);
    }

    #[test]
    fn the_sun_on_a_house_gives_rooms_no_outside() {
        let mesh = Mesh::cuboid(Vec3::ZERO, Vec3::new(3.0, 2.0, 3.0)).inside_out();
        let house = |lights: &[LightKind]| have_backs(&world(vec![Object::new("room", mesh.clone(), white())], lights));
        assert_eq!(house(&[sun_from_above(), bulb(DVec3::ONE)]), [false]);
        assert_eq!(house(&[sun_from_above(), bulb(DVec3::new(1.0, 1.0, -2.0))]), [true]);
    }

    #[test]
    fn what_is_inserted_and_a_lamp_that_moves_show_backs() {
        let dark = world(vec![sheet("ground", 0.0, true)], &[bulb(DVec3::new(0.0, 5.0, 0.0))]);
        let insert = |y: f64, faces_up| Edit::Insert {
            asset: Arc::new(Scene::from_objects(vec![sheet("s", 0.0, faces_up)])),
            name: format!("sheet {y}"),
            transform: DMat4::from_translation(DVec3::Y * y),
        };
        let edits = [insert(2.0, true), insert(3.0, false)];
        let after = dark.apply(&edits).expect("two sheets").after;
        // The ground sees the one from below; the lamp shines on the other from above, and each sees the other's front.
        assert_eq!(have_backs(&after), [false, true, true]);
        let alone = world(vec![sheet("ground", 0.0, true)], &[bulb(DVec3::new(0.0, 5.0, 0.0))]);
        let down = Edit::MoveLight {
            light: "lamp 0".into(),
            position: Some(DVec3::new(0.0, -1.0, 0.0)),
            direction: None,
            own_layer: false,
        };
        assert_eq!(have_backs(&alone.apply(&[down]).expect("a lamp").after), [true]);
    }
}
