//! What is seen of a light map from a point in space.

use glam::Vec3;

use super::walk::{is_near, light_at, sky_at};
use super::{Field, Surfel};
use crate::bvh::Ray;
use crate::random::Pcg32;
use crate::sampling::cosine_hemisphere;
use crate::value::Value;
use crate::world::World;

/// Radiance along a ray.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Seen<V> {
    /// By a surface.
    pub reflected: V,
    /// The even part of the sky's.
    pub sky: V,
}

impl<V: Value> Field<'_, V> {
    /// Radiance along a ray from a point that need not lie on a surface: of what surfaces reflect, and of the even part
    /// of the sky. What lights that are aimed at send straight to the point is not in it. None where the ray meets the
    /// back of a surface that has none, or of one that bounds a solid: nobody looks from there.
    #[inline]
    pub(crate) fn seen(
        &self,
        world: &World,
        origin: Vec3,
        direction: Vec3,
        rng: &mut Pcg32,
        rays: &mut u64,
    ) -> Option<Seen<V>> {
        let ray = Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY };
        let mut left = Vec3::ONE;
        *rays += 1;
        let Some(hit) = world.trees.first_hit(&ray, &mut left) else {
            return Some(Seen { reflected: V::default(), sky: world.emitters.sky::<V>(direction) * left });
        };
        if hit.normal.dot(direction) > 0.0 && world.space.part(hit.triangle).solid {
            return None;
        }
        let surfel = Surfel::to_look_up(world, &ray, &hit, rays)?;
        let is_far = |footprint| !is_near(world, footprint, hit.t * hit.t);
        let light = match surfel.footprint.as_ref().is_some_and(is_far) {
            true => {
                let mut light = V::default();
                self.add_at(world, &surfel, false, Vec3::ONE, rng, rays, &mut light);
                light
            }
            false => self.sent_near(world, &surfel, rng, rays),
        };
        Some(Seen { reflected: light * (surfel.albedo * left), sky: V::default() })
    }

    /// irradiance / π of a surface that is not to be looked up: one sample of direct light, and one path.
    fn sent_near(&self, world: &World, surfel: &Surfel, rng: &mut Pcg32, rays: &mut u64) -> V {
        let mut light: V = light_at::<V>(world, surfel, rng, rays) + sky_at::<V>(world, surfel, rng, rays);
        let (from, source) = ((surfel.ray_origin(), surfel.normal), self.source(world, None));
        let direction = cosine_hemisphere(surfel.normal, rng.next_2d());
        let receiver = surfel.nearest_element();
        let (_, landed) = source.along(world, receiver, from, direction, 0.0, rng, rays, &mut light);
        source.add_landed(landed.as_ref(), rng, rays, &mut light);
        light
    }
}
