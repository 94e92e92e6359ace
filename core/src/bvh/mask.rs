//! Triangles taken out of a tree without rebuilding it.

use crate::bits::Bits;

/// Ids of triangles that are gone: rays pass through them.
///
/// Ids that were never set are present, whatever their size.
#[derive(Clone, Debug, Default)]
pub struct TriangleMask {
    gone: Bits,
}

impl TriangleMask {
    /// Takes a triangle out (`gone`) or puts it back.
    pub fn set(&mut self, id: u32, gone: bool) {
        self.gone.set(id as usize, gone);
    }

    /// Whether the triangle is gone.
    #[inline]
    pub fn get(&self, id: u32) -> bool {
        self.gone.contains(id as usize)
    }

    /// Whether any triangle is gone. Constant time: a tree asks once per ray.
    #[inline]
    pub fn any(&self) -> bool {
        !self.gone.is_empty()
    }
}
