//! Which light a vertex of a path samples: by what each could bring there, one by one where they are few, by way of a tree
//! where there are many. A weak lamp then does not explode beside itself, where it is chosen as seldom as its power says.

use glam::Vec3;

use super::emitters::{Emitter, Emitters, Shape};

/// So many lights are weighed at every vertex.
pub(crate) const WEIGHED: usize = 32;

/// Solid angle of the half space above a surface, sr.
const HALF_SPACE: f32 = std::f32::consts::TAU;

impl Emitters {
    /// A light for a surface with unit normal `n`, and its probability; none where none can bring light there. `u` is
    /// uniform.
    #[inline]
    pub(crate) fn choose(&self, point: Vec3, n: Vec3, u: f32) -> Option<(usize, f32)> {
        if let Some(tree) = &self.tree {
            return tree.choose(&self.list, point, n, u);
        }
        if self.list.len() == 1 {
            return Some((0, 1.0));
        }
        let mut weights = [0.0f32; WEIGHED];
        let total = self.weigh(point, n, &mut weights);
        let mut left = u * total;
        let mut chosen = None;
        for (index, &weight) in weights[..self.list.len()].iter().enumerate().filter(|(_, w)| **w > 0.0) {
            chosen = Some((index, weight / total));
            left -= weight;
            if left < 0.0 {
                break;
            }
        }
        chosen
    }

    /// Probability with which [`Emitters::choose`] answers `index`.
    pub(crate) fn choice_pdf(&self, point: Vec3, n: Vec3, index: usize) -> f32 {
        if let Some(tree) = &self.tree {
            return tree.probability(&self.list, point, n, index);
        }
        if self.list.len() == 1 {
            return 1.0;
        }
        let mut weights = [0.0f32; WEIGHED];
        let total = self.weigh(point, n, &mut weights);
        if total > 0.0 { weights[index] / total } else { 0.0 }
    }

    fn weigh(&self, point: Vec3, n: Vec3, weights: &mut [f32; WEIGHED]) -> f32 {
        let mut total = 0.0;
        for (weight, emitter) in weights.iter_mut().zip(&self.list) {
            *weight = emitter.weight_at(point, n);
            total += *weight;
        }
        total
    }
}

impl Emitter {
    /// About the most that it can bring to a surface: strength × solid angle from the nearest point of its box, without
    /// shadows. Zero only where it brings nothing.
    #[inline]
    pub(crate) fn weight_at(&self, point: Vec3, n: Vec3) -> f32 {
        let strength = self.strength.element_sum() * self.importance;
        if strength <= 0.0 || self.is_below_horizon(point, n) {
            return 0.0;
        }
        strength
            * match &self.shape {
                Shape::Surface { low, high, area, brightness, .. } => {
                    let distance2 = (point.clamp(*low, *high) - point).length_squared();
                    brightness * if distance2 * HALF_SPACE > *area { area / distance2 } else { HALF_SPACE }
                }
                Shape::Point { position, .. } => {
                    // Inverse square law; the specification's window only takes from it.
                    1.0 / (*position - point).length_squared().max(1e-12)
                }
                Shape::Directional { .. } => 1.0,
                Shape::BrightSky(sky) => sky.bright_power(),
                Shape::Sky(_) => 0.0,
            }
    }

    /// Whether all of it lies below a surface's horizon.
    #[inline]
    pub fn is_below_horizon(&self, point: Vec3, n: Vec3) -> bool {
        match self.sphere() {
            Some((center, radius)) => n.dot(center - point) <= -radius,
            None => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Light, LightKind};

    fn lamps(intensities: &[f32]) -> Emitters {
        let lamp = |(i, &intensity): (usize, &f32)| Light {
            name: format!("lamp {i}"),
            kind: LightKind::Point { position: glam::DVec3::new(i as f64, 1.0, 0.0), range: None },
            color: Vec3::ONE,
            intensity,
        };
        let lights: Vec<Light> = intensities.iter().enumerate().map(lamp).collect();
        Emitters::new(&lights, glam::DVec3::ZERO, 10.0, |_, _| None)
    }

    #[test]
    fn lights_are_chosen_as_often_as_said() {
        let emitters = lamps(&[1.0, 0.0, 50.0, 4.0]);
        let (point, n) = (Vec3::new(0.1, 0.0, 0.0), Vec3::Y);
        let draws = 100_000;
        let mut counts = [0u32; 4];
        for k in 0..draws {
            let (index, pdf) = emitters.choose(point, n, (k as f32 + 0.5) / draws as f32).unwrap();
            assert_eq!(pdf, emitters.choice_pdf(point, n, index));
            counts[index] += 1;
        }
        let total: f32 = (0..4).map(|i| emitters.choice_pdf(point, n, i)).sum();
        assert!((total - 1.0).abs() < 1e-5);
        for (i, count) in counts.iter().enumerate() {
            // Stratified draws: off by one draw at each end of an interval, and by rounding.
            let expected = emitters.choice_pdf(point, n, i) * draws as f32;
            assert!((*count as f32 - expected).abs() < 3.0, "{i}: {count} {expected}");
        }
        assert_eq!(counts[1], 0, "a light that is off is never chosen");
    }

    #[test]
    fn what_lies_below_the_horizon_is_not_chosen() {
        assert!(lamps(&[1.0, 2.0]).choose(Vec3::new(0.0, 2.0, 0.0), Vec3::Y, 0.5).is_none());
    }
}
