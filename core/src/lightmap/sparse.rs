//! Light of a layer: a lamp lights few places, and where it does not, nothing is kept. Fewer still are lit straight, where
//! it lights a room next door by what comes through the door.

use std::borrow::Cow;

use glam::Vec3;
use rayon::prelude::*;

use super::{LightPart, LightValues};

/// Slots per block: neighbours on a surface mostly, which are lit alike.
pub const BLOCK_SLOTS: usize = 64;

/// A block that is not there.
const ABSENT: u32 = u32::MAX;

/// Direct light of a block that has none.
static DARK: [Vec3; BLOCK_SLOTS] = [Vec3::ZERO; BLOCK_SLOTS];

/// Light per element slot, in blocks of [`BLOCK_SLOTS`] slots: those without any light are not there. The variance is
/// there wherever light is; direct light alone may be missing.
#[derive(Clone, Debug, Default)]
pub struct SparseLight {
    slots: usize,
    /// Per block: how many of those before it are there, or [`ABSENT`].
    places: Vec<u32>,
    /// Per block that is there: how many of those before it have direct light, or [`ABSENT`] where it has none. Empty where
    /// all have some.
    lit_places: Vec<u32>,
    /// Values of the blocks that are there, one after the other: direct light of those that have some.
    values: LightValues,
}

/// Light of consecutive slots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightBlock<'a> {
    /// As [`LightValues::direct`].
    pub direct: &'a [Vec3],
    /// As [`LightValues::indirect`].
    pub indirect: &'a [Vec3],
    /// As [`LightValues::variance`].
    pub variance: &'a [f32],
}

impl LightBlock<'_> {
    /// Whether every bit of it is zero.
    fn is_empty(&self) -> bool {
        is_dark(self.direct) && is_dark(self.indirect) && self.variance.iter().all(|v| v.to_bits() == 0)
    }
}

/// Whether every bit of some light is zero.
fn is_dark(light: &[Vec3]) -> bool {
    light.iter().all(|light| light.to_array().iter().all(|x| x.to_bits() == 0))
}

/// How many blocks so many slots are in.
pub fn blocks_of(slots: usize) -> usize {
    slots.div_ceil(BLOCK_SLOTS)
}

/// Light of all slots, or of those in some blocks.
#[derive(Clone, Copy, Debug)]
pub(crate) enum AnyLight<'a> {
    Dense(&'a LightValues),
    Sparse(&'a SparseLight),
}

impl<'a> AnyLight<'a> {
    pub(crate) fn len(&self) -> usize {
        match self {
            AnyLight::Dense(light) => light.len(),
            AnyLight::Sparse(light) => light.len(),
        }
    }

    /// The light of a block; none where there is none.
    #[inline]
    pub(crate) fn block(&self, block: usize) -> Option<LightBlock<'a>> {
        match *self {
            AnyLight::Dense(light) => Some(light.block(block)),
            AnyLight::Sparse(light) => light.block(block),
        }
    }
}

impl LightValues {
    /// The slots of a block.
    #[inline]
    pub(crate) fn block(&self, block: usize) -> LightBlock<'_> {
        let first = block * BLOCK_SLOTS;
        self.range(first, BLOCK_SLOTS.min(self.len() - first))
    }

    /// Some consecutive slots.
    #[inline]
    pub(crate) fn range(&self, first: usize, slots: usize) -> LightBlock<'_> {
        let slots = first..first + slots;
        LightBlock {
            direct: &self.direct[slots.clone()],
            indirect: &self.indirect[slots.clone()],
            variance: self.variance.get(slots).unwrap_or_default(),
        }
    }

    /// The light of a block, alone.
    pub(crate) fn of_block(block: &LightBlock) -> LightValues {
        let mut values = LightValues::default();
        values.direct.extend_from_slice(block.direct);
        values.push_bounces(block);
        values
    }

    /// Indirect light, and the variance.
    fn push_bounces(&mut self, block: &LightBlock) {
        self.indirect.extend_from_slice(block.indirect);
        self.variance.extend_from_slice(block.variance);
    }
}

impl SparseLight {
    /// No light in `slots` slots.
    pub fn black(slots: usize) -> SparseLight {
        SparseLight { slots, places: vec![ABSENT; blocks_of(slots)], ..SparseLight::default() }
    }

