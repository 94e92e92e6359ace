//! Directional light maps: from where the light of each element comes, as the first band of spherical harmonics.
//! Gathered from a light map when it is asked for, by the rays and the estimator of direct light that probes have.

use std::f32::consts::{FRAC_1_PI, TAU};

use glam::Vec3;

use crate::batches::{BATCHES, mean_of, shares};
use crate::harmonics::{COSINE, basis};
use crate::job::{Canceled, Observer};
use crate::lightmap::{LightMap, LightPart};
use crate::random::{Pcg32, R2, subseed};
use crate::sampling::uniform_sphere;
use crate::transport::{DirectLight, Field, Rough, Work};
use crate::world::{World, arriving_on_side};

/// Of which light, and from how many samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DirectionalOptions {
    /// Which light.
    pub part: LightPart,
    /// Samples per element: rays over its hemisphere, and rays to each light. At least two are taken.
    pub samples: u32,
    /// Seed of the random numbers.
    pub seed: u64,
}

/// From where the light of each element comes.
#[derive(Clone, Debug, PartialEq)]
pub struct Directional {
    /// Per slot, the coefficients of the first band of the radiance that comes to the hemisphere above it, linear RGB:
    /// of *y*, *z* and *x*, in the basis of [`crate::harmonics`] and the axes of the scene. Elements whose value is not
    /// computed have those of their neighbours; 0 in holes.
    pub band: [Vec<Vec3>; 3],
    /// irradiance / π from the same rays, per slot: another estimate of what the light map holds.
    pub light: Vec<Vec3>,
    /// Stated error of the coefficients: area-weighted RMSE over all three and RGB, as the scatter of the samples tells
    /// it.
    pub stated: f32,
}

impl Directional {
    /// irradiance / π on a small surface at an element, with unit normal `bent` instead of the element's own, `n`: of
    /// light that the element has from the light map, and that turns with the normal as far as the first band tells. On
    /// the element's own normal it is the light map's.
    pub fn bent(&self, slot: usize, light: Vec3, n: Vec3, bent: Vec3) -> Vec3 {
        let (own, other) = (basis(n), basis(bent));
        let turned: Vec3 = (0..3).map(|k| self.band[k][slot] * (other[k + 1] - own[k + 1])).sum();
        (light + turned * COSINE[1]).max(Vec3::ZERO)
    }
}

/// Directional light of all elements of a world with this light map. The same inputs and seed give the same bits on any
/// number of threads.
///
/// # Errors
/// [`Canceled`] where the observer says so.
///
/// # Panics
/// Where the map has not one value per slot.
pub fn directional(
    world: &World,
    map: &LightMap,
    options: &DirectionalOptions,
    observer: &dyn Observer,
) -> Result<Directional, Canceled> {
    assert_eq!(map.len(), world.slots(), "a light map has one value per slot");
    let total: Vec<Vec3> = (0..map.len()).map(|slot| map.total(slot)).collect();
    let rough = Rough::new(world, |slot| map.light.direct[slot as usize].element_sum());
    let field = Field { total: &total, indirect: &map.light.indirect, rough: &rough };
    let (slots, shares) = (world.computed_slots(), shares(options.samples.max(2)));
    let lights = shares.map(|count| DirectLight::new(world, count));
    let seed = subseed(options.seed, 0xd1c);
    let one = |_, slot: u32, rays: &mut u64| {
        let from = world.ray_origin(slot as usize);
        let mut rng = Pcg32::new(seed, u64::from(slot));
        let part = |k: usize| match shares[k] {
            0 => [Vec3::ZERO; 4],
            count => estimate(world, (&field, &lights[k]), from, options.part, count, &mut rng, rays),
        };
        let parts: [[Vec3; 4]; BATCHES] = std::array::from_fn(part);
        std::array::from_fn(|k| mean_of(&std::array::from_fn::<_, BATCHES, _>(|part| (shares[part], parts[part][k]))))
    };
    let found: Vec<[(Vec3, f32); 4]> = Work::new(observer).map(&slots, one)?;
    let of = |k: usize| {
        let mut values = vec![Vec3::ZERO; world.slots()];
        slots.iter().zip(&found).for_each(|(&slot, found)| values[slot as usize] = found[k].0);
        world.validity.fill(&mut values);
        values
    };
    let (sum, area) = slots.iter().zip(&found).fold((0.0, 0.0), |(sum, total), (&slot, found)| {
        let area = f64::from(world.areas()[slot as usize]);
        (sum + area * found[..3].iter().map(|(_, error)| f64::from(*error).powi(2)).sum::<f64>() / 3.0, total + area)
    });
    let stated = if area > 0.0 { (sum / area).sqrt() as f32 } else { 0.0 };
    Ok(Directional { band: std::array::from_fn(of), light: of(3), stated })
}

