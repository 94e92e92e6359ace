//! Lights as a path meets them: sampled from a vertex, or hit by a ray that was sampled by the cosine.
//!
//! Write `w` for a light sample's weight: its contribution to irradiance / π per unit radiance over its density, which
//! is `p_cos / p_light`. With `a` light samples and `b` cosine samples the balance heuristic turns a light sample into
//! `w / (a + b w)` and a hit into `w / (a + b w)` as well, per sample of each: bounded, whatever the geometry. For one
//! light chosen with probability q, `a` is q.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;

use rebake_core::bvh::{Hit, Ray};
use rebake_core::random::{Pcg32, R2};
use rebake_core::scene::LightKind;
use rebake_core::transport::DirectLight;
use rebake_core::{Emitter, Placed, World, arriving};

const NONE: u32 = u32::MAX;

/// A world's lights with the way back from triangles to them.
pub(super) struct Lights<'a> {
    pub(super) world: &'a World,
    /// Light samples of an element per batch.
    counts: DirectLight,
    /// Cosine samples of an element per batch.
    cosine_samples: f32,
    /// Per part: the emitter.
    of_part: Vec<u32>,
    /// Per emitter with triangles: the slot of its object's first.
    first_faces: Vec<u32>,
}

impl<'a> Lights<'a> {
    /// For batches of `samples` paths.
    pub(super) fn new(world: &'a World, samples: u32) -> Lights<'a> {
        let counts = DirectLight::new(world, samples);
        let mut lights = Lights {
            world,
            counts,
            cosine_samples: samples as f32,
            of_part: vec![NONE; world.part_count()],
            first_faces: vec![NONE; world.emitters().len()],
        };
        for (index, emitter) in world.emitters().iter().enumerate() {
            let Some((placed, material)) = emissive_part(world, emitter) else { continue };
            lights.of_part[(placed.placement.parts.start + material) as usize] = index as u32;
            lights.first_faces[index] = placed.placement.faces.start;
        }
        lights
    }

    /// Direct light of an element from a batch of light samples, the share of the balance heuristic.
    pub(super) fn stratified(&self, point: Vec3, n: Vec3, rng: &mut Pcg32, rays: &mut u64) -> Vec3 {
        let world = self.world;
        let mut sum = Vec3::ZERO;
        for (emitter, &count) in world.emitters().iter().zip(&self.counts.samples) {
            if count == 0 || emitter.is_below_horizon(point, n) {
                continue;
            }
            let sequence = R2::new(rng);
            for k in 0..count {
                let cosine_samples = if emitter.is_surface() { self.cosine_samples } else { 0.0 };
                let samples = (count as f32, cosine_samples);
                sum += shared(emitter, world, (point, n), sequence.get(k), samples, rays);
            }
        }
        sum
    }

    /// Radiance of a light that a cosine ray of an element met, its share beside [`Lights::stratified`], for a mean
    /// over all cosine rays.
    pub(super) fn met_by_first(&self, n: Vec3, ray: &Ray, hit: &Hit) -> Vec3 {
        let share = |index: u32, w: f32| {
            let ratio = self.counts.samples[index as usize] as f32;
            // b w / (a + b w): a mean over b rays divides by b.
            self.cosine_samples * w / (ratio + self.cosine_samples * w)
        };
        self.met_with(n, ray, hit, share)
    }

    /// One sample of one light, at a vertex of a path; its share of the balance heuristic.
    pub(super) fn sampled(&self, point: Vec3, n: Vec3, rng: &mut Pcg32, rays: &mut u64) -> Vec3 {
        let world = self.world;
        let Some((index, probability)) = world.choose_light(point, n, rng.next_f32()) else { return Vec3::ZERO };
        let emitter = &world.emitters()[index];
        let cosine_samples = if emitter.is_surface() { 1.0 } else { 0.0 };
        shared(emitter, world, (point, n), rng.next_2d(), (probability, cosine_samples), rays)
    }

    /// Radiance of a light that a cosine ray of a path met, its share beside [`Lights::sampled`].
    pub(super) fn met(&self, n: Vec3, ray: &Ray, hit: &Hit) -> Vec3 {
        self.met_with(n, ray, hit, |index, w| w / (self.world.light_choice_pdf(ray.origin, n, index as usize) + w))
    }

    #[inline]
    fn met_with(&self, n: Vec3, ray: &Ray, hit: &Hit, share: impl Fn(u32, f32) -> f32) -> Vec3 {
        let index = self.of_part[self.world.part_index(hit.triangle) as usize];
        if index == NONE {
            return Vec3::ZERO;
        }
        let face = hit.triangle - self.first_faces[index as usize];
        let Some((radiance, pdf)) = self.world.emitters()[index as usize].found(ray, hit, face) else {
            return Vec3::ZERO;
        };
        // No light sample can come from where the density is zero: the hit counts in full.
        let part = if pdf > 0.0 { share(index, n.dot(ray.direction) * FRAC_1_PI / pdf) } else { 1.0 };
        radiance * part
    }
}

/// One sample of a light: its share of the balance heuristic beside other samples of it and cosine samples, which find
/// surfaces only.
#[inline]
fn shared(
    emitter: &Emitter,
    world: &World,
    (point, n): (Vec3, Vec3),
    u: [f32; 2],
    (samples, cosine_samples): (f32, f32),
    rays: &mut u64,
) -> Vec3 {
    let Some((w, left)) = arriving(emitter, world.trees(), point, n, u, rays) else { return Vec3::ZERO };
    emitter.strength * left * (w / (samples + cosine_samples * w))
}

/// The object of an emissive surface and the index of its material.
fn emissive_part<'a>(world: &'a World, emitter: &Emitter) -> Option<(&'a Placed, u32)> {
    let key = emitter.object?;
    let light = world.scene.lights.iter().find(|light| light.name == emitter.name)?;
    let LightKind::Emissive { material, .. } = light.kind else { return None };
    let placed = world.placed().iter().find(|placed| placed.key == key)?;
    Some((placed, material))
}
