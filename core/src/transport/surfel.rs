//! What a ray met: a reflecting point and the slots that its light is looked up at.

use glam::Vec3;

use crate::bvh::{Hit, Ray};
use crate::space::{Footprint, Part, Spot, ray_offset};
use crate::world::{World, over_bulge};

/// A reflecting point that a ray met, seen from the side of the ray.
#[derive(Clone, Copy, Debug)]
pub struct Surfel {
    /// Scene space.
    pub position: Vec3,
    /// Unit geometric normal on the side that the ray came from.
    pub normal: Vec3,
    /// How far rays start off it, metres.
    pub offset: f32,
    /// Diffuse albedo.
    pub albedo: Vec3,
    /// Index of its part.
    pub part: u32,
    /// The ray met the triangle's back.
    pub is_back: bool,
    /// Id of the cell that the point lies in.
    pub cell: u32,
    /// Where its light is looked up; none where no element knows it.
    pub footprint: Option<Footprint>,
}

impl Surfel {
    /// Resolves a hit; none where the side that was met reflects nothing.
    #[inline]
    pub fn new(world: &World, ray: &Ray, hit: &Hit) -> Option<Surfel> {
        let (mut surfel, part) = Surfel::reflecting(world, ray, hit)?;
        Spot { cell: surfel.cell, footprint: surfel.footprint, albedo: surfel.albedo } =
            world.space.spot(hit, part, surfel.is_back);
        Some(surfel)
    }

    /// Resolves a hit whose light nobody looks up: without footprint, and quicker where the albedo is the same all
    /// over.
    #[inline]
    pub fn without_light(world: &World, ray: &Ray, hit: &Hit) -> Option<Surfel> {
        let (mut surfel, part) = Surfel::reflecting(world, ray, hit)?;
        if part.albedos.is_some() {
            surfel.albedo = world.space.spot(hit, part, surfel.is_back).albedo;
        }
        Some(surfel)
    }

    /// What is known of a hit from its part alone, and the part.
    #[inline]
    fn reflecting<'w>(world: &'w World, ray: &Ray, hit: &Hit) -> Option<(Surfel, &'w Part)> {
        let index = world.space.part_index(hit.triangle);
        let part = &world.space.parts()[index as usize];
        let is_back = hit.normal.dot(ray.direction) > 0.0;
        if is_back && !part.double_sided {
            return None;
        }
        let position = ray.origin + ray.direction * hit.t;
        let surfel = Surfel {
            position,
            // As exact as the way there was long.
            offset: ray_offset(position, part.extent.max(hit.t)),
            normal: if is_back { -hit.normal } else { hit.normal },
            albedo: part.albedo,
            part: index,
            is_back,
            cell: u32::MAX,
            footprint: None,
        };
        Some((surfel, part))
    }

    /// As [`Surfel::new`], for look-ups: where a wall stands on the cell, only elements on this side of it count.
    #[inline]
    pub(crate) fn to_look_up(world: &World, ray: &Ray, hit: &Hit, rays: &mut u64) -> Option<Surfel> {
        let mut surfel = Surfel::new(world, ray, hit)?;
        if world.space.is_cut(surfel.cell) {
            surfel.leave_out_hidden(world, world.space.is_shared(hit.triangle), rays);
        }
        Some(surfel)
    }

    #[cold]
    fn leave_out_hidden(&mut self, world: &World, is_shared: bool, rays: &mut u64) {
        let above = self.normal * world.lift(self.position);
        let from = self.position + above;
        // Values that elements have from neighbours are those of one side, and maybe not of this.
        let is_out = |slot: u32| {
            if !world.is_valid(slot as usize) {
                return true;
            }
            let to = world.positions()[slot as usize] + above;
            *rays += 1;
            let is_hidden = |from: Vec3, to: Vec3| {
                let ray = Ray { origin: from, direction: to - from, t_min: 0.0, t_max: 0.98 };
                from != to && world.trees.any_hiding(&ray)
            };
            if !is_shared {
                return is_hidden(from, to);
            }
            let middle = over_bulge((from, self.normal), (to, world.normals()[slot as usize]));
            *rays += 1;
            is_hidden(from, middle) || is_hidden(to, middle)
        };
        self.footprint = self.footprint.and_then(|footprint| footprint.without(is_out));
    }

    /// Where rays start that leave it.
    #[inline]
    pub fn ray_origin(&self) -> Vec3 {
        self.position + self.normal * self.offset
    }

    /// The element slot that weighs most; `u32::MAX` where there is none.
    #[inline]
    pub(crate) fn nearest_element(&self) -> u32 {
        self.footprint.map_or(u32::MAX, |footprint| footprint.heaviest())
    }

    /// An element slot drawn by its weight, with a uniform number.
    #[inline]
    pub(crate) fn element_by_weight(&self, u: f32) -> u32 {
        self.footprint.map_or(u32::MAX, |footprint| footprint.slots()[footprint.drawn(u)])
    }

    /// Has the values that are looked up fetched into the cache.
    #[inline]
    pub(crate) fn fetch<V>(&self, values: &[V]) {
        let slots = self.footprint.iter().flat_map(|footprint| footprint.slots());
        slots.filter_map(|&slot| values.get(slot as usize)).for_each(fetch);
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
