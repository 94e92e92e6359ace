//! From a binary tree to the wide one: which binary nodes become children of which wide node is chosen
//! by the dynamic programme of "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs" (Ylitie,
//! Karras, Laine 2017), section 3.1.

use super::Bvh;
use super::build::Input;
use super::node::{Block, Bounds, ChildRef, MAX_DEPTH, Node, WIDTH};
use obvhs::bvh2::node::Bvh2Node;

/// Cost of a wide node that is entered, relative to [`COST_BLOCK`].
const COST_NODE: f32 = 1.0;

/// Cost of a leaf block that is entered, however full it is.
const COST_BLOCK: f32 = 1.0;

/// What the dynamic programme knows of a binary node. Children are `first` and `first + 1`.
#[derive(Clone, Copy)]
struct Choice {
    /// `cost[i]`: of the subtree as a forest of at most `i + 1` wide roots.
    cost: [f32; WIDTH - 1],
    /// `left[i]`: how many of the `i + 1` roots lie in the left child; 0 if one root fewer costs no more.
    left: [u8; WIDTH],
    /// Triangles below.
    triangles: u32,
}

impl Choice {
    const NONE: Self = Self { cost: [0.0; WIDTH - 1], left: [0; WIDTH], triangles: 0 };

    /// Whether the subtree becomes one block.
    fn is_block(&self) -> bool {
        self.left[WIDTH - 1] == 0
    }

    fn leaf(area: f32) -> Self {
        Self { cost: [area * COST_BLOCK; WIDTH - 1], left: [0; WIDTH], triangles: 1 }
    }

    fn inner(area: f32, left: &Self, right: &Self) -> Self {
        // Equation (2) of the paper: the cheapest way to distribute roots between the children.
        let distribute = |roots: usize| {
            (1..roots).fold((f32::INFINITY, 0), |best, k| {
                let cost = left.cost[k - 1] + right.cost[roots - k - 1];
                if cost < best.0 { (cost, k as u8) } else { best }
            })
        };
        let mut choice = Self { triangles: left.triangles + right.triangles, ..Self::NONE };
        // One root: a block if the triangles fit and that is no dearer than a node over eight roots. `left[7]` is that
        // node's choice, or 0 for a block.
        let (below, split) = distribute(WIDTH);
        let node_cost = area * COST_NODE + below;
        let block_cost = if choice.triangles as usize <= WIDTH { area * COST_BLOCK } else { f32::INFINITY };
        choice.cost[0] = node_cost.min(block_cost);
        choice.left[WIDTH - 1] = if block_cost <= node_cost { 0 } else { split };
        for roots in 2..WIDTH {
            let (cost, split) = distribute(roots);
            let better = cost < choice.cost[roots - 2];
            choice.cost[roots - 1] = if better { cost } else { choice.cost[roots - 2] };
            choice.left[roots - 1] = if better { split } else { 0 };
        }
        choice
    }
}

/// The wide tree, or nothing if it would be deeper than traversal stacks allow.
pub(super) fn collapse(input: &Input, binary: &[Bvh2Node]) -> Option<Bvh> {
    let order = parents_first(binary);
    let mut choices = vec![Choice::NONE; binary.len()];
    let mut bounds = vec![Bounds::EMPTY; binary.len()];
    for &index in order.iter().rev() {
        let node = &binary[index];
        let (area, first) = (node.aabb().half_area(), node.first_index as usize);
        (choices[index], bounds[index]) = if node.is_leaf() {
            (Choice::leaf(area), Bounds::of_triangle(&input.corners[first]).padded(input.padding))
        } else {
            (Choice::inner(area, &choices[first], &choices[first + 1]), bounds[first].union(bounds[first + 1]))
        };
    }
    Collapse { input, binary, choices, bounds, nodes: Vec::new(), blocks: Vec::new() }.run()
}

fn parents_first(binary: &[Bvh2Node]) -> Vec<usize> {
    let mut order = Vec::with_capacity(binary.len());
    let mut pending = vec![0];
    while let Some(index) = pending.pop() {
        order.push(index);
        if !binary[index].is_leaf() {
            let first = binary[index].first_index as usize;
            pending.extend([first + 1, first]);
        }
    }
    order
}

