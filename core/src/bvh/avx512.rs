//! Lanes in one AVX register with the mask registers and the compression of AVX-512VL.

use super::avx2::{avx_arithmetic, entry_points};
use super::lanes::{Lanes, SortedStack, Stack};
use super::node::{Node, WIDTH};
use super::traverse::{any_hit, closest_hit};
use super::{Bvh, Filter, Hit, Ray};
use std::arch::x86_64::*;

pub(super) struct Avx512;

entry_points!(Avx512, "avx512f,avx512vl,avx512dq,avx512bw,avx2,bmi1,bmi2,popcnt,lzcnt");

impl Lanes for Avx512 {
    type Mask = __mmask8;

    avx_arithmetic!();

    #[inline(always)]
    unsafe fn le(a: __m256, b: __m256) -> __mmask8 {
        // SAFETY: the CPU has AVX-512VL (contract of the trait).
        unsafe { _mm256_cmp_ps_mask::<_CMP_LE_OQ>(a, b) }
    }

    #[inline(always)]
    unsafe fn lt(a: __m256, b: __m256) -> __mmask8 {
        // SAFETY: the CPU has AVX-512VL (contract of the trait).
        unsafe { _mm256_cmp_ps_mask::<_CMP_LT_OQ>(a, b) }
    }

    #[inline(always)]
    unsafe fn and(a: __mmask8, b: __mmask8) -> __mmask8 {
        a & b
    }

    #[inline(always)]
    unsafe fn or(a: __mmask8, b: __mmask8) -> __mmask8 {
        a | b
    }

    #[inline(always)]
    unsafe fn bits(mask: __mmask8) -> u32 {
        u32::from(mask)
    }

    #[inline(always)]
    unsafe fn push_unsorted(stack: &mut Stack, node: &Node, entry: __m256, exit: __m256) {
        // SAFETY: the CPU has AVX-512VL and the stack room for WIDTH children (contract of the trait); nodes are
        // aligned to 64 bytes.
        unsafe {
            let entered = _mm256_cmp_ps_mask::<_CMP_LE_OQ>(entry, exit);
            let children = _mm256_load_si256(node.children.as_ptr().cast());
            _mm256_storeu_si256(stack.children_top().cast(), _mm256_maskz_compress_epi32(entered, children));
            stack.grow(entered.count_ones());
        }
    }

    #[inline(always)]
    unsafe fn push_sorted(stack: &mut SortedStack, node: &Node, entry: __m256, exit: __m256, octant: u32) {
        // SAFETY: as in `push_unsorted`. The permutations look only at the lowest three bits of their indices.
        unsafe {
            let shift = _mm_cvtsi32_si128(3 * octant as i32);
            let order = _mm256_srl_epi32(_mm256_load_si256(node.order.as_ptr().cast()), shift);
            let children = _mm256_permutevar8x32_epi32(_mm256_load_si256(node.children.as_ptr().cast()), order);
            let (entry, exit) = (_mm256_permutevar8x32_ps(entry, order), _mm256_permutevar8x32_ps(exit, order));
            let entered = _mm256_cmp_ps_mask::<_CMP_LE_OQ>(entry, exit);
            _mm256_storeu_si256(stack.children_top().cast(), _mm256_maskz_compress_epi32(entered, children));
            _mm256_storeu_ps(stack.entries_top(), _mm256_maskz_compress_ps(entered, entry));
            stack.grow(entered.count_ones());
        }
    }
}
