//! Traversal, generic over the instruction set.
//!
//! What a ray hits is a function of the ray, the triangles and the tree's padding alone, not of the tree's shape:
//! a triangle counts only if the ray enters the triangle's own padded box, and its distance is moved into that box. All
//! boxes above contain this box and rounding is monotonic, so that every box on the way down is entered, and no
//! later than the distance found: culling never decides which of two triangles wins. Equal distances go to the smaller
//! id.

use super::lanes::{Lanes, SortedStack, Stack, StackMemory};
use super::node::{Block, ChildRef, NO_TRIANGLE, Node};
use super::{Bvh, Filter, Hit, Ray};
use glam::{DVec3, Vec2, Vec3};

/// Lengthens the far end of slab intervals by more than the rounding errors of both ends: 2γ₃ of
/// "Robust BVH Ray Traversal" (Ize 2013).
const SLAB_SLACK: f32 = 1.0 + 4.0 * f32::EPSILON;

type Float3<L> = [<L as Lanes>::Float; 3];

/// A ray, each number in all lanes.
struct RayLanes<L: Lanes> {
    origin: Float3<L>,
    /// Infinite where the direction is zero. A box plane through the origin then gives 0 · ∞ = NaN, and NaN never
    /// survives the minima and maxima of the slab test: the other planes decide.
    inverse: Float3<L>,
    t_min: L::Float,
    padding: L::Float,
    octant: u32,
    /// Which of a node's planes is entered first, per axis.
    near: [usize; 3],
    shear: Shear,
    shear_x: L::Float,
    shear_y: L::Float,
    /// The origin along the sheared axes.
    origin_x: L::Float,
    origin_y: L::Float,
    origin_z: L::Float,
}

impl<L: Lanes> RayLanes<L> {
    /// # Safety
    /// The CPU has the instruction set `L`; so for everything below.
    #[inline(always)]
    unsafe fn new(ray: &Ray, padding: f32) -> Self {
        let inverse = ray.direction.recip();
        let shear = Shear::new(&ray.direction);
        let origin: &[f32; 3] = ray.origin.as_ref();
        let octant = inverse.is_negative_bitmask();
        // SAFETY: contract of this function.
        unsafe {
            Self {
                origin: [L::splat(ray.origin.x), L::splat(ray.origin.y), L::splat(ray.origin.z)],
                inverse: [L::splat(inverse.x), L::splat(inverse.y), L::splat(inverse.z)],
                t_min: L::splat(ray.t_min),
                padding: L::splat(padding),
                octant,
                near: [octant as usize & 1, 2 + (octant as usize >> 1 & 1), 4 + (octant as usize >> 2 & 1)],
                shear_x: L::splat(shear.x),
                shear_y: L::splat(shear.y),
                origin_x: L::splat(origin[shear.axes[0]]),
                origin_y: L::splat(origin[shear.axes[1]]),
                origin_z: L::splat(origin[shear.axes[2]]),
                shear,
            }
        }
    }
}

/// The shear that maps a ray's direction to an axis.
#[derive(Clone, Copy)]
struct Shear {
    /// Axes of the space that become x, y and z; z is where the direction is largest.
    axes: [usize; 3],
    /// Slopes of the direction.
    x: f32,
    y: f32,
    /// Ray parameter per unit along z.
    per_depth: f32,
}

impl Shear {
    #[inline(always)]
    fn new(direction: &Vec3) -> Self {
        let size = direction.abs();
        let z = if size.x > size.y && size.x > size.z { 0 } else { 1 + usize::from(size.z >= size.y) };
        let axes = [[1, 2, 0], [2, 0, 1], [0, 1, 2]][z];
        let direction: &[f32; 3] = direction.as_ref();
        let [x, y, z] = axes.map(|axis| direction[axis]);
        Self { axes, x: x / z, y: y / z, per_depth: 1.0 / z }
    }