struct Collapse<'a> {
    input: &'a Input,
    binary: &'a [Bvh2Node],
    choices: Vec<Choice>,
    /// Padded boxes in metres, per binary node.
    bounds: Vec<Bounds>,
    nodes: Vec<Node>,
    blocks: Vec<Block>,
}

impl Collapse<'_> {
    fn run(mut self) -> Option<Bvh> {
        // Binary node, its wide node, the wide node's level.
        let mut pending = vec![(0, 0, 1)];
        self.nodes.push(Node::new(&[]));
        let mut roots = Vec::with_capacity(WIDTH);
        while let Some((index, wide, depth)) = pending.pop() {
            if depth > MAX_DEPTH {
                return None;
            }
            roots.clear();
            self.wide_children(index, &mut roots);
            let mut children = Vec::with_capacity(WIDTH);
            let first_pending = pending.len();
            for &root in &roots {
                let child = if self.choices[root].is_block() {
                    self.push_block(root)
                } else {
                    self.nodes.push(Node::new(&[]));
                    pending.push((root, self.nodes.len() - 1, depth + 1));
                    ChildRef::node(self.nodes.len() - 1)
                };
                children.push((child, self.bounds[root]));
            }
            pending[first_pending..].reverse();
            self.nodes[wide] = Node::new(&children);
        }
        self.nodes.shrink_to_fit();
        self.blocks.shrink_to_fit();
        Some(Bvh::from_parts(self.nodes, self.blocks, self.input))
    }

    /// The binary nodes that are the children of the wide node at binary node `index`.
    fn wide_children(&self, index: usize, roots: &mut Vec<usize>) {
        if self.choices[index].is_block() {
            // The whole tree is one block: a node with one child.
            return roots.push(index);
        }
        let left = usize::from(self.choices[index].left[WIDTH - 1]);
        let first = self.binary[index].first_index as usize;
        self.forest(first, left, roots);
        self.forest(first + 1, WIDTH - left, roots);
    }

    /// The subtree at `index` as a forest of at most `count` roots, as chosen.
    fn forest(&self, index: usize, mut count: usize, roots: &mut Vec<usize>) {
        let choice = &self.choices[index];
        while count > 1 && choice.left[count - 1] == 0 {
            count -= 1;
        }
        if count == 1 {
            return roots.push(index);
        }
        let left = usize::from(choice.left[count - 1]);
        let first = self.binary[index].first_index as usize;
        self.forest(first, left, roots);
        self.forest(first + 1, count - left, roots);
    }

    /// A block of all triangles below a binary node.
    fn push_block(&mut self, index: usize) -> ChildRef {
        let mut block = Block::EMPTY;
        let mut lane = 0;
        let mut pending = vec![index];
        while let Some(index) = pending.pop() {
            let first = self.binary[index].first_index as usize;
            if self.binary[index].is_leaf() {
                block.set(lane, self.input.ids[first], &self.input.corners[first]);
                lane += 1;
            } else {
                pending.extend([first + 1, first]);
            }
        }
        self.blocks.push(block);
        ChildRef::block(self.blocks.len() - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bvh::build::from_medians;
    use glam::{Vec3, Vec3A};
    use obvhs::aabb::Aabb;

    #[test]
    fn trees_too_deep_for_the_stack_are_refused() {
        let corners: Vec<_> = (0..1000).map(|i| [Vec3::X, Vec3::Y, Vec3::Z].map(|p| p + i as f32)).collect();
        let input = Input::new(&corners, &(0..1000).collect::<Vec<_>>());
        let boxes: Vec<_> =
            (0..1000).map(|i| Aabb::new(Vec3A::splat(i as f32), Vec3A::splat(i as f32 + 1.0))).collect();
        // A list: the left child of node 2i is triangle i, the right one the rest.
        let whole = |first: usize| Aabb::new(boxes[first].min, boxes[999].max);
        let mut list = vec![Bvh2Node::new(whole(0), 0, 1)];
        for (i, triangle) in boxes.iter().enumerate().take(999) {
            let last = i == 998;
            let rest = if last { 999 } else { 2 * i as u32 + 3 };
            list.push(Bvh2Node::new(*triangle, 1, i as u32));
            list.push(Bvh2Node::new(whole(i + 1), u32::from(last), rest));
        }
        assert!(collapse(&input, &list).is_none());
        let bvh = collapse(&input, &from_medians(&boxes)).expect("a balanced tree");
        bvh.validate().expect("a valid tree");
    }
}
