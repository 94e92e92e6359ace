//! The elements at which smooth light is evaluated, over a whole world.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use crate::bvh::Ray;
use crate::world::{Placed, World};

const NONE: u32 = u32::MAX;

/// Representatives of all objects, and the way back from their values to all elements.
pub(crate) struct Subset {
    /// Element slots of the representatives, object by object.
    pub slots: Vec<u32>,
    sides: Vec<Side>,
    len: usize,
}

/// One side of one object.
struct Side {
    placed: Arc<Placed>,
    first_slot: u32,
    /// Per representative of the object: index into `Subset::slots`, or `NONE` where it is not computed.
    index: Vec<u32>,
    /// Entries of the object's weights whose representative the element does not see: a wall stands between.
    hidden: Vec<bool>,
    /// Elements none of whose representatives is computed: (element of the object, index into `Subset::slots`).
    alone: Vec<(u32, u32)>,
}

impl Subset {
    /// Collects the representatives of a world.
    pub(crate) fn new(world: &World) -> Subset {
        let mut subset = Subset { slots: Vec::new(), sides: Vec::new(), len: world.slots() };
        for placed in &world.placed {
            let front = placed.surface.positions.len() as u32;
            subset.add_side(world, placed, placed.placement.elements.start);
            if placed.with_back {
                subset.add_side(world, placed, placed.placement.elements.start + front);
            }
        }
        subset
    }

    fn add_side(&mut self, world: &World, placed: &Arc<Placed>, first_slot: u32) {
        let coarse = &placed.coarse;
        let hidden = hidden_entries(world, placed, first_slot);
        let computed = |element: u32| {
            let slot = (first_slot + element) as usize;
            world.geometry.areas[slot] > 0.0 && world.validity.is_valid(slot)
        };
        let mut index = Vec::with_capacity(coarse.representatives.len());
        let mut complete = !hidden.iter().any(|h| *h);
        for &r in &coarse.representatives {
            if computed(r) {
                index.push(self.slots.len() as u32);
                self.slots.push(first_slot + r);
            } else {
                index.push(NONE);
                complete = false;
            }
        }
        let mut alone = Vec::new();
        if !complete {
            for element in 0..placed.surface.positions.len() as u32 {
                let range = coarse.offsets[element as usize] as usize..coarse.offsets[element as usize + 1] as usize;
                let known = range.into_iter().any(|e| !hidden[e] && index[coarse.entries[e].0 as usize] != NONE);
                if !known && computed(element) {
                    alone.push((element, self.slots.len() as u32));
                    self.slots.push(first_slot + element);
                }
            }
        }
        self.sides.push(Side { placed: Arc::clone(placed), first_slot, index, hidden, alone });
    }

    /// Values at the representatives carried to all slots; zero in holes.
    pub(crate) fn interpolate(&self, values: &[Vec3]) -> Vec<Vec3> {
        let mut out = vec![Vec3::ZERO; self.len];
        let filled: Vec<Vec<Vec3>> = self.sides.par_iter().map(|side| side.interpolate(values)).collect();
        for (side, filled) in self.sides.iter().zip(filled) {
            out[side.first_slot as usize..][..filled.len()].copy_from_slice(&filled);
        }
        out
    }

    /// Area that each representative stands for, m²: what interpolation gives weight to.
    pub(crate) fn areas(&self) -> Vec<f32> {
        let mut areas = vec![0.0; self.slots.len()];
        for side in &self.sides {
            let surface = &side.placed.surface;
            for (element, &area) in surface.areas.iter().enumerate() {
                let known: f32 = side.entries_of(element as u32).map(|e| e.1).sum();
                for (i, w) in side.entries_of(element as u32) {
                    areas[i] += area * w / known;
                }
            }
            side.alone.iter().for_each(|&(element, i)| areas[i as usize] += surface.areas[element as usize]);
        }
        areas
    }

    /// For every slot the representative that weighs most, as index into `slots`; `u32::MAX` where there is none.
    pub(crate) fn nearest(&self) -> Vec<u32> {
        let mut out = vec![NONE; self.len];
        for side in &self.sides {
            let n = side.placed.surface.positions.len() as u32;
            for element in 0..n {
                let best = side.entries_of(element).next().map(|(i, _)| i as u32);
                out[(side.first_slot + element) as usize] = best.unwrap_or(NONE);
            }
            side.alone.iter().for_each(|(element, i)| out[(side.first_slot + element) as usize] = *i);
        }
        out
    }
}

impl Side {
    /// (index into `Subset::slots`, weight) of an element, heaviest first; the weights need not sum to 1.
    fn entries_of(&self, element: u32) -> impl Iterator<Item = (usize, f32)> {
        let coarse = &self.placed.coarse;
        let first = coarse.offsets[element as usize] as usize;
        let entries = coarse.entries_of(element).iter().enumerate();
        entries.filter_map(move |(k, &(r, w))| {
            let i = self.index[r as usize];
            (i != NONE && !self.hidden[first + k]).then_some((i as usize, w))
        })
    }

    fn interpolate(&self, values: &[Vec3]) -> Vec<Vec3> {
        let mut out: Vec<Vec3> = (0..self.placed.surface.positions.len() as u32)
            .map(|element| {
                let (mut sum, mut weight) = (Vec3::ZERO, 0.0);
                for (i, w) in self.entries_of(element) {
                    sum += values[i] * w;
                    weight += w;
                }
                if weight > 0.0 { sum / weight } else { Vec3::ZERO }
            })
            .collect();
        self.alone.iter().for_each(|&(element, i)| out[element as usize] = values[i as usize]);
        out
    }
}

/// Entries between an element and a representative that do not see each other, just above the surface. Light of one
/// side of a wall must not be interpolated to the other.
fn hidden_entries(world: &World, placed: &Placed, first_slot: u32) -> Vec<bool> {
    let lift = 0.05 * world.spacing();
    let above = |element: u32| {
        let slot = (first_slot + element) as usize;
        world.geometry.positions[slot] + world.geometry.normals[slot] * lift
    };
    let coarse = &placed.coarse;
    let elements = (0..placed.surface.positions.len() as u32).into_par_iter();
    let of_element = |element: u32| {
        coarse.entries_of(element).iter().map(move |&(r, _)| {
            let (from, to) = (above(element), above(coarse.representatives[r as usize]));
            from != to && world.trees.any_hit(&Ray { origin: from, direction: to - from, t_min: 0.0, t_max: 1.0 })
        })
    };
    elements.with_min_len(256).flat_map_iter(of_element).collect()
}