    /// A point relative to the ray's origin in the plane across the ray.
    fn apply(&self, point: Vec3) -> Vec2 {
        let [x, y, z] = self.axes.map(|axis| point[axis]);
        Vec2::new(x - self.x * z, y - self.y * z)
    }
}

/// Where the ray crosses one of a node's six planes per child.
#[inline(always)]
unsafe fn cross_plane<L: Lanes>(node: &Node, ray: &RayLanes<L>, axis: usize, side: usize) -> L::Float {
    // SAFETY: the instruction set is the caller's promise; sides are 0..6.
    unsafe { L::mul(L::sub(L::load(node.planes.get_unchecked(side)), ray.origin[axis]), ray.inverse[axis]) }
}

/// Where a node's boxes are entered and left, no farther than `limit`. Missed boxes are left before they are entered.
#[inline(always)]
unsafe fn enter_boxes<L: Lanes>(node: &Node, ray: &RayLanes<L>, limit: f32) -> (L::Float, L::Float) {
    // SAFETY: the instruction set is the caller's promise. Flipping the lowest bit of a side gives the opposite one.
    unsafe {
        let [x, y, z] = ray.near;
        let entry = L::max(
            L::max(cross_plane(node, ray, 0, x), cross_plane(node, ray, 1, y)),
            L::max(cross_plane(node, ray, 2, z), ray.t_min),
        );
        let exit = L::min(
            L::min(cross_plane(node, ray, 0, x ^ 1), cross_plane(node, ray, 1, y ^ 1)),
            cross_plane(node, ray, 2, z ^ 1),
        );
        let exit = L::min(L::mul(exit, L::splat(SLAB_SLACK)), L::splat(limit));
        (entry, exit)
    }
}

/// A corner of a block's triangles in sheared space.
#[inline(always)]
unsafe fn shear_corner<L: Lanes>(block: &Block, corner: usize, ray: &RayLanes<L>) -> Float3<L> {
    // SAFETY: the instruction set is the caller's promise. `axes` are 0, 1 and 2 in some order.
    unsafe {
        let [x, y, z] = ray.shear.axes;
        let corner = &block.corners[corner];
        let depth = L::sub(L::load(corner.get_unchecked(z)), ray.origin_z);
        let x = L::sub(L::load(corner.get_unchecked(x)), ray.origin_x);
        let y = L::sub(L::load(corner.get_unchecked(y)), ray.origin_y);
        [L::sub(x, L::mul(ray.shear_x, depth)), L::sub(y, L::mul(ray.shear_y, depth)), depth]
    }
}

/// Twice the area of the triangle of a side and the ray, in the plane across the ray.
#[inline(always)]
unsafe fn edge<L: Lanes>(from: Float3<L>, to: Float3<L>) -> L::Float {
    // SAFETY: the instruction set is the caller's promise.
    unsafe { L::sub(L::mul(from[0], to[1]), L::mul(from[1], to[0])) }
}

/// Which triangles of a block are hit at `t_min ≤ t ≤ limit`, and where.
///
/// "Watertight Ray/Triangle Intersection" (Woop, Benthin, Wald 2013): in the sheared space every corner has one
/// position, whatever the triangle, and the rounded products of an edge function compare like the exact ones or are
/// equal. Equality counts as inside, so that no ray passes between triangles, not even at their corners. A fused
/// product would break this; edge functions in three dimensions (Plücker) let rays aimed at corners through.
#[inline(always)]
unsafe fn intersect_block<L: Lanes>(block: &Block, ray: &RayLanes<L>, limit: f32) -> (u32, L::Float) {
    // SAFETY: the instruction set is the caller's promise.
    unsafe {
        let (a, b, c) = (shear_corner(block, 0, ray), shear_corner(block, 1, ray), shear_corner(block, 2, ray));
        let (u, v, w) = (edge::<L>(b, c), edge::<L>(c, a), edge::<L>(a, b));
        let zero = L::splat(0.0);
        let smallest = L::min(u, L::min(v, w));
        let largest = L::max(u, L::max(v, w));
        let inside = L::or(L::le(zero, smallest), L::le(largest, zero));
        if L::bits(inside) == 0 {
            return (0, zero);
        }
        // A mean of the corners' distances. Triangles seen edge-on have no weights to give.
        let weight = L::add(L::add(u, v), w);
        let depth = L::add(L::add(L::mul(u, a[2]), L::mul(v, b[2])), L::mul(w, c[2]));
        let t = L::div(L::mul(depth, L::splat(ray.shear.per_depth)), weight);
        let (entry, exit) = own_box::<L>(block, ray);
        let t = L::max(entry, L::min(exit, t));
        let proper = L::and(L::le(entry, exit), L::lt(zero, L::abs(weight)));
        let in_range = L::and(L::le(ray.t_min, t), L::le(t, L::splat(limit)));
        (L::bits(L::and(inside, L::and(proper, in_range))), t)
    }
}

