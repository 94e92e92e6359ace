//! Transport between representatives, sampled: every path of a representative that ends at a surface is one entry of a
//! sparse matrix T̂, whose expectation is the transport operator.
//!
//! With `u = G[source]` from the same rays, `X = u + T̂ X` holds all bounces of the source, and no ray is traced for
//! any but the first. A bounce's look-up is interpolated from a few elements, each from a few representatives; an entry
//! takes one of them, with their weight as probability.

use std::ops::Range;
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::rows::{NONE, offsets};
use super::{Rows, Solvable, Subset};
use crate::job::Canceled;
use crate::random::{PartSeed, Pcg32};
use crate::ranges::split_mut;
use crate::transport::{End, Radiance, Source, Work, gather_paths};
use crate::value::Value;
use crate::world::World;

/// Paths that a row borrows of its neighbours.
const BORROWED: f32 = 4.0;

/// Rows per task.
const CHUNK: usize = 32;

/// Groups of rows that borrow of one another, per task.
const GROUPS: usize = 64;

/// Where one path of a representative ended.
#[derive(Clone, Copy, Debug)]
struct Entry {
    /// Row of the matrix; `NONE` where the path left or ended at what is not among the rows.
    row: u32,
    /// Slot of an element of the cell that it ended on, drawn by barycentric weight; `NONE` where it left.
    element: u32,
    /// Product of the albedos on the way.
    weight: Vec3,
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
        offsets((0..rows).map(of_row))
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

/// A sampled transport matrix.
pub(crate) struct Matrix {
    rows: Arc<Rows>,
    /// `offsets[i]..offsets[i + 1]` are the entries of row `i`.
    offsets: Vec<usize>,
    entries: Vec<Entry>,
}

impl Matrix {
    /// T̂ x. Rows borrow paths of their neighbours: a few paths alone may all end where they came from, and a matrix
    /// with such a cycle has far more light go round than there is.
    pub(super) fn apply<V: Value>(&self, x: &[V]) -> Vec<V> {
        let mut means = self.mean_of_rows(|e| e.row, x);
        let groups = || self.rows.neighbours.windows(2).map(|ends| ends[0]..ends[1]);
        let parts = split_mut(&mut means, groups());
        let borrow = |(rows, means): (Range<usize>, &mut [V])| {
            let paths = |row: usize| (self.offsets[row + 1] - self.offsets[row]) as f32;
            let all = (self.offsets[rows.end] - self.offsets[rows.start]) as f32;
            let mean = rows.clone().zip(&*means).map(|(row, own)| *own * paths(row)).sum::<V>() / all;
            for (row, own) in rows.zip(means) {
                let paths = paths(row);
                *own = (*own * paths + mean * BORROWED) / (paths + BORROWED);
            }
        };
        groups().zip(parts).collect::<Vec<_>>().into_par_iter().with_min_len(GROUPS).for_each(borrow);
        means
    }

    /// Per row: the mean over its paths of `values` where they end, `NONE` being nowhere.
    fn mean_of_rows<V: Value>(&self, end: impl Fn(&Entry) -> u32 + Sync, values: &[V]) -> Vec<V> {
        let of_row = |ends: &[usize]| -> V {
            let entries = &self.entries[ends[0]..ends[1]];
            let met = entries.iter().filter(|e| end(e) != NONE);
            let mut sum = V::default();
            met.for_each(|e| sum.add_scaled(&values[end(e) as usize], e.weight));
            sum / entries.len() as f32
        };
        self.offsets.par_windows(2).with_min_len(256).map(of_row).collect()
    }
}

/// A sampled transport matrix and the first gather of a source along its rays.
pub(crate) struct Exchange<V> {
    matrix: Matrix,
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
        seed: PartSeed,
        work: &Work,
    ) -> Result<Exchange<V>, Canceled> {
        let offsets = paths.offsets(rows.len());
        let mut entries = vec![Entry { row: NONE, element: NONE, weight: Vec3::ZERO }; offsets[rows.len()]];
        let mut first = vec![V::default(); rows.len()];
        let seed = seed.of(0xec);
        let tasks = (0..rows.len()).step_by(CHUNK).zip(chunks(&offsets, &mut entries)).zip(first.chunks_mut(CHUNK));
        let begun = work.tasks(rows.len().div_ceil(CHUNK));
        tasks.collect::<Vec<_>>().into_par_iter().try_for_each(|((row, (offsets, mut entries)), first)| {
            begun.begin()?;
            let mut rays = 0;
            for ((row, first), ends) in (row..).zip(first).zip(offsets.windows(2)) {
                let own = entries.split_off_mut(..ends[1] - ends[0]).unwrap_or_default();
                *first = trace_row(world, subset, rows, row, source, own, seed, &mut rays);
            }
            work.count(rays);
            Ok(())
        })?;
        Ok(Exchange { matrix: Matrix { rows: Arc::clone(rows), offsets, entries }, first })
    }

