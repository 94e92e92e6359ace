//! The error of resolution while a map gets better: measured again and again, with a small part of the map's own rays.

use super::{LEAST_POINTS, ResolutionError, ResolutionOptions, resolution_error};
use crate::job::{Canceled, Observer};
use crate::lightmap::LightMap;
use crate::random::subseed;
use crate::world::World;

/// Part of a map's rays that are traced to measure it.
const SHARE: f64 = 0.015;

/// Samples per point: at first, and at most. With fewer their noise hides small errors, with more there are too few points
/// to meet the large ones.
const SAMPLES: u32 = 64;
const MOST_SAMPLES: u32 = 2048;

/// How far squared errors scatter from point to point, as a multiple of their mean: noise of samples that makes them
/// scatter as much is small enough.
const SCATTER: f64 = 3.0;

/// Most points at a time: at first, while nobody knows what a sample costs (there may be hundreds of lights), and then.
const FIRST_POINTS: f64 = 64.0;
const MOST_POINTS: f64 = 65_536.0;

/// Rays per sample where none has been traced yet: a path, and rays to lights at both of its ends.
const RAYS_PER_SAMPLE: f64 = 3.0;

/// Measures the error of resolution of a light map whose elements stay as they are while it gets better. Points of all
/// measurements count alike: what they find does not depend on the samples of the map, but for the noise of it.
#[derive(Clone, Debug, Default)]
pub struct Meter {
    error: Option<ResolutionError>,
    /// Rays that it has traced.
    spent: u64,
    /// Samples that it has taken.
    samples: u64,
    /// Maps whose error was stated.
    maps: u64,
}

impl Meter {
    /// Goes on from what is known of a map with the same elements and the same light, but for its noise.
    pub fn after(known: Option<ResolutionError>) -> Meter {
        Meter { error: known, ..Meter::default() }
    }

    /// Of a map before which so many have stated their error.
    pub fn after_maps(maps: u64) -> Meter {
        Meter { maps, ..Meter::default() }
    }

    /// Measures a map that states its error and that `rays` rays were traced for, by as many points as a small part of
    /// them is enough for. The first of them only guesses its noise, and is left out. The same calls give the same bits on
    /// any number of threads.
    ///
    /// # Errors
    /// [`Canceled`] where the observer says so: what was known is still good.
    ///
    /// # Panics
    /// Where the map has not one value per slot of the world.
    pub fn measure(
        &mut self,
        world: &World,
        map: &LightMap,
        rays: u64,
        seed: u64,
        observer: &dyn Observer,
    ) -> Result<(), Canceled> {
        self.maps += 1;
        if self.maps == 1 {
            return Ok(());
        }
        let left = SHARE * rays as f64 - self.spent as f64;
        let (per_sample, most) = match self.samples {
            0 => (RAYS_PER_SAMPLE, FIRST_POINTS),
            samples => (self.spent as f64 / samples as f64, MOST_POINTS),
        };
        let per_point = self.samples_per_point((left / per_sample) as u32 / (2 * LEAST_POINTS));
        // `as` saturates.
        let points = (left / (per_sample * f64::from(per_point))).min(most) as u32;
        if points < LEAST_POINTS {
            return Ok(());
        }
        let options = ResolutionOptions { points, samples: per_point, seed: subseed(seed, self.maps) };
        let Some(found) = resolution_error(world, map, &options, observer)? else { return Ok(()) };
        self.spent += found.rays;
        self.samples += u64::from(points) * u64::from(per_point);
        match &mut self.error {
            Some(known) if known.objects.len() == found.objects.len() => known.pool(&found),
            error => *error = Some(found),
        }
        Ok(())
    }

    /// How many samples a point is worth, of at most so many: as many as keep their noise below what the error itself
    /// scatters, as far as that is known.
    fn samples_per_point(&self, most: u32) -> u32 {
        let Some(ResolutionError { all, scatter, .. }) = &self.error else { return SAMPLES };
        // What is not told from noise is no larger than that.
        let square = all.mean().max(0.5 * all.standard_error());
        let variance = scatter / f64::from(all.points.max(1));
        let wanted = 2.0_f64.sqrt() * variance / (SCATTER * square);
        // `as` saturates, and makes nothing of what is no number.
        (wanted as u32).clamp(SAMPLES, MOST_SAMPLES.min(most).max(SAMPLES))
    }

    /// What is known by now.
    pub fn error(&self) -> Option<&ResolutionError> {
        self.error.as_ref()
    }

    /// Rays that were traced to measure, beside those of the map.
    pub fn rays(&self) -> u64 {
        self.spent
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex};

    use glam::{DVec3, Vec3};

    use super::*;
    use crate::bake::bake;
    use crate::job::{Budget, Progress, Snapshot, Unobserved};
    use crate::metrics::Family;
    use crate::resolution::error_against;
    use crate::scene::{Light, LightKind, Material, Mesh, Object, Scene};
    use crate::world::WorldOptions;

    const MANY: ResolutionOptions = ResolutionOptions { points: 6000, samples: 64, seed: 3 };

    /// These rooms have a few thousand elements. Of scenes of so many times as many rays as much is measured.
    const LARGER: u64 = 100;

