//! Which elements lie beside one another along a surface: one list per element, all behind one another.
//!
//! Elements are numbered along a curve, so that most neighbours have near numbers: by the steps between them a list takes
//! about nine bytes, where six numbers would take 24.

/// Neighbours of every element.
#[derive(Clone, Debug, Default)]
pub(super) struct Neighbours {
    /// Element `e` has `bytes[starts[e]..starts[e + 1]]`.
    starts: Vec<u32>,
    /// How far the first neighbour is from the element, either way, and each of the others from the one before it
    /// (LEB128).
    bytes: Vec<u8>,
}

/// Appends a number, seven bits a byte and the least first; all bytes but the last have their highest bit set.
fn push(bytes: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
}

/// A step of either sign as a number: 0, −1, 1, −2, …
fn folded(step: i64) -> u64 {
    ((step << 1) ^ (step >> 63)) as u64
}

fn unfolded(number: u64) -> i64 {
    (number >> 1) as i64 ^ -((number & 1) as i64)
}

/// A list of neighbours that is left to be read.
#[derive(Clone)]
struct Rest<'n> {
    bytes: &'n [u8],
    /// The neighbour before, or else the element.
    last: u32,
    is_first: bool,
}

impl Iterator for Rest<'_> {
    type Item = u32;

    #[inline]
    fn next(&mut self) -> Option<u32> {
        let (mut number, mut shift) = (0, 0);
        loop {
            let (&byte, rest) = self.bytes.split_first()?;
            self.bytes = rest;
            number |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                break;
            }
            shift += 7;
        }
        let step = if std::mem::take(&mut self.is_first) { unfolded(number) } else { number as i64 };
        self.last = (i64::from(self.last) + step) as u32;
        Some(self.last)
    }
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
        let (mut starts, mut bytes) = (Vec::with_capacity(elements + 1), Vec::new());
        let mut from = 0;
        for (element, &end) in (0..).zip(&ends[..elements]) {
            starts.push(bytes.len() as u32);
            let others = &mut full[from..end as usize];
            others.sort_unstable();
            let mut last = None;
            for &other in others.iter().filter(|&&other| other != element) {
                match last.replace(other) {
                    None => push(&mut bytes, folded(i64::from(other) - i64::from(element))),
                    Some(last) if last != other => push(&mut bytes, u64::from(other - last)),
                    Some(_) => {}
                }
            }
            from = end as usize;
        }
        starts.push(bytes.len() as u32);
        bytes.shrink_to_fit();
        Neighbours { starts, bytes }
    }

    /// How many elements there are.
    pub(super) fn len(&self) -> usize {
        self.starts.len().saturating_sub(1)
    }

    /// Those of an element, each once, ascending.
    #[inline]
    pub(super) fn of(&self, element: u32) -> impl Iterator<Item = u32> + Clone + '_ {
        let range = self.starts[element as usize] as usize..self.starts[element as usize + 1] as usize;
        Rest { bytes: &self.bytes[range], last: element, is_first: true }
    }

    /// Bytes held.
    pub(super) fn memory_bytes(&self) -> usize {
        self.starts.capacity() * size_of::<u32>() + self.bytes.capacity()
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

    /// Steps of one byte and of several, to both sides.
    #[test]
    fn neighbours_may_have_any_number() {
        const FAR: u32 = 3_000_000;
        let neighbours = Neighbours::new(FAR as usize + 1, &[[0, 200, FAR], [FAR, 0, 20_000], [200, 201, 264]]);
        let of = |element: u32| neighbours.of(element).collect::<Vec<u32>>();
        assert_eq!(of(0), [200, 20_000, FAR]);
        assert_eq!(of(200), [0, 201, 264, FAR]);
        assert_eq!(of(20_000), [0, FAR]);
        assert_eq!(of(FAR), [0, 200, 20_000]);
        assert_eq!(of(264), [200, 201]);
    }
}
