//! Elements that cannot be computed, or not for what is seen of their cells: inside solids, or behind a surface that
//! cuts most of their cells off. They take the values of neighbours.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::buried::{depth_towards, is_inside};
use super::{Placed, Trees, World};
use crate::bits::Bits;
use crate::lightmap::LightValues;
use crate::ranges::split_mut;
use crate::surface::overlap;
use crate::value::{Linear, Value};

/// Which elements cannot be computed, and where their values come from.
#[derive(Clone, Debug, Default)]
pub struct Validity {
    /// Invalid slots, ascending.
    invalid: Vec<u32>,
    /// Those of them that are not inside a solid, but behind a surface; ascending.
    behind: Vec<u32>,
    /// Invalid slots, to be asked one by one.
    is_invalid: Bits,
    /// Objects with slots to fill, by their first slots.
    objects: Vec<Filled>,
}

/// An object some of whose slots are filled.
#[derive(Clone, Debug)]
struct Filled {
    key: u32,
    slots: Range<u32>,
    /// What the next world shares, where the object stays as it is.
    fills: Arc<Fills>,
}

/// Which slots take the mean of which others.
#[derive(Debug)]
struct Fills {
    /// Slots that are filled, nearest to valid ones first: each is the mean of sources filled before it.
    targets: Vec<u32>,
    /// Where the sources of each begin, and where the last one's end.
    starts: Vec<u32>,
    sources: Vec<u32>,
    /// Indices of `targets`, by slot.
    by_target: Vec<u32>,
}

impl Fills {
    /// Of slots, each with its sources, in the order in which they are filled.
    fn new(list: &[(u32, Vec<u32>)]) -> Fills {
        let mut by_target: Vec<u32> = (0..list.len() as u32).collect();
        by_target.sort_unstable_by_key(|&f| list[f as usize].0);
        let ends = list.iter().scan(0, |end, (_, sources)| {
            *end += sources.len() as u32;
            Some(*end)
        });
        Fills {
            targets: list.iter().map(|(target, _)| *target).collect(),
            starts: std::iter::once(0).chain(ends).collect(),
            sources: list.iter().flat_map(|(_, sources)| sources).copied().collect(),
            by_target,
        }
    }

    /// The sources of a slot; none where it is not filled.
    fn of(&self, slot: u32) -> Option<&[u32]> {
        let found = self.by_target.binary_search_by_key(&slot, |&f| self.targets[f as usize]).ok()?;
        Some(self.sources_of(self.by_target[found] as usize))
    }

    #[inline]
    fn sources_of(&self, index: usize) -> &[u32] {
        &self.sources[self.starts[index] as usize..self.starts[index + 1] as usize]
    }

    /// Fills the slots from `first` on.
    fn fill<T: Linear>(&self, first: usize, values: &mut [T]) {
        for (index, &target) in self.targets.iter().enumerate() {
            let sources = self.sources_of(index);
            let sum = sources.iter().fold(T::default(), |sum, &source| sum + values[source as usize - first]);
            values[target as usize - first] = sum / sources.len() as f32;
        }
    }

    fn memory_bytes(&self) -> usize {
        let Fills { targets, starts, sources, by_target } = self;
        [targets, starts, sources, by_target].into_iter().map(|list| list.capacity() * size_of::<u32>()).sum()
    }
}

impl Validity {
    /// Tests all elements of a world.
    pub(super) fn of_all(world: &World) -> Validity {
        let inside = |placed: &Placed| {
            let slots = placed.placement.elements.clone().into_par_iter();
            slots.filter(|&slot| is_inside(world, slot)).collect()
        };
        Validity::from_invalid(world, Vec::new(), inside, |_, _| None)
    }

    /// This validity with other elements behind surfaces, ascending.
    pub(super) fn with_behind(&self, world: &World, behind: &[u32]) -> Validity {
        let all = |placed: &Placed| {
            let slots = &placed.placement.elements;
            let inside = self.invalid_of(slots).iter().filter(|slot| self.behind.binary_search(slot).is_err());
            let mut all: Vec<u32> = inside.copied().chain(part_of(behind, slots).iter().copied()).collect();
            all.sort_unstable();
            all.dedup();
            all
        };
        let kept = |placed: &Placed, invalid: &[u32]| {
            self.fills_of(placed).filter(|_| self.invalid_of(&placed.placement.elements) == invalid)
        };
        Validity::from_invalid(world, behind.to_vec(), all, kept)
    }

