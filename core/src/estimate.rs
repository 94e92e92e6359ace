//! What a part of a round gives, as a value that other processes can send: bytes of a format of its own.
//!
//! Little-endian: `RBKEST03`, the round's index, the part, its samples per element and the number of layers (`u32` each),
//! the number of slots (`u64`), then direct light of all slots, then indirect light, as `f32`, linear RGB. Of up to 16
//! layers a slot has all, side by side. Of more it has those that are told apart there: how many (`u8`), which (`u16`
//! each, ascending; the first is always one, and has what is left of all), and their light.

use glam::Vec3;

use crate::lightmap::{LightValues, MAX_LAYERS};
use crate::value::{Few, SIDE_BY_SIDE, Value};

const MAGIC: &[u8; 8] = b"RBKEST03";
const HEADER: usize = MAGIC.len() + 4 * size_of::<u32>() + size_of::<u64>();
const BYTES_PER_VALUE: usize = 3 * size_of::<f32>();

/// Light as one part of a round has found it.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// Which round of its bake it is of.
    pub round: u32,
    /// Which part of that.
    pub part: u32,
    /// Samples per element, at least one.
    pub samples: u32,
    slots: usize,
    layers: usize,
    direct: Rows,
    indirect: Rows,
}

/// Light of all slots, one after the other.
#[derive(Clone, Debug, Default, PartialEq)]
struct Rows {
    /// Per slot, how many layers are told apart there; none where all are, everywhere.
    counts: Vec<u8>,
    /// Which, slot by slot; none where all are.
    told: Vec<u16>,
    /// The light of each.
    light: Vec<Vec3>,
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
        /// Bytes as its numbers of slots and layers have it; of more than 16 layers those that are read before it is
        /// clear that it is none.
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
    /// A slot has layers that there are not, or has them in no order.
    #[error("slot {slot} has layers that there are not, or not ascending from the first")]
    Layers {
        /// The first such slot.
        slot: u64,
    },
    /// No samples.
    #[error("the estimate has no samples")]
    NoSamples,
}

impl Rows {
    /// Of light with so many layers per slot.
    fn new<V: Value>(values: &[V], layers: usize) -> Rows {
        if !V::IS_FEW {
            let light = values.iter().flat_map(|value| (0..layers).map(|k| value.layer(k))).collect();
            return Rows { light, ..Rows::default() };
        }
        let mut rows = Rows { counts: Vec::with_capacity(values.len()), ..Rows::default() };
        for value in values {
            let before = rows.told.len();
            value.for_layers(|layer, light| {
                rows.told.push(layer as u16);
                rows.light.push(light);
            });
            rows.counts.push((rows.told.len() - before) as u8);
        }
        rows
    }

    /// The layers of a slot together.
    fn values<V: Value>(&self, layers: usize) -> Vec<V> {
        if self.counts.is_empty() {
            return self.light.chunks_exact(layers).map(V::of_layers).collect();
        }
        let mut first = 0;
        let value = |&count: &u8| {
            let row = first..first + usize::from(count);
            first = row.end;
            // They were told by such light, or checked when they were read.
            V::of_told(&self.told[row.clone()], &self.light[row]).unwrap_or_default()
        };
        self.counts.iter().map(value).collect()
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        if self.counts.is_empty() {
            return self.light.iter().for_each(|light| write_light(bytes, *light));
        }
        let mut first = 0;
        for &count in &self.counts {
            let row = first..first + usize::from(count);
            first = row.end;
            bytes.push(count);
            self.told[row.clone()].iter().for_each(|layer| bytes.extend_from_slice(&layer.to_le_bytes()));
            self.light[row].iter().for_each(|light| write_light(bytes, *light));
        }
    }
}

fn write_light(bytes: &mut Vec<u8>, light: Vec3) {
    light.to_array().iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
}

/// Bytes that are left to be read.
struct Rest<'b> {
    left: &'b [u8],
    /// Bytes of the whole.
    all: usize,
}

