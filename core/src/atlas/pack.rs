//! Charts of one mesh, put side by side.

/// Up to so many boxes, several widths of the sheet are tried.
const FEW: usize = 10_000;

/// Where boxes of some sizes (each at least 1 × 1) lie in a sheet, and the size of that. The same boxes get the same
/// places.
pub(super) fn pack(boxes: &[[u32; 2]]) -> (Vec<[u32; 2]>, [u32; 2]) {
    let area: u64 = boxes.iter().map(|[w, h]| u64::from(*w) * u64::from(*h)).sum();
    let widest = boxes.iter().map(|[w, _]| *w).max().unwrap_or(0);
    // Rows end ragged: a little wider comes out square.
    let square = (area as f64 * 1.05).sqrt().ceil();
    let factors: &[f64] =
        if boxes.len() <= FEW { &[1.0, 0.7, 0.8, 0.9, 1.1, 1.25, 1.4, 1.6, 1.8, 2.0] } else { &[1.0] };
    let of_width = |factor: &f64| in_rows(boxes, ((square * factor) as u32).max(widest));
    let tried = factors.iter().map(of_width);
    // The first of the smallest.
    tried.min_by_key(|(_, size)| u64::from(size[0]) * u64::from(size[1])).unwrap_or_default()
}

/// Rows of boxes, the highest first.
fn in_rows(boxes: &[[u32; 2]], width: u32) -> (Vec<[u32; 2]>, [u32; 2]) {
    let mut order: Vec<usize> = (0..boxes.len()).collect();
    order.sort_by_key(|&k| (std::cmp::Reverse(boxes[k][1]), std::cmp::Reverse(boxes[k][0]), k));
    let (mut places, mut size) = (vec![[0; 2]; boxes.len()], [0; 2]);
    // The row at hand: where its next box goes, and how high it is.
    let (mut x, mut y, mut row) = (0u32, 0u32, 0u32);
    for k in order {
        let [w, h] = boxes[k];
        if x.saturating_add(w) > width {
            (x, y, row) = (0, y.saturating_add(row), 0);
        }
        places[k] = [x, y];
        x = x.saturating_add(w);
        row = row.max(h);
        size = [size[0].max(x), size[1].max(y.saturating_add(row))];
    }
    (places, size)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Pcg32;

    #[test]
    fn boxes_lie_apart_in_a_sheet_that_is_mostly_full() {
        let mut rng = Pcg32::new(3, 1);
        for count in [0, 1, 2, 17, 400] {
            let boxes: Vec<[u32; 2]> = (0..count).map(|_| [1 + rng.next_u32() % 30, 1 + rng.next_u32() % 20]).collect();
            let (places, size) = pack(&boxes);
            let mut taken = vec![false; size[0] as usize * size[1] as usize];
            for (at, of) in places.iter().zip(&boxes) {
                for (x, y) in (0..of[0] * of[1]).map(|k| (at[0] + k % of[0], at[1] + k / of[0])) {
                    assert!(x < size[0] && y < size[1]);
                    assert!(!std::mem::replace(&mut taken[(y * size[0] + x) as usize], true), "two boxes at {x} {y}");
                }
            }
            let full = taken.iter().filter(|taken| **taken).count();
            assert!(count < 400 || full * 10 > taken.len() * 8, "{full} of {}", taken.len());
        }
    }
}
