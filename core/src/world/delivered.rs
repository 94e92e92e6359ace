//! Light as it is delivered: never negative. Stored light may be, since its noise has both signs and no bias; what a
//! client takes roots of must not.

use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::{Placed, World};
use crate::lightmap::{LightMap, LightPart};
use crate::space::NO_OBJECT;

/// Slots per task.
const CHUNK: usize = 4096;

/// Times that what is missing is sought one ring of elements further.
const RINGS: u32 = 8;

impl World {
    /// Some of the light of a map as clients get it, per slot (irradiance / π, linear RGB): nowhere negative, and direct +
    /// indirect = full, bit for bit. A map with layers is their weighted sum, and keeps its noise as they do.
    ///
    /// # Panics
    /// Where the map has not one value per slot.
    pub fn delivered(&self, map: &LightMap, part: LightPart) -> Vec<Vec3> {
        let positive = |values: &[Vec3]| {
            let mut values = values.to_vec();
            if map.layers.is_empty() {
                self.without_negative(&mut values);
            }
            values
        };
        match part {
            LightPart::Direct => positive(&map.light.direct),
            LightPart::Indirect => positive(&map.light.indirect),
            LightPart::Full => {
                let mut sum = positive(&map.light.direct);
                sum.iter_mut().zip(positive(&map.light.indirect)).for_each(|(sum, indirect)| *sum += indirect);
                sum
            }
        }
    }

    /// The standard error, per slot, of what is delivered of a map or a layer with this variance: three equal numbers,
    /// irradiance / π; zero in holes. `is_known` tells of a slot whether its variance is that of the light it holds: where it
    /// is not, the error is infinite, since nothing bounds it.
    ///
    /// # Panics
    /// Where there is not one variance per slot.
    pub fn standard_errors(&self, variance: &[f32], is_known: impl Fn(usize) -> bool + Sync) -> Vec<Vec3> {
        assert_eq!(variance.len(), self.slots(), "one variance per slot");
        let error = |(slot, variance): (usize, &f32)| match () {
            () if self.space.slots().owners[slot] == NO_OBJECT => Vec3::ZERO,
            () if !is_known(slot) || variance.is_nan() => Vec3::INFINITY,
            () => Vec3::splat(variance.max(0.0).sqrt()),
        };
        variance.par_iter().enumerate().with_min_len(CHUNK).map(error).collect()
    }

    /// Raises negative values (per slot, irradiance / π) to zero and takes what that adds from neighbours along the
    /// surface, so that the mean of each side of an object, weighted by area, stays as it is per channel. Where it is
    /// negative, that channel of the side becomes black. Nothing else changes, not even by a bit: the same values come
    /// out of the same values.
    ///
    /// # Panics
    /// Where there is not one value per slot.
    pub fn without_negative(&self, values: &mut [Vec3]) {
        assert_eq!(values.len(), self.slots(), "one value per slot");
        let has_negative = |placed: &&Arc<Placed>| {
            values[placed.placement.element_indices()].iter().any(|value| value.min_element() < 0.0)
        };
        let objects: Vec<&Arc<Placed>> = self.placed.par_iter().filter(has_negative).collect();
        for placed in objects {
            for side in placed.sides() {
                let own = side.start as usize..side.end as usize;
                let areas = self.areas().copy(own.clone());
                (0..3).for_each(|channel| raise(placed, &areas, &mut values[own.clone()], channel));
            }
        }
    }
}

/// One channel of one side.
fn raise(placed: &Placed, areas: &[f32], values: &mut [Vec3], channel: usize) {
    let mut negative: Vec<usize> = (0..values.len()).filter(|&e| values[e][channel] < 0.0).collect();
    for _ in 0..RINGS {
        if negative.is_empty() {
            return;
        }
        for &element in &negative {
            borrow(placed, areas, values, channel, element);
        }
        negative.retain(|&element| values[element][channel] < 0.0);
    }
    // What neighbours cannot give is given by all.
    let light = |value: f32, area: f32| f64::from(value) * f64::from(area);
    let sums = values.iter().zip(areas).fold((0.0, 0.0), |(missing, there), (value, area)| {
        let light = light(value[channel], *area);
        (missing - light.min(0.0), there + light.max(0.0))
    });
    let left = if sums.1 > sums.0 { (1.0 - sums.0 / sums.1) as f32 } else { 0.0 };
    values.iter_mut().for_each(|value| value[channel] = value[channel].max(0.0) * left);
}

