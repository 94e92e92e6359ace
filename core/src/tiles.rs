//! Tiles of elements, and their order: pure functions of positions and keys.

use std::collections::BTreeMap;
use std::ops::Index;

use glam::Vec3;

/// More tiles than this are not worth what each costs by itself.
const MOST: usize = 256;

/// Groups of about `size` slots out of those whose key is finite, whole cells each, ordered by the least key in them.
/// `cells` tells per slot which cell it belongs to. Slots of a tile ascend.
pub(crate) fn cut(
    positions: &impl Index<usize, Output = Vec3>,
    cells: &[u32],
    keys: &[f32],
    size: u32,
) -> Vec<Vec<u32>> {
    let mut members: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for slot in (0..keys.len()).filter(|&slot| keys[slot].is_finite()) {
        members.entry(cells[slot]).or_default().push(slot as u32);
    }
    let middle = |slots: &[u32]| slots.iter().map(|&s| positions[s as usize]).sum::<Vec3>() / slots.len() as f32;
    let mut list: Vec<Cell> = members.into_values().map(|slots| Cell { middle: middle(&slots), slots }).collect();
    let count = count_of(&list);
    let mut tiles = Vec::new();
    halve(&mut list, (size as usize).max(count.div_ceil(MOST)).max(1), &mut tiles);
    let key = |tile: &[u32]| tile.iter().map(|&slot| keys[slot as usize]).fold(f32::INFINITY, f32::min);
    let mut keyed: Vec<(f32, Vec<u32>)> = tiles.into_iter().map(|tile| (key(&tile), tile)).collect();
    keyed.sort_by(|(a, x), (b, y)| a.total_cmp(b).then(x.cmp(y)));
    keyed.into_iter().map(|(_, tile)| tile).collect()
}

/// Slots that stay together.
struct Cell {
    middle: Vec3,
    slots: Vec<u32>,
}

fn count_of(cells: &[Cell]) -> usize {
    cells.iter().map(|cell| cell.slots.len()).sum()
}

/// Halves cells across the longest side of their box until none of the halves has more than `size` slots, where cells
/// allow it.
fn halve(cells: &mut [Cell], size: usize, tiles: &mut Vec<Vec<u32>>) {
    let count = count_of(cells);
    if count == 0 {
        return;
    }
    if count <= size || cells.len() == 1 {
        let mut tile: Vec<u32> = cells.iter().flat_map(|cell| cell.slots.iter().copied()).collect();
        tile.sort_unstable();
        tiles.push(tile);
        return;
    }
    let low = cells.iter().map(|cell| cell.middle).fold(Vec3::INFINITY, Vec3::min);
    let high = cells.iter().map(|cell| cell.middle).fold(Vec3::NEG_INFINITY, Vec3::max);
    let axis = (high - low).max_position();
    cells.sort_by(|a, b| a.middle[axis].total_cmp(&b.middle[axis]).then(a.slots.cmp(&b.slots)));
    let mut left = 0;
    let full = cells.iter().position(|cell| {
        left += cell.slots.len();
        2 * left >= count
    });
    let at = full.map_or(1, |k| k + 1).clamp(1, cells.len() - 1);
    let (a, b) = cells.split_at_mut(at);
    halve(a, size, tiles);
    halve(b, size, tiles);
}

/// A sphere around what an edit has changed in one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ChangedSphere {
    pub middle: Vec3,
    /// Metres.
    pub radius: f32,
    /// Largest change of radiance that comes from there × radius², up to a factor that all spheres share.
    pub power: f32,
}

impl ChangedSphere {
    /// Bound on the change of light at a point, up to that factor: form factor to the sphere × largest change. Zero
    /// where the sphere is below the horizon.
    pub(crate) fn bound(&self, point: Vec3, normal: Vec3) -> f32 {
        let to = self.middle - point;
        if normal.dot(to) <= -self.radius {
            return 0.0;
        }
        self.power / to.length_squared().max(self.radius * self.radius).max(f32::MIN_POSITIVE)
    }
}

