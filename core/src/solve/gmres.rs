//! Restarted GMRES (Saad & Schultz 1986) for `x = b + T x`, three colour channels in lockstep.
//!
//! T is a contraction, so plain iteration would converge too, but as the largest albedo to the power k: hundreds of
//! steps in bright rooms. GMRES finds the few slow modes of a room at once.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Krylov vectors before a restart.
const RESTART: usize = 24;

/// Restarts at most.
const MAX_RESTARTS: usize = 8;

/// Elements per partial sum: fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 4096;

/// Solves `x − T x = b` from `x = 0` until the residual is at most `tolerance` of `b` in every channel.
pub(super) fn solve(apply: impl Fn(&[Vec3]) -> Vec<Vec3>, b: &[Vec3], tolerance: f64) -> Vec<Vec3> {
    let target = norm(b) * tolerance;
    let mut x = vec![Vec3::ZERO; b.len()];
    let mut residual = b.to_vec();
    for _ in 0..MAX_RESTARTS {
        if norm(&residual).cmple(target).all() {
            break;
        }
        let step = cycle(&apply, &residual, target);
        axpy(&mut x, DVec3::ONE, &step);
        let t = apply(&x);
        residual.par_iter_mut().zip(b).zip(&x).zip(&t).for_each(|(((r, b), x), t)| *r = *b - *x + *t);
    }
    x
}

/// One cycle: the step that makes the residual least over the Krylov space.
fn cycle(apply: &impl Fn(&[Vec3]) -> Vec<Vec3>, residual: &[Vec3], target: DVec3) -> Vec<Vec3> {
    let beta = norm(residual);
    let mut basis = vec![scaled(residual, inverse(beta))];
    // Column j of the Hessenberg matrix after Givens rotations, and the rotated right-hand side.
    let mut columns: Vec<Vec<DVec3>> = Vec::new();
    let mut rotations: Vec<(DVec3, DVec3)> = Vec::new();
    let mut right = vec![beta];
    for j in 0..RESTART {
        let t = apply(&basis[j]);
        let mut w: Vec<Vec3> = basis[j].par_iter().zip(&t).map(|(v, t)| *v - *t).collect();
        let mut column = Vec::with_capacity(j + 2);
        for v in &basis {
            let h = dot(v, &w);
            axpy(&mut w, -h, v);
            column.push(h);
        }
        let next = norm(&w);
        for (i, &(c, s)) in rotations.iter().enumerate() {
            let (above, below) = (column[i], column[i + 1]);
            (column[i], column[i + 1]) = (c * above + s * below, c * below - s * above);
        }
        let length = (column[j] * column[j] + next * next).map_sqrt();
        let (c, s) = (select_one(length, column[j] * inverse(length)), next * inverse(length));
        column[j] = length;
        columns.push(column);
        rotations.push((c, s));
        right.push(-s * right[j]);
        right[j] *= c;
        if right[j + 1].abs().cmple(target).all() {
            break;
        }
        basis.push(scaled(&w, inverse(next)));
    }
    let weights = back_substitute(&columns, &right);
    let mut step = vec![Vec3::ZERO; residual.len()];
    for (weight, v) in weights.iter().zip(&basis) {
        axpy(&mut step, *weight, v);
    }
    step
}

fn back_substitute(columns: &[Vec<DVec3>], right: &[DVec3]) -> Vec<DVec3> {
    let n = columns.len();
    let mut y = vec![DVec3::ZERO; n];
    for i in (0..n).rev() {
        let known: DVec3 = (i + 1..n).map(|k| columns[k][i] * y[k]).sum();
        y[i] = (right[i] - known) * inverse(columns[i][i]);
    }
    y
}

trait MapSqrt {
    fn map_sqrt(self) -> Self;
}

impl MapSqrt for DVec3 {
    fn map_sqrt(self) -> DVec3 {
        DVec3::new(self.x.sqrt(), self.y.sqrt(), self.z.sqrt())
    }
}

/// 1/v per channel, 0 where a channel has nothing (left).
fn inverse(v: DVec3) -> DVec3 {
    let one = |x: f64| if x.abs() > f64::MIN_POSITIVE { 1.0 / x } else { 0.0 };
    DVec3::new(one(v.x), one(v.y), one(v.z))
}

/// A rotation by nothing where the channel has nothing.
fn select_one(length: DVec3, c: DVec3) -> DVec3 {
    DVec3::select(length.cmpgt(DVec3::ZERO), c, DVec3::ONE)
}

fn dot(a: &[Vec3], b: &[Vec3]) -> DVec3 {
    let partial = |(a, b): (&[Vec3], &[Vec3])| -> DVec3 { a.iter().zip(b).map(|(a, b)| (*a * *b).as_dvec3()).sum() };
    let sums: Vec<DVec3> = a.par_chunks(CHUNK).zip(b.par_chunks(CHUNK)).map(partial).collect();
    sums.into_iter().sum()
}

fn norm(a: &[Vec3]) -> DVec3 {
    dot(a, a).map_sqrt()
}

fn scaled(a: &[Vec3], by: DVec3) -> Vec<Vec3> {
    a.par_iter().with_min_len(CHUNK).map(|v| (v.as_dvec3() * by).as_vec3()).collect()
}

fn axpy(y: &mut [Vec3], a: DVec3, x: &[Vec3]) {
    let a = a.as_vec3();
    y.par_iter_mut().zip(x).with_min_len(CHUNK).for_each(|(y, x)| *y += a * *x);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Pcg32;

    /// A random contraction with row sums `albedo`, one of them per channel.
    fn transport(n: usize, albedo: Vec3) -> impl Fn(&[Vec3]) -> Vec<Vec3> {
        let mut rng = Pcg32::new(3, 4);
        let columns: Vec<[usize; 8]> = (0..n).map(|_| std::array::from_fn(|_| (rng.next_u32() as usize) % n)).collect();
        move |x| columns.iter().map(|c| albedo * c.iter().map(|&i| x[i]).sum::<Vec3>() / 8.0).collect()
    }

    #[test]
    fn bright_rooms_are_solved_in_every_channel() {
        let apply = transport(5000, Vec3::new(0.99, 0.5, 0.0));
        let mut rng = Pcg32::new(1, 2);
        let b: Vec<Vec3> = (0..5000).map(|_| Vec3::new(rng.next_f32(), rng.next_f32() - 0.5, rng.next_f32())).collect();
        let x = solve(&apply, &b, 1e-5);
        let t = apply(&x);
        let residual: Vec<Vec3> = (0..5000).map(|i| b[i] + t[i] - x[i]).collect();
        assert!((norm(&residual) / norm(&b)).max_element() < 3e-5, "{residual:?}");
        // Sum over all rows of a doubly random matrix: roughly 1 / (1 − albedo) of that of b.
        let mean = x.iter().map(|v| v.x).sum::<f32>() / b.iter().map(|v| v.x).sum::<f32>();
        assert!((90.0..110.0).contains(&mean), "{mean}");
    }

    #[test]
    fn nothing_comes_of_nothing() {
        let apply = transport(100, Vec3::splat(0.9));
        assert!(solve(&apply, &[Vec3::ZERO; 100], 1e-5).iter().all(|v| *v == Vec3::ZERO));
        // A channel without a source stays black beside one with it.
        let x = solve(&apply, &[Vec3::X; 100], 1e-5);
        assert!(x.iter().all(|v| (v.x - 10.0).abs() < 1e-2 && v.y == 0.0 && v.z == 0.0), "{:?}", x[0]);
    }
}
