//! The operators: 𝒪 by the bounding sphere, a random walk on the object, paths through the scene without it.

use std::f32::consts::{FRAC_1_PI, TAU};

use glam::Vec3;

use super::scenes::ObjectScene;
use rebake_core::bvh::{Hit, Ray};
use rebake_core::random::{Pcg32, R2, subseed};
use rebake_core::sampling::{Cone, cosine_hemisphere};
use rebake_core::transport::{Surfel, Work, light_of_one};
use rebake_core::{Canceled, World};

/// Walks end by Russian roulette from this vertex on, and here at the latest.
const ROULETTE_DEPTH: u32 = 4;
const MAX_DEPTH: u32 = 256;

/// Where lights are sampled, one per vertex, in S ∪ O.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sampled {
    /// Nowhere: the field has no emission.
    Nowhere,
    /// On the object: the field has emission, and its direct light off the object is in the map.
    OnObject,
    /// Wherever a ray ends, too: the map has no direct light.
    Everywhere,
}

/// The radiance that an operator is applied to: reflected light and, by `lights`, emission and its first bounce.
#[derive(Clone, Copy)]
pub(super) struct Field<'a> {
    /// Reflected light, irradiance / π per slot; none: zero.
    pub map: Option<&'a [Vec3]>,
    /// Emission.
    pub lights: Sampled,
    /// `map` holds for the object, too: it is looked up there and no walk is needed.
    pub on_object: bool,
}

/// Where a ray goes on.
struct Vertex {
    surfel: Surfel,
    point: Vec3,
}

impl Vertex {
    fn new(world: &World, ray: &Ray, hit: &Hit) -> Option<Vertex> {
        let surfel = Surfel::new(world, ray, hit)?;
        Some(Vertex { surfel, point: surfel.ray_origin() })
    }
}

fn ray(origin: Vec3, direction: Vec3) -> Ray {
    Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY }
}

