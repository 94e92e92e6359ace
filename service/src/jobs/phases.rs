//! Where the time of the engine goes: seconds and rays per pass, as the engine tells of them.

use std::time::Instant;

use crate::engine::{Pass, Progress};
use crate::metrics::Metrics;

/// Follows one piece of work of the engine. What lies between two reports belongs to the pass that the earlier one
/// named.
#[derive(Debug, Default)]
pub(super) struct PhaseClock {
    running: Option<(Instant, Pass)>,
    rays: u64,
}

impl PhaseClock {
    /// The engine has reported.
    pub(super) fn tick(&mut self, metrics: &Metrics, progress: &Progress) {
        let now = Instant::now();
        let (since, pass) = self.running.replace((now, progress.pass)).unwrap_or((now, progress.pass));
        let rays = progress.rays.saturating_sub(self.rays);
        self.rays = progress.rays;
        metrics.phase(pass, (now - since).as_secs_f64(), rays);
    }

    /// The engine has returned; the next work counts its rays from 0.
    pub(super) fn stop(&mut self, metrics: &Metrics) {
        if let Some((since, pass)) = self.running.take() {
            metrics.phase(pass, since.elapsed().as_secs_f64(), 0);
        }
        self.rays = 0;
    }
}
