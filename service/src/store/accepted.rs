//! What the edits that were accepted so far lead to, however far their light is.

use std::sync::OnceLock;

use super::lighting::Sequence;
use crate::engine::{ObjectSummary, World, objects};

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
