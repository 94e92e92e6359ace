//! Parts of a light map that are computed when a client asks: kept while they are right, so that the pages of an atlas
//! share one.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use glam::Vec3;

/// Values per element that are computed for a request.
#[derive(Debug)]
pub(crate) struct ComputedPart {
    /// One value per slot of each, with its name among the channels of a picture; a single one has none.
    pub(crate) bands: Vec<(&'static str, Vec<Vec3>)>,
    /// What a file says of itself: names and texts.
    pub(crate) about: Vec<(&'static str, String)>,
    /// Stated error, area-weighted RMSE.
    pub(crate) stated: f32,
    /// How far was looked, metres, where that counts.
    pub(crate) distance: Option<f32>,
}

/// What it is right for: a version, and the distance that was asked for, as bits.
type Key = (u64, Option<u32>);

/// What was computed last.
#[derive(Debug, Default)]
pub(crate) struct KeptPart {
    /// Whoever computes it holds it: others wait for the same.
    pub(crate) turn: tokio::sync::Mutex<()>,
    last: Mutex<Option<(Key, Arc<ComputedPart>)>>,
}

impl KeptPart {
    /// That of a version, where it is the last one.
    pub(crate) fn get(&self, version: u64, distance: Option<f32>) -> Option<Arc<ComputedPart>> {
        let key = (version, distance.map(f32::to_bits));
        self.held().as_ref().filter(|(kept, _)| *kept == key).map(|(_, found)| Arc::clone(found))
    }

    /// Keeps it in place of the last one.
    pub(crate) fn keep(&self, version: u64, distance: Option<f32>, found: &Arc<ComputedPart>) {
        *self.held() = Some(((version, distance.map(f32::to_bits)), Arc::clone(found)));
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        let bytes = |(_, found): &(Key, Arc<ComputedPart>)| -> usize {
            found.bands.iter().map(|(_, values)| size_of_val(values.as_slice())).sum()
        };
        self.held().as_ref().map_or(0, bytes)
    }

    fn held(&self) -> MutexGuard<'_, Option<(Key, Arc<ComputedPart>)>> {
        self.last.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
