use std::f32::consts::PI;

use super::*;
use crate::bake::bake;
use crate::harmonics::{COSINE, basis};
use crate::job::{Budget, Unobserved};
use crate::lightmap::LightPart;
use crate::metrics::Family;
use crate::points::{PointOptions, light_at};
use crate::scene::{Light, LightKind, Material, Mesh, Object, Scene};
use crate::world::WorldOptions;

fn world(objects: Vec<Object>, lights: Vec<LightKind>) -> World {
    let mut scene = Scene::from_objects(objects);
    let light = |kind| Light { name: "light".into(), kind, color: Vec3::ONE, intensity: 3.0 };
    scene.lights.extend(lights.into_iter().map(light));
    World::new(scene, &WorldOptions { spacing: Some(0.25), ..WorldOptions::default() }).expect("a world")
}

/// A closed room of 4 × 3 × 4 m that reflects `albedo` and sends out `emission`.
fn room(albedo: f32, emission: f32) -> Object {
    let material = Material { emission: Vec3::splat(emission), ..Material::diffuse(Vec3::splat(albedo)) };
    Object::new("room", Mesh::cuboid(Vec3::ZERO, Vec3::new(4.0, 3.0, 4.0)).inside_out(), material)
}

fn at(world: &World, map: &LightMap, points: &[DVec3], seed: u64) -> Vec<Probe> {
    probes_at(world, map, points, &ProbeOptions { samples: 512, seed }, &Unobserved).expect("probes")
}

fn in_the_dark(world: &World, points: &[DVec3]) -> Vec<Probe> {
    at(world, &LightMap::black(world.slots()), points, 5)
}

fn baked(world: &World, samples: u32) -> std::sync::Arc<LightMap> {
    bake(world, &Budget { samples_per_element: samples, target_rmse: None }, 1, &Unobserved).expect("a map")
}

/// Places in the room's air.
fn places(count: u32) -> Vec<DVec3> {
    let place = |k: u32| DVec3::new(0.3, 0.2, 0.4) + DVec3::new(0.11, 0.085, 0.1) * f64::from(k % 32);
    (0..count).map(place).collect()
}

/// Asserts that the mean over many probes of each coefficient (band 0 and 1 at least) is `expected`, by their own
/// errors.
fn assert_mean(probes: &[Probe], expected: [f32; COEFFICIENTS]) {
    let mut family = Family::of_known_errors();
    for (k, expected) in expected.into_iter().enumerate() {
        let sum: f32 = probes.iter().map(|probe| probe.radiance.0[k].x - expected).sum();
        let variance: f32 = probes.iter().map(|probe| probe.error[k].powi(2)).sum();
        // What is left of rounding where all samples are the same.
        let rounding = 1e-4 * expected.abs() * probes.len() as f32;
        family.compare_within(format!("coefficient {k}"), sum.into(), variance.sqrt().into(), rounding.into());
    }
    family.assert_agrees();
}

/// Radiance that is equal from everywhere is √(4π) of it in the first coefficient, and nothing else.
#[test]
fn an_even_sky_is_its_first_coefficient() {
    let world = world(Vec::new(), vec![LightKind::Environment]);
    let probes = in_the_dark(&world, &places(32));
    let mut expected = [0.0; COEFFICIENTS];
    expected[0] = 3.0 * (4.0 * PI).sqrt();
    assert_mean(&probes, expected);
    assert!(probes.iter().all(|probe| probe.error[0] < 1e-4 && probe.error[3] > 0.0 && probe.validity == 1.0));
    // Band by band, irradiance / π is the radiance itself.
    assert!((probes[0].radiance.irradiance(Vec3::Y).x - 3.0).abs() < 0.1);
}

/// A black wall hides the sky on one side of it; see-through in no place, and what is behind it is its back.
#[test]
fn a_wall_leaves_half_of_the_sky() {
    let wall = Mesh::quad(Vec3::new(0.0, -5000.0, -5000.0), Vec3::Y * 10_000.0, Vec3::Z * 10_000.0);
    let mut scene = Scene::from_objects(vec![Object::new("wall", wall, Material::diffuse(Vec3::ZERO))]);
    scene.lights.push(Light { name: "sky".into(), kind: LightKind::Environment, color: Vec3::ONE, intensity: 3.0 });
    let world = World::new(scene, &WorldOptions { spacing: Some(1000.0), ..WorldOptions::default() }).unwrap();
    let probes = in_the_dark(&world, &places(32));
    // ∫ over x > 0: of band 1 only x is left, of band 2 nothing is.
    let mut expected = [0.0; COEFFICIENTS];
    expected[0] = 3.0 * PI.sqrt();
    expected[3] = 3.0 * (3.0 / (4.0 * PI)).sqrt() * PI;
    assert_mean(&probes, expected);
    assert!(probes.iter().all(|probe| probe.validity == 1.0));
    let behind = in_the_dark(&world, &[DVec3::new(-1.0, 0.0, 0.0)]);
    assert!((behind[0].validity - 0.5).abs() < 0.05, "{:?}", behind[0]);
}

