//! From triangles to a binary tree: by obvhs, or by object medians where obvhs' tree would be too deep.

use super::collapse::collapse;
use super::node::Bounds;
use super::{BuildQuality, Bvh};
use glam::{DVec3, Vec3};
use obvhs::aabb::Aabb;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

/// Padding of the boxes relative to the diagonal of the scene. More than the rounding errors of the edge test for rays
/// that start within about a diagonal, so that no box is missed where its triangle would be hit.
const RELATIVE_PADDING: f32 = 1e-6;

/// Triangles as they enter the build. The default is none.
pub(super) struct Input {
    pub(super) corners: Vec<[Vec3; 3]>,
    pub(super) ids: Vec<u32>,
    /// Smallest box of everything.
    pub(super) extent: Bounds,
    /// Added to all boxes, metres.
    pub(super) padding: f32,
}

impl Default for Input {
    fn default() -> Self {
        Self { corners: Vec::new(), ids: Vec::new(), extent: Bounds::EMPTY, padding: 0.0 }
    }
}

impl Input {
    pub(super) fn new(corners: &[[Vec3; 3]], ids: &[u32]) -> Self {
        let finite = |(corners, _): &(&[Vec3; 3], &u32)| corners.iter().all(|corner| corner.is_finite());
        let (corners, ids): (Vec<_>, Vec<_>) = corners.iter().zip(ids).filter(finite).map(|(c, id)| (*c, *id)).unzip();
        let extent = corners.iter().map(Bounds::of_triangle).fold(Bounds::EMPTY, Bounds::union);
        let padding = padding(&extent);
        Self { corners, ids, extent, padding }
    }
}

/// At least one unit in the last place of every coordinate, or adding it would change nothing. A power of two, so that
/// trees over nearly the same triangles agree about it, and with it about every hit.
fn padding(extent: &Bounds) -> f32 {
    if extent.min.x > extent.max.x {
        return 0.0;
    }
    let diagonal = (extent.max.as_dvec3() - extent.min.as_dvec3()).length() as f32;
    let largest = extent.min.abs().max(extent.max.abs()).max_element();
    let least = (RELATIVE_PADDING * diagonal).max(f32::EPSILON * largest).max(f32::MIN_POSITIVE);
    // Twice the power of two below. At the end of the range the last bit of the largest number is 2¹⁰⁴.
    2.0 * f32::from_bits(least.min(2f32.powi(104)).to_bits() & f32::INFINITY.to_bits())
}

/// See [`Bvh::build`].
pub(super) fn build(corners: &[[Vec3; 3]], ids: &[u32], quality: BuildQuality) -> Bvh {
    let input = Input::new(corners, ids);
    if input.corners.is_empty() {
        return Bvh::empty();
    }
    let boxes = relative_boxes(&input);
    // Medians halve: they stay far below the depth that `collapse` refuses.
    collapse(&input, &from_obvhs(&boxes, quality))
        .or_else(|| collapse(&input, &from_medians(&boxes)))
        .unwrap_or_else(Bvh::empty)
}

/// The triangles' boxes in units of the extent's longest side, from -½ to ½: areas can neither overflow nor vanish.
///
/// The padding keeps centres off the faces of the extent, where obvhs' Morton code wraps round. The shift by
/// less than the padding breaks ties: between equal boxes obvhs merges one pair per sweep, a quadratic
/// time and a linear depth for duplicated triangles. These boxes shape the tree and are not used further.
fn relative_boxes(input: &Input) -> Vec<Aabb> {
    let (low, high) = (input.extent.min.as_dvec3(), input.extent.max.as_dvec3());
    let side = (high - low).max_element();
    let scale = if side > 0.0 { side.recip() } else { 1.0 };
    let centre = (low + high) * 0.5;
    let relative = |point: Vec3, shift: DVec3| ((point.as_dvec3() - centre) * scale + shift).as_vec3a();
    let relative_box = |(index, corners): (usize, &[Vec3; 3])| {
        let bounds = Bounds::of_triangle(corners);
        let shift =
            DVec3::from_array([0, 1, 2].map(|axis| noise(3 * index as u64 + axis))) * f64::from(RELATIVE_PADDING);
        let (min, max) = (relative(bounds.min, shift), relative(bounds.max, shift));
        Aabb::new(min - RELATIVE_PADDING, max + RELATIVE_PADDING)
    };
    input.corners.iter().enumerate().map(relative_box).collect()
}

