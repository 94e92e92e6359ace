//! Restarted GMRES (Saad & Schultz 1986) for `x = b + T x`, all layers and colour channels in lockstep.
//!
//! T is a contraction, so plain iteration would converge too, but as the largest albedo to the power k: hundreds of
//! steps in bright rooms. GMRES finds the few slow modes of a room at once.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::value::{Lockstep, Wide};

/// Krylov vectors before a restart.
const RESTART: usize = 24;

/// Restarts at most.
const MAX_RESTARTS: usize = 8;

/// Bytes per task and partial sum: fixed, so that sums do not depend on the number of threads, and the less elements
/// the more layers they have.
const CHUNK_BYTES: usize = 4096 * size_of::<Vec3>();

/// Elements per task and partial sum.
const fn chunk<V>() -> usize {
    CHUNK_BYTES / size_of::<V>()
}

/// Elements whose products are summed in single precision before the sum is widened.
const NARROW: usize = 16;

/// Solves `x − T x = b` from `x = 0` until the residual is at most `tolerance` of `b` in every layer and channel.
pub(super) fn solve<V: Lockstep>(apply: impl Fn(&[V]) -> Vec<V>, b: &[V], tolerance: f64) -> Vec<V> {
    let target = norm(b).map(|n| n * tolerance);
    let mut x = vec![V::default(); b.len()];
    let mut residual = b.to_vec();
    for _ in 0..MAX_RESTARTS {
        let size = norm(&residual);
        if is_within::<V>(size, target) {
            break;
        }
        let (weights, basis) = cycle(&apply, residual, size, target);
        add_scaled(&mut x, &weights, &basis);
        residual = apply(&x);
        let len = chunk::<V>();
        let terms = residual.par_iter_mut().zip(b).zip(&x).with_min_len(len);
        terms.for_each(|((r, b), x)| *r = *b - *x + *r);
    }
    x
}

fn is_within<V: Lockstep>(values: V::Wide, limits: V::Wide) -> bool {
    values.all(limits, |v, limit| v.abs().cmple(limit).all())
}

/// One cycle: the weights of Krylov vectors that make the residual, whose norm is `beta`, least over their space.
/// Orthogonalised as classical Gram-Schmidt does it, all vectors in one pass: the residual is computed anew in the end.
fn cycle<V: Lockstep>(
    apply: &impl Fn(&[V]) -> Vec<V>,
    residual: Vec<V>,
    beta: V::Wide,
    target: V::Wide,
) -> (Vec<V::Wide>, Vec<Vec<V>>) {
    let mut basis = vec![residual];
    scale(&mut basis[0], beta.map(inverse));
    // Column j of the Hessenberg matrix after Givens rotations, and the rotated right-hand side.
    let mut columns: Vec<Vec<V::Wide>> = Vec::new();
    let mut rotations: Vec<(V::Wide, V::Wide)> = Vec::new();
    let mut right = vec![beta];
    for j in 0..RESTART {
        let mut w = apply(&basis[j]);
        let mut column = subtract_and_project(&basis, &mut w);
        let next = orthogonalise(&mut w, &column, &basis);
        for (i, &(c, s)) in rotations.iter().enumerate() {
            let (above, below) = (column[i], column[i + 1]);
            column[i] = c.times(above).plus(s.times(below));
            column[i + 1] = c.times(below).zip(s.times(above), |a, b| a - b);
        }
        let length = column[j].zip(next, |a, b| sqrt(a * a + b * b));
        let (c, s) = (
            length.zip(column[j].zip(length, |a, l| a * inverse(l)), select_one),
            next.zip(length, |n, l| n * inverse(l)),
        );
        column[j] = length;
        columns.push(column);
        rotations.push((c, s));
        right.push(s.zip(right[j], |s, r| -s * r));
        right[j] = right[j].times(c);
        if is_within::<V>(right[j + 1], target) {
            break;
        }
        scale(&mut w, next.map(inverse));
        basis.push(w);
    }
    (back_substitute(&columns, &right), basis)
}

fn back_substitute<W: Wide>(columns: &[Vec<W>], right: &[W]) -> Vec<W> {
    let n = columns.len();
    let mut y = vec![W::splat(DVec3::ZERO); n];
    for i in (0..n).rev() {
        let known = (i + 1..n).fold(W::splat(DVec3::ZERO), |sum, k| sum.plus(columns[k][i].times(y[k])));
        y[i] = right[i].zip(known, |r, k| r - k).times(columns[i][i].map(inverse));
    }
    y
}

