//! Transport between representatives, sampled: every path of a representative that ends at a surface is one entry of a
//! sparse matrix T̂, whose expectation is the transport operator.
//!
//! With `u = G[source]` from the same rays, `X = u + T̂ X` holds all bounces of the source, and no ray is traced for any
//! but the first. A bounce's look-up is interpolated from a few elements, each from a few representatives; an entry
//! takes one of them, with their weight as probability.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::{Subset, gmres};
use crate::job::Canceled;
use crate::random::{Pcg32, R2, subseed};
use crate::sampling::cosine_hemisphere;
use crate::transport::{End, Radiance, Source, Value, Work};
use crate::world::World;

/// Residual of the solve, relative to its source.
const TOLERANCE: f64 = 1e-4;

/// Representatives per task.
const CHUNK: usize = 32;

const NONE: u32 = u32::MAX;

/// Where one path of a representative ended.
#[derive(Clone, Copy, Debug)]
struct Entry {
    /// Row of the matrix; `NONE` where the path left or ended at what is not among the rows.
    row: u32,
    /// Slot of an element of the triangle that it ended on, drawn by barycentric weight; `NONE` where it left.
    element: u32,
    /// Product of the albedos on the way.
    weight: Vec3,
}

/// The representatives that a matrix is over.
pub(crate) struct Rows {
    /// Indices into `Subset::slots`.
    pub members: Vec<u32>,
    /// Row of every index of `Subset::slots`, or `NONE`; empty where all are rows.
    row_of: Vec<u32>,
}

impl Rows {
    /// All representatives.
    pub(crate) fn all(subset: &Subset) -> Rows {
        Rows { members: (0..subset.slots.len() as u32).collect(), row_of: Vec::new() }
    }

    /// Those whose element slot is wanted.
    pub(crate) fn only(subset: &Subset, wanted: impl Fn(u32) -> bool) -> Rows {
        let mut rows = Rows { members: Vec::new(), row_of: vec![NONE; subset.slots.len()] };
        for (i, &slot) in subset.slots.iter().enumerate() {
            if wanted(slot) {
                rows.row_of[i] = rows.members.len() as u32;
                rows.members.push(i as u32);
            }
        }
        rows
    }

    fn row(&self, representative: u32) -> u32 {
        if self.row_of.is_empty() { representative } else { self.row_of[representative as usize] }
    }
}

/// How many paths rows get, at least one each.
#[derive(Clone, Copy)]
pub(crate) enum Paths<'a> {
    /// All the same number.
    Each(u32),
    /// A number for every row.
    OfRows(&'a [u32]),
}

impl Paths<'_> {
    /// Where the paths of each of `rows` begin, and where the last one's end.
    fn offsets(self, rows: usize) -> Vec<usize> {
        let of_row = |row: usize| match self {
            Paths::Each(paths) => paths.max(1) as usize,
            Paths::OfRows(paths) => paths[row].max(1) as usize,
        };
        let ends = (0..rows).scan(0, |end, row| {
            *end += of_row(row);
            Some(*end)
        });
        std::iter::once(0).chain(ends).collect()
    }
}

/// The offsets and entries of every task's rows.
fn chunks<'a>(offsets: &'a [usize], entries: &'a mut [Entry]) -> impl Iterator<Item = (&'a [usize], &'a mut [Entry])> {
    let mut left = entries;
    let last = offsets.len() - 1;
    (0..last).step_by(CHUNK).map(move |row| {
        let offsets = &offsets[row..=(row + CHUNK).min(last)];
        let len = offsets[offsets.len() - 1] - offsets[0];
        (offsets, left.split_off_mut(..len).unwrap_or_default())
    })
}

/// A sampled transport matrix and the first gather of a source along its rays.
pub(crate) struct Exchange<V> {
    rows: Arc<Rows>,
    /// `offsets[i]..offsets[i + 1]` are the entries of row `i`.
    offsets: Vec<usize>,
    entries: Vec<Entry>,
    /// First gather, per row.
    pub first: Vec<V>,
}

