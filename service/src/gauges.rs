//! What Prometheus is told when it asks: what was counted, and gauges as of now.

use std::sync::atomic::AtomicU64;

use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::{Registry, Unit};

use crate::jobs::queue::JobState;
use crate::state::App;

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct OfState {
    state: &'static str,
}

#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct OfScene {
    scene: String,
}

/// All metrics of the service as text.
pub(crate) fn text(app: &App) -> Result<String, std::fmt::Error> {
    let mut registry = Registry::with_prefix("rebake");
    app.metrics.register(&mut registry);
    register_state(app, &mut registry);
    let mut text = String::new();
    prometheus_client::encoding::text::encode(&mut text, &registry)?;
    Ok(text)
}

/// Gauges as of now.
fn register_state(app: &App, registry: &mut Registry) {
    let gauge = |registry: &mut Registry, name: &str, help: &str, value: u64| {
        let gauge = Gauge::<u64, AtomicU64>::default();
        gauge.set(value);
        registry.register(name, help, gauge);
    };
    let jobs = Family::<OfState, Gauge<u64, AtomicU64>>::default();
    app.jobs.with_queue(|queue| {
        for state in JobState::ALL {
            let count = queue.iter().filter(|job| job.state() == state).count();
            jobs.get_or_create(&OfState { state: state.as_str() }).set(count as u64);
        }
    });
    registry.register("jobs", "Jobs that are remembered, by state", jobs);
    if let Some(workers) = app.jobs.worker_count() {
        gauge(registry, "workers", "Workers on other machines that are there", workers as u64);
    }
    let memory = Family::<OfScene, Gauge<u64, AtomicU64>>::default();
    let version = Family::<OfScene, Gauge<u64, AtomicU64>>::default();
    let error = Family::<OfScene, Gauge<f64, AtomicU64>>::default();
    let scenes = app.scenes.all();
    for scene in &scenes {
        let (published, label) = (scene.published(), OfScene { scene: scene.id.clone() });
        let bytes = published.world.memory_bytes() + published.memory_bytes();
        memory.get_or_create(&label).set(bytes as u64);
        version.get_or_create(&label).set(published.version);
        error.get_or_create(&label).set(published.stated_rmse().map_or(f64::NAN, f64::from));
    }
    registry.register_with_unit("scene_memory", "Memory of each scene", Unit::Bytes, memory);
    registry.register("scene_version", "Version of each light map", version);
    registry.register("scene_estimated_rmse", "Stated error of each light map", error);
    let streams = app.config.limits.streams - app.streams.available_permits();
    gauge(registry, "streams", "Open event and delta streams", streams as u64);
    let refining = u64::from(app.jobs.is_refining());
    gauge(registry, "refining", "Light maps that are refined because no job waits", refining);
    gauge(registry, "scenes", "Scenes", scenes.len() as u64);
    gauge(
        registry,
        "scenes_damaged",
        "Scenes that cannot be served",
        scenes.iter().filter(|s| s.is_damaged()).count() as u64,
    );
    gauge(registry, "memory_limit_bytes", "Memory that scenes may take", app.config.limits.memory_bytes);
}
