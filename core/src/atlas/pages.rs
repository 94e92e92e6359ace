//! Rectangles on pages. One that is there stays where it is; what is freed is given again.

use std::fmt::{Debug, Formatter};

use guillotiere::{AllocId, AtlasAllocator, size2};

/// Longest side of a page, texels.
pub const MAX_PAGE_SIDE: u32 = 4096;

/// Longest side of a page that more than one object lies on, texels.
const MAX_SHARED_SIDE: u32 = 2048;

const MIN_SIDE: u32 = 64;

/// A rectangle of a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rectangle {
    /// Index of the page.
    pub page: usize,
    /// First column and row, texels from the top left.
    pub corner: [u32; 2],
    /// Width and height, texels.
    pub size: [u32; 2],
    id: AllocId,
}

/// All pages of an atlas.
#[derive(Clone, Default)]
pub(super) struct Pages {
    list: Vec<AtlasAllocator>,
    /// Side of a page that is added; 0 before the first.
    side: u32,
}

impl Debug for Pages {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.sizes()).finish()
    }
}

impl Pages {
    /// Widths and heights.
    pub(super) fn sizes(&self) -> impl Iterator<Item = [u32; 2]> + '_ {
        self.list.iter().map(|page| [page.size().width as u32, page.size().height as u32])
    }

    /// Chooses the size of pages, before the first, for so many texels in all.
    pub(super) fn expect(&mut self, texels: u64) {
        if self.side == 0 {
            // Some of a page is lost between rectangles.
            let side = (texels as f64 * 1.1).sqrt().ceil() as u32;
            self.side = side.next_power_of_two().clamp(MIN_SIDE, MAX_SHARED_SIDE);
        }
    }

    /// A rectangle of a size of at most [`MAX_PAGE_SIDE`] either way: on the first page that has room, or on a new one.
    pub(super) fn allocate(&mut self, size: [u32; 2]) -> Rectangle {
        let asked = size2(size[0] as i32, size[1] as i32);
        let on = |(page, allocator): (usize, &mut AtlasAllocator)| {
            let found = allocator.allocate(asked)?;
            let corner = [found.rectangle.min.x as u32, found.rectangle.min.y as u32];
            Some(Rectangle { page, corner, size, id: found.id })
        };
        if let Some(found) = self.list.iter_mut().enumerate().find_map(on) {
            return found;
        }
        let side = |of: u32| of.next_power_of_two().max(self.side.max(MIN_SIDE)) as i32;
        self.list.push(AtlasAllocator::new(size2(side(size[0]), side(size[1]))));
        self.list.iter_mut().enumerate().last().and_then(on).expect("an empty page that is larger than the rectangle")
    }

    /// Gives a rectangle back.
    pub(super) fn free(&mut self, rectangle: &Rectangle) {
        self.list[rectangle.page].deallocate(rectangle.id);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Pcg32;

    #[test]
    fn rectangles_that_come_and_go_never_meet_and_never_leave_their_page() {
        let (mut pages, mut rng) = (Pages::default(), Pcg32::new(1, 1));
        pages.expect(100_000);
        let mut live: Vec<Rectangle> = Vec::new();
        for _ in 0..600 {
            if live.len() > 40 && rng.next_u32() % 2 == 0 {
                let index = rng.next_u32() as usize % live.len();
                pages.free(&live.swap_remove(index));
            }
            let size = [1 + rng.next_u32() % 120, 1 + rng.next_u32() % 90];
            let new = pages.allocate(size);
            assert_eq!(new.size, size);
            let page = pages.sizes().nth(new.page).expect("a page");
            assert!((0..2).all(|k| new.corner[k] + size[k] <= page[k]));
            let apart = |other: &Rectangle| {
                other.page != new.page
                    || (0..2).any(|k| {
                        other.corner[k] + other.size[k] <= new.corner[k] || new.corner[k] + size[k] <= other.corner[k]
                    })
            };
            assert!(live.iter().all(apart), "{new:?} {live:?}");
            live.push(new);
        }
        let huge = pages.allocate([MAX_PAGE_SIDE, 9]);
        assert_eq!(pages.sizes().nth(huge.page), Some([MAX_PAGE_SIDE, 512]));
    }
}
