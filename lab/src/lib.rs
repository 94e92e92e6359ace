//! The laboratory of rebake: what measures the engine and nothing else needs. Other methods on the same worlds (path
//! tracing, the published update), benches of them all side by side, and sheets of pictures.
//!
//! It knows the engine alone. Who has a service at hand lends it to a bench as a [`bench::Service`].

pub mod bench;
pub mod compare;
pub mod paper;
pub mod path;
pub mod sheet;
pub mod truth;
