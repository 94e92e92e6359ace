//! What a caller and a running bake or update say to each other: budgets down, progress and snapshots up, cancel down.

use std::sync::Arc;

use crate::estimate::Estimate;
use crate::lightmap::{LayerHeader, LightMap};

/// When to stop. The first bound that is reached ends the work; time is the caller's (see [`Observer::plan_round`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Budget {
    /// Samples per element of the last full pass.
    pub samples_per_element: u32,
    /// Stop when the estimated area-weighted RMSE (radiance / albedo) is at most this.
    pub target_rmse: Option<f32>,
}

/// What is being done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pass {
    /// Light straight from lights.
    Direct,
    /// The object's own elements (update) before the scene's.
    Object,
    /// The source of an edit on the scene's elements.
    Source,
    /// Further bounces on a subset of the elements.
    Propagation,
    /// Gather at full resolution.
    FinalGather,
}

impl Pass {
    /// A stable word for clients.
    pub fn as_str(self) -> &'static str {
        match self {
            Pass::Direct => "direct",
            Pass::Object => "object",
            Pass::Source => "source",
            Pass::Propagation => "propagation",
            Pass::FinalGather => "final_gather",
        }
    }
}

/// How far the work is.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Which pass runs.
    pub pass: Pass,
    /// Samples per element of the rounds that are finished.
    pub samples_per_element: u32,
    /// Samples per element of the round that runs.
    pub round_samples: u32,
    /// Part of the running round that is done, 0..=1.
    pub round_fraction: f32,
    /// Part of it that the pass takes which runs, roughly.
    pub pass_share: f32,
    /// Rays traced so far.
    pub rays: u64,
    /// Estimated area-weighted RMSE of the last snapshot, where there is one.
    pub estimated_rmse: Option<f32>,
    /// Of an update: how many times the samples so far it takes until its own noise makes the whole map's error at most
    /// 1.05 times what it was before, and twice where the change is seen, and new elements are as good as what is around
    /// them; at most 1 where it is there. None where that is not known.
    pub needed: Option<f32>,
}

impl Progress {
    /// Of work that has just begun with a pass.
    pub(crate) fn nothing(pass: Pass) -> Progress {
        Progress { round_fraction: 0.0, ..Progress::at_once(pass, 0, None) }
    }

    /// Of a map that is there at once, without a round of samples.
    pub fn at_once(pass: Pass, samples_per_element: u32, estimated_rmse: Option<f32>) -> Progress {
        Progress {
            pass,
            samples_per_element,
            round_samples: 0,
            round_fraction: 1.0,
            pass_share: 0.0,
            rays: 0,
            estimated_rmse,
            needed: None,
        }
    }
}

/// What a light map that a job shows holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Snapshot {
    /// A first picture of a bake, before its first round is done: direct light, and one ambient term per layer for all
    /// light that has not been distributed yet. To be shown, and nothing else: what the bake gives does not depend on it.
    Estimate,
    /// New light where it comes first ([`crate::Importance`]), old light elsewhere. Nothing is to start from it.
    Partial,
    /// Light that is right for the scene everywhere.
    Complete {
        /// Its area-weighted RMSE (irradiance / π) as its variance tells it; none where nothing is known of that yet.
        stated: Option<f32>,
    },
}

/// A round of a bake whose parts may be done elsewhere, by who has the world and nothing else
/// ([`crate::PartBaker`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Offer<'a> {
    /// Of the bake; seeds of its rounds derive from it.
    pub seed: u64,
    /// Layers along the same rays; empty where all light is one.
    pub layers: &'a [LayerHeader],
    /// Which round it is.
    pub round: u32,
    /// How many times the nominal number of samples each slot gets; empty where all get it once.
    pub effort: &'a [u8],
    /// Samples per element of each of its parts.
    pub parts: &'a [u32],
}

/// What a bake does next, asked of [`Observer::next_part`].
#[derive(Clone, Debug, PartialEq)]
pub enum NextPart {
    /// This part, here.
    Run(u32),
    /// It takes this one as it was done elsewhere.
    Take(Estimate),
}

/// The caller's side of a running job. Called from the thread that runs the job, [`Observer::canceled`] and
/// [`Observer::advanced`] from all.
pub trait Observer: Sync {
    /// Asked at every tile: true ends the work with [`Canceled`].
    fn canceled(&self) -> bool {
        false
    }

    /// Where the work stands; called at least at every pass, and cheap to ignore.
    fn progress(&self, _progress: &Progress) {}

    /// A loop of the pass that runs has come so far, 0..=1; a pass of several loops begins anew with each. Called from all
    /// threads, at every tile.
    fn advanced(&self, _part: f32) {}

    /// Asked before each round: how many samples per element it may take (at most `proposed`); 0 ends the work.
    /// The first round is asked for too, and answering 0 there leaves the map as it was.
    fn plan_round(&self, _so_far: &Progress, proposed: u32) -> u32 {
        proposed
    }

    /// Whether what comes first ([`crate::Importance`]) is to be left as far as it is, and the rest done: asked before
    /// each of its rounds. A tile that is not done yet keeps its old light until then.
    fn leaves_first(&self) -> bool {
        false
    }

    /// Whether a [`Snapshot::Estimate`] is of use; else nothing is computed for it.
    fn wants_estimates(&self) -> bool {
        false
    }

    /// A round of a bake begins whose parts may be done elsewhere.
    fn offer(&self, _offer: &Offer<'_>) {}

    /// Which of the parts of the offered round that are still missing, ascending and never none, is to be done here now,
    /// or what has come of one elsewhere. What the round gives does not depend on where they were done, nor on the order
    /// in which they come. May wait.
    fn next_part(&self, missing: &[u32]) -> NextPart {
        NextPart::Run(missing[0])
    }

    /// A consistent light map, better than the one before, and what it holds. Cheap: the map is shared.
    fn snapshot(&self, _map: &Arc<LightMap>, _snapshot: Snapshot, _progress: &Progress) {}
}

/// The work was ended by [`Observer::canceled`]; the last snapshot is still good.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("canceled")]
pub struct Canceled;

/// An observer that lets everything run to its end.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unobserved;

impl Observer for Unobserved {}
