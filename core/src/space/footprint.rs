//! What a look-up reads.

use std::ops::Index;

use glam::Vec3;

/// The slots that hold the light of a point, and their weights, which sum to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    slots: [u32; 3],
    weights: [f32; 3],
}

/// A side of a surface, at a point, as trees and lights know it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Spot {
    /// Id of the cell.
    pub cell: u32,
    /// Element slots there; none where the side has no elements.
    pub footprint: Option<Footprint>,
    /// Diffuse albedo.
    pub albedo: Vec3,
}

impl Footprint {
    /// Of the corners of a cell.
    #[inline]
    pub(crate) fn of_triangle(slots: [u32; 3], weights: [f32; 3]) -> Footprint {
        Footprint { slots, weights }
    }

    /// The slots.
    #[inline]
    pub(crate) fn slots(&self) -> &[u32] {
        &self.slots
    }

    /// The slots with their weights.
    pub(crate) fn slots_and_weights(&self) -> impl Iterator<Item = (u32, f32)> {
        self.slots.into_iter().zip(self.weights)
    }

    /// The weighted mean of some values, one per slot.
    #[inline]
    pub fn interpolate<V>(&self, values: &(impl Index<usize, Output = V> + ?Sized)) -> V
    where
        V: Copy + std::ops::Add<Output = V> + std::ops::Mul<f32, Output = V>,
    {
        let value = |k: usize| values[self.slots[k] as usize] * self.weights[k];
        value(0) + value(1) + value(2)
    }

    /// Calls `add` with each value and its weight.
    #[inline]
    pub(crate) fn for_each<V>(&self, values: &[V], mut add: impl FnMut(&V, f32)) {
        self.slots_and_weights().for_each(|(slot, weight)| add(&values[slot as usize], weight));
    }

    /// The slot that weighs most.
    #[inline]
    pub(crate) fn heaviest(&self) -> u32 {
        let mut best = 0;
        for k in 1..3 {
            if self.weights[k] > self.weights[best] {
                best = k;
            }
        }
        self.slots[best]
    }

    /// Which of the slots a uniform number draws by weight.
    #[inline]
    pub(crate) fn drawn(&self, u: f32) -> usize {
        let (mut k, mut sum) = (0, self.weights[0]);
        while u >= sum && k < 2 {
            k += 1;
            sum += self.weights[k];
        }
        k
    }

    /// What is left of it where some slots do not count; none where next to nothing is.
    pub(crate) fn without(mut self, mut is_out: impl FnMut(u32) -> bool) -> Option<Footprint> {
        const LEAST: f32 = 1e-3;
        let mut sum = 0.0;
        for k in 0..3 {
            if is_out(self.slots[k]) {
                self.weights[k] = 0.0;
            }
            sum += self.weights[k];
        }
        self.weights.iter_mut().for_each(|w| *w /= sum);
        (sum > LEAST).then_some(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn look_ups_are_weighted_means() {
        let footprint = Footprint::of_triangle([2, 0, 1], [0.5, 0.25, 0.25]);
        assert_eq!(footprint.interpolate(&[Vec3::X * 4.0, Vec3::Y * 4.0, Vec3::Z * 2.0]), Vec3::ONE);
        assert_eq!(footprint.heaviest(), 2);
        assert_eq!([0.0, 0.49, 0.5, 0.74, 0.75, 0.999].map(|u| footprint.drawn(u)), [0, 0, 1, 1, 2, 2]);
    }

    #[test]
    fn what_does_not_count_leaves_its_weight_to_the_rest() {
        let footprint = Footprint::of_triangle([2, 0, 1], [0.5, 0.25, 0.25]);
        let rest = footprint.without(|slot| slot == 2).expect("half of it is left");
        assert_eq!(rest.weights, [0.0, 0.5, 0.5]);
        assert_eq!(footprint.without(|_| true), None);
    }
}
