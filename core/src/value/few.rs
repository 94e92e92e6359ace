//! Of many layers, those that matter at a place. Where there are too many, or one matters little, chance decides which
//! stay, and they grow by what the others had: each layer is right on average, and all light together is the same
//! (aggregation of pairs: Cohen, Cormode and Duffield 2011, "Structure-aware sampling").

#[cfg(test)]
mod tests;

use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

use glam::Vec3;

use super::{Linear, Scalars, Value};
use crate::random::{mix, unit};

/// Layers that are told apart at a place, at most: what four lamps each of a room and of its neighbours light.
const FEW: usize = 16;

/// Layers with less than this part of all light at a place are carried as often as they have of it.
const LEAST_CARRIED: f32 = 1e-2;

/// A number or light of each layer that matters, layers ascending, and what makes all of them together right, in the first
/// layer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Few<T> {
    len: usize,
    layers: [u16; FEW + 1],
    /// With room for one more, for a moment.
    values: [T; FEW + 1],
    /// Of layer 0.
    rest: T,
}

/// What can be added up and compared in size.
pub(crate) trait Item: Linear + Neg<Output = Self> {
    /// Largest absolute number.
    fn size(self) -> f32;

    /// Bits that differ where numbers do: what chance is made of, so that it is the same in every run.
    fn bits(self) -> u64;
}

impl Item for f32 {
    #[inline]
    fn size(self) -> f32 {
        self.abs()
    }

    #[inline]
    fn bits(self) -> u64 {
        u64::from(self.to_bits())
    }
}

impl Item for Vec3 {
    #[inline]
    fn size(self) -> f32 {
        self.abs().max_element()
    }

    #[inline]
    fn bits(self) -> u64 {
        self.to_array().into_iter().fold(0, |bits, x| bits.rotate_left(21) ^ u64::from(x.to_bits()))
    }
}

impl<T: Item> Default for Few<T> {
    #[inline]
    fn default() -> Self {
        Few { len: 0, layers: [0; FEW + 1], values: [T::default(); FEW + 1], rest: T::default() }
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

    /// Puts a layer in its place, where it is not yet; answers where it is now, or what follows it.
    fn insert(&mut self, place: usize, layer: u16, value: T) -> usize {
        if value == T::default() {
            return place;
        }
        self.layers.copy_within(place..self.len, place + 1);
        self.values.copy_within(place..self.len, place + 1);
        (self.layers[place], self.values[place]) = (layer, value);
        self.len += 1;
        if self.len <= FEW {
            return place;
        }
        let gone = self.merge_least();
        place - usize::from(gone < place)
    }

    /// Merges the two least. Answers where the one was that is there no more.
    fn merge_least(&mut self) -> usize {
        let size = |place: usize| self.values[place].size();
        let (mut least, mut next) = if size(1) < size(0) { (1, 0) } else { (0, 1) };
        for place in 2..self.len {
            if size(place) < size(least) {
                (least, next) = (place, least);
            } else if size(place) < size(next) {
                next = place;
            }
        }
        let goes = self.merge(least, next);
        self.remove(goes);
        goes
    }

    /// Of two layers one stays, as often as it has of the size of both, and grows to that; what colour it lacks then is
    /// the rest's. Answers where the other is.
    fn merge(&mut self, a: usize, b: usize) -> usize {
        let size = |place: usize| self.values[place].size();
        let both = size(a) + size(b);
        let draw = unit(mix(self.bits(a) ^ self.bits(b).rotate_left(32)));
        let (stays, goes) = if draw * both < size(a) { (a, b) } else { (b, a) };
        let value = self.values[stays];
        if value.size() > 0.0 {
            self.values[stays] = value * (both / value.size());
        }
        self.rest += self.values[goes] + value - self.values[stays];
        goes
    }

    fn bits(&self, place: usize) -> u64 {
        mix(self.values[place].bits() ^ (u64::from(self.layers[place]) << 48))
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

    /// Without a difference, whose layers of both signs would be merged.
    #[inline]
    fn approach(&mut self, other: &Self, part: f32) {
        *self = *self * (1.0 - part);
        self.add_scaled(other, Vec3::splat(part));
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
        let square = |light| square(light, factor);
        Few { len: self.len, layers: self.layers, values: self.values.map(square), rest: square(self.rest) }
    }

    fn thinned(mut self) -> Self {
        let least = LEAST_CARRIED * (self.live().map(|(_, light)| light.size()).sum::<f32>() + self.rest.size());
        // Those with less are merged until they have as much, or one is left.
        let (mut small, mut gone) = (None, [false; FEW + 1]);
        for place in 0..self.len {
            if self.values[place].size() >= least {
                continue;
            }
            let mut stays = place;
            if let Some(before) = small {
                let goes = self.merge(before, place);
                stays = before + place - goes;
                gone[goes] = true;
            }
            small = (self.values[stays].size() < least).then_some(stays);
        }
        let mut kept = 0;
        for place in (0..self.len).filter(|&place| !gone[place]) {
            (self.layers[kept], self.values[kept]) = (self.layers[place], self.values[place]);
            kept += 1;
        }
        self.len = kept;
        self
    }

    /// Squared layer by layer: of both signs, what is merged would not be.
    fn squared_difference(&self, other: &Self, factor: f32) -> Few<f32> {
        let square = |light| square(light, factor);
        let mut squares = Few { rest: square(self.rest - other.rest), ..Few::default() };
        self.live().for_each(|(layer, light)| squares.add_to(layer, square(light - other.at(layer.into()))));
        let only_theirs = other.live().filter(|(layer, _)| !self.layers[..self.len].contains(layer));
        only_theirs.for_each(|(layer, light)| squares.add_to(layer, square(light)));
        squares
    }

    #[inline]
    fn weighted(&self, weights: &[Vec3]) -> Vec3 {
        let of_rest = self.rest * weights.first().copied().unwrap_or_default();
        self.live().fold(of_rest, |sum, (layer, light)| sum + light * weights[usize::from(layer)])
    }
}

/// `factor` times the square, mean over RGB.
fn square(light: Vec3, factor: f32) -> f32 {
    factor * light.length_squared() / 3.0
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
