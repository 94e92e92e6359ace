//! Triangles taken out of a tree without rebuilding it.

/// One bit per triangle id; a set bit means the triangle is gone: rays pass through it.
///
/// Ids that were never set are present, whatever their size.
#[derive(Clone, Debug, Default)]
pub struct TriangleMask {
    words: Vec<u64>,
    set_bits: usize,
}

impl TriangleMask {
    /// A mask with nothing gone and room for the ids `0..capacity`. It grows on demand.
    pub fn new(capacity: usize) -> Self {
        Self { words: vec![0; capacity.div_ceil(64)], set_bits: 0 }
    }

    /// Takes a triangle out (`gone`) or puts it back.
    pub fn set(&mut self, id: u32, gone: bool) {
        let (word, bit) = (id as usize / 64, 1 << (id % 64));
        if self.get(id) == gone {
            return;
        }
        if gone {
            if word >= self.words.len() {
                self.words.resize(word + 1, 0);
            }
            self.words[word] |= bit;
            self.set_bits += 1;
        } else {
            self.words[word] &= !bit;
            self.set_bits -= 1;
        }
    }

    /// Whether the triangle is gone.
    #[inline]
    pub fn get(&self, id: u32) -> bool {
        self.words.get(id as usize / 64).is_some_and(|word| word >> (id % 64) & 1 != 0)
    }

    /// Whether any triangle is gone. Constant time: a tree asks once per ray.
    #[inline]
    pub fn any(&self) -> bool {
        self.set_bits != 0
    }

    /// Number of triangles gone.
    pub fn count(&self) -> usize {
        self.set_bits
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_grows_and_counts() {
        let mut mask = TriangleMask::new(3);
        assert!(!mask.any());
        assert!(!mask.get(u32::MAX));
        mask.set(1000, false);
        assert!(!mask.any());
        for _ in 0..2 {
            mask.set(1000, true);
            mask.set(63, true);
        }
        assert_eq!((mask.count(), mask.get(1000), mask.get(63), mask.get(64)), (2, true, true, false));
        mask.set(63, false);
        mask.set(1000, false);
        assert!(!mask.any());
    }
}
