//! Free slots among those in use.

use std::ops::Range;

/// Runs of free slots below the end of some arrays, ascending, with slots in use between them.
#[derive(Clone, Debug, Default)]
pub(super) struct Holes(Vec<Range<usize>>);

impl Holes {
    /// Takes the first run of `count` free ones and answers where it begins. Where none is long enough it ends behind
    /// the `len` slots that there are: what is free at their end is part of it.
    pub(super) fn take(&mut self, count: usize, len: usize) -> usize {
        let Some(index) = self.0.iter().position(|hole| hole.len() >= count || hole.end == len) else { return len };
        let start = self.0[index].start;
        self.0[index].start += count;
        if self.0[index].is_empty() {
            self.0.remove(index);
        }
        start
    }

    /// Frees some that are in use.
    pub(super) fn give(&mut self, range: Range<usize>) {
        if range.is_empty() {
            return;
        }
        let index = self.0.partition_point(|hole| hole.start < range.start);
        self.0.insert(index, range);
        if self.0.get(index + 1).is_some_and(|next| next.start == self.0[index].end) {
            self.0[index].end = self.0.remove(index + 1).end;
        }
        if index > 0 && self.0[index - 1].end == self.0[index].start {
            self.0[index - 1].end = self.0.remove(index).end;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Pcg32;

    #[test]
    fn holes_are_found_first_fit_and_at_the_end() {
        let find = |count| Holes(vec![0..1, 2..4, 5..6]).take(count, 6);
        assert_eq!(find(1), 0);
        assert_eq!(find(2), 2);
        // Three slots fit only behind slot 5, which is free and last.
        assert_eq!(find(3), 5);
        assert_eq!(Holes::default().take(1, 4), 4);
        assert_eq!(Holes(std::iter::once(0..4).collect()).take(9, 4), 0);
    }

    /// First run of `count` free slots, or where one that reaches the end begins.
    fn searched(used: &[bool], count: usize) -> usize {
        let fits = |&start: &usize| used[start..used.len().min(start + count)].iter().all(|used| !used);
        (0..=used.len()).find(fits).unwrap_or(used.len())
    }

    #[test]
    fn any_order_of_taking_and_giving_finds_what_a_search_finds() {
        let mut rng = Pcg32::new(3, 9);
        let (mut holes, mut used, mut taken) = (Holes::default(), Vec::new(), Vec::new());
        for _ in 0..4000 {
            if rng.next_f32() < 0.55 || taken.is_empty() {
                let count = 1 + (rng.next_f32() * 9.0) as usize;
                let start = holes.take(count, used.len());
                assert_eq!(start, searched(&used, count));
                used.resize(used.len().max(start + count), false);
                assert!(used[start..start + count].iter().all(|used| !used));
                used[start..start + count].fill(true);
                taken.push(start..start + count);
            } else {
                let range: Range<usize> = taken.swap_remove((rng.next_f32() * taken.len() as f32) as usize);
                used[range.clone()].fill(false);
                holes.give(range);
            }
        }
        assert!(taken.len() > 100);
    }
}
