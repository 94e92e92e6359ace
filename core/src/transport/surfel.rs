//! What a ray met: a reflecting point and the elements that its light is looked up at.

use glam::Vec3;

use super::Value;
use crate::bvh::{Hit, Ray};
use crate::world::World;

/// A reflecting point that a ray met, seen from the side of the ray.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surfel {
    /// Scene space.
    pub position: Vec3,
    /// Unit geometric normal on the side that the ray came from.
    pub normal: Vec3,
    /// Diffuse albedo.
    pub albedo: Vec3,
    /// Index of its part.
    pub part: u32,
    /// Its triangle's slot.
    pub triangle: u32,
    /// The ray met the triangle's back.
    pub is_back: bool,
    /// Element slots of the corners on that side; none where there are none that know the light of this point.
    pub elements: Option<[u32; 3]>,
    /// Weights of the corners, sum 1.
    pub weights: [f32; 3],
}

impl Surfel {
    /// Resolves a hit; none where the side that was met reflects nothing.
    #[inline]
    pub(crate) fn new(world: &World, ray: &Ray, hit: &Hit) -> Option<Surfel> {
        let record = &world.geometry.triangles[hit.triangle as usize];
        let part = &world.parts[record.part() as usize];
        let back = hit.normal.dot(ray.direction) > 0.0;
        if back && !part.double_sided {
            return None;
        }
        let elements = match (back, part.back_offset) {
            (false, _) => Some(record.elements),
            (true, 0) => None,
            (true, offset) => Some(record.elements.map(|e| e + offset)),
        };
        Some(Surfel {
            position: ray.origin + ray.direction * hit.t,
            normal: if back { -hit.normal } else { hit.normal },
            albedo: part.albedo,
            part: record.part(),
            triangle: hit.triangle,
            is_back: back,
            elements,
            weights: [1.0 - hit.u - hit.v, hit.u, hit.v],
        })
    }

    /// As [`Surfel::new`], for look-ups: where a wall cuts the triangle, only corners on this side of it count.
    #[inline]
    pub(crate) fn to_look_up(world: &World, ray: &Ray, hit: &Hit, rays: &mut u64) -> Option<Surfel> {
        let mut surfel = Surfel::new(world, ray, hit)?;
        if world.geometry.triangles[hit.triangle as usize].is_cut() {
            surfel.leave_out_hidden(world, rays);
        }
        Some(surfel)
    }

    #[cold]
    fn leave_out_hidden(&mut self, world: &World, rays: &mut u64) {
        let Some(elements) = self.elements else { return };
        let lift = world.lift();
        let from = self.position + self.normal * lift;
        let mut sum = 0.0;
        for (weight, element) in self.weights.iter_mut().zip(elements) {
            let to = world.geometry.positions[element as usize] + self.normal * lift;
            *rays += 1;
            let ray = Ray { origin: from, direction: to - from, t_min: 0.0, t_max: 0.98 };
            if from != to && world.trees.any_hit(&ray) {
                *weight = 0.0;
            }
            sum += *weight;
        }
        if sum > 1e-3 {
            self.weights.iter_mut().for_each(|w| *w /= sum);
        } else {
            self.elements = None;
        }
    }

    /// The element slot that weighs most; `u32::MAX` where there is none.
    #[inline]
    pub(crate) fn nearest_element(&self) -> u32 {
        let [a, b, c] = self.weights;
        let k = if a >= b && a >= c { 0 } else { 1 + usize::from(c > b) };
        self.elements.map_or(u32::MAX, |e| e[k])
    }

    /// An element slot drawn by its weight, with a uniform number.
    #[inline]
    pub(crate) fn element_by_weight(&self, u: f32) -> u32 {
        let [a, b, _] = self.weights;
        self.elements.map_or(u32::MAX, |e| e[usize::from(u >= a) + usize::from(u >= a + b)])
    }

    /// Has the values of its corners fetched into the cache.
    #[inline]
    pub(crate) fn fetch<V>(&self, values: &[V]) {
        for value in self.elements.iter().flatten().filter_map(|&element| values.get(element as usize)) {
            fetch(value);
        }
    }

    /// Barycentric look-up.
    #[inline]
    pub(crate) fn interpolate<V: Value>(&self, elements: [u32; 3], values: &[V]) -> V {
        values[elements[0] as usize] * self.weights[0]
            + values[elements[1] as usize] * self.weights[1]
            + values[elements[2] as usize] * self.weights[2]
    }
}

/// Has a value fetched into the cache.
#[inline]
fn fetch<V>(value: &V) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        const LINE: usize = 64;
        let first = std::ptr::from_ref(value).cast::<i8>();
        let end = first.addr() + size_of::<V>();
        let mut line = first.map_addr(|a| a & !(LINE - 1));
        while line.addr() < end {
            // SAFETY: SSE is part of x86-64; a prefetch never faults.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(line) };
            line = line.wrapping_add(LINE);
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = value;
}
