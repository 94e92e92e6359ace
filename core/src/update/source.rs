//! S: what rays of the unchanged elements see of what was inserted or removed, less what they saw or see behind it. One
//! ray serves both signs.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;

use super::extent::Extent;
use crate::bvh::{Hit, Ray};
use crate::job::Canceled;
use crate::random::{Pcg32, R2, subseed};
use crate::rounds::Round;
use crate::sampling::{Mixture, Spheres};
use crate::solve::Subset;
use crate::transport::{Spots, Surfel, Work};
use crate::value::Value;
use crate::world::{Transition, Trees, World};

/// From this part of the hemisphere on an element gets all samples; less coverage, less to know.
const FULL_COVERAGE: f32 = 0.15;

/// Samples, over those of others, of elements inside a sphere around a part of what changed or next to it: few they
/// are, and half of all noise is theirs.
const CLOSE_SAMPLES: f32 = 4.0;

/// Elements within this many spacings of the boxes around what changed are near: there every
/// one gathers, and farther away representatives do.
const NEAR_ZONE: f32 = 5.0;

/// Samples of a representative of far elements per sample of a near element.
const FAR_SAMPLES: u32 = 2;

/// Rays for each one that is aimed at a bright spot.
const SAMPLES_PER_AIM: u32 = 2;

/// Light maps (direct + indirect) to look up, in the slots of their worlds.
pub(super) struct Maps<'a, V> {
    pub before: &'a [V],
    pub after: &'a [V],
    /// Where much of that light is.
    pub spots: Option<&'a Spots>,
}

/// What changes along a ray.
struct RayChange<V> {
    /// Radiance of the sky.
    sky: V,
    /// Reflected radiance.
    reflected: V,
    /// Surfaces of the new world that are seen in one of both worlds, and their cells.
    seen: [Option<(Hit, u32)>; 2],
}

/// Rays towards the geometry of an edit.
pub(super) struct SourceTerm<'a> {
    transition: &'a Transition,
    spheres: Spheres,
}

