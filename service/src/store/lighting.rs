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
//! - A job that is interrupted (paused, or by the end of the service) leaves `lit` alone: it starts from there again,
//!   and what it had published stays published until it has something better.
//! - Where no light map is right for any world (never baked, or a job failed) the next job bakes.

use std::collections::BTreeMap;
use std::ops::Bound::{Excluded, Included};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::records::LightRecord;
use super::versions::{Published, Unknown};
use crate::engine::{Edit, LightMap, ResolutionError, Transition, World};
use crate::jobs::budget::JobBudget;

/// Sequence number of an accepted edit request; 0 is the scene as uploaded.
pub(crate) type Sequence = u64;

/// An accepted edit request that is not lit yet.
#[derive(Clone)]
pub(crate) struct Unlit {
    pub(crate) sequence: Sequence,
    pub(crate) transition: Arc<Transition>,
    /// What the request asked for.
    pub(crate) edits: Arc<[Edit]>,
}

/// What a map has in samples per element beside the one before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Samples {
    /// It is baked from scratch, with so many.
    Fresh(u32),
    /// It was refined with so many more.
    More(u32),
    /// It was brought up to date.
    Same,
}

/// How far work towards the scene's target has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Effort {
    /// Samples per element of the last bake and of what has refined it since.
    pub(crate) samples: u32,
    /// A bound of the target was reached: samples, error or time.
    pub(crate) is_done: bool,
}

/// The mutable side of a scene's light; behind one lock, changed by the scene's job and by accepted edits.
pub(crate) struct Lighting {
    lit: Option<Arc<LightMap>>,
    /// What `lit` is right for. Without it: what needs no transition any more.
    lit_sequence: Sequence,
    /// The published world.
    shown_sequence: Sequence,
    /// What the published light is right for, where a job computed it.
    right_for: Option<Sequence>,
    unlit: BTreeMap<Sequence, Unlit>,
    effort: Effort,
}

/// A map as the engine gave it.
#[derive(Clone, Copy)]
pub(crate) struct Lit<'a> {
    pub(crate) map: &'a Arc<LightMap>,
    pub(crate) estimated_rmse: Option<f32>,
    /// What is known of its error of resolution.
    pub(crate) resolution: Option<&'a Arc<ResolutionError>>,
    /// It is an estimate for its sequence number, and not only carried over.
    pub(crate) is_right: bool,
}

/// Elements whose light is none of theirs, after one more transition that old light is carried over.
fn unknown_after(transition: &Transition, before: Unknown) -> Unknown {
    let came = transition.slots_without_light();
    let mut unknown = before.map_or_else(Vec::new, |before| before.to_vec());
    unknown.resize(transition.after.slots(), false);
    came.into_iter().for_each(|slot| unknown[slot as usize] = true);
    Some(unknown.into())
}

/// Elements whose light is none of theirs, in light that was saved. `unlit`: the edits behind the light that was saved to start from.
pub(crate) fn unknown_of_saved(light: &LightRecord, unlit: &[Unlit]) -> Unknown {
    let about = &light.about;
    let Some(right_for) = about.right_for.or(light.lit.as_ref().map(|(sequence, _)| *sequence)) else {
        return Some(vec![true; light.map.len()].into());
    };
    let carried = unlit.iter().filter(|unlit| (right_for + 1..=about.shown).contains(&unlit.sequence));
    carried.fold(None, |unknown, unlit| unknown_after(&unlit.transition, unknown))
}

/// What a job has to do.
pub(crate) enum Work {
    /// Bake this world.
    Bake(Box<World>),
    /// Light these edits, one after the other, from this map, which is right for this sequence number.
    Update(Sequence, Arc<LightMap>, Vec<Unlit>),
}

impl Lighting {
    pub(crate) fn new() -> Lighting {
        Lighting {
            lit: None,
            lit_sequence: 0,
            shown_sequence: 0,
            right_for: None,
            unlit: BTreeMap::new(),
            effort: Effort::default(),
        }
    }

