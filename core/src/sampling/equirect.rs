//! Directions by the texels of an equirectangular picture.

use std::f32::consts::TAU;
use std::f64::consts::PI;

use glam::Vec3;

use super::Discrete;

/// The texels of an equirectangular picture as cells of the sphere: rows from +y at the top to −y at the bottom, columns
/// around it, the middle of the picture towards +x, three quarters of its width towards +z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Equirect {
    /// Columns, at least 1.
    pub width: usize,
    /// Rows, at least 1.
    pub height: usize,
}

impl Equirect {
    /// (row, column) of a unit direction.
    #[inline]
    pub fn texel(&self, direction: Vec3) -> (usize, usize) {
        // From both sine and cosine: near the poles the cosine alone has lost its digits.
        let theta = direction.x.hypot(direction.z).atan2(direction.y);
        let row = (theta * (self.height as f32 / std::f32::consts::PI)) as usize;
        let turn = direction.z.atan2(direction.x) / TAU + 0.5;
        let column = (turn * self.width as f32) as usize;
        (row.min(self.height - 1), column % self.width)
    }

    /// Solid angle of each texel of a row, sr.
    pub fn solid_angle(&self, row: usize) -> f64 {
        2.0 * PI / self.width as f64 * (self.edge(row) - self.edge(row + 1))
    }

    /// Cosine between +y and the upper edge of a row.
    fn edge(&self, row: usize) -> f64 {
        (PI * row as f64 / self.height as f64).cos()
    }

    /// A unit direction in a texel, uniform in solid angle for uniform `u`: (across, down).
    #[inline]
    pub fn direction(&self, (row, column): (usize, usize), u: [f32; 2]) -> Vec3 {
        let (top, bottom) = (self.edge(row), self.edge(row + 1));
        let y = top + (bottom - top) * f64::from(u[1]);
        let turn = (column as f64 + f64::from(u[0])) / self.width as f64 - 0.5;
        let (sin, cos) = (2.0 * PI * turn).sin_cos();
        let r = ((1.0 - y) * (1.0 + y)).max(0.0).sqrt();
        glam::DVec3::new(r * cos, y, r * sin).as_vec3()
    }
}

/// Directions whose density over each texel is in proportion to a weight: rows first, then a texel of the row.
#[derive(Clone, Debug)]
pub struct TexelChoice {
    grid: Equirect,
    rows: Discrete,
    columns: Vec<Discrete>,
    /// Solid angle of each texel of a row, inverted, 1/sr.
    densities: Vec<f32>,
}

impl TexelChoice {
    /// By `weight(row, column)` per steradian, finite and at least 0; none where all are zero.
    pub fn new(grid: Equirect, weight: impl Fn(usize, usize) -> f32) -> Option<TexelChoice> {
        let row = |row: usize| (0..grid.width).map(move |column| (row, column));
        let weight = |(row, column): (usize, usize)| f64::from(weight(row, column));
        let of_row = |r: usize| row(r).map(weight).sum::<f64>() * grid.solid_angle(r);
        Some(TexelChoice {
            grid,
            rows: Discrete::new((0..grid.height).map(of_row))?,
            columns: (0..grid.height).map(|r| Discrete::new(row(r).map(weight)).unwrap_or_default()).collect(),
            densities: (0..grid.height).map(|r| (1.0 / grid.solid_angle(r)) as f32).collect(),
        })
    }

    /// A unit direction.
    #[inline]
    pub fn sample(&self, [u, v]: [f32; 2]) -> Vec3 {
        let (row, down) = self.rows.sample(v);
        let (column, across) = self.columns[row].sample(u);
        self.grid.direction((row, column), [across, down])
    }

    /// Density of [`TexelChoice::sample`] per steradian.
    #[inline]
    pub fn pdf(&self, direction: Vec3) -> f32 {
        let (row, column) = self.grid.texel(direction);
        let of_row = self.rows.pdf(row);
        if of_row == 0.0 { 0.0 } else { of_row * self.columns[row].pdf(column) * self.densities[row] }
    }

    /// Bytes that it holds.
    pub fn memory_bytes(&self) -> usize {
        (self.grid.width + 2) * self.grid.height * size_of::<f32>()
    }
}
