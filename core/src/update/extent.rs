//! Where a quantity is estimated element by element, and where it is interpolated from representatives.

use rayon::prelude::*;

use crate::solve::Subset;
use crate::transport::Value;

/// A division of some rows.
pub(super) struct Extent {
    /// Slots that are estimated themselves.
    pub fine: Vec<u32>,
    /// Slots whose values are interpolated.
    pub spread: Vec<u32>,
    /// Slots of the representatives among `spread`.
    pub representatives: Vec<u32>,
}

impl Extent {
    /// Divides `rows` (slots) of a world of `slots` slots.
    pub(super) fn new(rows: &[u32], subset: &Subset, slots: usize, is_fine: impl Fn(u32) -> bool) -> Extent {
        let (fine, spread): (Vec<u32>, Vec<u32>) = rows.iter().partition(|&&slot| is_fine(slot));
        let mut representatives = Vec::new();
        if !spread.is_empty() {
            let mut is_spread = vec![false; slots];
            spread.iter().for_each(|&slot| is_spread[slot as usize] = true);
            representatives = subset.slots.iter().copied().filter(|&slot| is_spread[slot as usize]).collect();
        }
        Extent { fine, spread, representatives }
    }

    /// Rows that are looked at, and nothing else: representatives of others among those that theirs are interpolated from.
    pub(super) fn only(rows: &[u32], subset: &Subset, slots: usize, is_fine: impl Fn(u32) -> bool) -> Extent {
        let (fine, spread): (Vec<u32>, Vec<u32>) = rows.iter().partition(|&&slot| is_fine(slot));
        let needed = subset.needed_by(&spread, slots);
        let representatives = subset.slots.iter().copied().filter(|&slot| needed[slot as usize]).collect();
        Extent { fine, spread, representatives }
    }

    /// Adds values to all rows: those of `fine` and `representatives`, in that order.
    pub(super) fn add<V: Value>(&self, subset: &Subset, fine: &[V], representatives: &[V], out: &mut [V]) {
        self.fine.iter().zip(fine).for_each(|(&slot, v)| out[slot as usize] += *v);
        if self.spread.is_empty() {
            return;
        }
        const NONE: u32 = u32::MAX;
        let mut place = vec![NONE; out.len()];
        self.fine.iter().chain(&self.representatives).zip(0..).for_each(|(&slot, k)| place[slot as usize] = k);
        let value = |&slot: &u32| match place[slot as usize] as usize {
            k if k < fine.len() => fine[k],
            k if k - fine.len() < representatives.len() => representatives[k - fine.len()],
            _ => V::default(),
        };
        let values: Vec<V> = subset.slots.par_iter().map(value).collect();
        let field = subset.interpolate(&values);
        self.spread.iter().for_each(|&slot| out[slot as usize] += field[slot as usize]);
    }
}