impl<V: Value> Exchange<V> {
    /// Traces `paths` from every row, to the first surface that can be looked up (near-field rule).
    pub(crate) fn trace(
        world: &World,
        subset: &Subset,
        rows: &Arc<Rows>,
        source: &Source<impl Radiance<V>, V>,
        paths: Paths,
        seed: u64,
        work: &Work,
    ) -> Result<Exchange<V>, Canceled> {
        let offsets = paths.offsets(rows.members.len());
        let mut entries = vec![Entry { row: NONE, element: NONE, weight: Vec3::ZERO }; offsets[rows.members.len()]];
        let mut first = vec![V::default(); rows.members.len()];
        let seed = subseed(seed, 0xec);
        let tasks = rows.members.chunks(CHUNK).zip(chunks(&offsets, &mut entries)).zip(first.chunks_mut(CHUNK));
        tasks.collect::<Vec<_>>().into_par_iter().try_for_each(|((members, (offsets, mut entries)), first)| {
            work.check()?;
            let mut rays = 0;
            for ((first, ends), &member) in first.iter_mut().zip(offsets.windows(2)).zip(members) {
                let own = entries.split_off_mut(..ends[1] - ends[0]).unwrap_or_default();
                *first = trace_row(world, subset, rows, subset.slots[member as usize], source, own, seed, &mut rays);
            }
            work.count(rays);
            Ok(())
        })?;
        Ok(Exchange { rows: Arc::clone(rows), offsets, entries, first })
    }

    /// Bytes that it holds.
    pub(crate) fn memory_bytes(&self) -> usize {
        size_of_val(self.entries.as_slice()) + size_of_val(self.offsets.as_slice()) + self.first.len() * size_of::<V>()
    }

    /// T̂ x.
    fn apply(&self, x: &[V]) -> Vec<V> {
        self.mean_of_rows(|e| e.row, x)
    }

    /// Per row: the mean over its paths of `values` where they end, `NONE` being nowhere.
    fn mean_of_rows(&self, end: impl Fn(&Entry) -> u32 + Sync, values: &[V]) -> Vec<V> {
        let of_row = |ends: &[usize]| -> V {
            let entries = &self.entries[ends[0]..ends[1]];
            let met = entries.iter().filter(|e| end(e) != NONE);
            met.map(|e| values[end(e) as usize] * e.weight).sum::<V>() / entries.len() as f32
        };
        self.offsets.par_windows(2).with_min_len(256).map(of_row).collect()
    }

    /// `X = u + T̂ X`, per row: all bounces of a source whose first gather is `u`.
    pub(crate) fn all_bounces(&self, first: &[V]) -> Vec<V> {
        gmres::solve(|x| self.apply(x), first, TOLERANCE)
    }

    /// What is missing where a better gather of the same light differs from the solution by `residual`, per element
    /// slot: `Σ_{j ≥ 1} Tʲ r`. Its first bounce is gathered at full resolution: the solution, interpolated from its
    /// representatives, is off where there are none, in corners above all.
    pub(crate) fn settle(&self, residual: &[V]) -> Vec<V> {
        let first = self.mean_of_rows(|e| e.element, residual);
        self.all_bounces(&first)
    }

    /// Values of rows at all representatives; zero at those that are no rows.
    pub(crate) fn to_representatives(&self, subset: &Subset, values: &[V]) -> Vec<V> {
        let mut out = vec![V::default(); subset.slots.len()];
        self.rows.members.iter().zip(values).for_each(|(&m, v)| out[m as usize] = *v);
        out
    }
}

#[expect(clippy::too_many_arguments, reason = "a private step of one loop")]
fn trace_row<V: Value>(
    world: &World,
    subset: &Subset,
    rows: &Rows,
    slot: u32,
    source: &Source<impl Radiance<V>, V>,
    entries: &mut [Entry],
    seed: u64,
    rays: &mut u64,
) -> V {
    let from = world.ray_origin(slot as usize);
    let mut rng = Pcg32::new(seed, u64::from(slot));
    let sequence = R2::new(&mut rng);
    let aims = source.aims(entries.len() as u32);
    let ratio = aims as f32 / entries.len() as f32;
    let (mut sum, mut last) = (V::default(), None);
    for (k, entry) in entries.iter_mut().enumerate() {
        let direction = cosine_hemisphere(from.1, sequence.get(k as u32));
        let (end, landed) = source.along(world, slot, from, direction, ratio, &mut rng, rays, &mut sum);
        source.add_landed(std::mem::replace(&mut last, landed).as_ref(), &mut rng, rays, &mut sum);
        if let End::Landed(surfel, weight) = end {
            let u = [rng.next_f32(), rng.next_f32(), rng.next_f32()];
            let row = subset.sample(world, &surfel, u).map_or(NONE, |r| rows.row(r));
            *entry = Entry { row, element: surfel.element_by_weight(u[0]), weight };
        }
    }
    source.add_landed(last.as_ref(), &mut rng, rays, &mut sum);
    let sequence = R2::new(&mut rng);
    for k in 0..aims {
        sum += source.aimed(world, slot, from, sequence.get(k), ratio, &mut rng, rays);
    }
    sum / entries.len() as f32
}
