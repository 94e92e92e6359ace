//! How triangles are to be split: what a subdivision keeps of those that wait.

/// A triangle that is to be split. Edge `i` goes from corner `i` to corner `i + 1`.
pub(super) struct Triangle {
    pub corners: [u32; 3],
    /// Per edge.
    pub segments: [u32; 3],
    pub plan: Plan,
}

/// How a triangle is to be split.
pub(super) enum Plan {
    /// At all edges.
    Four([Split; 3]),
    /// At one edge, of the corners turned by so many; the next edge may be split, too, and the last is not.
    Two { turn: u8, ab: Split, bc: Option<Split> },
    /// Across; the triangle's corners are turned so that its last edge is the short one.
    Strip { turn: u8, ab: Vec<Piece>, cb: Vec<Piece> },
}

impl Plan {
    /// None where no edge is split.
    pub(super) fn of_edges(splits: [Option<Split>; 3]) -> Option<Plan> {
        match splits {
            [None, None, None] => None,
            [Some(ab), Some(bc), Some(ca)] => Some(Plan::Four([ab, bc, ca])),
            [Some(ab), bc, None] => Some(Plan::Two { turn: 0, ab, bc }),
            [None, Some(ab), bc] => Some(Plan::Two { turn: 1, ab, bc }),
            [bc, None, Some(ab)] => Some(Plan::Two { turn: 2, ab, bc }),
        }
    }
}

/// An edge after its split: the vertex between its ends and the segments on either side.
#[derive(Clone, Copy)]
pub(super) struct Split {
    pub middle: u32,
    /// Segments from the edge's first corner to the middle, and from there to its second corner.
    pub segments: [u32; 2],
    /// How far along the edge, from its first corner, the middle is.
    pub at: f32,
}

/// A part of an edge, up to a vertex.
#[derive(Clone, Copy)]
pub(super) struct Piece {
    pub end: u32,
    /// How far along the edge the end is.
    pub at: f32,
    pub segments: u32,
}

/// A child of a triangle, and how it is split where that is known already.
pub(super) struct Child {
    pub corners: [u32; 3],
    pub segments: [u32; 3],
    pub plan: Option<Plan>,
}

impl Child {
    pub(super) fn new(corners: [u32; 3], segments: [u32; 3]) -> Child {
        Child { corners, segments, plan: None }
    }

    /// Of which one edge is split, by its number.
    pub(super) fn with_split(self, turn: u8, ab: Split) -> Child {
        Child { plan: Some(Plan::Two { turn, ab, bc: None }), ..self }
    }
}
