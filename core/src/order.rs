//! Spatial order: points along a Hilbert curve, so that what is computed one after the other lies side by side and rays
//! meet the same part of the tree.

use glam::Vec3;

/// Bits per axis.
const BITS: u32 = 12;

/// Indices of points in their order along the curve through a cube around all of them; ties go by the index, so that
/// the order is the same in every run.
pub(crate) fn along_curve(points: &[Vec3]) -> Vec<u32> {
    let grid = Grid::new(points);
    let mut keys: Vec<(u64, u32)> = points.iter().map(|p| grid.key(*p)).zip(0..).collect();
    keys.sort_unstable();
    keys.into_iter().map(|(_, index)| index).collect()
}

/// Values in an order of their indices, such as [`along_curve`] tells.
pub(crate) fn in_order<T: Copy>(values: &[T], order: &[u32]) -> Vec<T> {
    order.iter().map(|&old| values[old as usize]).collect()
}

/// A cube around all points, cut into 2¹² cells per axis.
struct Grid {
    low: Vec3,
    cells_per_metre: f32,
}

impl Grid {
    fn new(points: &[Vec3]) -> Self {
        let low = points.iter().copied().fold(Vec3::INFINITY, Vec3::min);
        let high = points.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
        let extent = (high - low).max_element();
        let cells_per_metre = if extent > 0.0 { ((1 << BITS) - 1) as f32 / extent } else { 0.0 };
        Self { low, cells_per_metre }
    }

    fn key(&self, point: Vec3) -> u64 {
        // A cast of a float to an integer saturates: no point falls off the grid's ends into another cell's key.
        let cell = (point - self.low) * self.cells_per_metre;
        hilbert(cell.to_array().map(|c| (c as u32).min((1 << BITS) - 1)))
    }
}

/// Index along the Hilbert curve (J. Skilling, Programming the Hilbert curve, 2004).
fn hilbert(mut x: [u32; 3]) -> u64 {
    let mut bit = 1_u32 << (BITS - 1);
    while bit > 1 {
        let below = bit - 1;
        for axis in 0..3 {
            if x[axis] & bit != 0 {
                x[0] ^= below;
            } else {
                let swap = (x[0] ^ x[axis]) & below;
                x[0] ^= swap;
                x[axis] ^= swap;
            }
        }
        bit >>= 1;
    }
    x[1] ^= x[0];
    x[2] ^= x[1];
    let mut flip = 0;
    let mut bit = 1_u32 << (BITS - 1);
    while bit > 1 {
        if x[2] & bit != 0 {
            flip ^= bit - 1;
        }
        bit >>= 1;
    }
    let x = x.map(|value| value ^ flip);
    spread(x[0]) << 2 | spread(x[1]) << 1 | spread(x[2])
}

/// Puts two zero bits between each two of the low 16 bits, by moving halves apart.
fn spread(value: u32) -> u64 {
    let mut x = u64::from(value & 0xffff);
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    /// On a small sub-cube: neighbours along the curve are neighbours in space, and no cell is missing.
    #[test]
    fn curve_visits_every_cell_in_steps_of_one() {
        let side = 8_u32;
        let mut cells: Vec<(u64, [i64; 3])> = Vec::new();
        for index in 0..side.pow(3) {
            let cell = [index % side, index / side % side, index / side / side];
            cells.push((hilbert(cell), cell.map(i64::from)));
        }
        cells.sort_unstable();
        for (expected, pair) in cells.windows(2).enumerate() {
            assert_eq!(pair[0].0, expected as u64);
            let step: i64 = (0..3).map(|axis| (pair[0].1[axis] - pair[1].1[axis]).abs()).sum();
            assert_eq!(step, 1, "{pair:?}");
        }
    }
}
