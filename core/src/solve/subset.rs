//! The elements at which smooth light is evaluated, over a whole world.

use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use crate::ranges::split_mut;
use crate::transport::{Surfel, blacken};
use crate::value::Value;
use crate::world::{Hidden, Placed, World};

const NONE: u32 = u32::MAX;

/// Elements per task.
const CHUNK: usize = 1024;

/// Representatives of all objects, and the way back from their values to all elements.
pub(crate) struct Subset {
    /// Element slots of the representatives, object by object.
    pub slots: Vec<u32>,
    sides: Vec<Side>,
    /// Indices of `sides` in the order of their slots.
    by_slot: Vec<usize>,
    /// Index of the front's side, by part; the back's comes next.
    side_of_part: Vec<u32>,
    len: usize,
}

/// One side of one object.
struct Side {
    placed: Arc<Placed>,
    first_slot: u32,
    back: bool,
    /// Indices into `Subset::slots`.
    members: Range<usize>,
    /// Per representative of the object: index into `Subset::slots`, or `NONE` where it is not computed.
    index: Vec<u32>,
    /// Entries of the object's weights whose representative the element does not see: a wall stands between.
    hidden: Arc<Hidden>,
    /// Elements none of whose representatives is computed: (element of the object, index into `Subset::slots`).
    alone: Vec<(u32, u32)>,
}

impl Subset {
    /// Collects the representatives of a world.
    pub(crate) fn new(world: &World) -> Subset {
        let mut side_of_part = vec![0; world.space.parts().len()];
        let mut ends = Vec::new();
        for placed in &world.placed {
            side_of_part[placed.placement.part_indices()].fill(ends.len() as u32);
            ends.push((placed, false));
            if placed.with_back {
                ends.push((placed, true));
            }
        }
        let sides: Vec<(Side, Vec<u32>)> =
            ends.into_par_iter().map(|(placed, back)| Side::new(world, placed, back)).collect();
        let mut by_slot: Vec<usize> = (0..sides.len()).collect();
        by_slot.sort_by_key(|&k| sides[k].0.first_slot);
        let (mut slots, mut placed) = (Vec::new(), Vec::with_capacity(sides.len()));
        for (mut side, own) in sides {
            side.begin_at(slots.len() as u32);
            slots.extend(own);
            placed.push(side);
        }
        Subset { slots, sides: placed, by_slot, side_of_part, len: world.slots() }
    }

    /// Per slot: whether it is a representative that some of `wanted`, ascending, are interpolated from.
    pub(crate) fn needed_by(&self, wanted: &[u32], slots: usize) -> Vec<bool> {
        let mut needed = vec![false; slots];
        let index = |slot: u32| wanted.partition_point(|&other| other < slot);
        for side in &self.sides {
            let own = side.first_slot..side.first_slot + side.placed.layout.len() as u32;
            let own = &wanted[index(own.start)..index(own.end)];
            let mut need = |i: usize| needed[self.slots[i] as usize] = true;
            for slot in own {
                side.entries_of(slot - side.first_slot).for_each(|(i, _)| need(i));
            }
            let is_wanted = |element: &u32| own.binary_search(&(side.first_slot + element)).is_ok();
            if !own.is_empty() {
                side.alone.iter().filter(|(element, _)| is_wanted(element)).for_each(|&(_, i)| need(i as usize));
            }
        }
        needed
    }

    /// Per slot: the representative that weighs most in it, as index into `slots`; `u32::MAX` where there is none.
    pub(crate) fn cells(&self) -> Vec<u32> {
        let mut cells = vec![NONE; self.len];
        for side in &self.sides {
            for element in 0..side.placed.layout.len() as u32 {
                if let Some((i, _)) = side.entries_of(element).next() {
                    cells[(side.first_slot + element) as usize] = i as u32;
                }
            }
            side.alone.iter().for_each(|&(element, i)| cells[(side.first_slot + element) as usize] = i);
        }
        cells
    }

    /// m² of the elements that are interpolated from each representative, by weight, as if all of them were computed and
    /// nothing stood between them.
    pub(crate) fn areas(&self, world: &World) -> Vec<f32> {
        let of_side = |side: &Side| {
            let computed = side.index.iter().zip(&side.placed.coarse.areas).filter(|(index, _)| **index != NONE);
            let mut areas: Vec<f32> = computed.map(|(_, area)| *area).collect();
            areas.extend(side.alone.iter().map(|(element, _)| world.areas()[(side.first_slot + element) as usize]));
            areas
        };
        self.sides.iter().flat_map(of_side).collect()
    }

    /// Bytes of its own; surfaces and their weights belong to the world.
    pub(crate) fn memory_bytes(&self) -> usize {
        let side = |side: &Side| size_of_val(side.index.as_slice()) + size_of_val(side.alone.as_slice());
        size_of_val(self.slots.as_slice()) + self.sides.iter().map(side).sum::<usize>()
    }

    /// Values at the representatives carried to all slots, over what `out` holds; zero in holes.
    pub(crate) fn interpolate<V: Value>(&self, values: &[V], out: &mut Vec<V>) {
        blacken(out, self.len);
        self.add_where(|_| true, values, out);
    }

    /// Values at the representatives carried to the slots that are wanted, and added to `out` there.
    pub(crate) fn add_where<V: Value>(&self, is_wanted: impl Fn(u32) -> bool + Sync, values: &[V], out: &mut [V]) {
        self.interpolate_where(is_wanted, values, out, |out, value| *out += *value);
    }

