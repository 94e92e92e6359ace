//! What the neighbours of an element tell of its variance.
//!
//! Of one round alone: how values scatter about those of their neighbours. Light is smooth along a surface but for the
//! edges of shadows, noise is not; so a first map knows its error, too. Of few rounds: variances are alike along a
//! surface, and each by itself has one degree of freedom less than there are rounds.

use std::ops::Range;

use rayon::prelude::*;

use crate::ranges::split_mut;
use crate::value::Linear;
use crate::world::{Placed, World};

/// Elements per task.
const CHUNK: usize = 1024;

/// Per slot: variance of some light, as `square` makes it of `light × factor` (a square over three, say); zero where no
/// element is computed. An element's distance from the mean of its k valid neighbours has (1 + 1/k) times the variance,
/// whatever the gradient; the mean over itself and its neighbours is taken.
pub(crate) fn scatter_of_neighbours<L: Linear, T: Linear>(
    world: &World,
    light: impl Fn(usize) -> L + Sync,
    square: impl Fn(L, f32) -> T + Sync,
) -> Vec<T> {
    let is_valid = |slot: usize| world.is_valid(slot);
    by_sides(world, |placed, own, variance| {
        let first = own.start;
        let neighbours = |element: usize| {
            let slots = placed.layout.neighbours_of(element as u32).map(|e| first + e as usize);
            slots.filter(|&slot| is_valid(slot))
        };
        let square = |element: usize| {
            let (sum, count) = neighbours(element).fold((L::default(), 0.0), |(s, n), slot| (s + light(slot), n + 1.0));
            if count == 0.0 || !is_valid(first + element) {
                return T::default();
            }
            square(light(first + element) - sum / count, count / (count + 1.0))
        };
        // Where an edit changes nothing, nothing scatters.
        if own.clone().into_par_iter().with_min_len(CHUNK).all(|slot| light(slot) == L::default()) {
            return;
        }
        let squares: Vec<T> = (0..own.len()).into_par_iter().with_min_len(CHUNK).map(square).collect();
        let pooled = |(element, variance): (usize, &mut T)| {
            let around = neighbours(element).map(|slot| squares[slot - first]);
            let (sum, count) = around.fold((squares[element], 1.0), |(s, n), square| (s + square, n + 1.0));
            *variance = sum / count;
        };
        variance.par_iter_mut().enumerate().with_min_len(CHUNK).for_each(pooled);
    })
}

/// A value per slot, the default where `write` leaves it: of each side of each object, whose slots and values it is told.
fn by_sides<T: Linear>(world: &World, write: impl Fn(&Placed, Range<usize>, &mut [T]) + Sync) -> Vec<T> {
    let mut values = vec![T::default(); world.slots()];
    let sides = world.sides();
    let parts = split_mut(&mut values, sides.iter().map(|(_, slots)| slots.clone()));
    sides.into_par_iter().zip(parts).for_each(|((placed, slots), values)| write(placed, slots, values));
    values
}

/// Degrees of freedom that neighbours count for, together.
const NEIGHBOURS: f32 = 8.0;

