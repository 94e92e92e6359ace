//! Arrays whose copies share what they have in common.

use std::ops::{Index, Range};
use std::sync::Arc;

use rayon::prelude::*;

/// Values per chunk: small beside a scene, so that an edit of one object copies little, and large beside the pointer
/// that a copy takes per chunk.
const CHUNK: usize = 1024;

/// An array of values in chunks. A copy shares all chunks; a change copies those that it touches.
#[derive(Clone)]
pub struct Chunks<T> {
    /// What lies behind `len` in the last one is the default.
    chunks: Vec<Arc<[T; CHUNK]>>,
    len: usize,
}

impl<T: Copy + Default> Chunks<T> {
    /// Number of values.
    #[inline]
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there is no value.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// A value; none behind the end.
    #[inline]
    pub fn get(&self, index: usize) -> Option<&T> {
        (index < self.len).then(|| &self.chunks[index / CHUNK][index % CHUNK])
    }

    /// All values in their order.
    pub fn iter(&self) -> impl Iterator<Item = &T> {
        self.chunks.iter().flat_map(|chunk| chunk.iter()).take(self.len)
    }

    /// All values in their order, for several threads.
    pub fn par_iter(&self) -> impl IndexedParallelIterator<Item = &T>
    where
        T: Send + Sync,
    {
        (0..self.len).into_par_iter().map(|index| &self[index])
    }

    /// The values of a range.
    ///
    /// # Panics
    /// Where the range ends behind the array.
    pub fn range(&self, range: Range<usize>) -> impl ExactSizeIterator<Item = &T> {
        assert!(range.end <= self.len, "{} of {}", range.end, self.len);
        range.map(|index| &self.chunks[index / CHUNK][index % CHUNK])
    }

    /// The values of a range, copied.
    ///
    /// # Panics
    /// Where the range ends behind the array.
    pub fn copy(&self, range: Range<usize>) -> Vec<T> {
        self.range(range).copied().collect()
    }

    /// Makes room for so many values, and no more.
    pub(crate) fn reserve(&mut self, len: usize) {
        self.chunks.reserve_exact(len.div_ceil(CHUNK).saturating_sub(self.chunks.len()));
    }

    /// As many values, those that come being the default.
    pub(crate) fn grow(&mut self, len: usize) {
        let empty = || Arc::new([T::default(); CHUNK]);
        self.chunks.resize_with(len.div_ceil(CHUNK).max(self.chunks.len()), empty);
        self.len = len.max(self.len);
    }

    /// Puts other values in the place of those from `first` on.
    ///
    /// # Panics
    /// Where they end behind the array.
    pub(crate) fn write(&mut self, first: usize, values: &[T]) {
        let mut values = values;
        self.change(first..first + values.len(), |part| {
            let (now, later) = values.split_at(part.len());
            part.copy_from_slice(now);
            values = later;
        });
    }

    /// Puts one value in the place of all of a range.
    ///
    /// # Panics
    /// Where it ends behind the array.
    pub(crate) fn fill(&mut self, range: Range<usize>, value: T) {
        self.change(range, |part| part.fill(value));
    }

    /// Changes the values of a range, one chunk's after the other.
    fn change(&mut self, range: Range<usize>, mut change: impl FnMut(&mut [T])) {
        assert!(range.end <= self.len, "{} of {}", range.end, self.len);
        let mut from = range.start;
        while from < range.end {
            let first = from % CHUNK;
            let count = (CHUNK - first).min(range.end - from);
            change(&mut Arc::make_mut(&mut self.chunks[from / CHUNK])[first..first + count]);
            from += count;
        }
    }

    /// Bytes held, those that others share included.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.chunks.len() * size_of::<[T; CHUNK]>() + self.chunks.capacity() * size_of::<Arc<[T; CHUNK]>>()
    }

    /// Bytes of chunks that `other` does not share.
    #[cfg(test)]
    pub(crate) fn own_bytes(&self, other: &Chunks<T>) -> usize {
        let is_own = |(index, chunk): &(usize, &Arc<[T; CHUNK]>)| {
            !other.chunks.get(*index).is_some_and(|other| Arc::ptr_eq(chunk, other))
        };
        self.chunks.iter().enumerate().filter(is_own).count() * size_of::<[T; CHUNK]>()
    }
}

