//! `𝒪[L_e]`: the shadow of the object and the light it sends out itself, by area sampling of the lights (section 3.4).

use glam::Vec3;

use super::scenes::ObjectScene;
use rebake_core::bvh::Ray;
use rebake_core::random::{Pcg32, R2, subseed};
use rebake_core::transport::{DirectLight, Work};
use rebake_core::{Canceled, Emitter, visible_light};

impl ObjectScene<'_> {
    /// Change of direct light (irradiance / π) that the object makes at all elements of S. What comes
    /// evenly from outside is left to the object operator.
    pub(super) fn direct_change(&self, samples: u32, seed: u64, work: &Work) -> Result<Vec<Vec3>, Canceled> {
        let counts = DirectLight::new(self.with, samples);
        let emitters = self.with.emitters();
        let of_object: Vec<bool> = emitters.iter().map(|e| self.is_of_object(e)).collect();
        let seed = subseed(seed, 0xd1);
        work.map(&self.rows, |_, slot, rays| {
            let (point, n) = self.with.ray_origin(slot as usize);
            let mut rng = Pcg32::new(seed, u64::from(slot));
            let mut sum = Vec3::ZERO;
            for ((emitter, &count), &own) in emitters.iter().zip(&counts.samples).zip(&of_object) {
                if count == 0 || emitter.is_below_horizon(point, n) {
                    continue;
                }
                let sequence = R2::new(&mut rng);
                let mut light = Vec3::ZERO;
                for k in 0..count {
                    let u = sequence.get(k);
                    light += if own {
                        visible_light(emitter, self.with.trees(), point, n, u, rays)
                    } else {
                        -self.hidden_light(emitter, point, n, u, rays)
                    };
                }
                sum += light / count as f32;
            }
            sum
        })
    }

    /// Light of a sample that the object hides and S does not.
    fn hidden_light(&self, emitter: &Emitter, point: Vec3, n: Vec3, u: [f32; 2], rays: &mut u64) -> Vec3 {
        let Some(sample) = emitter.sample(point, n, u) else { return Vec3::ZERO };
        let end = sample.end(point);
        let segment = Ray { origin: point, direction: sample.direction, t_min: 0.0, t_max: sample.distance - end };
        *rays += 1;
        let hidden = Vec3::ONE - self.object.transmittance(&segment);
        if hidden == Vec3::ZERO {
            return Vec3::ZERO;
        }
        *rays += 1;
        let light = emitter.strength * sample.tint * sample.weight;
        self.without.transmittance(&segment) * hidden * light
    }

    fn is_of_object(&self, emitter: &Emitter) -> bool {
        emitter.object.is_some_and(|key| {
            self.with.part_objects().zip(&self.is_object).any(|(object, is_object)| *is_object && object == key)
        })
    }
}
