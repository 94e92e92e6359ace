//! Light at points of a client's choice, which need not lie on a surface: direct light from rays to the lights, indirect
//! light by one gather over what a light map holds.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use crate::batches::{BATCHES, mean_of, shares};
use crate::job::{Canceled, Observer};
use crate::lightmap::{LightMap, LightPart};
use crate::random::{Draws, PartSeed, subseed};
use crate::sampling::cosine_hemisphere;
use crate::space::ray_offset;
use crate::transport::{DirectLight, Field, Rough};
use crate::world::World;

/// Points are taken off as elements of triangles of this extent are, metres: nothing tells what they are on.
const EXTENT: f32 = 1.0;

/// Which light, and from how many samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PointOptions {
    /// Which light.
    pub part: LightPart,
    /// Samples per point: paths that are gathered, and rays to each light. At least two are taken.
    pub samples: u32,
    /// Seed of the random numbers.
    pub seed: u64,
}

/// Light at one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointLight {
    /// irradiance / π on a surface there, linear RGB, never negative: what a light map holds.
    pub light: Vec3,
    /// Standard error of `light`, mean over RGB, from the scatter of its samples: paths that land on other elements meet
    /// other noise of the map. What all of the map has wrong alike is not in it.
    pub error: f32,
    /// Rays that were traced for it.
    pub rays: u64,
}

/// Light that a small surface at each point (world space, metres) would get on the side of its unit normal. The same inputs and
/// seed give the same bits on any number of threads.
///
/// # Errors
/// [`Canceled`] where the observer says so; it is asked once per point.
///
/// # Panics
/// Where the map has not one value per slot of the world.
pub fn light_at(
    world: &World,
    map: &LightMap,
    points: &[(DVec3, Vec3)],
    options: &PointOptions,
    observer: &dyn Observer,
) -> Result<Vec<PointLight>, Canceled> {
    assert_eq!(map.len(), world.slots(), "a light map has one value per slot");
    let gathers = options.part != LightPart::Direct;
    let total: Vec<Vec3> = (0..map.len()).filter(|_| gathers).map(|slot| map.total(slot)).collect();
    let rough = if gathers {
        Rough::new(world, |slot| map.light.direct[slot as usize].element_sum())
    } else {
        Rough::default()
    };
    let field = Field { total: &total, indirect: &map.light.indirect, rough: &rough };
    let samples = options.samples.max(2);
    let shares = shares(samples);
    let one = |(index, (point, n)): (usize, &(DVec3, Vec3))| {
        if observer.canceled() {
            return Err(Canceled);
        }
        let point = (*point - world.scene.origin).as_vec3();
        let from = (point + *n * ray_offset(point, EXTENT), *n);
        let mut rays = 0;
        let part = |k: usize| match shares[k] {
            0 => (0, Vec3::ZERO),
            count => {
                let mut draws = PartSeed::whole(subseed(options.seed, k as u64)).draws(index as u64);
                (count, estimate(world, &field, from, (options.part, count), &mut draws, &mut rays))
            }
        };
        let (mean, error) = mean_of(&std::array::from_fn::<_, BATCHES, _>(part));
        Ok(PointLight { light: mean.max(Vec3::ZERO), error, rays })
    };
    points.par_iter().enumerate().map(one).collect()
}

/// irradiance / π from so many samples.
fn estimate(
    world: &World,
    field: &Field<Vec3>,
    from: (Vec3, Vec3),
    (part, samples): (LightPart, u32),
    draws: &mut Draws,
    rays: &mut u64,
) -> Vec3 {
    let mut light = Vec3::ZERO;
    if part != LightPart::Indirect {
        light += DirectLight::new(world, samples).estimate::<Vec3>(world, from, 1, draws, rays);
    }
    if part == LightPart::Direct {
        return light;
    }
    let (source, sequence) = (field.source(world, None), draws.sequence(samples));
    let rng = &mut draws.own;
    let mut gathered = Vec3::ZERO;
    for k in 0..samples {
        let direction = cosine_hemisphere(from.1, sequence.get(k));
        let (_, landed) = source.along(world, u32::MAX, from, direction, 0.0, rng, rays, &mut gathered);
        source.add_landed(landed.as_ref(), rng, rays, &mut gathered);
    }
    light + gathered / samples as f32
}

#[cfg(test)]
mod tests {
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

    fn at(world: &World, map: &LightMap, points: &[(DVec3, Vec3)], part: LightPart) -> Vec<PointLight> {
        let options = PointOptions { part, samples: 256, seed: 3 };
        light_at(world, map, points, &options, &Unobserved).expect("light")
    }

