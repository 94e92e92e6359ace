//! Eight `f32` lanes, and what traversal needs beyond arithmetic. One implementation per instruction set.
//!
//! No implementation may fuse or reorder: all give the same bits, so that a light map does not depend on the CPU.
//! Fused products would also break the edge test (see `traverse`) and, in the slab test, leak far from the origin.

use super::node::{ChildRef, Node, STACK_SIZE, WIDTH};
use std::marker::PhantomData;
use std::mem::MaybeUninit;

/// An instruction set.
///
/// # Safety
/// Every method requires that the CPU has the instruction set, and inlines into its caller: the outermost caller
/// carries `#[target_feature]`. `push_*` require room for `WIDTH` entries on the stack.
pub(super) trait Lanes {
    /// Eight numbers.
    type Float: Copy;
    /// Eight truth values.
    type Mask: Copy;

    unsafe fn splat(value: f32) -> Self::Float;
    unsafe fn load(values: &[f32; WIDTH]) -> Self::Float;
    unsafe fn store(values: Self::Float) -> [f32; WIDTH];

    unsafe fn add(a: Self::Float, b: Self::Float) -> Self::Float;
    unsafe fn sub(a: Self::Float, b: Self::Float) -> Self::Float;
    unsafe fn mul(a: Self::Float, b: Self::Float) -> Self::Float;
    unsafe fn div(a: Self::Float, b: Self::Float) -> Self::Float;
    /// `a < b ? a : b`: the second operand wherever either is NaN.
    unsafe fn min(a: Self::Float, b: Self::Float) -> Self::Float;
    /// `a > b ? a : b`: the second operand wherever either is NaN.
    unsafe fn max(a: Self::Float, b: Self::Float) -> Self::Float;
    unsafe fn abs(a: Self::Float) -> Self::Float;

    /// `a ≤ b`, false for NaN.
    unsafe fn le(a: Self::Float, b: Self::Float) -> Self::Mask;
    /// `a < b`, false for NaN.
    unsafe fn lt(a: Self::Float, b: Self::Float) -> Self::Mask;
    unsafe fn and(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    unsafe fn or(a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// Bit `i` is lane `i`.
    unsafe fn bits(mask: Self::Mask) -> u32;

    /// Pushes the children with `entry ≤ exit` in any order, without their distances.
    unsafe fn push_unsorted(stack: &mut Stack, node: &Node, entry: Self::Float, exit: Self::Float);
    /// Pushes the children with `entry ≤ exit` and their entry distances, far to near.
    unsafe fn push_sorted(stack: &mut SortedStack, node: &Node, entry: Self::Float, exit: Self::Float, octant: u32);

    /// Starts to load the first `bytes` behind `address` (any address is allowed).
    unsafe fn prefetch(address: *const u8, bytes: usize);
}

/// Room for a [`Stack`], left uninitialised.
#[repr(C, align(64))]
pub(super) struct StackMemory {
    children: MaybeUninit<[ChildRef; STACK_SIZE]>,
    entries: MaybeUninit<[f32; STACK_SIZE]>,
}

impl StackMemory {
    #[inline(always)]
    pub(super) fn new() -> Self {
        Self { children: MaybeUninit::uninit(), entries: MaybeUninit::uninit() }
    }
}

/// What is still to be visited, in any order. Never overflows: see [`STACK_SIZE`]. Apart from its memory, so that it
/// lives in registers.
pub(super) struct Stack<'a> {
    children: *mut ChildRef,
    len: usize,
    memory: PhantomData<&'a mut StackMemory>,
}

impl<'a> Stack<'a> {
    #[inline(always)]
    pub(super) fn new(memory: &'a mut StackMemory) -> Self {
        Self { children: memory.children.as_mut_ptr().cast(), len: 0, memory: PhantomData }
    }

    /// Where the next child goes. A push writes `WIDTH` children here, then grows the stack by those that count.
    #[inline(always)]
    pub(super) fn children_top(&mut self) -> *mut ChildRef {
        debug_assert!(self.len + WIDTH <= STACK_SIZE);
        self.children.wrapping_add(self.len)
    }

    #[inline(always)]
    pub(super) fn grow(&mut self, count: u32) {
        self.len += count as usize;
    }

    /// The next child.
    #[inline(always)]
    pub(super) fn pop(&mut self) -> Option<ChildRef> {
        self.len = self.len.checked_sub(1)?;
        // SAFETY: `len` is below what the pushes grew it to, and they initialised all below.
        Some(unsafe { self.children.add(self.len).read() })
    }

    /// What `pop` would return.
    #[inline(always)]
    pub(super) fn peek(&self) -> Option<ChildRef> {
        let last = self.len.checked_sub(1)?;
        // SAFETY: as in `pop`.
        Some(unsafe { self.children.add(last).read() })
    }
}

/// What is still to be visited, with the distance at which each box is entered. Only [`Lanes::push_sorted`] pushes to it,
/// which writes both: no distance is read that was never written.
pub(super) struct SortedStack<'a> {
    children: Stack<'a>,
    entries: *mut f32,
}

impl<'a> SortedStack<'a> {
    #[inline(always)]
    pub(super) fn new(memory: &'a mut StackMemory) -> Self {
        let StackMemory { children, entries } = memory;
        let children = Stack { children: children.as_mut_ptr().cast(), len: 0, memory: PhantomData };
        Self { children, entries: entries.as_mut_ptr().cast() }
    }

    /// The children, without their distances.
    #[inline(always)]
    pub(super) fn children(&self) -> &Stack<'a> {
        &self.children
    }

    /// Where the next child goes. A push writes `WIDTH` children here, as many distances to
    /// [`SortedStack::entries_top`], then grows the stack by those that count.
    #[inline(always)]
    pub(super) fn children_top(&mut self) -> *mut ChildRef {
        self.children.children_top()
    }

    /// Where the next entry distance goes.
    #[inline(always)]
    pub(super) fn entries_top(&mut self) -> *mut f32 {
        self.entries.wrapping_add(self.children.len)
    }

    #[inline(always)]
    pub(super) fn grow(&mut self, count: u32) {
        self.children.grow(count);
    }

    /// The next child whose box is entered no later than `limit`.
    #[inline(always)]
    pub(super) fn pop_nearer(&mut self, limit: f32) -> Option<ChildRef> {
        loop {
            let child = self.children.pop()?;
            // SAFETY: every push has written a distance for every child.
            if unsafe { self.entries.add(self.children.len).read() } <= limit {
                return Some(child);
            }
        }
    }
}
