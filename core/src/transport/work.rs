//! What a running job is doing, and loops over slots on all threads.

use std::ops::AddAssign;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

use rayon::prelude::*;

use crate::job::{Canceled, Observer};
use crate::ranges::split_mut;

/// Elements per task: long enough to amortise, short enough that a cancel is seen within milliseconds.
const CHUNK: usize = 64;

/// Slots per task where little is done for each.
const LONG_CHUNK: usize = 4096;

/// A running job's ray counter and cancel flag, shared by all threads and touched once per chunk.
pub struct Work<'a> {
    observer: &'a dyn Observer,
    rays: AtomicU64,
}

impl<'a> Work<'a> {
    /// Of a job that nobody counts the rays of yet.
    pub fn new(observer: &'a dyn Observer) -> Work<'a> {
        Work { observer, rays: AtomicU64::new(0) }
    }

    /// Rays counted so far.
    pub fn rays(&self) -> u64 {
        self.rays.load(Ordering::Relaxed)
    }

    pub(crate) fn observer(&self) -> &'a dyn Observer {
        self.observer
    }

    /// The cancel flag as an error.
    pub(crate) fn check(&self) -> Result<(), Canceled> {
        if self.observer.canceled() { Err(Canceled) } else { Ok(()) }
    }

    /// A loop of so many tasks.
    pub(crate) fn tasks(&self, count: usize) -> Tasks<'_> {
        Tasks { work: self, begun: AtomicUsize::new(0), count }
    }

    /// Adds to the ray count.
    pub(crate) fn count(&self, rays: u64) {
        self.rays.fetch_add(rays, Ordering::Relaxed);
    }

    /// Evaluates `f(index, slot, &mut rays)` for all slots in parallel. Results do not depend on how the work is cut.
    pub fn map<T: Send + Clone + Default>(
        &self,
        slots: &[u32],
        f: impl Fn(usize, u32, &mut u64) -> T + Sync,
    ) -> Result<Vec<T>, Canceled> {
        let mut out = vec![T::default(); slots.len()];
        let tasks = self.tasks(slots.len().div_ceil(CHUNK));
        out.par_chunks_mut(CHUNK).zip(slots.par_chunks(CHUNK)).enumerate().try_for_each(|(chunk, (out, slots))| {
            tasks.begin()?;
            let mut rays = 0;
            for (k, (out, &slot)) in out.iter_mut().zip(slots).enumerate() {
                *out = f(chunk * CHUNK + k, slot, &mut rays);
            }
            self.count(rays);
            Ok(())
        })?;
        Ok(out)
    }

    /// Adds `f(slot, &mut rays)` to the values of some slots, ascending, in parallel.
    pub(crate) fn add<T: Send + AddAssign>(
        &self,
        slots: &[u32],
        values: &mut [T],
        f: impl Fn(u32, &mut u64) -> T + Sync,
    ) -> Result<(), Canceled> {
        let pieces = pieces(slots, values, CHUNK);
        let tasks = self.tasks(pieces.len());
        pieces.into_par_iter().try_for_each(|piece| {
            tasks.begin()?;
            let mut rays = 0;
            piece.for_each(|slot, value| *value += f(slot, &mut rays));
            self.count(rays);
            Ok(())
        })
    }
}

/// A loop that runs on all threads.
pub(crate) struct Tasks<'a> {
    work: &'a Work<'a>,
    begun: AtomicUsize,
    count: usize,
}

impl Tasks<'_> {
    /// One of them begins, unless the job is to end.
    pub(crate) fn begin(&self) -> Result<(), Canceled> {
        self.work.check()?;
        let before = self.begun.fetch_add(1, Ordering::Relaxed);
        self.work.observer.advanced(before as f32 / self.count as f32);
        Ok(())
    }
}

/// No light in so many slots: fresh memory is touched on all threads.
pub(crate) fn black<V: Default + Send>(slots: usize) -> Vec<V> {
    let mut light = Vec::new();
    blacken(&mut light, slots);
    light
}

/// No light in so many slots, in memory that is there.
pub(crate) fn blacken<V: Default + Send>(light: &mut Vec<V>, slots: usize) {
    (0..slots).into_par_iter().with_min_len(LONG_CHUNK).map(|_| V::default()).collect_into_vec(light);
}

/// Some sums over chunks, the same on any number of threads.
pub(crate) fn sums<const N: usize, C: IntoIterator>(
    chunks: impl IndexedParallelIterator<Item = C>,
    of: impl Fn(C::Item) -> [f64; N] + Sync,
) -> [f64; N] {
    let add = |a: [f64; N], b: [f64; N]| std::array::from_fn(|k| a[k] + b[k]);
    let partials: Vec<[f64; N]> = chunks.map(|chunk| chunk.into_iter().map(&of).fold([0.0; N], add)).collect();
    partials.into_iter().fold([0.0; N], add)
}

/// Calls `f(slot, value)` for the values of some slots, ascending, in parallel.
pub(crate) fn for_slots<T: Send>(slots: &[u32], values: &mut [T], f: impl Fn(u32, &mut T) + Sync) {
    pieces(slots, values, LONG_CHUNK).into_par_iter().for_each(|piece| piece.for_each(&f));
}

/// Some slots, and the values from the first to the last of them.
struct Piece<'a, T> {
    slots: &'a [u32],
    first: usize,
    values: &'a mut [T],
}

impl<T> Piece<'_, T> {
    fn for_each(self, mut f: impl FnMut(u32, &mut T)) {
        self.slots.iter().for_each(|&slot| f(slot, &mut self.values[slot as usize - self.first]));
    }
}

/// Divides ascending slots, and their values with them.
fn pieces<'a, T>(slots: &'a [u32], values: &'a mut [T], chunk: usize) -> Vec<Piece<'a, T>> {
    debug_assert!(slots.is_sorted(), "slots have to ascend");
    let around = |slots: &[u32]| slots[0] as usize..slots[slots.len() - 1] as usize + 1;
    let parts = split_mut(values, slots.chunks(chunk).map(around));
    let piece = |(slots, values): (&'a [u32], &'a mut [T])| Piece { slots, first: slots[0] as usize, values };
    slots.chunks(chunk).zip(parts).map(piece).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::Unobserved;
    use crate::random::Pcg32;

    /// Whatever slots there are, every one of them is met once, and nothing beside them.
    #[test]
    fn loops_over_slots_meet_each_once() {
        let mut rng = Pcg32::new(5, 6);
        for len in [0, 1, 63, 64, 65, 5000, 20_000] {
            for part in [0.0, 0.01, 0.5, 1.0] {
                let slots: Vec<u32> = (0..len).filter(|_| rng.next_f32() < part).collect();
                let mut values = vec![1; len as usize];
                let work = Work::new(&Unobserved);
                let count = |slot: u32, rays: &mut u64| {
                    *rays += 1;
                    slot
                };
                work.add(&slots, &mut values, count).expect("nobody cancels");
                assert_eq!(work.rays(), slots.len() as u64);
                let mut expected = vec![1; len as usize];
                slots.iter().for_each(|&slot| expected[slot as usize] += slot);
                assert!(values == expected, "{len} and {part}");
                for_slots(&slots, &mut values, |slot, value| *value -= slot);
                assert!(values.iter().all(|value| *value == 1), "{len} and {part}");
            }
        }
    }
}