/// Key of a point: the least distance to any of some places as `distance` has it.
pub(crate) fn nearest<T>(places: &[T], distance: impl Fn(&T) -> f32) -> f32 {
    places.iter().map(distance).fold(f32::INFINITY, f32::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of `n` × `n` elements in cells of 2 × 2; keys are the Chebyshev distance from a corner.
    fn square(n: u32) -> (Vec<Vec3>, Vec<u32>, Vec<f32>) {
        let slots = || (0..n * n).map(|i| (i % n, i / n));
        let positions = slots().map(|(x, y)| Vec3::new(x as f32, 0.0, y as f32)).collect();
        let cells = slots().map(|(x, y)| (y / 2) * n + x / 2).collect();
        let keys = slots().map(|(x, y)| x.max(y) as f32).collect();
        (positions, cells, keys)
    }

    #[test]
    fn tiles_hold_every_element_once_in_whole_cells() {
        let (positions, cells, mut keys) = square(24);
        keys[5] = f32::INFINITY;
        let tiles = cut(&positions, &cells, &keys, 20);
        let mut all: Vec<u32> = tiles.iter().flatten().copied().collect();
        all.sort_unstable();
        assert_eq!(all, (0..24 * 24).filter(|&slot| slot != 5).collect::<Vec<u32>>());
        assert!(tiles.iter().all(|tile| tile.len() <= 20 && tile.is_sorted()), "{tiles:?}");
        assert!(tiles.len() < 80, "{} tiles", tiles.len());
        let tile_of =
            |cell: u32| tiles.iter().filter(|tile| tile.iter().any(|&slot| cells[slot as usize] == cell)).count();
        assert!(cells.iter().all(|&cell| tile_of(cell) == 1));
    }

    #[test]
    fn tiles_are_compact_and_come_by_their_least_key() {
        let (positions, cells, keys) = square(32);
        let tiles = cut(&positions, &cells, &keys, 64);
        assert_eq!(tiles.len(), 16);
        for tile in &tiles {
            let of = |part: fn(&Vec3) -> f32| {
                let values = || tile.iter().map(|&slot| part(&positions[slot as usize]));
                values().fold(f32::NEG_INFINITY, f32::max) - values().fold(f32::INFINITY, f32::min)
            };
            assert_eq!((of(|p| p.x), of(|p| p.z)), (7.0, 7.0));
        }
        let least: Vec<f32> = tiles.iter().map(|tile| nearest(tile, |&slot| keys[slot as usize])).collect();
        assert_eq!(least[..4], [0.0, 8.0, 8.0, 8.0]);
        assert!(least.is_sorted(), "{least:?}");
    }

    #[test]
    fn there_are_never_too_many_tiles() {
        let (positions, cells, keys) = square(128);
        let tiles = cut(&positions, &cells, &keys, 1);
        assert!((64..=2 * MOST).contains(&tiles.len()), "{} tiles", tiles.len());
        assert!(cut(&positions, &cells, &[f32::INFINITY; 128 * 128], 16).is_empty());
        let one_cell = cut(&positions, &[7; 128 * 128], &keys, 16);
        assert_eq!(one_cell.len(), 1, "cells stay whole");
    }

    #[test]
    fn the_bound_falls_with_distance_and_ends_at_the_horizon() {
        let place = ChangedSphere { middle: Vec3::new(0.0, 1.0, 0.0), radius: 0.5, power: 0.25 };
        let at = |x: f32, y: f32| place.bound(Vec3::new(x, y, 0.0), Vec3::Y);
        assert_eq!(at(0.0, 0.0), 0.25);
        assert_eq!(at(0.0, 0.8), 1.0, "inside the sphere the form factor is 1");
        assert!(at(1.0, 0.0) < at(0.5, 0.0) && at(3.0, 0.0) < at(1.0, 0.0));
        assert!(at(0.0, 1.4) > 0.0, "part of the sphere is above the horizon");
        assert_eq!(at(0.0, 1.6), 0.0);
        let down = place.bound(Vec3::ZERO, Vec3::NEG_Y);
        assert_eq!(down, 0.0, "it faces away");
    }
}
