//! Which elements of one surface see each other. Light of one side of a wall must not be interpolated to the other.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::buried::behind_surfaces;
use super::validity::part_of;
use super::{Placed, World};
use crate::bits::Bits;
use crate::bvh::Ray;
use crate::space::{Patch, ray_offset};
use crate::surface::{ROUNDED, bounds_of, overlap};

/// Height above the surface at which sight is asked for, in spacings.
const LIFT: f32 = 0.05;

/// Part of the way between two points that is left out at both ends: walls may begin there.
const ENDS: f32 = 0.02;

/// Entries of an object's coarse weights whose representative the element does not see.
#[derive(Clone, Debug, Default)]
pub(crate) struct Hidden {
    /// Front, then back.
    hidden: Bits,
    entries: usize,
}

impl Hidden {
    /// Bytes held.
    pub(super) fn memory_bytes(&self) -> usize {
        self.hidden.memory_bytes()
    }

    /// Whether nothing is hidden.
    #[inline]
    pub(crate) fn is_empty(&self) -> bool {
        self.hidden.is_empty()
    }

    /// Whether an entry of the front or the back is hidden.
    #[inline]
    pub(crate) fn contains(&self, back: bool, entry: usize) -> bool {
        self.hidden.contains(entry + if back { self.entries } else { 0 })
    }
}

/// What was found for one object: nothing where nothing has changed; ids of cells with whether they are cut.
type Seen = (Option<Hidden>, Vec<(u32, bool)>);

/// Boxes in which geometry has changed; `None` is everywhere.
pub(super) type Touched<'a> = Option<&'a [(Vec3, Vec3)]>;

impl World {
    /// How far above a surface sight is asked for at a point, metres.
    #[inline]
    pub(crate) fn lift(&self, point: Vec3) -> f32 {
        (LIFT * self.resolution.smooth).max(4.0 * ray_offset(point, 0.0))
    }

    /// Asks anew where geometry has changed, and everywhere for objects that are new.
    pub(super) fn look_around(&mut self, touched: Touched, is_new: impl Fn(&Placed) -> bool + Sync) {
        let world = &*self;
        let found: Vec<Seen> = world
            .placed
            .par_iter()
            .map(|placed| {
                let old = world.sight.get(&placed.key);
                let touched = if is_new(placed) { None } else { touched };
                if !world.is_near(touched, placed) {
                    return (None, Vec::new());
                }
                (Some(hidden_entries(world, placed, touched, old.map(|o| &**o))), cut_cells(world, placed, touched))
            })
            .collect();
        let (mut sight, mut cuts) = (BTreeMap::new(), Vec::new());
        for (placed, (hidden, cut)) in self.placed.iter().zip(found) {
            let old = || self.sight.get(&placed.key).cloned();
            sight.insert(placed.key, hidden.map(Arc::new).or_else(old).unwrap_or_default());
            cuts.extend(cut);
        }
        self.sight = sight;
        self.space.set_cuts(cuts);
    }

    /// Finds the elements that a surface cuts off from their cells, anew where geometry has changed: they take their
    /// neighbours' values from then on, and cells at them are cut.
    pub(super) fn find_behind(&mut self, touched: Touched, is_new: impl Fn(&Placed) -> bool + Sync) {
        let world = &*self;
        let of_object = |placed: &Arc<Placed>| -> Vec<u32> {
            let touched = if is_new(placed) { None } else { touched };
            match world.is_near(touched, placed) {
                true => behind_surfaces(world, placed, touched),
                false => world.validity.behind_of(&placed.placement.elements).to_vec(),
            }
        };
        let mut behind: Vec<u32> = world.placed.par_iter().flat_map_iter(of_object).collect();
        behind.sort_unstable();
        if behind == world.validity.behind() {
            return;
        }
        // Cells at the others are cut already.
        let was_behind = |slot: &u32| world.validity.behind().binary_search(slot).is_ok();
        let fresh: Vec<u32> = behind.iter().copied().filter(|slot| !was_behind(slot)).collect();
        let cells: Vec<(u32, bool)> =
            world.placed.par_iter().flat_map_iter(|placed| cells_at(world, placed, &fresh)).collect();
        self.validity = Arc::new(world.validity.with_behind(world, &behind));
        self.space.set_cuts(cells);
    }

