//! What transport carries: light of all lights together, or layer by layer along the same rays.

mod dense;
mod few;

use std::fmt::Debug;
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, Mul, Sub, SubAssign};

use glam::{DVec3, Vec3};

pub(crate) use dense::Layered;
pub(crate) use few::Few;

pub(crate) use crate::lightmap::SIDE_BY_SIDE;

/// What can be added up and scaled: numbers, vectors, and one of either per layer.
pub(crate) trait Linear:
    Copy
    + Default
    + Debug
    + PartialEq
    + Send
    + Sync
    + Add<Output = Self>
    + AddAssign
    + Sub<Output = Self>
    + Mul<f32, Output = Self>
    + Div<f32, Output = Self>
    + 'static
{
}

impl<T> Linear for T where
    T: Copy
        + Default
        + Debug
        + PartialEq
        + Send
        + Sync
        + Add<Output = T>
        + AddAssign
        + Sub<Output = T>
        + Mul<f32, Output = T>
        + Div<f32, Output = T>
        + 'static
{
}

/// Light at a point, linear RGB, of one or several layers. All arithmetic is per layer; a `Vec3` factor (albedo) and a
/// scalar apply to every layer.
pub(crate) trait Value: Linear + SubAssign + Mul<Vec3, Output = Self> + Sum {
    /// A number per layer, such as a variance; nothing where there is one layer only.
    type Scalars: Scalars;

    /// Where there are too many layers, chance decides which are told apart; the first makes all together right.
    const IS_FEW: bool = false;

    /// Light of one layer.
    fn of_layer(layer: u32, light: Vec3) -> Self;

    /// Light of some layers, of none in those that are left.
    fn of_layers(layers: &[Vec3]) -> Self;

    /// What [`Value::for_layers`] tells of light, bit for bit: layers, ascending from the first, and their light. None
    /// where that is no such light.
    fn of_told(_layers: &[u16], _lights: &[Vec3]) -> Option<Self> {
        None
    }

    /// Adds to the light of one layer.
    fn add_to_layer(&mut self, layer: u32, light: Vec3);

    /// Adds `by` times other light.
    #[inline]
    fn add_scaled(&mut self, other: &Self, by: Vec3) {
        *self += *other * by;
    }

    /// Moves towards other light by a part of the way, from 0 to 1.
    #[inline]
    fn approach(&mut self, other: &Self, part: f32) {
        *self += (*other - *self) * part;
    }

    /// A layer's light.
    fn layer(&self, layer: usize) -> Vec3;

    /// Tells the layers whose light is told apart here, and the first, with their light, where not all are.
    fn for_layers(&self, _tell: impl FnMut(usize, Vec3)) {}

    /// `factor` times the square of the light of each layer, mean over RGB.
    fn squares(&self, factor: f32) -> Self::Scalars;

    /// `factor` times the square of the difference of each layer, mean over RGB.
    #[inline]
    fn squared_difference(&self, other: &Self, factor: f32) -> Self::Scalars {
        (*self - *other).squares(factor)
    }

    /// Layers that matter little here are merged, where there is such a thing.
    #[inline]
    fn thinned(self) -> Self {
        self
    }

    /// All layers, each with its weight.
    #[inline]
    fn weighted(&self, weights: &[Vec3]) -> Vec3 {
        weights.iter().enumerate().map(|(layer, weight)| self.layer(layer) * *weight).sum()
    }
}

/// A number per layer.
pub(crate) trait Scalars: Linear {
    /// Of one layer.
    fn of_layer(&self, layer: usize) -> f32;

    /// Adds to that of one layer.
    fn add_to_layer(&mut self, layer: usize, number: f32);

    /// Tells the layers that are told apart here, and the first, with their numbers, where not all are.
    fn for_layers(&self, _tell: impl FnMut(usize, f32)) {}
}

/// Light whose layers are all there, so that sums over many elements can be had of each by itself.
pub(crate) trait Lockstep: Value {
    /// Double-precision numbers per layer and channel, for sums over many elements.
    type Wide: Wide;

    /// Numbers per layer and channel, in double precision.
    fn wide(self) -> Self::Wide;

    /// Product per layer and channel.
    fn times(self, other: Self) -> Self;

    /// Numbers per layer and channel, in single precision.
    fn narrow(wide: Self::Wide) -> Self;
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

/// Calls a function generic over what is carried, for the least that holds `$layers` layers side by side, of which there
/// are at most [`SIDE_BY_SIDE`].
macro_rules! side_by_side {
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
pub(crate) use side_by_side;

/// Calls a function generic over what is carried, for the least that holds `$layers` layers.
macro_rules! with_layers {
    ($layers:expr, $function:ident($($argument:expr),* $(,)?)) => {
        match $layers {
            layers if layers > $crate::value::SIDE_BY_SIDE => {
                $function::<$crate::value::Few<glam::Vec3>>($($argument),*)
            }
            layers => $crate::value::side_by_side!(layers, $function($($argument),*)),
        }
    };
}
pub(crate) use with_layers;
