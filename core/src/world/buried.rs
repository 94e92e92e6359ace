//! Which elements nobody sees as they are: inside solids, or cut off from most of their cells by a surface.

use std::collections::{BTreeMap, BTreeSet};

use glam::Vec3;
use rayon::prelude::*;

use super::sight::{Touched, is_touched, of_touched_cells};
use super::{Placed, World, visible_light};
use crate::bvh::Ray;
use crate::random::Pcg32;
use crate::sampling::cosine_hemisphere;
use crate::space::Patch;
use crate::surface::bounds_of;

/// First a few rays; elements that meet a back are asked again with all.
const FIRST_RAYS: u32 = 6;
const ALL_RAYS: u32 = 32;

/// Samples of each light that have to miss an element that only sees backs.
const LIGHT_SAMPLES: u32 = 4;

/// An element that sees less than this part of its cells is behind what hides the rest, unless it is as open as they are.
const LEAST_SHARE: f32 = 0.4;

/// It is where it has this part of the openness of its neighbours that it does not see, by so many rays each.
const LEAST_OPEN: f32 = 0.8;
const OPEN_RAYS: u32 = 128;

/// Where this part of so many rays finds nothing, an element that no lamp shines on is in the dark outside.
const LEAST_OUTSIDE: f32 = 0.25;
const OUTSIDE_RAYS: u32 = 32;

/// Whether an element is inside a solid. Most of its rays meet the backs of closed objects that light does not enter,
/// or all of them meet some back that no light comes from (objects that stand on a floor often have no bottom) and no
/// lamp is in there. A courtyard between backs is open, and lit.
pub(super) fn is_inside(world: &World, slot: u32) -> bool {
    if world.areas()[slot as usize] <= 0.0 {
        return false;
    }
    let (origin, n) = world.ray_origin(slot as usize);
    is_in_solid(world, (origin, n), &mut Pcg32::new(0x1551, u64::from(slot)))
}

/// Whether a point, a little above a surface with a normal there, is inside a solid.
fn is_in_solid(world: &World, (origin, n): (Vec3, Vec3), rng: &mut Pcg32) -> bool {
    let (mut solid, mut dark) = (0, 0);
    for k in 0..ALL_RAYS {
        if k == FIRST_RAYS && solid + dark == 0 {
            return false;
        }
        let direction = cosine_hemisphere(n, rng.next_2d());
        let ray = Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY };
        if let Some(hit) = world.trees.closest_opaque(&ray)
            && hit.normal.dot(direction) > 0.0
        {
            let part = world.space.part(hit.triangle);
            solid += u32::from(part.solid);
            dark += u32::from(!part.solid && !part.double_sided);
        }
    }
    2 * solid > ALL_RAYS || solid + dark == ALL_RAYS && !is_lit(world, origin, n, rng)
}

/// Whether some light reaches a point straight.
fn is_lit(world: &World, point: Vec3, n: Vec3, rng: &mut Pcg32) -> bool {
    world.emitters.list.iter().filter(|emitter| !emitter.is_below_horizon(point, n)).any(|emitter| {
        (0..LIGHT_SAMPLES).any(|_| visible_light(emitter, &world.trees, point, n, rng.next_2d(), &mut 0) != Vec3::ZERO)
    })
}

impl World {
    /// Whether a point on a surface with a normal there is inside a solid: nobody sees it.
    pub(crate) fn is_in_solid(&self, point: Vec3, n: Vec3, rng: &mut Pcg32) -> bool {
        is_in_solid(self, (point + n * self.lift(point), n), rng)
    }

    /// A little above the surface at an element: where sight along it is asked for.
    #[inline]
    pub(super) fn above(&self, slot: u32) -> Vec3 {
        let p = self.positions()[slot as usize];
        p + self.normals()[slot as usize] * self.lift(p)
    }

    /// Part of the way from an element to another, along their surface, that is free.
    fn free_part(&self, from: u32, to: u32) -> f32 {
        let (origin, end) = (self.above(from), self.above(to));
        let ray = Ray { origin, direction: end - origin, t_min: 0.0, t_max: 1.0 };
        if origin == end { 1.0 } else { self.trees.closest_opaque(&ray).map_or(1.0, |hit| hit.t) }
    }
}

