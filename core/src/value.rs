//! What transport carries: light of all lights together, or layer by layer along the same rays.

use std::fmt::Debug;
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Sub, SubAssign};

use glam::{DVec3, Vec3};

/// Light at a point, linear RGB, of one or several layers. All arithmetic is per layer; a `Vec3` factor (albedo) and a
/// scalar apply to every layer.
pub(crate) trait Value:
    Copy
    + Default
    + Debug
    + PartialEq
    + Send
    + Sync
    + Add<Output = Self>
    + AddAssign
    + Sub<Output = Self>
    + SubAssign
    + Mul<Vec3, Output = Self>
    + Mul<f32, Output = Self>
    + Div<f32, Output = Self>
    + Sum
    + 'static
{
    /// Double-precision numbers per layer and channel, for sums over many elements.
    type Wide: Wide;

    /// Light of one layer.
    fn of_layer(layer: u32, light: Vec3) -> Self;

    /// Light of some layers, of none in those that are left.
    fn of_layers(layers: &[Vec3]) -> Self;

    /// Adds to the light of one layer.
    fn add_to_layer(&mut self, layer: u32, light: Vec3);

    /// A layer's light.
    fn layer(&self, layer: usize) -> Vec3;

    /// Numbers per layer and channel, in double precision.
    fn wide(self) -> Self::Wide;

    /// Product per layer and channel.
    fn times(self, other: Self) -> Self;

    /// Numbers per layer and channel, in single precision.
    fn narrow(wide: Self::Wide) -> Self;

    /// All layers, each with its weight.
    #[inline]
    fn weighted(&self, weights: &[Vec3]) -> Vec3 {
        weights.iter().enumerate().map(|(layer, weight)| self.layer(layer) * *weight).sum()
    }
}

/// Double-precision numbers per layer and channel.
pub(crate) trait Wide: Copy + Debug + Send + Sync {
    /// A number per channel, the same for all layers.
    fn splat(value: DVec3) -> Self;

    /// Applies `f` layer by layer.
    fn map(self, f: impl Fn(DVec3) -> DVec3) -> Self {
        self.zip(self, |a, _| f(a))
    }

    /// Applies `f` layer by layer to two.
    fn zip(self, other: Self, f: impl Fn(DVec3, DVec3) -> DVec3) -> Self;

    /// Whether `f` holds for all layers of two.
    fn all(self, other: Self, f: impl Fn(DVec3, DVec3) -> bool) -> bool;

    /// Sum.
    fn plus(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }

    /// Product.
    fn times(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
}

impl Value for Vec3 {
    type Wide = DVec3;

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
    type Wide = [DVec3; K];

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
    fn layer(&self, layer: usize) -> Vec3 {
        self.0[layer]
    }

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

    #[inline]
    fn weighted(&self, weights: &[Vec3]) -> Vec3 {
        self.0.iter().zip(weights).fold(Vec3::ZERO, |sum, (light, weight)| sum + *light * *weight)
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

/// Calls a function generic over the number of layers for the least number that holds `$layers`.
macro_rules! with_layers {
    ($layers:expr, $function:ident($($argument:expr),* $(,)?)) => {
        match $layers {
            0 | 1 => $function::<glam::Vec3>($($argument),*),
            2 => $function::<$crate::value::Layered<2>>($($argument),*),
            3 | 4 => $function::<$crate::value::Layered<4>>($($argument),*),
            5..=8 => $function::<$crate::value::Layered<8>>($($argument),*),
            _ => $function::<$crate::value::Layered<16>>($($argument),*),
        }
    };
}
pub(crate) use with_layers;