impl<'b> Rest<'b> {
    fn take(&mut self, count: usize) -> Result<&'b [u8], EstimateError> {
        let (taken, left) = self.left.split_at_checked(count).ok_or_else(|| self.length(count))?;
        self.left = left;
        Ok(taken)
    }

    /// That there are not `count` more bytes, and no others.
    fn length(&self, count: usize) -> EstimateError {
        let read = (self.all - self.left.len()) as u64;
        EstimateError::Length { expected: read.saturating_add(count as u64), found: self.all as u64 }
    }

    fn light(&mut self, count: usize) -> Result<impl Iterator<Item = Vec3> + 'b, EstimateError> {
        let float = |bytes: &[u8; 4]| f32::from_le_bytes(*bytes);
        let bytes = self.take(count.saturating_mul(BYTES_PER_VALUE))?;
        Ok(bytes.as_chunks::<12>().0.iter().map(move |value| {
            let (x, y, z) = (value.first_chunk(), value[4..].first_chunk(), value[8..].first_chunk());
            Vec3::from([x, y, z].map(|bytes| bytes.map_or(0.0, float)))
        }))
    }

    fn rows(&mut self, slots: usize, layers: usize) -> Result<Rows, EstimateError> {
        let mut rows = Rows::default();
        if layers <= SIDE_BY_SIDE {
            rows.light = self.light(slots.saturating_mul(layers))?.collect();
            return Ok(rows);
        }
        for slot in 0..slots {
            let count = self.take(1)?[0];
            let first = rows.told.len();
            let told = self.take(usize::from(count) * size_of::<u16>())?.as_chunks::<2>().0;
            rows.told.extend(told.iter().map(|layer| u16::from_le_bytes(*layer)));
            rows.light.extend(self.light(usize::from(count))?);
            rows.counts.push(count);
            let (told, light) = (&rows.told[first..], &rows.light[first..]);
            let is_told = told.last().is_some_and(|last| usize::from(*last) < layers);
            if !is_told || Few::of_told(told, light).is_none() {
                return Err(EstimateError::Layers { slot: slot as u64 });
            }
        }
        Ok(rows)
    }
}

impl Estimate {
    /// Of light with so many layers per slot.
    pub(crate) fn new<V: Value>(
        (round, part): (u32, u32),
        samples: u32,
        layers: usize,
        light: &LightValues<V>,
    ) -> Estimate {
        let (direct, indirect) = (Rows::new(&light.direct, layers), Rows::new(&light.indirect, layers));
        Estimate { round, part, samples, slots: light.direct.len(), layers, direct, indirect }
    }

    /// Its light, the layers of a slot together.
    pub(crate) fn light<V: Value>(&self) -> LightValues<V> {
        let (direct, indirect) = (self.direct.values(self.layers), self.indirect.values(self.layers));
        LightValues { direct, indirect, variance: Vec::new() }
    }

    /// Slots and layers.
    pub(crate) fn shape(&self) -> (u64, u64) {
        (self.slots as u64, self.layers as u64)
    }

    /// Whether it is one of the missing parts of a round.
    pub(crate) fn is_part_of(&self, round: u32, parts: &[u32], missing: &[u32], shape: (u64, u64)) -> bool {
        let is_wanted = self.round == round && missing.contains(&self.part);
        is_wanted && parts.get(self.part as usize) == Some(&self.samples) && self.shape() == shape
    }

    /// Whether all of its light is numbers.
    pub fn is_finite(&self) -> bool {
        self.direct.light.iter().chain(&self.indirect.light).all(|light| light.is_finite())
    }

