//! Sets of probes that clients follow: what they were told last, and since which version.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rebake_core::probes::Probe;

/// Sets that are kept per scene; the one that was asked for longest ago makes room.
const SETS: usize = 4;

/// What tells sets apart: a hash of points and samples.
pub(crate) type SetKey = [u8; 32];

/// Each probe with the version of the light map that its light is of.
#[derive(Clone, Debug)]
pub(crate) struct ProbeSet {
    /// Version that it is up to date with.
    pub(crate) version: u64,
    /// Version that it began with: what was told before is not known.
    pub(crate) first: u64,
    pub(crate) probes: Arc<[(Probe, u64)]>,
}

impl ProbeSet {
    fn new(version: u64, fresh: Vec<Probe>) -> ProbeSet {
        ProbeSet { version, first: version, probes: fresh.into_iter().map(|probe| (probe, version)).collect() }
    }

    /// The set at a later version: probes whose light is within its error of what was told stay as they are.
    fn next(&self, version: u64, fresh: Vec<Probe>) -> ProbeSet {
        let newer = |(told, fresh): (&(Probe, u64), Probe)| match fresh.differs_from(&told.0) {
            true => (fresh, version),
            false => *told,
        };
        ProbeSet { version, first: self.first, probes: self.probes.iter().zip(fresh).map(newer).collect() }
    }
}

/// The sets of a scene.
#[derive(Debug, Default)]
pub(crate) struct KeptProbes {
    /// Whoever brings a set up to date holds it.
    pub(crate) turn: tokio::sync::Mutex<()>,
    /// Asked for last comes last.
    sets: Mutex<VecDeque<(SetKey, ProbeSet)>>,
}

impl KeptProbes {
    /// A set as it was last asked for.
    pub(crate) fn get(&self, key: &SetKey) -> Option<ProbeSet> {
        self.held().iter().find(|(kept, _)| kept == key).map(|(_, set)| set.clone())
    }

    /// Brings a set up to date with what was computed for a version, or begins it. To be called by whoever has the
    /// turn.
    pub(crate) fn update(&self, key: SetKey, version: u64, fresh: Vec<Probe>) -> ProbeSet {
        let mut sets = self.held();
        let at = sets.iter().position(|(kept, _)| *kept == key);
        let set = match at.and_then(|at| sets.remove(at)) {
            Some((_, set)) if set.probes.len() == fresh.len() => set.next(version, fresh),
            _ => ProbeSet::new(version, fresh),
        };
        if sets.len() >= SETS {
            sets.pop_front();
        }
        sets.push_back((key, set.clone()));
        set
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.held().iter().map(|(_, set)| size_of_val(&*set.probes)).sum()
    }

    fn held(&self) -> MutexGuard<'_, VecDeque<(SetKey, ProbeSet)>> {
        self.sets.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use rebake_core::harmonics::Harmonics;

    use super::*;

    fn probe(light: f32) -> Probe {
        Probe { radiance: Harmonics([Vec3::splat(light); 9]), error: [0.1; 9], validity: 1.0 }
    }

    #[test]
    fn what_changed_beyond_its_error_is_told_anew() {
        let kept = KeptProbes::default();
        kept.update([1; 32], 3, vec![probe(1.0), probe(1.0)]);
        // Small steps add up until they are told.
        kept.update([1; 32], 5, vec![probe(1.06), probe(2.0)]);
        let set = kept.update([1; 32], 6, vec![probe(1.12), probe(2.05)]);
        assert_eq!((set.first, set.version), (3, 6));
        assert_eq!(*set.probes, [(probe(1.12), 6), (probe(2.0), 5)]);
        assert_eq!(kept.get(&[1; 32]).unwrap().probes, set.probes);
        assert!(kept.get(&[2; 32]).is_none() && kept.memory_bytes() > 0);
    }

    #[test]
    fn sets_make_room_for_others() {
        let kept = KeptProbes::default();
        (0..SETS as u8).for_each(|k| drop(kept.update([k; 32], 1, vec![probe(1.0)])));
        kept.update([0; 32], 2, vec![probe(1.0)]);
        kept.update([9; 32], 2, vec![probe(1.0)]);
        assert!(kept.get(&[0; 32]).is_some() && kept.get(&[1; 32]).is_none(), "the one asked for longest ago");
    }
}
