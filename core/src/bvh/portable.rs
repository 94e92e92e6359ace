//! Lanes for every CPU: plain arrays that the compiler vectorises with what the target has.

use super::lanes::{Lanes, SortedStack, Stack};
use super::node::{Node, WIDTH};

pub(super) struct Portable;

type Array = [f32; WIDTH];

#[inline(always)]
fn zip(a: Array, b: Array, f: impl Fn(f32, f32) -> f32) -> Array {
    std::array::from_fn(|i| f(a[i], b[i]))
}

impl Lanes for Portable {
    type Float = Array;
    type Mask = u32;

    #[inline(always)]
    unsafe fn splat(value: f32) -> Array {
        [value; WIDTH]
    }

    #[inline(always)]
    unsafe fn load(values: &Array) -> Array {
        *values
    }

    #[inline(always)]
    unsafe fn store(values: Array) -> Array {
        values
    }

    #[inline(always)]
    unsafe fn add(a: Array, b: Array) -> Array {
        zip(a, b, |a, b| a + b)
    }

    #[inline(always)]
    unsafe fn sub(a: Array, b: Array) -> Array {
        zip(a, b, |a, b| a - b)
    }

    #[inline(always)]
    unsafe fn mul(a: Array, b: Array) -> Array {
        zip(a, b, |a, b| a * b)
    }

    #[inline(always)]
    unsafe fn div(a: Array, b: Array) -> Array {
        zip(a, b, |a, b| a / b)
    }

    #[inline(always)]
    unsafe fn min(a: Array, b: Array) -> Array {
        zip(a, b, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    unsafe fn max(a: Array, b: Array) -> Array {
        zip(a, b, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    unsafe fn abs(a: Array) -> Array {
        a.map(f32::abs)
    }

    #[inline(always)]
    unsafe fn le(a: Array, b: Array) -> u32 {
        (0..WIDTH).fold(0, |bits, i| bits | u32::from(a[i] <= b[i]) << i)
    }

    #[inline(always)]
    unsafe fn lt(a: Array, b: Array) -> u32 {
        (0..WIDTH).fold(0, |bits, i| bits | u32::from(a[i] < b[i]) << i)
    }

    #[inline(always)]
    unsafe fn and(a: u32, b: u32) -> u32 {
        a & b
    }

    #[inline(always)]
    unsafe fn or(a: u32, b: u32) -> u32 {
        a | b
    }

    #[inline(always)]
    unsafe fn bits(mask: u32) -> u32 {
        mask
    }

    #[inline(always)]
    unsafe fn push_unsorted(stack: &mut Stack, node: &Node, entry: Array, exit: Array) {
        // SAFETY: needs no instruction set.
        let mut bits = unsafe { Self::le(entry, exit) };
        while bits != 0 {
            let slot = bits.trailing_zeros() as usize & (WIDTH - 1);
            // SAFETY: the caller left room for WIDTH children.
            unsafe { stack.children_top().write(node.children[slot]) };
            stack.grow(1);
            bits &= bits - 1;
        }
    }

    #[inline(always)]
    unsafe fn push_sorted(stack: &mut SortedStack, node: &Node, entry: Array, exit: Array, octant: u32) {
        for order in node.order {
            let slot = (order >> (3 * octant)) as usize & (WIDTH - 1);
            // SAFETY: the caller left room for WIDTH children; writing one that does not count is harmless.
            unsafe {
                stack.children_top().write(node.children[slot]);
                stack.entries_top().write(entry[slot]);
            }
            stack.grow(u32::from(entry[slot] <= exit[slot]));
        }
    }

    #[inline(always)]
    unsafe fn prefetch(_: *const u8, _: usize) {}
}