/// Slab intervals of the padded boxes of a block's triangles.
#[inline(always)]
unsafe fn own_box<L: Lanes>(block: &Block, ray: &RayLanes<L>) -> (L::Float, L::Float) {
    // SAFETY: the instruction set is the caller's promise.
    unsafe {
        let mut entry = L::splat(f32::NEG_INFINITY);
        let mut exit = L::splat(f32::INFINITY);
        for axis in 0..3 {
            let [a, b, c] = &block.corners;
            let (a, b, c) = (L::load(&a[axis]), L::load(&b[axis]), L::load(&c[axis]));
            let low = L::sub(L::min(a, L::min(b, c)), ray.padding);
            let high = L::add(L::max(a, L::max(b, c)), ray.padding);
            let low = L::mul(L::sub(low, ray.origin[axis]), ray.inverse[axis]);
            let high = L::mul(L::sub(high, ray.origin[axis]), ray.inverse[axis]);
            entry = L::max(L::min(low, high), entry);
            exit = L::min(L::max(low, high), exit);
        }
        (entry, L::mul(exit, L::splat(SLAB_SLACK)))
    }
}

/// The largest number below `t_max`, so that `t < t_max` can be asked as `t ≤ limit`, like all later limits.
#[inline(always)]
fn inclusive(t_max: f32) -> f32 {
    t_max.next_down()
}

/// The winner so far.
struct Candidate {
    t: f32,
    id: u32,
    block: usize,
    lane: usize,
}

#[inline(always)]
unsafe fn prefetch_next<L: Lanes>(bvh: &Bvh, stack: &Stack) {
    if let Some(next) = stack.peek() {
        // SAFETY: the instruction set is the caller's promise. Nothing is dereferenced.
        unsafe {
            let block: *const u8 = bvh.blocks.as_ptr().wrapping_add(next.index()).cast();
            let node: *const u8 = bvh.nodes.as_ptr().wrapping_add(next.index()).cast();
            L::prefetch(if next.is_block() { block } else { node }, size_of::<Node>());
        }
    }
}