/// Per slot: variances (numbers, or one per layer), each of so many degrees of freedom, as the mean of itself and of what its neighbours have. An
/// element whose few rounds came out alike by chance is not as good as known; one of which nothing is `estimated` takes
/// part in nothing.
pub(crate) fn pooled_with_neighbours<T: Linear>(
    world: &World,
    freedom: f32,
    estimated: &[bool],
    variance: impl Fn(usize) -> T + Sync,
) -> Vec<T> {
    by_sides(world, |placed, own, pooled| {
        let first = own.start;
        let pool = |(element, pooled): (usize, &mut T)| {
            if !estimated[first + element] {
                return;
            }
            let slots = placed.layout.neighbours_of(element as u32).map(|e| first + e as usize);
            let (sum, count) = slots
                .filter(|&slot| world.is_valid(slot) && estimated[slot])
                .fold((T::default(), 0.0), |(sum, count), slot| (sum + variance(slot), count + 1.0));
            let by_itself = variance(first + element);
            *pooled = match count > 0.0 {
                true => (by_itself * freedom + sum * (NEIGHBOURS / count)) / (freedom + NEIGHBOURS),
                false => by_itself,
            };
        };
        pooled.par_iter_mut().enumerate().with_min_len(CHUNK).for_each(pool);
    })
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::metrics::Family;
    use crate::random::Pcg32;
    use crate::scene::{Material, Mesh, Object, Scene};
    use crate::world::WorldOptions;

    fn wall() -> World {
        let wall =
            Object::new("wall", Mesh::quad(Vec3::ZERO, Vec3::X * 2.0, Vec3::Z * 2.0), Material::diffuse(Vec3::ONE));
        let options = WorldOptions { spacing: Some(0.03), ..WorldOptions::default() };
        World::new(Scene::from_objects(vec![wall]), &options).expect("a wall")
    }

    /// Of two degrees of freedom each: the mean is the same, and far fewer elements are sure of what they do not know.
    #[test]
    fn few_rounds_are_told_by_neighbours_too() {
        let world = wall();
        let mut rng = Pcg32::new(5, 2);
        // A sum of twelve uniform numbers of variance 1/12: normal but for its far tails.
        let mut normal = || (0..12).map(|_| rng.next_f32()).sum::<f32>() - 6.0;
        let draws: Vec<(f32, f32)> =
            world.positions().iter().map(|_| (normal(), (normal().powi(2) + normal().powi(2)) / 2.0)).collect();
        let is_dark = |slot: usize| slot.is_multiple_of(97);
        let is_lit: Vec<bool> = (0..draws.len()).map(|slot| !is_dark(slot)).collect();
        let pooled = pooled_with_neighbours(&world, 2.0, &is_lit, |slot| draws[slot].1);
        let lit: Vec<usize> = (0..draws.len()).filter(|&slot| !is_dark(slot)).collect();
        let count = lit.len() as f64;
        let surprised = |variance: &dyn Fn(usize) -> f32| {
            lit.iter().filter(|&&slot| draws[slot].0.powi(2) > 9.0 * variance(slot)).count() as f64 / count
        };
        // Student's distribution of two degrees of freedom; with some eight more it is close to a normal one.
        assert!(surprised(&|slot| draws[slot].1) > 0.07);
        let share = surprised(&|slot| pooled[slot]);
        assert!(share < 0.02, "{share}");
        let mean = lit.iter().map(|&slot| f64::from(pooled[slot])).sum::<f64>() / count;
        // Each has the variance 1 of two degrees of freedom; those on the edge count for more than others.
        let deviation = (1.5 / count).sqrt();
        let mut family = Family::of_known_errors();
        family.compare("mean", mean - 1.0, deviation);
        family.assert_agrees();
        assert!((0..draws.len()).filter(|&slot| is_dark(slot)).all(|slot| pooled[slot] == 0.0));
    }

    /// Noise of a known variance on light that rises along a wall: the mean of what is found is that variance.
    #[test]
    fn noise_is_told_from_a_gradient() {
        let world = wall();
        let mut rng = Pcg32::new(3, 1);
        let light: Vec<Vec3> = world
            .positions()
            .iter()
            .map(|p| Vec3::new(3.0 * p.x, p.z, 1.0) + Vec3::from([0, 1, 2].map(|_| 0.2 * (rng.next_f32() - 0.5))))
            .collect();
        let square = |light: Vec3, factor: f32| factor * light.length_squared() / 3.0;
        let found = scatter_of_neighbours(&world, |slot| light[slot], square);
        let mean = found.iter().map(|v| f64::from(*v)).sum::<f64>() / found.len() as f64;
        let truth = 0.2 * 0.2 / 12.0;
        // A uniform number's square has a relative deviation of √(4/5); three channels of so many elements, of which
        // seven share a neighbourhood.
        let deviation = (0.8 / (3.0 * found.len() as f64 / 7.0)).sqrt();
        let mut family = Family::of_known_errors();
        family.compare("variance", mean / truth - 1.0, deviation);
        family.assert_agrees();
    }
}
