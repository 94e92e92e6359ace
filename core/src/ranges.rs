//! Parts of an array, to be written on several threads.

use std::ops::Range;

/// The parts of `values` in some ranges, which ascend and do not overlap.
///
/// # Panics
/// Where they do not ascend, or end behind the array.
pub(crate) fn split_mut<T>(values: &mut [T], ranges: impl IntoIterator<Item = Range<usize>>) -> Vec<&mut [T]> {
    let (mut left, mut end) = (values, 0);
    let part = |range: Range<usize>| {
        let (own, behind) = std::mem::take(&mut left)[range.start - end..].split_at_mut(range.len());
        (left, end) = (behind, range.end);
        own
    };
    ranges.into_iter().map(part).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn parts_are_those_of_their_ranges(lengths in prop::collection::vec((0_usize..9, 0_usize..9), 0..20)) {
            let mut ranges: Vec<Range<usize>> = Vec::new();
            for (gap, len) in lengths {
                let start = ranges.last().map_or(0, |range| range.end) + gap;
                ranges.push(start..start + len);
            }
            let mut values = vec![0; ranges.last().map_or(0, |range| range.end) + 5];
            for (k, part) in split_mut(&mut values, ranges.iter().cloned()).into_iter().enumerate() {
                part.fill(k + 1);
            }
            let of_slot = |slot: usize| ranges.iter().position(|range| range.contains(&slot)).map_or(0, |k| k + 1);
            prop_assert!((0..values.len()).all(|slot| values[slot] == of_slot(slot)));
        }
    }
}
