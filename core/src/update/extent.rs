//! Where a quantity is estimated element by element, and where it is interpolated from representatives.

use rayon::prelude::*;

use crate::solve::Subset;
use crate::transport::for_slots;
use crate::value::Value;

const NONE: u32 = u32::MAX;

/// A division of some slots.
pub(super) struct Extent {
    /// Slots that are estimated themselves, ascending.
    pub fine: Vec<u32>,
    /// Slots of the representatives that others are interpolated from.
    pub representatives: Vec<u32>,
    /// Per slot: whether its value is interpolated; empty where none is.
    is_spread: Vec<bool>,
    /// Per representative of the subset: its place among `fine` and `representatives`, one behind the other, or `NONE`.
    places: Vec<u32>,
}

impl Extent {
    /// Divides `of` (slots, ascending), of a world of `slots` slots.
    pub(super) fn new(of: &[u32], subset: &Subset, slots: usize, is_fine: impl Fn(u32) -> bool) -> Extent {
        let (fine, spread): (Vec<u32>, Vec<u32>) = of.iter().partition(|&&slot| is_fine(slot));
        let is_spread = flags(&spread, slots);
        let is_representative = |slot: u32| is_spread.get(slot as usize).copied().unwrap_or(false);
        let representatives = subset.slots.iter().copied().filter(|&slot| is_representative(slot)).collect();
        Extent::of(fine, representatives, is_spread, subset)
    }

    /// Slots that are looked at, and nothing else: representatives of others among those that theirs are interpolated
    /// from.
    pub(super) fn only(of: &[u32], subset: &Subset, slots: usize, is_fine: impl Fn(u32) -> bool) -> Extent {
        let (fine, spread): (Vec<u32>, Vec<u32>) = of.iter().partition(|&&slot| is_fine(slot));
        let needed = subset.needed_by(&spread, slots);
        let representatives = subset.slots.iter().copied().filter(|&slot| needed[slot as usize]).collect();
        Extent::of(fine, representatives, flags(&spread, slots), subset)
    }

    fn of(fine: Vec<u32>, representatives: Vec<u32>, is_spread: Vec<bool>, subset: &Subset) -> Extent {
        let mut places = Vec::new();
        if !is_spread.is_empty() {
            let mut of_slot = vec![NONE; is_spread.len()];
            fine.iter().chain(&representatives).zip(0..).for_each(|(&slot, place)| of_slot[slot as usize] = place);
            places = subset.slots.iter().map(|&slot| of_slot[slot as usize]).collect();
        }
        Extent { fine, representatives, is_spread, places }
    }

    /// Whether all slots are estimated themselves.
    pub(super) fn is_fine(&self) -> bool {
        self.is_spread.is_empty()
    }

    /// Adds values to all slots: those of `fine` and `representatives`, in that order.
    pub(super) fn add<V: Value>(&self, subset: &Subset, fine: &[V], representatives: &[V], out: &mut [V]) {
        self.fine.iter().zip(fine).for_each(|(&slot, v)| out[slot as usize] += *v);
        if self.is_fine() {
            return;
        }
        let value = |&place: &u32| match place as usize {
            k if k < fine.len() => fine[k],
            k => representatives.get(k - fine.len()).copied().unwrap_or_default(),
        };
        let values: Vec<V> = self.places.par_iter().with_min_len(1024).map(value).collect();
        subset.add_where(|slot| self.is_spread[slot as usize], &values, out);
    }
}

/// Flags of some slots; none at all where there are none.
fn flags(of: &[u32], slots: usize) -> Vec<bool> {
    if of.is_empty() {
        return Vec::new();
    }
    let mut flags = vec![false; slots];
    for_slots(of, &mut flags, |_, flag| *flag = true);
    flags
}
