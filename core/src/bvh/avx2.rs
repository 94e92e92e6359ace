//! Lanes in one AVX register; AVX2 for the integer permutations.

use super::lanes::{Lanes, SortedStack, Stack};
use super::node::{Node, WIDTH};
use super::traverse::{any_hit, closest_hit};
use super::{Bvh, Filter, Hit, Ray};
use std::arch::x86_64::*;

pub(super) struct Avx2;

/// For each set of lanes: the lanes in ascending order, for compressing them to the front of a register.
#[repr(align(32))]
struct Compress([[u32; WIDTH]; 256]);

static COMPRESS: Compress = {
    let mut table = [[0; WIDTH]; 256];
    let mut bits = 0;
    while bits < 256 {
        let (mut lane, mut count) = (0, 0);
        while lane < WIDTH {
            if bits >> lane & 1 != 0 {
                table[bits][count] = lane as u32;
                count += 1;
            }
            lane += 1;
        }
        bits += 1;
    }
    Compress(table)
};

/// Arithmetic on AVX registers, shared by [`Avx2`] and AVX-512.
macro_rules! avx_arithmetic {
    () => {
        type Float = __m256;

        #[inline(always)]
        unsafe fn splat(value: f32) -> __m256 {
            // SAFETY: the CPU has AVX (contract of the trait).
            unsafe { _mm256_set1_ps(value) }
        }

        #[inline(always)]
        unsafe fn load(values: &[f32; WIDTH]) -> __m256 {
            // SAFETY: AVX as above; the reference covers the eight values read.
            unsafe { _mm256_loadu_ps(values.as_ptr()) }
        }

        #[inline(always)]
        unsafe fn store(values: __m256) -> [f32; WIDTH] {
            let mut stored = [0.0; WIDTH];
            // SAFETY: AVX as above; the array holds the eight values written.
            unsafe { _mm256_storeu_ps(stored.as_mut_ptr(), values) };
            stored
        }

        avx_arithmetic!(
            add _mm256_add_ps, sub _mm256_sub_ps, mul _mm256_mul_ps,
            div _mm256_div_ps, min _mm256_min_ps, max _mm256_max_ps
        );

        #[inline(always)]
        unsafe fn abs(a: __m256) -> __m256 {
            // SAFETY: the CPU has AVX (contract of the trait).
            unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), a) }
        }

        #[inline(always)]
        unsafe fn prefetch(address: *const u8, bytes: usize) {
            for line in 0..bytes / 64 {
                // SAFETY: SSE is part of x86-64; a prefetch never faults.
                unsafe { _mm_prefetch::<_MM_HINT_T0>(address.wrapping_add(64 * line).cast()) };
            }
        }
    };
    ($($name:ident $intrinsic:ident),*) => {$(
        #[inline(always)]
        unsafe fn $name(a: __m256, b: __m256) -> __m256 {
            // SAFETY: the CPU has AVX (contract of the trait).
            unsafe { $intrinsic(a, b) }
        }
    )*};
}
pub(super) use avx_arithmetic;

/// The tree's entry points with the instruction set enabled, into which the generic traversal inlines.
macro_rules! entry_points {
    ($lanes:ty, $features:literal) => {
        /// # Safety
        /// The CPU has the instruction set.
        #[target_feature(enable = $features)]
        pub(super) unsafe fn closest<F: Filter>(bvh: &Bvh, ray: &Ray, filter: &mut F) -> Option<Hit> {
            // SAFETY: the features are enabled here.
            unsafe { closest_hit::<$lanes, F>(bvh, ray, filter) }
        }

        /// # Safety
        /// The CPU has the instruction set.
        #[target_feature(enable = $features)]
        pub(super) unsafe fn any<F: Filter>(bvh: &Bvh, ray: &Ray, filter: &mut F) -> bool {
            // SAFETY: the features are enabled here.
            unsafe { any_hit::<$lanes, F>(bvh, ray, filter) }
        }
    };
}
pub(super) use entry_points;

entry_points!(Avx2, "avx2,bmi1,bmi2,popcnt,lzcnt");

impl Lanes for Avx2 {
    type Mask = __m256;

    avx_arithmetic!();

    #[inline(always)]
    unsafe fn le(a: __m256, b: __m256) -> __m256 {
        // SAFETY: the CPU has AVX (contract of the trait).
        unsafe { _mm256_cmp_ps::<_CMP_LE_OQ>(a, b) }
    }

    #[inline(always)]
    unsafe fn lt(a: __m256, b: __m256) -> __m256 {
        // SAFETY: the CPU has AVX (contract of the trait).
        unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(a, b) }
    }

    #[inline(always)]
    unsafe fn and(a: __m256, b: __m256) -> __m256 {
        // SAFETY: the CPU has AVX (contract of the trait).
        unsafe { _mm256_and_ps(a, b) }
    }

    #[inline(always)]
    unsafe fn or(a: __m256, b: __m256) -> __m256 {
        // SAFETY: the CPU has AVX (contract of the trait).
        unsafe { _mm256_or_ps(a, b) }
    }

    #[inline(always)]
    unsafe fn bits(mask: __m256) -> u32 {
        // SAFETY: the CPU has AVX (contract of the trait).
        unsafe { _mm256_movemask_ps(mask) as u32 }
    }

    #[inline(always)]
    unsafe fn push_unsorted(stack: &mut Stack, node: &Node, entry: __m256, exit: __m256) {
        // SAFETY: the CPU has AVX2 and the stack room for WIDTH children (contract of the trait); the table has an
        // entry for every set of eight lanes, and node and table are aligned to 32 bytes.
        unsafe {
            let bits = Self::bits(Self::le(entry, exit));
            let lanes = _mm256_load_si256(COMPRESS.0.as_ptr().add(bits as usize).cast());
            let children = _mm256_load_si256(node.children.as_ptr().cast());
            _mm256_storeu_si256(stack.children_top().cast(), _mm256_permutevar8x32_epi32(children, lanes));
            stack.grow(bits.count_ones());
        }
    }

    #[inline(always)]
    unsafe fn push_sorted(stack: &mut SortedStack, node: &Node, entry: __m256, exit: __m256, octant: u32) {
        // SAFETY: as in `push_unsorted`. The permutations look only at the lowest three bits of their indices.
        unsafe {
            let shift = _mm_cvtsi32_si128(3 * octant as i32);
            let order = _mm256_srl_epi32(_mm256_load_si256(node.order.as_ptr().cast()), shift);
            let bits = Self::bits(_mm256_permutevar8x32_ps(Self::le(entry, exit), order));
            let lanes = _mm256_load_si256(COMPRESS.0.as_ptr().add(bits as usize).cast());
            let slots = _mm256_permutevar8x32_epi32(order, lanes);
            let children = _mm256_load_si256(node.children.as_ptr().cast());
            _mm256_storeu_si256(stack.children_top().cast(), _mm256_permutevar8x32_epi32(children, slots));
            _mm256_storeu_ps(stack.entries_top(), _mm256_permutevar8x32_ps(entry, slots));
            stack.grow(bits.count_ones());
        }
    }
}
