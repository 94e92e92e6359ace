//! Bounding volume hierarchy: built by obvhs, collapsed to eight-wide nodes, traversed with SIMD chosen at run time.
//!
//! Triangles carry an id of the caller's; a [`TriangleMask`] takes ids out of a tree without rebuilding it.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod build;
mod collapse;
mod filter;
mod lanes;
mod mask;
mod node;
mod portable;
#[cfg(test)]
mod tests;
mod traverse;
mod validate;

pub(crate) use self::filter::Filter;
pub use self::mask::TriangleMask;
pub use self::node::Bounds;

use self::build::Input;
use self::filter::All;
use self::node::{Block, Node};
use self::portable::Portable;
use glam::Vec3;

/// A ray segment `origin + t · direction`, `t_min ≤ t < t_max`.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Scene-space origin.
    pub origin: Vec3,
    /// Direction; `t` is in units of its length.
    pub direction: Vec3,
    /// Hits nearer than this are ignored.
    pub t_min: f32,
    /// Hits at this distance or beyond are ignored.
    pub t_max: f32,
}

/// The closest intersection along a ray.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// Ray parameter.
    pub t: f32,
    /// Barycentric weight of the triangle's second corner.
    pub u: f32,
    /// Barycentric weight of the triangle's third corner.
    pub v: f32,
    /// The caller's id of the triangle.
    pub triangle: u32,
    /// Unit geometric normal: counter-clockwise corners seen from its tip.
    pub normal: Vec3,
}

/// How much time to spend on building a tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BuildQuality {
    /// For small trees that must exist at once.
    Fast,
    /// For the tree that most rays go through.
    Good,
}

/// Instruction sets with a traversal of their own. All give the same hits, bit by bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum InstructionSet {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl InstructionSet {
    /// What this CPU has, best first. Never empty.
    fn available() -> impl Iterator<Item = Self> {
        #[cfg(target_arch = "x86_64")]
        let vector_sets = {
            let avx2 = is_x86_feature_detected!("avx2")
                && is_x86_feature_detected!("bmi1")
                && is_x86_feature_detected!("bmi2")
                && is_x86_feature_detected!("popcnt")
                && is_x86_feature_detected!("lzcnt");
            let avx512 = avx2
                && is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512bw");
            [avx512.then_some(Self::Avx512), avx2.then_some(Self::Avx2)]
        };
        #[cfg(not(target_arch = "x86_64"))]
        let vector_sets: [Option<Self>; 0] = [];
        vector_sets.into_iter().flatten().chain([Self::Portable])
    }

    fn best() -> Self {
        Self::available().next().unwrap_or(Self::Portable)
    }
}

/// An immutable tree of triangles.
///
/// Closest hits are a function of the triangles and the ray alone: they do not depend on the order of the input, on
/// the number of threads or on the CPU. Where two triangles are hit at the same distance, the smaller id wins.
#[derive(Debug)]
pub struct Bvh {
    nodes: Vec<Node>,
    blocks: Vec<Block>,
    bounds: Bounds,
    /// By how much all boxes are larger than their triangles, metres.
    padding: f32,
    triangle_count: usize,
    /// Only ever one that the CPU has: the `unsafe` calls rely on it.
    instruction_set: InstructionSet,
}

/// Calls the traversal of the tree's instruction set.
macro_rules! dispatch {
    ($bvh:expr, $ray:expr, $filter:expr, $entry:ident, $generic:ident) => {{
        let (bvh, ray, filter) = ($bvh, $ray, $filter);
        // SAFETY: `instruction_set` is one of `InstructionSet::available`.
        unsafe {
            match bvh.instruction_set {
                InstructionSet::Portable => traverse::$generic::<Portable, _>(bvh, ray, filter),
                #[cfg(target_arch = "x86_64")]
                InstructionSet::Avx2 => avx2::$entry(bvh, ray, filter),
                #[cfg(target_arch = "x86_64")]
                InstructionSet::Avx512 => avx512::$entry(bvh, ray, filter),
            }
        }
    }};
}

impl Bvh {
    /// Builds a tree in which triangle `corners[i]` (metres) is called `ids[i]`. Ids should differ.
    ///
    /// Uses the current rayon pool; the result does not depend on its size. Triangles with a corner that is not finite
    /// are left out. Without triangles the tree is one that nothing hits.
    pub fn build(corners: &[[Vec3; 3]], ids: &[u32], quality: BuildQuality) -> Self {
        build::build(corners, ids, quality)
    }

    fn empty() -> Self {
        Self::from_parts(vec![Node::new(&[])], vec![Block::EMPTY], &Input::default())
    }

    fn from_parts(nodes: Vec<Node>, blocks: Vec<Block>, input: &Input) -> Self {
        Self {
            nodes,
            blocks,
            bounds: input.extent,
            padding: input.padding,
            triangle_count: input.ids.len(),
            instruction_set: InstructionSet::best(),
        }
    }

    /// The triangle hit first at `t_min ≤ t < t_max` from either side, except those that `mask` takes out.
    #[inline]
    pub fn closest_hit(&self, ray: &Ray, mask: Option<&TriangleMask>) -> Option<Hit> {
        match mask.filter(|mask| mask.any()) {
            None => self.closest_hit_of(ray, &mut All),
            Some(mut mask) => self.closest_hit_of(ray, &mut mask),
        }
    }

    /// Whether anything is hit at `t_min ≤ t < t_max`: exactly when [`Self::closest_hit`] finds something.
    #[inline]
    pub fn any_hit(&self, ray: &Ray, mask: Option<&TriangleMask>) -> bool {
        match mask.filter(|mask| mask.any()) {
            None => self.any_hit_of(ray, &mut All),
            Some(mut mask) => self.any_hit_of(ray, &mut mask),
        }
    }

    /// The triangle hit first at `t_min ≤ t < t_max` from either side, of those that `filter` does not pass.
    #[inline(always)]
    pub(crate) fn closest_hit_of(&self, ray: &Ray, filter: &mut impl Filter) -> Option<Hit> {
        dispatch!(self, ray, filter, closest, closest_hit)
    }

    /// Whether anything that `filter` does not pass is hit at `t_min ≤ t < t_max`.
    #[inline(always)]
    pub(crate) fn any_hit_of(&self, ray: &Ray, filter: &mut impl Filter) -> bool {
        dispatch!(self, ray, filter, any, any_hit)
    }

    /// The smallest box of all triangles, without padding. [`Bounds::EMPTY`] if there are none.
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// Triangles in the tree.
    pub fn triangle_count(&self) -> usize {
        self.triangle_count
    }

    /// Memory that the tree holds on the heap, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.nodes.capacity() * size_of::<Node>() + self.blocks.capacity() * size_of::<Block>()
    }
}