    /// The values of some blocks, ascending, each with its index. All but the last block of all have [`BLOCK_SLOTS`]
    /// slots.
    ///
    /// # Panics
    /// Where they do not ascend, or do not have the length that they should.
    pub fn of_blocks<'a>(slots: usize, blocks: impl IntoIterator<Item = (usize, LightBlock<'a>)>) -> SparseLight {
        let blocks: Vec<(usize, LightBlock<'a>)> = blocks.into_iter().collect();
        let is_lit: Vec<bool> = blocks.iter().map(|(_, block)| !is_dark(block.direct)).collect();
        let lit = is_lit.iter().filter(|is_lit| **is_lit).count();
        let (all, lit_slots) = (blocks.len() * BLOCK_SLOTS, lit * BLOCK_SLOTS);
        let mut light = SparseLight::black(slots);
        // No more than it takes, at once: what grows is copied, and then twice as large.
        light.values.direct.reserve_exact(lit_slots.min(slots));
        light.values.indirect.reserve_exact(all.min(slots));
        light.values.variance.reserve_exact(all.min(slots));
        let mut next = 0;
        for (count, ((index, block), is_lit)) in blocks.iter().zip(&is_lit).enumerate() {
            let len = BLOCK_SLOTS.min(slots - index * BLOCK_SLOTS);
            assert!(block.direct.len() == len && block.indirect.len() == len, "a value per slot");
            assert!(*index >= next, "blocks in their order");
            light.places[*index] = count as u32;
            light.values.push_bounces(block);
            if *is_lit {
                light.values.direct.extend_from_slice(block.direct);
            }
            next = index + 1;
        }
        if lit < blocks.len() {
            let mut before = 0..;
            let place = |is_lit: &bool| if *is_lit { before.next().unwrap_or(ABSENT) } else { ABSENT };
            light.lit_places = is_lit.iter().map(place).collect();
        }
        light
    }

    /// Slots, empty ones included.
    pub fn len(&self) -> usize {
        self.slots
    }

    /// Whether there is no slot.
    pub fn is_empty(&self) -> bool {
        self.slots == 0
    }

    /// The light of a block; none where there is none.
    ///
    /// # Panics
    /// Where there is no such block.
    #[inline]
    pub fn block(&self, block: usize) -> Option<LightBlock<'_>> {
        let place = self.places[block];
        if place == ABSENT {
            return None;
        }
        let len = BLOCK_SLOTS.min(self.slots - block * BLOCK_SLOTS);
        let range = |place: u32| place as usize * BLOCK_SLOTS..place as usize * BLOCK_SLOTS + len;
        let lit = self.lit_places.get(place as usize).copied().unwrap_or(place);
        let LightValues { direct, indirect, variance } = &self.values;
        Some(LightBlock {
            direct: if lit == ABSENT { &DARK[..len] } else { &direct[range(lit)] },
            indirect: &indirect[range(place)],
            variance: variance.get(range(place)).unwrap_or_default(),
        })
    }

    /// The blocks that are there, ascending, each with its index.
    pub fn blocks(&self) -> impl Iterator<Item = (usize, LightBlock<'_>)> {
        (0..self.places.len()).filter_map(|block| Some((block, self.block(block)?)))
    }

    /// Direct and indirect light of a slot.
    ///
    /// # Panics
    /// Where there is no such slot.
    pub fn at(&self, slot: usize) -> (Vec3, Vec3) {
        let within = slot % BLOCK_SLOTS;
        let at = |block: LightBlock| (block.direct[within], block.indirect[within]);
        self.block(slot / BLOCK_SLOTS).map_or((Vec3::ZERO, Vec3::ZERO), at)
    }

    /// Some of the light, per slot.
    pub fn part(&self, part: LightPart) -> Cow<'_, [Vec3]> {
        if self.is_whole() {
            return self.values.part(part);
        }
        let mut out = vec![Vec3::ZERO; self.slots];
        for (index, block) in self.blocks() {
            let out = &mut out[index * BLOCK_SLOTS..][..block.direct.len()];
            match part {
                LightPart::Direct => out.copy_from_slice(block.direct),
                LightPart::Indirect => out.copy_from_slice(block.indirect),
                LightPart::Full => {
                    out.iter_mut().zip(block.direct).zip(block.indirect).for_each(|((out, d), i)| *out = *d + *i);
                }
            }
        }
        out.into()
    }

    /// Variance per slot.
    pub fn variance(&self) -> Cow<'_, [f32]> {
        if self.is_whole() {
            return Cow::Borrowed(&self.values.variance);
        }
        let mut out = vec![0.0; self.slots];
        for (index, block) in self.blocks() {
            out[index * BLOCK_SLOTS..][..block.variance.len()].copy_from_slice(block.variance);
        }
        out.into()
    }

    /// Light of all slots.
    pub fn to_dense(&self) -> LightValues {
        if self.is_whole() {
            return self.values.clone();
        }
        LightValues {
            direct: self.part(LightPart::Direct).into_owned(),
            indirect: self.part(LightPart::Indirect).into_owned(),
            variance: self.variance().into_owned(),
        }
    }

    /// `factor` times it.
    pub(crate) fn scaled(&self, factor: Vec3) -> SparseLight {
        let square = factor.length_squared() / 3.0;
        let mut light = self.clone();
        let LightValues { direct, indirect, variance } = &mut light.values;
        direct.iter_mut().chain(indirect).for_each(|value| *value *= factor);
        variance.iter_mut().for_each(|value| *value *= square);
        light
    }

    /// Cut to `slots` slots, or with some more without light.
    pub fn resized(&self, slots: usize) -> SparseLight {
        if slots == self.slots {
            return self.clone();
        }
        let mut values = self.to_dense();
        values.resize(slots);
        values.into()
    }

    /// Bytes that it holds.
    pub fn memory_bytes(&self) -> usize {
        let LightValues { direct, indirect, variance } = &self.values;
        size_of_val(self.places.as_slice())
            + size_of_val(self.lit_places.as_slice())
            + size_of_val(direct.as_slice())
            + size_of_val(indirect.as_slice())
            + size_of_val(variance.as_slice())
    }

    /// Whether every block is there, and has direct light: values lie as slots do.
    fn is_whole(&self) -> bool {
        self.values.direct.len() == self.slots
    }
}

