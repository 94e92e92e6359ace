//! The light-map update service: HTTP API, job queue, version store and the parts of its command line.
//!
//! Data goes one way: request → queue → update → version store → delta → client. `api` only unpacks, calls and wraps;
//! `jobs` decides and runs; `store` keeps what was published; `engine` is the only module that computes light,
//! `pictures` the only one that draws it.
//! Nothing but `server` and `api` knows HTTP, and no light is computed on an async thread.

mod answers;
pub mod api;
pub mod auth;
mod bands;
pub mod client;
pub mod cluster;
mod compute;
pub mod config;
mod connections;
pub mod engine;
mod events;
mod filter;
mod freed;
mod gauges;
mod ids;
pub mod jobs;
mod memory;
mod metrics;
mod mode;
pub mod pictures;
mod restore;
mod saving;
pub mod server;
mod sizing;
mod state;
mod store;
mod tiles;
mod unit;
pub mod viewer;

pub use config::Config;
pub use filter::Filter;
pub use freed::keep_freed_memory;
pub use mode::Mode;
pub use server::{run, run_while};
pub use sizing::Sizing;
pub use store::faults;
pub use unit::LightUnit;

/// The largest albedo that anybody may let light meet: light of a closed room halves in 700 bounces, and has to end.
pub const LARGEST_ALBEDO: f32 = 0.999;