    /// Whether geometry has changed on an object or beside it.
    fn is_near(&self, touched: Touched, placed: &Placed) -> bool {
        let (low, high) = placed.surface.bounds();
        let grown = (low - self.spacing(), high + self.spacing());
        touched.is_none_or(|boxes| boxes.iter().any(|b| overlap(b, &grown)))
    }

    /// Whether two elements that do not lie on one plane see each other, over what bulges between them.
    pub(super) fn blocked_over(&self, a: u32, b: u32) -> bool {
        let [from, to] = [a, b].map(|slot| (self.above(slot), self.normals()[slot as usize]));
        let middle = over_bulge(from, to);
        self.blocked(from.0, middle) || self.blocked(middle, to.0)
    }

    fn blocked(&self, from: Vec3, to: Vec3) -> bool {
        let ray = Ray { origin: from, direction: to - from, t_min: ENDS, t_max: 1.0 - ENDS };
        from != to && self.trees.any_hiding(&ray)
    }
}

/// Half way between two points of a surface that may be round, given with their unit normals: on a circle, where their
/// tangents meet.
pub(crate) fn over_bulge(from: (Vec3, Vec3), to: (Vec3, Vec3)) -> Vec3 {
    let bulge = 0.25 * (to.0 - from.0).dot(to.1 - from.1);
    from.0.midpoint(to.0) + (from.1 + to.1).normalize_or_zero() * bulge.max(0.0)
}

/// Whether geometry has changed about the way between two points.
pub(super) fn is_touched(touched: Touched, a: Vec3, b: Vec3) -> bool {
    touched.is_none_or(|boxes| boxes.iter().any(|x| overlap(x, &(a.min(b), a.max(b)))))
}

/// What `f` makes of the cells of an object about which geometry may have changed.
pub(super) fn of_touched_cells<T: Send>(
    placed: &Placed,
    touched: Touched,
    f: impl Fn(&Patch) -> Option<T> + Sync,
) -> Vec<T> {
    match touched {
        Some(boxes) => placed.layout.of_cells_in(&placed.surface, boxes, f),
        None => placed.layout.of_cells(&placed.surface, f),
    }
}

/// Entries between an element and a representative that do not see each other, just above the surface. Those of elements
/// that are far from what has changed stay as they were.
fn hidden_entries(world: &World, placed: &Placed, touched: Touched, old: Option<&Hidden>) -> Hidden {
    let coarse = &placed.coarse;
    let n = placed.layout.len() as u32;
    let entries = coarse.entry_count();
    let sides = if placed.with_back { 2 } else { 1 };
    let touched = touched.filter(|_| old.is_some());
    let reach = Vec3::splat(ROUNDED * coarse.reach);
    let asked: Vec<(usize, bool)> = (0..sides * n)
        .into_par_iter()
        .with_min_len(256)
        .flat_map_iter(|i| {
            let (back, element) = (i >= n, i % n);
            let first = placed.placement.elements.start + if back { n } else { 0 };
            let from = world.above(first + element);
            let lift = Vec3::splat(2.0 * world.lift(from));
            let range = match is_touched(touched, from - reach - lift, from + reach + lift) {
                true => coarse.range_of(element),
                false => 0..0,
            };
            range.filter_map(move |e| {
                let to = world.above(first + coarse.representatives[coarse.representative_of(e)]);
                let entry = e + if back { entries } else { 0 };
                is_touched(touched, from, to).then(|| (entry, world.blocked(from, to)))
            })
        })
        .collect();
    let mut hidden = touched.and(old).map_or_else(Bits::default, |old| old.hidden.clone());
    asked.into_iter().for_each(|(entry, is_hidden)| hidden.set(entry, is_hidden));
    Hidden { hidden, entries }
}

