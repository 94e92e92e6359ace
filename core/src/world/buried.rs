//! Which elements nobody sees as they are: inside solids, or cut off from most of their cells by a surface.

use std::collections::BTreeMap;

use glam::Vec3;

use super::emitters::visible_weight;
use super::{Placed, World};
use crate::bvh::Ray;
use crate::random::Pcg32;
use crate::sampling::cosine_hemisphere;

/// First a few rays; elements that meet a back are asked again with all.
const FIRST_RAYS: u32 = 6;
const ALL_RAYS: u32 = 32;

/// Samples of each light that have to miss an element that only sees backs.
const LIGHT_SAMPLES: u32 = 4;

/// An element that sees less than this part of its cells is behind what hides the rest.
const LEAST_SHARE: f32 = 0.4;

/// Whether an element is inside a solid. Most of its rays meet the backs of closed objects that light does not enter, or all
/// of them meet some back that no light comes from (objects that stand on a floor often have no bottom) and no lamp is in
/// there. A courtyard between backs is open, and lit.
pub(super) fn is_inside(world: &World, slot: u32) -> bool {
    if world.areas()[slot as usize] <= 0.0 {
        return false;
    }
    let (origin, n) = world.ray_origin(slot as usize);
    let mut rng = Pcg32::new(0x1551, u64::from(slot));
    let (mut solid, mut dark) = (0, 0);
    for k in 0..ALL_RAYS {
        if k == FIRST_RAYS && solid + dark == 0 {
            return false;
        }
        let direction = cosine_hemisphere(n, rng.next_2d());
        let ray = Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY };
        if let Some(hit) = world.trees.closest_hit(&ray)
            && hit.normal.dot(direction) > 0.0
        {
            let part = world.space.part(hit.triangle);
            solid += u32::from(part.solid);
            dark += u32::from(!part.solid && !part.double_sided);
        }
    }
    2 * solid > ALL_RAYS || solid + dark == ALL_RAYS && !is_lit(world, origin, n, &mut rng)
}

/// Whether some light reaches a point straight.
fn is_lit(world: &World, point: Vec3, n: Vec3, rng: &mut Pcg32) -> bool {
    world.emitters.list.iter().filter(|emitter| !emitter.is_below_horizon(point, n)).any(|emitter| {
        (0..LIGHT_SAMPLES).any(|_| visible_weight(emitter, &world.trees, point, n, rng.next_2d(), &mut 0) > 0.0)
    })
}

impl World {
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
        if origin == end { 1.0 } else { self.trees.closest_hit(&ray).map_or(1.0, |hit| hit.t) }
    }
}

/// How far behind a surface an element is, seen from a neighbour in front of it: metres along the way between them.
pub(super) fn depth_towards(world: &World, from: u32, to: u32) -> f32 {
    let length = world.positions()[from as usize].distance(world.positions()[to as usize]);
    length * (1.0 - world.free_part(from, to))
}

/// Elements of an object, outside of solids, that see next to nothing of their cells, ascending. Only cells that something stands on count.
pub(super) fn behind_surfaces(world: &World, placed: &Placed) -> Vec<u32> {
    let behind = world.validity.behind();
    let is_outside = |slot: u32| world.is_valid(slot as usize) || behind.binary_search(&slot).is_ok();
    let hidden_of_cell = |slots: [u32; 3]| {
        // What a corner sees of its cell: as far as it sees along both edges.
        let free = |a: u32, b: u32| world.free_part(a, b);
        let [a, b, c] = slots;
        [(a, free(a, b) * free(a, c)), (b, free(b, a) * free(b, c)), (c, free(c, a) * free(c, b))]
    };
    let cut = placed.layout.of_cells(&placed.surface, |patch| {
        let is_cut = world.space.is_cut(placed.placement.cells.start + patch.cell);
        is_cut.then(|| placed.sides().flat_map(|first| hidden_of_cell(patch.elements.map(|e| first + e))).collect())
    });
    let mut seen: BTreeMap<u32, f32> = BTreeMap::new();
    for (slot, part) in cut.iter().flat_map(|corners: &Vec<(u32, f32)>| corners) {
        *seen.entry(*slot).or_default() += part;
    }
    seen.retain(|slot, _| is_outside(*slot));
    let candidates: Vec<u32> = seen.keys().copied().collect();
    let mut cells: BTreeMap<u32, (u32, u32)> = candidates.iter().map(|slot| (*slot, (0, 0))).collect();
    let around = placed.layout.of_cells(&placed.surface, |patch| {
        let is_cut = world.space.is_cut(placed.placement.cells.start + patch.cell);
        let of_side = |first: u32| patch.elements.map(|e| first + e);
        let touched = placed.sides().flat_map(of_side).filter(|slot| candidates.binary_search(slot).is_ok());
        let touched: Vec<(u32, bool)> = touched.map(|slot| (slot, is_cut)).collect();
        (!touched.is_empty()).then_some(touched)
    });
    for (slot, is_cut) in around.into_iter().flatten() {
        let count = cells.entry(slot).or_default();
        *count = (count.0 + 1, count.1 + u32::from(is_cut));
    }
    let share = |slot: u32| {
        let (all, cut) = cells[&slot];
        (seen[&slot] + (all - cut) as f32) / all as f32
    };
    candidates.into_iter().filter(|&slot| share(slot) < LEAST_SHARE).collect()
}
