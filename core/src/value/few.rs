//! Of many layers, those that matter at a place: a lamp is bright in few places, and elsewhere its light is hardly
//! told from that of all the others. It is not lost there: all light together is the same.

use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

use glam::Vec3;

use super::{Linear, Scalars, Value};

/// Layers that are told apart at a place, at most: what four lamps each of a room and of its neighbours light.
const FEW: usize = 16;

/// Of more layers than are carried side by side, one with less than this part of all light at a place is not told apart
/// there.
pub(crate) const LEAST_TOLD: f32 = 4e-3;

/// A number or light of each layer that matters, layers ascending, and of all others together in the first layer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Few<T> {
    len: usize,
    layers: [u16; FEW],
    values: [T; FEW],
    /// Of layer 0.
    rest: T,
}

/// What can be added up and compared in size.
pub(crate) trait Item: Linear + Neg<Output = Self> {
    /// Largest absolute number.
    fn size(self) -> f32;
}

impl Item for f32 {
    #[inline]
    fn size(self) -> f32 {
        self.abs()
    }
}

impl Item for Vec3 {
    #[inline]
    fn size(self) -> f32 {
        self.abs().max_element()
    }
}

impl<T: Item> Default for Few<T> {
    #[inline]
    fn default() -> Self {
        Few { len: 0, layers: [0; FEW], values: [T::default(); FEW], rest: T::default() }
    }
}

impl<T: Item> Few<T> {
    #[inline]
    fn live(&self) -> impl Iterator<Item = (u16, T)> {
        self.layers[..self.len].iter().copied().zip(self.values[..self.len].iter().copied())
    }

    #[inline]
    fn at(&self, layer: usize) -> T {
        if layer == 0 {
            return self.rest;
        }
        self.live().find(|(own, _)| usize::from(*own) == layer).map_or_else(T::default, |(_, value)| value)
    }

    /// Adds to a layer.
    fn add_to(&mut self, layer: u16, value: T) {
        let place = self.layers[..self.len].partition_point(|own| *own < layer);
        if place < self.len && self.layers[place] == layer {
            self.values[place] += value;
        } else {
            self.insert(place, layer, value);
        }
    }

    /// Puts a layer in its place, where it is not yet; answers where it is now. Where there are too many, the least of all
    /// is left to the rest.
    fn insert(&mut self, mut place: usize, layer: u16, value: T) -> usize {
        if value == T::default() {
            return place;
        }
        if self.len == FEW {
            let least = (0..FEW).min_by(|a, b| self.values[*a].size().total_cmp(&self.values[*b].size()));
            let least = least.filter(|least| self.values[*least].size() < value.size());
            let Some(least) = least else {
                self.rest += value;
                return place;
            };
            self.rest += self.values[least];
            self.remove(least);
            place -= usize::from(least < place);
        }
        self.layers.copy_within(place..self.len, place + 1);
        self.values.copy_within(place..self.len, place + 1);
        (self.layers[place], self.values[place]) = (layer, value);
        self.len += 1;
        place
    }

    fn remove(&mut self, place: usize) {
        self.layers.copy_within(place + 1..self.len, place);
        self.values.copy_within(place + 1..self.len, place);
        self.len -= 1;
    }

    #[inline]
    fn map(mut self, f: impl Fn(T) -> T) -> Self {
        self.values[..self.len].iter_mut().for_each(|value| *value = f(*value));
        self.rest = f(self.rest);
        self
    }

    #[inline]
    fn add_all(&mut self, other: &Self, f: impl Fn(T) -> T) {
        self.rest += f(other.rest);
        if self.layers[..self.len] == other.layers[..other.len] {
            let values = self.values[..self.len].iter_mut().zip(&other.values);
            values.for_each(|(own, other)| *own += f(*other));
            return;
        }
        let mut place = 0;
        for (layer, value) in other.live() {
            while place < self.len && self.layers[place] < layer {
                place += 1;
            }
            if place < self.len && self.layers[place] == layer {
                self.values[place] += f(value);
            } else {
                place = self.insert(place, layer, f(value));
            }
        }
    }
}

impl<T: Item> PartialEq for Few<T> {
    fn eq(&self, other: &Self) -> bool {
        self.rest == other.rest && self.live().eq(other.live())
    }
}

impl Value for Few<Vec3> {
    type Scalars = Few<f32>;

