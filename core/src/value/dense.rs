//! All layers side by side, or one.

use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Sub, SubAssign};

use glam::{DVec3, Vec3};

use super::{Lockstep, Scalars, Value, Wide};

impl Value for Vec3 {
    type Scalars = NoScalars;

    #[inline]
    fn of_layer(_: u32, light: Vec3) -> Self {
        light
    }

    #[inline]
    fn of_layers(layers: &[Vec3]) -> Self {
        layers.first().copied().unwrap_or_default()
    }

    #[inline]
    fn add_to_layer(&mut self, _: u32, light: Vec3) {
        *self += light;
    }

    #[inline]
    fn layer(&self, _: usize) -> Vec3 {
        *self
    }

    #[inline]
    fn squares(&self, _: f32) -> NoScalars {
        NoScalars
    }
}

impl Lockstep for Vec3 {
    type Wide = DVec3;

    #[inline]
    fn wide(self) -> DVec3 {
        self.as_dvec3()
    }

    #[inline]
    fn times(self, other: Self) -> Self {
        self * other
    }

    #[inline]
    fn narrow(wide: DVec3) -> Self {
        wide.as_vec3()
    }
}

impl Wide for DVec3 {
    fn splat(value: DVec3) -> Self {
        value
    }

    fn zip(self, other: Self, f: impl Fn(DVec3, DVec3) -> DVec3) -> Self {
        f(self, other)
    }

    fn all(self, other: Self, f: impl Fn(DVec3, DVec3) -> bool) -> bool {
        f(self, other)
    }
}

/// Light of `K` layers at a point; they lie side by side.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(transparent)]
pub(crate) struct Layered<const K: usize>(pub [Vec3; K]);

impl<const K: usize> Default for Layered<K> {
    fn default() -> Self {
        Layered([Vec3::ZERO; K])
    }
}

impl<const K: usize> Value for Layered<K> {
    type Scalars = LayeredScalars<K>;

    #[inline]
    fn of_layer(layer: u32, light: Vec3) -> Self {
        let mut value = Layered::default();
        value.0[layer as usize] = light;
        value
    }

    #[inline]
    fn of_layers(layers: &[Vec3]) -> Self {
        let mut value = Layered::default();
        value.0.iter_mut().zip(layers).for_each(|(value, light)| *value = *light);
        value
    }

    #[inline]
    fn add_to_layer(&mut self, layer: u32, light: Vec3) {
        self.0[layer as usize] += light;
    }

    #[inline]
    fn add_scaled(&mut self, other: &Self, by: Vec3) {
        self.0.iter_mut().zip(&other.0).for_each(|(a, b)| *a += *b * by);
    }

    #[inline]
    fn layer(&self, layer: usize) -> Vec3 {
        self.0[layer]
    }

    #[inline]
    fn weighted(&self, weights: &[Vec3]) -> Vec3 {
        self.0.iter().zip(weights).fold(Vec3::ZERO, |sum, (light, weight)| sum + *light * *weight)
    }

    #[inline]
    fn squares(&self, factor: f32) -> LayeredScalars<K> {
        LayeredScalars(self.0.map(|light| factor * light.length_squared() / 3.0))
    }
}

impl<const K: usize> Lockstep for Layered<K> {
    type Wide = [DVec3; K];

    #[inline]
    fn wide(self) -> [DVec3; K] {
        self.0.map(|v| v.as_dvec3())
    }

    #[inline]
    fn times(mut self, other: Self) -> Self {
        self.0.iter_mut().zip(other.0).for_each(|(a, b)| *a *= b);
        self
    }

    #[inline]
    fn narrow(wide: [DVec3; K]) -> Self {
        Layered(wide.map(|v| v.as_vec3()))
    }
}

impl<const K: usize> Wide for [DVec3; K] {
    fn splat(value: DVec3) -> Self {
        [value; K]
    }

    fn zip(self, other: Self, f: impl Fn(DVec3, DVec3) -> DVec3) -> Self {
        std::array::from_fn(|k| f(self[k], other[k]))
    }

    fn all(self, other: Self, f: impl Fn(DVec3, DVec3) -> bool) -> bool {
        self.into_iter().zip(other).all(|(a, b)| f(a, b))
    }
}

impl<const K: usize> Add for Layered<K> {
    type Output = Self;