    /// A lamp in empty space: I cos / (π r²), exactly.
    #[test]
    fn a_lamp_lights_points_in_space_as_it_should() {
        let floor = Object::new("floor", Mesh::quad(Vec3::Y * -9.0, Vec3::Z, Vec3::X), Material::diffuse(Vec3::ZERO));
        let world = world(vec![floor], Some(LightKind::Point { position: DVec3::new(0.0, 2.0, 0.0), range: None }));
        let map = LightMap::black(world.slots());
        let points = [(DVec3::ZERO, Vec3::Y), (DVec3::new(2.0, 0.0, 0.0), Vec3::Y), (DVec3::ZERO, -Vec3::Y)];
        let found = at(&world, &map, &points, LightPart::Full);
        for (point, expected) in found.iter().zip([3.0 / 4.0, 3.0 / 8.0 * 0.5_f32.sqrt(), 0.0]) {
            let expected = expected / std::f32::consts::PI;
            assert!((point.light.x - expected).abs() < 1e-5, "{point:?} {expected}");
            // But for the rounding of their mean, all samples are the same.
            assert!(point.error <= 1e-6 * point.light.x, "{point:?}");
        }
    }

    /// Constant light from outside: half of what there is, within what is stated.
    #[test]
    fn a_wall_hides_half_of_the_sky() {
        let wall = Mesh::quad(Vec3::new(0.0, -500.0, -500.0), Vec3::Y * 1000.0, Vec3::Z * 1000.0);
        let wall = Object::new("wall", wall, Material::diffuse(Vec3::ZERO));
        let mut scene = Scene::from_objects(vec![wall]);
        let kind = LightKind::Environment;
        scene.lights.push(Light { name: "sky".into(), kind, color: Vec3::ONE, intensity: 3.0 });
        let world = World::new(scene, &WorldOptions { spacing: Some(100.0), ..WorldOptions::default() }).unwrap();
        let points: Vec<_> = (0..64).map(|k| (DVec3::new(0.01, f64::from(k), 0.5), Vec3::Y)).collect();
        let found = at(&world, &LightMap::black(world.slots()), &points, LightPart::Direct);
        let off: f32 = found.iter().map(|point| point.light.x - 1.5).sum();
        let variance: f32 = found.iter().map(|point| point.error.powi(2)).sum();
        let mut family = Family::of_known_errors();
        family.compare("sum", off.into(), variance.sqrt().into());
        family.assert_agrees();
        assert!(found.iter().all(|point| point.error > 0.0));
    }

    /// At the places of elements it is the light map, within both errors.
    #[test]
    fn at_elements_it_is_the_light_map() {
        let room = Object::new(
            "room",
            Mesh::cuboid(Vec3::ZERO, Vec3::new(4.0, 3.0, 4.0)).inside_out(),
            Material::diffuse(Vec3::splat(0.6)),
        );
        let lamp = Mesh::quad(Vec3::new(1.5, 2.9, 1.5), Vec3::X, Vec3::Z);
        let lamp = Object::new("lamp", lamp, Material::emissive(Vec3::splat(5.0)));
        let world = world(vec![room, lamp], None);
        let budget = Budget { samples_per_element: 256, target_rmse: None };
        let map = bake(&world, &budget, 1, &Unobserved).expect("a map");
        let slots: Vec<usize> = (0..world.slots()).filter(|&slot| world.is_valid(slot)).step_by(5).collect();
        let place = |&slot: &usize| (world.positions()[slot].as_dvec3(), world.normals()[slot]);
        let points: Vec<_> = slots.iter().map(place).collect();
        let found = at(&world, &map, &points, LightPart::Full);
        let z = |(point, &slot): (&PointLight, &usize)| {
            let variance = point.error * point.error + map.light.variance[slot];
            f64::from((point.light - map.total(slot)).element_sum() / 3.0) / f64::from(variance).sqrt()
        };
        let mut squares: Vec<f64> =
            found.iter().zip(&slots).map(|pair| z(pair).powi(2)).filter(|z| z.is_finite()).collect();
        assert!(squares.len() > 100, "{}", squares.len());
        squares.sort_by(f64::total_cmp);
        // Of a normal distribution half is within 0.455; eight parts have seven degrees of freedom, which widens it a little.
        let median = squares[squares.len() / 2];
        assert!((0.2..0.9).contains(&median), "{median}");
        let light = |of: &dyn Fn(usize) -> f64| (0..slots.len()).map(of).sum::<f64>() / slots.len() as f64;
        let (a, b) = (light(&|k| f64::from(found[k].light.x)), light(&|k| f64::from(map.total(slots[k]).x)));
        assert!((a / b - 1.0).abs() < 0.01, "{a} {b}");
    }
}
