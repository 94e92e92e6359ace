//! Layers of published light maps, through time: beside every block of a layer's values stands the version that last
//! changed one of them. What a restart forgets is sent whole.

use std::borrow::Cow;
use std::sync::Arc;

use glam::Vec3;
use rebake_core::delta::{Frame, same_bits};
use rebake_core::layers::{BLOCK_SLOTS, LightBlock, blocks_of};

use super::versions::LightPart;
use crate::engine::{Layer, LightMap, VALUE_BYTES};

/// Bytes of one element in one layer, where that has light, at most: its values, and its part of what is kept per block.
pub(crate) const LAYER_BYTES: usize = VALUE_BYTES + 1;

/// One layer of a published map.
#[derive(Clone)]
pub(crate) struct PublishedLayer {
    /// What it holds, at reference strengths.
    pub(crate) layer: Arc<Layer>,
    /// What it counts in the published map: that is the sum of weight × layer.
    pub(crate) weight: Vec3,
    /// What changed before this version is not known.
    born: u64,
    /// Per block of slots: the version that last changed one of its values.
    changed: Arc<[u64]>,
}

impl PublishedLayer {
    /// The layers of a map of which nothing earlier is known.
    pub(crate) fn first(map: &LightMap, weights: &[Vec3], version: u64) -> Vec<PublishedLayer> {
        let new = |(layer, weight): (&Arc<Layer>, &Vec3)| PublishedLayer::new(layer, *weight, version);
        map.layers.iter().zip(weights).map(new).collect()
    }

    /// The layers of a later map. `part` is what their values are.
    pub(crate) fn next(
        old: &[PublishedLayer],
        map: &LightMap,
        weights: &[Vec3],
        part: LightPart,
        version: u64,
    ) -> Vec<PublishedLayer> {
        let next = |(layer, weight): (&Arc<Layer>, &Vec3)| {
            let Some(known) = old.iter().find(|old| old.layer.name == layer.name) else {
                return PublishedLayer::new(layer, *weight, version);
            };
            let changed = match Arc::ptr_eq(&known.layer, layer) {
                true => known.changed.clone(),
                false => known.changed_by(layer, part, version),
            };
            PublishedLayer { layer: layer.clone(), weight: *weight, born: known.born, changed }
        };
        map.layers.iter().zip(weights).map(next).collect()
    }

    fn new(layer: &Arc<Layer>, weight: Vec3, version: u64) -> PublishedLayer {
        let changed = vec![version; blocks_of(layer.light.len())].into();
        PublishedLayer { layer: layer.clone(), weight, born: version, changed }
    }

    fn changed_by(&self, layer: &Layer, part: LightPart, version: u64) -> Arc<[u64]> {
        let (old, new) = (&self.layer.light, &layer.light);
        let since = |block: usize| match self.changed.get(block) {
            Some(since) if is_same(old.block(block), new.block(block), part) => *since,
            _ => version,
        };
        let same_ends = old.len().is_multiple_of(BLOCK_SLOTS) || old.len() == new.len();
        let mut changed: Vec<u64> = (0..blocks_of(new.len())).map(since).collect();
        if let Some(last) = changed.get_mut(old.len() / BLOCK_SLOTS).filter(|_| !same_ends) {
            *last = version;
        }
        changed.into()
    }

    /// One value per slot, at reference strengths.
    pub(crate) fn values(&self, part: LightPart) -> Cow<'_, [Vec3]> {
        self.layer.light.part(part)
    }

    /// What a client lacks that has the layer's values (of the `part` that is published) at version `since`; everything
    /// where that is 0 or nothing is known of that version.
    pub(crate) fn delta(&self, part: LightPart, since: u64, version: u64) -> Frame {
        let values = self.values(part);
        if since == 0 || since < self.born {
            return Frame::whole(&values, version);
        }
        Frame::from_changed(&values, |slot| self.changed[slot / BLOCK_SLOTS] > since, since, version)
    }

    /// Bytes of the values and what is kept beside them.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.layer.light.memory_bytes() + size_of_val(&*self.changed)
    }
}

/// Whether some light is the same, to the bit, in the same block of two layers.
fn is_same(a: Option<LightBlock<'_>>, b: Option<LightBlock<'_>>, part: LightPart) -> bool {
    // Of the last block, which grows with the slots, the new ones were not there.
    if a.zip(b).is_some_and(|(a, b)| a.direct.len() != b.direct.len()) {
        return false;
    }
    let at = |block: &Option<LightBlock<'_>>, k: usize| match (block, part) {
        (None, _) => Vec3::ZERO,
        (Some(block), LightPart::Direct) => block.direct[k],
        (Some(block), LightPart::Indirect) => block.indirect[k],
        (Some(block), LightPart::Full) => block.direct[k] + block.indirect[k],
    };
    let len = |block: &Option<LightBlock<'_>>| block.map_or(0, |block| block.direct.len());
    (0..len(&a).max(len(&b))).all(|k| same_bits(at(&a, k), at(&b, k)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rebake_core::layers::LightValues;

    fn map(layers: &[(&str, Vec<f32>)]) -> LightMap {
        let layer = |(name, values): &(&str, Vec<f32>)| {
            let direct: Vec<Vec3> = values.iter().map(|x| Vec3::splat(*x)).collect();
            let (indirect, variance) = (vec![Vec3::ONE; direct.len()], vec![0.0; direct.len()]);
            let light = LightValues { direct, indirect, variance };
            Arc::new(Layer { name: (*name).to_owned(), light: light.into(), ..Layer::default() })
        };
        LightMap { layers: layers.iter().map(layer).collect(), ..LightMap::default() }
    }

    #[test]
    fn deltas_tell_what_changed_and_all_where_that_is_not_known() {
        let weights = [Vec3::ONE; 2];
        let (mut earlier, slots) = (vec![1.0; 2 * BLOCK_SLOTS + 3], 2 * BLOCK_SLOTS + 4);
        earlier[BLOCK_SLOTS] = 2.0;
        let mut later = earlier.clone();
        later[BLOCK_SLOTS] = 3.0;
        let one = map(&[("a", earlier)]);
        let first = PublishedLayer::first(&one, &weights, 5);
        // A slot more, a slot changed, another layer.
        let grown = [&later[..], &[0.0]].concat();
        let two = map(&[("b", vec![0.0; grown.len()]), ("a", grown)]);
        let second = PublishedLayer::next(&first, &two, &weights, LightPart::Full, 6);
        // Only weights change.
        let third = PublishedLayer::next(&second, &two, &[Vec3::ZERO; 2], LightPart::Full, 7);
        let [b, a] = third.as_slice() else { panic!("two layers") };
        // What changed is told by the block.
        let told = a.delta(LightPart::Full, 5, 7);
        assert_eq!((told.runs[0].first as usize, told.values.len()), (BLOCK_SLOTS, BLOCK_SLOTS + 4));
        assert!(a.delta(LightPart::Full, 6, 7).values.is_empty());
        for whole in [a.delta(LightPart::Full, 4, 7), a.delta(LightPart::Full, 0, 7), b.delta(LightPart::Full, 5, 7)] {
            assert!(whole.flags.replace_all && whole.base == 0 && whole.values.len() == slots);
        }
        let mut client = first[0].values(LightPart::Full).into_owned();
        a.delta(LightPart::Full, 5, 7).apply(&mut client).unwrap();
        assert_eq!(client, *a.values(LightPart::Full));
        assert_eq!((a.weight, a.values(LightPart::Indirect)[0]), (Vec3::ZERO, Vec3::ONE));
    }
}