    /// Elements behind surfaces, ascending.
    pub(super) fn behind(&self) -> &[u32] {
        &self.behind
    }

    /// Those of some slots, ascending.
    pub(super) fn behind_of(&self, slots: &Range<u32>) -> &[u32] {
        part_of(&self.behind, slots)
    }

    /// Tests the elements of `ranges` and those within `bounds` anew, keeps the rest of `old`.
    pub(super) fn updated(old: &Validity, world: &World, ranges: &[Range<u32>], bounds: &[(Vec3, Vec3)]) -> Validity {
        let is_new = |slot: &u32| ranges.iter().any(|range| range.contains(slot));
        let is_affected = |slot: u32| {
            let p = world.positions()[slot as usize];
            is_new(&slot) || bounds.iter().any(|(low, high)| p.cmpge(*low).all() && p.cmple(*high).all())
        };
        let inside = |placed: &Placed| -> Vec<u32> {
            let slots = placed.placement.elements.clone();
            let own = placed.surface.bounds();
            if !is_new(&slots.start) && !bounds.iter().any(|b| overlap(b, &own)) {
                return old.invalid_of(&slots).to_vec();
            }
            // Those behind surfaces stay as they are until they are looked for anew.
            let is_invalid = |&slot: &u32| {
                if is_affected(slot) { is_inside(world, slot) } else { !old.is_valid(slot as usize) }
            };
            slots.into_par_iter().with_min_len(256).filter(is_invalid).collect()
        };
        let kept = |placed: &Placed, invalid: &[u32]| {
            let slots = &placed.placement.elements;
            old.fills_of(placed).filter(|_| !is_new(&slots.start) && old.invalid_of(slots) == invalid)
        };
        let behind = old.behind.iter().copied().filter(|slot| !is_affected(*slot)).collect();
        Validity::from_invalid(world, behind, inside, kept)
    }

    /// `inside` tells the invalid slots of an object, ascending, and `kept` its fills where they are known.
    fn from_invalid(
        world: &World,
        behind: Vec<u32>,
        inside: impl Fn(&Placed) -> Vec<u32> + Sync,
        kept: impl Fn(&Placed, &[u32]) -> Option<Arc<Fills>> + Sync,
    ) -> Validity {
        let by_object: Vec<Vec<u32>> = world.placed.par_iter().map(|placed| inside(placed)).collect();
        let mut invalid = by_object.concat();
        invalid.sort_unstable();
        let is_invalid = invalid.iter().map(|&slot| slot as usize).collect();
        let mut validity = Validity { invalid, behind, is_invalid, ..Validity::default() };
        let objects = world.placed.par_iter().zip(&by_object).filter(|(_, invalid)| !invalid.is_empty());
        let mut filled: Vec<Filled> = objects
            .map(|(placed, invalid)| {
                let new = || Arc::new(Fills::new(&fill_object(world, placed, &validity)));
                let fills = kept(placed, invalid).unwrap_or_else(new);
                Filled { key: placed.key, slots: placed.placement.elements.clone(), fills }
            })
            .collect();
        filled.sort_unstable_by_key(|object| object.slots.start);
        validity.objects = filled;
        validity
    }

    /// The fills of an object, where it is in the slots that it had.
    fn fills_of(&self, placed: &Placed) -> Option<Arc<Fills>> {
        let slots = &placed.placement.elements;
        let object = self.object_at(slots.start)?;
        (object.key == placed.key && object.slots == *slots).then(|| Arc::clone(&object.fills))
    }

    /// The object that has a slot, where some of its slots are filled.
    fn object_at(&self, slot: u32) -> Option<&Filled> {
        let behind = self.objects.partition_point(|object| object.slots.start <= slot);
        self.objects[..behind].last().filter(|object| object.slots.contains(&slot))
    }

    /// Bytes held.
    pub(super) fn memory_bytes(&self) -> usize {
        let fills: usize = self.objects.iter().map(|object| object.fills.memory_bytes()).sum();
        (self.invalid.capacity() + self.behind.capacity()) * size_of::<u32>()
            + self.is_invalid.memory_bytes()
            + self.objects.capacity() * size_of::<Filled>()
            + fills
    }

    /// The invalid ones among some slots, ascending.
    pub(super) fn invalid_of(&self, slots: &Range<u32>) -> &[u32] {
        part_of(&self.invalid, slots)
    }

    /// Whether a slot's value is computed.
    #[inline]
    pub(crate) fn is_valid(&self, slot: usize) -> bool {
        !self.is_invalid.contains(slot)
    }

