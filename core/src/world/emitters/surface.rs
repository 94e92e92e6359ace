//! Emissive surfaces as transport samples them.

use std::f32::consts::FRAC_1_PI;
use std::sync::Arc;

use glam::Vec3;

use super::{Emitter, LightSample, Shape};
use crate::bvh::{Hit, Ray};
use crate::sampling::{Discrete, SphericalTriangle, uniform_barycentrics};
use crate::surface::{Facets, SeeThrough, barycentrics};

/// Emitters of at most so many triangles are sampled by the solid angle of all of them from near.
const FEW: usize = 4;

/// An emissive triangle in scene space: a face, or a facet of one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EmissiveTriangle {
    /// Index in its object's surface, of the face.
    pub face: u32,
    /// Corners, counter-clockwise from the front.
    pub corners: [Vec3; 3],
    /// Unit geometric normal.
    pub normal: Vec3,
    /// m².
    pub area: f32,
}

/// The emissive triangles of an object's material.
pub(crate) struct Emissive {
    /// Key of the object.
    pub key: u32,
    /// Ascending by face.
    pub triangles: Vec<EmissiveTriangle>,
    /// What each of them sends out, where that varies: in the same order.
    pub facets: Option<Arc<Facets>>,
    /// Both sides emit.
    pub double_sided: bool,
    /// What of the object lets light through.
    pub see_through: Option<Arc<SeeThrough>>,
}

/// The shape of some triangles.
pub(super) fn shape(Emissive { triangles, facets, double_sided, see_through, .. }: Emissive) -> Shape {
    let bright = |index: usize| facets.as_ref().map_or(1.0, |facets| facets.list()[index].color.element_sum() / 3.0);
    let powers = || triangles.iter().enumerate().map(|(index, t)| f64::from(t.area) * f64::from(bright(index)));
    let choice = Discrete::new(powers()).unwrap_or_default();
    let corners = || triangles.iter().flat_map(|t| t.corners);
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    corners().for_each(|c| {
        low = low.min(c);
        high = high.max(c);
    });
    let center = (low + high) * 0.5;
    let radius = corners().map(|c| c.distance(center)).fold(0.0, f32::max) * 1.0001;
    let largest = triangles.iter().map(|t| t.area).fold(0.0, f32::max);
    let area: f32 = triangles.iter().map(|t| t.area).sum();
    let brightness = facets.as_ref().map_or(1.0, |_| (powers().sum::<f64>() / f64::from(area).max(1e-30)) as f32);
    Shape::Surface {
        triangles,
        choice,
        facets,
        double_sided,
        center,
        radius,
        low,
        high,
        largest,
        area,
        brightness,
        see_through,
    }
}

/// Few triangles that are near together by solid angle; else triangles by area, and the point on one by area from afar
/// and by solid angle from near, where 1/r² would explode.
#[inline]
pub(super) fn sample(
    triangles: &[EmissiveTriangle],
    choice: &Discrete,
    double_sided: bool,
    point: Vec3,
    n: Vec3,
    [u, v]: [f32; 2],
) -> Option<(LightSample, usize)> {
    if triangles.len() <= FEW && triangles.iter().any(|t| t.is_near(point)) {
        return sample_few(triangles, double_sided, point, n, [u, v]);
    }
    let (index, u) = if triangles.len() == 1 { (0, u) } else { choice.sample(u) };
    let triangle = &triangles[index];
    let probability = choice.pdf(index);
    if !triangle.shines_at(point, double_sided) {
        return None;
    }
    if triangle.is_near(point) {
        let spherical = SphericalTriangle::new(point, triangle.corners)?;
        let sample = triangle.towards(point, n, spherical.sample([u, v]), probability * spherical.pdf())?;
        return Some((sample, index));
    }
    let [a, b, c] = triangle.corners;
    let (b1, b2) = uniform_barycentrics([u, v]);
    let w = a + (b - a) * b1 + (c - a) * b2 - point;
    let distance2 = w.length_squared();
    let distance = distance2.sqrt();
    let direction = w / distance;
    let cos = n.dot(direction);
    let cos_light = direction.dot(triangle.normal).abs();
    let weight = cos * cos_light * triangle.area / (distance2 * probability) * FRAC_1_PI;
    (cos > 0.0).then_some((LightSample { direction, distance, weight, tint: Vec3::ONE }, index))
}