    /// No light, and the world after `sequence` is the published one: the next job bakes.
    pub(crate) fn baked_next(sequence: Sequence) -> Lighting {
        Lighting { lit_sequence: sequence, shown_sequence: sequence, ..Lighting::new() }
    }

    /// As it was saved. `unlit`: the edits behind `lit`.
    pub(crate) fn restored(light: &LightRecord, unlit: impl IntoIterator<Item = Unlit>) -> Lighting {
        let shown = light.about.shown;
        let (lit_sequence, lit) = match &light.lit {
            Some((sequence, map)) => (*sequence, Some(map.clone())),
            None => (shown, None),
        };
        let mut lighting = Lighting {
            lit,
            lit_sequence,
            shown_sequence: shown,
            right_for: light.about.right_for,
            unlit: unlit.into_iter().map(|unlit| (unlit.sequence, unlit)).collect(),
            effort: light.about.effort,
        };
        lighting.drop_lit(lit_sequence);
        lighting
    }

    /// What is to be saved beside the published version: what its light is right for, and what the next job starts
    /// from.
    pub(crate) fn saved(&self) -> (Option<Sequence>, Option<(Sequence, Arc<LightMap>)>) {
        (self.right_for, self.lit.clone().map(|map| (self.lit_sequence, map)))
    }

    /// Takes in an accepted edit.
    pub(crate) fn accept(&mut self, unlit: Unlit) {
        self.unlit.insert(unlit.sequence, unlit);
    }

    /// Edits that are not lit yet.
    pub(crate) fn unlit(&self) -> usize {
        self.unlit.range((Excluded(self.lit_sequence), Included(Sequence::MAX))).count()
    }

    /// What edits asked for that are not lit yet, with their sequence numbers.
    pub(crate) fn unlit_edits(&self) -> Vec<(Sequence, Arc<[Edit]>)> {
        self.unlit.values().map(|unlit| (unlit.sequence, unlit.edits.clone())).collect()
    }

    /// The next version, which shows the geometry up to `sequence` with old light; `None` where it is shown already.
    pub(crate) fn show(&mut self, published: &Published, sequence: Sequence) -> Option<Published> {
        if sequence <= self.shown_sequence {
            return None;
        }
        let mut map = published.map.clone();
        let (mut world, mut unknown) = (None, published.unknown().clone());
        for (_, unlit) in self.unlit.range((Excluded(self.shown_sequence), Included(sequence))) {
            map = unlit.transition.carried(&map);
            unknown = unknown_after(&unlit.transition, unknown);
            world = Some(unlit.transition.after.clone());
        }
        self.shown_sequence = sequence;
        let world = world?;
        self.right_for = None;
        if self.lit.is_none() {
            self.drop_lit(self.shown_sequence);
        }
        Some(published.next(Some(world), map, &published.weights(), published.estimated_rmse, unknown))
    }

    /// What is to be done so that the light is right for the published world.
    pub(crate) fn work(&mut self, published: &Published, max_unlit: usize) -> Work {
        if self.unlit() > max_unlit {
            self.distrust();
        }
        match &self.lit {
            None => Work::Bake(Box::new(published.world.clone())),
            Some(map) => {
                let due = self.unlit.range((Excluded(self.lit_sequence), Included(self.shown_sequence)));
                Work::Update(self.lit_sequence, map.clone(), due.map(|(_, unlit)| unlit.clone()).collect())
            }
        }
    }

    /// The stated error of the published light where it is right for `sequence` already: a job that starts again
    /// publishes nothing worse.
    pub(crate) fn floor(&self, published: &Published, sequence: Sequence) -> Option<f32> {
        (self.right_for == Some(sequence) && self.shown_sequence == sequence).then_some(published.estimated_rmse)?
    }

