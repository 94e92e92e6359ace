//! Elements inside solids: recognised by the backs that their rays meet, filled from valid neighbours.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

use super::sight::overlap;
use super::{Placed, Trees, World};
use crate::bvh::Ray;
use crate::random::Pcg32;
use crate::sampling::cosine_hemisphere;
use crate::transport::Value;

/// First a few rays; elements that meet a back are asked again with all.
const FIRST_RAYS: u32 = 6;
const ALL_RAYS: u32 = 32;

/// Which elements cannot be computed, and where their values come from.
#[derive(Clone, Debug, Default)]
pub(crate) struct Validity {
    /// Invalid slots, ascending.
    invalid: Vec<u32>,
    /// The same, a bit per slot; empty where all are valid.
    bits: Vec<u64>,
    /// Slots to fill, object by object, nearest to valid ones first; each is the mean of sources filled before it.
    fills: Vec<Fill>,
    /// The part of `fills` that belongs to an object, by key.
    of_object: BTreeMap<u32, Range<usize>>,
    /// Indices of `fills` by target.
    by_target: Vec<u32>,
}

#[derive(Clone, Debug)]
struct Fill {
    target: u32,
    sources: Vec<u32>,
}

impl Validity {
    /// Tests all elements of a world.
    pub(super) fn of_all(world: &World) -> Validity {
        let inside = |placed: &Placed| {
            let slots = placed.placement.elements.clone().into_par_iter();
            slots.filter(|&slot| is_inside(world, slot)).collect()
        };
        Validity::from_invalid(world, inside, |_, _| None)
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
            let is_inside =
                |&slot: &u32| if is_affected(slot) { is_inside(world, slot) } else { !old.is_valid(slot as usize) };
            slots.into_par_iter().with_min_len(256).filter(is_inside).collect()
        };
        let kept = |placed: &Placed, invalid: &[u32]| {
            let slots = &placed.placement.elements;
            let range = old.of_object.get(&placed.key)?;
            (!is_new(&slots.start) && old.invalid_of(slots) == invalid).then(|| &old.fills[range.clone()])
        };
        Validity::from_invalid(world, inside, kept)
    }

    /// `inside` tells the invalid slots of an object, ascending, and `kept` its fills where they are known.
    fn from_invalid<'a>(
        world: &World,
        inside: impl Fn(&Placed) -> Vec<u32> + Sync,
        kept: impl Fn(&Placed, &[u32]) -> Option<&'a [Fill]> + Sync,
    ) -> Validity {
        let by_object: Vec<Vec<u32>> = world.placed.par_iter().map(|placed| inside(placed)).collect();
        let mut invalid = by_object.concat();
        invalid.sort_unstable();
        let mut bits = if invalid.is_empty() { Vec::new() } else { vec![0; world.slots().div_ceil(64)] };
        invalid.iter().for_each(|&slot| bits[slot as usize / 64] |= 1 << (slot % 64));
        let mut validity = Validity { invalid, bits, ..Validity::default() };
        let objects = world.placed.par_iter().zip(&by_object).filter(|(_, invalid)| !invalid.is_empty());
        let filled: Vec<(u32, Vec<Fill>)> = objects
            .map(|(placed, invalid)| {
                let fills = kept(placed, invalid).map_or_else(|| fill_object(placed, &validity), <[Fill]>::to_vec);
                (placed.key, fills)
            })
            .collect();
        for (key, fills) in filled {
            let first = validity.fills.len();
            validity.fills.extend(fills);
            validity.of_object.insert(key, first..validity.fills.len());
        }
        validity.by_target = (0..validity.fills.len() as u32).collect();
        validity.by_target.sort_unstable_by_key(|&f| validity.fills[f as usize].target);
        validity
    }

    /// Bytes held.
    pub(super) fn memory_bytes(&self) -> usize {
        let sources: usize = self.fills.iter().map(|fill| fill.sources.capacity()).sum();
        (self.invalid.capacity() + self.by_target.capacity() + sources) * size_of::<u32>()
            + self.bits.capacity() * size_of::<u64>()
            + self.fills.capacity() * size_of::<Fill>()
    }

    /// The invalid ones among some slots, ascending.
    pub(super) fn invalid_of(&self, slots: &Range<u32>) -> &[u32] {
        let index = |slot: u32| self.invalid.partition_point(|&s| s < slot);
        &self.invalid[index(slots.start)..index(slots.end)]
    }

    /// Whether a slot's value is computed.
    #[inline]
    pub(crate) fn is_valid(&self, slot: usize) -> bool {
        self.bits.get(slot / 64).is_none_or(|bits| bits >> (slot % 64) & 1 == 0)
    }

    /// One of the slots that an invalid slot takes its value from, by a uniform number; the slot itself where it is valid.
    pub(crate) fn stand_in(&self, slot: u32, mut u: f32) -> u32 {
        let mut slot = slot;
        while let Ok(i) = self.by_target.binary_search_by_key(&slot, |&f| self.fills[f as usize].target) {
            let sources = &self.fills[self.by_target[i] as usize].sources;
            u *= sources.len() as f32;
            let k = (u as usize).min(sources.len() - 1);
            u -= k as f32;
            slot = sources[k];
        }
        slot
    }

    /// Gives invalid slots the values of their neighbours.
    pub(crate) fn fill<V: Value>(&self, values: &mut [V]) {
        for fill in &self.fills {
            let sum: V = fill.sources.iter().map(|&s| values[s as usize]).sum();
            values[fill.target as usize] = sum / fill.sources.len() as f32;
        }
    }

    /// The same for scalars, of which every slot has some side by side.
    pub(crate) fn fill_scalars(&self, values: &mut [f32], per_slot: usize) {
        for fill in &self.fills {
            for k in 0..per_slot {
                let sum: f32 = fill.sources.iter().map(|&s| values[s as usize * per_slot + k]).sum();
                values[fill.target as usize * per_slot + k] = sum / fill.sources.len() as f32;
            }
        }
    }
}

