//! What is counted for Prometheus, as requests and jobs raise it.

use std::sync::atomic::AtomicU64;

use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::{Registry, Unit};

use crate::engine::Pass;
use crate::jobs::queue::{JobKind, JobState};
use crate::store::versions::Published;

/// Answers by route: few, since a route is a pattern and not a path.
#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct Route {
    method: String,
    route: String,
    status: u16,
}

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct Ended {
    kind: &'static str,
    state: &'static str,
}

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct OfPhase {
    phase: &'static str,
}

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct Done {
    place: &'static str,
}

/// All metrics of the service.
pub(crate) struct Metrics {
    requests: Family<Route, Counter>,
    request_seconds: Histogram,
    jobs_ended: Family<Ended, Counter>,
    job_seconds: Histogram,
    wait_seconds: Histogram,
    rays: Counter,
    phase_seconds: Family<OfPhase, Counter<f64, AtomicU64>>,
    phase_rays: Family<OfPhase, Counter>,
    elements_changed: Counter,
    /// Versions published while no job waited.
    pub(crate) idle_versions: Counter,
    versions: Counter,
    /// Parts of rounds that were offered to workers.
    parts: Family<Done, Counter>,
    /// Bytes of delta frames, before compression.
    pub(crate) delta_bytes: Counter,
    /// Changes that could not be kept.
    pub(crate) unsaved: Counter,
}

impl Default for Metrics {
    fn default() -> Metrics {
        let seconds = |first: f64| Histogram::new(exponential_buckets(first, 4.0, 9));
        Metrics {
            requests: Family::default(),
            request_seconds: seconds(0.001),
            jobs_ended: Family::default(),
            job_seconds: seconds(0.01),
            wait_seconds: seconds(0.01),
            rays: Counter::default(),
            phase_seconds: Family::default(),
            phase_rays: Family::default(),
            elements_changed: Counter::default(),
            idle_versions: Counter::default(),
            versions: Counter::default(),
            parts: Family::default(),
            delta_bytes: Counter::default(),
            unsaved: Counter::default(),
        }
    }
}

/// How a job ended.
pub(crate) struct JobEnd {
    pub(crate) kind: JobKind,
    pub(crate) state: JobState,
    pub(crate) wait_seconds: f64,
    pub(crate) seconds: f64,
}

impl Metrics {
    /// A part of a round was done: here, elsewhere, or in a way that is refused.
    pub(crate) fn part_done(&self, place: &'static str) {
        self.parts.get_or_create(&Done { place }).inc();
    }

    /// Counts an answer.
    pub(crate) fn answered(&self, method: &str, route: &str, status: u16, seconds: f64) {
        // Methods are the client's to invent.
        let method =
            if matches!(method, "GET" | "POST" | "PATCH" | "DELETE" | "HEAD" | "OPTIONS") { method } else { "other" };
        let route = Route { method: method.to_owned(), route: route.to_owned(), status };
        self.requests.get_or_create(&route).inc();
        self.request_seconds.observe(seconds);
    }

    /// Counts a job that ended.
    pub(crate) fn job_ended(&self, end: &JobEnd) {
        let label = Ended { kind: end.kind.as_str(), state: end.state.as_str() };
        self.jobs_ended.get_or_create(&label).inc();
        self.job_seconds.observe(end.seconds);
        self.wait_seconds.observe(end.wait_seconds);
    }

    /// Counts a part of the engine's work.
    pub(crate) fn phase(&self, pass: Pass, seconds: f64, rays: u64) {
        let label = OfPhase { phase: pass.as_str() };
        self.phase_seconds.get_or_create(&label).inc_by(seconds);
        self.phase_rays.get_or_create(&label).inc_by(rays);
        self.rays.inc_by(rays);
    }

    /// Counts a version.
    pub(crate) fn published(&self, published: &Published) {
        self.versions.inc();
        let changed = published.changed.iter().filter(|version| **version == published.version).count();
        self.elements_changed.inc_by(changed as u64);
    }

    /// Puts all of them into what is told.
    pub(crate) fn register(&self, registry: &mut Registry) {
        registry.register("http_requests", "Answers by route and status", self.requests.clone());
        let name = "http_request_duration";
        registry.register_with_unit(name, "Time to the head of an answer", Unit::Seconds, self.request_seconds.clone());
        registry.register("jobs_ended", "Jobs by how they ended", self.jobs_ended.clone());
        registry.register_with_unit("job_duration", "Start to end of jobs", Unit::Seconds, self.job_seconds.clone());
        registry.register_with_unit("job_wait", "Arrival to start of jobs", Unit::Seconds, self.wait_seconds.clone());
        registry.register("rays", "Rays traced", self.rays.clone());
        let help = "Time in each phase of bakes and updates";
        registry.register_with_unit("phase", help, Unit::Seconds, self.phase_seconds.clone());
        registry.register("phase_rays", "Rays traced in each phase of bakes and updates", self.phase_rays.clone());
        let help = "Elements whose value a new version changed";
        registry.register("elements_changed", help, self.elements_changed.clone());
        registry.register("idle_versions", "Light maps published while no job waited", self.idle_versions.clone());
        registry.register("versions", "Light maps published", self.versions.clone());
        registry.register("parts", "Parts of rounds by where they were done", self.parts.clone());
        let help = "Delta frames sent, before compression";
        registry.register_with_unit("delta", help, Unit::Bytes, self.delta_bytes.clone());
        registry.register("unsaved", "Changes that could not be kept", self.unsaved.clone());
    }
}
