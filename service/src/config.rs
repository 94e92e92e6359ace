//! Every limit of the service in one place. Nothing that a client can make grow is without one.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use crate::auth::Tokens;
use crate::cluster::ClusterConfig;
use crate::engine::{CoreEngine, Engine};
use crate::store::faults::Faults;

/// How the service runs.
#[derive(Clone, Debug)]
pub struct Config {
    /// Compute threads of one running job, and of the short tasks (uploads, edits, encoding); 0: one per core.
    pub threads: usize,
    /// Jobs that run at the same time, each of another scene.
    pub job_slots: usize,
    /// Sizes and counts.
    pub limits: Limits,
    /// Waits.
    pub timeouts: Timeouts,
    /// What a client gets that does not ask for anything else.
    pub defaults: Defaults,
    /// Where scenes, assets, edits and light maps are kept across restarts; none: in memory only.
    pub data_dir: Option<PathBuf>,
    /// Who may do what; none: everybody everything.
    pub tokens: Option<Tokens>,
    /// Host names that the service answers to without tokens, beside those of this machine and the address that it
    /// listens on; `*`: all. Others would let a page elsewhere reach it under a name of its own (DNS rebinding).
    pub host_names: Vec<String>,
    /// Origins whose pages may call the API from a browser; none by default. `*`: all.
    pub cors_origins: Vec<String>,
    /// Refine light maps while no job waits; none: their jobs' budgets are all that is spent on them.
    pub idle_refine: Option<IdleRefine>,
    /// Seeds of all jobs derive from it and from how many jobs their scene had: services with the same one give the
    /// same light, bit for bit, for the same scene and edits. A job keeps the seed it was accepted with, so another one
    /// after a restart is for new jobs.
    pub seed: u64,
    /// Other machines that do parts of bakes; none: all is done here.
    pub cluster: Option<ClusterConfig>,
    /// It serves reads of what another service publishes, and takes no changes.
    pub is_replica: bool,
    /// Faults of the data directory, for tests.
    pub faults: Faults,
    /// What computes light: the engine, or a stand-in for tests.
    pub engine: Arc<dyn Engine>,
}

/// How far light maps are refined while no job waits. It always ends: at the share, or where `samples` more per element
/// do not halve the stated error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IdleRefine {
    /// Stop where the stated error is this part of the mean light.
    pub error_share: f64,
    /// Samples per element of one spell.
    pub samples: u32,
}

impl Default for IdleRefine {
    fn default() -> IdleRefine {
        IdleRefine { error_share: 0.01, samples: 1024 }
    }
}

/// Sizes and counts. One more is refused, never queued without end.
#[derive(Clone, Debug)]
pub struct Limits {
    /// Bytes of an uploaded scene or asset.
    pub upload_bytes: usize,
    /// Bytes that a refused request may still send: clients that send first and read then hear of the refusal.
    pub drain_bytes: usize,
    /// Bytes of an edit request.
    pub edit_bytes: usize,
    /// Uploads that are built at the same time; more wait.
    pub concurrent_uploads: usize,
    /// Open connections; more wait in the listener's backlog.
    pub connections: usize,
    /// Open event and delta streams.
    pub streams: usize,
    /// Triangles of an uploaded file.
    pub triangles: usize,
    /// Triangles of a scene after subdivision.
    pub subdivided_triangles: usize,
    /// Elements of a scene.
    pub elements: usize,
    /// Texels that the objects of a scene take in its atlas.
    pub atlas_texels: u64,
    /// Bytes of memory of all scenes, assets and uploads under way together; one that would not fit is refused before
    /// it is built.
    pub memory_bytes: u64,
    /// Bytes of large answers that are made or sent at the same time.
    pub answer_bytes: u64,
    /// Scenes.
    pub scenes: usize,
    /// Assets.
    pub assets: usize,
    /// Bytes of all assets, as uploaded.
    pub asset_bytes: usize,
    /// Edits of one request.
    pub edits_per_request: usize,
    /// Queued jobs of one scene.
    pub queued_per_scene: usize,
    /// Queued jobs in all.
    pub queued: usize,
    /// Finished jobs that are remembered.
    pub finished_jobs: usize,
    /// Idempotency keys remembered per scene, and as many of uploads.
    pub idempotency_keys: usize,
    /// Edit requests of a scene that can be taken back.
    pub undo_steps: usize,
    /// Events remembered per job and per scene, for `Last-Event-ID`.
    pub events: usize,
    /// Canceled edits of a scene whose light may be outstanding; past that the next job bakes afresh.
    pub unlit_edits: usize,
    /// Bytes of a delta frame; larger snapshots travel in several.
    pub frame_bytes: usize,
    /// Entries of one page, at most.
    pub page: usize,
    /// Points of one request for light at points.
    pub sample_points: usize,
    /// Probes of one request.
    pub probes: usize,
    /// Samples of one request for light at points or for probes.
    pub samples: u64,
    /// Samples per element that a budget may ask for.
    pub samples_per_element: u32,
    /// Seconds that a budget may ask for.
    pub max_seconds: f64,
}

