//! What the edits that were accepted so far lead to, however far their light is.

use std::sync::OnceLock;

use super::history::History;
use super::keys::IdempotencyKeys;
use super::lighting::Sequence;
use crate::engine::{ObjectSummary, World, objects};

/// What the next edit is validated against.
pub(crate) struct Head {
    /// After all accepted edits.
    pub(crate) world: World,
    /// Accepted edit requests that changed something.
    pub(crate) sequence: Sequence,
    /// Jobs of this scene so far: seeds derive from it.
    pub(crate) jobs: u64,
    pub(crate) keys: IdempotencyKeys,
    /// What was accepted, and the way back.
    pub(crate) history: History,
}

/// A scene after its last accepted edit.
pub(crate) struct AcceptedWorld {
    /// Edit requests that were accepted and changed something.
    pub(crate) sequence: Sequence,
    pub(crate) world: World,
    /// Bytes of the world.
    pub(crate) bytes: u64,
    /// Of the world; worked out when a client first asks.
    objects: OnceLock<Vec<ObjectSummary>>,
}

impl AcceptedWorld {
    pub(crate) fn new(world: &World, sequence: Sequence) -> AcceptedWorld {
        let bytes = world.memory_bytes() as u64;
        AcceptedWorld { sequence, world: world.clone(), bytes, objects: OnceLock::new() }
    }

    /// The objects of the world. The first call takes a moment in large scenes.
    pub(crate) fn objects(&self) -> &[ObjectSummary] {
        self.objects.get_or_init(|| objects(&self.world).collect())
    }
}
