//! Elements near one another: the same surface, or one that goes on where it ends, whatever object it belongs to.

use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use crate::hash::FastMap;
use crate::job::{Canceled, Observer};
use crate::world::World;

/// Elements count as near up to so many times the extent of the smaller one, the root of its area.
pub(super) const REACH: f32 = 3.5;

/// Smallest cosine between the normals of elements of one surface.
const SAME_DIRECTION: f32 = 0.9;

/// Largest sine between the surface at an element and the way to another one.
const SAME_PLANE: f32 = 0.3;

/// Largest ratio of the areas of elements that are near: their levels differ by one at most.
const ALIKE: f32 = 4.0;

/// Cells per task.
const CHUNK: usize = 64;

/// An element near another one.
#[derive(Clone, Copy)]
pub(super) struct Near {
    pub slot: u32,
    /// Distance over the extent of the smaller of the two, squared.
    pub distance2: f32,
}

impl Near {
    /// Falls from 1 where both are one to 0 at [`REACH`].
    pub(super) fn kernel(self) -> f32 {
        let inside = (1.0 - self.distance2 / (REACH * REACH)).max(0.0);
        inside * inside
    }
}

/// Elements in cubes. Those whose extents lie within a factor of two have a level of cubes of their own, a little larger
/// than their reach, so that all that is near lies in the cubes about one's own, at its level and those beside it.
pub(super) struct Nearby {
    /// Those that are computed, cube by cube.
    elements: Vec<Element>,
    cells: Vec<Cell>,
    levels: FastMap<u32, FastMap<u64, Range<u32>>>,
}

/// An element's own data, side by side with those of its cube: they are compared over and over.
#[derive(Clone, Copy)]
struct Element {
    position: Vec3,
    area: f32,
    normal: Vec3,
    slot: u32,
}

/// Some elements in one cube.
struct Cell {
    level: i32,
    at: [i32; 3],
    elements: Range<u32>,
}

impl Nearby {
    pub(super) fn new(world: &World) -> Nearby {
        let place = |slot: u32| {
            let level = level_of(world.areas()[slot as usize].sqrt());
            (level, cell_of(world.positions()[slot as usize], level), slot)
        };
        let mut places: Vec<(i32, [i32; 3], u32)> = world.computed_slots().into_par_iter().map(place).collect();
        places.par_sort_unstable();
        let (mut cells, mut levels) = (Vec::new(), FastMap::<u32, FastMap<u64, Range<u32>>>::default());
        let mut start = 0;
        for cell in places.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let (level, at, _) = cell[0];
            let elements = start..start + cell.len() as u32;
            start = elements.end;
            levels.entry(level as u32).or_default().insert(key(at), elements.clone());
            cells.push(Cell { level, at, elements });
        }
        let element = |(.., slot): (i32, [i32; 3], u32)| {
            let at = slot as usize;
            Element { position: world.positions()[at], area: world.areas()[at], normal: world.normals()[at], slot }
        };
        Nearby { elements: places.into_iter().map(element).collect(), cells, levels }
    }

    /// What `of(part, slot, elements near it)` makes of every slot that is computed, in parts that are the same in every run, as
    /// is the order of what is near. An element is not near itself.
    pub(super) fn each<T: Default + Send>(
        &self,
        observer: &dyn Observer,
        of: impl Fn(&mut T, u32, &[Near]) + Sync,
    ) -> Result<Vec<T>, Canceled> {
        let part = |cells: &[Cell]| {
            if observer.canceled() {
                return Err(Canceled);
            }
            let (mut around, mut near, mut part) = (Vec::new(), Vec::new(), T::default());
            for cell in cells {
                self.around(cell, &mut around);
                for element in self.of(&cell.elements) {
                    near.clear();
                    let others = around.iter().flat_map(|range| self.of(range));
                    near.extend(others.filter_map(|other| element.near(other)));
                    of(&mut part, element.slot, &near);
                }
            }
            Ok(part)
        };
        self.cells.par_chunks(CHUNK).map(part).collect()
    }

    fn of(&self, range: &Range<u32>) -> &[Element] {
        &self.elements[range.start as usize..range.end as usize]
    }

    /// All elements that can be near one of a cell's.
    fn around(&self, cell: &Cell, around: &mut Vec<Range<u32>>) {
        around.clear();
        for level in cell.level - 1..=cell.level + 1 {
            let Some(cells) = self.levels.get(&(level as u32)) else { continue };
            // The cubes of a level are twice those of the level before.
            let [low, high] = match level - cell.level {
                -1 => [-1, 2].map(|by| cell.at.map(|k| k.saturating_mul(2).saturating_add(by))),
                0 => [-1, 1].map(|by| cell.at.map(|k| k.saturating_add(by))),
                _ => [-1, 1].map(|by| cell.at.map(|k| k.div_euclid(2).saturating_add(by))),
            };
            for x in low[0]..=high[0] {
                for y in low[1]..=high[1] {
                    around.extend((low[2]..=high[2]).filter_map(|z| cells.get(&key([x, y, z])).cloned()));
                }
            }
        }
    }
}

impl Element {
    #[inline]
    fn near(&self, other: &Element) -> Option<Near> {
        let way = other.position - self.position;
        let length2 = way.length_squared();
        let smaller = self.area.min(other.area);
        if length2 > REACH * REACH * smaller || self.slot == other.slot {
            return None;
        }
        let is_off = |normal: Vec3| normal.dot(way).powi(2) > SAME_PLANE * SAME_PLANE * length2;
        let is_same = self.area.max(other.area) < ALIKE * smaller
            && self.normal.dot(other.normal) > SAME_DIRECTION
            && !is_off(self.normal)
            && !is_off(other.normal);
        is_same.then_some(Near { slot: other.slot, distance2: length2 / smaller })
    }
}

/// Elements of an extent (m) within a factor of √2 of 2^level.
fn level_of(extent: f32) -> i32 {
    extent.log2().round() as i32
}

fn cell_of(position: Vec3, level: i32) -> [i32; 3] {
    let size = f64::from(REACH) * 2f64.powf(f64::from(level) + 0.5);
    position.as_dvec3().to_array().map(|x| (x / size).floor() as i32)
}

/// Cubes that share a key lie 2²¹ cubes apart: no mistake, only more to be looked at.
fn key(at: [i32; 3]) -> u64 {
    const BITS: u64 = (1 << 21) - 1;
    at.iter().fold(0, |key, &k| key << 21 | k as u32 as u64 & BITS)
}
