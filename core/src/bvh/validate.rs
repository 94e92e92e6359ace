//! Checks and figures of a finished tree, for tests and logs.

use super::Bvh;
use super::node::{Bounds, ChildRef, MAX_DEPTH};
use glam::Vec3;

impl Bvh {
    /// Expected cost of a random ray (surface area heuristic) in visited nodes and blocks: the sum of their areas
    /// relative to the root's. For comparing trees over the same triangles.
    pub fn surface_area_cost(&self) -> f32 {
        let root = area(&self.node_bounds(0));
        if root.is_nan() || root <= 0.0 {
            return 1.0;
        }
        let children = self.nodes.iter().flat_map(|node| (0..8).map(|slot| area(&node.bounds(slot))));
        1.0 + (children.sum::<f64>() / root) as f32
    }

    /// Whether every triangle lies in exactly one leaf, every box contains what is below it, and the tree is not too
    /// deep for a traversal stack. The error says what is wrong.
    pub fn validate(&self) -> Result<(), String> {
        let mut visited = (vec![false; self.nodes.len()], vec![false; self.blocks.len()]);
        let mut triangles = 0;
        let mut pending = vec![(0, 1)];
        visited.0[0] = true;
        while let Some((index, depth)) = pending.pop() {
            if depth > MAX_DEPTH {
                return Err(format!("node {index} lies {depth} levels deep"));
            }
            for slot in 0..8 {
                let (child, bounds) = (self.nodes[index].children[slot], self.nodes[index].bounds(slot));
                if bounds == Bounds::EMPTY {
                    if child != ChildRef::UNUSED {
                        return Err(format!("node {index} hides a child in slot {slot}"));
                    }
                    continue;
                }
                let seen = if child.is_block() { &mut visited.1 } else { &mut visited.0 };
                match seen.get_mut(child.index()) {
                    None => return Err(format!("node {index} has a child {child:?} that does not exist")),
                    Some(true) => return Err(format!("{child:?} has two parents")),
                    Some(seen) => *seen = true,
                }
                let below =
                    if child.is_block() { self.block_bounds(child.index()) } else { self.node_bounds(child.index()) };
                if !bounds.contains(&below) {
                    return Err(format!("slot {slot} of node {index} does not contain {child:?}"));
                }
                if child.is_block() {
                    triangles += self.blocks[child.index()].len();
                } else {
                    pending.push((child.index(), depth + 1));
                }
            }
        }
        if triangles != self.triangle_count {
            return Err(format!("{triangles} of {} triangles are in the tree", self.triangle_count));
        }
        Ok(())
    }

    fn node_bounds(&self, index: usize) -> Bounds {
        (0..8).map(|slot| self.nodes[index].bounds(slot)).fold(Bounds::EMPTY, Bounds::union)
    }

    fn block_bounds(&self, index: usize) -> Bounds {
        let block = &self.blocks[index];
        let padded = |lane| Bounds::of_triangle(&block.triangle(lane)).padded(self.padding);
        (0..block.len()).map(padded).fold(Bounds::EMPTY, Bounds::union)
    }
}

/// Half the surface, zero for the empty box.
fn area(bounds: &Bounds) -> f64 {
    let sides = (bounds.max.as_dvec3() - bounds.min.as_dvec3()).max(Vec3::ZERO.as_dvec3());
    if bounds.min.x > bounds.max.x { 0.0 } else { sides.x * sides.y + sides.y * sides.z + sides.z * sides.x }
}
