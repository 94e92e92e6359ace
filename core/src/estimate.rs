//! What a part of a round gives, as a value that other processes can send: bytes of a format of its own.
//!
//! Little-endian: `RBKEST02`, the round's index, the part, its samples per element and the number of layers (`u32` each),
//! the number of slots (`u64`), then direct and indirect light of all slots as `f32`, linear RGB, the layers of a slot side by
//! side.

use glam::Vec3;

use crate::lightmap::LightValues;
use crate::value::SIDE_BY_SIDE;
use crate::value::Value;

const MAGIC: &[u8; 8] = b"RBKEST02";
const HEADER: usize = MAGIC.len() + 4 * size_of::<u32>() + size_of::<u64>();
const BYTES_PER_VALUE: usize = 2 * 3 * size_of::<f32>();

/// Light as one part of a round has found it.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// Which round of its bake it is of.
    pub round: u32,
    /// Which part of that.
    pub part: u32,
    /// Samples per element, at least one.
    pub samples: u32,
    layers: usize,
    /// The layers of a slot side by side.
    light: LightValues,
}

/// Why there is no estimate, or why it is not added.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EstimateError {
    /// Other bytes, or those of another version.
    #[error("these bytes are no estimate of this version")]
    NotAnEstimate,
    /// The bytes end too early or too late.
    #[error("the estimate has {found} bytes where it says that there are {expected}")]
    Length {
        /// Bytes as its numbers of slots and layers have it.
        expected: u64,
        /// Bytes that are there.
        found: u64,
    },
    /// It is of another world or of other layers.
    #[error("the estimate has {found:?} slots and layers where {expected:?} are expected")]
    Shape {
        /// Slots and layers of the map.
        expected: (u64, u64),
        /// Slots and layers of the estimate.
        found: (u64, u64),
    },
    /// No samples.
    #[error("the estimate has no samples")]
    NoSamples,
}

impl Estimate {
    /// Of light with so many layers per slot.
    pub(crate) fn new<V: Value>(
        (round, part): (u32, u32),
        samples: u32,
        layers: usize,
        light: &LightValues<V>,
    ) -> Estimate {
        let apart = |values: &[V]| values.iter().flat_map(|value| (0..layers).map(|k| value.layer(k))).collect();
        let (direct, indirect) = (apart(&light.direct), apart(&light.indirect));
        Estimate { round, part, samples, layers, light: LightValues { direct, indirect, variance: Vec::new() } }
    }

    /// Its light, the layers of a slot together.
    pub(crate) fn light<V: Value>(&self) -> LightValues<V> {
        let together = |values: &[Vec3]| values.chunks_exact(self.layers).map(V::of_layers).collect();
        let (direct, indirect) = (together(&self.light.direct), together(&self.light.indirect));
        LightValues { direct, indirect, variance: Vec::new() }
    }

    /// Slots and layers.
    pub(crate) fn shape(&self) -> (u64, u64) {
        ((self.light.len() / self.layers) as u64, self.layers as u64)
    }

    /// Whether it is one of the missing parts of a round.
    pub(crate) fn is_part_of(&self, round: u32, parts: &[u32], missing: &[u32], shape: (u64, u64)) -> bool {
        let is_wanted = self.round == round && missing.contains(&self.part);
        is_wanted && parts.get(self.part as usize) == Some(&self.samples) && self.shape() == shape
    }

    /// Whether all of its light is numbers.
    pub fn is_finite(&self) -> bool {
        self.light.direct.iter().chain(&self.light.indirect).all(|light| light.is_finite())
    }