/// Three coefficients, and irradiance / π.
fn estimate(
    world: &World,
    (field, lights): (&Field<Vec3>, &DirectLight),
    (point, n): (Vec3, Vec3),
    part: LightPart,
    samples: u32,
    rng: &mut Pcg32,
    rays: &mut u64,
) -> [Vec3; 4] {
    let mut sum = [Vec3::ZERO; 4];
    let mut add = |direction: Vec3, power: Vec3| {
        let y = basis(direction);
        (0..3).for_each(|k| sum[k] += power * y[k + 1]);
        sum[3] += power * (n.dot(direction).max(0.0) * FRAC_1_PI);
    };
    let sequence = R2::new(rng);
    for k in 0..samples {
        let direction = uniform_sphere(sequence.get(k));
        let direction = if direction.dot(n) < 0.0 { -direction } else { direction };
        let seen = field.seen(world, point, direction, rng, rays).unwrap_or_default();
        let light = match part {
            LightPart::Full => seen.reflected + seen.sky,
            LightPart::Direct => seen.sky,
            LightPart::Indirect => seen.reflected,
        };
        add(direction, light * (TAU / samples as f32));
    }
    if part != LightPart::Indirect {
        for (emitter, &count) in world.emitters.list.iter().zip(&lights.samples) {
            let sequence = R2::new(rng);
            for k in 0..count {
                let arriving = arriving_on_side(emitter, &world.trees, (point, n), sequence.get(k), rays);
                arriving.into_iter().for_each(|(direction, power)| add(direction, power / count as f32));
            }
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use std::f32::consts::PI;

    use glam::DVec3;

    use super::*;
    use crate::bake::bake;
    use crate::job::{Budget, Unobserved};
    use crate::metrics::Family;
    use crate::scene::{Light, LightKind, Material, Mesh, Object, Scene};
    use crate::world::WorldOptions;

    fn world(objects: Vec<Object>, light: Option<LightKind>) -> World {
        let mut scene = Scene::from_objects(objects);
        scene.lights.extend(light.map(|kind| Light { name: "l".into(), kind, color: Vec3::ONE, intensity: 3.0 }));
        World::new(scene, &WorldOptions { spacing: Some(0.25), ..WorldOptions::default() }).expect("a world")
    }

    /// Its normal is neither an axis nor a diagonal.
    fn slope(albedo: f32) -> Object {
        let mesh = Mesh::quad(Vec3::ZERO, Vec3::new(0.0, 0.4, 2.0), Vec3::new(2.0, 0.7, 0.0));
        Object::new("slope", mesh, Material::diffuse(Vec3::splat(albedo)))
    }

    fn gathered(world: &World, map: &LightMap, part: LightPart, samples: u32) -> Directional {
        directional(world, map, &DirectionalOptions { part, samples, seed: 4 }, &Unobserved).expect("directions")
    }

    /// One lamp without extent: I / d² times the basis in its direction, exactly, and light that turns half as much as
    /// it should.
    #[test]
    fn a_lamp_is_its_direction() {
        let lamp = DVec3::new(0.5, 2.0, 1.5);
        let world = world(vec![slope(0.0)], Some(LightKind::Point { position: lamp, range: None }));
        let found = gathered(&world, &LightMap::black(world.slots()), LightPart::Full, 4);
        for slot in 0..world.slots() {
            let w = (lamp - world.scene.origin).as_vec3() - world.positions()[slot];
            let (y, power) = (basis(w.normalize()), 3.0 / w.length_squared());
            let off = |k: usize| (found.band[k][slot] - Vec3::splat(power * y[k + 1])).abs().max_element();
            assert!((0..3).all(|k| off(k) < 2e-5 * power), "{slot}: {:?}", found.band.each_ref().map(|b| b[slot]));
            let n = world.normals()[slot];
            let light = power * n.dot(w.normalize()) / PI;
            assert!((found.light[slot].x - light).abs() < 1e-4 * light);
            let bent = found.bent(slot, Vec3::splat(light), n, w.normalize()).x;
            let half = light + 0.5 * power / PI * (1.0 - n.dot(w.normalize()));
            assert!((bent - half).abs() < 1e-4 * half && found.bent(slot, Vec3::ONE, n, n) == Vec3::ONE);
        }
        assert!(found.stated < 1e-5);
        let indirect = gathered(&world, &LightMap::black(world.slots()), LightPart::Indirect, 4);
        assert!(indirect.band.iter().flatten().all(|c| *c == Vec3::ZERO), "a lamp alone is direct light");
    }

    /// Radiance that is equal from everywhere above has a first band of √(3 / 4π) π times the normal.
    #[test]
    fn an_even_sky_comes_from_the_normal() {
        let world = world(vec![slope(0.0)], Some(LightKind::Environment));
        let found = gathered(&world, &LightMap::black(world.slots()), LightPart::Full, 256);
        let n = world.normals()[0];
        let slots = world.slots() as f32;
        let mut family = Family::of_known_errors();
        for (k, axis) in [n.y, n.z, n.x].into_iter().enumerate() {
            let expected = 3.0 * (3.0 / (4.0 * PI)).sqrt() * PI * axis;
            let off = found.band[k].iter().map(|c| c.x - expected).sum::<f32>() / slots;
            family.compare(format!("coefficient {k}"), off.into(), (found.stated / slots.sqrt()).into());
        }
        family.assert_agrees();
        assert!(found.stated > 0.0 && found.stated < 0.2, "{}", found.stated);
    }

    /// What the same rays tell of the light itself is the light map, within both errors.
    #[test]
    fn its_light_is_that_of_the_map() {
        let room = Mesh::cuboid(Vec3::ZERO, Vec3::new(4.0, 3.0, 4.0)).inside_out();
        let lamp = Mesh::quad(Vec3::new(1.5, 2.9, 1.5), Vec3::X, Vec3::Z);
        let lamp = Object::new("lamp", lamp, Material::emissive(Vec3::splat(5.0)));
        let world = world(vec![Object::new("room", room, Material::diffuse(Vec3::splat(0.6))), lamp], None);
        let budget = Budget { samples_per_element: 128, target_rmse: None };
        let map = bake(&world, &budget, 1, &Unobserved).expect("a map");
        let mut family = Family::of_known_errors();
        for (part, values) in [(LightPart::Full, None), (LightPart::Indirect, Some(&map.light.indirect))] {
            let found = gathered(&world, &map, part, 64);
            let other = directional(&world, &map, &DirectionalOptions { part, samples: 64, seed: 9 }, &Unobserved);
            let other = other.expect("directions");
            let slots: Vec<usize> = (0..world.slots()).filter(|&slot| world.is_valid(slot)).collect();
            let expected = |slot: usize| values.map_or(map.total(slot), |values| values[slot]).x;
            let (mut off, mut variance, mut light) = (0.0, 0.0, 0.0);
            for &slot in &slots {
                let (a, b) = (found.light[slot].x, other.light[slot].x);
                off += f64::from(0.5 * (a + b) - expected(slot));
                // Two estimates of independent rays: a quarter of their squared difference is the variance of their
                // mean.
                variance += f64::from((a - b).powi(2)) / 4.0 + f64::from(map.light.variance[slot]);
                light += f64::from(expected(slot));
            }
            family.compare_within(format!("{part:?}"), off, variance.sqrt(), 0.002 * light);
            assert!(slots.len() > 500 && variance.sqrt() < 0.01 * light, "{} {variance} {light}", slots.len());
        }
        family.assert_agrees();
    }

    #[test]
    fn the_same_on_any_number_of_threads_and_canceled_when_nobody_waits() {
        struct Gone;
        impl Observer for Gone {
            fn canceled(&self) -> bool {
                true
            }
        }
        let world = world(vec![slope(0.5)], Some(LightKind::Environment));
        let map = LightMap::black(world.slots());
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| gathered(&world, &map, LightPart::Full, 11))
        };
        assert_eq!(on(1), on(3));
        let options = DirectionalOptions { part: LightPart::Full, samples: 4, seed: 3 };
        assert!(directional(&world, &map, &options, &Gone).is_err());
    }
}
