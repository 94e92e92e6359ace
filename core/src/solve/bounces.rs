//! `X = u + T̂ X` for what is carried: each layer by itself where all are there, and all light together where only some
//! are.

use glam::Vec3;
use rayon::prelude::*;

use super::exchange::Matrix;
use super::gmres;
use crate::value::{Few, Lockstep, Value};

/// Residual of the solve, relative to its source.
const TOLERANCE: f64 = 1e-4;

/// Bounces of layers of which only some are told apart at a place, at most.
const BOUNCES: usize = 24;

/// What is missing of all light together, relative to it, that is left to be shared out between layers.
const LEFT: f64 = 1e-2;

/// Rows per task.
const CHUNK: usize = 1024;

/// Light whose bounces can be had from a sampled matrix.
pub(crate) trait Solvable: Value {
    /// A difference of light, of both signs.
    type Change: Solvable;

    /// `X = u + T̂ X`, per row, where `first` is u.
    fn all_bounces(matrix: &Matrix, first: &[Self]) -> Vec<Self>;

    /// This light less other light.
    fn change_from(&self, other: &Self) -> Self::Change;

    /// Adds a change.
    fn add_change(&mut self, change: &Self::Change);
}

/// Layer by layer.
impl<V: Lockstep> Solvable for V {
    type Change = V;

    fn all_bounces(matrix: &Matrix, first: &[V]) -> Vec<V> {
        in_lockstep(matrix, first)
    }

    fn change_from(&self, other: &V) -> V {
        *self - *other
    }

    fn add_change(&mut self, change: &V) {
        *self += *change;
    }
}

fn in_lockstep<V: Lockstep>(matrix: &Matrix, first: &[V]) -> Vec<V> {
    gmres::solve(|x| matrix.apply(x), first, TOLERANCE)
}

impl Solvable for Few<Vec3> {
    /// Of all light together: layers of both signs cannot be merged, and which are told apart differs from place to place.
    type Change = Vec3;

    /// All light together is solved for. Its layers are followed bounce by bounce, since what is told apart at one place is
    /// not at another and the equation holds for none of them alone; the last bounces, that are missing then, are shared
    /// out as the others are.
    fn all_bounces(matrix: &Matrix, first: &[Self]) -> Vec<Self> {
        let totals = |values: &[Self]| -> Vec<Vec3> { values.par_iter().with_min_len(CHUNK).map(Few::total).collect() };
        let whole = in_lockstep(matrix, &totals(first));
        let mut found = first.to_vec();
        let limit = LEFT * size(&whole);
        for _ in 0..BOUNCES {
            let missing: Vec<Vec3> = whole.iter().zip(&found).map(|(whole, found)| *whole - found.total()).collect();
            if size(&missing) <= limit {
                break;
            }
            found = matrix.apply(&found);
            let bounced = found.par_iter_mut().zip(first).with_min_len(CHUNK);
            bounced.for_each(|(found, first)| *found = (*found + *first).thinned());
        }
        found.par_iter_mut().zip(&whole).with_min_len(CHUNK).for_each(|(found, whole)| *found = found.of_total(*whole));
        found
    }

    fn change_from(&self, other: &Self) -> Vec3 {
        self.total() - other.total()
    }

    /// It is shared out as the size of the layers is.
    fn add_change(&mut self, change: &Vec3) {
        *self = self.of_total(self.total() + *change);
    }
}

/// Root of the sum of squares.
fn size(values: &[Vec3]) -> f64 {
    values.iter().map(|value| f64::from(value.length_squared())).sum::<f64>().sqrt()
}
