//! Lines between neighbouring elements, over the light that they hold.

use glam::Vec3;

use crate::bvh::Ray;
use crate::space::Footprint;
use crate::world::World;

/// Half the width of a line, pixels.
const HALF_WIDTH: f32 = 0.6;

/// Cells that are less than this high, in pixels, have fainter lines: they would cover the light.
const CLEAR: f32 = 8.0;

/// How much of a line hides what is below it.
const OPACITY: f32 = 0.7;

/// Lines in the dark: as bright as the mean light, and of a colour that light seldom has.
const COLOR: Vec3 = Vec3::new(1.5, 0.5, 0.1);

/// Where there is this part of the mean light, lines are darker than it.
const LIT: f32 = 0.4;

/// How lines are drawn.
pub(super) struct Lines {
    mean: f32,
    /// Angle that a pixel takes up.
    pixel: f32,
}

impl Lines {
    /// `light` per slot.
    pub(super) fn new(world: &World, light: &[Vec3], pixel: f32) -> Lines {
        let mean = world.area_mean(0..light.len(), |slot| f64::from(light[slot].element_sum()) / 3.0) as f32;
        // In the dark there is nothing but lines.
        Lines { mean: if mean > 0.0 { mean } else { 1.0 }, pixel }
    }

    /// Light where a camera ray met a cell, with the lines at its edges.
    pub(super) fn over(&self, light: Vec3, world: &World, footprint: &Footprint, ray: &Ray) -> Vec3 {
        let corners: [Vec3; 3] = std::array::from_fn(|k| world.positions()[footprint.slots()[k] as usize] - ray.origin);
        // A ray and an edge are as far apart as the ray is from the plane through the eye and the edge.
        let apart = |edge: usize, direction: Vec3| {
            let plane = corners[edge].cross(corners[(edge + 1) % 3]).normalize_or_zero();
            plane.dot(direction).abs() / self.pixel
        };
        let nearest = (0..3).map(|edge| apart(edge, ray.direction)).fold(f32::INFINITY, f32::min);
        if nearest > HALF_WIDTH {
            return light;
        }
        let height = |edge: usize| apart(edge, corners[(edge + 2) % 3].normalize_or_zero());
        let least = (0..3).map(height).fold(f32::INFINITY, f32::min);
        let is_lit = light.element_sum() / 3.0 > LIT * self.mean;
        let color = if is_lit { Vec3::ZERO } else { COLOR * self.mean };
        light.lerp(color, OPACITY * (least / CLEAR).min(1.0))
    }
}
