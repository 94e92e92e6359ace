//! Lists of indices that take no more bytes than they need.

use std::ops::Range;

/// Indices of two bytes each where all are below 65,536, and of four otherwise.
#[derive(Clone, Debug)]
pub(crate) enum Indices {
    /// Below 65,536.
    Short(Vec<u16>),
    /// Any.
    Long(Vec<u32>),
}

impl Default for Indices {
    fn default() -> Indices {
        Indices::Short(Vec::new())
    }
}

impl From<Vec<u32>> for Indices {
    fn from(mut list: Vec<u32>) -> Indices {
        let short: Result<Vec<u16>, _> = list.iter().map(|&index| u16::try_from(index)).collect();
        list.shrink_to_fit();
        short.map_or(Indices::Long(list), Indices::Short)
    }
}

impl Indices {
    /// How many there are.
    pub(crate) fn len(&self) -> usize {
        match self {
            Indices::Short(list) => list.len(),
            Indices::Long(list) => list.len(),
        }
    }

    /// One of them.
    ///
    /// # Panics
    /// Where there is none at `place`.
    #[inline]
    pub(crate) fn at(&self, place: usize) -> u32 {
        match self {
            Indices::Short(list) => list[place].into(),
            Indices::Long(list) => list[place],
        }
    }

    /// Those of a range, in their order.
    ///
    /// # Panics
    /// Where the range ends behind them.
    #[inline]
    pub(crate) fn range(&self, range: Range<usize>) -> impl Iterator<Item = u32> + Clone + '_ {
        let (short, long): (&[u16], &[u32]) = match self {
            Indices::Short(list) => (&list[range], &[]),
            Indices::Long(list) => (&[], &list[range]),
        };
        short.iter().map(|&index| index.into()).chain(long.iter().copied())
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        match self {
            Indices::Short(list) => list.capacity() * size_of::<u16>(),
            Indices::Long(list) => list.capacity() * size_of::<u32>(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn they_are_what_was_put_in_and_short_where_they_can_be() {
        for (largest, bytes) in [(65_535, 2), (65_536, 4)] {
            let list: Vec<u32> = vec![7, 0, largest, 3];
            let indices = Indices::from(list.clone());
            assert_eq!((indices.len(), indices.memory_bytes()), (4, 4 * bytes));
            assert_eq!(indices.range(0..4).collect::<Vec<_>>(), list);
            assert_eq!(indices.range(1..3).collect::<Vec<_>>(), list[1..3]);
            assert_eq!((0..4).map(|place| indices.at(place)).collect::<Vec<_>>(), list);
        }
        assert_eq!(Indices::default().range(0..0).count(), 0);
    }
}
