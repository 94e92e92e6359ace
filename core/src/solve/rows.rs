//! The rows of a transport matrix: representatives, or neighbours among them that share what they gather.

use super::Subset;

pub(super) const NONE: u32 = u32::MAX;

/// The representatives that a matrix is over.
pub(crate) struct Rows {
    /// Indices into `Subset::slots`, row by row.
    members: Vec<u32>,
    /// Where the members of each row begin, and where the last one's end.
    starts: Vec<usize>,
    /// Row of every index of `Subset::slots`, or `NONE`.
    row_of: Vec<u32>,
    /// Where neighbours begin among the rows, and where the last ones end; empty where every row is on its own.
    pub(super) neighbours: Vec<usize>,
}

impl Rows {
    /// All representatives, a row each.
    pub(crate) fn all(subset: &Subset) -> Rows {
        Rows::only(subset, |_| true)
    }

    /// Those whose element slot is wanted, a row each.
    pub(crate) fn only(subset: &Subset, wanted: impl Fn(u32) -> bool) -> Rows {
        let count = subset.slots.len();
        let members: Vec<u32> = (0..count as u32).filter(|&i| wanted(subset.slots[i as usize])).collect();
        let starts = (0..=members.len()).collect();
        Rows::new(members, starts, count)
    }

    /// These representatives in rows of so many each (`counts`), and so many of those rows to a group of neighbours.
    pub(crate) fn shared(&self, counts: impl Iterator<Item = usize>, neighbours: impl Iterator<Item = usize>) -> Rows {
        let rows = Rows::new(self.members.clone(), offsets(counts), self.row_of.len());
        Rows { neighbours: offsets(neighbours), ..rows }
    }

    fn new(members: Vec<u32>, starts: Vec<usize>, representatives: usize) -> Rows {
        let mut row_of = vec![NONE; representatives];
        for (row, ends) in (0..).zip(starts.windows(2)) {
            members[ends[0]..ends[1]].iter().for_each(|&m| row_of[m as usize] = row);
        }
        Rows { members, starts, row_of, neighbours: Vec::new() }
    }

    /// How many there are.
    pub(crate) fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// The representatives of all rows, as indices into `Subset::slots`.
    pub(crate) fn members(&self) -> &[u32] {
        &self.members
    }

    /// The representatives of one row.
    #[inline]
    pub(crate) fn members_of(&self, row: usize) -> &[u32] {
        &self.members[self.starts[row]..self.starts[row + 1]]
    }

    /// Row of a representative, or `NONE`.
    #[inline]
    pub(super) fn row(&self, representative: u32) -> u32 {
        self.row_of[representative as usize]
    }
}

/// Where each of some runs begins, and where the last one ends.
pub(super) fn offsets(counts: impl Iterator<Item = usize>) -> Vec<usize> {
    let ends = counts.scan(0, |end, count| {
        *end += count;
        Some(*end)
    });
    std::iter::once(0).chain(ends).collect()
}
