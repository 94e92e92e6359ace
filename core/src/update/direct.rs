//! ΔD: the change of light that arrives straight from lights, on unchanged elements.

use glam::Vec3;
use rayon::prelude::*;

use super::extent::Extent;
use crate::bvh::Ray;
use crate::job::Canceled;
use crate::random::{Pcg32, R2, subseed};
use crate::sampling::Spheres;
use crate::solve::Subset;
use crate::surface::bounds_of;
use crate::transport::{DirectLight, Work};
use crate::value::Value;
use crate::world::{Emitter, Shape, Transition, Trees, World};

/// Slots that are asked together which lights may change there; neighbours, mostly.
const BLOCK: usize = 64;

/// Blocks per task.
const BLOCKS: usize = 64;

/// Spheres are larger by this part of their radius than they are told to be.
const INEXACT: f32 = 1e-3;

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
    /// Per block of slots: the pairs whose light may change there.
    reaching: Vec<Vec<u32>>,
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
        let sphere = Spheres::new(&triangles).bounding();
        let mut change = DirectChange { transition, pairs, sphere, reaching: Vec::new() };
        let blocks = (0..after.slots().div_ceil(BLOCK)).into_par_iter().with_min_len(BLOCKS);
        change.reaching = blocks.map(|block| change.pairs_reaching(block)).collect();
        change
    }

    /// Pairs whose light may change in a block.
    fn pairs_reaching(&self, block: usize) -> Vec<u32> {
        let world = &self.transition.after;
        let slots = block * BLOCK..world.slots().min((block + 1) * BLOCK);
        let computed = slots.filter(|&slot| world.is_computed(slot));
        let (low, high) = bounds_of(computed.map(|slot| world.positions()[slot]));
        if !low.cmple(high).all() {
            return Vec::new();
        }
        let around = (low.midpoint(high), 0.5 * low.distance(high));
        let pairs = (0..).zip(&self.pairs).filter(|(_, pair)| self.may_reach(pair, around));
        pairs.map(|(index, _)| index).collect()
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

    /// What lamps alone change, where everything stands as it did; none where anything does not, or no lamp changes.
    pub(super) fn of_lamps(&self) -> Option<LampChange<'_>> {
        let pairs: Vec<&Pair> = self.pairs.iter().filter(|pair| pair.before != pair.after).collect();
        (self.sphere.is_none() && !pairs.is_empty()).then_some(LampChange { direct: self, pairs })
    }

    /// Those of some slots whose direct light may change, and perhaps some beside them.
    pub(super) fn may_change(&self, slots: &[u32]) -> Vec<u32> {
        let may_change = |slot: &&u32| !self.reaching[**slot as usize / BLOCK].is_empty();
        slots.par_iter().with_min_len(BLOCK * BLOCKS).filter(may_change).copied().collect()
    }

    /// Whether what changes of a light can be seen within a sphere.
    fn may_reach(&self, pair: &Pair, (point, radius): (Vec3, f32)) -> bool {
        if pair.before != pair.after {
            return true;
        }
        if matches!(pair.emitter.shape, Shape::Sky(_)) || pair.before == Vec3::ZERO {
            return false;
        }
        let Some((center, size)) = self.sphere else { return false };
        let Some((light, light_radius)) = pair.emitter.sphere() else { return true };
        // All that is between two spheres is within the larger radius about the line between their centers.
        let (way, to_object) = (light - point, center - point);
        let along = (to_object.dot(way) / way.length_squared().max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
        let reach = (size + radius.max(light_radius)) * (1.0 + INEXACT);
        (to_object - way * along).length_squared() <= reach * reach
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
            for pair in self.reaching[slot as usize / BLOCK].iter().map(|&index| &self.pairs[index as usize]) {
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

/// How the light of lamps changes that comes straight from them, at any point.
pub(super) struct LampChange<'a> {
    direct: &'a DirectChange<'a>,
    /// Those that change.
    pairs: Vec<&'a Pair<'a>>,
}

/// So many lights are sampled each: one that moves goes and comes, and either alone would be noise.
const EACH: usize = 2;

impl LampChange<'_> {
    /// One sample of the change at a point with a normal, irradiance / π.
    #[inline]
    pub(super) fn at<V: Value>(&self, at: (Vec3, Vec3), rng: &mut Pcg32, rays: &mut u64) -> V {
        let mut light = V::default();
        if self.pairs.len() <= EACH {
            self.pairs.iter().for_each(|pair| self.add(pair, at, 1.0, rng, rays, &mut light));
        } else {
            let count = self.pairs.len() as f32;
            let chosen = ((rng.next_f32() * count) as usize).min(self.pairs.len() - 1);
            self.add(self.pairs[chosen], at, count, rng, rays, &mut light);
        }
        light
    }

    #[inline]
    fn add<V: Value>(&self, pair: &Pair, at: (Vec3, Vec3), by: f32, rng: &mut Pcg32, rays: &mut u64, light: &mut V) {
        light.add_to_layer(pair.emitter.layer, self.direct.pair_change(pair, 1, at.0, at.1, rng, rays) * by);
    }

    /// Whether one sample tells all: none of them has an extent.
    pub(super) fn is_exact(&self) -> bool {
        self.pairs.iter().all(|pair| pair.emitter.is_delta())
    }
}

/// What something leaves of light along a ray.
fn left(trees: Option<&Trees>, ray: &Ray, rays: &mut u64) -> Vec3 {
    trees.map_or(Vec3::ONE, |trees| {
        *rays += 1;
        trees.transmittance(ray)
    })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DMat4, DVec3};

    use super::*;
    use crate::edit::Edit;
    use crate::scene::{Light, LightKind, Material, Mesh, Object, Scene};
    use crate::world::WorldOptions;

    /// Three rooms in a row that doors join, a lamp with an extent in the first, and one without in the last.
    fn house() -> World {
        let grey = || Material::diffuse(Vec3::splat(0.5));
        let mut objects = Vec::new();
        for (k, x) in [0.0, 3.0, 6.0].into_iter().enumerate() {
            let (low, high) = (Vec3::new(x, 0.0, 0.0), Vec3::new(x + 3.0, 2.5, 3.0));
            objects.push(Object::new(format!("floor {k}"), Mesh::quad(low, Vec3::Z * 3.0, Vec3::X * 3.0), grey()));
            let wall = Mesh::cuboid(Vec3::new(high.x - 0.1, 0.0, 0.0), Vec3::new(high.x, 2.5, 2.2));
            objects.push(Object::new(format!("wall {k}"), wall, grey()));
            let chest = Mesh::cuboid(low + Vec3::new(0.4, 0.0, 0.5), low + Vec3::new(0.9, 0.6, 1.2));
            objects.push(Object::new(format!("chest {k}"), chest, grey()));
        }
        let panel = Mesh::quad(Vec3::new(1.0, 2.4, 1.0), Vec3::X * 0.5, Vec3::Z * 0.5);
        objects.push(Object::new("panel", panel, Material::emissive(Vec3::splat(5.0))));
        let kind = LightKind::Point { position: DVec3::new(7.5, 2.0, 1.5), range: None };
        let bulb = Light { name: "bulb".into(), kind, color: Vec3::ONE, intensity: 3.0 };
        let options = WorldOptions { spacing: Some(0.1), ..WorldOptions::default() };
        World::new(Scene::from_objects(objects).with_light(bulb), &options).expect("a house")
    }

    /// Where nothing is asked, nothing changes, and no light that is left out somewhere would change there.
    #[test]
    fn direct_light_changes_nowhere_but_where_it_may() {
        let world = house();
        for (at, size) in [(DVec3::new(0.9, 0.0, 1.4), 0.4), (DVec3::new(7.0, 1.0, 1.0), 0.3), (DVec3::ZERO, 1.5)] {
            let mesh = Mesh::cuboid(Vec3::ZERO, Vec3::splat(size));
            let inserted = Object::new("crate", mesh, Material::diffuse(Vec3::splat(0.5)));
            let (asset, transform) = (Arc::new(Scene::from_objects(vec![inserted])), DMat4::from_translation(at));
            let edit = Edit::Insert { asset, name: "crate".into(), transform };
            let transition = world.apply(&[edit]).expect("an edit");
            let direct = DirectChange::new(&transition);
            let all = transition.after.computed_slots();
            let asked = direct.may_change(&all);
            let mut is_asked = vec![false; transition.after.slots()];
            asked.iter().for_each(|&slot| is_asked[slot as usize] = true);
            assert!(asked.len() < all.len() / 2, "{} of {}", asked.len(), all.len());
            let every_pair: Vec<u32> = (0..direct.pairs.len() as u32).collect();
            let every = vec![every_pair; direct.reaching.len()];
            let every = DirectChange { reaching: every, ..DirectChange::new(&transition) };
            let mut changed = 0;
            for seed in 0..4 {
                let (change, whole) = (direct.change::<Vec3>(4, seed), every.change::<Vec3>(4, seed));
                for &slot in &all {
                    let light = whole(slot, &mut 0);
                    assert_eq!(change(slot, &mut 0), light, "slot {slot}");
                    assert!(light == Vec3::ZERO || is_asked[slot as usize], "slot {slot}");
                    changed += u32::from(light != Vec3::ZERO);
                }
            }
            assert!(changed > 20, "{changed}");
        }
    }
}
