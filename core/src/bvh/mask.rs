//! Triangles taken out of a tree without rebuilding it.

use crate::bits::Bits;

/// Ids of triangles that are gone: rays pass through them.
///
/// Ids that were never set are present, whatever their size.
#[derive(Clone, Debug, Default)]
pub struct TriangleMask {
    removed: Bits,
}

impl TriangleMask {
    /// Takes a triangle out (`gone`) or puts it back.
    pub fn set(&mut self, id: u32, removed: bool) {
        self.removed.set(id as usize, removed);
    }

    /// Whether the triangle is gone.
    #[inline]
    pub fn get(&self, id: u32) -> bool {
        self.removed.contains(id as usize)
    }

    /// Whether any triangle is gone. Constant time: a tree asks once per ray.
    #[inline]
    pub fn any(&self) -> bool {
        !self.removed.is_empty()
    }
}