    const IS_FEW: bool = true;

    #[inline]
    fn of_layer(layer: u32, light: Vec3) -> Self {
        let mut value = Few::default();
        Value::add_to_layer(&mut value, layer, light);
        value
    }

    fn of_layers(layers: &[Vec3]) -> Self {
        let mut value = Few::default();
        layers.iter().zip(0..).for_each(|(light, layer)| Value::add_to_layer(&mut value, layer, *light));
        value
    }

    fn of_told(layers: &[u16], lights: &[Vec3]) -> Option<Self> {
        let ((&0, layers), (&rest, lights)) = (layers.split_first()?, lights.split_first()?) else { return None };
        let is_told = layers.len() <= FEW && layers.len() == lights.len() && layers.is_sorted_by(|a, b| a < b);
        let mut value = Few { len: layers.len(), rest, ..Few::default() };
        is_told.then(|| {
            value.layers[..layers.len()].copy_from_slice(layers);
            value.values[..layers.len()].copy_from_slice(lights);
            value
        })
    }

    #[inline]
    fn add_to_layer(&mut self, layer: u32, light: Vec3) {
        match layer {
            0 => self.rest += light,
            _ => self.add_to(layer as u16, light),
        }
    }

    #[inline]
    fn add_scaled(&mut self, other: &Self, by: Vec3) {
        self.add_all(other, |light| light * by);
    }

    #[inline]
    fn layer(&self, layer: usize) -> Vec3 {
        self.at(layer)
    }

    fn for_layers(&self, mut tell: impl FnMut(usize, Vec3)) {
        tell(0, self.rest);
        self.live().for_each(|(layer, light)| tell(usize::from(layer), light));
    }

    fn squares(&self, factor: f32) -> Few<f32> {
        let square = |light: Vec3| factor * light.length_squared() / 3.0;
        Few { len: self.len, layers: self.layers, values: self.values.map(square), rest: square(self.rest) }
    }

    fn thinned(mut self) -> Self {
        let least = LEAST_TOLD * (self.live().map(|(_, light)| light.size()).sum::<f32>() + self.rest.size());
        let mut kept = 0;
        for place in 0..self.len {
            if self.values[place].size() < least {
                self.rest += self.values[place];
                continue;
            }
            (self.layers[kept], self.values[kept]) = (self.layers[place], self.values[place]);
            kept += 1;
        }
        self.len = kept;
        self
    }

    #[inline]
    fn weighted(&self, weights: &[Vec3]) -> Vec3 {
        let of_rest = self.rest * weights.first().copied().unwrap_or_default();
        self.live().fold(of_rest, |sum, (layer, light)| sum + light * weights[usize::from(layer)])
    }
}

impl Few<Vec3> {
    /// All light together.
    #[inline]
    pub(crate) fn total(&self) -> Vec3 {
        self.live().fold(self.rest, |sum, (_, light)| sum + light)
    }

    /// As much light in all as `total`: what is missing is shared out as the size of the layers is.
    pub(crate) fn of_total(mut self, total: Vec3) -> Self {
        let missing = total - self.total();
        let size = self.live().fold(self.rest.abs(), |sum, (_, light)| sum + light.abs());
        let part = Vec3::select(size.cmpgt(Vec3::ZERO), missing / size.max(Vec3::splat(f32::MIN_POSITIVE)), Vec3::ZERO);
        self.values[..self.len].iter_mut().for_each(|light| *light += light.abs() * part);
        self.rest += self.rest.abs() * part + Vec3::select(size.cmpgt(Vec3::ZERO), Vec3::ZERO, missing);
        self
    }
}

impl Scalars for Few<f32> {
    #[inline]
    fn of_layer(&self, layer: usize) -> f32 {
        self.at(layer)
    }

    #[inline]
    fn add_to_layer(&mut self, layer: usize, number: f32) {
        match layer {
            0 => self.rest += number,
            _ => self.add_to(layer as u16, number),
        }
    }

    fn for_layers(&self, mut tell: impl FnMut(usize, f32)) {
        tell(0, self.rest);
        self.live().for_each(|(layer, number)| tell(usize::from(layer), number));
    }
}

impl<T: Item> Add for Few<T> {
    type Output = Self;

    #[inline]
    fn add(mut self, other: Self) -> Self {
        self += other;
        self
    }
}