/// An element takes what it lacks from its neighbours, from each the same part of what it has. Where they have too
/// little it takes all, and the rest later of those that have borrowed themselves by then.
fn borrow(placed: &Placed, areas: &[f32], values: &mut [Vec3], channel: usize, element: usize) {
    let neighbours = placed.layout.neighbours_of(element as u32);
    let missing = -values[element][channel] * areas[element];
    let light = |e: u32| values[e as usize][channel].max(0.0) * areas[e as usize];
    let there: f32 = neighbours.clone().map(light).sum();
    if there <= 0.0 {
        return;
    }
    let given = missing.min(there);
    for e in neighbours {
        let value = &mut values[e as usize][channel];
        if *value > 0.0 {
            *value = (*value * (1.0 - given / there)).max(0.0);
        }
    }
    values[element][channel] = if given < missing { -(missing - given) / areas[element] } else { 0.0 };
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::Edit;
    use crate::random::Pcg32;
    use crate::scene::{Material, Mesh, Object, Scene};
    use crate::world::WorldOptions;

    fn world() -> World {
        let ball = |name: &str| Object::new(name, Mesh::icosphere(1.0, 3), Material::diffuse(Vec3::splat(0.5)));
        let options = WorldOptions { spacing: Some(0.2), ..WorldOptions::default() };
        World::new(Scene::from_objects(vec![ball("a"), ball("b")]), &options).expect("two balls")
    }

    fn mean(world: &World, object: usize, values: &[Vec3]) -> Vec3 {
        let range = world.placed[object].placement.element_indices();
        range.map(|slot| values[slot] * world.areas()[slot]).sum()
    }

    #[test]
    fn means_of_objects_stay_and_nothing_is_negative() {
        let (world, mut rng) = (world(), Pcg32::new(4, 2));
        let stored: Vec<Vec3> =
            (0..world.slots()).map(|_| Vec3::new(rng.next_f32() - 0.4, rng.next_f32() - 0.1, rng.next_f32())).collect();
        let mut values = stored.clone();
        world.without_negative(&mut values);
        assert!(values.iter().all(|value| value.min_element() >= 0.0));
        for object in 0..2 {
            let (before, after) = (mean(&world, object, &stored), mean(&world, object, &values));
            assert!((before - after).abs().max_element() < 1e-4 * before.length(), "{before} and {after}");
        }
        // The last channel had nothing to mend.
        assert!(values.iter().zip(&stored).all(|(a, b)| a.z.to_bits() == b.z.to_bits()));
        let again = values.clone();
        world.without_negative(&mut values);
        assert_eq!(values, again);
    }

    /// One negative element changes its neighbours, and nobody else.
    #[test]
    fn what_is_missing_comes_from_beside() {
        let world = world();
        let mut values = vec![Vec3::ONE; world.slots()];
        values[7] = Vec3::splat(-0.5);
        world.without_negative(&mut values);
        let beside: Vec<u32> = world.placed[0].layout.neighbours_of(7).collect();
        for (slot, value) in (0..).zip(&values) {
            let is_changed = slot == 7 || beside.contains(&slot);
            assert_eq!(*value != Vec3::ONE, is_changed, "slot {slot}");
        }
    }

    /// An object that has more to lose than to give is black.
    #[test]
    fn what_is_negative_as_a_whole_is_black() {
        let world = world();
        let mut values = vec![Vec3::splat(-0.01); world.slots()];
        values[3] = Vec3::splat(0.02);
        world.without_negative(&mut values);
        assert!(values.iter().all(|value| *value == Vec3::ZERO));
    }

    /// What is not known is not exact, and holes hold nothing.
    #[test]
    fn errors_are_roots_of_variances_and_infinite_where_unknown() {
        let gone = Edit::Remove { objects: vec!["a".into()] };
        let world = world().apply(&[gone]).expect("an edit").after;
        let first = world.placed[0].placement.elements.start as usize;
        let mut variance = vec![0.25; world.slots()];
        variance[first + 1] = -1e-9;
        let errors = world.standard_errors(&variance, |slot| slot != first + 2);
        assert!(first > 0 && errors[..first].iter().all(|error| *error == Vec3::ZERO));
        let expected = [0.5, 0.0, f32::INFINITY, 0.5].map(Vec3::splat);
        assert_eq!(errors[first..first + 4], expected);
    }

    #[test]
    fn direct_and_indirect_light_add_up_to_what_is_delivered() {
        let (world, mut rng) = (world(), Pcg32::new(5, 3));
        let mut map = LightMap::black(world.slots());
        map.light.direct.iter_mut().for_each(|value| *value = Vec3::splat(rng.next_f32() - 0.3));
        map.light.indirect.iter_mut().for_each(|value| *value = Vec3::splat(rng.next_f32() - 0.2));
        let part = |part| world.delivered(&map, part);
        let [full, direct, indirect] = [LightPart::Full, LightPart::Direct, LightPart::Indirect].map(part);
        assert!(full.iter().all(|value| value.min_element() >= 0.0));
        assert!((0..world.slots()).all(|slot| full[slot] == direct[slot] + indirect[slot]));
        // Layers are delivered as they are, and so is their sum.
        map.layers.push(Arc::default());
        assert_eq!(world.delivered(&map, LightPart::Direct), map.light.direct);
    }
}