/// In a closed room whose walls shine and reflect alike, radiance is E / (1 − ρ) in every direction, also right at a
/// wall.
#[test]
fn a_furnace_is_even() {
    let world = world(vec![room(0.5, 2.0)], Vec::new());
    let map = baked(&world, 256);
    let mut points = places(32);
    points.extend((0..8).map(|k| DVec3::new(0.5 + 0.3 * f64::from(k), 0.02, 1.0)));
    let probes = at(&world, &map, &points, 5);
    let mean: f32 = probes.iter().map(|probe| probe.radiance.0[0].x).sum::<f32>() / probes.len() as f32;
    // The map's own noise is common to all probes: its mean is within its error of 4.
    let expected = 4.0 * (4.0 * PI).sqrt();
    assert!((mean / expected - 1.0).abs() < 0.004, "{mean} {expected}");
    let mut family = Family::of_known_errors();
    for k in 1..COEFFICIENTS {
        let sum: f32 = probes.iter().map(|probe| probe.radiance.0[k].x).sum();
        let variance: f32 = probes.iter().map(|probe| probe.error[k].powi(2)).sum();
        family.compare(format!("coefficient {k}"), sum.into(), variance.sqrt().into());
    }
    family.assert_agrees();
}

/// Lamps without extent and the sun are exact: intensity / distance² times the basis in their direction.
#[test]
fn lamps_are_their_direction() {
    let lamp = LightKind::Point { position: DVec3::new(1.0, 2.0, -2.0), range: None };
    let sun = LightKind::Directional { direction: Vec3::new(0.6, -0.8, 0.0), angle: 0.0 };
    let world = world(Vec::new(), vec![lamp, sun]);
    // The second stands at the lamp's height.
    for point in [DVec3::ZERO, DVec3::new(0.0, 2.0, -1.0)] {
        let probe = in_the_dark(&world, &[point])[0];
        let to_lamp = (DVec3::new(1.0, 2.0, -2.0) - point).as_vec3();
        let lamp = Harmonics::of(to_lamp.normalize(), Vec3::splat(3.0 / to_lamp.length_squared()));
        let expected = lamp + Harmonics::of(Vec3::new(-0.6, 0.8, 0.0), Vec3::splat(3.0));
        let difference = (probe.radiance - expected).0;
        assert!(difference.iter().all(|c| c.abs().max_element() < 2e-5), "{probe:?} {expected:?}");
        assert!(probe.error.iter().all(|error| *error < 1e-5));
    }
}

/// A sun with a disc: a cone of even radiance E / (π sin²).
#[test]
fn a_disc_is_a_cone() {
    let angle = 1.0f32;
    let direction = Vec3::new(0.0, -0.6, 0.8);
    let world = world(Vec::new(), vec![LightKind::Directional { direction, angle }]);
    let probes = in_the_dark(&world, &places(32));
    let (sin, cos) = (angle / 2.0).sin_cos();
    let radiance = 3.0 / (PI * sin * sin);
    // Zonal coefficients about its axis (Y at the axis is √((2 l + 1) / 4π)): ∫ Pₗ over the cone.
    let bands = [1.0 - cos, sin * sin / 2.0, (cos - cos.powi(3)) / 2.0].map(|integral| radiance * 2.0 * PI * integral);
    let mut expected = basis(-direction);
    expected.iter_mut().zip([0, 1, 1, 1, 2, 2, 2, 2, 2]).for_each(|(y, band)| *y *= bands[band]);
    assert_mean(&probes, expected);
}

/// An emissive quad near by, against sums over a fine grid on it.
#[test]
fn a_lamp_near_by_is_its_integral() {
    let lamp = Mesh::quad(Vec3::new(1.0, -0.5, -0.5), Vec3::Z, Vec3::Y);
    let world = world(vec![Object::new("lamp", lamp, Material::emissive(Vec3::splat(5.0)))], Vec::new());
    let point = DVec3::new(0.2, 0.1, -0.3);
    const STEPS: usize = 300;
    let mut expected = Harmonics::default();
    for k in 0..STEPS * STEPS {
        let step = |k: usize| (k as f32 + 0.5) / STEPS as f32 - 0.5;
        let w = Vec3::new(1.0, step(k / STEPS), step(k % STEPS)) - point.as_vec3();
        let power = 5.0 * w.x.abs() / w.length().powi(3) / (STEPS * STEPS) as f32;
        expected += Harmonics::of(w.normalize(), Vec3::splat(power));
    }
    let probes: Vec<Probe> =
        (0..16).map(|seed| at(&world, &LightMap::black(world.slots()), &[point], seed)[0]).collect();
    assert_mean(&probes, expected.0.map(|c| c.x));
    assert!(probes[0].error[0] < 0.02 * probes[0].radiance.0[0].x, "aimed at: {:?}", probes[0]);
}

