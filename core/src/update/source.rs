//! S: what rays of the elements that stay see of what came or went, less what they saw or see behind it. One ray serves
//! both signs.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3;

use super::extent::Extent;
use crate::bvh::{Bvh, Hit, Ray};
use crate::job::Canceled;
use crate::random::{Pcg32, R2, subseed};
use crate::rounds::Round;
use crate::sampling::{Mixture, Spheres};
use crate::solve::Subset;
use crate::transport::{Surfel, Value, Work};
use crate::world::{Transition, World};

/// From this part of the hemisphere on an element gets all samples; less coverage, less to know.
const FULL_COVERAGE: f32 = 0.15;

/// Elements within this many spacings of the boxes around what changed are near (design, section 3.8 a).
const NEAR_ZONE: f32 = 5.0;

/// Samples of a representative of far elements per sample of a near element.
const FAR_SAMPLES: u32 = 2;

/// Light maps (direct + indirect) to look up, in the slots of their worlds.
pub(super) struct Maps<'a, V> {
    pub before: &'a [V],
    pub after: &'a [V],
}

/// Rays towards the geometry of an edit.
pub(super) struct Source<'a> {
    transition: &'a Transition,
    spheres: Spheres,
}

impl<'a> Source<'a> {
    pub(super) fn new(transition: &'a Transition) -> Source<'a> {
        Source { transition, spheres: Spheres::new(&transition.changed_triangles()) }
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

    /// Adds S to `indirect` and the change of visible sky to `direct`, for all rows of `extent`.
    #[expect(clippy::too_many_arguments, reason = "the state of one pass, named once")]
    pub(super) fn estimate<V: Value>(
        &self,
        extent: &Extent,
        subset: &Subset,
        maps: &Maps<V>,
        round: &Round<V>,
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
        let (before, after) = (&self.transition.before.emitters, &self.transition.after.emitters);
        if before.environment != Vec3::ZERO || after.environment != Vec3::ZERO {
            extent.add(subset, &fine_sky, &far_sky, direct);
        }
        Ok(())
    }

    /// (change of visible sky, S) of some rows.
    fn gather<V: Value>(
        &self,
        rows: &[u32],
        maps: &Maps<V>,
        samples: u32,
        seed: u64,
        work: &Work,
    ) -> Result<(Vec<V>, Vec<V>), Canceled> {
        let full = samples as f32;
        let values = work.map(rows, |_, slot, rays| {
            let (point, n) = self.transition.after.ray_origin(slot as usize);
            let Some(mixture) = Mixture::new(&self.spheres, point, n) else { return (V::default(), V::default()) };
            let wanted = full * (mixture.coverage() / FULL_COVERAGE).min(1.0);
            let samples = (wanted.ceil() as u32).max(1);
            let mut rng = Pcg32::new(seed, u64::from(slot));
            let sequence = R2::new(&mut rng);
            let (mut sky, mut reflected) = (V::default(), V::default());
            for k in 0..samples {
                let direction = mixture.sample(sequence.get(k));
                let cos = n.dot(direction);
                if cos <= 0.0 {
                    continue;
                }
                let ray = Ray { origin: point, direction, t_min: 0.0, t_max: f32::INFINITY };
                if let Some((s, r)) = self.ray_change(&ray, maps, rays) {
                    let weight = cos * FRAC_1_PI / mixture.pdf(direction);
                    sky += s * weight;
                    reflected += r * weight;
                }
            }
            (sky / samples as f32, reflected / samples as f32)
        })?;
        Ok(values.into_iter().unzip())
    }

    /// Change of (sky radiance, reflected radiance) along a ray; none where both worlds look the same.
    fn ray_change<V: Value>(&self, ray: &Ray, maps: &Maps<V>, rays: &mut u64) -> Option<(V, V)> {
        let t = self.transition;
        let came = closest(t.come.as_deref(), ray, rays);
        let went = closest(t.gone.as_deref(), ray, rays);
        if came.is_none() && went.is_none() {
            return None;
        }
        *rays += 1;
        let behind = t.common.closest_hit(ray);
        let distance = |h: &Option<Hit>| h.map_or(f32::INFINITY, |h| h.t);
        let (came_t, went_t, behind_t) = (distance(&came), distance(&went), distance(&behind));
        if behind_t <= came_t && behind_t <= went_t {
            return None;
        }
        // The static surface as it was, in both worlds: repainted surfaces are a source of their own.
        let unchanged = |hit: &Option<Hit>, rays: &mut u64| look(&t.before, ray, hit.as_ref(), maps.before, rays);
        let after = if came_t < behind_t {
            look(&t.after, ray, came.as_ref(), maps.after, rays)
        } else {
            unchanged(&behind, rays)
        };
        let before = if went_t < behind_t { unchanged(&went, rays) } else { unchanged(&behind, rays) };
        let sky = |world: &World, hidden: bool| if hidden { V::default() } else { world.emitters.sky() };
        let free = behind.is_none();
        let sky = sky(&t.after, !free || came.is_some()) - sky(&t.after, !free || went.is_some());
        Some((sky, after - before))
    }
}

fn closest(tree: Option<&Bvh>, ray: &Ray, rays: &mut u64) -> Option<Hit> {
    tree.and_then(|t| {
        *rays += 1;
        t.closest_hit(ray, None)
    })
}

/// Reflected radiance of a hit in one of the worlds.
fn look<V: Value>(world: &World, ray: &Ray, hit: Option<&Hit>, map: &[V], rays: &mut u64) -> V {
    let Some(surfel) = hit.and_then(|h| Surfel::to_look_up(world, ray, h, rays)) else { return V::default() };
    surfel.elements.map_or(V::default(), |e| surfel.interpolate(e, map) * surfel.albedo)
}