    #[inline]
    fn add(mut self, other: Self) -> Self {
        self += other;
        self
    }
}

impl<const K: usize> AddAssign for Layered<K> {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        self.0.iter_mut().zip(other.0).for_each(|(a, b)| *a += b);
    }
}

impl<const K: usize> Sub for Layered<K> {
    type Output = Self;

    #[inline]
    fn sub(mut self, other: Self) -> Self {
        self -= other;
        self
    }
}

impl<const K: usize> SubAssign for Layered<K> {
    #[inline]
    fn sub_assign(&mut self, other: Self) {
        self.0.iter_mut().zip(other.0).for_each(|(a, b)| *a -= b);
    }
}

impl<const K: usize> MulAssign<Vec3> for Layered<K> {
    #[inline]
    fn mul_assign(&mut self, by: Vec3) {
        self.0.iter_mut().for_each(|a| *a *= by);
    }
}

impl<const K: usize> Mul<Vec3> for Layered<K> {
    type Output = Self;

    #[inline]
    fn mul(mut self, by: Vec3) -> Self {
        self *= by;
        self
    }
}

impl<const K: usize> Mul<f32> for Layered<K> {
    type Output = Self;

    #[inline]
    fn mul(mut self, by: f32) -> Self {
        self.0.iter_mut().for_each(|a| *a *= by);
        self
    }
}

impl<const K: usize> Div<f32> for Layered<K> {
    type Output = Self;

    #[inline]
    fn div(mut self, by: f32) -> Self {
        self.0.iter_mut().for_each(|a| *a /= by);
        self
    }
}

impl<const K: usize> Sum for Layered<K> {
    fn sum<I: Iterator<Item = Self>>(values: I) -> Self {
        values.fold(Layered::default(), |a, b| a + b)
    }
}

/// Of a single layer, whose numbers are those of the whole.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct NoScalars;

impl Scalars for NoScalars {
    #[inline]
    fn of_layer(&self, _: usize) -> f32 {
        0.0
    }

    #[inline]
    fn add_to_layer(&mut self, _: usize, _: f32) {}
}

impl Add for NoScalars {
    type Output = Self;

    fn add(self, _: Self) -> Self {
        self
    }
}

impl AddAssign for NoScalars {
    fn add_assign(&mut self, _: Self) {}
}

impl Sub for NoScalars {
    type Output = Self;

    fn sub(self, _: Self) -> Self {
        self
    }
}

impl Mul<f32> for NoScalars {
    type Output = Self;

    fn mul(self, _: f32) -> Self {
        self
    }
}

impl Div<f32> for NoScalars {
    type Output = Self;

    fn div(self, _: f32) -> Self {
        self
    }
}

/// A number for each of `K` layers.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(transparent)]
pub(crate) struct LayeredScalars<const K: usize>([f32; K]);

impl<const K: usize> Default for LayeredScalars<K> {
    fn default() -> Self {
        LayeredScalars([0.0; K])
    }
}

impl<const K: usize> LayeredScalars<K> {
    #[inline]
    fn zip(self, other: Self, f: impl Fn(f32, f32) -> f32) -> Self {
        LayeredScalars(std::array::from_fn(|k| f(self.0[k], other.0[k])))
    }
}

impl<const K: usize> Scalars for LayeredScalars<K> {
    #[inline]
    fn of_layer(&self, layer: usize) -> f32 {
        self.0[layer]
    }

    #[inline]
    fn add_to_layer(&mut self, layer: usize, number: f32) {
        self.0[layer] += number;
    }
}

impl<const K: usize> Add for LayeredScalars<K> {
    type Output = Self;

    #[inline]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
}

impl<const K: usize> AddAssign for LayeredScalars<K> {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<const K: usize> Sub for LayeredScalars<K> {
    type Output = Self;

    #[inline]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
}

impl<const K: usize> Mul<f32> for LayeredScalars<K> {
    type Output = Self;

    #[inline]
    fn mul(self, by: f32) -> Self {
        LayeredScalars(self.0.map(|a| a * by))
    }
}

impl<const K: usize> Div<f32> for LayeredScalars<K> {
    type Output = Self;

    #[inline]
    fn div(self, by: f32) -> Self {
        LayeredScalars(self.0.map(|a| a / by))
    }
}
