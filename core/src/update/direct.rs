//! ΔD: the change of light that arrives straight from lights, on unchanged elements.

use glam::Vec3;

use super::extent::Extent;
use crate::bvh::Ray;
use crate::job::Canceled;
use crate::random::{Pcg32, R2, subseed};
use crate::sampling::Spheres;
use crate::solve::Subset;
use crate::transport::{DirectLight, Work};
use crate::value::Value;
use crate::world::{Emitter, Shape, Transition, Trees, World};

/// One light in both worlds.
struct Pair<'a> {
    /// Geometry of the light, the same in both worlds.
    emitter: &'a Emitter,
    /// Strength before and after.
    before: Vec3,
    after: Vec3,
    /// Its places among the emitters of both worlds, for its sample counts.
    places: [Option<usize>; 2],
}

/// How direct light changes between two worlds.
pub(super) struct DirectChange<'a> {
    transition: &'a Transition,
    pairs: Vec<Pair<'a>>,
    /// Sphere around all geometry that was inserted or removed.
    sphere: Option<(Vec3, f32)>,
}

impl<'a> DirectChange<'a> {
    pub(super) fn new(transition: &'a Transition) -> DirectChange<'a> {
        let (before, after) = (&transition.before, &transition.after);
        let stays = |e: &Emitter, in_world: &World, other: &World| {
            // A light on an object stays where its object did.
            e.object.is_none_or(|key| {
                let find =
                    |w: &World| w.placed.iter().find(|p| p.key == key).map(|p| std::sync::Arc::as_ptr(&p.surface));
                find(in_world) == find(other)
            })
        };
        let mut pairs = Vec::new();
        let olds: Vec<&Emitter> = before.emitters.all().collect();
        let mut matched = vec![false; olds.len()];
        for (i, emitter) in after.emitters.all().enumerate() {
            let old = olds.iter().position(|o| o.name == emitter.name && o.same_shape(emitter));
            let old = old.filter(|_| stays(emitter, after, before));
            if let Some(o) = old {
                matched[o] = true;
            }
            let strength = old.map_or(Vec3::ZERO, |o| olds[o].strength);
            pairs.push(Pair { emitter, before: strength, after: emitter.strength, places: [old, Some(i)] });
        }
        for (i, emitter) in olds.into_iter().enumerate().filter(|(i, _)| !matched[*i]) {
            pairs.push(Pair { emitter, before: emitter.strength, after: Vec3::ZERO, places: [Some(i), None] });
        }
        let triangles: Vec<[Vec3; 3]> = transition.changed_triangles();
        DirectChange { transition, pairs, sphere: Spheres::new(&triangles).bounding() }
    }

    /// Adds ΔD of all slots of `extent` to `out`.
    pub(super) fn estimate<V: Value>(
        &self,
        extent: &Extent,
        subset: &Subset,
        samples: u32,
        seed: u64,
        work: &Work,
        out: &mut [V],
    ) -> Result<(), Canceled> {
        if self.sphere.is_none() && self.pairs.iter().all(|p| p.before == p.after) {
            return Ok(());
        }
        let change = self.change(samples, seed);
        if extent.is_fine() {
            return work.add(&extent.fine, out, change);
        }
        let found = |slots: &[u32]| work.map(slots, |_, slot, rays| change(slot, rays));
        extent.add(subset, &found(&extent.fine)?, &found(&extent.representatives)?, out);
        Ok(())
    }

    /// ΔD of an element.
    fn change<V: Value>(&self, samples: u32, seed: u64) -> impl Fn(u32, &mut u64) -> V + Sync {
        let (before, after) = (&self.transition.before, &self.transition.after);
        let counts = [DirectLight::new(before, samples), DirectLight::new(after, samples)];
        let seed = subseed(seed, 0xdd);
        move |slot, rays| {
            let (point, n) = after.ray_origin(slot as usize);
            let mut rng = Pcg32::new(seed, u64::from(slot));
            let mut sum = V::default();
            for pair in &self.pairs {
                let count = |world: usize| pair.places[world].map_or(0, |place| counts[world].samples[place]);
                let count = count(0).max(count(1)).max(1);
                let change = self.pair_change(pair, count, point, n, &mut rng, rays);
                sum.add_to_layer(pair.emitter.layer, change);
            }
            sum
        }
    }

    fn pair_change(&self, pair: &Pair, count: u32, point: Vec3, n: Vec3, rng: &mut Pcg32, rays: &mut u64) -> Vec3 {
        let emitter = pair.emitter;
        let steady = pair.before == pair.after;
        // What geometry changes of an even sky is found by the rays of the source.
        let is_sky = matches!(emitter.shape, Shape::Sky(_));
        if steady && (is_sky || pair.before == Vec3::ZERO || !self.may_be_cut(emitter, point))
            || emitter.is_below_horizon(point, n)
        {
            return Vec3::ZERO;
        }
        let sequence = R2::new(rng);
        let mut sum = Vec3::ZERO;
        for k in 0..count {
            let Some(sample) = emitter.sample(point, n, sequence.get(k)) else { continue };
            let end = sample.end(point);
            let ray = Ray { origin: point, direction: sample.direction, t_min: 0.0, t_max: sample.distance - end };
            let removed = left(self.transition.removed.as_ref(), &ray, rays);
            let inserted = if is_sky { removed } else { left(self.transition.inserted.as_ref(), &ray, rays) };
            let (before, after) = (pair.before * removed, pair.after * inserted);
            if before == after {
                continue;
            }
            *rays += 1;
            let arriving = self.transition.common.transmittance(&ray) * sample.tint;
            sum += (after - before) * arriving * sample.weight;
        }
        sum / count as f32
    }

    /// Whether a segment to the light can pass through the sphere of changed geometry: their cones overlap.
    fn may_be_cut(&self, emitter: &Emitter, point: Vec3) -> bool {
        let Some((center, radius)) = self.sphere else { return false };
        let Some((light, light_radius)) = emitter.sphere() else { return true };
        let (to_object, to_light) = (center - point, light - point);
        let (object_distance, light_distance) = (to_object.length(), to_light.length());
        if object_distance <= radius || light_distance <= light_radius {
            return true;
        }
        if object_distance - radius > light_distance + light_radius {
            return false;
        }
        // cos(a + b) of the half angles of both cones, from their sines.
        let (a, b) = (radius / object_distance, light_radius / light_distance);
        let cos_sum = ((1.0 - a * a) * (1.0 - b * b)).sqrt() - a * b;
        to_object.dot(to_light) >= (cos_sum - 1e-4) * object_distance * light_distance
    }
}

/// What something leaves of light along a ray.
fn left(trees: Option<&Trees>, ray: &Ray, rays: &mut u64) -> Vec3 {
    trees.map_or(Vec3::ONE, |trees| {
        *rays += 1;
        trees.transmittance(ray)
    })
}
