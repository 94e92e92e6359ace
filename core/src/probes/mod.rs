//! Probes: the light that comes to points in space from all around, as spherical harmonics. Light straight from lights
//! is sampled by their densities, what surfaces send is read from a light map along rays.

#[cfg(test)]
mod tests;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::batches::{BATCHES, mean_of, shares};
use crate::harmonics::{COEFFICIENTS, Harmonics};
use crate::job::{Canceled, Observer};
use crate::lightmap::LightMap;
use crate::random::{Pcg32, R2, subseed};
use crate::sampling::{uniform_sphere, uniform_sphere_pdf};
use crate::transport::{DirectLight, Field, Rough};
use crate::world::{World, arriving_in_space};

/// How many samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProbeOptions {
    /// Samples per probe: rays in all directions, and rays to each light. At least two are taken.
    pub samples: u32,
    /// Seed of the random numbers.
    pub seed: u64,
}

/// The light around a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Probe {
    /// Incoming radiance over all directions, of all lights and surfaces and from outside; see [`crate::harmonics`] for
    /// order and signs. Not convolved with a cosine: [`Harmonics::irradiance`] does that.
    pub radiance: Harmonics,
    /// Standard error of each coefficient, mean over RGB, from the scatter of its samples: rays that end on other
    /// elements meet other noise of the map. What all of the map has wrong alike is not in it.
    pub error: [f32; COEFFICIENTS],
    /// Share of the directions in which the point sees no back of a single-sided surface or of one that bounds a solid:
    /// 1 in the open, 0 inside of solids. Backs send no light.
    pub validity: f32,
}

impl Probe {
    /// Whether the light differs from that of an earlier probe, in some coefficient and channel, by more than the error
    /// of this one.
    pub fn differs_from(&self, earlier: &Probe) -> bool {
        let differences = (self.radiance - earlier.radiance).0;
        differences.iter().zip(&self.error).any(|(difference, error)| difference.abs().max_element() > *error)
    }
}

/// Probes at points (world space, metres) of a scene with this light map. The same inputs and seed give the same bits
/// on any number of threads.
///
/// # Errors
/// [`Canceled`] where the observer says so; it is asked once per probe.
///
/// # Panics
/// Where the map has not one value per slot.
pub fn probes_at(
    world: &World,
    map: &LightMap,
    points: &[DVec3],
    options: &ProbeOptions,
    observer: &dyn Observer,
) -> Result<Vec<Probe>, Canceled> {
    assert_eq!(map.len(), world.slots(), "a light map has one value per slot");
    let total: Vec<Vec3> = (0..map.len()).into_par_iter().map(|slot| map.total(slot)).collect();
    let rough = Rough::new(world, |slot| map.light.direct[slot as usize].element_sum());
    let field = Field { total: &total, indirect: &map.light.indirect, rough: &rough };
    let shares = shares(options.samples.max(2));
    let lights = shares.map(|count| DirectLight::new(world, count));
    let one = |(index, point): (usize, &DVec3)| {
        if observer.canceled() {
            return Err(Canceled);
        }
        let point = (*point - world.scene.origin).as_vec3();
        let part = |k: usize| match shares[k] {
            0 => (0, Estimate::default()),
            count => {
                let mut rng = Pcg32::new(subseed(options.seed, 0x9b0 + k as u64), index as u64);
                (count, Estimate::new(world, (&field, &lights[k]), point, count, &mut rng))
            }
        };
        Ok(probe_of(&std::array::from_fn(part)))
    };
    points.par_iter().enumerate().map(one).collect()
}

/// One estimate of a probe.
#[derive(Clone, Copy, Debug, Default)]
struct Estimate {
    radiance: Harmonics,
    validity: f32,
}

impl Estimate {
    fn new(
        world: &World,
        (field, lights): (&Field<Vec3>, &DirectLight),
        point: Vec3,
        samples: u32,
        rng: &mut Pcg32,
    ) -> Estimate {
        let (mut around, mut backs, rays) = (Harmonics::default(), 0, &mut 0);
        let sequence = R2::new(rng);
        for k in 0..samples {
            let direction = uniform_sphere(sequence.get(k));
            match field.seen(world, point, direction, rng, rays) {
                Some(seen) => around += Harmonics::of(direction, (seen.reflected + seen.sky) / uniform_sphere_pdf()),
                None => backs += 1,
            }
        }
        let samples_f = samples as f32;
        Estimate {
            radiance: around / samples_f + direct(world, lights, point, rng, rays),
            validity: 1.0 - backs as f32 / samples_f,
        }
    }
}

/// Light straight from the lights that are aimed at.
fn direct(world: &World, lights: &DirectLight, point: Vec3, rng: &mut Pcg32, rays: &mut u64) -> Harmonics {
    let mut sum = Harmonics::default();
    for (emitter, count) in world.emitters.list.iter().zip(&lights.samples).filter(|(_, count)| **count > 0) {
        let (mut light, sequence) = (Harmonics::default(), R2::new(rng));
        for k in 0..*count {
            let arriving = arriving_in_space(emitter, &world.trees, point, sequence.get(k), rays);
            arriving.into_iter().for_each(|(direction, power)| light += Harmonics::of(direction, power));
        }
        sum += light / *count as f32;
    }
    sum
}

/// Mean of independent parts, and what their scatter tells.
fn probe_of(parts: &[(u32, Estimate); BATCHES]) -> Probe {
    let of = |k: usize| mean_of(&parts.map(|(count, estimate)| (count, estimate.radiance.0[k])));
    let found: [(Vec3, f32); COEFFICIENTS] = std::array::from_fn(of);
    let (validity, _) = mean_of(&parts.map(|(count, estimate)| (count, Vec3::splat(estimate.validity))));
    Probe {
        radiance: Harmonics(found.map(|(mean, _)| mean)),
        error: found.map(|(_, error)| error),
        validity: validity.x,
    }
}
