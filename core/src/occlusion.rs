//! Ambient occlusion: how open the surroundings of each element are.

use glam::Vec3;

use crate::batches::{mean_of, shares};
use crate::bvh::Ray;
use crate::job::{Canceled, Observer};
use crate::random::{Pcg32, R2, subseed};
use crate::sampling::cosine_hemisphere;
use crate::transport::Work;
use crate::world::World;

/// Part of the scene's radius that is looked at where nothing is asked for.
const DEFAULT_SHARE: f32 = 0.2;

/// How ambient occlusion is computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OcclusionOptions {
    /// What lies farther away hides nothing, metres; a fifth of the scene's radius where absent.
    pub distance: Option<f32>,
    /// Rays per element; at least two are taken.
    pub samples: u32,
    /// Seed of the random numbers.
    pub seed: u64,
}

/// How open the surroundings of each element are.
#[derive(Clone, Debug, PartialEq)]
pub struct Occlusion {
    /// What lies farther away was not looked at, metres.
    pub distance: f32,
    /// Per slot: share of the hemisphere above it, weighted by the cosine, in which nothing lies within the distance;
    /// from 0 to 1, three equal numbers. What lets light through counts as much as it does not, in the mean over RGB.
    /// Elements whose value is not computed have that of their neighbours; 0 in holes.
    pub open: Vec<Vec3>,
    /// Stated error: area-weighted RMSE as the scatter of the rays tells it.
    pub stated: f32,
}

/// Ambient occlusion of all elements of a world, from rays alone: light has no part in it. Sides of triangles make no
/// difference. The same inputs and seed give the same bits on any number of threads.
///
/// # Errors
/// [`Canceled`] where the observer says so.
pub fn ambient_occlusion(
    world: &World,
    options: &OcclusionOptions,
    observer: &dyn Observer,
) -> Result<Occlusion, Canceled> {
    let distance = options.distance.unwrap_or(DEFAULT_SHARE * world.emitters.scene_radius);
    let (slots, shares) = (world.computed_slots(), shares(options.samples.max(2)));
    let seed = subseed(options.seed, 0xa0);
    let one = |_, slot: u32, rays: &mut u64| {
        let from = world.ray_origin(slot as usize);
        let mut rng = Pcg32::new(seed, u64::from(slot));
        mean_of(&shares.map(|count| (count, open_share(world, from, distance, count, &mut rng, rays))))
    };
    let found = Work::new(observer).map(&slots, one)?;
    let mut open = vec![Vec3::ZERO; world.slots()];
    slots.iter().zip(&found).for_each(|(&slot, (mean, _))| open[slot as usize] = *mean);
    world.validity.fill(&mut open);
    let (sum, area) = slots.iter().zip(&found).fold((0.0, 0.0), |(sum, total), (&slot, (_, error))| {
        let area = f64::from(world.areas()[slot as usize]);
        (sum + area * f64::from(*error).powi(2), total + area)
    });
    let stated = if area > 0.0 { (sum / area).sqrt() as f32 } else { 0.0 };
    Ok(Occlusion { distance, open, stated })
}