impl<'a> SourceTerm<'a> {
    pub(super) fn new(transition: &'a Transition) -> SourceTerm<'a> {
        SourceTerm { transition, spheres: Spheres::new(&transition.changed_triangles()) }
    }

    /// Where S is not smooth: near the geometry that changed.
    pub(super) fn is_near(&self) -> impl Fn(u32) -> bool {
        let world = &self.transition.after;
        let boxes = self.transition.changed_bounds();
        let reach = NEAR_ZONE * world.resolution.smooth;
        move |slot| {
            let p = world.positions()[slot as usize];
            boxes.iter().any(|(low, high)| (p.clamp(*low, *high) - p).length_squared() < reach * reach)
        }
    }

    /// Adds S to `indirect` and the change of visible sky to `direct`, for all slots of `extent`.
    #[expect(clippy::too_many_arguments, reason = "the state of one pass, named once")]
    pub(super) fn estimate<V: Value>(
        &self,
        extent: &Extent,
        subset: &Subset,
        maps: &Maps<V>,
        round: &Round,
        work: &Work,
        direct: &mut [V],
        indirect: &mut [V],
    ) -> Result<(), Canceled> {
        if !self.transition.moves_geometry() {
            return Ok(());
        }
        let seed = subseed(round.seed, 0x50c);
        let (fine_sky, fine) = self.gather(&extent.fine, maps, round.samples, seed, work)?;
        let samples = round.samples * FAR_SAMPLES;
        let (far_sky, far) = self.gather(&extent.representatives, maps, samples, seed, work)?;
        extent.add(subset, &fine, &far, indirect);
        if self.has_sky() {
            extent.add(subset, &fine_sky, &far_sky, direct);
        }
        Ok(())
    }

    fn has_sky(&self) -> bool {
        let Transition { before, after, .. } = self.transition;
        before.emitters.has_sky() || after.emitters.has_sky()
    }

    /// (change of visible sky, S) of some slots; without a sky nothing for it.
    fn gather<V: Value>(
        &self,
        slots: &[u32],
        maps: &Maps<V>,
        samples: u32,
        seed: u64,
        work: &Work,
    ) -> Result<(Vec<V>, Vec<V>), Canceled> {
        let full = samples as f32;
        let world = &self.transition.after;
        let change = |slot: u32, rays: &mut u64| {
            let from @ (point, n) = world.ray_origin(slot as usize);
            let Some(mixture) = Mixture::new(&self.spheres, point, n) else { return (V::default(), V::default()) };
            let wanted =
                full * if mixture.is_close() { CLOSE_SAMPLES } else { (mixture.coverage() / FULL_COVERAGE).min(1.0) };
            let samples = (wanted.ceil() as u32).max(1);
            let mut rng = Pcg32::new(seed, u64::from(slot));
            let sequence = R2::new(&mut rng);
            let aims = if maps.spots.is_some() { samples.div_ceil(SAMPLES_PER_AIM) } else { 0 };
            let ratio = aims as f32 / samples as f32;
            let (mut sky, mut reflected) = (V::default(), V::default());
            let mut add = |direction: Vec3, target: Option<u32>, rays: &mut u64| {
                let (cos, pdf) = (n.dot(direction), mixture.pdf(direction));
                if cos <= 0.0 || pdf <= 0.0 {
                    return;
                }
                let ray = Ray { origin: point, direction, t_min: 0.0, t_max: f32::INFINITY };
                let Some(change) = self.ray_change(&ray, maps, rays) else { return };
                if target.is_some_and(|target| !change.seen.iter().flatten().any(|(_, cell)| *cell == target)) {
                    return;
                }
                let density = maps.spots.map_or(0.0, |spots| {
                    change.seen.iter().flatten().map(|(hit, cell)| spots.towards(direction, hit, *cell)).sum::<f32>()
                });
                let weight = cos * FRAC_1_PI / (pdf + ratio * density);
                sky += change.sky * weight;
                reflected += change.reflected * weight;
            };
            for k in 0..samples {
                add(mixture.sample(sequence.get(k)), None, rays);
            }
            let sequence = R2::new(&mut rng);
            for k in 0..aims {
                if let Some((direction, target)) = maps.spots.and_then(|spots| spots.aim(from, sequence.get(k))) {
                    add(direction, Some(target), rays);
                }
            }
            (sky / samples as f32, reflected / samples as f32)
        };
        if self.has_sky() {
            return Ok(work.map(slots, |_, slot, rays| change(slot, rays))?.into_iter().unzip());
        }
        Ok((Vec::new(), work.map(slots, |_, slot, rays| change(slot, rays).1)?))
    }

    /// What changes along a ray; none where both worlds look the same.
    fn ray_change<V: Value>(&self, ray: &Ray, maps: &Maps<V>, rays: &mut u64) -> Option<RayChange<V>> {
        let t = self.transition;
        let inserted = closest(t.inserted.as_ref(), ray, rays);
        let removed = closest(t.removed.as_ref(), ray, rays);
        let tint = |trees: Option<&Trees>, t: f32| trees.map_or(Vec3::ONE, |trees| trees.tint(ray, t));
        let of_changed = |t_after, t_before| (tint(t.inserted.as_ref(), t_after), tint(t.removed.as_ref(), t_before));
        if inserted.is_none() && removed.is_none() && of_changed(f32::INFINITY, f32::INFINITY) == (Vec3::ONE, Vec3::ONE)
        {
            return None;
        }
        *rays += 1;
        let behind = t.common.closest_hit(ray);
        let distance = |h: &Option<Hit>| h.map_or(f32::INFINITY, |h| h.t);
        let (inserted_t, removed_t, behind_t) = (distance(&inserted), distance(&removed), distance(&behind));
        // How far light comes in each world, and what tinted surfaces on the way leave of it.
        let (after_t, before_t) = (inserted_t.min(behind_t), removed_t.min(behind_t));
        let (left_after, left_before) = of_changed(after_t, before_t);
        if behind_t <= inserted_t && behind_t <= removed_t && left_after == left_before {
            return None;
        }
        let left_after = left_after * t.common.tint(ray, after_t);
        let left_before = left_before * t.common.tint(ray, before_t);
        // The static surface as it was, in both worlds: repainted surfaces are a source of their own.
        let unchanged = |hit: &Option<Hit>, rays: &mut u64| look(&t.before, ray, hit.as_ref(), maps.before, rays);
        let after = if inserted_t < behind_t {
            look(&t.after, ray, inserted.as_ref(), maps.after, rays)
        } else {
            unchanged(&behind, rays)
        };
        let before = if removed_t < behind_t { unchanged(&removed, rays) } else { unchanged(&behind, rays) };
        let of_sky = t.after.emitters.sky::<V>(ray.direction);
        let sky = |hidden: bool, left: Vec3| if hidden { V::default() } else { of_sky * left };
        let free = behind.is_none();
        let sky = sky(!free || inserted.is_some(), left_after) - sky(!free || removed.is_some(), left_before);
        // Cells are asked for where they are aimed at, and nowhere else.
        let cell = |hit: Hit| {
            let part = t.after.space.part(hit.triangle);
            let back = hit.normal.dot(ray.direction) > 0.0;
            (hit, t.after.space.spot(&hit, part, back).cell)
        };
        let seen = match maps.spots {
            Some(_) => [inserted.filter(|_| inserted_t < behind_t), behind].map(|hit| hit.map(cell)),
            None => [None; 2],
        };
        Some(RayChange { sky, reflected: after * left_after - before * left_before, seen })
    }
}

fn closest(trees: Option<&Trees>, ray: &Ray, rays: &mut u64) -> Option<Hit> {
    trees.and_then(|trees| {
        *rays += 1;
        trees.closest_hit(ray)
    })
}

/// Reflected radiance of a hit in one of the worlds. Where no element there is a place of its own, such as below what
/// is taken away, it is what they have of their neighbours: their own light counts by how it differs from that.
fn look<V: Value>(world: &World, ray: &Ray, hit: Option<&Hit>, map: &[V], rays: &mut u64) -> V {
    let Some(surfel) = hit.and_then(|h| Surfel::to_look_up(world, ray, h, rays)) else { return V::default() };
    let as_it_is = || if world.space.is_cut(surfel.cell) { Surfel::new(world, ray, hit?)?.footprint } else { None };
    let footprint = surfel.footprint.or_else(as_it_is);
    footprint.map_or(V::default(), |footprint| footprint.interpolate(map) * surfel.albedo)
}

#[cfg(test)]
mod tests {
    use glam::DMat4;