    /// One of the slots that an invalid slot takes its value from, by a uniform number; the slot itself where it is
    /// valid.
    pub(crate) fn stand_in(&self, slot: u32, mut u: f32) -> u32 {
        let mut slot = slot;
        while let Some(sources) = self.object_at(slot).and_then(|object| object.fills.of(slot)) {
            u *= sources.len() as f32;
            let k = (u as usize).min(sources.len() - 1);
            u -= k as f32;
            slot = sources[k];
        }
        slot
    }

    /// The slots whose mean an invalid slot takes; none where it is valid, or all around it are as it is.
    pub(super) fn sources_of(&self, slot: u32) -> &[u32] {
        self.object_at(slot).and_then(|object| object.fills.of(slot)).unwrap_or_default()
    }

    /// Gives invalid slots the means of their neighbours' values.
    pub(crate) fn fill<T: Linear>(&self, values: &mut [T]) {
        let range = |object: &Filled| object.slots.start as usize..object.slots.end as usize;
        let parts = split_mut(values, self.objects.iter().map(range));
        let objects = self.objects.par_iter().zip(parts);
        objects.for_each(|(object, values)| object.fills.fill(object.slots.start as usize, values));
    }

    /// Gives invalid slots the light of their neighbours, and its variance.
    pub(crate) fn fill_light<V: Value>(&self, light: &mut LightValues<V>) {
        self.fill(&mut light.direct);
        self.fill(&mut light.indirect);
        self.fill(&mut light.variance);
    }
}

impl World {
    /// Validity while other trees stand in place of the world's, which differ from them within `bounds`.
    pub fn validity_among(&self, trees: &Trees, bounds: (Vec3, Vec3)) -> Validity {
        let world = World { trees: trees.clone(), ..self.clone() };
        let grown = (bounds.0 - self.spacing(), bounds.1 + self.spacing());
        Validity::updated(&self.validity, &world, &[], &[grown])
    }
}

/// Of ascending slots those in a range.
pub(super) fn part_of<'s>(slots: &'s [u32], range: &Range<u32>) -> &'s [u32] {
    let index = |slot: u32| slots.partition_point(|&s| s < slot);
    &slots[index(range.start)..index(range.end)]
}

/// Ring by ring from the valid elements of one object, along its surface. Each takes the side that is nearest: the mean
/// of both sides of a wall would be the light of neither.
fn fill_object(world: &World, placed: &Placed, validity: &Validity) -> Vec<(u32, Vec<u32>)> {
    let mut fills = Vec::new();
    for side in placed.sides() {
        let first = side.start;
        let neighbours = |slot: u32| placed.layout.neighbours_of(slot - first).map(move |other| first + other);
        let mut open: BTreeSet<u32> = validity.invalid_of(&side).iter().copied().collect();
        // How far behind the surface that hides them those are that are filled.
        let mut depths: BTreeMap<u32, f32> = BTreeMap::new();
        loop {
            let fill = |&target: &u32| {
                let sources: Vec<u32> = neighbours(target).filter(|source| !open.contains(source)).collect();
                let depth = |source: &u32| match depths.get(source) {
                    Some(depth) => depth + distance(world, *source, target),
                    None => depth_towards(world, *source, target),
                };
                let of_sources: Vec<f32> = sources.iter().map(depth).collect();
                let (nearest, least) = of_sources.iter().copied().enumerate().min_by(|a, b| a.1.total_cmp(&b.1))?;
                let place = |slot: u32| world.positions()[slot as usize] - world.positions()[target as usize];
                let there = place(sources[nearest]);
                let is_beside = |(source, depth): (&u32, &f32)| {
                    (*source == sources[nearest] || *depth <= 2.0 * least && place(*source).dot(there) > 0.0)
                        .then_some(*source)
                };
                let sources = sources.iter().zip(&of_sources).filter_map(is_beside).collect();
                Some(((target, sources), least))
            };
            let ring: Vec<((u32, Vec<u32>), f32)> = open.iter().filter_map(fill).collect();
            if ring.is_empty() {
                break;
            }
            for (fill, depth) in ring {
                open.remove(&fill.0);
                depths.insert(fill.0, depth);
                fills.push(fill);
            }
        }
    }
    fills
}

fn distance(world: &World, a: u32, b: u32) -> f32 {
    world.positions()[a as usize].distance(world.positions()[b as usize])
}