    /// Its bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let values = self.direct.light.len() + self.indirect.light.len();
        let of_rows = self.direct.counts.len() + self.indirect.counts.len() + size_of::<u16>() * values;
        let more = if self.direct.counts.is_empty() { 0 } else { of_rows };
        let mut bytes = Vec::with_capacity(HEADER + values * BYTES_PER_VALUE + more);
        bytes.extend_from_slice(MAGIC);
        for number in [self.round, self.part, self.samples, self.layers as u32] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        bytes.extend_from_slice(&(self.slots as u64).to_le_bytes());
        self.direct.write(&mut bytes);
        self.indirect.write(&mut bytes);
        bytes
    }

    /// The estimate of some bytes. It takes hardly more memory than they do.
    ///
    /// # Errors
    /// Where they are not those of [`Estimate::to_bytes`], of a world of `slots` slots.
    pub fn from_bytes(bytes: &[u8], slots: usize) -> Result<Estimate, EstimateError> {
        let rest = bytes.strip_prefix(MAGIC).ok_or(EstimateError::NotAnEstimate)?;
        let (header, left) = rest.split_at_checked(HEADER - MAGIC.len()).ok_or(EstimateError::NotAnEstimate)?;
        let (numbers, count) = header.split_at(4 * size_of::<u32>());
        let mut numbers = numbers.as_chunks::<4>().0.iter().map(|number| u32::from_le_bytes(*number));
        let mut number = || numbers.next().ok_or(EstimateError::NotAnEstimate);
        let (round, part, samples, layers) = (number()?, number()?, number()?, number()?);
        let found = count.as_chunks::<8>().0.iter().map(|count| u64::from_le_bytes(*count)).sum();
        if found != slots as u64 || !(1..=MAX_LAYERS as u32).contains(&layers) {
            let (expected, found) = ((slots as u64, u64::from(layers)), (found, u64::from(layers)));
            return Err(EstimateError::Shape { expected, found });
        }
        if samples == 0 {
            return Err(EstimateError::NoSamples);
        }
        let layers = layers as usize;
        let mut rest = Rest { left, all: bytes.len() };
        let (direct, indirect) = (rest.rows(slots, layers)?, rest.rows(slots, layers)?);
        match rest.left {
            [] => Ok(Estimate { round, part, samples, slots, layers, direct, indirect }),
            _ => Err(rest.length(0)),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::value::Layered;

    /// Any bits of numbers, such as negative zeros and what is no number; up to so many layers.
    fn estimate(layers: usize) -> impl Strategy<Value = (Estimate, usize)> {
        (0_usize..40, 1..=layers).prop_flat_map(|(slots, layers)| {
            let parts = (any::<[u32; 2]>(), 1..=u32::MAX, rows(slots, layers), rows(slots, layers));
            parts.prop_map(move |([round, part], samples, direct, indirect)| {
                (Estimate { round, part, samples, slots, layers, direct, indirect }, slots)
            })
        })
    }

    fn light() -> impl Strategy<Value = Vec3> {
        any::<[u32; 3]>().prop_map(|bits| Vec3::from(bits.map(f32::from_bits)))
    }

    fn rows(slots: usize, layers: usize) -> BoxedStrategy<Rows> {
        if layers <= SIDE_BY_SIDE {
            let all = prop::collection::vec(light(), slots * layers);
            return all.prop_map(|light| Rows { light, ..Rows::default() }).boxed();
        }
        let others = prop::collection::btree_map(1..layers as u16, light(), 0..=SIDE_BY_SIDE);
        let row =
            (light(), others).prop_map(|(rest, others)| std::iter::once((0, rest)).chain(others).collect::<Vec<_>>());
        let of_rows = |all: Vec<Vec<(u16, Vec3)>>| {
            let counts = all.iter().map(|row| row.len() as u8).collect();
            let (told, light) = all.into_iter().flatten().unzip();
            Rows { counts, told, light }
        };
        prop::collection::vec(row, slots).prop_map(of_rows).boxed()
    }

    proptest! {
        #[test]
        fn bytes_are_the_estimate_and_nothing_else_is((estimate, slots) in estimate(40), cut in any::<prop::sample::Index>()) {
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
        fn any_bytes_are_read_without_harm(mut bytes in prop::collection::vec(any::<u8>(), 0..200), slots in 0_usize..4, layers in 0_u8..40) {
            if let Some(start) = bytes.first_chunk_mut() {
                *start = *MAGIC;
            }
            if bytes.len() >= HEADER {
                bytes[20..24].copy_from_slice(&[layers, 0, 0, 0]);
                bytes[24..32].copy_from_slice(&(slots as u64).to_le_bytes());
            }
            if let Ok(estimate) = Estimate::from_bytes(&bytes, slots) {
                prop_assert_eq!(estimate.to_bytes(), bytes);
            }
        }

        #[test]
        fn layers_go_apart_and_together((estimate, slots) in estimate(2 * SIDE_BY_SIDE)) {
            fn again<V: Value>(estimate: &Estimate) -> (usize, Vec<u8>) {
                let light: LightValues<V> = estimate.light();
                let again = Estimate::new((estimate.round, estimate.part), estimate.samples, estimate.layers, &light);
                (light.direct.len(), again.to_bytes())
            }
            let is_few = estimate.layers > SIDE_BY_SIDE;
            let (len, bytes) = if is_few { again::<Few<Vec3>>(&estimate) } else { again::<Layered<16>>(&estimate) };
            prop_assert_eq!(len, slots);
            prop_assert_eq!(bytes, estimate.to_bytes());
        }
    }

    /// Of more layers than lie side by side a slot has some, and no others than there are.
    #[test]
    fn layers_that_there_are_not_are_refused() {
        let row = |told: &[u16]| Rows {
            counts: vec![told.len() as u8],
            told: told.to_vec(),
            light: vec![Vec3::ONE; told.len()],
        };
        let read = |told: &[u16]| {
            let (direct, indirect) = (row(&[0]), row(told));
            let estimate = Estimate { round: 0, part: 0, samples: 1, slots: 1, layers: 20, direct, indirect };
            Estimate::from_bytes(&estimate.to_bytes(), 1).err()
        };
        assert_eq!(read(&[0, 3, 19]), None);
        let all: Vec<u16> = (0..18).collect();
        for told in [&[][..], &[1], &[0, 3, 3], &[0, 4, 3], &[0, 20], &all] {
            assert_eq!(read(told), Some(EstimateError::Layers { slot: 0 }), "{told:?}");
        }
    }
}