impl World {
    /// Validity while other trees stand in place of the world's, which differ from them within `bounds`.
    pub(crate) fn validity_among(&self, trees: &Trees, bounds: (Vec3, Vec3)) -> Validity {
        let world = World { trees: trees.clone(), ..self.clone() };
        let grown = (bounds.0 - self.spacing(), bounds.1 + self.spacing());
        Validity::updated(&self.validity, &world, &[], &[grown])
    }
}

/// Whether most rays of an element meet a back that no light comes from.
fn is_inside(world: &World, slot: u32) -> bool {
    if world.areas()[slot as usize] <= 0.0 {
        return false;
    }
    let (origin, n) = world.ray_origin(slot as usize);
    let mut rng = Pcg32::new(0x1551, u64::from(slot));
    let mut backs = 0;
    for k in 0..ALL_RAYS {
        if k == FIRST_RAYS && backs == 0 {
            return false;
        }
        let direction = cosine_hemisphere(n, rng.next_2d());
        let ray = Ray { origin, direction, t_min: 0.0, t_max: f32::INFINITY };
        if let Some(hit) = world.trees.closest_hit(&ray) {
            let part = world.space.part(hit.triangle);
            let back = hit.normal.dot(direction) > 0.0;
            backs += u32::from(back && (part.solid || !part.double_sided));
        }
    }
    2 * backs > ALL_RAYS
}

/// Ring by ring from the valid elements of one object, along its surface.
fn fill_object(placed: &Placed, validity: &Validity) -> Vec<Fill> {
    let n = placed.layout.len() as u32;
    let first = placed.placement.elements.start;
    let sides = if placed.with_back { 2 } else { 1 };
    let mut fills = Vec::new();
    for side in 0..sides {
        let first = first + side * n;
        let neighbours = |slot: u32| placed.layout.neighbours_of(slot - first).iter().map(move |other| first + other);
        let mut open: BTreeSet<u32> = validity.invalid_of(&(first..first + n)).iter().copied().collect();
        loop {
            let ring: Vec<Fill> = open
                .iter()
                .filter_map(|&target| {
                    let known = |s: &u32| !open.contains(s);
                    let sources: Vec<u32> = neighbours(target).filter(known).collect();
                    (!sources.is_empty()).then_some(Fill { target, sources })
                })
                .collect();
            if ring.is_empty() {
                break;
            }
            ring.iter().for_each(|f| {
                open.remove(&f.target);
            });
            fills.extend(ring);
        }
    }
    fills
}
