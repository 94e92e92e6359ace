//! Triangles that a ray passes though it meets them.

use super::TriangleMask;

/// What of a tree's triangles counts for one ray. Traversal is compiled for each kind apart, so that trees without
/// anything to filter pay nothing.
pub(crate) trait Filter {
    /// Whether the ray passes the triangle `id`, which it would meet at distance `t`. `place` tells the barycentric weights
    /// of the second and third corner there. Triangles are asked about in any order, each at most once per tree.
    fn passes(&mut self, id: u32, t: f32, place: impl FnOnce() -> [f32; 2]) -> bool;
}

/// All triangles count.
pub(super) struct All;

impl Filter for All {
    #[inline(always)]
    fn passes(&mut self, _: u32, _: f32, _: impl FnOnce() -> [f32; 2]) -> bool {
        false
    }
}

impl Filter for &TriangleMask {
    #[inline(always)]
    fn passes(&mut self, id: u32, _: f32, _: impl FnOnce() -> [f32; 2]) -> bool {
        self.get(id)
    }
}