    use super::*;
    use crate::edit::Edit;
    use crate::job::Unobserved;
    use crate::metrics::Family;
    use crate::scene::{Material, Mesh, Object, Scene};
    use crate::world::WorldOptions;

    /// A box put into a closed room with a bright spot on one wall.
    fn insert() -> Transition {
        let white = Material::diffuse(Vec3::splat(0.5));
        let room = Object::new("room", Mesh::cuboid(Vec3::ZERO, Vec3::splat(2.0)).inside_out(), white);
        let options = WorldOptions { spacing: Some(0.2), ..WorldOptions::default() };
        let world = World::new(Scene::from_objects(vec![room]), &options).expect("a room");
        let boxed = Object::new("box", Mesh::cuboid(Vec3::new(0.8, 0.5, 0.8), Vec3::splat(1.2)), white);
        let asset = std::sync::Arc::new(Scene::from_objects(vec![boxed]));
        world.apply(&[Edit::Insert { asset, name: "box".into(), transform: DMat4::IDENTITY }]).expect("an insert")
    }

    /// Aimed rays change the noise of S and nothing else.
    #[test]
    fn what_hides_a_bright_spot_is_aimed_at() {
        const RUNS: u64 = 300;
        let transition = insert();
        let (before, after) = (&transition.before, &transition.after);
        let is_bright = |p: Vec3| p.x < 0.01 && p.distance(Vec3::new(0.0, 1.0, 1.0)) < 0.3;
        let light = |world: &World| -> Vec<Vec3> {
            let of = |p: &Vec3| Vec3::splat(if is_bright(*p) { 200.0 } else { 1.0 });
            world.positions().iter().map(of).collect()
        };
        let (old, new) = (light(before), light(after));
        let spots = Spots::of_map(after, &new, &[Vec3::ONE]);
        assert!(spots.is_some());
        let source = SourceTerm::new(&transition);
        // Where the box hides the spot, and some places where it does not.
        let faces_it = |slot: u32| after.positions()[slot as usize].x > 1.99;
        let slots: Vec<u32> = (0..before.slots() as u32).filter(|&s| faces_it(s) || s % 29 == 0).collect();
        let gathered = |spots: Option<&Spots>, samples: u32, seed: u64| {
            let maps = Maps { before: &old, after: &new, spots };
            let found = |run| source.gather(&slots, &maps, samples, subseed(seed, run), &Work::new(&Unobserved));
            let mut sums = vec![(0.0, 0.0); slots.len()];
            for run in 0..RUNS {
                for (sum, s) in sums.iter_mut().zip(found(run).expect("nobody cancels").1) {
                    let s = f64::from(s.x);
                    *sum = (sum.0 + s, sum.1 + s * s);
                }
            }
            let n = RUNS as f64;
            let mean = |(sum, squares): (f64, f64)| (sum / n, (squares - sum * sum / n).max(0.0) / (n * (n - 1.0)));
            sums.into_iter().map(mean).collect::<Vec<_>>()
        };
        let (with, without) = (gathered(spots.as_ref(), 8, 1), gathered(None, 12, 2));
        let (mut squares, mut count, mut noise) = (0.0, 0.0, [0.0; 2]);
        let mut family = Family::of_freedom((RUNS - 1) as f64);
        for ((slot, a), b) in slots.iter().zip(&with).zip(&without) {
            if a.1 + b.1 == 0.0 {
                assert!((a.0 - b.0).abs() < 1e-6, "slot {slot}: {a:?} and {b:?}");
                continue;
            }
            let z = (a.0 - b.0) / (a.1 + b.1).sqrt();
            family.compare(format!("slot {slot}"), z, 1.0);
            (squares, count, noise) = (squares + z * z, count + 1.0, [noise[0] + a.1, noise[1] + b.1]);
        }
        family.compare("all slots", squares / count - 1.0, f64::sqrt(2.0 / count));
        family.assert_agrees();
        assert!(count > 60.0, "{count}");
        // As many rays.
        assert!(noise[0] < 0.6 * noise[1], "{noise:?}");
    }
}