/// How far behind a surface an element is, seen from a neighbour in front of it: metres along the way between them.
pub(super) fn depth_towards(world: &World, from: u32, to: u32) -> f32 {
    let length = world.positions()[from as usize].distance(world.positions()[to as usize]);
    length * (1.0 - world.free_part(from, to))
}

/// What an element sees of the cells around it.
#[derive(Clone, Copy, Default)]
struct Sight {
    cells: u32,
    /// Sum over them of the part that it sees.
    seen: f32,
}

impl Sight {
    fn add(&mut self, seen: f32) {
        self.cells += 1;
        self.seen += seen;
    }
}

/// Part of an element's hemisphere, by the cosine, in which nothing is nearer than a distance, by so many rays.
fn free_part_of_hemisphere(world: &World, slot: u32, distance: f32, rays: u32) -> f32 {
    let (origin, n) = world.ray_origin(slot as usize);
    let mut rng = Pcg32::new(0x0be7, u64::from(slot));
    let mut is_free = || {
        let direction = cosine_hemisphere(n, rng.next_2d());
        world.trees.closest_opaque(&Ray { origin, direction, t_min: 0.0, t_max: distance }).is_none()
    };
    (0..rays).filter(|_| is_free()).count() as f32 / rays as f32
}

/// Whether an element is in the dark outside of everything, as what sticks out below a floor is: nobody looks at it, and it
/// gets no light. Without any lamp, nobody knows where light will come from.
fn is_outside(world: &World, slot: u32) -> bool {
    !world.emitters.has_sky()
        && !world.emitters.list.is_empty()
        && free_part_of_hemisphere(world, slot, f32::INFINITY, OUTSIDE_RAYS) >= LEAST_OUTSIDE
        && !is_lamplit(world, slot)
}

/// Whether some lamp shines on an element.
fn is_lamplit(world: &World, slot: u32) -> bool {
    let (point, n) = world.ray_origin(slot as usize);
    is_lit(world, point, n, &mut Pcg32::new(0x11f, u64::from(slot)))
}

/// Part of an element's hemisphere in which nothing is nearer than the spacing.
fn openness(world: &World, slot: u32) -> f32 {
    free_part_of_hemisphere(world, slot, world.spacing(), OPEN_RAYS)
}

/// Whether an element gets less light than its neighbours that it does not see: it is less open, or lamps shine on them alone.
/// Theirs stands for its own then. Between slats, or on a ledge whose other corners are in a wall, its own is the better.
fn is_in_shadow(world: &World, slot: u32, unseen: &[u32]) -> bool {
    let sum: f32 = unseen.iter().map(|&other| openness(world, other)).sum();
    openness(world, slot) * (unseen.len() as f32) < LEAST_OPEN * sum
        || !is_lamplit(world, slot) && unseen.iter().any(|&other| is_lamplit(world, other))
}

/// Neighbours that an element does not see.
fn unseen_by(world: &World, placed: &Placed, slot: u32) -> Vec<u32> {
    let side = placed.sides().find(|side| side.contains(&slot)).map_or(0, |side| side.start);
    let neighbours = placed.layout.neighbours_of(slot - side).map(|element| side + element);
    neighbours.filter(|&other| part_between(world, slot, other, placed.layout.is_shared()) < 1.0).collect()
}

