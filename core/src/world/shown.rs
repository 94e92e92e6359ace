//! What the corners of cells show where a mesh is drawn with the light map on its vertices, and interpolated by whoever draws it.

use super::{Placed, World};
use crate::space::{Patch, Read};

impl World {
    /// What each corner of a cell reads, of the elements of one side of an object.
    ///
    /// A corner inside of a wall has the light of one side of it. A cell on the other side reads in its place its corners that are
    /// not in the wall: those that are computed, or else those close before it.
    pub(crate) fn shown_at(&self, placed: &Placed, patch: &Patch, is_back: bool) -> [Read; 3] {
        let mut reads = placed.layout.reads_of(patch);
        let first = placed.placement.elements.start + if is_back { placed.layout.len() as u32 } else { 0 };
        let element = |read: &Read| read.elements[0];
        if reads.iter().all(|read| self.is_valid((first + element(read)) as usize)) {
            return reads;
        }
        let those = |are_wanted: &dyn Fn(u32) -> bool| -> Vec<u32> {
            let of_one = reads.iter().filter(|read| read.is_one()).map(element);
            of_one.filter(|element| are_wanted(first + element)).collect()
        };
        let mut own = those(&|slot| self.is_valid(slot as usize));
        if own.is_empty() {
            own = those(&|slot| self.validity.behind().binary_search(&slot).is_ok());
        }
        let read = match own[..] {
            [] => return reads,
            [one] => Read::own(one),
            [one, other, ..] => Read { elements: [one, other, one], weights: [0.5, 0.5, 0.0] },
        };
        for corner in reads.iter_mut().filter(|read| read.is_one() && !own.contains(&element(read))) {
            let sources = self.validity.sources_of(first + element(corner));
            if !sources.is_empty() && !own.iter().any(|element| sources.contains(&(first + element))) {
                *corner = read;
            }
        }
        reads
    }
}
