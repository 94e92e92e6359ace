//! Cheap questions to the rays about objects: is the back of a surface ever seen, does an object bound a volume that
//! light does not enter?

use rayon::prelude::*;

use super::lamplit::Lamps;
use super::{Emitter, Placed, World};
use crate::bvh::Ray;
use crate::random::{Pcg32, subseed};
use crate::sampling::cosine_hemisphere;

/// Rays over a whole scene.
const RAYS: usize = 600_000;

/// A back counts as seen from this part of all probe rays on.
const SEEN: f64 = 2e-5;

/// Per object: whether a double-sided surface is seen from its back by the scene's elements, or lit there.
pub(super) fn backs_seen(world: &World) -> Vec<bool> {
    let slots = world.slots();
    let candidates: Vec<bool> = (0..world.placed.len()).map(|index| world.may_have_back(index)).collect();
    if slots == 0 || !candidates.iter().any(|c| *c) {
        return vec![false; candidates.len()];
    }
    let lamps = Lamps::new(world, |_| true);
    let per_element = (RAYS / slots).clamp(1, 32);
    let step = (slots * per_element / RAYS).max(1);
    let hits: Vec<Vec<u32>> = (0..slots.div_ceil(step * 1024))
        .into_par_iter()
        .map(|chunk| {
            let mut found = Vec::new();
            for k in 0..1024 {
                let slot = (chunk * 1024 + k) * step;
                if slot < slots {
                    found.extend((0..per_element).filter_map(|s| back_hit(world, slot, s as u64)));
                }
            }
            found
        })
        .collect();
    let mut counts = vec![0usize; candidates.len()];
    // Keys are indices here: nothing has been edited yet.
    hits.into_iter().flatten().for_each(|key| counts[key as usize] += 1);
    let total = slots.div_ceil(step) * per_element;
    let seen = |count: usize| count as f64 > (SEEN * total as f64).max(2.0);
    let objects = world.placed.par_iter().zip(counts).zip(candidates);
    objects.map(|((placed, count), candidate)| candidate && (seen(count) || lamps.reach_back_of(placed))).collect()
}

/// Key of the object whose reflecting back a probe ray meets.
fn back_hit(world: &World, slot: usize, sample: u64) -> Option<u32> {
    let (origin, n) = world.ray_origin(slot);
    let mut rng = Pcg32::new(subseed(0xbac5, sample), slot as u64);
    let direction = cosine_hemisphere(n, rng.next_2d());
    let hit = world.trees.closest_hit(&Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY })?;
    let part = world.space.part(hit.triangle);
    (part.double_sided && hit.normal.dot(direction) > 0.0).then_some(part.object)
}

impl World {
    /// Marks the parts of closed objects that hold no light and do not enclose the rest of the scene.
    pub(super) fn mark_solids(&mut self) {
        let solid: Vec<bool> = self.placed.iter().map(|p| self.is_solid(p)).collect();
        for (placed, solid) in self.placed.iter().zip(solid) {
            self.space.parts_of_mut(&placed.placement).iter_mut().for_each(|p| p.solid = solid);
        }
    }

    pub(super) fn is_solid(&self, placed: &Placed) -> bool {
        if !placed.surface.closed || placed.surface.volume <= 0.0 || placed.see_through.is_some() {
            return false;
        }
        if self.encloses_most(placed) {
            return false;
        }
        // A lamp inside: its light has to come out through backs that reflect.
        !self.has_lamp_inside(placed)
    }

    /// Whether most other elements are within an object's box.
    fn encloses_most(&self, placed: &Placed) -> bool {
        let bounds = placed.surface.bounds();
        let inside = |p: glam::Vec3| p.cmpge(bounds.0).all() && p.cmple(bounds.1).all();
        let own = placed.placement.elements.clone();
        let others = self.slots().saturating_sub(own.len());
        let enclosed = if others == 0 {
            0
        } else {
            let (positions, areas) = (self.positions(), self.areas());
            (0..self.slots())
                .step_by((self.slots() / 2048).max(1))
                .filter(|&i| !own.contains(&(i as u32)) && areas[i] > 0.0 && inside(positions[i]))
                .count()
                * (self.slots() / 2048).max(1)
        };
        2 * enclosed > others
    }

