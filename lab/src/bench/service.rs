//! A service as a bench asks it: what a client of it has, and when.

use std::time::Duration;

use anyhow::Result;
use glam::Vec3;
use rebake_core::{Edit, Focus, Stated, World};
use serde_json::{Map, Value};

use super::{Goal, Options, PreparedCase, Timed};

/// The light map before an edit.
#[derive(Clone, Copy, Debug)]
pub struct Base {
    /// Samples per element of its bake.
    pub samples: u32,
    /// What is published.
    pub mode: Stated,
    /// Of all random numbers.
    pub seed: u64,
}

impl Base {
    /// That of the `k`th run.
    pub(super) fn of_run(options: &Options, k: u32) -> Base {
        Base { samples: options.base_samples, mode: options.mode, seed: options.seed.wrapping_add(u64::from(k)) }
    }
}

/// A client's light map at some time.
#[derive(Clone, Debug)]
pub struct Seen {
    /// Seconds since the start of what is measured.
    pub seconds: f64,
    /// Per slot: irradiance / π, linear RGB.
    pub values: Vec<Vec3>,
}

/// Edits that follow each other at a steady pace.
#[derive(Clone, Debug)]
pub struct Drag {
    /// In their order; none adds or takes away elements.
    pub steps: Vec<Vec<Edit>>,
    /// From one to the next; each but the last has that long to be lit.
    pub pause: Duration,
    /// How long to look on, from the first step on.
    pub duration: Duration,
}

/// Lends a bench services of its own, each with one scene that it has baked, and plays their client.
pub trait Service {
    /// A focus as the service reads it from an edit of `world`.
    ///
    /// # Errors
    /// What is wrong with it.
    fn read_focus(&self, focus: &Value, world: &World) -> Result<Focus>;

    /// Has a case's edit lit to `goal`. Seconds are from the request to the end of its job; the light map is what a
    /// client that follows the scene then has, all of it in the part that `base` publishes.
    ///
    /// # Errors
    /// What the service refuses, and elements that are not those of the case.
    fn run(&self, case: &PreparedCase, base: Base, goal: Goal) -> Result<Timed>;

    /// Has a case's edit lit and answers every version that the client sees of it; `beside` is what its request has
    /// beside the edits: budget, focus, tiles.
    ///
    /// # Errors
    /// What the service refuses, and elements that are not those of the case.
    fn watch(&self, case: &PreparedCase, base: Base, beside: Map<String, Value>) -> Result<Vec<Seen>>;

    /// Drags things in a world and answers every version that the client sees, that before the first step first.
    ///
    /// # Errors
    /// What the service refuses, and elements that are not those of `before`.
    fn drag(&self, before: &World, base: Base, drag: &Drag) -> Result<Vec<Seen>>;
}
