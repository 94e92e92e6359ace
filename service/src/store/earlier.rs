//! Light maps of a scene's earlier states: whoever takes an edit back gets the map from before it, bit for bit, and who
//! moves an object step by step gets every step from the light before the first, without the noise of those between.

use std::collections::{HashSet, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use rebake_core::edit::{Effect, Thing};

use crate::engine::{Edit, Layer, LightMap, Transition, VALUE_BYTES, World, fitted, have_same_slots};
use crate::jobs::merge;

/// States kept per scene.
const KEPT: usize = 4;

/// The last few worlds with a light map that is right for them.
#[derive(Default)]
pub(crate) struct Earlier(Mutex<States>);

#[derive(Default)]
struct States {
    kept: VecDeque<(World, Arc<LightMap>)>,
    base: Option<Base>,
    /// The present map, where time ended it before it was as accurate as was asked for.
    coarse: Weak<LightMap>,
}

/// What the present map was computed from.
struct Base {
    world: World,
    map: Arc<LightMap>,
    /// What lies between.
    edits: Arc<[Edit]>,
    /// The present map.
    present: Weak<LightMap>,
}

/// An update from an earlier state that makes those between superfluous.
pub(crate) struct Shortcut {
    pub(crate) transition: Arc<Transition>,
    pub(crate) map: Arc<LightMap>,
    pub(crate) edits: Arc<[Edit]>,
}

impl Earlier {
    fn lock(&self) -> MutexGuard<'_, States> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Keeps a state, in place of one that was lit like it, or of the oldest. One that time has ended is not worth it.
    pub(crate) fn remember(&self, world: &World, map: &Arc<LightMap>) {
        let mut states = self.lock();
        if states.coarse.as_ptr() == Arc::as_ptr(map) {
            return;
        }
        states.kept.retain(|(other, _)| !world.is_lit_like(other));
        states.kept.push_back((world.clone(), map.clone()));
        if states.kept.len() > KEPT {
            states.kept.pop_front();
        }
    }

    /// The map of a state that is lit like `world`, in its slots.
    pub(crate) fn recall(&self, world: &World) -> Option<Arc<LightMap>> {
        let states = self.lock();
        let (_, map) = states.kept.iter().find(|(other, _)| world.is_lit_like(other))?;
        Some(fitted(map, world.slots()))
    }

    /// Tells that `present` was computed from `map`; whether time ended that.
    pub(crate) fn computed(
        &self,
        world: &World,
        map: &Arc<LightMap>,
        edits: &Arc<[Edit]>,
        present: &Arc<LightMap>,
        was_cut: bool,
    ) {
        let mut states = self.lock();
        let (world, map, edits, present) = (world.clone(), map.clone(), edits.clone(), Arc::downgrade(present));
        states.coarse = if was_cut { present.clone() } else { Weak::new() };
        states.base = Some(Base { world, map, edits, present });
    }

    /// The way from where `present` was computed from straight to the end of a transition, where its edits make those
    /// before superfluous: they move and repaint the same objects. Every update leaves its noise in the map.
    pub(crate) fn shortcut(
        &self,
        present: &Arc<LightMap>,
        transition: &Transition,
        edits: &[Edit],
    ) -> Option<Shortcut> {
        let stays = |effect: &Effect<'_>| matches!(effect, Effect::Sets(Thing::Object(_), _));
        if !edits.iter().all(|edit| edit.effects().iter().all(stays)) {
            return None;
        }
        // Worlds take long to change: not under the lock.
        let (world, map, fewer) = {
            let states = self.lock();
            let base = states.base.as_ref().filter(|base| base.present.as_ptr() == Arc::as_ptr(present))?;
            let fewer = merge::simplify(base.edits.iter().chain(edits).cloned());
            if fewer.is_empty() || fewer.len() > merge::count(&base.edits) {
                return None;
            }
            (base.world.clone(), base.map.clone(), fewer)
        };
        let straight = world.apply(&fewer).ok()?;
        // Clients know the slots of the present map.
        have_same_slots(&straight.after, &transition.after).then_some(())?;
        Some(Shortcut { transition: Arc::new(straight), map, edits: fewer.into() })
    }

    /// Bytes of the maps that are kept, without the layers that they share with each other and with `shown`.
    pub(crate) fn memory_bytes(&self, shown: &LightMap) -> usize {
        let states = self.lock();
        let mut maps: HashSet<*const LightMap> = HashSet::from([std::ptr::from_ref(shown)]);
        let mut layers: HashSet<*const Layer> = shown.layers.iter().map(Arc::as_ptr).collect();
        let kept = states.kept.iter().map(|(_, map)| map).chain(states.base.iter().map(|base| &base.map));
        let mut bytes = 0;
        for map in kept.filter(|map| maps.insert(Arc::as_ptr(map))) {
            let own = map.layers.iter().filter(|layer| layers.insert(Arc::as_ptr(layer)));
            bytes += map.len() * VALUE_BYTES + own.map(|layer| layer.light.memory_bytes()).sum::<usize>();
        }
        bytes
    }
}