/// Waits.
#[derive(Clone, Debug)]
pub struct Timeouts {
    /// For the head of a request.
    pub header: Duration,
    /// For a request's whole body.
    pub body: Duration,
    /// For the next piece of an upload's body.
    pub body_idle: Duration,
    /// For what a refused request still sends.
    pub drain: Duration,
    /// For the end of a restore, of a request that comes before it.
    pub restore: Duration,
    /// For a place among the uploads.
    pub upload_slot: Duration,
    /// For an uploaded scene to be prepared before the upload is answered without it.
    pub upload_answer: Duration,
    /// For a scene to be prepared, of a request that comes before it is.
    pub preparing: Duration,
    /// An answer of which nothing is taken in for so long gives way where others need its room.
    pub answer_stall: Duration,
    /// For room for a large answer.
    pub answer_room: Duration,
    /// Between two comments on a silent event stream.
    pub keep_alive: Duration,
    /// From the shutdown signal to the end of the last connection.
    pub shutdown: Duration,
    /// For a client to take in anything at all of what was sent to it.
    pub write: Duration,
    /// Between two progress events of one job.
    pub progress: Duration,
    /// Between two saves of the light of a job that runs.
    pub save: Duration,
    /// How long work towards a scene's target goes on at a time while another scene waits.
    pub share: Duration,
}

/// What a client gets that does not ask for anything else.
#[derive(Clone, Debug)]
pub struct Defaults {
    /// Samples per element of a bake.
    pub bake_samples: u32,
    /// Samples per element of an edit.
    pub edit_samples: u32,
    /// Entries of one page.
    pub page: usize,
}

impl Default for Config {
    fn default() -> Config {
        Config {
            threads: 0,
            job_slots: 2,
            limits: Limits::default(),
            timeouts: Timeouts::default(),
            defaults: Defaults::default(),
            data_dir: None,
            tokens: None,
            host_names: Vec::new(),
            cors_origins: Vec::new(),
            idle_refine: None,
            seed: 0,
            cluster: None,
            is_replica: false,
            faults: Faults::default(),
            engine: Arc::new(CoreEngine),
        }
    }
}

impl Default for Limits {
    fn default() -> Limits {
        Limits {
            upload_bytes: 512 << 20,
            drain_bytes: 1 << 30,
            edit_bytes: 1 << 20,
            concurrent_uploads: 2,
            connections: 1024,
            streams: 512,
            triangles: 20_000_000,
            subdivided_triangles: 40_000_000,
            elements: 20_000_000,
            atlas_texels: rebake_core::atlas::DEFAULT_MAX_TEXELS,
            memory_bytes: crate::memory::default_limit(),
            // With little memory one answer at a time is still let through.
            answer_bytes: (crate::memory::default_limit() / 16).clamp(64 << 20, 1 << 30),
            scenes: 64,
            assets: 1024,
            asset_bytes: 4 << 30,
            edits_per_request: 256,
            queued_per_scene: 64,
            queued: 512,
            finished_jobs: 1000,
            idempotency_keys: 1024,
            undo_steps: 256,
            events: 256,
            unlit_edits: 64,
            frame_bytes: 4 << 20,
            page: 200,
            sample_points: 4096,
            probes: 32_768,
            samples: 1 << 23,
            samples_per_element: 65_536,
            max_seconds: 86_400.0,
        }
    }
}

impl Default for Timeouts {
    fn default() -> Timeouts {
        Timeouts {
            header: Duration::from_secs(15),
            body: Duration::from_secs(300),
            body_idle: Duration::from_secs(30),
            drain: Duration::from_secs(10),
            restore: Duration::from_secs(10),
            upload_slot: Duration::from_secs(60),
            upload_answer: Duration::from_millis(800),
            preparing: Duration::from_secs(60),
            answer_stall: Duration::from_secs(5),
            answer_room: Duration::from_secs(60),
            keep_alive: Duration::from_secs(15),
            shutdown: Duration::from_secs(10),
            write: Duration::from_secs(60),
            progress: Duration::from_millis(100),
            save: Duration::from_secs(10),
            share: Duration::from_secs(1),
        }
    }
}

impl Default for Defaults {
    fn default() -> Defaults {
        Defaults { bake_samples: 128, edit_samples: 48, page: 50 }
    }
}