impl From<LightValues> for SparseLight {
    fn from(values: LightValues) -> SparseLight {
        let slots = values.len();
        let is_there = |block: usize| !values.block(block).is_empty();
        let there: Vec<bool> = (0..blocks_of(slots)).into_par_iter().with_min_len(64).map(is_there).collect();
        if there.iter().all(|is| *is) {
            // As they are: a copy would take longer than it is worth.
            return SparseLight { slots, places: (0..there.len() as u32).collect(), lit_places: Vec::new(), values };
        }
        let blocks = there.iter().enumerate().filter(|(_, is)| **is).map(|(block, _)| (block, values.block(block)));
        SparseLight::of_blocks(slots, blocks)
    }
}

impl PartialEq for SparseLight {
    /// Whether two have the same light in the same slots; a block that is not there and one of zeros are the same.
    fn eq(&self, other: &SparseLight) -> bool {
        let same = |block: usize| match (self.block(block), other.block(block)) {
            (Some(a), Some(b)) => a == b,
            (Some(one), None) | (None, Some(one)) => one.is_empty(),
            (None, None) => true,
        };
        self.slots == other.slots && (0..self.places.len()).all(same)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Some slots, of which runs are lit.
    fn light() -> impl Strategy<Value = LightValues> {
        prop::collection::vec((0_usize..90, any::<bool>(), -2.0_f32..2.0), 0..12).prop_map(|runs| {
            let mut light = LightValues::default();
            for (len, is_lit, value) in runs {
                let value = if is_lit { value } else { 0.0 };
                let is_straight = value > -1.0;
                let straight = |k| Vec3::new(value, 0.0, value * k as f32);
                light.direct.extend((0..len).map(|k| if is_straight { straight(k) } else { Vec3::ZERO }));
                light.indirect.extend((0..len).map(|_| Vec3::splat(-value)));
                light.variance.extend((0..len).map(|_| value * value));
            }
            light
        })
    }

    proptest! {
        #[test]
        fn light_comes_back_bit_for_bit(values in light(), more in 0_usize..200) {
            let sparse = SparseLight::from(values.clone());
            let bits = |light: &LightValues| {
                let numbers = light.direct.iter().chain(&light.indirect).flat_map(|v| v.to_array());
                numbers.chain(light.variance.iter().copied()).map(f32::to_bits).collect::<Vec<u32>>()
            };
            prop_assert_eq!(bits(&sparse.to_dense()), bits(&values));
            for part in [LightPart::Full, LightPart::Direct, LightPart::Indirect] {
                prop_assert_eq!(sparse.part(part), values.part(part));
            }
            prop_assert_eq!(&*sparse.variance(), &*values.variance);
            for slot in 0..values.len() {
                prop_assert_eq!(sparse.at(slot), (values.direct[slot], values.indirect[slot]));
            }
            let again = SparseLight::of_blocks(sparse.len(), sparse.blocks());
            prop_assert!(again == sparse);
            for slots in [values.len() + more, values.len().saturating_sub(more)] {
                let mut expected = values.clone();
                expected.resize(slots);
                prop_assert_eq!(sparse.resized(slots).to_dense(), expected);
            }
            let there: Vec<LightBlock> =
                (0..blocks_of(values.len())).map(|block| values.block(block)).filter(|block| !block.is_empty()).collect();
            prop_assert_eq!(sparse.blocks().count(), there.len());
            // What is not there takes no room.
            let lit = there.iter().filter(|block| !is_dark(block.direct)).map(|block| block.direct.len()).sum::<usize>();
            prop_assert_eq!(again.values.direct.len(), lit);
            prop_assert_eq!(again.values.indirect.len(), there.iter().map(|block| block.indirect.len()).sum::<usize>());
        }
    }
}
