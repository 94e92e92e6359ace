//! Rays per second through a furnished room, on one thread: `cargo bench --bench rays [-- TRIANGLES]`.
//!
//! Closest hits are asked by cosine-distributed rays from surface points, any hits by shadow rays from the same points
//! to a lamp below the ceiling; points are in spatial order, as the engine takes them. Prints millions of rays per
//! second.
#![allow(clippy::print_stdout)]

use glam::{Mat3, Vec3};
use rebake_core::bvh::{BuildQuality, Bvh, Ray};
use std::f32::consts::TAU;
use std::hint::black_box;
use std::time::Instant;

/// Rays are timed this often; the median is printed.
const ROUNDS: usize = 7;

fn main() {
    let triangles = std::env::args().skip(1).find_map(|argument| argument.parse().ok()).unwrap_or(300_000);
    let corners = furnished_room(triangles);
    let ids: Vec<u32> = (0..corners.len() as u32).collect();
    for quality in [BuildQuality::Fast, BuildQuality::Good] {
        let start = Instant::now();
        let bvh = Bvh::build(&corners, &ids, quality);
        let bytes = bvh.memory_bytes() as f64 / corners.len() as f64;
        println!(
            "{quality:?}: {} triangles built in {:.3} s, {bytes:.0} bytes per triangle, surface area cost {:.1}",
            corners.len(),
            start.elapsed().as_secs_f64(),
            bvh.surface_area_cost(),
        );
        let (cosine, shadow) = rays(&corners);
        let closest = rate(&cosine, |ray| bvh.closest_hit(ray, None).is_some());
        let any = rate(&shadow, |ray| bvh.any_hit(ray, None));
        println!("    closest {:.2} M/s ({:.2} hit), any {:.2} M/s ({:.2} hit)", closest.0, closest.1, any.0, any.1);
    }
}

/// Millions of rays per second, and the part that hits.
fn rate(rays: &[Ray], hit: impl Fn(&Ray) -> bool) -> (f64, f64) {
    let mut hits = 0;
    let mut seconds: Vec<f64> = (0..ROUNDS)
        .map(|_| {
            let start = Instant::now();
            hits = black_box(rays.iter().filter(|ray| hit(ray)).count());
            start.elapsed().as_secs_f64()
        })
        .collect();
    seconds.sort_by(f64::total_cmp);
    (rays.len() as f64 / seconds[ROUNDS / 2] / 1e6, hits as f64 / rays.len() as f64)
}

/// About two cosine rays and one shadow ray for every triangle, at most 600,000 and 300,000.
pub fn rays(corners: &[[Vec3; 3]]) -> (Vec<Ray>, Vec<Ray>) {
    let mut points: Vec<_> =
        corners.iter().map(|&[a, b, c]| ((a + b + c) / 3.0, (b - a).cross(c - a).normalize())).collect();
    points.sort_by_cached_key(|(point, _)| morton(*point));
    points.truncate(points.len() / 8 * 8);
    let (mut cosine, mut shadow) = (Vec::new(), Vec::new());
    let mut random = Random(1);
    // Whole tiles of points, evenly spread, where there are too many.
    let skipped = points.len().div_ceil(300_000);
    for (point, normal) in points.chunks(256).step_by(skipped).flatten() {
        let tangent = normal.any_orthonormal_vector();
        let frame = Mat3::from_cols(tangent, normal.cross(tangent), *normal);
        let origin = *point + *normal * 1e-4;
        for _ in 0..2 {
            let (radius, angle) = (random.unit().sqrt(), random.unit() * TAU);
            let local = Vec3::new(radius * angle.cos(), radius * angle.sin(), (1.0 - radius * radius).sqrt());
            cosine.push(Ray { origin, direction: frame * local, t_min: 0.0, t_max: f32::INFINITY });
        }
        let lamp = Vec3::new(3.0 + 2.0 * random.unit(), 2.7, 2.0 + 2.0 * random.unit());
        if normal.dot(lamp - origin) > 0.0 {
            shadow.push(Ray { origin, direction: lamp - origin, t_min: 0.0, t_max: 0.999 });
        }
    }
    (cosine, shadow)
}

