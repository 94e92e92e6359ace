//! Many layers as they are kept: each in the blocks of slots in which it matters.

use std::ops::Range;

use rayon::prelude::*;

use super::Stack;
use crate::lightmap::{BLOCK_SLOTS, LightValues, SparseLight, blocks_of};
use crate::value::{Scalars, Value};

/// A layer with less than this part of all light in a block is not told apart there.
const LEAST_TOLD: f32 = 4e-3;

/// Unless it has more than this part at one of its slots.
const LEAST_AT_SLOT: f32 = 8.0 * LEAST_TOLD;

/// Layers where they matter; where they do not, their light is left to the first.
pub(super) fn where_they_matter<V: Value>(stack: &Stack<V>, layers: usize) -> Vec<SparseLight> {
    let slots = stack.light.len();
    let of_block = |index: usize| {
        let own = index * BLOCK_SLOTS..slots.min((index + 1) * BLOCK_SLOTS);
        block_apart(stack, own, layers)
    };
    let blocks: Vec<Vec<(usize, LightValues)>> = (0..blocks_of(slots)).into_par_iter().map(of_block).collect();
    let layer = |layer: usize| {
        let of_block = |(index, found): (usize, &'_ Vec<(usize, LightValues)>)| {
            let place = found.binary_search_by_key(&layer, |(own, _)| *own).ok()?;
            Some((index, place))
        };
        let there = blocks.iter().enumerate().filter_map(of_block);
        SparseLight::of_blocks(slots, there.map(|(index, place)| (index, blocks[index][place].1.block(0))))
    };
    (0..layers).into_par_iter().map(layer).collect()
}

/// Whether a layer is told apart in a block: the size of its light and of all light, slot by slot.
pub(super) fn matters(sizes: impl Iterator<Item = (f32, f32)>) -> bool {
    let (mut own, mut all) = (0.0, 0.0);
    for (size, whole) in sizes {
        if size > LEAST_AT_SLOT * whole {
            return true;
        }
        (own, all) = (own + size, all + whole);
    }
    own > LEAST_TOLD * all
}

/// Layers that matter in a block, ascending, with their light; the first is always there.
fn block_apart<V: Value>(stack: &Stack<V>, slots: Range<usize>, layers: usize) -> Vec<(usize, LightValues)> {
    let mut block = Block { slots: slots.len(), places: vec![u16::MAX; layers], found: Vec::new() };
    block.at(0);
    for (k, slot) in slots.clone().enumerate() {
        stack.light.direct[slot].for_layers(|layer, light| block.at(layer).direct[k] += light);
        stack.light.indirect[slot].for_layers(|layer, light| block.at(layer).indirect[k] += light);
    }
    for (k, slot) in slots.enumerate() {
        // That of the first is what merging has left: rounding may leave less than nothing.
        stack.layer_variance[slot].for_layers(|layer, variance| block.at(layer).variance[k] += variance.max(0.0));
    }
    block.where_they_matter()
}

/// Layers of some slots as they are found.
struct Block {
    slots: usize,
    /// Per layer: place in `found`, or the greatest number.
    places: Vec<u16>,
    found: Vec<(usize, LightValues)>,
}

impl Block {
    /// The light of a layer.
    fn at(&mut self, layer: usize) -> &mut LightValues {
        if self.places[layer] == u16::MAX {
            self.places[layer] = self.found.len() as u16;
            self.found.push((layer, LightValues::black(self.slots)));
        }
        &mut self.found[usize::from(self.places[layer])].1
    }

    /// The layers that matter, ascending, and the first with the light of the others.
    fn where_they_matter(self) -> Vec<(usize, LightValues)> {
        let size =
            |light: &LightValues, k: usize| light.direct[k].abs().max_element() + light.indirect[k].abs().max_element();
        let sizes: Vec<f32> =
            (0..self.slots).map(|k| self.found.iter().map(|(_, light)| size(light, k)).sum()).collect();
        let is_told = |(layer, light): &(usize, LightValues)| {
            *layer == 0 || matters(sizes.iter().enumerate().map(|(k, whole)| (size(light, k), *whole)))
        };
        let (mut kept, others): (Vec<_>, Vec<_>) = self.found.into_iter().partition(is_told);
        kept.sort_unstable_by_key(|(layer, _)| *layer);
        let rest = &mut kept[0].1;
        for (_, light) in others {
            rest.direct.iter_mut().zip(light.direct).for_each(|(rest, light)| *rest += light);
            rest.indirect.iter_mut().zip(light.indirect).for_each(|(rest, light)| *rest += light);
            rest.variance.iter_mut().zip(light.variance).for_each(|(rest, v)| *rest += v);
        }
        kept
    }
}