/// Share of the rays that nothing stops, by what is left of light along them.
fn open_share(
    world: &World,
    (origin, n): (Vec3, Vec3),
    distance: f32,
    samples: u32,
    rng: &mut Pcg32,
    rays: &mut u64,
) -> Vec3 {
    let (sequence, mut left) = (R2::new(rng), 0.0);
    for k in 0..samples {
        *rays += 1;
        let direction = cosine_hemisphere(n, sequence.get(k));
        left += world.trees.transmittance(&Ray { origin, direction, t_min: 0.0, t_max: distance }).element_sum() / 3.0;
    }
    Vec3::splat(left / samples.max(1) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::Unobserved;
    use crate::metrics::Family;
    use crate::scene::{Material, Mesh, Object, Scene};
    use crate::world::WorldOptions;

    fn world(objects: Vec<Object>, spacing: f32) -> World {
        let options = WorldOptions { spacing: Some(spacing), ..WorldOptions::default() };
        World::new(Scene::from_objects(objects), &options).expect("a world")
    }

    fn object(name: &str, mesh: Mesh) -> Object {
        Object::new(name, mesh, Material::diffuse(Vec3::splat(0.5)))
    }

    fn computed(world: &World, distance: Option<f32>, samples: u32) -> Occlusion {
        ambient_occlusion(world, &OcclusionOptions { distance, samples, seed: 3 }, &Unobserved).expect("occlusion")
    }

    /// Slots of an object's front that are within a box.
    fn slots(world: &World, object: usize, within: impl Fn(Vec3) -> bool) -> Vec<usize> {
        let range = world.placed[object].placement.element_indices();
        range.filter(|&slot| within(world.positions()[slot])).collect()
    }

    /// Root of the mean squared difference between what was found and what is expected, over the stated error.
    fn over_stated(world: &World, found: &Occlusion, slots: &[usize], expected: impl Fn(Vec3) -> f32) -> f32 {
        let square = |&slot: &usize| (found.open[slot].x - expected(world.positions()[slot])).powi(2);
        (slots.iter().map(square).sum::<f32>() / slots.len() as f32).sqrt() / found.stated
    }

    /// Nothing above a plane.
    #[test]
    fn a_plane_is_open() {
        let world = world(vec![object("floor", Mesh::quad(Vec3::ZERO, Vec3::Z, Vec3::X))], 0.25);
        let found = computed(&world, None, 16);
        assert!(found.open.iter().all(|open| *open == Vec3::ONE) && found.stated == 0.0);
        assert!((found.distance / world.emitters.scene_radius - 0.2).abs() < 1e-6);
    }

    /// A floor at a wall that has no end: a ray that meets the wall within the distance is one whose horizontal reach
    /// towards it is at least `x`; of the cosine-weighted hemisphere that is the part of a unit disc beyond a chord at
    /// `x / distance`, where the wall is higher than the distance.
    #[test]
    fn a_corner_of_two_walls() {
        let floor = object("floor", Mesh::quad(Vec3::new(0.0, 0.0, -20.0), Vec3::Z * 40.0, Vec3::X * 4.0));
        let wall = object("wall", Mesh::quad(Vec3::new(0.0, 0.0, -20.0), Vec3::Y * 4.0, Vec3::Z * 40.0));
        let world = world(vec![floor, wall], 0.4);
        let found = computed(&world, Some(2.0), 256);
        // Far from the ends of both.
        let inner = slots(&world, 0, |p| p.z.abs() < 15.0 && p.x > 0.01 && p.x < 3.0);
        let expected = |p: Vec3| {
            let h = (p.x / 2.0).min(1.0);
            1.0 - (h.acos() - h * (1.0 - h * h).sqrt()) / std::f32::consts::PI
        };
        let ratio = over_stated(&world, &found, &inner, expected);
        assert!(inner.len() > 200 && found.stated > 0.0 && found.stated < 0.03, "{} {}", inner.len(), found.stated);
        assert!((0.3..1.4).contains(&ratio), "{ratio}");
        let mean = |f: &dyn Fn(usize) -> f32| inner.iter().map(|&slot| f(slot)).sum::<f32>() / inner.len() as f32;
        let off = mean(&|slot| found.open[slot].x) - mean(&|slot| expected(world.positions()[slot]));
        let mut family = Family::of_known_errors();
        family.compare("mean", off.into(), (found.stated / (inner.len() as f32).sqrt()).into());
        family.assert_agrees();
    }

    /// What a polygon hides is Lambert's sum over its edges; nothing beyond the distance.
    #[test]
    fn under_a_disc() {
        const SIDES: u32 = 96;
        let rim = |k: u32| {
            let (sin, cos) = (std::f32::consts::TAU * k as f32 / SIDES as f32).sin_cos();
            Vec3::new(cos, 0.5, sin)
        };
        let positions: Vec<Vec3> = (0..SIDES).map(rim).chain([Vec3::new(0.0, 0.5, 0.0)]).collect();
        let triangles: Vec<[u32; 3]> = (0..SIDES).map(|k| [k, (k + 1) % SIDES, SIDES]).collect();
        let quad = Mesh::quad(Vec3::new(-0.02, 0.0, -0.02), Vec3::Z * 0.04, Vec3::X * 0.04);
        let triangle_materials = vec![0; triangles.len()];
        let disc = Mesh { positions, triangles, triangle_materials, normals: Vec::new(), ..quad.clone() };
        let world = world(vec![object("floor", quad), object("disc", disc)], 0.02);
        let floor = slots(&world, 0, |_| true);
        let found = computed(&world, Some(5.0), 4096);
        let expected = |p: Vec3| {
            let edge = |k: u32| {
                let (a, b) = ((rim(k) - p).normalize(), (rim((k + 1) % SIDES) - p).normalize());
                a.angle_between(b) * a.cross(b).normalize().y
            };
            1.0 - ((0..SIDES).map(edge).sum::<f32>() / std::f32::consts::TAU).abs()
        };
        let off: f32 = floor.iter().map(|&slot| found.open[slot].x - expected(world.positions()[slot])).sum();
        assert!((expected(Vec3::ZERO) - 0.2).abs() < 1e-3 && found.stated < 0.01, "{}", found.stated);
        let mut family = Family::of_known_errors();
        family.compare("sum", off.into(), (found.stated * (floor.len() as f32).sqrt()).into());
        family.assert_agrees();
        let near = computed(&world, Some(0.4), 64);
        assert!(floor.iter().all(|&slot| near.open[slot] == Vec3::ONE), "the disc is farther away");
    }

    #[test]
    fn the_same_on_any_number_of_threads_and_canceled_when_nobody_waits() {
        struct Gone;
        impl Observer for Gone {
            fn canceled(&self) -> bool {
                true
            }
        }
        let world = world(vec![object("room", Mesh::cuboid(Vec3::ZERO, Vec3::ONE).inside_out())], 0.1);
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| computed(&world, Some(0.3), 20))
        };
        assert_eq!(on(1), on(3));
        let options = OcclusionOptions { distance: None, samples: 4, seed: 3 };
        assert!(ambient_occlusion(&world, &options, &Gone).is_err());
    }
}