    /// Bytes that it holds.
    pub(crate) fn memory_bytes(&self) -> usize {
        let Matrix { offsets, entries, .. } = &self.matrix;
        size_of_val(entries.as_slice()) + size_of_val(offsets.as_slice()) + self.first.len() * size_of::<V>()
    }

    /// Values of rows at all representatives; zero at those that are no rows.
    pub(crate) fn to_representatives<C: Value>(&self, subset: &Subset, values: &[C]) -> Vec<C> {
        let mut out = vec![C::default(); subset.slots.len()];
        for (row, value) in values.iter().enumerate() {
            self.matrix.rows.members_of(row).iter().for_each(|&member| out[member as usize] = *value);
        }
        out
    }
}

impl<V: Solvable> Exchange<V> {
    /// `X = u + T̂ X`, per row: all bounces of a source whose first gather is `u`.
    pub(crate) fn all_bounces(&self, first: &[V]) -> Vec<V> {
        V::all_bounces(&self.matrix, first)
    }

    /// What is missing where a better gather of the same light differs from the solution by `residual`, per element
    /// slot: `Σ_{j ≥ 1} Tʲ r`. Its first bounce is gathered at full resolution: the solution, interpolated from its
    /// representatives, is off where there are none, in corners above all.
    pub(crate) fn further_bounces<C: Solvable>(&self, residual: &[C]) -> Vec<C> {
        C::all_bounces(&self.matrix, &self.matrix.mean_of_rows(|e| e.element, residual))
    }
}

/// Paths begin at the members of the row in turn, from a random one on.
#[expect(clippy::too_many_arguments, reason = "a private step of one loop")]
fn trace_row<V: Value>(
    world: &World,
    subset: &Subset,
    rows: &Rows,
    row: usize,
    source: &Source<impl Radiance<V>, V>,
    entries: &mut [Entry],
    seed: PartSeed,
    rays: &mut u64,
) -> V {
    let members = rows.members_of(row);
    let mut draws = seed.draws(subset.slots[members[0] as usize].into());
    let turn = if members.len() > 1 { (draws.of_round.next_f32() * members.len() as f32) as usize } else { 0 };
    let turn = turn + draws.before(entries.len() as u32) as usize;
    let begin = |k: u32| {
        let slot = subset.slots[members[(turn + k as usize) % members.len()] as usize];
        (slot, world.ray_origin(slot as usize))
    };
    let paths = entries.len() as u32;
    let ended = |k: u32, end: End, rng: &mut Pcg32| {
        if let End::Landed(surfel, weight) = end {
            let u = [rng.next_f32(), rng.next_f32(), rng.next_f32()];
            let row = subset.sample(world, &surfel, u).map_or(NONE, |r| rows.row(r));
            entries[k as usize] = Entry { row, element: surfel.element_by_weight(u[0]), weight };
        }
    };
    gather_paths(world, source, paths, begin, ended, &mut draws, rays)
}
