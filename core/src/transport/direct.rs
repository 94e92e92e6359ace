//! Light that arrives straight from lights.

use glam::Vec3;

use super::{Effort, Work};
use crate::job::Canceled;
use crate::random::{Draws, PartSeed, Pcg32};
use crate::value::Value;
use crate::world::{Emitter, WEIGHED, World, visible_light};

/// Of more lights than are weighed at every vertex, an element gets so many samples of all of them together, over the
/// nominal number.
const OF_MANY: f32 = 4.0;

/// How many samples each light gets, for a nominal number per element.
#[derive(Clone, Debug)]
pub struct DirectLight {
    /// Samples per emitter, in the order of [`World::emitters`], then of what comes evenly from outside.
    pub samples: Vec<u32>,
    /// Samples of one light, at most, and of all that are aimed at together, where they are many.
    of_many: Option<(u32, f32)>,
}

impl DirectLight {
    /// Splits `samples` between the lights that are aimed at by power; lights without extent take one, exactly. Each sky
    /// gets all of them: a hemisphere is large.
    pub fn new(world: &World, samples: u32) -> DirectLight {
        let emitters = &world.emitters;
        let count = emitters.list.len().max(1) as f32;
        let total = samples as f32 * count.sqrt();
        let share = |i: usize| emitters.choice.as_ref().map_or(0.0, |c| c.pdf(i));
        let of = |(i, emitter): (usize, &Emitter)| match () {
            () if emitter.strength == Vec3::ZERO => 0,
            () if emitter.is_delta() => 1,
            () if i >= emitters.list.len() => samples,
            () => ((total * share(i)).round() as u32).clamp(1, samples.max(1)),
        };
        let are_many = emitters.list.len() > WEIGHED;
        DirectLight {
            samples: emitters.all().enumerate().map(of).collect(),
            of_many: are_many.then_some((samples, OF_MANY * samples as f32)),
        }
    }

    /// irradiance / π at a point with unit normal `n`, light by light added up, from `factor` times the samples.
    pub(crate) fn estimate<V: Value>(
        &self,
        world: &World,
        (point, n): (Vec3, Vec3),
        factor: u32,
        draws: &mut Draws,
        rays: &mut u64,
    ) -> V {
        let mut sum = match self.of_many {
            Some(of_many) => estimate_many(world, (point, n), of_many, factor, draws, rays),
            None => V::default(),
        };
        for (emitter, &count) in world.emitters.all().zip(&self.samples) {
            // Of many, those that have a place are done.
            if self.of_many.is_some() && emitter.sphere().is_some() {
                continue;
            }
            if count == 0 || emitter.is_below_horizon(point, n) {
                continue;
            }
            let count = if emitter.is_delta() { count } else { count * factor };
            let sequence = draws.sequence(count);
            let mut light = Vec3::ZERO;
            for k in 0..count {
                light += visible_light(emitter, &world.trees, point, n, sequence.get(k), rays);
            }
            sum.add_to_layer(emitter.layer, light / count as f32);
        }
        sum.thinned()
    }
}

/// As [`DirectLight::estimate`], of many lights that have a place: each gets samples by what it could bring there, and
/// one that is to have less than one gets one as often as that says.
fn estimate_many<V: Value>(
    world: &World,
    (point, n): (Vec3, Vec3),
    (most, all): (u32, f32),
    factor: u32,
    draws: &mut Draws,
    rays: &mut u64,
) -> V {
    let list = || world.emitters.list.iter().filter(|emitter| emitter.sphere().is_some());
    let total: f32 = list().map(|emitter| emitter.weight_at(point, n)).sum();
    let mut sum = V::default();
    for emitter in list() {
        let weight = emitter.weight_at(point, n);
        if weight <= 0.0 {
            continue;
        }
        let wanted = all * factor as f32 * (weight / total);
        let light = if wanted < 1.0 {
            if draws.own.next_f32() >= wanted {
                continue;
            }
            visible_light(emitter, &world.trees, point, n, draws.own.next_2d(), rays) / wanted
        } else {
            let count = if emitter.is_delta() { 1 } else { (wanted.round() as u32).clamp(1, most * factor) };
            let sequence = draws.sequence(count);
            let light = |k| visible_light(emitter, &world.trees, point, n, sequence.get(k), rays);
            (0..count).map(light).sum::<Vec3>() / count as f32
        };
        sum.add_to_layer(emitter.layer, light);
    }
    sum
}