    /// Its bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER + self.light.len() * BYTES_PER_VALUE);
        let (slots, layers) = self.shape();
        bytes.extend_from_slice(MAGIC);
        for number in [self.round, self.part, self.samples, layers as u32] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        bytes.extend_from_slice(&slots.to_le_bytes());
        for value in self.light.direct.iter().chain(&self.light.indirect) {
            value.to_array().iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
        }
        bytes
    }

    /// The estimate of some bytes. It takes no more memory than they do.
    ///
    /// # Errors
    /// Where they are not those of [`Estimate::to_bytes`], of a world of `slots` slots.
    pub fn from_bytes(bytes: &[u8], slots: usize) -> Result<Estimate, EstimateError> {
        let rest = bytes.strip_prefix(MAGIC).ok_or(EstimateError::NotAnEstimate)?;
        let (header, values) = rest.split_at_checked(HEADER - MAGIC.len()).ok_or(EstimateError::NotAnEstimate)?;
        let (numbers, count) = header.split_at(4 * size_of::<u32>());
        let mut numbers = numbers.as_chunks::<4>().0.iter().map(|number| u32::from_le_bytes(*number));
        let mut number = || numbers.next().ok_or(EstimateError::NotAnEstimate);
        let (round, part, samples, layers) = (number()?, number()?, number()?, number()?);
        let found = count.as_chunks::<8>().0.iter().map(|count| u64::from_le_bytes(*count)).sum();
        if found != slots as u64 || !(1..=SIDE_BY_SIDE as u32).contains(&layers) {
            let (expected, found) = ((slots as u64, u64::from(layers)), (found, u64::from(layers)));
            return Err(EstimateError::Shape { expected, found });
        }
        let layers = layers as usize;
        let expected = (slots as u64).saturating_mul((layers * BYTES_PER_VALUE) as u64);
        if values.len() as u64 != expected {
            let [expected, found] = [expected, values.len() as u64].map(|len| len.saturating_add(HEADER as u64));
            return Err(EstimateError::Length { expected, found });
        }
        if samples == 0 {
            return Err(EstimateError::NoSamples);
        }
        let float = |bytes: &[u8; 4]| f32::from_le_bytes(*bytes);
        let values = values.as_chunks::<12>().0.iter().map(|value| {
            let (x, y, z) = (value.first_chunk(), value[4..].first_chunk(), value[8..].first_chunk());
            Vec3::from([x, y, z].map(|bytes| bytes.map_or(0.0, float)))
        });
        let mut direct: Vec<Vec3> = values.collect();
        let indirect = direct.split_off(slots * layers);
        Ok(Estimate { round, part, samples, layers, light: LightValues { direct, indirect, variance: Vec::new() } })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::value::Layered;

    /// Any bits of numbers, such as negative zeros and what is no number.
    fn estimate() -> impl Strategy<Value = (Estimate, usize)> {
        let light = |len: usize| prop::collection::vec(any::<[u32; 6]>(), len);
        (0_usize..40, 1..=SIDE_BY_SIDE).prop_flat_map(move |(slots, layers)| {
            (any::<[u32; 2]>(), 1..=u32::MAX, light(slots * layers)).prop_map(
                move |([round, part], samples, values)| {
                    let light = |first: usize| {
                        let value =
                            move |bits: &[u32; 6]| Vec3::from([0, 1, 2].map(|k| f32::from_bits(bits[first + k])));
                        values.iter().map(value).collect::<Vec<Vec3>>()
                    };
                    let light = LightValues { direct: light(0), indirect: light(3), variance: Vec::new() };
                    (Estimate { round, part, samples, layers, light }, slots)
                },
            )
        })
    }

    proptest! {
        #[test]
        fn bytes_are_the_estimate_and_nothing_else_is((estimate, slots) in estimate(), cut in any::<prop::sample::Index>()) {
            let bytes = estimate.to_bytes();
            let back = Estimate::from_bytes(&bytes, slots).expect("its own bytes");
            prop_assert_eq!(back.to_bytes(), bytes.clone());
            prop_assert_eq!((back.round, back.part, back.samples), (estimate.round, estimate.part, estimate.samples));
            prop_assert_eq!(back.shape(), estimate.shape());
            prop_assert!(Estimate::from_bytes(&bytes[..cut.index(bytes.len())], slots).is_err());
            prop_assert!(Estimate::from_bytes(&[&bytes[..], &[0]].concat(), slots).is_err());
            prop_assert!(Estimate::from_bytes(&bytes, slots + 1).is_err());
        }

        #[test]
        fn any_bytes_are_read_without_harm(mut bytes in prop::collection::vec(any::<u8>(), 0..200), slots in 0_usize..4) {
            if let Some(start) = bytes.first_chunk_mut() {
                *start = *MAGIC;
            }
            if let Ok(estimate) = Estimate::from_bytes(&bytes, slots) {
                prop_assert_eq!(estimate.to_bytes(), bytes);
            }
        }

        #[test]
        fn layers_go_apart_and_together((estimate, slots) in estimate()) {
            let bytes = |light: &LightValues<Layered<16>>| {
                Estimate::new((estimate.round, estimate.part), estimate.samples, estimate.layers, light).to_bytes()
            };
            let light = estimate.light();
            prop_assert_eq!(light.len(), slots);
            prop_assert_eq!(bytes(&light), estimate.to_bytes());
        }
    }
}