/// irradiance / π on small surfaces of all directions at a point, which `sample` answers from rays of its own, has the
/// probe's coefficients times 1, 2/3 and 1/4 (Funk and Hecke), whatever the light.
#[test]
fn surfaces_of_all_directions_have_the_same_light() {
    let lamp = Mesh::quad(Vec3::new(1.5, 2.9, 1.5), Vec3::X, Vec3::Z);
    let lamp = Object::new("lamp", lamp, Material::emissive(Vec3::splat(5.0)));
    let table = Object::new(
        "table",
        Mesh::cuboid(Vec3::new(0.5, 0.0, 0.5), Vec3::new(2.0, 0.8, 1.5)),
        Material::diffuse(Vec3::new(0.7, 0.2, 0.2)),
    );
    let world = world(vec![room(0.6, 0.0), lamp, table], vec![]);
    let map = baked(&world, 64);
    const NORMALS: usize = 512;
    let mut squares = 0.0;
    // In the air, and just above the table, where the map is not looked up.
    for point in [DVec3::new(3.0, 1.0, 1.0), DVec3::new(1.0, 0.9, 1.0)] {
        let probe = at(&world, &map, &[point], 3)[0];
        let mut rng = Pcg32::new(8, 1);
        let sequence = R2::new(&mut rng);
        let surfaces: Vec<(DVec3, Vec3)> =
            (0..NORMALS).map(|k| (point, uniform_sphere(sequence.get(k as u32)))).collect();
        let options = PointOptions { part: LightPart::Full, samples: 64, seed: 9 };
        let light = light_at(&world, &map, &surfaces, &options, &Unobserved).expect("light");
        for (k, band) in [0, 1, 1, 1, 2, 2, 2, 2, 2].into_iter().enumerate() {
            let term = |k: usize, i: usize| light[i].light.x * basis(surfaces[i].1)[k] * 4.0 * PI;
            let parts: Vec<f32> = (0..8)
                .map(|part| (0..NORMALS).skip(part).step_by(8).map(|i| term(k, i)).sum::<f32>() * 8.0 / NORMALS as f32)
                .collect();
            let mean = parts.iter().sum::<f32>() / 8.0;
            let variance = parts.iter().map(|p| (p - mean).powi(2)).sum::<f32>() / 56.0;
            let difference = mean - COSINE[band] * probe.radiance.0[k].x;
            let z2 = difference * difference / (variance + (COSINE[band] * probe.error[k]).powi(2));
            assert!(z2 < 36.0, "{point}, coefficient {k}: {difference}, z² {z2}");
            squares += z2;
        }
    }
    // Eighteen squares of z of about eight degrees of freedom: the mean of one is 8 / 6, its deviation about 2.7.
    assert!(squares / 18.0 < 3.0, "{squares}");
}

#[test]
fn inside_solids_nothing_is_valid_and_beside_them_all_is() {
    let cube = Mesh::cuboid(Vec3::splat(1.0), Vec3::splat(2.0));
    let cube = Object::new("cube", cube, Material::diffuse(Vec3::splat(0.5)).double_sided());
    let world = world(vec![room(0.6, 0.0), cube], vec![LightKind::Environment]);
    let probes = in_the_dark(&world, &[DVec3::splat(1.5), DVec3::new(3.0, 1.0, 3.0), DVec3::new(-9.0, 1.0, 1.0)]);
    assert_eq!((probes[0].validity, probes[0].radiance), (0.0, Harmonics::default()));
    assert_eq!(probes[1].validity, 1.0);
    // Outside of the room: some rays miss it.
    assert!(probes[2].validity > 0.8 && probes[2].validity < 1.0, "{:?}", probes[2]);
}

#[test]
fn the_same_on_any_number_of_threads() {
    let world = world(vec![room(0.6, 0.0)], vec![LightKind::Point { position: DVec3::splat(1.0), range: None }]);
    let map = baked(&world, 8);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| at(&world, &map, &places(20), 5))
    };
    let probes = on(1);
    assert_eq!(probes, on(3));
    // Seeds matter, and what differs by less than its error does not count as another light.
    let other = at(&world, &map, &places(20), 6);
    assert!(probes != other && !probes[0].differs_from(&probes[0]));
    let brighter = Probe { radiance: probes[0].radiance * 1.5, ..probes[0] };
    assert!(brighter.differs_from(&probes[0]));
}

#[test]
fn nobody_waits_for_it() {
    struct Gone;
    impl Observer for Gone {
        fn canceled(&self) -> bool {
            true
        }
    }
    let world = world(vec![room(0.6, 0.0)], Vec::new());
    let options = ProbeOptions { samples: 8, seed: 1 };
    assert!(probes_at(&world, &LightMap::black(world.slots()), &places(4), &options, &Gone).is_err());
}