/// One sample of one light that is aimed at, for a vertex of a path. What comes evenly from outside the path finds itself.
#[inline]
pub(crate) fn one_light<V: Value>(world: &World, point: Vec3, n: Vec3, rng: &mut Pcg32, rays: &mut u64) -> V {
    let Some((index, probability)) = world.emitters.choose(point, n, rng.next_f32()) else { return V::default() };
    let emitter = &world.emitters.list[index];
    let light = visible_light(emitter, &world.trees, point, n, rng.next_2d(), rays);
    V::of_layer(emitter.layer, light / probability)
}

/// Direct light of many elements, from `samples` each, times its effort.
pub(crate) fn direct_of<V: Value>(
    world: &World,
    slots: &[u32],
    samples: u32,
    effort: &Effort,
    seed: u64,
    work: &Work,
) -> Result<Vec<V>, Canceled> {
    let direct = direct_at(world, samples, effort, PartSeed::whole(seed));
    work.map(slots, |_, slot, rays| direct(slot, rays))
}

/// Direct light of an element: for [`Work::add`], which writes it into a map.
pub(crate) fn direct_at<'a, V: Value>(
    world: &'a World,
    samples: u32,
    effort: &'a Effort,
    seed: PartSeed,
) -> impl Fn(u32, &mut u64) -> V + Sync + 'a {
    let direct = DirectLight::new(world, samples);
    let seed = seed.of(0xd1);
    move |slot, rays| {
        let (from, factor) = (world.ray_origin(slot as usize), effort.factor(slot));
        direct.estimate(world, from, factor, &mut seed.draws(slot.into()), rays)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::metrics::Family;
    use crate::scene::{Light, LightKind, Material, Mesh, Object, Scene};
    use crate::world::WorldOptions;

    /// A floor below 49 lamps, and a sun that shines on its back, far stronger than they.
    fn hall() -> World {
        let floor = Mesh::quad(Vec3::ZERO, Vec3::Z * 14.0, Vec3::X * 14.0);
        let mut scene = Scene::from_objects(vec![Object::new("floor", floor, Material::diffuse(Vec3::ONE))]);
        let light = |name: String, kind: LightKind, intensity: f32| Light { name, kind, color: Vec3::ONE, intensity };
        for k in 0..49 {
            let position = DVec3::new(1.0 + 2.0 * f64::from(k % 7), 2.5, 1.0 + 2.0 * f64::from(k / 7));
            let kind = LightKind::Point { position, range: None };
            scene.lights.push(light(format!("lamp {k}"), kind, 100.0));
        }
        scene.lights.push(light("sun".into(), LightKind::Directional { direction: Vec3::Y, angle: 0.0 }, 1e5));
        World::new(scene, &WorldOptions { spacing: Some(1.0), ..WorldOptions::default() }).expect("a hall")
    }

    /// The light of each lamp is known exactly, and what comes from afar takes no samples from them.
    #[test]
    fn many_lamps_are_added_up_by_chance_and_a_sun_does_not_matter() {
        const RUNS: u64 = 400;
        let (world, mut rays) = (hall(), 0);
        let direct = DirectLight::new(&world, 16);
        let mut family = Family::of_freedom((RUNS - 1) as f64);
        for slot in world.computed_slots().into_iter().step_by(13) {
            let from @ (point, n) = world.ray_origin(slot as usize);
            let mut light = |emitter| f64::from(visible_light(emitter, &world.trees, point, n, [0.5; 2], &mut rays).x);
            let exact: f64 = world.emitters.list.iter().map(&mut light).sum();
            let found: Vec<f64> = (0..RUNS)
                .map(|seed| {
                    let draws = &mut PartSeed::whole(seed).draws(slot.into());
                    f64::from(direct.estimate::<Vec3>(&world, from, 1, draws, &mut rays).x)
                })
                .collect();
            let mean = found.iter().sum::<f64>() / RUNS as f64;
            let variance = found.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (RUNS - 1) as f64;
            family.compare(format!("slot {slot}"), mean - exact, (variance / RUNS as f64).sqrt());
            assert!(variance.sqrt() < 0.15 * exact, "slot {slot}: {} of {exact}", variance.sqrt());
        }
        family.assert_agrees();
    }
}
