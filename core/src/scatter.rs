//! Variance of a light map from one round alone: from how values scatter about those of their neighbours. Light is
//! smooth along a surface but for the edges of shadows, noise is not; so a first map knows its error, too, until more
//! rounds tell it.

use glam::Vec3;
use rayon::prelude::*;

use crate::world::World;

/// Elements per task.
const CHUNK: usize = 1024;

/// Per slot: variance of some light, mean over RGB; zero where no element is computed. An element's distance from the
/// mean of its k valid neighbours has (1 + 1/k) times the variance, whatever the gradient; the mean over itself and its
/// neighbours is taken.
pub(crate) fn scatter_of_neighbours(world: &World, light: impl Fn(usize) -> Vec3 + Sync) -> Vec<f32> {
    let mut variance = vec![0.0; world.slots()];
    let is_valid = |slot: usize| world.is_valid(slot);
    for placed in &world.placed {
        for side in placed.sides() {
            let own = side.start as usize..side.end as usize;
            let first = own.start;
            let neighbours = |element: usize| {
                let slots = placed.layout.neighbours_of(element as u32).iter().map(|&e| first + e as usize);
                slots.filter(|&slot| is_valid(slot))
            };
            let square = |element: usize| {
                let (sum, count) =
                    neighbours(element).fold((Vec3::ZERO, 0.0), |(s, n), slot| (s + light(slot), n + 1.0));
                if count == 0.0 || !is_valid(first + element) {
                    return 0.0;
                }
                (light(first + element) - sum / count).length_squared() / 3.0 * count / (count + 1.0)
            };
            let squares: Vec<f32> = (0..own.len()).into_par_iter().with_min_len(CHUNK).map(square).collect();
            let pooled = |(element, variance): (usize, &mut f32)| {
                let around = neighbours(element).map(|slot| squares[slot - first]);
                let (sum, count) = around.fold((squares[element], 1.0), |(s, n), square| (s + square, n + 1.0));
                *variance = sum / count;
            };
            variance[own].par_iter_mut().enumerate().with_min_len(CHUNK).for_each(pooled);
        }
    }
    variance
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Pcg32;
    use crate::scene::{Material, Mesh, Object, Scene};
    use crate::world::WorldOptions;

    /// Noise of a known variance on light that rises along a wall: the mean of what is found is that variance.
    #[test]
    fn noise_is_told_from_a_gradient() {
        let wall =
            Object::new("wall", Mesh::quad(Vec3::ZERO, Vec3::X * 2.0, Vec3::Z * 2.0), Material::diffuse(Vec3::ONE));
        let options = WorldOptions { spacing: Some(0.03), ..WorldOptions::default() };
        let world = World::new(Scene::from_objects(vec![wall]), &options).expect("a wall");
        let mut rng = Pcg32::new(3, 1);
        let light: Vec<Vec3> = world
            .positions()
            .iter()
            .map(|p| Vec3::new(3.0 * p.x, p.z, 1.0) + Vec3::from([0, 1, 2].map(|_| 0.2 * (rng.next_f32() - 0.5))))
            .collect();
        let found = scatter_of_neighbours(&world, |slot| light[slot]);
        let mean = found.iter().map(|v| f64::from(*v)).sum::<f64>() / found.len() as f64;
        let truth = 0.2 * 0.2 / 12.0;
        // A uniform number's square has a relative deviation of √(4/5); three channels of so many elements, of which
        // seven share a neighbourhood.
        let deviation = (0.8 / (3.0 * found.len() as f64 / 7.0)).sqrt();
        assert!((mean / truth - 1.0).abs() < 5.0 * deviation, "{mean} for {truth}, +- {deviation}");
    }
}
