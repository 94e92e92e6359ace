//! Vertices that are meant to be one: files have them apart by rounding, at the poles and seams of spheres, say, and a ray
//! that is aimed there would slip through.

use glam::{IVec3, Vec3};

use crate::hash::FastMap;

/// Vertices nearer than this part of the object's longest side are one: some steps of `f32`.
const SAME: f32 = 2.5e-7;

/// Edge of the cells in which others are looked for, over that distance: hardly any vertex is near the border of one.
const CELL: f32 = 64.0;

const NONE: u32 = u32::MAX;

/// Puts vertices that are meant to be one in the place of the first of them.
pub(super) fn join(positions: &mut [Vec3]) {
    let bounds = |bounds: (Vec3, Vec3), p: &Vec3| (bounds.0.min(*p), bounds.1.max(*p));
    let (low, high) = positions.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), bounds);
    let same = SAME * (high - low).max_element();
    if positions.is_empty() || same.is_nan() || same < f32::MIN_POSITIVE {
        return;
    }
    let mut joined = Joined { same, low, first: FastMap::default(), next: Vec::new(), places: Vec::new() };
    positions.iter_mut().for_each(|position| *position = joined.place_of(*position));
}

/// Places of vertices so far.
struct Joined {
    /// m.
    same: f32,
    /// Least corner of the box around all vertices.
    low: Vec3,
    /// The latest place in a cell.
    first: FastMap<IVec3, u32>,
    /// Per place, the one before it in its cell, or [`NONE`].
    next: Vec<u32>,
    places: Vec<Vec3>,
}

impl Joined {
    /// A place that is as good as `position`: it, or one that was there before.
    fn place_of(&mut self, position: Vec3) -> Vec3 {
        let cell = |p: Vec3| ((p - self.low) / (CELL * self.same)).floor().as_ivec3();
        let (own, low, high) = (cell(position), cell(position - self.same), cell(position + self.same));
        for x in low.x..=high.x {
            for y in low.y..=high.y {
                for z in low.z..=high.z {
                    if let Some(place) = self.in_cell(IVec3::new(x, y, z), position) {
                        return place;
                    }
                }
            }
        }
        let index = self.places.len() as u32;
        self.places.push(position);
        self.next.push(self.first.insert(own, index).unwrap_or(NONE));
        position
    }

    fn in_cell(&self, cell: IVec3, position: Vec3) -> Option<Vec3> {
        let mut index = *self.first.get(&cell)?;
        while index != NONE {
            let place = self.places[index as usize];
            if place.distance_squared(position) < self.same * self.same {
                return Some(place);
            }
            index = self.next[index as usize];
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_apart_by_rounding_is_one() {
        let near = Vec3::new(1.0, 2.0, 3.0);
        for apart in [Vec3::X * 4e-17, Vec3::new(2e-7, -2e-7, 2e-7), Vec3::Y * -1e-7] {
            let mut positions = [Vec3::ZERO, near, near + apart, Vec3::splat(-4.0)];
            join(&mut positions);
            assert_eq!(positions, [Vec3::ZERO, near, near, Vec3::splat(-4.0)], "{apart}");
        }
    }

    #[test]
    fn what_is_apart_stays() {
        let mut positions: Vec<Vec3> =
            (0..1000).map(|k| Vec3::new(1e-6 * k as f32, 0.5 - 1e-6 * k as f32, 1.0)).collect();
        let before = positions.clone();
        join(&mut positions);
        assert_eq!(positions, before);
        let mut flat = [Vec3::ONE; 3];
        join(&mut flat);
        assert_eq!(flat, [Vec3::ONE; 3]);
        join(&mut []);
    }
}