impl<T: Item> AddAssign for Few<T> {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        self.add_all(&other, |value| value);
    }
}

impl<T: Item> Sub for Few<T> {
    type Output = Self;

    #[inline]
    fn sub(mut self, other: Self) -> Self {
        self.add_all(&other, Neg::neg);
        self
    }
}

impl SubAssign for Few<Vec3> {
    #[inline]
    fn sub_assign(&mut self, other: Self) {
        self.add_all(&other, Neg::neg);
    }
}

impl Mul<Vec3> for Few<Vec3> {
    type Output = Self;

    #[inline]
    fn mul(self, by: Vec3) -> Self {
        self.map(|light| light * by)
    }
}

impl<T: Item> Mul<f32> for Few<T> {
    type Output = Self;

    #[inline]
    fn mul(self, by: f32) -> Self {
        self.map(|value| value * by)
    }
}

impl<T: Item> Div<f32> for Few<T> {
    type Output = Self;

    #[inline]
    fn div(self, by: f32) -> Self {
        self * (1.0 / by)
    }
}

impl Sum for Few<Vec3> {
    fn sum<I: Iterator<Item = Self>>(values: I) -> Self {
        values.fold(Few::default(), |mut sum, value| {
            sum += value;
            sum
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn lights() -> impl Strategy<Value = Vec<(u32, Vec3)>> {
        let light = (0.0_f32..1.0, 0.0_f32..1.0).prop_map(|(x, y)| Vec3::new(x, y, x * y));
        prop::collection::vec((0_u32..60, light), 0..60)
    }

    fn of(lights: &[(u32, Vec3)]) -> Few<Vec3> {
        lights.iter().fold(Few::default(), |mut value, (layer, light)| {
            value.add_to_layer(*layer, *light);
            value
        })
    }

    proptest! {
        #[test]
        fn no_light_is_lost_and_what_is_told_apart_is_no_more_than_there_is(a in lights(), b in lights(), by in -2.0_f32..2.0) {
            let sum = of(&a) + of(&b) * by;
            let all = |layer: Option<u32>| -> Vec3 {
                let of = |lights: &[(u32, Vec3)]| -> Vec3 {
                    lights.iter().filter(|(l, _)| layer.is_none_or(|layer| layer == *l)).map(|(_, light)| *light).sum()
                };
                of(&a) + of(&b) * by
            };
            let whole = all(None);
            let close = |a: Vec3, b: Vec3| a.abs_diff_eq(b, 1e-4);
            prop_assert!(close(sum.total(), whole) && close(sum.thinned().total(), whole));
            prop_assert!(close(sum.weighted(&[Vec3::ONE; 60]), whole));
            let other = sum.of_total(Vec3::new(3.0, 0.5, 0.0));
            prop_assert!(close(other.total(), Vec3::new(3.0, 0.5, 0.0)));
            let mut layers = Vec::new();
            Value::for_layers(&sum, |layer, _| layers.push(layer));
            prop_assert!(layers[0] == 0 && layers.is_sorted_by(|a, b| a < b) && layers.len() <= FEW + 1);
            let squares = sum.squares(3.0);
            for layer in 0..60 {
                let light = sum.layer(layer);
                prop_assert!((squares.of_layer(layer) - light.length_squared()).abs() < 1e-3);
                // Of positive light no layer has more than all of it, and what it lacks is in the rest.
                if by >= 0.0 && layer > 0 {
                    let missing = all(Some(layer as u32)) - light;
                    prop_assert!(missing.min_element() > -1e-4 && (sum.layer(0) - missing).min_element() > -1e-4);
                }
            }
        }

        #[test]
        fn few_layers_are_all_told_apart(a in lights(), b in lights()) {
            let few = |lights: &[(u32, Vec3)]| lights.iter().map(|(layer, light)| (layer % FEW as u32, *light)).collect::<Vec<_>>();
            let (a, b) = (few(&a), few(&b));
            let difference = of(&a) - of(&b);
            for layer in 0..FEW {
                let of = |lights: &[(u32, Vec3)]| -> Vec3 {
                    lights.iter().filter(|(own, _)| *own as usize == layer).map(|(_, light)| *light).sum()
                };
                prop_assert!(difference.layer(layer).abs_diff_eq(of(&a) - of(&b), 1e-4));
            }
        }
    }
}