    /// Measures while a map is baked, as a service does.
    struct Watch<'w> {
        world: &'w World,
        seen: Mutex<(Meter, u64)>,
    }

    impl Observer for Watch<'_> {
        fn snapshot(&self, map: &Arc<LightMap>, snapshot: Snapshot, progress: &Progress) {
            if let Snapshot::Complete { stated: Some(_) } = snapshot {
                let mut seen = self.seen.lock().expect("nobody panics with it");
                seen.0.measure(self.world, map, LARGER * progress.rays, 9, &Unobserved).expect("nobody cancels");
                seen.1 = progress.rays;
            }
        }
    }

    fn grey(mesh: Mesh, name: &str) -> Object {
        Object::new(name, mesh, Material::diffuse(Vec3::splat(0.6)))
    }

    fn room() -> Object {
        grey(Mesh::cuboid(Vec3::ZERO, Vec3::new(3.0, 2.5, 3.0)).inside_out(), "room")
    }

    /// A room with a box on its floor, under a lamp of half a metre.
    fn under_a_lamp() -> Scene {
        let lamp = Mesh::quad(Vec3::new(1.2, 2.3, 1.2), Vec3::X * 0.5, Vec3::Z * 0.5);
        let lamp = Object::new("lamp", lamp, Material::emissive(Vec3::new(9.0, 8.0, 6.0)));
        let chest = grey(Mesh::cuboid(Vec3::new(0.6, 0.0, 1.0), Vec3::new(1.3, 0.8, 1.9)), "chest");
        Scene::from_objects(vec![room(), chest, lamp])
    }

    /// A room with a point of light beside a screen.
    fn beside_a_screen() -> Scene {
        let screen = Mesh::quad(Vec3::new(1.4, 0.3, 0.8), Vec3::Z * 1.4, Vec3::Y * 1.5);
        let screen = Object::new("screen", screen, Material::diffuse(Vec3::splat(0.5)).double_sided());
        let kind = LightKind::Point { position: DVec3::new(0.9, 1.6, 1.3), range: None };
        let lamp = Light { name: "lamp".into(), kind, color: Vec3::ONE, intensity: 6.0 };
        Scene::from_objects(vec![room(), screen]).with_light(lamp)
    }

    fn laid_out(scene: &Scene, spacing: f32) -> World {
        World::new(scene.clone(), &WorldOptions { spacing: Some(spacing), ..WorldOptions::default() }).expect("a world")
    }

    fn baked(world: &World, samples: u32, observer: &dyn Observer) -> Arc<LightMap> {
        bake(world, &Budget { samples_per_element: samples, target_rmse: None }, 4, observer).expect("nobody cancels")
    }

    /// In two rooms at three spacings: what is stated beside a bake is the error that many points of the same map show, and
    /// about that which a much finer map shows; the map has the bits that it has without.
    #[test]
    fn what_is_stated_beside_a_bake_is_the_error_that_a_finer_map_shows() {
        let mut family = Family::of_known_errors();
        for (name, scene) in [("under a lamp", under_a_lamp()), ("beside a screen", beside_a_screen())] {
            let fine = laid_out(&scene, 0.06);
            let exact = baked(&fine, 64, &Unobserved);
            let mut last = f32::INFINITY;
            for spacing in [0.5, 0.35, 0.22] {
                let world = laid_out(&scene, spacing);
                let watch = Watch { world: &world, seen: Mutex::default() };
                let map = baked(&world, 128, &watch);
                assert!(map == baked(&world, 128, &Unobserved), "{name}: nobody sees whether it was measured");
                let (meter, rays) = watch.seen.into_inner().expect("nobody panics with it");
                let share = meter.rays() as f64 / (rays * LARGER) as f64;
                assert!((0.01..0.02).contains(&share), "{share}");
                let found = meter.error().expect("enough rays");
                let many = |exact| error_against((&world, &map), exact, &MANY, &Unobserved).expect("nobody cancels");
                let [own, finer] =
                    [many((&world, &map)), many((&fine, &exact))].map(|error| error.expect("noise is known").all);
                let error = found.all.standard_error().hypot(own.standard_error());
                family.compare(format!("{name} {spacing}"), found.all.mean() - own.mean(), error);
                let (stated, truth) = (found.all.rmse().expect("it is told from noise"), finer.mean().sqrt() as f32);
                assert!((2.0 / 3.0..1.5).contains(&(stated / truth)), "{name} {spacing}: {stated} {truth}");
                assert!(stated < last, "{name} {spacing}: {stated} {last}");
                last = stated;
                let of_objects: u32 = found.objects.iter().map(|object| object.points).sum();
                assert_eq!(of_objects, found.all.points);
            }
        }
        family.assert_agrees();
    }

    #[test]
    fn few_rays_and_first_maps_tell_nothing_and_what_was_known_stays() {
        let world = laid_out(&under_a_lamp(), 0.5);
        let map = baked(&world, 16, &Unobserved);
        let mut meter = Meter::default();
        let mut measure = |rays| {
            meter.measure(&world, &map, rays, 1, &Unobserved).expect("nobody cancels");
            (meter.error().map(|error| error.all.points), meter.rays())
        };
        assert_eq!(measure(10_000_000), (None, 0), "its noise is a guess");
        assert_eq!(measure(100_000), (None, 0), "too few for a mean");
        let (first, _) = measure(3_000_000);
        assert!(first.is_some_and(|points| (32..=64).contains(&points)), "{first:?}");
        let (points, spent) = measure(3_000_000);
        assert!(points > first && (35_000..50_000).contains(&spent), "{points:?} {spent}");
        assert_eq!(measure(3_000_000), (points, spent), "no more rays for no more of them");
        let (more, all) = measure(6_000_000);
        assert!(more > points && all > spent && all < 120_000, "{more:?} {all}");
        let known = meter.error().cloned();
        assert_eq!(Meter::after(known.clone()).error(), known.as_ref());
        // Of the elements of another scene nothing is known.
        let other = laid_out(&beside_a_screen(), 0.5);
        let mut after = Meter::after(known);
        for _ in 0..2 {
            let map = baked(&other, 8, &Unobserved);
            after.measure(&other, &map, 3_000_000, 1, &Unobserved).expect("nobody cancels");
        }
        assert!(after.error().is_some_and(|error| error.objects.len() == 2 && Some(error.all.points) < more));
    }
}