/// Uniform over the solid angle of all triangles together.
fn sample_few(
    triangles: &[EmissiveTriangle],
    double_sided: bool,
    point: Vec3,
    n: Vec3,
    [u, v]: [f32; 2],
) -> Option<(LightSample, usize)> {
    let mut seen = [None; FEW];
    let mut total = 0.0;
    for (slot, triangle) in seen.iter_mut().zip(triangles) {
        if triangle.shines_at(point, double_sided) {
            *slot = SphericalTriangle::new(point, triangle.corners);
            total += slot.map_or(0.0, |s| s.solid_angle);
        }
    }
    let mut left = f64::from(u) * total;
    let mut last = None;
    for (index, spherical) in seen.iter().enumerate() {
        let Some(spherical) = spherical else { continue };
        last = Some((spherical, index, left));
        if left < spherical.solid_angle {
            break;
        }
        left -= spherical.solid_angle;
    }
    let (spherical, index, left) = last?;
    let u = ((left / spherical.solid_angle) as f32).clamp(0.0, 0.999_999_94);
    Some((triangles[index].towards(point, n, spherical.sample([u, v]), (1.0 / total) as f32)?, index))
}

impl Emitter {
    /// Density per steradian with which [`Emitter::sample`] finds the point that a ray met on this emissive surface;
    /// zero where it never does. `which` tells the index of the triangle, where it is needed: near many triangles, and of
    /// facets.
    pub(crate) fn pdf(&self, ray: &Ray, hit: &Hit, which: impl FnOnce() -> Option<usize>) -> f32 {
        let Shape::Surface { triangles, choice, facets, double_sided, center, radius, largest, area, .. } = &self.shape
        else {
            return 0.0;
        };
        let point = ray.origin;
        let slope = ray.direction.dot(hit.normal).abs();
        let few = triangles.len() <= FEW;
        if few && triangles.iter().any(|t| t.is_near(point)) {
            let seen = triangles.iter().filter(|t| t.shines_at(point, *double_sided));
            let total: f64 = seen.filter_map(|t| SphericalTriangle::new(point, t.corners)).map(|s| s.solid_angle).sum();
            return if total > 0.0 && slope >= 1e-7 { (1.0 / total) as f32 } else { 0.0 };
        }
        // Of the triangle, where it counts which; else all are one area.
        let (mut probability, mut area) = (1.0, *area);
        if facets.is_some() || !few && point.distance(*center) < radius + (8.0 * largest).sqrt() {
            let Some(index) = which() else { return 0.0 };
            let triangle = &triangles[index];
            if triangle.is_near(point) {
                let spherical = SphericalTriangle::new(point, triangle.corners).filter(|_| slope >= 1e-7);
                return spherical.map_or(0.0, |s| choice.pdf(index) * s.pdf());
            }
            if facets.is_some() {
                (probability, area) = (choice.pdf(index), triangle.area);
            }
        }
        if slope > 0.0 { probability * (hit.t * hit.t / (slope * area)) } else { 0.0 }
    }
}

impl EmissiveTriangle {
    /// Whether it is so near that points on it differ much in distance.
    #[inline]
    fn is_near(&self, point: Vec3) -> bool {
        let [a, b, c] = self.corners;
        ((a + b + c) * (1.0 / 3.0) - point).length_squared() < 8.0 * self.area
    }

    /// Height of a point over the triangle's plane, m.
    #[inline]
    fn height(&self, point: Vec3) -> f32 {
        (point - self.corners[0]).dot(self.normal)
    }

    #[inline]
    fn shines_at(&self, point: Vec3, double_sided: bool) -> bool {
        let height = self.height(point);
        height > 0.0 || double_sided && height < 0.0
    }

    /// The sample in a direction that was drawn with density `pdf` per steradian.
    #[inline]
    fn towards(&self, point: Vec3, n: Vec3, direction: Vec3, pdf: f32) -> Option<LightSample> {
        let cos = n.dot(direction);
        let slope = -direction.dot(self.normal);
        if cos <= 0.0 || slope.abs() < 1e-7 {
            return None;
        }
        let distance = self.height(point) / slope;
        (distance > 0.0).then_some(LightSample { direction, distance, weight: cos * FRAC_1_PI / pdf, tint: Vec3::ONE })
    }
}

/// What a place of a triangle sends out of unit strength, linear RGB: what its facet shows, and as much of it as is
/// there. What goes through a pane adds to that and takes nothing of it.
#[inline(never)]
pub(super) fn sent_at(
    triangle: &EmissiveTriangle,
    index: usize,
    (facets, see_through): (Option<&Facets>, Option<&SeeThrough>),
    point: Vec3,
) -> Vec3 {
    let facet = facets.map(|facets| &facets.list()[index]);
    let covered = see_through.map_or(1.0, |see_through| {
        let weights = barycentrics(point, triangle.corners);
        let place = facet.map_or([weights[1], weights[2]], |facet| facet.place(weights));
        see_through.at(triangle.face as usize, place).map_or(1.0, |passage| passage.covered)
    });
    facet.map_or(Vec3::ONE, |facet| facet.color) * covered
}
