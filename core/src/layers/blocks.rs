//! Many layers as they are kept: each in the blocks of slots in which it matters.

use std::ops::Range;

use rayon::prelude::*;

use super::Stack;
use crate::lightmap::{BLOCK_SLOTS, LightValues, SparseLight, blocks_of};
use crate::value::{LEAST_TOLD, Scalars, Value};

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

/// Layers that matter in a block, ascending, with their light; the first is always there.
fn block_apart<V: Value>(stack: &Stack<V>, slots: Range<usize>, layers: usize) -> Vec<(usize, LightValues)> {
    let mut block = Block { slots: slots.len(), places: vec![u16::MAX; layers], found: Vec::new() };
    block.at(0);
    for (k, slot) in slots.clone().enumerate() {
        stack.light.direct[slot].for_layers(|layer, light| block.at(layer).direct[k] += light);
        stack.light.indirect[slot].for_layers(|layer, light| block.at(layer).indirect[k] += light);
    }
    for (k, slot) in slots.enumerate() {
        stack.layer_variance[slot].for_layers(|layer, variance| block.at(layer).variance[k] += variance);
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
        let least: Vec<f32> = (0..self.slots)
            .map(|k| LEAST_TOLD * self.found.iter().map(|(_, light)| size(light, k)).sum::<f32>())
            .collect();
        let matters = |(layer, light): &(usize, LightValues)| {
            *layer == 0 || least.iter().enumerate().any(|(k, least)| size(light, k) > *least)
        };
        let (mut kept, others): (Vec<_>, Vec<_>) = self.found.into_iter().partition(matters);
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