    /// Whether an object may have elements on its back.
    fn may_have_back(&self, index: usize) -> bool {
        let (placed, object) = (&self.placed[index], &self.scene.objects[index]);
        let is_double_sided = object.materials.iter().any(|material| material.double_sided);
        is_double_sided && !placed.surface.triangles.is_empty() && self.may_light_be_behind(placed)
    }

    /// Objects without elements on their backs on which some lamps shine there, ascending.
    pub(super) fn lit_from_behind(&self, is_asked: impl Fn(&Emitter) -> bool) -> Vec<usize> {
        let lamps = Lamps::new(self, is_asked);
        let is_lit = |&index: &usize| {
            let placed = &self.placed[index];
            !placed.with_back && self.may_have_back(index) && lamps.reach_back_of(placed)
        };
        if lamps.is_empty() { Vec::new() } else { (0..self.placed.len()).into_par_iter().filter(is_lit).collect() }
    }

    /// Whether there may be light behind an object's surface. Inside of what is closed there is with a lamp; behind a
    /// closed surface that faces in, as flipped furniture does, is the scene, unless that is within it.
    fn may_light_be_behind(&self, placed: &Placed) -> bool {
        let surface = &placed.surface;
        match surface.volume > 0.0 {
            _ if !surface.closed || placed.see_through.is_some() => true,
            true => self.has_lamp_inside(placed),
            false => !self.encloses_most(placed),
        }
    }

    /// Whether a lamp that is not the object itself is inside its closed surface.
    fn has_lamp_inside(&self, placed: &Placed) -> bool {
        let (low, high) = placed.surface.bounds();
        let inside = |p: glam::Vec3| p.cmpge(low).all() && p.cmple(high).all() && contains(placed, p);
        let lamps = self.emitters.list.iter().filter(|e| e.object != Some(placed.key));
        lamps.filter_map(Emitter::sphere).any(|(center, _)| inside(center))
    }
}

/// Whether a closed surface contains a point: parity of the crossings of one skew ray.
fn contains(placed: &Placed, point: glam::Vec3) -> bool {
    let direction = glam::DVec3::new(0.577_215_66, 0.691_2, 0.431_237_9);
    let origin = point.as_dvec3();
    let crossings = placed.surface.all_corners().filter(|corners| {
        let [a, b, c] = corners.map(|corner| corner.as_dvec3() - origin);
        let (u, v, w) = (direction.dot(c.cross(b)), direction.dot(a.cross(c)), direction.dot(b.cross(a)));
        let same = (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0);
        let n = (b - a).cross(c - a);
        let slope = direction.dot(n);
        same && slope != 0.0 && a.dot(n) / slope > 0.0
    });
    crossings.count() % 2 == 1
}

/// Whether a newly placed double-sided, open object shows its back to the elements of the scene, or to lamps.
pub(super) fn back_seen(world: &World, index: usize) -> bool {
    const PAIRS: u32 = 4096;
    let placed = &world.placed[index];
    if !world.may_have_back(index) {
        return false;
    }
    let mut rng = Pcg32::new(0x5ee, u64::from(placed.key));
    let (mut seen, mut backs) = (0, 0);
    for _ in 0..PAIRS {
        let slot = rng.next_below(world.slots());
        let target = placed.placement.elements.start as usize + rng.next_below(placed.layout.len());
        let target = world.positions()[target];
        if world.areas()[slot] <= 0.0 {
            continue;
        }
        let (origin, n) = world.ray_origin(slot);
        let direction = target - origin;
        if n.dot(direction) <= 0.0 {
            continue;
        }
        let ray = Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY };
        let Some(hit) = world.trees.closest_hit(&ray) else { continue };
        let part = world.space.part(hit.triangle);
        if part.object == placed.key {
            seen += 1;
            backs += u32::from(hit.normal.dot(direction) > 0.0);
        }
    }
    backs > 4 && f64::from(backs) > 0.01 * f64::from(seen) || Lamps::new(world, |_| true).reach_back_of(placed)
}