/// A number in -½..½ for every index (splitmix64).
fn noise(index: u64) -> f64 {
    let mut x = index.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    (x ^ x >> 31) as f64 / u64::MAX as f64 - 0.5
}

/// Locally ordered clustering (Meister and Bittner 2018) with parallel reinsertion (2018). The nodes' children are
/// adjacent, and leaves hold one triangle, whose index is `first_index`.
fn from_obvhs(boxes: &[Aabb], quality: BuildQuality) -> Vec<Bvh2Node> {
    let (search, reinserted) = match quality {
        BuildQuality::Fast => (PlocSearchDistance::Low, 0.02),
        BuildQuality::Good => (PlocSearchDistance::High, 0.2),
    };
    let indices = (0..boxes.len() as u32).collect();
    let mut tree = PlocBuilder::new().build(search, boxes, indices, SortPrecision::U64, 2);
    ReinsertionOptimizer::default().run(&mut tree, reinserted, None);
    tree.nodes
}

/// A balanced tree in the form of [`from_obvhs`]: halves by the centres along the widest axis.
pub(super) fn from_medians(boxes: &[Aabb]) -> Vec<Bvh2Node> {
    let union = |indices: &[u32]| indices.iter().fold(Aabb::empty(), |all, &i| all.union(&boxes[i as usize]));
    let mut indices: Vec<u32> = (0..boxes.len() as u32).collect();
    let mut nodes = vec![Bvh2Node::new(union(&indices), 0, 0)];
    let mut pending = vec![(0, &mut indices[..])];
    while let Some((node, indices)) = pending.pop() {
        if let [single] = indices {
            nodes[node] = Bvh2Node::new(boxes[*single as usize], 1, *single);
            continue;
        }
        let sides = nodes[node].aabb().diagonal();
        let axis = (0..3).fold(0, |widest, axis| if sides[axis] > sides[widest] { axis } else { widest });
        let centre = |index: u32| boxes[index as usize].center_axis(axis);
        let middle = indices.len() / 2;
        indices.select_nth_unstable_by(middle, |&a, &b| centre(a).total_cmp(&centre(b)).then(a.cmp(&b)));
        let (left, right) = indices.split_at_mut(middle);
        let first = nodes.len();
        nodes[node].first_index = first as u32;
        nodes.extend([&left, &right].map(|half| Bvh2Node::new(union(half), 0, 0)));
        pending.extend([(first, left), (first + 1, right)]);
    }
    nodes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_are_balanced_and_complete() {
        let boxes: Vec<_> = (0..1000).map(|i| Aabb::from_point(glam::Vec3A::splat(i as f32))).collect();
        let nodes = from_medians(&boxes);
        assert_eq!(nodes.len(), 1999);
        let mut seen = vec![false; 1000];
        let mut pending = vec![(0, 0)];
        while let Some((node, depth)) = pending.pop() {
            assert!(depth <= 10);
            let (first, is_leaf) = (nodes[node].first_index as usize, nodes[node].is_leaf());
            if is_leaf {
                assert!(!std::mem::replace(&mut seen[first], true));
            } else {
                pending.extend([(first, depth + 1), (first + 1, depth + 1)]);
            }
        }
        assert!(seen.iter().all(|&seen| seen));
    }

    #[test]
    fn padding_is_never_lost() {
        for (min, max) in [(0.0, 1e-3), (500.0, 500.001), (1e4, 2e4), (-1e-30, 0.0), (7.0, 7.0), (-3e38, 3e38)] {
            let padding = padding(&Bounds { min: Vec3::splat(min), max: Vec3::splat(max) });
            assert!(padding.is_finite() && min - padding < min && max + padding > max, "{min} {max} {padding}");
        }
    }
}
