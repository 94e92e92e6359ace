//! Light maps of a scene's earlier states: whoever takes an edit back gets the map from before it, bit for bit, and who
//! moves an object step by step gets every step from the light before the first, without the noise of those between. They
//! are saved with the present light: after a restart undo has the same bits.

use std::collections::{BTreeMap, HashSet, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use rebake_core::edit::{Effect, Thing};

use crate::engine::{Edit, Layer, LightMap, Transition, VALUE_BYTES, World, fitted, have_same_slots};
use crate::jobs::merge;
use crate::store::lighting::Sequence;
use crate::store::records::EarlierLight;

/// States kept per scene.
const KEPT: usize = 4;

/// The last few worlds with a light map that is right for them.
#[derive(Default)]
pub(crate) struct Earlier(Mutex<States>);

#[derive(Default)]
struct States {
    kept: VecDeque<State>,
    base: Option<Base>,
    /// The present map, where time ended it before it was as accurate as was asked for.
    coarse: Weak<LightMap>,
}

/// A world with a light map that is right for it.
#[derive(Clone)]
pub(crate) struct State {
    pub(crate) sequence: Sequence,
    pub(crate) world: World,
    pub(crate) map: Arc<LightMap>,
}

/// What the present map was computed from.
struct Base {
    state: State,
    /// What lies between.
    edits: Arc<[Edit]>,
    /// The present map.
    present: Weak<LightMap>,
}

/// An update from an earlier state that makes those between superfluous.
pub(crate) struct Shortcut {
    pub(crate) transition: Arc<Transition>,
    pub(crate) from: State,
    pub(crate) edits: Arc<[Edit]>,
}

impl Earlier {
    fn lock(&self) -> MutexGuard<'_, States> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Keeps a state, in place of one that was lit like it, or of the oldest. One that time has ended is not worth it.
    pub(crate) fn remember(&self, state: &State) {
        let mut states = self.lock();
        if states.coarse.as_ptr() == Arc::as_ptr(&state.map) {
            return;
        }
        states.kept.retain(|other| !state.world.is_lit_like(&other.world));
        states.kept.push_back(state.clone());
        if states.kept.len() > KEPT {
            states.kept.pop_front();
        }
    }

    /// The map of a state that is lit like `world`, in its slots.
    pub(crate) fn recall(&self, world: &World) -> Option<Arc<LightMap>> {
        let states = self.lock();
        let known = states.kept.iter().find(|state| world.is_lit_like(&state.world))?;
        Some(fitted(&known.map, world.slots()))
    }

    /// Tells what `present` was computed from, by which edits; whether time ended that.
    pub(crate) fn computed(&self, from: &State, edits: &Arc<[Edit]>, present: &Arc<LightMap>, was_cut: bool) {
        let mut states = self.lock();
        let (edits, present) = (edits.clone(), Arc::downgrade(present));
        states.coarse = if was_cut { present.clone() } else { Weak::new() };
        states.base = Some(Base { state: from.clone(), edits, present });
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
        let (from, fewer) = {
            let states = self.lock();
            let base = states.base.as_ref().filter(|base| base.present.as_ptr() == Arc::as_ptr(present))?;
            let fewer = merge::simplify(base.edits.iter().chain(edits).cloned());
            if fewer.is_empty() || fewer.len() > merge::count(&base.edits) {
                return None;
            }
            (base.state.clone(), fewer)
        };
        let straight = from.world.apply(&fewer).ok()?;
        // Clients know the slots of the present map.
        have_same_slots(&straight.after, &transition.after).then_some(())?;
        Some(Shortcut { transition: Arc::new(straight), from, edits: fewer.into() })
    }

    /// What is saved beside the light that the next job starts from, and whether time ended that.
    pub(crate) fn saved(&self, present: &Arc<LightMap>) -> (EarlierLight, bool) {
        let states = self.lock();
        let is_present = |map: &Weak<LightMap>| map.as_ptr() == Arc::as_ptr(present);
        let light = |state: &State| (state.sequence, state.map.clone());
        let base = states.base.as_ref().filter(|base| is_present(&base.present));
        let light =
            EarlierLight { kept: states.kept.iter().map(light).collect(), base: base.map(|base| light(&base.state)) };
        (light, is_present(&states.coarse))
    }

    /// As it was saved beside `present`: `worlds` has those of the sequence numbers that are named, `edits` what lies
    /// between the base and the present light. Light that fits none of the worlds is left out.
    pub(crate) fn restored(
        saved: EarlierLight,
        worlds: &BTreeMap<Sequence, World>,
        edits: Vec<Edit>,
        (present, is_coarse): (&Arc<LightMap>, bool),
    ) -> Earlier {
        let state = |(sequence, map): (Sequence, Arc<LightMap>)| {
            let world = worlds.get(&sequence).filter(|world| world.slots() == map.len())?.clone();
            Some(State { sequence, world, map })
        };
        let present = Arc::downgrade(present);
        let base = saved.base.and_then(state);
        let of_base = |state| Base { state, edits: merge::simplify(edits).into(), present: present.clone() };
        let coarse = if is_coarse { present.clone() } else { Weak::new() };
        let kept = saved.kept.into_iter().filter_map(state).collect();
        Earlier(Mutex::new(States { kept, base: base.map(of_base), coarse }))
    }

    /// Bytes of the maps that are kept, without the layers that they share with each other and with `shown`.
    pub(crate) fn memory_bytes(&self, shown: &LightMap) -> usize {
        let states = self.lock();
        let mut maps: HashSet<*const LightMap> = HashSet::from([std::ptr::from_ref(shown)]);
        let mut layers: HashSet<*const Layer> = shown.layers.iter().map(Arc::as_ptr).collect();
        let all = states.kept.iter().chain(states.base.iter().map(|base| &base.state));
        let mut bytes = 0;
        for map in all.map(|state| &state.map).filter(|map| maps.insert(Arc::as_ptr(map))) {
            let own = map.layers.iter().filter(|layer| layers.insert(Arc::as_ptr(layer)));
            bytes += map.len() * VALUE_BYTES + own.map(|layer| layer.light.memory_bytes()).sum::<usize>();
        }
        bytes
    }
}