/// A closed room of 8 × 2.8 × 6 m with tables, chairs, shelves, lamps and balls, of about that many triangles.
pub fn furnished_room(triangles: usize) -> Vec<[Vec3; 3]> {
    // Surfaces of about 340 m², measured with a fine spacing.
    let mut mesh = Mesh { spacing: (2.0 * 340.0 / triangles as f32).sqrt(), triangles: Vec::new() };
    mesh.cuboid(Vec3::new(4.0, 1.4, 3.0), Vec3::new(-8.0, 2.8, 6.0), 0.0);
    let mut random = Random(2);
    for table in 0..4 {
        let centre = Vec3::new(1.5 + (table % 2) as f32 * 4.5, 0.0, 1.5 + (table / 2) as f32 * 3.0);
        mesh.table(centre, Vec3::new(1.4, 0.75, 0.8), random.unit());
        for chair in 0..4 {
            let angle = chair as f32 * TAU / 4.0 + 0.3;
            let seat = centre + Vec3::new(angle.cos() * 0.9, 0.0, angle.sin() * 0.9);
            mesh.table(seat, Vec3::new(0.42, 0.45, 0.42), angle);
            mesh.cuboid(seat + Vec3::Y * 0.7, Vec3::new(0.42, 0.45, 0.03), angle);
        }
        for _ in 0..8 {
            let place = Vec3::new(random.unit() - 0.5, 0.0, random.unit() * 0.5 - 0.25);
            let radius = 0.04 + 0.06 * random.unit();
            mesh.ball(centre + place + Vec3::Y * (0.77 + radius), radius);
        }
    }
    for shelf in 0..3 {
        let left = Vec3::new(2.0 + 2.0 * shelf as f32, 0.0, 5.75);
        for board in 0..6 {
            let height = Vec3::Y * (0.1 + 0.38 * board as f32);
            mesh.cuboid(left + height, Vec3::new(1.6, 0.03, 0.35), 0.0);
            for book in 0..24 {
                let size = Vec3::new(0.03 + 0.02 * random.unit(), 0.2 + 0.1 * random.unit(), 0.2);
                let place = Vec3::new(-0.75 + 0.062 * book as f32, 0.02 + size.y / 2.0, 0.0);
                mesh.cuboid(left + height + place, size, 0.1 * random.unit());
            }
        }
    }
    mesh.triangles
}

struct Mesh {
    spacing: f32,
    triangles: Vec<[Vec3; 3]>,
}

impl Mesh {
    /// Two triangles per cell of about `spacing`; the normal is u × v.
    fn patch(&mut self, u_size: f32, v_size: f32, point: impl Fn(f32, f32) -> Vec3) {
        let cells = |size: f32| (size / self.spacing).ceil().max(1.0) as usize;
        let (columns, rows) = (cells(u_size), cells(v_size));
        for (i, j) in (0..columns * rows).map(|cell| (cell % columns, cell / columns)) {
            let corner = |i: usize, j: usize| point(i as f32 / columns as f32, j as f32 / rows as f32);
            let [p, q, r, s] = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
            self.triangles.extend([[p, q, r], [p, r, s]]);
        }
    }

    /// A box turned about the vertical. A negative width turns it inside out.
    fn cuboid(&mut self, centre: Vec3, size: Vec3, angle: f32) {
        let turn = Mat3::from_rotation_y(angle);
        for (n, u, v) in [(Vec3::X, Vec3::Y, Vec3::Z), (Vec3::Y, Vec3::Z, Vec3::X), (Vec3::Z, Vec3::X, Vec3::Y)] {
            for (n, u, v) in [(n, u, v), (-n, v, u)] {
                let face = |s: f32, t: f32| centre + turn * ((n * 0.5 + u * (s - 0.5) + v * (t - 0.5)) * size);
                self.patch((u * size).length(), (v * size).length(), face);
            }
        }
    }

    fn table(&mut self, centre: Vec3, size: Vec3, angle: f32) {
        self.cuboid(centre + Vec3::Y * size.y, Vec3::new(size.x, 0.03, size.z), angle);
        for (x, z) in [(-0.45, -0.45), (-0.45, 0.45), (0.45, -0.45), (0.45, 0.45)] {
            let foot = Mat3::from_rotation_y(angle) * Vec3::new(x * size.x, size.y / 2.0, z * size.z);
            self.cuboid(centre + foot, Vec3::new(0.05, size.y - 0.03, 0.05), angle);
        }
    }

    fn ball(&mut self, centre: Vec3, radius: f32) {
        self.patch(radius * TAU, radius * TAU / 2.0, |s, t| {
            let ((sin, cos), (height, ring)) =
                ((s * TAU).sin_cos(), ((0.02 + 0.96 * t) * TAU / 2.0 + TAU / 4.0).sin_cos());
            centre + Vec3::new(-cos * ring, -height, sin * ring) * radius
        });
    }
}

struct Random(u64);

impl Random {
    fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1 << 24) as f32
    }
}

/// Cells of 1/64 m along a space-filling curve.
fn morton(point: Vec3) -> u64 {
    let spread = |x: f32| (0..10).fold(0, |code, bit| code | ((x * 64.0) as u64 >> bit & 1) << (3 * bit));
    spread(point.x) | spread(point.y) << 1 | spread(point.z) << 2
}