    /// Values at the representatives carried to the slots that are wanted, and added there by `add`.
    pub(crate) fn interpolate_where<V: Value, W: Send>(
        &self,
        is_wanted: impl Fn(u32) -> bool + Sync,
        values: &[V],
        out: &mut [W],
        add: impl Fn(&mut W, &V) + Sync,
    ) {
        let sides = || self.by_slot.iter().map(|&k| &self.sides[k]);
        let parts = split_mut(out, sides().map(Side::range));
        let sides = sides().zip(parts).collect::<Vec<_>>().into_par_iter();
        sides.for_each(|(side, out)| side.interpolate_where(&is_wanted, values, out, &add));
    }

    /// One of the representatives that a look-up is interpolated from, with its weight as probability; none where no
    /// slot of it has any.
    #[inline]
    pub(crate) fn sample(&self, world: &World, surfel: &Surfel, u: [f32; 3]) -> Option<u32> {
        let footprint = surfel.footprint?;
        let (slots, k) = (footprint.slots(), footprint.drawn(u[0]));
        let front = self.side_of_part[surfel.part as usize] as usize;
        (0..slots.len()).find_map(|i| {
            let slot = slots[(k + i) % slots.len()];
            let slot = if world.is_valid(slot as usize) { slot } else { world.validity.stand_in(slot, u[2]) };
            self.sides[front].sample(slot, u[1]).or_else(|| self.sides.get(front + 1)?.sample(slot, u[1]))
        })
    }
}

impl Side {
    /// One side of an object and the slots of its representatives, whose indices begin at 0.
    fn new(world: &World, placed: &Arc<Placed>, back: bool) -> (Side, Vec<u32>) {
        let coarse = &placed.coarse;
        let elements = placed.layout.len() as u32;
        let first_slot = placed.placement.elements.start + if back { elements } else { 0 };
        let hidden = world.sight.get(&placed.key).cloned().unwrap_or_default();
        let computed = |element: u32| world.is_computed((first_slot + element) as usize);
        let mut slots = Vec::with_capacity(coarse.representatives.len());
        let mut index = Vec::with_capacity(coarse.representatives.len());
        let mut complete = hidden.is_empty();
        for &r in &coarse.representatives {
            if computed(r) {
                index.push(slots.len() as u32);
                slots.push(first_slot + r);
            } else {
                index.push(NONE);
                complete = false;
            }
        }
        let mut alone = Vec::new();
        if !complete {
            let is_alone = |&element: &u32| {
                let is_known = |e: usize| !hidden.contains(back, e) && index[coarse.representative_of(e)] != NONE;
                let known = coarse.range_of(element).any(is_known);
                !known && computed(element)
            };
            let all = (0..elements).into_par_iter().with_min_len(CHUNK);
            alone = all.filter(is_alone).collect::<Vec<u32>>().into_iter().zip(slots.len() as u32..).collect();
            slots.extend(alone.iter().map(|(element, _)| first_slot + element));
        }
        let members = 0..slots.len();
        (Side { placed: Arc::clone(placed), first_slot, back, members, index, hidden, alone }, slots)
    }

    /// Its slots.
    fn range(&self) -> Range<usize> {
        let first = self.first_slot as usize;
        first..first + self.placed.layout.len()
    }

    /// Moves its indices, which begin at 0.
    fn begin_at(&mut self, first: u32) {
        self.members = first as usize..first as usize + self.members.len();
        self.index.iter_mut().filter(|index| **index != NONE).for_each(|index| *index += first);
        self.alone.iter_mut().for_each(|(_, index)| *index += first);
    }

    /// (index into `Subset::slots`, weight) of an element, heaviest first; the weights need not sum to 1.
    fn entries_of(&self, element: u32) -> impl Iterator<Item = (usize, f32)> {
        let coarse = &self.placed.coarse;
        let entries = coarse.range_of(element).zip(coarse.entries_of(element));
        entries.filter_map(move |(entry, (r, w))| {
            let i = self.index[r];
            (i != NONE && !self.hidden.contains(self.back, entry)).then_some((i as usize, w))
        })
    }

    /// One of an element's representatives by weight; none for slots of other sides.
    #[inline]
    fn sample(&self, slot: u32, u: f32) -> Option<u32> {
        let element = slot.wrapping_sub(self.first_slot);
        if element as usize >= self.placed.layout.len() {
            return None;
        }
        let total: f32 = self.entries_of(element).map(|e| e.1).sum();
        let (mut left, mut last) = (u * total, None);
        for (i, w) in self.entries_of(element) {
            last = Some(i as u32);
            left -= w;
            if left < 0.0 {
                break;
            }
        }
        last.or_else(|| self.alone.binary_search_by_key(&element, |a| a.0).ok().map(|k| self.alone[k].1))
    }

    /// Adds the values of its elements to `out`.
    fn interpolate_where<V: Value, W: Send>(
        &self,
        is_wanted: &(impl Fn(u32) -> bool + Sync),
        values: &[V],
        out: &mut [W],
        add: &(impl Fn(&mut W, &V) + Sync),
    ) {
        if values[self.members.clone()].iter().all(|value| *value == V::default()) {
            return;
        }
        let is_wanted = |element: u32| is_wanted(self.first_slot + element);
        out.par_iter_mut().enumerate().with_min_len(CHUNK).for_each(|(element, out)| {
            if !is_wanted(element as u32) {
                return;
            }
            let (mut sum, mut weight) = (V::default(), 0.0);
            for (i, w) in self.entries_of(element as u32) {
                sum += values[i] * w;
                weight += w;
            }
            if weight > 0.0 {
                add(out, &(sum / weight));
            }
        });
        let alone = self.alone.iter().filter(|(element, _)| is_wanted(*element));
        alone.for_each(|&(element, i)| add(&mut out[element as usize], &values[i as usize]));
    }
}
