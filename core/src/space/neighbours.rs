//! Which elements lie beside one another along a surface: one list per element, all behind one another.

use crate::indices::Indices;

/// Neighbours of every element.
#[derive(Clone, Debug, Default)]
pub(super) struct Neighbours {
    /// Element `e` has `list[starts[e]..starts[e + 1]]`.
    starts: Vec<u32>,
    list: Indices,
}

impl Neighbours {
    /// Those that share a cell; `triangles` are the elements at the corners of the cells.
    pub(super) fn new(elements: usize, triangles: &[[u32; 3]]) -> Neighbours {
        let mut ends = vec![0_u32; elements + 1];
        for &corner in triangles.iter().flatten() {
            ends[corner as usize] += 2;
        }
        let mut sum = 0;
        for end in &mut ends {
            (*end, sum) = (sum, sum + *end);
        }
        // `ends[e]` is where the list of `e` begins until it is filled.
        let mut full = vec![0; sum as usize];
        for &[a, b, c] in triangles {
            for (element, others) in [(a, [b, c]), (b, [c, a]), (c, [a, b])] {
                let end = &mut ends[element as usize];
                full[*end as usize..*end as usize + 2].copy_from_slice(&others);
                *end += 2;
            }
        }
        let (mut starts, mut list) = (Vec::with_capacity(elements + 1), Vec::with_capacity(full.len() / 2));
        let mut from = 0;
        for &end in &ends[..elements] {
            starts.push(list.len() as u32);
            let others = &mut full[from..end as usize];
            others.sort_unstable();
            let mut last = None;
            let is_new = |&other: &u32| other as usize != starts.len() - 1 && last.replace(other) != Some(other);
            list.extend(others.iter().copied().filter(is_new));
            from = end as usize;
        }
        starts.push(list.len() as u32);
        Neighbours { starts, list: list.into() }
    }

    /// How many elements there are.
    pub(super) fn len(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    #[inline]
    pub(super) fn of(&self, element: u32) -> impl Iterator<Item = u32> + Clone + '_ {
        self.list.range(self.starts[element as usize] as usize..self.starts[element as usize + 1] as usize)
    }

    /// Bytes held.
    pub(super) fn memory_bytes(&self) -> usize {
        self.starts.capacity() * size_of::<u32>() + self.list.memory_bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_share_a_triangle() {
        let neighbours = Neighbours::new(6, &[[0, 1, 2], [2, 1, 3], [4, 4, 0]]);
        let lists: Vec<Vec<u32>> = (0..6).map(|element| neighbours.of(element).collect()).collect();
        assert_eq!(lists, [&[1, 2, 4][..], &[0, 2, 3], &[0, 1, 3], &[1, 2], &[0], &[]]);
    }
}