impl<T> Default for Chunks<T> {
    fn default() -> Chunks<T> {
        Chunks { chunks: Vec::new(), len: 0 }
    }
}

impl<T> Index<usize> for Chunks<T> {
    type Output = T;

    #[inline]
    fn index(&self, index: usize) -> &T {
        debug_assert!(index < self.len);
        &self.chunks[index / CHUNK][index % CHUNK]
    }
}

impl<T: Copy + Default + std::fmt::Debug> std::fmt::Debug for Chunks<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

impl<T: Copy + Default + PartialEq> PartialEq for Chunks<T> {
    fn eq(&self, other: &Chunks<T>) -> bool {
        let is_same = |(a, b): (&Arc<[T; CHUNK]>, &Arc<[T; CHUNK]>)| Arc::ptr_eq(a, b) || a == b;
        self.len == other.len && self.chunks.iter().zip(&other.chunks).all(is_same)
    }
}

impl<T: Copy + Default> From<&[T]> for Chunks<T> {
    fn from(values: &[T]) -> Chunks<T> {
        let mut chunks = Chunks::default();
        chunks.grow(values.len());
        chunks.write(0, values);
        chunks
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[derive(Clone, Debug)]
    enum Change {
        Grow(usize),
        Write(usize, Vec<u32>),
        Fill(usize, usize, u32),
    }

    fn change() -> impl Strategy<Value = Change> {
        prop_oneof![
            (0_usize..4000).prop_map(Change::Grow),
            (0_usize..4000, prop::collection::vec(any::<u32>(), 0..2500)).prop_map(|(at, v)| Change::Write(at, v)),
            (0_usize..4000, 0_usize..2500, any::<u32>()).prop_map(|(at, count, v)| Change::Fill(at, count, v)),
        ]
    }

    proptest! {
        #[test]
        fn it_is_an_array_and_copies_stay_as_they_were(changes in prop::collection::vec(change(), 0..12)) {
            let (mut chunks, mut expected) = (Chunks::default(), Vec::new());
            let mut copies = Vec::new();
            for change in changes {
                copies.push((chunks.clone(), expected.clone()));
                match change {
                    Change::Grow(len) => {
                        chunks.grow(len);
                        expected.resize(len.max(expected.len()), 0);
                    }
                    Change::Write(at, values) if at + values.len() <= expected.len() => {
                        chunks.write(at, &values);
                        expected[at..at + values.len()].copy_from_slice(&values);
                    }
                    Change::Fill(at, count, value) if at + count <= expected.len() => {
                        chunks.fill(at..at + count, value);
                        expected[at..at + count].fill(value);
                    }
                    Change::Write(..) | Change::Fill(..) => {}
                }
            }
            copies.push((chunks, expected));
            for (copy, expected) in copies {
                prop_assert_eq!(copy.iter().copied().collect::<Vec<_>>(), expected.clone());
                prop_assert_eq!(copy.par_iter().copied().collect::<Vec<_>>(), expected.clone());
                prop_assert_eq!(copy.get(expected.len()), None);
                prop_assert_eq!(copy.len(), expected.len());
                let half = expected.len() / 2;
                prop_assert_eq!(copy.copy(half..expected.len()), expected[half..].to_vec());
                prop_assert_eq!(&copy, &Chunks::from(&expected[..]));
            }
        }
    }

    #[test]
    fn a_change_copies_what_it_touches() {
        let values = Chunks::from(&vec![1.0_f32; 100 * CHUNK][..]);
        let mut changed = values.clone();
        assert_eq!(changed.own_bytes(&values), 0);
        changed.write(5 * CHUNK + 1, &[2.0, 3.0]);
        assert_eq!(changed.own_bytes(&values), CHUNK * size_of::<f32>());
        assert_ne!(changed, values);
    }
}
