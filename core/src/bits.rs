//! Sets of indices that take a bit each.

/// A set of indices. It holds memory up to its largest member only: an empty one holds no words.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Bits {
    /// The last word is not 0.
    words: Vec<u64>,
}

impl Bits {
    /// Whether an index is in the set, however large it is.
    #[inline]
    pub(crate) fn contains(&self, index: usize) -> bool {
        self.words.get(index / 64).is_some_and(|word| word >> (index % 64) & 1 == 1)
    }

    /// Whether nothing is in the set.
    #[inline]
    pub(crate) fn is_empty(&self) -> bool {
        self.words.is_empty()
    }

    /// Puts an index into the set (`member`) or takes it out.
    pub(crate) fn set(&mut self, index: usize, member: bool) {
        let (word, bit) = (index / 64, 1 << (index % 64));
        if member {
            if word >= self.words.len() {
                self.words.resize(word + 1, 0);
            }
            self.words[word] |= bit;
        } else if word < self.words.len() {
            self.words[word] &= !bit;
            while self.words.last() == Some(&0) {
                self.words.pop();
            }
        }
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.words.capacity() * size_of::<u64>()
    }
}

impl FromIterator<usize> for Bits {
    fn from_iter<I: IntoIterator<Item = usize>>(members: I) -> Bits {
        let mut bits = Bits::default();
        members.into_iter().for_each(|index| bits.set(index, true));
        bits
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::Bits;

    proptest! {
        #[test]
        fn it_is_a_set(changes in prop::collection::vec((0_usize..300, any::<bool>()), 0..200)) {
            let (mut bits, mut expected) = (Bits::default(), BTreeSet::new());
            for (index, member) in changes {
                bits.set(index, member);
                if member { expected.insert(index); } else { expected.remove(&index); }
                prop_assert_eq!(bits.is_empty(), expected.is_empty());
            }
            for index in (0..400).chain([usize::MAX]) {
                prop_assert_eq!(bits.contains(index), expected.contains(&index));
            }
            // However it came about, the same set is equal.
            prop_assert_eq!(bits, expected.into_iter().collect::<Bits>());
        }
    }
}