impl ObjectScene<'_> {
    /// 𝒪 applied to a field, at all elements of S: radiance that the object sends and, negative, what it hides.
    /// Answers reflected light and the change of visible background apart.
    pub(super) fn apply_object(
        &self,
        field: &Field,
        samples: u32,
        seed: u64,
        work: &Work,
    ) -> Result<Vec<(Vec3, Vec3)>, Canceled> {
        let seed = subseed(seed, 0x0b1ec7);
        work.map(&self.rows, |_, slot, rays| {
            let (point, n) = self.with.ray_origin(slot as usize);
            let (center, radius) = self.sphere;
            if n.dot(center - point) <= -radius {
                return (Vec3::ZERO, Vec3::ZERO);
            }
            let cone = Cone::to_sphere(point, center, radius);
            let mut rng = Pcg32::new(seed, u64::from(slot));
            let sequence = R2::new(&mut rng);
            let (mut light, mut sky) = (Vec3::ZERO, Vec3::ZERO);
            for k in 0..samples {
                let u = sequence.get(k);
                // Uniform in the solid angle of the sphere (Wang 1992); inside it by the cosine.
                let (direction, weight) = match &cone {
                    Some(cone) => {
                        let direction = cone.sample(u);
                        (direction, n.dot(direction) * FRAC_1_PI * TAU * cone.one_minus_cos)
                    }
                    None => (cosine_hemisphere(n, u), 1.0),
                };
                if weight > 0.0
                    && let Some((l, s)) = self.change_along(&ray(point, direction), field, &mut rng, rays)
                {
                    light += l * weight;
                    sky += s * weight;
                }
            }
            (light / samples as f32, sky / samples as f32)
        })
    }

    /// What the object changes along a ray; none where it is missed or hidden.
    fn change_along(&self, ray: &Ray, field: &Field, rng: &mut Pcg32, rays: &mut u64) -> Option<(Vec3, Vec3)> {
        *rays += 1;
        let hit = self.object.closest_hit(ray);
        let t = hit.map_or(f32::INFINITY, |hit| hit.t);
        if hit.is_none() && self.object.tint(ray, t) == Vec3::ONE {
            return None;
        }
        *rays += 1;
        // What is left of light with the object and without it.
        let mut before = Vec3::ONE;
        let behind = self.without.first_hit(ray, &mut before);
        let end = behind.map_or(f32::INFINITY, |behind| behind.t);
        let is_behind = end <= t;
        let after = self.object.tint(ray, t.min(end)) * self.without.tint(ray, t.min(end));
        if is_behind && after == before {
            return None;
        }
        let sent = if is_behind { Vec3::ZERO } else { self.follow(*ray, hit, field, rng, rays) };
        let beyond = before - if is_behind { after } else { Vec3::ZERO };
        let (hidden, sky) = match behind {
            Some(behind) => (self.radiance(ray, &behind, field, rng, rays), Vec3::ZERO),
            None => (Vec3::ZERO, self.with.even_sky(ray.direction)),
        };
        Some((sent * after - hidden * beyond, -sky * beyond))
    }

    /// Radiance that a surface reflects against a ray: the map, and direct light where `sampled`.
    fn reflected(&self, vertex: &Vertex, field: &Field, sampled: bool, rng: &mut Pcg32, rays: &mut u64) -> Vec3 {
        let surfel = &vertex.surfel;
        let known = match (field.map, surfel.footprint) {
            (Some(map), Some(footprint)) => footprint.interpolate(map),
            _ => Vec3::ZERO,
        };
        let direct = if sampled { light_of_one(self.with, vertex.point, surfel.normal, rng, rays) } else { Vec3::ZERO };
        surfel.albedo * (known + direct)
    }

    /// Radiance that a surface off the object reflects against the ray that met it.
    fn radiance(&self, ray: &Ray, hit: &Hit, field: &Field, rng: &mut Pcg32, rays: &mut u64) -> Vec3 {
        let sampled = field.lights == Sampled::Everywhere;
        Vertex::new(self.with, ray, hit).map_or(Vec3::ZERO, |v| self.reflected(&v, field, sampled, rng, rays))
    }

    /// Follows a ray over the object until it meets something else, and answers the reflected radiance that comes back
    /// (section 3.5). `first` is its first hit where that is known.
    pub(super) fn follow(
        &self,
        mut ray: Ray,
        mut first: Option<Hit>,
        field: &Field,
        rng: &mut Pcg32,
        rays: &mut u64,
    ) -> Vec3 {
        let lit = field.lights != Sampled::Nowhere;
        let (mut radiance, mut beta) = (Vec3::ZERO, Vec3::ONE);
        for depth in 0..MAX_DEPTH {
            let hit = first.take().or_else(|| {
                *rays += 1;
                self.with.trees().first_hit(&ray, &mut beta)
            });
            let Some(hit) = hit else {
                // The background at the first hit is direct light, which is counted elsewhere.
                if depth > 0 && lit {
                    radiance += beta * self.with.even_sky(ray.direction);
                }
                break;
            };
            if !self.is_object[self.with.part_index(hit.triangle) as usize] {
                radiance += beta * self.radiance(&ray, &hit, field, rng, rays);
                break;
            }
            let Some(vertex) = Vertex::new(self.with, &ray, &hit) else { break };
            if field.on_object {
                let sampled = field.lights == Sampled::Everywhere;
                radiance += beta * self.reflected(&vertex, field, sampled, rng, rays);
                break;
            }
            let Vertex { surfel, point } = vertex;
            beta *= surfel.albedo;
            if depth >= ROULETTE_DEPTH {
                let survive = beta.max_element().min(0.95);
                if rng.next_f32() >= survive {
                    break;
                }
                beta /= survive;
            }
            if beta == Vec3::ZERO {
                break;
            }
            if lit {
                radiance += beta * light_of_one(self.with, point, surfel.normal, rng, rays);
            }
            ray = self::ray(point, cosine_hemisphere(surfel.normal, rng.next_2d()));
        }
        radiance
    }

    /// `Σ_{k = 1..M} T_S^k` applied to reflected light (irradiance / π per slot), at all elements of S: one path of at
    /// most M segments per sample through the scene without the object, looking the map up at every vertex.
    pub(super) fn bounce(
        &self,
        map: &[Vec3],
        path_length: u32,
        samples: u32,
        seed: u64,
        work: &Work,
    ) -> Result<Vec<Vec3>, Canceled> {
        if path_length == 0 {
            return Ok(vec![Vec3::ZERO; self.rows.len()]);
        }
        let seed = subseed(seed, 0xb0);
        work.map(&self.rows, |_, slot, rays| {
            let (point, n) = self.with.ray_origin(slot as usize);
            let mut rng = Pcg32::new(seed, u64::from(slot));
            let sequence = R2::new(&mut rng);
            let mut sum = Vec3::ZERO;
            for k in 0..samples {
                let mut ray = ray(point, cosine_hemisphere(n, sequence.get(k)));
                let mut beta = Vec3::ONE;
                for _ in 0..path_length {
                    *rays += 1;
                    let Some(hit) = self.without.first_hit(&ray, &mut beta) else { break };
                    let Some(vertex) = Vertex::new(self.with, &ray, &hit) else { break };
                    beta *= vertex.surfel.albedo;
                    if let Some(footprint) = vertex.surfel.footprint {
                        sum += beta * footprint.interpolate(map);
                    }
                    ray = self::ray(vertex.point, cosine_hemisphere(vertex.surfel.normal, rng.next_2d()));
                }
            }
            sum / samples as f32
        })
    }
}