/// Elements of an object, outside of solids, that see next to nothing of their cells and get less light than what is there, or
/// that are outside of everything where what is there is not; ascending. Where nothing has changed about their cells, they are
/// those that were.
pub(super) fn behind_surfaces(world: &World, placed: &Placed, touched: Touched) -> Vec<u32> {
    let behind = world.validity.behind();
    let was_behind = |slot: u32| behind.binary_search(&slot).is_ok();
    let asked = asked(world, placed, touched);
    let is_asked = |slot: u32| asked.as_ref().is_none_or(|asked| asked.slots.contains(&slot));
    let boxes = asked.as_ref().map(|asked| &*asked.boxes);
    let is_cut = |patch: &Patch| world.space.is_cut(placed.placement.cells.start + patch.cell);
    let corners = |patch: &Patch| {
        let elements = patch.elements;
        placed.sides().map(move |side| elements.map(|element| side.start + element))
    };
    let cut = of_touched_cells(placed, boxes, |patch| {
        let is_wanted = || is_cut(patch) && corners(patch).flatten().any(is_asked);
        let seen = |corners| seen_of_cell(world, corners, placed.layout.is_shared());
        is_wanted().then(|| corners(patch).flat_map(seen).collect::<Vec<_>>())
    });
    let mut sights: BTreeMap<u32, Sight> = BTreeMap::new();
    let is_in_no_solid = |slot: u32| world.is_valid(slot as usize) || was_behind(slot);
    for (slot, seen) in cut.into_iter().flatten().filter(|(slot, _)| is_asked(*slot) && is_in_no_solid(*slot)) {
        sights.entry(slot).or_default().add(seen);
    }
    if !sights.is_empty() {
        // Of cells that nothing stands on, all is seen.
        let whole = of_touched_cells(placed, boxes, |patch| {
            let there = || corners(patch).flatten().filter(|slot| sights.contains_key(slot)).collect::<Vec<_>>();
            (!is_cut(patch)).then(there).filter(|slots| !slots.is_empty())
        });
        for slot in whole.into_iter().flatten() {
            sights.entry(slot).or_default().add(1.0);
        }
    }
    let is_cut_off = |sight: Sight| sight.seen < LEAST_SHARE * sight.cells as f32;
    let is_behind = |&(slot, sight): &(u32, Sight)| {
        let (is_cut_off, is_out) = (is_cut_off(sight), is_outside(world, slot));
        if !is_cut_off && !is_out {
            return false;
        }
        let unseen: Vec<u32> =
            unseen_by(world, placed, slot).into_iter().filter(|&slot| is_in_no_solid(slot)).collect();
        is_cut_off && is_in_shadow(world, slot, &unseen)
            || is_out && unseen.iter().any(|&slot| !is_outside(world, slot))
    };
    let partly_hidden: Vec<(u32, Sight)> =
        sights.into_iter().filter(|(_, sight)| sight.seen < sight.cells as f32).collect();
    let found = partly_hidden.into_par_iter().filter(is_behind);
    let mut all: Vec<u32> = found.map(|(slot, _)| slot).collect();
    let kept = world.validity.behind_of(&placed.placement.elements).iter().copied().filter(|slot| !is_asked(*slot));
    all.extend(kept);
    all.sort_unstable();
    all
}

/// Elements about whose cells geometry has changed.
struct Asked {
    slots: BTreeSet<u32>,
    /// All their cells are in these.
    boxes: Vec<(Vec3, Vec3)>,
}

/// None where all elements are.
fn asked(world: &World, placed: &Placed, touched: Touched) -> Option<Asked> {
    let boxes = touched?;
    let (positions, start) = (world.positions(), placed.placement.elements.start);
    let at = |element: u32| positions[(start + element) as usize];
    let of_box = |one: &(Vec3, Vec3)| {
        let one = Some(std::slice::from_ref(one));
        let touched = of_touched_cells(placed, one, |patch| {
            let [a, b, c] = patch.elements.map(at);
            let is_touched = is_touched(one, a, b) || is_touched(one, b, c) || is_touched(one, c, a);
            is_touched.then_some(patch.elements)
        });
        let elements: BTreeSet<u32> = touched.into_iter().flatten().collect();
        let around = elements.iter().flat_map(|&element| placed.layout.neighbours_of(element));
        let grown = bounds_of(around.map(at));
        (elements, grown)
    };
    let (elements, boxes): (Vec<BTreeSet<u32>>, Vec<_>) = boxes.iter().map(of_box).unzip();
    let sides = placed.sides();
    let slots = sides.flat_map(|side| elements.iter().flatten().map(move |element| side.start + element)).collect();
    Some(Asked { slots, boxes })
}

/// What each corner of a cell sees of it: as far as it sees along both edges.
fn seen_of_cell(world: &World, corners: [u32; 3], is_shared: bool) -> [(u32, f32); 3] {
    [0, 1, 2].map(|k| {
        let [corner, next, last] = [0, 1, 2].map(|step| corners[(k + step) % 3]);
        (corner, part_between(world, corner, next, is_shared) * part_between(world, corner, last, is_shared))
    })
}

/// Part of the way between two elements that is free; of elements that several vertices share, over what bulges there.
fn part_between(world: &World, from: u32, to: u32, is_shared: bool) -> f32 {
    match is_shared && !world.blocked_over(from, to) {
        true => 1.0,
        false => world.free_part(from, to),
    }
}
