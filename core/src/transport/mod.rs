//! One application of the transport operator T: what arrives at an element, estimated with rays.
//!
//! Light maps hold `M = irradiance / π`; a surface with albedo ρ sends out ρ M. With `L = E + ρ M`, one bounce is
//! `M' = G[L]`, where G gathers L over the hemisphere by the cosine.

pub(crate) mod direct;
mod gather;
mod walk;

pub(crate) use direct::DirectLight;
pub(crate) use gather::{gather, gather_with};
pub(crate) use walk::{LightField, incoming_light};

use std::sync::atomic::{AtomicU64, Ordering};

use glam::Vec3;
use rayon::prelude::*;

use crate::bvh::{Hit, Ray};
use crate::job::{Canceled, Observer};
use crate::world::World;

/// Elements per task: long enough to amortise, short enough that a cancel is seen within milliseconds.
const CHUNK: usize = 64;

/// A running job's ray counter and cancel flag, shared by all threads and touched once per chunk.
pub(crate) struct Work<'a> {
    observer: &'a dyn Observer,
    rays: AtomicU64,
}

impl<'a> Work<'a> {
    pub(crate) fn new(observer: &'a dyn Observer) -> Work<'a> {
        Work { observer, rays: AtomicU64::new(0) }
    }

    pub(crate) fn rays(&self) -> u64 {
        self.rays.load(Ordering::Relaxed)
    }

    pub(crate) fn observer(&self) -> &'a dyn Observer {
        self.observer
    }

    /// The cancel flag as an error.
    pub(crate) fn check(&self) -> Result<(), Canceled> {
        if self.observer.canceled() { Err(Canceled) } else { Ok(()) }
    }

    /// Adds to the ray count.
    pub(crate) fn count(&self, rays: u64) {
        self.rays.fetch_add(rays, Ordering::Relaxed);
    }

    /// Evaluates `f(index, slot, &mut rays)` for all slots in parallel. Results do not depend on how the work is cut.
    pub(crate) fn map<T: Send + Clone + Default>(
        &self,
        slots: &[u32],
        f: impl Fn(usize, u32, &mut u64) -> T + Sync,
    ) -> Result<Vec<T>, Canceled> {
        let mut out = vec![T::default(); slots.len()];
        out.par_chunks_mut(CHUNK).zip(slots.par_chunks(CHUNK)).enumerate().try_for_each(|(chunk, (out, slots))| {
            self.check()?;
            let mut rays = 0;
            for (k, (out, &slot)) in out.iter_mut().zip(slots).enumerate() {
                *out = f(chunk * CHUNK + k, slot, &mut rays);
            }
            self.count(rays);
            Ok(())
        })?;
        Ok(out)
    }
}

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
    /// Element slots of the corners on that side; none where the back has no elements.
    pub elements: Option<[u32; 3]>,
    /// Barycentric weights of the second and third corner.
    pub barycentrics: (f32, f32),
}

impl Surfel {
    /// Resolves a hit; none where the side that was met reflects nothing.
    #[inline]
    pub(crate) fn new(world: &World, ray: &Ray, hit: &Hit) -> Option<Surfel> {
        let record = &world.geometry.triangles[hit.triangle as usize];
        let part = &world.parts[record.part as usize];
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
            part: record.part,
            elements,
            barycentrics: (hit.u, hit.v),
        })
    }

    /// Barycentric look-up.
    #[inline]
    pub(crate) fn interpolate(&self, elements: [u32; 3], values: &[Vec3]) -> Vec3 {
        let (u, v) = self.barycentrics;
        values[elements[0] as usize] * (1.0 - u - v)
            + values[elements[1] as usize] * u
            + values[elements[2] as usize] * v
    }
}
