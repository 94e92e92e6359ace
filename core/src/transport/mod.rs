//! One application of the transport operator T: what arrives at an element, estimated with rays.
//!
//! Light maps hold `M = irradiance / π`; a surface with albedo ρ sends out ρ M. With `L = E + ρ M`, one bounce is
//! `M' = G[L]`, where G gathers L over the hemisphere by the cosine.

pub(crate) mod direct;
mod effort;
mod gather;
mod hint;
mod incoming;
mod spots;
mod surfel;
mod value;
mod walk;

pub(crate) use direct::DirectLight;
pub(crate) use effort::Effort;
pub(crate) use gather::gather;
pub(crate) use hint::Hint;
pub(crate) use incoming::{Radiance, Source};
pub(crate) use spots::{Spots, Target};
pub(crate) use surfel::Surfel;
pub(crate) use value::{Layered, Value, Wide};
pub(crate) use walk::{End, Field, Rough, walk};

use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use crate::job::{Canceled, Observer};

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
