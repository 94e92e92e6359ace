//! Geometry and light of one scene, and which of them a client sees.
//!
//! Every accepted edit is a [`Transition`] with a sequence number. The light map is right for one sequence number
//! (`lit`); the published world may be further on, with the old light carried over to the new slots. Rules:
//!
//! - A job lights all transitions up to its own. Before its first ray it publishes their geometry, so elements,
//!   objects and light map always belong together.
//! - Cancelling a job cancels work on light, never geometry: an acknowledged edit stays. After its first complete
//!   round a canceled job has lit its edit, at lower accuracy. Before that the transition stays here, and the next
//!   job of the scene lights it first.
//! - Where no light map is right for any world (never baked, or a job failed) the next job bakes.

use std::collections::BTreeMap;
use std::ops::Bound::{Excluded, Included};
use std::sync::Arc;

use super::versions::Published;
use crate::engine::{LightMap, Transition, World, carry_over};

/// Sequence number of an accepted edit request; 0 is the scene as uploaded.
pub(crate) type Sequence = u64;

/// The mutable side of a scene's light; behind one lock, changed by the scene's job and by accepted edits.
pub(crate) struct Lighting {
    lit: Option<Arc<LightMap>>,
    /// What `lit` is right for. Without it: what needs no transition any more.
    lit_sequence: Sequence,
    /// The published world.
    shown_sequence: Sequence,
    transitions: BTreeMap<Sequence, Arc<Transition>>,
}

/// A map as the engine gave it.
#[derive(Clone, Copy)]
pub(crate) struct Lit<'a> {
    pub(crate) map: &'a Arc<LightMap>,
    pub(crate) estimated_rmse: Option<f32>,
}

/// What a job has to do.
pub(crate) enum Work {
    /// Bake this world.
    Bake(Box<World>),
    /// Run these transitions, one after the other, from this map.
    Update(Arc<LightMap>, Vec<(Sequence, Arc<Transition>)>),
}

impl Lighting {
    pub(crate) fn new() -> Lighting {
        Lighting { lit: None, lit_sequence: 0, shown_sequence: 0, transitions: BTreeMap::new() }
    }

    /// Takes in an accepted edit.
    pub(crate) fn accept(&mut self, sequence: Sequence, transition: Transition) {
        self.transitions.insert(sequence, Arc::new(transition));
    }

    /// Transitions that are not lit yet.
    pub(crate) fn unlit(&self) -> usize {
        self.transitions.range((Excluded(self.lit_sequence), Included(Sequence::MAX))).count()
    }

    /// The next version, which shows the geometry up to `sequence` with old light; `None` where it is shown already.
    pub(crate) fn show(&mut self, published: &Published, sequence: Sequence) -> Option<Published> {
        let mut map = published.map.clone();
        let mut world = None;
        for (_, transition) in self.transitions.range((Excluded(self.shown_sequence), Included(sequence))) {
            map = carry_over(transition, &map);
            world = Some(transition.after.clone());
        }
        self.shown_sequence = self.shown_sequence.max(sequence);
        let world = world?;
        if self.lit.is_none() {
            self.drop_lit_transitions(self.shown_sequence);
        }
        Some(published.next(Some(world), map, published.estimated_rmse))
    }

    /// What is to be done so that the light is right for the published world.
    pub(crate) fn work(&mut self, published: &Published, max_unlit: usize) -> Work {
        if self.unlit() > max_unlit {
            self.distrust();
        }
        match &self.lit {
            None => Work::Bake(Box::new(published.world.clone())),
            Some(map) => {
                let due = self.transitions.range((Excluded(self.lit_sequence), Included(self.shown_sequence)));
                Work::Update(map.clone(), due.map(|(s, t)| (*s, t.clone())).collect())
            }
        }
    }

    /// The next version, which shows a map that is right for `sequence` on the published world.
    pub(crate) fn snapshot(&self, published: &Published, sequence: Sequence, lit: Lit<'_>) -> Published {
        let mut map = lit.map.clone();
        for (_, transition) in self.transitions.range((Excluded(sequence), Included(self.shown_sequence))) {
            map = carry_over(transition, &map);
        }
        published.next(None, map, lit.estimated_rmse)
    }

    /// `map` is right for `sequence`.
    pub(crate) fn set_lit(&mut self, sequence: Sequence, map: Arc<LightMap>) {
        self.lit = Some(map);
        self.drop_lit_transitions(sequence);
    }

    /// No map can be trusted: the next job bakes.
    pub(crate) fn distrust(&mut self) {
        self.lit = None;
        self.drop_lit_transitions(self.shown_sequence);
    }

    /// The sequence number of the published world.
    pub(crate) fn shown(&self) -> Sequence {
        self.shown_sequence
    }

    fn drop_lit_transitions(&mut self, sequence: Sequence) {
        self.lit_sequence = self.lit_sequence.max(sequence);
        self.transitions = self.transitions.split_off(&(self.lit_sequence + 1));
    }
}
