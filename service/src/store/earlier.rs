//! Light maps of a scene's earlier states: whoever takes an edit back gets the map from before it, bit for bit.

use std::collections::{HashSet, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::engine::{Layer, LightMap, VALUE_BYTES, World, fitted};

/// States kept per scene.
const KEPT: usize = 4;

/// The last few worlds with a light map that is right for them.
#[derive(Default)]
pub(crate) struct Earlier {
    states: Mutex<VecDeque<(World, Arc<LightMap>)>>,
}

impl Earlier {
    fn lock(&self) -> MutexGuard<'_, VecDeque<(World, Arc<LightMap>)>> {
        self.states.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Keeps a state, in place of one that was lit like it, or of the oldest.
    pub(crate) fn remember(&self, world: &World, map: &Arc<LightMap>) {
        let mut states = self.lock();
        states.retain(|(other, _)| !world.is_lit_like(other));
        states.push_back((world.clone(), map.clone()));
        if states.len() > KEPT {
            states.pop_front();
        }
    }

    /// The map of a state that is lit like `world`, in its slots.
    pub(crate) fn recall(&self, world: &World) -> Option<Arc<LightMap>> {
        let states = self.lock();
        let (_, map) = states.iter().find(|(other, _)| world.is_lit_like(other))?;
        Some(fitted(map, world.slots()))
    }

    /// Bytes of the maps that are kept, without the layers that they share with each other and with `shown`.
    pub(crate) fn memory_bytes(&self, shown: &LightMap) -> usize {
        let mut counted: HashSet<*const Layer> = shown.layers.iter().map(Arc::as_ptr).collect();
        let mut bytes = 0;
        for (_, map) in self.lock().iter() {
            let own = map.layers.iter().filter(|layer| counted.insert(Arc::as_ptr(layer)));
            bytes += (map.len() + own.map(|layer| layer.direct.len()).sum::<usize>()) * VALUE_BYTES;
        }
        bytes
    }
}
