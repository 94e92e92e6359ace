//! Triangles and random numbers for the tests.

use glam::Vec3;

/// xorshift64*: enough for tests, the same everywhere.
pub(super) struct Random(pub(super) u64);

impl Random {
    /// In 0..1.
    pub(super) fn unit(&mut self) -> f32 {
        self.0 = self.0.max(1);
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 40) as f32 / (1 << 24) as f32
    }

    /// In the cube from -1 to 1.
    pub(super) fn in_cube(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit()) * 2.0 - 1.0
    }
}

/// Triangles anywhere in the cube from -1 to 1.
pub(super) fn soup(random: &mut Random, count: usize, size: f32) -> Vec<[Vec3; 3]> {
    let triangle = |_| {
        let centre = random.in_cube();
        [0; 3].map(|_| centre + random.in_cube() * size)
    };
    (0..count).map(triangle).collect()
}

/// A grid of two triangles per cell over the parallelogram at `origin`.
fn grid(origin: Vec3, side_u: Vec3, side_v: Vec3, cells: usize) -> Vec<[Vec3; 3]> {
    let point = |i: usize, j: usize| origin + side_u * (i as f32 / cells as f32) + side_v * (j as f32 / cells as f32);
    let cell = |index: usize| {
        let (i, j) = (index % cells, index / cells);
        let [p, q, r, s] = [point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)];
        [[p, q, r], [p, r, s]]
    };
    (0..cells * cells).flat_map(cell).collect()
}

/// The cube from -1 to 1, closed: cells of at most `spacing`.
pub(super) fn room(spacing: f32) -> Vec<[Vec3; 3]> {
    let cells = (2.0 / spacing).ceil() as usize;
    let (x, y, z) = (Vec3::X * 2.0, Vec3::Y * 2.0, Vec3::Z * 2.0);
    let low = Vec3::splat(-1.0);
    [(low, x, y), (low + z, y, x), (low, y, z), (low + x, z, y), (low, z, x), (low + y, x, z)]
        .into_iter()
        .flat_map(|(origin, u, v)| grid(origin, u, v, cells))
        .collect()
}

/// The unit sphere, closed: the room blown up.
pub(super) fn sphere(spacing: f32) -> Vec<[Vec3; 3]> {
    room(spacing).into_iter().map(|triangle| triangle.map(Vec3::normalize)).collect()
}