/// See [`Bvh::closest_hit`].
///
/// # Safety
/// The CPU has the instruction set `L`, enabled in the caller.
#[inline(always)]
pub(super) unsafe fn closest_hit<L: Lanes, F: Filter>(bvh: &Bvh, ray: &Ray, filter: &mut F) -> Option<Hit> {
    // SAFETY: references in nodes were made by the collapse and point into the arrays; the stack holds MAX_DEPTH
    // levels.
    unsafe {
        let lanes = RayLanes::<L>::new(ray, bvh.padding);
        let mut best = Candidate { t: f32::INFINITY, id: NO_TRIANGLE, block: usize::MAX, lane: 0 };
        let mut limit = inclusive(ray.t_max);
        let mut memory = StackMemory::new();
        let mut stack = SortedStack::new(&mut memory);
        let mut next = Some(ChildRef::ROOT);
        while let Some(child) = next {
            if child.is_block() {
                let block = bvh.blocks.get_unchecked(child.index());
                let (mut hits, t) = intersect_block::<L>(block, &lanes, limit);
                if hits != 0 {
                    let t = L::store(t);
                    while hits != 0 {
                        let lane = hits.trailing_zeros() as usize & 7;
                        hits &= hits - 1;
                        let (t, id) = (t[lane], block.ids[lane]);
                        let nearer = t < best.t || t == best.t && id < best.id;
                        if nearer && !filter.passes(id, t, || barycentrics(ray, &block.triangle(lane))) {
                            best = Candidate { t, id, block: child.index(), lane };
                            limit = t;
                        }
                    }
                }
            } else {
                let node = bvh.nodes.get_unchecked(child.index());
                let (entry, exit) = enter_boxes::<L>(node, &lanes, limit);
                L::push_sorted(&mut stack, node, entry, exit, lanes.octant);
            }
            next = stack.pop_nearer(limit);
            prefetch_next::<L>(bvh, stack.children());
        }
        (best.block != usize::MAX).then(|| finish(bvh, ray, &best))
    }
}

/// See [`Bvh::any_hit`].
///
/// # Safety
/// The CPU has the instruction set `L`, enabled in the caller.
#[inline(always)]
pub(super) unsafe fn any_hit<L: Lanes, F: Filter>(bvh: &Bvh, ray: &Ray, filter: &mut F) -> bool {
    // SAFETY: as in `closest_hit`.
    unsafe {
        let lanes = RayLanes::<L>::new(ray, bvh.padding);
        let limit = inclusive(ray.t_max);
        let mut memory = StackMemory::new();
        let mut stack = Stack::new(&mut memory);
        let mut next = Some(ChildRef::ROOT);
        while let Some(child) = next {
            if child.is_block() {
                let block = bvh.blocks.get_unchecked(child.index());
                let (mut hits, t) = intersect_block::<L>(block, &lanes, limit);
                while hits != 0 {
                    let lane = hits.trailing_zeros() as usize & 7;
                    let place = || barycentrics(ray, &block.triangle(lane));
                    if !filter.passes(block.ids[lane], L::store(t)[lane], place) {
                        return true;
                    }
                    hits &= hits - 1;
                }
            } else {
                let node = bvh.nodes.get_unchecked(child.index());
                let (entry, exit) = enter_boxes::<L>(node, &lanes, limit);
                L::push_unsorted(&mut stack, node, entry, exit);
            }
            next = stack.pop();
            prefetch_next::<L>(bvh, &stack);
        }
        false
    }
}

/// Fills in what only the winner needs.
#[inline(always)]
fn finish(bvh: &Bvh, ray: &Ray, best: &Candidate) -> Hit {
    let corners = bvh.blocks[best.block].triangle(best.lane);
    let [u, v] = barycentrics(ray, &corners);
    Hit { t: best.t, u, v, triangle: best.id, normal: unit_normal(&corners, ray.direction) }
}

/// Weights of the second and third corner: the edge functions again, now of one triangle.
fn barycentrics(ray: &Ray, corners: &[Vec3; 3]) -> [f32; 2] {
    let shear = Shear::new(&ray.direction);
    let [a, b, c] = corners.map(|corner| shear.apply(corner - ray.origin));
    let (u, v, w) = (b.perp_dot(c), c.perp_dot(a), a.perp_dot(b));
    let weight = u + v + w;
    [v / weight, w / weight]
}

/// In f64: the squares of millimetre triangles and the products of kilometre coordinates both stay exact enough.
fn unit_normal(corners: &[Vec3; 3], direction: Vec3) -> Vec3 {
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    let normal = (b - a).cross(c - a).try_normalize();
    // Slivers without a normal face the ray; a ray without a direction hits nothing, so the last choice is never seen.
    normal.or_else(|| (-direction.as_dvec3()).try_normalize()).unwrap_or(DVec3::Z).as_vec3()
}