    /// The next version, which shows a map that is right for `sequence` on the published world.
    pub(crate) fn snapshot(&mut self, published: &Published, sequence: Sequence, lit: Lit<'_>) -> Published {
        let mut map = lit.map.clone();
        let mut resolution = lit.resolution.cloned();
        let (mut scene, mut unknown) = (None, None);
        for (_, unlit) in self.unlit.range((Excluded(sequence), Included(self.shown_sequence))) {
            map = unlit.transition.carried(&map);
            unknown = unknown_after(&unlit.transition, unknown);
            scene.get_or_insert(&unlit.transition.before.scene);
            resolution = None;
        }
        // Of the lights that the map is right for: those of later edits are not in it.
        let weights = map.layer_weights(scene.unwrap_or(&published.world.scene));
        self.right_for = lit.is_right.then_some(sequence);
        published.next(None, map, &weights, lit.estimated_rmse, unknown).with_resolution(resolution)
    }

    /// The map, where it is right for all that was accepted and clients see all of that.
    pub(crate) fn up_to_date(&self, published: &Published) -> Option<Arc<LightMap>> {
        let is_up_to_date = self.unlit.is_empty() && self.lit_sequence == self.shown_sequence;
        self.lit.clone().filter(|map| is_up_to_date && map.len() == published.world.slots())
    }

    /// The next version, with a more accurate map in place of `of`. `None` where anything came in between, and whatever
    /// did counts: a job that started from `of` goes on with it.
    pub(crate) fn refine(&mut self, published: &Published, of: &Arc<LightMap>, lit: Lit<'_>) -> Option<Published> {
        self.up_to_date(published).filter(|map| Arc::ptr_eq(map, of))?;
        self.lit = Some(lit.map.clone());
        self.right_for = Some(self.shown_sequence);
        let weights = lit.map.layer_weights(&published.world.scene);
        let next = published.next(None, lit.map.clone(), &weights, lit.estimated_rmse, None);
        Some(next.with_resolution(lit.resolution.cloned()))
    }

    /// `map` is right for `sequence`.
    pub(crate) fn set_lit(&mut self, sequence: Sequence, map: Arc<LightMap>, samples: Samples) {
        self.lit = Some(map);
        match samples {
            Samples::Fresh(samples) => self.effort.samples = samples,
            Samples::More(more) => self.effort.samples = self.effort.samples.saturating_add(more),
            Samples::Same => {}
        }
        self.drop_lit(sequence);
    }

    pub(crate) fn effort(&self) -> Effort {
        self.effort
    }

    /// Notes whether the scene's target is reached.
    pub(crate) fn set_done(&mut self, is_done: bool) {
        self.effort.is_done = is_done;
    }

    /// There is no light to go on from.
    pub(crate) fn needs_bake(&self) -> bool {
        self.lit.is_none()
    }

    /// Whether the light is less than a target asks for. Where edits wait for light, that comes first.
    pub(crate) fn is_behind(&self, published: &Published, target: &JobBudget) -> bool {
        let Effort { samples, is_done } = self.effort;
        match (self.up_to_date(published), target.target_rmse) {
            (None, _) => self.lit.is_none(),
            (Some(_), _) if samples >= target.samples_per_element => false,
            (Some(map), Some(rmse)) => map.estimated_rmse(published.world.areas()) > rmse,
            (Some(_), None) => !is_done,
        }
    }

    /// Puts one edit in the place of all that are not lit yet up to its own, which add up to it: a long drag must not
    /// leave a long list. Their geometry is shown already, in the same slots.
    pub(crate) fn fold(&mut self, unlit: Unlit) {
        let (first, last) = (self.lit_sequence, unlit.sequence);
        if first < last && last <= self.shown_sequence {
            self.unlit.retain(|sequence, _| !(first + 1..=last).contains(sequence));
            self.unlit.insert(last, unlit);
        }
    }

    /// No map can be trusted: the next job bakes.
    pub(crate) fn distrust(&mut self) {
        self.lit = None;
        self.right_for = None;
        self.effort = Effort::default();
        self.drop_lit(self.shown_sequence);
    }

    /// The sequence number of the published world.
    pub(crate) fn shown(&self) -> Sequence {
        self.shown_sequence
    }

    fn drop_lit(&mut self, sequence: Sequence) {
        self.lit_sequence = self.lit_sequence.max(sequence);
        self.unlit = self.unlit.split_off(&(self.lit_sequence + 1));
    }
}