fn sqrt(v: DVec3) -> DVec3 {
    DVec3::new(v.x.sqrt(), v.y.sqrt(), v.z.sqrt())
}

/// 1/v per channel, 0 where a channel has nothing (left) that single precision could hold the inverse of.
fn inverse(v: DVec3) -> DVec3 {
    let one = |x: f64| if x.abs() > f64::from(f32::MIN_POSITIVE) { 1.0 / x } else { 0.0 };
    DVec3::new(one(v.x), one(v.y), one(v.z))
}

/// A rotation by nothing where the channel has nothing.
fn select_one(length: DVec3, c: DVec3) -> DVec3 {
    DVec3::select(length.cmpgt(DVec3::ZERO), c, DVec3::ONE)
}

fn zero<V: Lockstep>() -> V::Wide {
    V::Wide::splat(DVec3::ZERO)
}

/// Σ a b of some elements.
fn product<V: Lockstep>(a: &[V], b: &[V]) -> V::Wide {
    let narrow = |(a, b): (&[V], &[V])| a.iter().zip(b).map(|(a, b)| a.times(*b)).sum::<V>();
    a.chunks(NARROW).zip(b.chunks(NARROW)).map(narrow).fold(zero::<V>(), |sum, products| sum.plus(products.wide()))
}

fn norm<V: Lockstep>(a: &[V]) -> V::Wide {
    let sums: Vec<V::Wide> = a.par_chunks(chunk::<V>()).map(|a| product(a, a)).collect();
    sums.into_iter().fold(zero::<V>(), Wide::plus).map(sqrt)
}

/// `w = v − w` with the last vector of the basis; the products of the result with all of them.
fn subtract_and_project<V: Lockstep>(basis: &[Vec<V>], w: &mut [V]) -> Vec<V::Wide> {
    let (size, last) = (chunk::<V>(), &basis[basis.len() - 1]);
    let mut products = vec![zero::<V>(); basis.len() * w.len().div_ceil(size)];
    let chunks = w.par_chunks_mut(size).zip(products.par_chunks_mut(basis.len())).enumerate();
    chunks.for_each(|(chunk, (w, products))| {
        let of_chunk = |v: &Vec<V>| chunk * size..v.len().min((chunk + 1) * size);
        w.iter_mut().zip(&last[of_chunk(last)]).for_each(|(w, v)| *w = *v - *w);
        products.iter_mut().zip(basis).for_each(|(sum, v)| *sum = product(&v[of_chunk(v)], w));
    });
    let add = |mut sums: Vec<V::Wide>, products: &[V::Wide]| {
        sums.iter_mut().zip(products).for_each(|(sum, product)| *sum = sum.plus(*product));
        sums
    };
    products.chunks(basis.len()).fold(vec![zero::<V>(); basis.len()], add)
}

/// Takes from `w` what is along the basis; the norm of what is left.
fn orthogonalise<V: Lockstep>(w: &mut [V], along: &[V::Wide], basis: &[Vec<V>]) -> V::Wide {
    let size = chunk::<V>();
    let along: Vec<V> = along.iter().map(|a| V::narrow(a.map(|a| -a))).collect();
    let sums: Vec<V::Wide> = (w.par_chunks_mut(size).enumerate())
        .map(|(chunk, w)| {
            add_to_chunk(w, chunk * size, &along, basis);
            product(w, w)
        })
        .collect();
    sums.into_iter().fold(zero::<V>(), Wide::plus).map(sqrt)
}

/// `x += Σ weight v`.
fn add_scaled<V: Lockstep>(x: &mut [V], weights: &[V::Wide], basis: &[Vec<V>]) {
    let size = chunk::<V>();
    let weights: Vec<V> = weights.iter().map(|weight| V::narrow(*weight)).collect();
    x.par_chunks_mut(size).enumerate().for_each(|(chunk, x)| add_to_chunk(x, chunk * size, &weights, basis));
}

/// `x += Σ weight v` for the elements from `first` on.
fn add_to_chunk<V: Lockstep>(x: &mut [V], first: usize, weights: &[V], basis: &[Vec<V>]) {
    for (weight, v) in weights.iter().zip(basis) {
        x.iter_mut().zip(&v[first..]).for_each(|(x, v)| *x += v.times(*weight));
    }
}

fn scale<V: Lockstep>(v: &mut [V], by: V::Wide) {
    let by = V::narrow(by);
    v.par_iter_mut().with_min_len(chunk::<V>()).for_each(|v| *v = v.times(by));
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
        assert!((norm(&residual) / norm(&b)).max_element() < 3e-5);
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
