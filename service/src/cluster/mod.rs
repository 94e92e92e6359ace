//! Several machines for one bake. Large rounds of bakes are done in parts (`rebake_core::PartBaker`); a coordinator, which
//! is a service with a queue, offers them to workers and adds up what comes of them, in an order of its own: one worker,
//! four or none give the same bits. Without a queue nothing of this runs.
//!
//! The queue is a work queue of NATS JetStream: a part is acknowledged when its result is kept, and given to another worker
//! where the first one falls silent. Files go by an object store (`objects`). `messages` are what machines say to each
//! other, `snapshot` is a scene as others can have it, `board` decides what is done where, `offers` and
//! `coordinator` speak for a bake, `worker` works for others. `publication` puts versions where a `replica` finds them, which serves reads.

mod board;
mod coordinator;
mod messages;
mod objects;
mod offers;
mod publication;
mod replica;
mod snapshot;
mod worker;

use std::fmt::Display;

use async_nats::{Client, ConnectOptions};

pub(crate) use coordinator::Coordinator;
use messages::FORMAT;
pub(crate) use offers::OpenOffer;
pub(crate) use publication::publish;
pub use replica::replicate;
pub(crate) use snapshot::Told;
pub use worker::{WorkerOptions, work};

/// Where machines meet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClusterConfig {
    /// Address of a NATS server with JetStream, as `nats://host:4222`.
    pub queue: String,
    /// Where files are shared: a folder, or an address that the `object_store` crate knows.
    pub objects: String,
    /// A service leaves parts to workers as long as there are any.
    pub delegates: bool,
}

/// What goes wrong between machines.
#[derive(Debug, thiserror::Error)]
pub enum ClusterError {
    /// An address that leads nowhere.
    #[error("the address of the {what}, {address:?}: {reason}")]
    Address {
        /// Of what.
        what: &'static str,
        /// As it was given.
        address: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The queue cannot be used.
    #[error("the queue: {0}")]
    Queue(String),
    /// Files cannot be put or read.
    #[error("the objects: {0}")]
    Objects(#[from] object_store::Error),
    /// A file has other bytes than its name says.
    #[error("a file has another hash than it should")]
    WrongHash,
    /// Written by another version of the program.
    #[error("a snapshot is of version {0} of the program")]
    OtherVersion(String),
    /// Another machine made another world of the same files.
    #[error("the scene has other elements here than where it is kept")]
    OtherLayout,
    /// What was sent cannot be read.
    #[error("{what} cannot be read: {reason}")]
    Odd {
        /// What it should be.
        what: &'static str,
        /// Why.
        reason: String,
    },
    /// A part was not done.
    #[error("a part: {0}")]
    Part(#[from] rebake_core::PartError),
    /// The coordinator takes nothing from this worker any more.
    #[error("the coordinator refuses what this worker gives")]
    Refused,
    /// A panic, or the end of the process.
    #[error("{0}")]
    Failed(String),
}

impl ClusterError {
    fn queue(error: impl Display) -> ClusterError {
        ClusterError::Queue(error.to_string())
    }

    fn odd(what: &'static str, error: impl Display) -> ClusterError {
        ClusterError::Odd { what, reason: error.to_string() }
    }
}

/// Connects to the queue, in the background: where it is not there it is tried again and again.
async fn connect(queue: &str, name: &str) -> Result<Client, ClusterError> {
    let told = |event: async_nats::Event| async move {
        match event {
            async_nats::Event::Connected => tracing::info!("the queue is there"),
            event => tracing::warn!(%event, "the queue"),
        }
    };
    let options = ConnectOptions::new().name(name).retry_on_initial_connect().event_callback(told);
    let invalid = |reason: String| ClusterError::Address { what: "queue", address: queue.to_owned(), reason };
    options.connect(queue).await.map_err(|error| invalid(error.to_string()))
}