/// Cells of an object at some of `slots`, ascending: they are cut.
fn cells_at(world: &World, placed: &Placed, slots: &[u32]) -> Vec<(u32, bool)> {
    let own = part_of(slots, &placed.placement.elements);
    if own.is_empty() {
        return Vec::new();
    }
    let around = bounds_of(own.iter().map(|&slot| world.positions()[slot as usize]));
    placed.layout.of_cells_in(&placed.surface, &[around], |patch| {
        let is_own = |slot: u32| own.binary_search(&slot).is_ok();
        let at = placed.sides().any(|side| patch.elements.iter().any(|e| is_own(side.start + e)));
        at.then_some((placed.placement.cells.start + patch.cell, true))
    })
}

/// Cells whose corners were asked whether they see each other, and whether some do not, or are no places of their own.
fn cut_cells(world: &World, placed: &Placed, touched: Touched) -> Vec<(u32, bool)> {
    let positions = world.positions();
    let n = placed.layout.len() as u32;
    let cut_on = |slots: [u32; 3], is_shared: bool| {
        let valid = slots.map(|slot| world.validity.is_valid(slot as usize));
        let above = slots.map(|slot| world.above(slot));
        let is_blocked = |k: usize, next: usize| match is_shared {
            true => world.blocked_over(slots[k], slots[next]),
            false => world.blocked(above[k], above[next]),
        };
        valid != [true; 3] || (0..3).any(|k| is_blocked(k, (k + 1) % 3))
    };
    of_touched_cells(placed, touched, |patch| {
        let slots = patch.elements.map(|element| placed.placement.elements.start + element);
        let [a, b, c] = slots.map(|slot| positions[slot as usize]);
        if !(is_touched(touched, a, b) || is_touched(touched, b, c) || is_touched(touched, c, a)) {
            return None;
        }
        let is_shared = placed.layout.is_shared();
        let cut = cut_on(slots, is_shared) || placed.with_back && cut_on(slots.map(|slot| slot + n), is_shared);
        Some((placed.placement.cells.start + patch.cell, cut))
    })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DMat4, DQuat, DVec3, Vec3};

    use crate::scene::{Material, Mesh, Object, Scene};
    use crate::{Edit, World, WorldOptions};

    /// A floor with elements in a slot between two plates, and an edit far from them that touches the floor.
    #[test]
    fn elements_behind_surfaces_stay_so_when_something_else_changes() {
        let white = Material::diffuse(Vec3::ONE);
        let floor = Mesh::quad(Vec3::ZERO, Vec3::Z * 4.0, Vec3::X * 4.0);
        // Their fronts face each other.
        let left = Mesh::quad(Vec3::new(0.98, 0.0, 0.0), Vec3::Y, Vec3::Z * 4.0);
        let right = Mesh::quad(Vec3::new(1.02, 0.0, 0.0), Vec3::Z * 4.0, Vec3::Y);
        let named = |name: &str, mesh| Object::new(name, mesh, white);
        let objects = vec![named("floor", floor), named("left", left), named("right", right)];
        let options = WorldOptions { spacing: Some(0.5), ..WorldOptions::default() };
        let start = World::new(Scene::from_objects(objects), &options).expect("a floor");
        let behind = start.validity.behind().to_vec();
        assert!(!behind.is_empty(), "no element is in the slot");
        let cube = Object::new("cube", Mesh::cuboid(Vec3::ZERO, Vec3::ONE * 0.3), white);
        let asset = Arc::new(Scene::from_objects(vec![cube]));
        let at = DMat4::from_translation(DVec3::new(3.0, 0.1, 3.0));
        let mut world = start.clone();
        for edit in [
            Edit::Insert { asset, name: "cube".into(), transform: at },
            Edit::Move { object: "cube".into(), transform: DMat4::from_translation(DVec3::new(3.2, 0.1, 2.0)) },
            Edit::Remove { objects: vec!["cube".into()] },
        ] {
            let transition = world.apply(&[edit]).expect("an edit");
            world = transition.after;
            assert_eq!(world.validity.behind(), behind);
            assert!(behind.iter().all(|&slot| !world.is_valid(slot as usize)), "they are computed now");
            assert!(behind.iter().all(|slot| !transition.filled_slots.contains(slot)));
        }
    }

    /// A sill that sticks out of a wall by a third: its outer corners see little of it, but all of the room.
    #[test]
    fn what_looks_out_as_its_neighbours_do_is_not_behind() {
        let white = Material::diffuse(Vec3::ONE);
        let wall = Mesh::cuboid(Vec3::new(0.0, 0.0, -1.0), Vec3::new(0.3, 2.0, 1.0));
        let sill = Mesh::quad(Vec3::new(0.1, 1.0, -0.5), Vec3::Z, Vec3::X * 0.3);
        let objects = vec![Object::new("wall", wall, white), Object::new("sill", sill, white)];
        let options = WorldOptions { spacing: Some(1.5), ..WorldOptions::default() };
        let world = World::new(Scene::from_objects(objects), &options).expect("a wall");
        let valid = world.placed[1].placement.elements.clone().filter(|&slot| world.is_valid(slot as usize));
        let places: Vec<f32> = valid.map(|slot| world.positions()[slot as usize].x).collect();
        assert!(places.len() == 2 && places.iter().all(|x| *x > 0.35), "{places:?}");
    }

    /// Only what an edit touches is asked again, and everything is then as if all of it had been asked.
    #[test]
    fn what_an_edit_does_not_touch_is_not_asked_again() {
        let white = Material::diffuse(Vec3::ONE);
        let room = Mesh::cuboid(Vec3::ZERO, Vec3::new(3.0, 2.0, 3.0)).inside_out();
        // Between them lies a row of the floor's elements.
        let [plate, other] = [1.47, 1.51].map(|x| Mesh::cuboid(Vec3::new(x, -0.1, 0.5), Vec3::new(x + 0.02, 1.0, 2.5)));
        let named = |name: &str, mesh| Object::new(name, mesh, white);
        let mut ball = named("ball", Mesh::icosphere(0.32, 3));
        ball.world_from_object = DMat4::from_translation(DVec3::new(0.7, 0.3, 0.7));
        let objects = vec![named("room", room), named("plate", plate), named("other", other), ball];
        let options = WorldOptions { spacing: Some(0.1), ..WorldOptions::default() };
        let mut world = World::new(Scene::from_objects(objects), &options).expect("a room");
        let slab = named("slab", Mesh::cuboid(Vec3::ZERO, Vec3::new(0.03, 0.7, 0.8)));
        let asset = Arc::new(Scene::from_objects(vec![slab]));
        let at = |x: f64, turn: f64| {
            DMat4::from_rotation_translation(DQuat::from_rotation_y(turn), DVec3::new(x, -0.05, 1.1))
        };
        for edit in [
            Edit::Insert { asset, name: "slab".into(), transform: at(0.62, 0.3) },
            Edit::Move { object: "slab".into(), transform: at(1.4, 0.0) },
            Edit::Move { object: "slab".into(), transform: at(2.96, -0.2) },
            Edit::Remove { objects: vec!["plate".into()] },
        ] {
            world = world.apply(&[edit]).expect("an edit").after;
            assert!(world.sight.values().any(|hidden| !hidden.is_empty()), "nothing hides anything");
            assert!(!world.validity.behind().is_empty(), "nothing is behind a surface");
            let mut again = world.clone();
            again.look_around(None, |_| true);
            again.find_behind(None, |_| true);
            assert_eq!(again.validity.behind(), world.validity.behind());
            assert!((0..world.space.cells() as u32).all(|cell| again.space.is_cut(cell) == world.space.is_cut(cell)));
            for placed in &world.placed {
                let [now, then] = [&again, &world].map(|world| &world.sight[&placed.key].hidden);
                assert_eq!(now, then, "of {}", placed.key);
            }
        }
    }
}
