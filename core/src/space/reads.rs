//! Corners of cells that are no elements: where triangles of a file are smaller than light needs, or long and thin, many share
//! some. Light at such a corner is a mean over the elements around it.

use glam::Vec3;

use super::cells::{Cells, NONE, Patch};
use super::layout::Elements;
use crate::surface::{Surface, triangle_area};

/// The elements whose light a corner of a cell has, and their weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Read {
    /// Some may be the same.
    pub elements: [u32; 3],
    /// Not negative, of sum 1.
    pub weights: [f32; 3],
}

impl Read {
    /// Of an element where it is.
    pub(crate) fn own(element: u32) -> Read {
        Read { elements: [element; 3], weights: [1.0, 0.0, 0.0] }
    }

    /// Whether it is all of one element.
    pub(crate) fn is_one(&self) -> bool {
        self.weights[0] == 1.0
    }

    /// Of the elements so many places behind.
    pub(crate) fn after(self, count: u32) -> Read {
        Read { elements: self.elements.map(|element| element + count), ..self }
    }

    /// The weighted mean of some values, one per element.
    pub(crate) fn of(&self, values: &[Vec3]) -> Vec3 {
        self.parts().map(|(element, weight)| values[element as usize] * weight).sum()
    }

    /// The elements with their weights.
    pub(crate) fn parts(&self) -> impl Iterator<Item = (u32, f32)> {
        self.elements.into_iter().zip(self.weights)
    }
}

/// What a point of a triangle reads, by its weights among the corners: the three elements that count most there.
#[inline]
pub(super) fn mixed(corners: [&Read; 3], weights: [f32; 3]) -> Read {
    let (mut parts, mut count) = ([(0_u32, 0.0_f32); 9], 0);
    for (read, weight) in corners.into_iter().zip(weights) {
        for (element, part) in read.parts() {
            let weight = weight.max(0.0) * part;
            match parts[..count].iter_mut().find(|known| known.0 == element) {
                Some(known) => known.1 += weight,
                None => {
                    parts[count] = (element, weight);
                    count += 1;
                }
            }
        }
    }
    let is_more = |a: (u32, f32), b: (u32, f32)| a.1 > b.1 || a.1 == b.1 && a.0 < b.0;
    for k in 0..count.min(3) {
        let mut best = k;
        for other in k + 1..count {
            if is_more(parts[other], parts[best]) {
                best = other;
            }
        }
        parts.swap(k, best);
    }
    (count.min(3)..3).for_each(|k| parts[k] = (parts[0].0, 0.0));
    let sum = parts[0].1 + parts[1].1 + parts[2].1;
    Read {
        elements: [parts[0].0, parts[1].0, parts[2].0],
        weights: [parts[0].1, parts[1].1, parts[2].1].map(|w| w / sum),
    }
}

impl Cells {
    /// What a point among some corners reads.
    #[inline]
    pub(super) fn mix(&self, corners: [u32; 3], weights: [f32; 3]) -> Read {
        mixed(corners.map(|corner| &self.reads[corner as usize]), weights)
    }

    /// What the corners of a cell read.
    pub(super) fn reads_of(&self, patch: &Patch) -> [Read; 3] {
        match self.reads.is_empty() {
            true => patch.elements.map(Read::own),
            false => patch.points.map(|corner| self.reads[corner as usize]),
        }
    }

    /// Leaves out the elements of corners that read others, and returns those that are left. `reads`: per corner, with
    /// elements as they are numbered now.
    pub(super) fn share(&mut self, surface: &Surface, mut reads: Vec<Read>, elements: &Elements) -> Elements {
        let mut left = Elements::default();
        let mut number = vec![NONE; reads.len()];
        for old in (0..reads.len()).filter(|&old| reads[old] == Read::own(old as u32)) {
            number[old] = left.positions.len() as u32;
            left.positions.push(elements.positions[old]);
            left.normals.push(elements.normals[old]);
        }
        reads.iter_mut().flat_map(|read| &mut read.elements).for_each(|element| *element = number[*element as usize]);
        self.reads = reads;
        left.areas = self.areas(surface, left.positions.len());
        left
    }

    /// The area that reads each element, m²; always above zero.
    fn areas(&self, surface: &Surface, elements: usize) -> Vec<f32> {
        let mut areas = vec![0.0_f64; elements];
        for (reads, area) in
            self.collect(surface, |_| true, |patch| Some((self.reads_of(patch), triangle_area(patch.corners))))
        {
            for (element, weight) in reads.iter().flat_map(Read::parts) {
                areas[element as usize] += area / 3.0 * f64::from(weight);
            }
        }
        areas.into_iter().map(|area| (area as f32).max(f32::MIN_POSITIVE)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_reads_the_elements_that_count_most() {
        let [a, b] = [Read::own(4), Read::own(7)];
        let c = Read { elements: [4, 9, 2], weights: [0.5, 0.25, 0.25] };
        assert_eq!(mixed([&a, &b, &c], [1.0, 0.0, 0.0]).parts().next(), Some((4, 1.0)));
        // 4: 0.2 + 0.25, 7: 0.3, 9 and 2: 0.125 each, of which the first counts.
        let read = mixed([&a, &b, &c], [0.2, 0.3, 0.5]);
        assert_eq!(read.elements, [4, 7, 2]);
        let sum = 0.45 + 0.3 + 0.125;
        assert!(read.weights.iter().zip([0.45, 0.3, 0.125]).all(|(w, part)| (w - part / sum).abs() < 1e-6));
        // Where fewer are read than three, the first stands for those that are not there.
        let read = mixed([&a, &a, &b], [0.25, 0.25, 0.5]);
        assert_eq!((read.elements, read.weights), ([4, 7, 4], [0.5, 0.5, 0.0]));
    }
}
