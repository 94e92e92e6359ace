//! Edits of a scene applied again in their order, which gives the same slots, and the saved light held against them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use rebake_core::allowed::Allowed;

use crate::api::edit_parse::{self, Parsed};
use crate::engine::{self, Edit, World};
use crate::store::StoreError;
use crate::store::assets::Assets;
use crate::store::disk::SavedEdit;
use crate::store::history::{self, History};
use crate::store::lighting::{Sequence, Unlit};
use crate::store::records::{EarlierLight, LightRecord};

/// A scene after all of its edits.
pub(super) struct Replayed {
    pub(super) world: World,
    pub(super) sequence: Sequence,
    /// The world that the saved light was published with.
    shown: Option<World>,
    /// Slots of the world that the saved light to start from is right for.
    lit_slots: Option<usize>,
    /// Edits that the saved light does not know.
    pub(super) unlit: Vec<Unlit>,
    /// Worlds that saved light of earlier states is of.
    pub(super) earlier: BTreeMap<Sequence, World>,
    /// Edits between what the saved light was computed from and what it is right for.
    pub(super) since_base: Vec<Edit>,
    pub(super) history: History,
}

/// Sequence numbers of what is kept of a replay.
#[derive(Default)]
struct Wanted {
    shown: Option<Sequence>,
    lit: Option<Sequence>,
    earlier: BTreeSet<Sequence>,
    base: Option<Sequence>,
}

impl Wanted {
    fn by(light: &LightRecord) -> Wanted {
        let EarlierLight { kept, base } = &light.earlier;
        Wanted {
            shown: Some(light.about.shown),
            lit: light.lit.as_ref().map(|(sequence, _)| *sequence),
            earlier: kept.iter().chain(base).map(|(sequence, _)| *sequence).collect(),
            base: base.as_ref().map(|(sequence, _)| *sequence),
        }
    }

    /// Whether an edit lies between the base and the light that was computed from it.
    fn is_since_base(&self, sequence: Sequence) -> bool {
        self.base.zip(self.lit).is_some_and(|(base, lit)| (base + 1..=lit).contains(&sequence))
    }
}

/// Applies all edits again. Only what `light` does not know is kept: every world has arrays of its own.
pub(super) fn replay(
    assets: &Assets,
    uploaded: World,
    edits: &[SavedEdit],
    light: Option<&LightRecord>,
) -> Result<Replayed, StoreError> {
    let wanted = light.map(Wanted::by).unwrap_or_default();
    let known = wanted.shown.map_or(Sequence::MAX, |shown| wanted.lit.map_or(shown, |lit| lit.min(shown)));
    let mut replayed = Replayed {
        world: uploaded,
        sequence: 0,
        shown: None,
        lit_slots: None,
        unlit: Vec::new(),
        earlier: BTreeMap::new(),
        since_base: Vec::new(),
        history: History::new(usize::MAX),
    };
    replayed.note(&wanted);
    for saved in edits {
        let sequence = &saved.sequence;
        let failed = |why: String| StoreError::damaged("an edit cannot be applied again", format!("{sequence}: {why}"));
        if *sequence != replayed.sequence + 1 {
            return Err(failed("an earlier one is missing".to_owned()));
        }
        let (edits, parsed) = read_edits(assets, &saved.body, &replayed.history).map_err(failed)?;
        let transition = replayed.world.apply_again(&edits).map_err(|error| failed(error.to_string()))?;
        let (body, job, accepted_at) = (saved.body.clone().into(), saved.job, saved.accepted_at);
        let moves = parsed.moves();
        let accepted = history::Accepted { body, job, accepted_at, moves, turn: None, is_undone: false };
        replayed.history.accept(accepted, parsed.way(), (&replayed.world.scene, &transition.after.scene));
        replayed.world = transition.after.clone();
        replayed.sequence = *sequence;
        replayed.note(&wanted);
        if wanted.is_since_base(*sequence) {
            replayed.since_base.extend_from_slice(&edits);
        }
        if *sequence > known {
            let transition = Arc::new(transition);
            replayed.unlit.push(Unlit { sequence: *sequence, transition, edits: edits.into() });
        }
    }
    Ok(replayed)
}

impl Replayed {
    fn note(&mut self, wanted: &Wanted) {
        if wanted.shown == Some(self.sequence) {
            self.shown = Some(self.world.clone());
        }
        if wanted.lit == Some(self.sequence) {
            self.lit_slots = Some(self.world.slots());
        }
        if wanted.earlier.contains(&self.sequence) {
            self.earlier.insert(self.sequence, self.world.clone());
        }
    }
}

fn read_edits(assets: &Assets, body: &[u8], history: &History) -> Result<(Vec<Edit>, Parsed), String> {
    let parsed = edit_parse::parse(body, usize::MAX).map_err(|problem| problem.to_string())?;
    let edits = edit_parse::to_edits(&parsed, assets, history, Allowed::KEPT);
    Ok((edits.map_err(|problem| problem.to_string())?, parsed))
}

/// The light with the world it belongs to; an error where their slots differ.
pub(super) fn fits(replayed: &Replayed, light: LightRecord) -> Result<(World, LightRecord), StoreError> {
    let differs = || StoreError::damaged("it does not fit the scene", "the slots differ");
    let shown = replayed.shown.as_ref().ok_or_else(differs)?;
    let about = &light.about;
    if light.map.len() != shown.slots() || about.layout != engine::layout_hash(shown) {
        return Err(differs());
    }
    if about.weights.len() != light.map.layers.len() {
        return Err(differs());
    }
    if light.lit.as_ref().is_some_and(|(_, lit)| replayed.lit_slots != Some(lit.len())) {
        return Err(differs());
    }
    Ok((shown.clone(), light))
}
