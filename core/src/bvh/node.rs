//! Layout of the wide tree: nodes of eight boxes and leaf blocks of eight triangles, both as structures of arrays.

use glam::Vec3;

/// Children of a node and triangles of a block: one AVX register of `f32`.
pub(super) const WIDTH: usize = 8;

/// Levels of wide nodes a tree may have. The collapse gives about log₈ of the number of triangles, so that only
/// pathological binary trees come near; those are replaced (see `build`).
pub(super) const MAX_DEPTH: usize = 34;

/// Entries of a traversal stack. A node replaces its own entry by at most eight, so `MAX_DEPTH` levels hold at
/// most `7 · MAX_DEPTH + 1` entries; one register of lanes on top of that because pushes always write whole registers.
pub(super) const STACK_SIZE: usize = (7 * MAX_DEPTH + 1 + WIDTH).next_multiple_of(16);

/// Id of a block's unused lanes.
pub(super) const NO_TRIANGLE: u32 = u32::MAX;

/// An axis-aligned box, metres in the space of the triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Smallest corner.
    pub min: Vec3,
    /// Largest corner.
    pub max: Vec3,
}

impl Bounds {
    /// The box of nothing: the union with it changes nothing, and no ray enters it.
    pub const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    /// Smallest box of a triangle.
    pub(super) fn of_triangle(corners: &[Vec3; 3]) -> Self {
        let [a, b, c] = *corners;
        Self { min: a.min(b).min(c), max: a.max(b).max(c) }
    }

    /// Smallest box that contains both.
    pub(super) fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// The box with `padding` added on all six sides.
    pub(super) fn padded(self, padding: f32) -> Self {
        Self { min: self.min - padding, max: self.max + padding }
    }

    /// Whether `other` lies inside.
    pub(super) fn contains(&self, other: &Self) -> bool {
        self.min.cmple(other.min).all() && self.max.cmpge(other.max).all()
    }
}

/// Where a child lives: an index into the tree's nodes or, with the highest bit set, into its blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(transparent)]
pub(super) struct ChildRef(pub(super) u32);

impl ChildRef {
    const LEAF: u32 = 1 << 31;

    pub(super) const ROOT: Self = Self(0);

    /// What unused slots of a node hold. Their boxes are empty, but a ray of NaNs enters every box: whatever it
    /// finds there must exist and must not lead back up the tree.
    pub(super) const UNUSED: Self = Self(Self::LEAF);

    pub(super) fn node(index: usize) -> Self {
        Self(index as u32)
    }

    pub(super) fn block(index: usize) -> Self {
        Self(index as u32 | Self::LEAF)
    }

    #[inline(always)]
    pub(super) fn is_block(self) -> bool {
        self.0 & Self::LEAF != 0
    }

    #[inline(always)]
    pub(super) fn index(self) -> usize {
        (self.0 & !Self::LEAF) as usize
    }
}

/// An inner node: the boxes of up to eight children. Four cache lines.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct Node {
    /// Planes of the children's boxes: min x, max x, min y, max y, min z, max z.
    pub(super) planes: [[f32; WIDTH]; 6],
    pub(super) children: [ChildRef; WIDTH],
    /// Slots of the children far to near, for each octant of ray directions: bits `3o..3o + 3` of `order[k]` are
    /// the slot that is visited k-th from last by rays of octant `o` (bit 0 of `o` is set for negative x, and so on).
    pub(super) order: [u32; WIDTH],
}

impl Node {
    /// A node over up to eight children.
    pub(super) fn new(children: &[(ChildRef, Bounds)]) -> Self {
        let mut node = Self {
            planes: std::array::from_fn(|side| [if side % 2 == 0 { f32::INFINITY } else { f32::NEG_INFINITY }; WIDTH]),
            children: [ChildRef::UNUSED; WIDTH],
            order: [0; WIDTH],
        };
        for (slot, (child, bounds)) in children.iter().enumerate() {
            node.children[slot] = *child;
            for axis in 0..3 {
                node.planes[2 * axis][slot] = bounds.min[axis];
                node.planes[2 * axis + 1][slot] = bounds.max[axis];
            }
        }
        for octant in 0..8 {
            node.set_order(octant, children);
        }
        node
    }

    /// Orders by the box's centre along the octant's diagonal. Less exact than sorting the entry distances of every
    /// ray, but a permutation that costs nothing beats it.
    fn set_order(&mut self, octant: u32, children: &[(ChildRef, Bounds)]) {
        let sign = |bit: u32| if octant >> bit & 1 == 0 { 0.5 } else { -0.5 };
        let diagonal = Vec3::new(sign(0), sign(1), sign(2));
        let depth = |slot: &usize| {
            children.get(*slot).map_or(f32::INFINITY, |(_, bounds)| diagonal.dot(bounds.min) + diagonal.dot(bounds.max))
        };
        let mut slots: [usize; WIDTH] = std::array::from_fn(|slot| slot);
        slots.sort_by(|a, b| depth(b).total_cmp(&depth(a)));
        for (rank, slot) in slots.into_iter().enumerate() {
            self.order[rank] |= (slot as u32) << (3 * octant);
        }
    }

    pub(super) fn bounds(&self, slot: usize) -> Bounds {
        let corner =
            |side: usize| Vec3::new(self.planes[side][slot], self.planes[2 + side][slot], self.planes[4 + side][slot]);
        Bounds { min: corner(0), max: corner(1) }
    }
}

/// A leaf: up to eight triangles. Unused lanes hold NaN, which no edge test accepts.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct Block {
    /// `corners[c][axis][lane]`: coordinates of the triangles' three corners.
    pub(super) corners: [[[f32; WIDTH]; 3]; 3],
    pub(super) ids: [u32; WIDTH],
}

impl Block {
    pub(super) const EMPTY: Self = Self { corners: [[[f32::NAN; WIDTH]; 3]; 3], ids: [NO_TRIANGLE; WIDTH] };

    pub(super) fn set(&mut self, lane: usize, id: u32, corners: &[Vec3; 3]) {
        self.ids[lane] = id;
        for (stored, corner) in self.corners.iter_mut().zip(corners) {
            for axis in 0..3 {
                stored[axis][lane] = corner[axis];
            }
        }
    }

    #[inline(always)]
    pub(super) fn triangle(&self, lane: usize) -> [Vec3; 3] {
        std::array::from_fn(|c| Vec3::from_array(std::array::from_fn(|axis| self.corners[c][axis][lane])))
    }

    /// Used lanes.
    pub(super) fn len(&self) -> usize {
        self.corners[0][0].iter().take_while(|x| !x.is_nan()).count()
    }
}
